"""The report: one HTML file without links to anything outside it, with the scenes' texts, charts, pictures and tables."""

from __future__ import annotations

import base64
import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from geofem import scenes
from geofem.mistake import Mistake
from geofem.result import Result, replace_text
from geofem.scene import Scene
from geofem.study import chart, film, pictures, rows
from geofem.study.rows import Row

CHOICES_HEAD = ("method", "after the step the mesh is", "state lives", "approximation space", "dies by")
CHOICES = {
    "fem": ("UL/TL-FEM", "carried with the material", "quadrature points", "Lagrange", "tangling"),
    "ale": ("ALE", "relocated by a mesh-motion model", "quadrature points, remapped", "Lagrange",
            "late tangling, remap diffusion, GCL error"),
    "cle": ("CLE (CEL)", "put back where it was", "cells and volume fraction, remapped", "Lagrange", "smeared interface"),
    "pfem": ("PFEM", "re-triangulated on the carried nodes", "nodes, or points transferred", "Lagrange",
             "volume made by the boundary search, slivers"),
    "mpm": ("MPM", "put back where it was", "material points", "grid functions × point domain",
            "cell crossing, fracture, null space"),
    "xfem": ("XFEM", "fixed", "quadrature points of the cut parts", "Lagrange + Heaviside + tip modes",
             "conditioning of small cuts"),
    "efg": ("EFG", "none: background cells", "quadrature points", "moving least squares", "cost, boundary conditions"),
    "sph": ("SPH", "none", "particles", "kernel sums", "noise, tensile instability"),
    "dem": ("DEM", "none", "grains and contacts", "none (no continuum)", "parameters that are not material constants"),
}  # fmt: skip
"""The four choices in which the methods differ, by the first word of a method's name."""

MAP_CAPTION = (
    "Each field is a run; the bar is the boundary found by bisection. Hatched fields are runs that broke down, with the cause."
)
EMBEDDED = 8_000_000
"""Bytes of a film at most that stands in the page itself; a larger one is a link to the file beside the page."""
PICTURES = 6
"""Pictures per problem at most, one for each variant."""


@dataclass
class Section:
    """One problem, as the page shows it."""

    title: str
    text: list[tuple[str, Markup]] = field(default_factory=list)
    references: list[tuple[str, str, str, str]] = field(default_factory=list)
    charts: list[dict[str, str]] = field(default_factory=list)
    pictures: list[dict[str, str]] = field(default_factory=list)
    films: list[dict[str, str]] = field(default_factory=list)
    table: list[tuple[bool, tuple[str, ...]]] = field(default_factory=list)

    @property
    def id(self) -> str:
        return slug(self.title)


def slug(words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")


def scene_text(name: str) -> str:
    """The page of a scene; empty for a scene of the user's own."""
    return scenes.describe(name) if name in scenes.names() else ""


def scene_of(row: Row) -> Scene | None:
    """The scene that was solved, with the knobs it was made with; None for one of the user's own, which is not run to look."""
    if row["scene"] not in scenes.names():
        return None
    build = scenes.get(row["scene"])
    known = inspect.signature(build).parameters
    return build(**{name: value for name, value in (row.get("scene_knobs") or row.get("knobs") or {}).items() if name in known})


def has_units(row: Row) -> bool:
    """False for a dimensionless scene; a scene of the user's own is taken to be in SI."""
    scene = scene_of(row)
    return scene is None or not scene.dimensionless


def is_small(row: Row) -> bool:
    """Whether the scene counts on small strain; False for a scene of the user's own."""
    scene = scene_of(row)
    return scene is not None and scene.strain == "small"


def paragraphs(text: str) -> list[tuple[str, Markup]]:
    """A docstring as blocks: ``p`` for prose, with its leading word bold and names in code type; ``pre`` for lists."""
    blocks = []
    for block in filter(None, re.split(r"\n\s*\n", text.strip())):
        if re.search(r"^(\s+\S|\S+ : )", block, re.MULTILINE):
            blocks.append(("pre", escape(block.replace("`", ""))))
            continue
        words = str(escape(" ".join(block.split())))
        words = re.sub(r"`+([^`]+)`+", r"<code>\1</code>", words)
        words = re.sub(r"^(\w[\w-]*(?: \w+){0,2}\.) (?=\S)", r"<b>\1</b> ", words)
        blocks.append(("p", Markup(words)))
    return blocks


def caption(group: Sequence[Row], measure: str) -> str:
    """What a chart rests on: reference, repeats, machine, versions."""
    reference = chart.reference_of(group, measure)
    words = []
    if reference:
        value = rows.reference_text(reference)
        words.append(f"Reference{' ' + value if value else ''} ({reference.get('kind')}): {reference.get('source')}.")
        if reference.get("kind") not in chart.ORDERED:
            words.append("No order of convergence is claimed against such a reference.")
    repeats = sorted({row["repeats"] for row in group if row.get("repeats")})
    words.append(f"CPU time: process seconds, least of {' or '.join(map(str, repeats)) or 'one'} repeats, JIT excluded.")
    machines = rows.machines(group)
    if machines:
        words.append(f"Machine: {'; '.join(machines)}.")
    if len(machines) > 1:
        words.append("Costs from different machines do not compare.")
    words.append(f"Versions: {versions(group)}." if versions(group) else "")
    refused = {f"{rows.label(row)} refuses: {row['message']}" for row in group if row["status"] == "refused"}
    words += [f"{line.rstrip('.')}." for line in sorted(refused)]
    return " ".join(word for word in words if word)


def versions(group: Iterable[Row]) -> str:
    found = {f"{name} {version}" for row in group for name, version in (row.get("versions") or {}).items()}
    return ", ".join(sorted(found))


def finest(group: Sequence[Row]) -> list[Row]:
    """Of each variant the finest run that finished, or else the finest that failed and left a snapshot."""
    chosen = []
    for line in rows.by_label(group).values():
        kept = [row for row in line if row.get("run") and row["status"] != "refused"]
        finished = [row for row in kept if row["status"] == "ok"]
        chosen += (finished or kept)[-1:]
    return chosen[:PICTURES]


def drawn(folder: Path, row: Row) -> list[dict[str, str]]:
    """The pictures of one run as the page takes them; none if the run left no body to draw."""
    run = folder / row["run"]
    if not (run / "result.npz").exists():
        return []
    outcome = "" if row["status"] == "ok" else f" ({row['status']}: {rows.why(row)})"
    made = []
    for shown in pictures.fields(Result.load(run).snapshot):
        name = slug(f"{rows.problem(row)} {rows.label(row)} {shown}")
        path = pictures.draw(run, folder / "pictures" / f"{name}.png", shown, has_units(row), is_small(row))
        words = f"{rows.label(row)}, {rows.step(row)}{outcome}: {pictures.title(pictures.TITLES[shown], has_units(row))}"
        made.append({"png": base64.b64encode(path.read_bytes()).decode(), "caption": words})
    return made


def filmed(folder: Path, row: Row, shown: str | None, asked: bool, progress: bool) -> list[dict[str, str]]:
    """The film and the stills of a single run as the page takes them; none if it left no frames."""
    heading = f"{row['scene']} · {rows.label(row)}"
    made = film.make(folder, shown, scene_of(row), asked=asked, si=has_units(row), heading=heading, progress=progress)
    if made is None:
        return []
    source = size = ""
    if made.path is not None:
        raw = made.path.read_bytes()
        source = made.path.name
        if len(raw) <= EMBEDDED:
            source = f"data:video/mp4;base64,{base64.b64encode(raw).decode()}"
        size = f"{len(raw) / 1e6:.1f} MB"
    outcome = "" if row["status"] == "ok" else f" The run {row['status']}: {rows.why(row)}."
    stills = base64.b64encode(made.stills.read_bytes()).decode()
    words = f"{rows.label(row)}, {rows.step(row)}: {made.caption}."
    return [{"mp4": source, "size": size, "png": stills, "caption": words + outcome}]


def section(folder: Path, title: str, group: Sequence[Row], look: Mapping[str, Any], text: str) -> Section:
    made = Section(title, paragraphs(text))
    for measure in rows.measures(group):
        reference = chart.reference_of(group, measure)
        if reference:
            made.references.append((measure, rows.reference_text(reference), reference["kind"], reference["source"]))
        if len(group) > 1:
            path = chart.save(chart.work_precision(group, measure, look), folder / "charts" / slug(f"{title} {measure}"))
            made.charts.append({"svg": chart.inline(path), "caption": caption(group, measure)})
    made.pictures = [picture for row in finest(group) for picture in drawn(folder, row)]
    made.table = [(row["status"] != "ok", rows.cells(row)) for line in rows.by_label(group).values() for row in line]
    return made


def write(folder: Path, *, shown: str | None = None, film: bool | None = None, progress: bool = False) -> Path:
    """Write ``report.html`` for a study, or for a single run with its history and, if it left frames, its film; return its path.

    shown : the field that colours the film, by default what tells most. film : False: none is made; True: it must be, and what is
    missing for it raises ``Mistake``. progress : a line on stderr while the film is made.

    Maps that ``geofem stability`` left in the folder are shown as well. Beside the page ``charts`` (SVG and PNG) and
    ``pictures`` (PNG) hold the drawings as files of their own.
    Raises ``Mistake`` if the folder holds no results.
    """
    found = rows.read(folder)
    look = chart.styles(rows.label(row) for row in found)
    told: set[str] = set()
    sections = []
    for title, group in rows.by_problem(found).items():
        scene = group[0]["scene"]
        sections.append(section(folder, title, group, look, "" if scene in told else scene_text(scene)))
        told.add(scene)
    if (folder / "result.json").exists() and (history := Result.load(folder).history).keys() - {"t"}:
        path = chart.save(chart.history(history), folder / "charts" / "history")
        words = "What the run sampled, against t: time (s) or load factor."
        sections[0].charts.append({"svg": chart.inline(path), "caption": words})
    if (folder / rows.RESULTS).exists() and film:
        raise Mistake(f"{folder}: is a study; a film is made of a single run, 'geofem run ... --out DIR --frames 50'")
    if not (folder / rows.RESULTS).exists() and film is not False:
        sections[0].films = filmed(folder, found[0], shown, bool(film), progress)
    if maps := sorted((folder / "maps").glob("*.svg")):
        drawings = [{"svg": chart.inline(path), "caption": MAP_CAPTION} for path in maps]
        sections.append(Section("Where methods fail", charts=drawings))
    provenance = [f"{len(found)} runs of {len({rows.label(row) for row in found})} variants"] if len(found) > 1 else []
    page = jinja2.Environment(
        loader=jinja2.PackageLoader("geofem.study"), autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    text = page.get_template("report.html").render(
        title="Error against cost" if len(found) > 1 else f"{found[0]['scene']} by {rows.label(found[0])}",
        provenance=" · ".join(provenance + rows.machines(found) + ([versions(found)] if versions(found) else [])),
        sections=sections,
        here={row["method"].partition("-")[0] for row in found},
        choices_head=CHOICES_HEAD,
        choices=CHOICES.items(),
        columns=rows.COLUMNS,
        numbers=(2, 3, 5),
    )
    replace_text(folder / "report.html", text)
    return folder / "report.html"
