"""A short film (MP4) and a sheet of stills of one run, from the frames it left: ``geofem run ... --out DIR --frames N``.

All frames have the same axes, colours and units, so that they can be compared; the colours are those of ``pictures``, whose
lightness grows with the value and which survive grey printing. Bodies in the plane are drawn by Matplotlib. Bodies in space are
drawn by PyVista in a process of its own, one PNG a frame, and Matplotlib adds the time and the colour bar; where PyVista brings
no picture home, Matplotlib draws the body too.
"""

from __future__ import annotations

import json
import logging
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import imread
from tqdm import tqdm

from geofem import materials
from geofem.mistake import Mistake, unknown
from geofem.scene import Scene
from geofem.study import paint, pictures
from geofem.study.chart import STYLE
from geofem.study.fields import FIELDS, Array, Snapshot, available, colouring, limits, title
from geofem.study.frames import Frames
from geofem.study.video import encode

log = logging.getLogger("geofem")
SECONDS = 6.0, 10.0
"""A film lasts between these, but for the pause on its last frame, and no shorter than its frames allow at ``FPS``."""
FPS = 4.0, 20.0
STILLS = 6
DPI = 100
BODIES = ("#0072B2", "#F0C04A", "#882255", "#8FC9E8", "#D55E00", "#B5B5B5", "#009E73", "#E8B7D4")
"""Colours of bodies, dark and light by turns, so that neighbours differ in grey as well."""
PATIENCE = 5.0
"""Seconds that PyVista may take for a frame, beside those it may take to start."""


# --- what all frames share --------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Look:
    """field : what the colours show. span : their limits. extend : on which sides values go beyond them.

    box : (2, gdim), the part of the plane or of space that is shown (m). side : width of the dots of points that tell no size (m).
    si : whether units are written. clock : unit of t: ``s``, ``load factor``, ``advance`` of cracks or empty.
    bodies : their names, for ``region``.
    shape : width against height of the pictures that PyVista made.
    """

    field: str
    span: tuple[float, float]
    extend: str
    box: Array
    side: float
    si: bool = True
    clock: str = ""
    bodies: tuple[str, ...] = ()
    shape: float = 0.0

    @property
    def solid(self) -> bool:
        return self.box.shape[1] == 3

    @property
    def ratio(self) -> float:
        """Width of a picture against its height."""
        if self.solid:
            return self.shape or 4.0 / 3.0
        return float(np.divide(*np.ptp(self.box, axis=0)))

    @property
    def colours(self) -> dict[str, Any]:
        """``cmap`` and ``norm``."""
        if self.field != "region":
            return {"cmap": pictures.COLOURS, "norm": Normalize(*self.span)}
        count = round(self.span[1] - self.span[0]) + 1
        shades = ListedColormap([BODIES[i % len(BODIES)] for i in range(count)])
        return {"cmap": shades, "norm": BoundaryNorm(self.span[0] - 0.5 + np.arange(count + 1), count)}


def choose(snapshot: Snapshot, scene: Scene | None) -> str:
    """The field that tells most of the frames of this scene: speed for what flows, stress for what springs back.

    Raises ``Mistake`` if nothing of the snapshot can be drawn.
    """
    there = available(snapshot)
    elastic = scene is not None and not any(materials.LAWS[region.material.law].history for region in scene.regions)
    if elastic:
        order = ["von_mises", "displacement"]
    elif scene is None or scene.dynamic:
        order = ["speed", "displacement"]
    else:
        order = ["plastic_strain", "displacement"]
    for name in (*order, *there):
        if name in there:
            return name
    raise Mistake("the frames hold no field that can be drawn: displacement, velocity or stress")


def survey(frames: Frames, shown: Sequence[int], field: str, scene: Scene | None, si: bool) -> Look:
    """Go through the frames once for the limits of colours and axes.

    A frame's limits leave out its ``tail``; those of a few frames far beyond the others, as in a breakdown, do not count either.
    """
    lows, highs, extremes, boxes = [], [], [], []
    rigid: list[Array] = []
    side = 0.0
    for i in shown:
        snapshot = frames[i]
        if field not in available(snapshot):
            continue
        if str(snapshot["cell"]) == "vertex" and not side:
            side = paint.spacing(snapshot)
        values = colouring(snapshot, field)
        low, high = limits(values, field)
        lows.append(low)
        highs.append(high)
        finite = values[np.isfinite(values)]
        extremes.append((finite.min(initial=np.inf), finite.max(initial=-np.inf)))
        boxes.append(paint.bounds(snapshot, side))
        rigid += paint.polygons(snapshot)
    least, most = np.min(extremes, axis=0)[0], np.max(extremes, axis=0)[1]
    if field == "region":
        span = (float(least), float(most))
    else:
        low, high = (float(np.quantile(lows, 0.02)) if FIELDS[field].signed else 0.0), float(np.quantile(highs, 0.98))
        if not FIELDS[field].tail:
            low, high = (min(low, least) if FIELDS[field].signed else 0.0), float(most)
        span = (low, high) if high > low else (low, low + 1.0)
    tiny = 1e-9 * (span[1] - span[0])
    beyond = (bool(least < span[0] - tiny), bool(most > span[1] + tiny))
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    if field == "region":
        extend = "neither"
    clock = "" if scene is None else "s" if scene.dynamic else "advance" if scene.growth else "load factor"
    names = tuple(region.name for region in scene.regions) if scene else ()
    return Look(field, span, extend, paint.room(np.array(boxes), rigid), side, si, clock if si or clock != "s" else "", names)


def stamps(t: Array, clock: str) -> list[str]:
    """The time in words for each of the t, all with the same number of digits: ``t = 0.25 s``."""
    last = float(np.abs(t).max()) or 1.0
    prefix, factor = "", 1.0
    if clock == "s" and last < 0.02:
        prefix, factor = ("m", 1e3) if last >= 2e-5 else ("µ", 1e6)
    step = float(np.median(np.diff(t))) * factor if len(t) > 1 else 1.0
    digits = int(np.clip(math.ceil(-math.log10(0.2 * step)), 0, 6)) if step > 0 else 3
    unit = f" {prefix}{clock}" if clock == "s" else ""
    name = "t" if clock in ("", "s") else clock
    texts = [f"{x * factor:.{digits}f}" for x in t]
    width = max(map(len, texts))
    return [f"{name} = {text.rjust(width, chr(0x2007))}{unit}" for text in texts]  # a space as wide as a digit


# --- drawing ----------------------------------------------------------------------------------------------------------
def draw_frame(axes: Any, look: Look, snapshot: Snapshot, image: Path | None) -> list[Any]:
    """Draw the body of one frame into axes that ``prepare`` has set up; returns what was added."""
    if image is not None:
        return [axes.imshow(imread(image), interpolation="antialiased")]
    if look.field not in available(snapshot):
        return []
    values = colouring(snapshot, look.field)
    if look.solid:
        return pictures.paint_solid(axes, snapshot, values, look.colours)
    return paint.body(axes, snapshot, values, look.side, look.colours)


def prepare(axes: Any, look: Look, image: Path | None) -> None:
    """Limits and labels that are the same in all frames; PyVista has them in its picture."""
    if image is not None:
        axes.set_axis_off()
    else:
        pictures.set_up(axes, look.box, look.si)


def grid(look: Look, count: int) -> tuple[int, int]:
    """Rows and columns of a sheet of so many pictures, about as wide as a page or a slide."""
    columns = next(c for limit, c in ((0.45, 6), (1.7, 3), (4.5, 2), (np.inf, 1)) if look.ratio <= limit)
    columns = min(columns, count)
    return -(-count // columns), columns


def colour_bar(figure: Figure, axes: Any, look: Look, beside: bool) -> None:
    """One bar for all axes, beside or below them."""
    mappable = ScalarMappable(**look.colours)
    where = (
        {"location": "right", "shrink": 0.9, "aspect": 28} if beside else {"location": "bottom", "shrink": 0.75, "aspect": 42}
    )
    if look.field != "region":
        pictures.bar(figure, mappable, look.field, look.si, ax=axes, extend=look.extend, **where)
        return
    drawn = figure.colorbar(mappable, ax=axes, **where)
    numbers = np.arange(round(look.span[0]), round(look.span[1]) + 1)
    named = len(look.bodies) > numbers[-1] >= 0 and numbers[0] >= 0
    drawn.set_ticks(numbers, labels=[look.bodies[i] if named else f"body {i}" for i in numbers])
    drawn.ax.minorticks_off()


def sheet(frames: Frames, look: Look, words: Mapping[int, str], images: Mapping[int, Path], path: Path) -> Path:
    """Draw the stills that ``words`` names, with their times, into one PNG file to be projected or printed."""
    rows, columns = grid(look, len(words))
    width = 14.0 if look.ratio * columns / rows > 0.8 else 11.0
    across = (width - 1.6) / columns
    height = float(np.clip(rows * (across / look.ratio + 0.55) + 1.9, 5.0, 13.0))
    with matplotlib.rc_context(STYLE | {"font.size": 17, "axes.titlesize": 18, "axes.labelsize": 18}):
        figure = Figure(figsize=(width, height), layout="compressed")
        kind = {"projection": "3d"} if look.solid and not images else {}
        flat = look.solid or bool(images)
        panels = figure.subplots(rows, columns, squeeze=False, subplot_kw=kind, sharex=not flat, sharey=not flat)
        for axes, i in zip(panels.flat, words):
            prepare(axes, look, images.get(i))
            draw_frame(axes, look, frames[i], images.get(i))
            axes.set_title(words[i], loc="left")
            if not flat:
                axes.locator_params(axis="x", nbins=4 if columns > 2 else 6)
                axes.locator_params(axis="y", nbins=4 if look.ratio > 1.5 else 6)
                axes.label_outer()
        for axes in panels.flat[len(words) :]:
            axes.set_axis_off()
        colour_bar(figure, panels, look, beside=look.ratio * columns / rows < 2.4)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150, bbox_inches="tight", pad_inches=0.15)
    return path


def size(look: Look) -> tuple[float, float]:
    """Width and height (inches) of a film that gives every shape of body about the same area."""
    if look.ratio > 1.3:
        width = 12.8
        height = (width - 1.4) / look.ratio + 2.4 if look.ratio > 2.2 else (width - 3.2) / look.ratio + 1.6
        return width, float(np.clip(height, 4.4, 8.6))
    height = 8.6
    return float(np.clip((height - 1.6) * look.ratio + 3.2, 6.4, 12.8)), height


def images_of(figure: Figure, canvas: FigureCanvasAgg) -> Array:
    """What the figure shows now, (height, width, 3), both even."""
    canvas.draw()
    shown = np.asarray(canvas.buffer_rgba())
    height, width = (length // 2 * 2 for length in shown.shape[:2])
    return np.ascontiguousarray(shown[:height, :width, :3])


def pages(frames: Frames, look: Look, words: Mapping[int, str], images: Mapping[int, Path], heading: str) -> Iterator[Array]:
    """The frames that ``words`` names as pictures for a film, one after the other."""
    with matplotlib.rc_context(STYLE | {"font.size": 17, "axes.titlesize": 20, "axes.labelsize": 18}):
        figure = Figure(figsize=size(look), dpi=DPI, layout="compressed")
        canvas = FigureCanvasAgg(figure)
        first = next(iter(words))
        axes: Any = figure.add_subplot(projection="3d" if look.solid and not images else None)
        prepare(axes, look, images.get(first))
        if not look.solid:
            axes.locator_params(axis="y", nbins=4 if look.ratio > 2.2 else 7)
        colour_bar(figure, axes, look, beside=look.ratio <= 2.2)
        stamp = axes.set_title(words[first], loc="left")
        axes.set_title(heading, loc="right", fontsize=15, color="#555555")
        canvas.draw()
        figure.set_layout_engine("none")  # from here on nothing moves but the body
        for i, text in words.items():
            drawn = draw_frame(axes, look, frames[i], images.get(i))
            stamp.set_text(text)
            yield images_of(figure, canvas)
            for artist in drawn:
                artist.remove()


# --- PyVista ----------------------------------------------------------------------------------------------------------
def by_pyvista(folder: Path, out: Path, field: str, span: tuple[float, float], box: Array, side: float, si: bool,
               shown: Sequence[int]) -> None:  # fmt: skip
    """Draw these frames of a body in space into ``out/<number>.png``; in a process of its own only, see ``pictures``."""
    import pyvista
    from PIL import Image

    frames = Frames(folder)
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 840))
    plotter.set_background("white")
    bounds = tuple(box.T.ravel().tolist())
    plotter.add_mesh(pyvista.Box(bounds), opacity=0.0)  # so that the camera sees the same room in all frames
    pictures.look_at(plotter, si, bounds)
    used = np.zeros((840, 1200), bool)
    for i in shown:
        snapshot = frames[i]
        body = pictures.dataset(snapshot, colouring(snapshot, field), field)
        pictures.add_body(plotter, body, field, span, side, name="body", show_scalar_bar=False, reset_camera=False)
        used |= plotter.screenshot(str(out / f"{i}.png"), return_img=True).min(axis=2) < 250
    rows, columns = (np.flatnonzero(used.any(axis=axis)) for axis in (1, 0))
    for i in shown:  # what is white in all frames is cut off
        path = out / f"{i}.png"
        with Image.open(path) as image:
            cut = image.crop((int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1))
        cut.save(path)
    (out / "done").touch()


def in_space(folder: Path, out: Path, look: Look, shown: Sequence[int]) -> dict[int, Path]:
    """PyVista's pictures by the number of the frame; none if it did not come to its end."""
    job = [look.field, look.span, look.box.tolist(), look.side, look.si, list(shown)]
    seconds = pictures.LIMIT + PATIENCE * len(shown) * (pictures.LIMIT >= 1.0)
    pictures.apart("geofem.study.film", folder, out, json.dumps(job), seconds=seconds)
    return {i: out / f"{i}.png" for i in shown} if (out / "done").exists() else {}


# --- the film ---------------------------------------------------------------------------------------------------------
def pace(count: int) -> tuple[list[int], float]:
    """Which of so many frames the film shows, and how many a second."""
    shown = np.unique(np.linspace(0, count - 1, min(count, round(SECONDS[1] * FPS[1]))).round().astype(int))
    return shown.tolist(), float(np.clip(len(shown) / SECONDS[0], *FPS))


@dataclass(frozen=True)
class Film:
    """What was made of a run: ``stills`` (PNG), and ``path`` (MP4), None where there is no ffmpeg."""

    stills: Path
    path: Path | None
    caption: str


def make(folder: Path, field: str | None = None, scene: Scene | None = None, *, asked: bool = False, si: bool = True,
         heading: str = "", progress: bool = False) -> Film | None:  # fmt: skip
    """Write ``film.mp4`` and ``pictures/stills.png`` of the run in ``folder``; None if it left fewer than two frames.

    field : one of ``fields.FIELDS``, by default what tells most. scene : what was run, if it is known. si : units are written.
    asked : True if the user asked for the film: what is missing then raises ``Mistake``, and is passed over otherwise.
    heading : words in the upper right corner. progress : a line on stderr.
    """
    try:
        if field is not None and field not in FIELDS:
            raise unknown("field", field, FIELDS)
        frames = Frames(folder, scene is not None and scene.strain == "small")
        if len(frames) < 2:
            raise Mistake(f"{folder}: holds no frames to make a film of; run again with --frames 50")
        if frames.times != 1.0:
            heading = f"{heading} · {pictures.enlarged(frames.times)}".removeprefix(" · ")
        there = available(frames[len(frames) - 1])
        if field is not None and field not in there:
            raise Mistake(f"{folder}: its frames do not hold {field!r}; choose from {', '.join(there)}")
        return made_of(frames, folder, field or choose(frames[len(frames) - 1], scene), scene, asked, si, heading, progress)
    except Mistake as mistake:
        if asked:
            raise
        if (folder / "fields.pvd").exists():
            log.warning("no film: %s", mistake)
        return None


def made_of(frames: Frames, folder: Path, field: str, scene: Scene | None, asked: bool, si: bool, heading: str,
            progress: bool) -> Film:  # fmt: skip
    """``make`` with at least two frames."""
    shown, fps = pace(len(frames))
    look = survey(frames, shown, field, scene, si)
    words = dict(zip(shown, stamps(frames.t[shown], look.clock)))
    some = [shown[k] for k in np.unique(np.linspace(0, len(shown) - 1, STILLS).round().astype(int))]
    caption = title(FIELDS[field].title, si)
    with tempfile.TemporaryDirectory() as rendered:
        images = in_space(folder, Path(rendered), look, shown) if look.solid else {}
        if images:
            height, width = imread(images[shown[0]]).shape[:2]
            look = replace(look, shape=width / height)
        stills = sheet(
            frames, look, dict(zip(some, stamps(frames.t[some], look.clock))), images, folder / "pictures" / "stills.png"
        )
        bar = tqdm(pages(frames, look, words, images, heading), total=len(shown), file=sys.stderr, desc="film", leave=False,
                   mininterval=0.5, bar_format="{desc} {percentage:3.0f}% |{bar:30}| t left {remaining}",
                   disable=not progress)  # fmt: skip
        try:
            path: Path | None = encode(bar, fps, folder / "film.mp4")
        except Mistake as mistake:
            if asked:
                raise
            log.warning("%s", mistake)
            path = None
    return Film(stills, path, caption)


if __name__ == "__main__":
    field_, span_, box_, *rest = json.loads(sys.argv[3])
    by_pyvista(Path(sys.argv[1]), Path(sys.argv[2]), field_, tuple(span_), np.array(box_), *rest)
