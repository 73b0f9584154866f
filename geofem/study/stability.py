"""Maps of where methods fail: one knob of a scene against variants, coloured by the error, with the boundary of failure.

A map is data (``MAPS`` in ``maps.py``). Of each variant a coarse row is run first; the boundary, where the error crosses the
map's threshold or a run breaks down, is then found by bisection between the two runs that enclose it, on the scale of the axis.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from tqdm import tqdm

from geofem.mistake import Mistake, unknown
from geofem.study import chart, rows, sweep
from geofem.study.maps import MAPS, Map, Variant
from geofem.study.rows import Row


@dataclass(frozen=True)
class Point:
    """One run of a map: its error, or None and the cause of its end."""

    x: float
    error: float | None
    cause: str | None

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
Runs = dict[tuple[str, float], Row]
"""What was run: (variant, x) -> row."""


def run_points(this: Map, wanted: Sequence[tuple[Variant, float]], out: Path, done: Runs) -> None:
    """Run what is not done yet, one worker for each method. A run that kills its worker is a row, and the others go on."""
    todo = {(variant.label, x): variant for variant, x in wanted if (variant.label, x) not in done}
    for method in dict.fromkeys(variant.method for variant in todo.values()):
        left = [(variant, x) for (_, x), variant in todo.items() if variant.method == method]
        while left:
            runs = [{**this.scene_knobs, **variant.knobs, this.knob: this.value(x)} for variant, x in left]
            folder = Path("runs") / f"{method}-{len(done)}"
            batch = sweep.batch(this.scene, method, runs, out / folder, 1, sweep.TIMEOUT)
            count = 0
            for row, (variant, x) in zip(batch, left):
                row |= {"label": variant.label, "vary": this.knob, "scene_knobs": dict(this.scene_knobs), "repeats": 1}
                row |= {"machine": sweep.machine(), "run": str(folder / str(count))}
                rows.append(out, row)
                done[variant.label, x] = row
                count += 1
            left = left[count:]


def judge(this: Map, variant: Variant, x: float, done: Runs) -> Point:
    """The error of one run, against the scene's reference or the map's own."""
    row = done[variant.label, x]
    if row["status"] != "ok":
        return Point(x, None, rows.why(row))
    if this.reference is None:
        error = rows.error(row, this.measure)
        return Point(x, error, None if error is not None else "no error was measured")
    against = done[this.reference.label, x]
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

    Raises ``Mistake`` if nothing of it could be run.
    """
    done: Runs = {}
    grid = np.geomspace(this.safe, this.harsh, this.coarse).tolist()
    at: dict[str, list[float]] = {variant.label: list(grid) for variant in this.variants}
    down = this.harsh < this.safe

    def line(variant: Variant) -> list[Point]:
        return [judge(this, variant, x, done) for x in sorted(at[variant.label], reverse=down)]

    with tqdm(total=1 + this.bisections, desc=f"map {this.name}", unit="round", file=sys.stderr, disable=None) as progress:
        for step in range(1 + this.bisections):
            wanted = [(variant, x) for variant in this.variants for x in at[variant.label]]
            also = [(this.reference, x) for _, x in wanted] if this.reference else []
            run_points(this, wanted + also, out, done)
            if all(row["status"] == "refused" for row in done.values()):
                raise Mistake(f"map {this.name}: nothing could be run: {rows.why(next(iter(done.values())))}")
            for variant in this.variants:
                found = bracket(line(variant), this.threshold)
                if found and step < this.bisections:
                    at[variant.label].append(float(np.sqrt(found[0] * found[1])))
            progress.update()
    lines = []
    for variant in this.variants:
        points = line(variant)
        found = bracket(points, this.threshold)
        boundary = float(np.sqrt(found[0] * found[1])) if found else this.safe if points[0].failed(this.threshold) else None
        lines.append(Line(variant.label, tuple(points), boundary))
    return lines


# --- drawing ----------------------------------------------------------------------------------------------------------
def edges(x: Sequence[float]) -> np.ndarray:
    """The borders (n + 1,) of the fields around n points on a logarithmic axis; those at the ends lie on the points."""
    at = np.asarray(x)
    return np.concatenate([at[:1], np.sqrt(at[:-1] * at[1:]), at[-1:]])


def percent(error: float, _: int = 0) -> str:
    return f"{float(f'{100 * error:.2g}'):g} %"


def draw(this: Map, lines: Sequence[Line]) -> Figure:
    """The map: colour is the error on a logarithmic scale, a bar the boundary, hatched what died, with the cause."""
    errors = [max(point.error, SMALLEST) for line in lines for point in line.points if point.error is not None]
    errors += [this.threshold / 3, this.threshold * 3]  # the colours span the threshold, whatever was found
    norm, colours = LogNorm(min(errors), max(errors)), matplotlib.colormaps["cividis"]
    with matplotlib.rc_context(chart.STYLE | {"hatch.color": "#b5b5b5"}):
        figure = Figure(figsize=(14, 2.6 + 0.85 * len(lines)), layout="constrained")
        axes = figure.subplots()
        axes.set_xscale("log")
        for i, line in enumerate(lines):
            borders = edges([point.x for point in line.points])
            for point, a, b in zip(line.points, borders, borders[1:]):
                level = None if point.error is None else float(norm(max(point.error, SMALLEST)))
                look = {"facecolor": "#ececec", "hatch": "xx"} if level is None else {"facecolor": colours(level)}
                axes.add_patch(Rectangle((min(a, b), i - 0.4), abs(b - a), 0.8, linewidth=0, **look))
                if abs(np.log(b / a) / np.log(this.harsh / this.safe)) < 0.065:
                    continue  # too narrow for words
                words = f"× {shortened(point.cause)}" if point.error is None else percent(point.error)
                colour = "white" if level is not None and level < 0.55 else "black"
                paper = {"facecolor": "#ececec", "edgecolor": "none", "pad": 2} if level is None else None
                axes.text(np.sqrt(a * b), i, words, ha="center", va="center", color=colour, fontsize=14, bbox=paper)
            if line.boundary is not None:
                axes.plot([line.boundary] * 2, [i - 0.46, i + 0.46], color="black", linewidth=8, solid_capstyle="butt")
                axes.plot([line.boundary] * 2, [i - 0.43, i + 0.43], color="white", linewidth=3, solid_capstyle="butt")
        axes.set_xlim(this.safe, this.harsh)
        axes.set_ylim(len(lines) - 0.5, -0.5)
        axes.set_yticks(range(len(lines)), [line.label for line in lines])
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel(this.axis)
        against = f"error against {this.reference.label}; " if this.reference else "error; "
        axes.set_title(f"{this.title}\n{against}the bar marks where it crosses {percent(this.threshold)}", fontweight="bold")
        scale = matplotlib.cm.ScalarMappable(norm, colours)
        figure.colorbar(scale, ax=axes, label="relative error", aspect=14, pad=0.01, format=percent)
    return figure


def shortened(cause: str | None) -> str:
    words = cause or "failed"
    return words if len(words) < 14 else "worker died" if words.startswith("worker died") else f"{words[:12].rstrip()}…"


def table(this: Map, lines: Sequence[Line]) -> str:
    """The boundaries as text."""
    width = max(len(line.label) for line in lines)
    text = [f"{this.title}: where the error crosses {percent(this.threshold)} ({this.axis})"]
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
