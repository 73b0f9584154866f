"""The report is one file that needs no network, and pictures come out whether or not PyVista can draw."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_study import fail, ladder

from geofem.mistake import Mistake
from geofem.result import Result
from geofem.study import paint, pictures, report, rows

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync",
         "--disable-component-update", "--no-first-run", "--hide-scrollbars", "--enable-logging=stderr")  # fmt: skip


def plane(cell: str = "quad") -> dict[str, Any]:
    """A square of 3 x 3 cells, stretched and sheared."""
    i, j = np.meshgrid(np.arange(4.0), np.arange(4.0))
    X = np.stack([i.ravel(), j.ravel()], axis=1)
    u = np.stack([0.1 * X[:, 1] ** 2, 0.2 * X[:, 0]], axis=1)
    corner = np.arange(16).reshape(4, 4)[:3, :3].ravel()[:, None]
    cells = {
        "quad": corner + [0, 1, 5, 4],
        "triangle": np.vstack([corner + [0, 1, 5], corner + [0, 5, 4]]),
        "vertex": np.arange(16)[:, None],
    }[cell]
    points = np.column_stack([X + u, np.zeros(len(X))])
    stress = np.arange(4.0 * len(cells)).reshape(-1, 4)
    return {"points": points, "cells": cells, "cell": cell, "displacement": u, "stress": stress}


def solid() -> dict[str, Any]:
    """One hexahedron, stretched."""
    X = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
    return {"points": 1.5 * X, "cells": np.arange(8)[None], "cell": "hexahedron", "displacement": 0.5 * X}


def saved(folder: Path, snapshot: dict[str, Any], **more: Any) -> Path:
    Result("cook", "fem", knobs={"n": 3}, error={"uy": 0.1}, qoi={"uy": 21.0}, snapshot=snapshot, **more).save(folder)
    return folder


def is_picture(path: Path) -> bool:
    """A PNG file of more than one colour."""
    from matplotlib.image import imread

    return path.read_bytes().startswith(b"\x89PNG") and float(np.ptp(imread(path)[..., :3])) > 0.1


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of two variants with a failure, a refusal and a snapshot, and its report."""
    folder = tmp_path_factory.mktemp("study")
    line, other = ladder("FEM P1", 1, 1), ladder("MPM linear", 0.5, 1, method="mpm-linear")
    other[-1] = fail(other[-1], cause="fracture", message="the body <came> apart")
    other.append(fail(ladder("CLE", 1, 1, (2,), method="cle")[0], status="refused", message="cle has no free surface"))
    saved(folder / "runs/0", plane("triangle"))
    for row in line + other:
        rows.append(folder, row | {"versions": {"dolfinx": "0.11.0"}})
    report.write(folder)
    return folder


class Links(HTMLParser):
    """What a page would fetch, and the pieces of it that matter here."""

    def __init__(self, text: str):
        super().__init__()
        self.outside: list[str] = []
        self.ids: list[str] = []
        self.wanted: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attributes:
            value = value or ""
            if name in ("src", "href", "xlink:href", "data", "action", "srcset", "poster"):
                if value.startswith("#"):
                    self.wanted.append(value[1:])
                elif not value.startswith("data:"):
                    self.outside.append(value)
            if name == "id":
                self.ids.append(value)


def test_report_is_one_file_that_needs_no_network(study: Path) -> None:
    text = (study / "report.html").read_text()
    page = Links(text)
    assert page.outside == [] and "script" not in page.tags
    assert not re.search(r"@import|url\((?!#)", text)
    assert set(page.wanted) <= set(page.ids)  # every marker, clip path and heading that is pointed at is there
    assert page.tags.count("svg") == 1 and page.tags.count("img") >= 2


def test_report_says_what_its_figures_rest_on(study: Path) -> None:
    text = (study / "report.html").read_text()
    for words in ("made up", "overkill", "least of 3 repeats", "JIT excluded", "a machine", "dolfinx 0.11.0", "failed: fracture",
                  "CLE refuses: cle has no free surface", "Cook&#39;s membrane", "null space"):  # fmt: skip
        assert words in text, words
    assert "<came>" not in text  # what a run says is text, not markup


def test_charts_lie_beside_the_report_as_files(study: Path) -> None:
    assert is_picture(study / "charts" / "cook-variant-a-uy.png") and (study / "charts" / "cook-variant-a-uy.svg").exists()


def test_report_of_a_single_run_shows_its_history(tmp_path: Path) -> None:
    t = np.linspace(0, 1, 5)
    saved(tmp_path, plane("vertex"), history={"t": t, "tip": t**2})
    page = Links(report.write(tmp_path).read_text())
    assert page.tags.count("svg") == 1 and page.tags.count("img") == 2 and page.outside == []


def test_folder_without_results_is_the_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(Mistake, match="no readable result"):
        report.write(tmp_path)


def test_two_charts_on_a_page_share_no_id(tmp_path: Path) -> None:
    for variant in "AD":
        for row in ladder("FEM P1", 1, 1, scene_knobs={"variant": variant}):
            rows.append(tmp_path, row | {"knobs": row["knobs"] | {"variant": variant}})
    page = Links(report.write(tmp_path).read_text())
    assert page.tags.count("svg") == 2 and len(set(page.ids)) == len(page.ids)


@pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome on PATH")
def test_report_opens_in_a_browser_without_a_complaint(study: Path, tmp_path: Path) -> None:
    shot = tmp_path / "shot.png"
    command = [str(BROWSER), *FLAGS, f"--user-data-dir={tmp_path}", "--window-size=1280,900", f"--screenshot={shot}"]
    done = subprocess.run(
        [*command, (study / "report.html").as_uri()], capture_output=True, text=True, timeout=120, check=False
    )
    assert "CONSOLE" not in done.stderr, done.stderr
    assert is_picture(shot)


# --- pictures ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("cell", ["quad", "triangle", "vertex"])
def test_bodies_in_the_plane_are_drawn(cell: str, tmp_path: Path) -> None:
    folder = saved(tmp_path, plane(cell))
    for field in ("displacement", "mean_stress"):
        assert is_picture(pictures.draw(folder, tmp_path / f"{field}.png", field))


def test_solid_is_drawn_by_matplotlib_where_pyvista_cannot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "LIMIT", 1e-3)  # no process starts that fast
    folder = saved(tmp_path, solid())
    assert not pictures.by_pyvista_apart(folder, tmp_path / "no.png", "displacement")
    assert is_picture(pictures.draw(folder, tmp_path / "yes.png"))


def test_solid_is_drawn_by_pyvista(tmp_path: Path) -> None:
    if not pictures.by_pyvista_apart(saved(tmp_path, solid()), tmp_path / "solid.png", "displacement"):
        pytest.skip("PyVista cannot draw here: no EGL")
    assert is_picture(tmp_path / "solid.png")


def test_outer_faces_are_those_of_one_cell_only() -> None:
    # two hexahedra side by side have 12 faces, of which they share one: 10 are outside
    cells = np.array([[0, 1, 2, 3, 4, 5, 6, 7], [1, 8, 9, 2, 5, 10, 11, 6]])
    faces, owner = pictures.outer_faces(cells, "hexahedron")
    assert len(faces) == 10 and sorted(owner.tolist()) == [0] * 5 + [1] * 5


def test_colours_are_the_length_of_the_displacement_and_a_third_of_the_trace() -> None:
    snapshot = {"displacement": np.array([[3.0, 4.0]]), "stress": np.array([[-3.0, -6.0, 0.0, 9.0]])}
    assert pictures.colouring(snapshot, "displacement") == [5.0]
    assert pictures.colouring(snapshot, "mean_stress") == [-3.0]


def test_pictures_of_a_dimensionless_scene_bear_no_unit() -> None:
    assert pictures.title("mean stress (Pa)", True) == "mean stress (Pa)"
    assert pictures.title("mean stress (Pa)", False) == "mean stress"
    assert [report.has_units({"scene": name}) for name in ("cook", "cantilever", "column", "mine.py:scene")] == [
        False,
        False,
        True,
        True,
    ]


@pytest.mark.parametrize("size", [1e-4, 0.3, 70.0])
def test_small_strain_is_drawn_as_large_as_shows_it(size):
    """A square whose right half moves by ``size``: drawn about a twelfth of its side, by a factor of one digit."""
    still = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    u = np.array([[0.0, 0.0], [size, 0.0], [size, 0.0], [0.0, 0.0]])
    moved = still + np.pad(u, ((0, 0), (0, 1)))
    snapshot = {"points": moved, "cells": np.array([[0, 1, 2, 3]]), "cell": "quad", "displacement": u}
    times = paint.magnification(snapshot)
    drawn = paint.magnified(snapshot, times)
    assert f"{times:.0e}"[0] in "125" and times == pytest.approx(float(f"{times:.0e}"))
    assert 1 / 30 < np.ptp(drawn["points"][:, 0]) - 1.0 <= 1 / 12
    assert drawn["displacement"] is u and snapshot["points"] is moved and paint.magnified(snapshot, 1.0) is snapshot
