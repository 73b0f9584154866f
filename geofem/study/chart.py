"""Charts: error against CPU time and against size, one figure per problem and measure; the history of a single run.

A finished run is a marker, a variant of a method a line, the Pareto front a broad grey band under the runs that no other run
beats, and a run that failed a cross at the upper edge with its cause. Against an exact or an overkill reference the error is
drawn, on logarithmic axes and with the observed order; against a bracket or an experiment the quantity itself and the band,
and no order is claimed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogFormatterMathtext, NullFormatter

from geofem.study import rows
from geofem.study.rows import CLOSEST, Row

# Okabe & Ito (2008), with Tol's wine in place of yellow and sky blue, which a projector washes out. Colours, markers and
# dashes differ in number, so that the first 56 lines are told apart by colour and marker, and neighbours by dashes too when
# printed in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#882255", "#E69F00")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
PARTICLES = ("mpm", "sph", "dem")
"""Methods whose points are unknowns of their own beside the dofs, and not the quadrature of a mesh."""
ORDERED = ("exact", "overkill")
STYLE = {
    "font.size": 15,
    "axes.titlesize": 17,
    "axes.labelsize": 16,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "lines.linewidth": 2.2,
    "lines.markersize": 9,
    "legend.frameon": False,
    "savefig.facecolor": "white",
}
BARE = {"Date": None, "Creator": None, "Format": None, "Type": None}


def styles(labels: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Colour, marker and dashes of each variant: the same in all charts of a report when given all its labels."""
    looks = zip(cycle(COLOURS), cycle(MARKERS), cycle(DASHES))
    return {
        name: {"color": colour, "marker": marker, "linestyle": dash}
        for name, (colour, marker, dash) in zip(dict.fromkeys(labels), looks)
    }


def save(figure: Figure, stem: Path) -> Path:
    """Write ``stem.svg`` and ``stem.png``; return the path of the SVG."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": stem.name}):
        figure.savefig(stem.with_suffix(".svg"), metadata=BARE)
    figure.savefig(stem.with_suffix(".png"), dpi=130)
    return stem.with_suffix(".svg")


def inline(path: Path) -> str:
    """An SVG file as an element of an HTML page, its ids made its own, as several charts share the page."""
    text = re.sub(r'(id="|"#|url\(#)', rf"\g<1>{path.stem}-", path.read_text())
    return text[text.index("<svg") :]


# --- one panel --------------------------------------------------------------------------------------------------------
def observed(row: Row, measure: str, banded: bool) -> float | None:
    """What stands on the vertical axis: the quantity beside a band, the error otherwise."""
    if banded:
        return row["qoi"].get(measure) if row["status"] == "ok" else None
    value = rows.error(row, measure)
    return None if value is None else max(value, CLOSEST)


def draw_front(axes: Axes, group: Sequence[Row], measure: str, budget: str) -> None:
    front = rows.pareto(group, measure, budget)
    x = [rows.cost(row, budget) for row in front]
    y = [observed(row, measure, False) for row in front]
    axes.plot(x, y, color="#bbbbbb", linewidth=9, solid_capstyle="round", solid_joinstyle="round", alpha=0.7, zorder=1)


def draw_failures(axes: Axes, group: Sequence[Row], budget: str, look: Mapping[str, Mapping[str, Any]]) -> None:
    """A cross for each failed run along the upper edge, at its cost if that is known and at the right edge if not."""
    failed = [row for row in group if row["status"] in ("failed", "partial")]
    if not failed:
        return
    left, right = axes.get_xlim()
    right = max([right] + [1.2 * known for row in failed if (known := rows.cost(row, budget))])
    axes.set_xlim(left, right)
    low, high = axes.get_ylim()
    room = 0.11 * (len(failed) + 0.5)
    axes.set_ylim(low, high * (high / low) ** room if axes.get_yscale() == "log" else high + (high - low) * room)
    top = 1 / (1 + room)
    axes.add_patch(Rectangle((0, top), 1, 1 - top, transform=axes.transAxes, color="#f7e8e1", zorder=0, linewidth=0))
    for i, row in enumerate(failed):
        known = rows.cost(row, budget)
        x = 0.97 if known is None else np.clip(np.log(known / left) / np.log(right / left), 0.03, 0.97)
        y = 1 - (1 - top) * (i + 0.6) / (len(failed) + 0.2)
        colour = look[rows.label(row)]["color"]
        axes.plot(x, y, "x", transform=axes.transAxes, color=colour, markersize=13, markeredgewidth=3.5, clip_on=False)
        side = "left" if x < 0.5 else "right"
        words = f"{rows.label(row)} {rows.step(row)}: {rows.why(row)}"
        words = words if len(words) < 60 else words[:58].rstrip() + "…"
        axes.text(x + (0.03 if side == "left" else -0.03), y, words, transform=axes.transAxes, ha=side, va="center",
                  fontsize=14, color=colour)  # fmt: skip


def draw_triangles(axes: Axes, lines: Mapping[str, Sequence[Row]], measure: str, look: Mapping[str, Mapping[str, Any]]) -> None:
    """Under the fine end of each line a triangle with its fitted slope; lines of nearly equal slope share one."""
    drawn: list[float] = []
    for name, line in lines.items():
        points = [(d, e) for row in line if (d := rows.cost(row, "dofs")) and (e := observed(row, measure, False))]
        fitted = rows.slope([d for d, _ in points], [e for _, e in points])
        if fitted is None or fitted > -0.1 or any(abs(fitted - other) < 0.15 for other in drawn):
            continue
        drawn.append(fitted)
        (x0, y0), (x1, _) = points[-2], points[-1]
        a, b = x0 * (x1 / x0) ** 0.25, x0 * (x1 / x0) ** 0.75
        y = y0 * (a / x0) ** fitted / 1.5
        end = y * (b / a) ** fitted
        colour = look[name]["color"]
        axes.fill([a, b, a], [y, end, end], facecolor=colour, alpha=0.2, edgecolor=colour, linewidth=1.2, zorder=2)
        axes.annotate(f"{-fitted:.1f}", (a, np.sqrt(y * end)), (-4, 0), textcoords="offset points", ha="right", va="center",
                      fontsize=12, color=colour)  # fmt: skip
        axes.annotate("1", (np.sqrt(a * b), end), (0, -4), textcoords="offset points", ha="center", va="top",
                      fontsize=12, color=colour)  # fmt: skip


def overhead(lines: Mapping[str, Sequence[Row]]) -> float | None:
    """The CPU time (s) below which cost is overhead: that of the cheapest run, if refining costs next to nothing somewhere.

    Next to nothing: the CPU time grows by less than the fourth root of the dofs' growth.
    """
    free = False
    seconds = []
    for line in lines.values():
        sized = [(d, c) for row in line if row["status"] == "ok" and (d := rows.cost(row, "dofs")) and (c := rows.cost(row))]
        seconds += [c for _, c in sized]
        free |= any(d1 > d0 and c1 / c0 < (d1 / d0) ** 0.25 for (d0, c0), (d1, c1) in zip(sized, sized[1:]))
    return min(seconds) if free else None


def legend_text(name: str, line: Sequence[Row], measure: str, ordered: bool) -> str:
    """The variant's name, its material points if it has any, and its observed order."""
    points = [row["size"]["points"] for row in line if row["size"].get("points") and row["method"].startswith(PARTICLES)]
    extra = [f"{min(points)}–{max(points)} points"] if points else []
    order = rows.observed_order(line, measure) if ordered else None
    if order is not None:
        extra.append(f"order {order:.1f} in h" if order > 0.1 else "does not converge")
    return f"{name} ({', '.join(extra)})" if extra else name


def between(digits: str) -> Callable[[float, int], str]:
    """Tick labels between the decades of a short axis: at these multiples of a power of ten."""
    return lambda x, _: f"{x:g}" if f"{x:e}"[0] in digits else ""


def draw_panel(axes: Axes, group: Sequence[Row], measure: str, budget: str, reference: Mapping[str, Any],
               look: Mapping[str, Mapping[str, Any]]) -> None:  # fmt: skip
    """One problem and measure: what was found against what it cost."""
    kind = reference.get("kind", "")
    group = [row for row in group if row["status"] != "refused"]  # the caption says why they are not here
    lines = rows.by_label(group)
    banded = kind not in ("", *ORDERED) and any(row["qoi"].get(measure) is not None for row in group)
    axes.set_xscale("log")
    axes.set_yscale("linear" if banded else "log")
    axes.grid(True, which="major")
    for name, line in lines.items():
        drawn = [(x, y) for row in line if (x := rows.cost(row, budget)) and (y := observed(row, measure, banded)) is not None]
        text = legend_text(name, line, measure, kind in ORDERED)
        axes.plot(
            *np.array(drawn).reshape(-1, 2).T, **look[name], label=text, zorder=3, markeredgecolor="white", markeredgewidth=0.5
        )
    if banded and reference.get("lower") is not None and reference.get("upper") is not None:
        axes.axhspan(
            reference["lower"], reference["upper"], color="#009E73", alpha=0.25, linewidth=0, label=f"{kind} reference"
        )
    elif banded and reference.get("value") is not None:
        axes.axhline(reference["value"], color="#009E73", alpha=0.5, linewidth=5, label=f"{kind} reference")
    elif not banded:
        draw_front(axes, group, measure, budget)
    axes.margins(0.09)
    if budget == "dofs" and kind in ORDERED:
        draw_triangles(axes, lines, measure, look)
    floor = overhead(lines) if budget == "cpu" else None
    if floor is not None:
        axes.axvline(floor, color="#777777", linewidth=1.5, linestyle=(0, (2, 2)), zorder=0)
        axes.annotate(" overhead floor", (floor, 0.01), xycoords=axes.get_xaxis_transform(), color="#555555", fontsize=12)
    draw_failures(axes, group, budget, look)
    axes.set_xlabel("CPU time (s)" if budget == "cpu" else "degrees of freedom")
    unit = reference.get("unit")
    axes.set_ylabel(
        f"{measure} ({unit})" if banded and unit not in (None, "-") else measure if banded else f"relative error of {measure}"
    )
    left, right = axes.get_xlim()
    axes.xaxis.set_major_formatter("{x:g}" if budget == "cpu" or right / left < 100 else LogFormatterMathtext())
    axes.xaxis.set_minor_formatter(between("235" if right / left < 10 else "25") if right / left < 100 else NullFormatter())


# --- figures ----------------------------------------------------------------------------------------------------------
def reference_of(group: Iterable[Row], measure: str) -> Mapping[str, Any]:
    """The reference of a measure as the first row has it that has one."""
    return next((row["reference"][measure] for row in group if row["reference"].get(measure)), {})


def work_precision(group: Sequence[Row], measure: str, look: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Error against CPU time (left) and against degrees of freedom (right) for the rows of one problem."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(14, 7.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        reference = reference_of(group, measure)
        for axes, budget in ((left, "cpu"), (right, "dofs")):
            draw_panel(axes, group, measure, budget, reference, look)
        handles, labels = left.get_legend_handles_labels()
        columns = 2 if max(map(len, labels)) > 36 else min(4, len(labels))
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, handlelength=3.2, fontsize=14)
        figure.suptitle(f"{rows.problem(group[0])}: {measure}", fontsize=19, fontweight="bold")
    return figure


def history(sampled: Mapping[str, np.ndarray]) -> Figure:
    """Each quantity that a run sampled, against t."""
    names = [name for name in sampled if name != "t"]
    with matplotlib.rc_context(STYLE | {"font.size": 13}):
        columns = min(3, len(names))
        height = -(-len(names) // columns)
        figure = Figure(figsize=(4.6 * columns, 3.4 * height), layout="constrained")
        for axes, name in zip(figure.subplots(height, columns, squeeze=False).flat, names):
            axes.plot(sampled["t"], sampled[name], color=COLOURS[0])
            axes.set_title(name)
            axes.set_xlabel("t")
            axes.grid(True)
        for axes in figure.axes[len(names) :]:
            axes.set_axis_off()
    return figure
