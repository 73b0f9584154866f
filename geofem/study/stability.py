"""Maps of where methods fail: one knob of a scene against variants, coloured by the error, with the boundary of failure.

A map is data (``MAPS`` in ``maps.py``). Of each variant a coarse row is run first; the boundary, where the error crosses the
map's threshold or a run breaks down, is then found by bisection between the two runs that enclose it, on the scale of the axis.
Where a run goes along the axis itself, as a bar does that is pulled out, the place where it broke down is the boundary.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from tqdm import tqdm

from geofem.mistake import Mistake, unknown
from geofem.study import chart, rows, sweep
from geofem.study.map import Map, Variant
from geofem.study.maps import MAPS
from geofem.study.rows import Row


@dataclass(frozen=True)
class Point:
    """One run of a map: its error, or None and the cause of its end; of several runs the worst.

    at : where on the axis the run ended, if the map is run along it.
    """

    x: float
    error: float | None
    cause: str | None
    at: float | None = None

    def failed(self, threshold: float) -> bool:
        return self.error is None or self.error > threshold


@dataclass(frozen=True)
class Line:
    """A finished row of a map: its points along the axis from safe to harsh, and where it fails, None if it never does."""

    label: str
    points: tuple[Point, ...]
    boundary: float | None


SMALLEST = 1e-6
"""Smaller errors are drawn as this one."""


# --- running ----------------------------------------------------------------------------------------------------------
Runs = dict[tuple[str, float], list[Row]]
"""What was run: (variant, x) -> a row for each of ``Map.cases``."""


def run_points(this: Map, wanted: Sequence[tuple[Variant, float]], out: Path, done: Runs) -> None:
    """Run what is not done yet, one worker for each method. A run that kills its worker is a row, and the others go on."""
    todo = {(variant.label, x): variant for variant, x in wanted if (variant.label, x) not in done}
    for method in dict.fromkeys(variant.method for variant in todo.values()):
        left = [(variant, x, case) for (_, x), variant in todo.items() if variant.method == method for case in this.cases]
        while left:
            runs = [{**this.scene_knobs, **variant.knobs, **this.knobs(x), **case} for variant, x, case in left]
            folder = Path("runs") / f"{method}-{sum(map(len, done.values()))}"
            batch = sweep.batch(this.scene, method, runs, out / folder, 1, sweep.TIMEOUT, this.analysis)
            count = 0
            for row, (variant, x, _) in zip(batch, left):
                row |= {"label": variant.label, "vary": this.knob, "scene_knobs": dict(this.scene_knobs), "repeats": 1}
                row |= {"machine": sweep.machine(), "run": str(folder / str(count))}
                rows.append(out, row)
                done.setdefault((variant.label, x), []).append(row)
                count += 1
            left = left[count:]


def judge(this: Map, variant: Variant, x: float, done: Runs) -> Point:
    """The worst error of the runs at x, against the scene's reference or the map's own."""
    against = done[this.reference.label, x] if this.reference else [None] * len(this.cases)
    points = [judge_row(this, row, x, other) for row, other in zip(done[variant.label, x], against)]
    died = [point for point in points if point.error is None]
    return died[0] if died else max(points, key=lambda point: point.error or 0.0)


def judge_row(this: Map, row: Row, x: float, against: Row | None) -> Point:
    """The error of one run."""
    if row["status"] != "ok":
        return Point(x, None, rows.why(row), row["at"].get(this.along))
    if against is None:
        error = rows.error(row, this.measure)
        return Point(x, error, None if error is not None else "no error was measured")
    if against["status"] != "ok":
        return Point(x, None, f"the reference {against['status']}: {rows.why(against)}")
    exact = against["qoi"][this.measure]
    return Point(x, abs(row["qoi"][this.measure] - exact) / abs(exact), None)


def bracket(points: Sequence[Point], threshold: float) -> tuple[float, float] | None:
    """The last x that works and the first that fails, from the safe end; None if all work or the first fails already."""
    failed = [point.failed(threshold) for point in points]
    if True not in failed or failed[0]:
        return None
    first = failed.index(True)
    return points[first - 1].x, points[first].x


def survey(this: Map, out: Path) -> list[Line]:
    """Run a map: the coarse rows, then the bisections, all variants together in each round.

    Runs along the axis need no bisection: the first that broke down says where.

    Raises ``Mistake`` if nothing of it could be run.
    """
    done: Runs = {}
    grid = this.scale.spread(this.safe, this.harsh, this.coarse)
    at: dict[str, list[float]] = {variant.label: list(grid) for variant in this.variants}
    down = this.harsh < this.safe

    def line(variant: Variant) -> list[Point]:
        return [judge(this, variant, x, done) for x in sorted(at[variant.label], reverse=down)]

    with tqdm(total=1 + this.bisections, desc=f"map {this.name}", unit="round", file=sys.stderr, disable=None) as progress:
        for step in range(1 + this.bisections):
            wanted = [(variant, x) for variant in this.variants for x in at[variant.label]]
            also = [(this.reference, x) for _, x in wanted] if this.reference else []
            run_points(this, wanted + also, out, done)
            found_rows = [row for several in done.values() for row in several]
            if all(row["status"] == "refused" for row in found_rows):
                raise Mistake(f"map {this.name}: nothing could be run: {rows.why(found_rows[0])}")
            for variant in this.variants:
                found = bracket(line(variant), this.threshold)
                if found and step < this.bisections and not this.along:
                    at[variant.label].append(this.scale.middle(*found))
            progress.update()
    return [Line(variant.label, tuple(points := line(variant)), boundary(this, points)) for variant in this.variants]


def boundary(this: Map, points: Sequence[Point]) -> float | None:
    """Where a row fails: between two runs, or where the first failed run along the axis ended; None if it never does."""
    first = next((point for point in points if point.failed(this.threshold)), None)
    if first is None:
        return None
    if first.at is not None:
        return first.at
    found = bracket(points, this.threshold)
    return this.scale.middle(*found) if found else this.safe


# --- drawing ----------------------------------------------------------------------------------------------------------
def edges(line: Line, this: Map) -> list[float]:
    """The borders (n + 1,) of the fields around n points; those at the ends lie on the points, one may be the boundary."""
    at = [point.x for point in line.points]
    borders = [at[0], *(this.scale.middle(a, b) for a, b in zip(at, at[1:])), at[-1]]
    failed = [point.failed(this.threshold) for point in line.points]
    if line.boundary is not None and True in failed and (first := failed.index(True)) > 0:
        borders[first] = line.boundary
    return borders


def percent(error: float, _: int = 0) -> str:
    return f"{float(f'{100 * error:.2g}'):g} %"


def number(error: float, _: int = 0) -> str:
    digits, power = f"{error:.1e}".split("e")
    return f"{float(digits):g}e{int(power)}" if error >= 1e4 else f"{float(f'{error:.2g}'):g}"


def draw(this: Map, lines: Sequence[Line]) -> Figure:
    """The map: colour is the error on a logarithmic scale, a bar the boundary, hatched what died, with the cause."""
    errors = [max(point.error, SMALLEST) for line in lines for point in line.points if point.error]
    errors += [this.threshold / 3, this.threshold * 3]  # the colours span the threshold, whatever was found
    told = percent if this.percent else number
    norm, colours = LogNorm(min(errors), max(errors)), matplotlib.colormaps["cividis"]
    with matplotlib.rc_context(chart.STYLE | {"hatch.color": "#b5b5b5"}):
        figure = Figure(figsize=(14, 2.6 + 0.85 * len(lines)), layout="constrained")
        axes = figure.subplots()
        axes.set_xscale(this.scale.name)
        whole = this.scale.way(this.safe, this.harsh)
        for i, line in enumerate(lines):
            borders = edges(line, this)
            for point, a, b in zip(line.points, borders, borders[1:]):
                level = None if point.error is None else float(norm(max(point.error, min(errors))))
                look = {"facecolor": "#ececec", "hatch": "xx"} if level is None else {"facecolor": colours(level)}
                axes.add_patch(Rectangle((min(a, b), i - 0.4), abs(b - a), 0.8, linewidth=0, **look))
                if abs(this.scale.way(a, b) / whole) < 0.065:
                    continue  # too narrow for words
                words = f"× {shortened(point.cause)}" if point.error is None else told(point.error)
                colour = "white" if level is not None and level < 0.55 else "black"
                paper = {"facecolor": "#ececec", "edgecolor": "none", "pad": 2} if level is None else None
                axes.text(this.scale.middle(a, b), i, words, ha="center", va="center", color=colour, fontsize=14, bbox=paper)
            if line.boundary is not None:
                for half, colour, width in ((0.46, "black", 8), (0.43, "white", 3)):  # whole at the ends of the axis as well
                    axes.plot([line.boundary] * 2, [i - half, i + half], color=colour, linewidth=width, solid_capstyle="butt",
                              clip_on=False, zorder=3)  # fmt: skip
        axes.set_xlim(this.safe, this.harsh)
        axes.set_ylim(len(lines) - 0.5, -0.5)
        axes.set_yticks(range(len(lines)), [line.label for line in lines])
        axes.tick_params(axis="y", length=0, pad=8)
        axes.tick_params(axis="x", which="minor", pad=5)  # as low as the labels of the longer major ticks
        axes.set_xlabel(this.axis)
        against = f"{this.quantity} against {this.reference.label}" if this.reference else this.quantity
        crosses = f"the bar marks where it crosses {told(this.threshold)} or a run breaks down"
        axes.set_title(f"{this.title}\n{against}; {crosses}", fontweight="bold")
        scale = matplotlib.cm.ScalarMappable(norm, colours)
        bar = figure.colorbar(scale, ax=axes, label=this.quantity, aspect=14, pad=0.01, format=told).ax.yaxis
        few = max(errors) / min(errors) < 100
        bar.set_minor_formatter(lambda x, _: told(x) if few and f"{x:e}"[0] in "25" else "")
        low, high = sorted((this.safe, this.harsh))
        if this.scale.name == "log" and high / low < 1000:
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(chart.between("235" if high / low < 30 else "25"))
    return figure


def shortened(cause: str | None) -> str:
    words = cause or "failed"
    return words if len(words) < 14 else "worker died" if words.startswith("worker died") else f"{words[:12].rstrip()}…"


def table(this: Map, lines: Sequence[Line]) -> str:
    """The boundaries as text."""
    width = max(len(line.label) for line in lines)
    threshold = (percent if this.percent else number)(this.threshold)
    text = [f"{this.title}: where the {this.quantity} crosses {threshold} ({this.axis})"]
    for line in lines:
        causes = ", ".join(sorted({point.cause for point in line.points if point.cause}))
        where = "not on this axis" if line.boundary is None else f"{line.boundary:.3g}"
        if line.boundary == this.safe:
            where = "all along this axis"
        text.append(f"  {line.label:{width}}  {where}{f'  ({causes})' if causes else ''}")
    return "\n".join(text)


def run(names: Sequence[str], out: Path) -> list[Path]:
    """Run the named maps, by default all; print their boundaries; return the charts, ``out/maps/NAME.png`` beside an SVG.

    Raises ``Mistake`` for an unknown map.
    """
    chosen = []
    for name in names or list(MAPS):
        if name not in MAPS:
            raise unknown("map", name, MAPS)
        chosen.append(MAPS[name])
    made = []
    for this in chosen:
        folder = out / "maps" / this.name
        lines = survey(this, folder)
        chart.save(draw(this, lines), out / "maps" / this.name)
        print(table(this, lines))
        made.append(out / "maps" / f"{this.name}.png")
        print(f"map: {made[-1]}")
    return made
