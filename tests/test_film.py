"""A run's frames become a film that browsers play and a sheet of stills; what they show is the same in all frames."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import meshio
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from test_report import Links, is_picture, plane, solid

import geofem
from geofem import __main__ as cli
from geofem.mistake import Mistake
from geofem.result import Result, replace_text, write_npz
from geofem.study import fields, film, paint, pictures, report, video
from geofem.study.film import Look
from geofem.study.frames import Frames

NAN = [[np.nan, np.nan]]
FLOOR = [[-9.0, -1.0], [9.0, -1.0], [9.0, 0.0], [-9.0, 0.0]]


def heap(t: float, n: int = 6, **keys: Any) -> dict[str, Any]:
    """A square metre of n x n material points of two bodies that is pulled to (1 + t) by 1 / (1 + t)."""
    X = (np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) + 0.5) / n
    x = X * [1 + t, 1 / (1 + t)]
    stress = -1e5 * np.stack([X[:, 1], 1 - X[:, 1], X[:, 1], t * X[:, 0]], axis=1)
    edges = np.tile([(1 + t) / 2 / n, 0, 0, 1 / (1 + t) / 2 / n], (n * n, 1))
    return {
        "points": np.column_stack([x, np.zeros(n * n)]),
        "cells": np.arange(n * n)[:, None],
        "cell": "vertex",
        "displacement": x - X,
        "velocity": X * [1.0, -1.0] * t,
        "stress": stress,
        "edges": edges,
        "region": (X[:, 0] > 0.5).astype(int),
        "rigid": np.array(FLOOR + NAN + [[2.0, 0.1 + t], [2.2, 0.1 + t], [2.2, 1.0 + t]]),
    } | keys


def written(folder: Path, snapshots: Iterable[tuple[float, dict[str, Any]]]) -> Path:
    """The folder of a run with these frames, as ``geofem.core.io.Series`` leaves it; that module needs dolfinx."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = ""
    for i, (t, snapshot) in enumerate(snapshots):
        path = folder / f"fields_{i:05d}.vtu"
        rows += f'<DataSet timestep="{t}" file="{path.name}"/>'
        arrays = {k: np.asarray(v) for k, v in snapshot.items() if k not in ("points", "cells", "cell", "rigid")}
        here = {k: v for k, v in arrays.items() if len(v) == len(snapshot["points"])}
        there = {k: [v] for k, v in arrays.items() if k not in here}
        meshio.Mesh(snapshot["points"], [(snapshot["cell"], snapshot["cells"])], here, there).write(path)
        if "rigid" in snapshot:
            write_npz(path.with_suffix(".npz"), {"rigid": snapshot["rigid"]})
    replace_text(folder / "fields.pvd", f"<VTKFile><Collection>{rows}</Collection></VTKFile>")
    Result("beam_drop", "mpm-gimp", knobs={"n": 3}, snapshot=snapshot, history={"t": np.arange(3.0), "tip": np.ones(3)}).save(
        folder
    )
    return folder


@pytest.fixture(scope="module")
def flow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of twelve frames, with its report."""
    folder = written(tmp_path_factory.mktemp("flow"), ((t, heap(t)) for t in np.linspace(0, 1.1, 12)))
    assert cli.main(["view", str(folder), "--field", "von_mises"]) == 0
    return folder


def decoded(path: Path) -> tuple[dict[str, Any], np.ndarray]:
    """What ffmpeg says of a film, and its frames (n, height, width, 3)."""
    reader = imageio_ffmpeg.read_frames(path)
    about = next(reader)
    width, height = about["size"]
    return about, np.stack([np.frombuffer(image, np.uint8).reshape(height, width, 3) for image in reader])


# --- the film ---------------------------------------------------------------------------------------------------------
def test_film_is_one_that_browsers_play(flow: Path) -> None:
    about, images = decoded(flow / "film.mp4")
    assert about["codec"] == "h264" and about["pix_fmt"].startswith("yuv420p")
    assert all(length % 2 == 0 for length in about["size"])
    held = round(video.PAUSE * film.FPS[0])
    assert len(images) == 12 + held  # 12 frames at the slowest pace, and the last one stands
    changes = np.abs(np.diff(images.astype(int), axis=0)).max(axis=(1, 2, 3))
    assert np.all(changes[:11] > 50)
    raw = (flow / "film.mp4").read_bytes()
    assert raw.index(b"moov") < raw.index(b"mdat")  # plays before it is loaded whole
    assert not list(flow.glob("*.part*"))


def test_axes_and_colour_bar_stand_still(flow: Path) -> None:
    frames = Frames(flow)
    look = film.survey(frames, range(12), "von_mises", None, True)
    images = np.stack(list(film.pages(frames, look, {0: "a", 6: "b", 11: "c"}, {}, "")))
    for part in (images[:, :, -150:], images[:, -60:]):  # colour bar at the right, labels below
        assert np.all(part == part[0]) and np.ptp(part[0]) > 100


def test_report_holds_the_film_and_the_stills(flow: Path) -> None:
    text = (flow / "report.html").read_text()
    page = Links(text)
    assert page.outside == [] and page.tags.count("video") == 1 and "data:video/mp4;base64," in text
    assert "von Mises stress" in text and is_picture(flow / "pictures" / "stills.png")


def test_a_large_film_is_a_link(flow: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = film.Film(flow / "pictures" / "stills.png", flow / "film.mp4", "speed")
    monkeypatch.setattr(film, "make", lambda *_, **__: made)
    row = Result.load(flow).row
    assert report.filmed(flow, row, None, False, False)[0]["mp4"].startswith("data:video/mp4")
    monkeypatch.setattr(report, "EMBEDDED", 100)
    assert report.filmed(flow, row, None, False, False)[0]["mp4"] == "film.mp4"


def test_without_ffmpeg_there_are_stills_and_a_mistake_only_if_asked(
    flow: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    folder = written(tmp_path, ((t, heap(t)) for t in (0.0, 0.5)))
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "no-ffmpeg"))
    made = film.make(folder)
    assert made is not None and made.path is None and is_picture(made.stills) and "no-ffmpeg" in caplog.text
    with pytest.raises(Mistake, match="no-ffmpeg"):
        film.make(folder, asked=True)


def test_what_ffmpeg_complains_of_is_told(tmp_path: Path) -> None:
    with pytest.raises(Mistake, match="film: ffmpeg ended with"):
        video.encode([np.zeros((0, 20, 3), np.uint8)] * 3, 4.0, tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("count, shown, fps", [(2, 2, 4.0), (60, 60, 10.0), (150, 150, 20.0), (1001, 200, 20.0)])
def test_a_film_takes_six_to_ten_seconds_where_there_are_frames_for_it(count: int, shown: int, fps: float) -> None:
    which, pace = film.pace(count)
    assert (len(which), pace) == (shown, fps) and which[0] == 0 and which[-1] == count - 1


# --- asking for it ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "words, says",
    [
        (["--film"], "--frames"),
        (["--field", "speed"], "--frames"),
        (["--field", "sped"], "did you mean 'speed'"),
        (["--field", "speed", "--no-film"], "--no-film"),
    ],
)
def test_a_film_that_cannot_be_is_the_users_mistake_only_if_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], says: str
) -> None:
    Result("cook", "fem", snapshot=plane()).save(tmp_path)
    assert cli.main(["view", str(tmp_path), *words]) == 2
    told = capsys.readouterr()
    assert told.err.count("\n") == 1 and says in told.err and not told.out


def test_view_goes_on_without_frames_and_without_a_word(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    Result("cook", "fem", snapshot=plane()).save(tmp_path)
    assert "video" not in Links(report.write(tmp_path).read_text()).tags and not caplog.records


def test_damaged_frames_are_named(flow: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(flow, tmp_path / "copy")
    (folder / "fields_00003.vtu").write_text("not xml")
    with pytest.raises(Mistake, match="fields_00003.vtu"):
        film.make(folder, asked=True)
    assert film.make(folder) is None
    (folder / "fields.pvd").write_text("not xml")
    with pytest.raises(Mistake, match="fields.pvd"):
        film.make(folder, asked=True)


def test_field_that_the_frames_lack_is_named_with_those_they_hold(flow: Path) -> None:
    with pytest.raises(Mistake, match="plastic_strain.*von_mises"):
        film.make(flow, "plastic_strain", asked=True)


# --- what it shows ----------------------------------------------------------------------------------------------------
def test_frames_come_back_with_domains_bodies_and_rigid_ones(flow: Path) -> None:
    frames = Frames(flow)
    assert len(frames) == 12 and frames.t[-1] == pytest.approx(1.1)
    one, made = frames[5], heap(0.5)
    for name in ("edges", "region", "stress", "rigid"):
        assert np.allclose(one[name], made[name], equal_nan=True), name


def test_limits_are_those_of_all_frames_and_colours_of_magnitudes_start_at_zero(flow: Path) -> None:
    frames = Frames(flow)
    look = film.survey(frames, range(12), "displacement", None, True)
    longest = np.linalg.norm(heap(1.1)["displacement"], axis=1).max()
    assert look.span == pytest.approx((0.0, longest)) and look.extend == "neither"
    low, high = look.box
    assert np.all(low < [0.0, 0.0]) and high[0] > 2.1 and high[1] > 1.0 and high[0] < 3.0  # the floor goes on to 9
    signed = film.survey(frames, range(12), "mean_stress", None, True)
    # a third of -1e5 (1 + y), y from 1/12 to 11/12; the outermost row of six is more than 2 % of the points
    assert signed.span == pytest.approx((-1e5 * 23 / 36, -1e5 * 13 / 36)) and signed.extend == "neither"


def test_a_stray_point_does_not_shrink_the_picture() -> None:
    many = heap(0.0, n=30)
    del many["edges"]
    many["points"][7] = 100.0, 5.0, 0.0
    assert np.all(paint.bounds(many, paint.spacing(many)) < 1.1)


@pytest.mark.parametrize("keys", ["edges", "corners", "volume", None])
def test_material_points_are_drawn_as_large_as_they_are(keys: str | None) -> None:
    body = heap(0.0)
    edges = body.pop("edges")
    del body["rigid"]
    if keys == "edges":
        body["edges"] = edges
    elif keys == "corners":
        body["corners"] = (body["points"][:, None, :2] + paint.SIGNS / 12).reshape(-1, 8)
    elif keys == "volume":
        body["volume"] = np.full(36, 1 / 36)
    figure = Figure(dpi=100)
    axes = figure.add_subplot()
    pictures.set_up(axes, np.array([[0.0, 0.0], [1.0, 1.0]]), True)
    look = {"cmap": "Greys", "norm": film.Normalize(-1, 1)}
    paint.body(axes, body, np.ones(36), paint.spacing(body), look)
    image = np.asarray(film.images_of(figure, film.FigureCanvasAgg(figure)))
    box = axes.get_window_extent()
    inside = image[image.shape[0] - int(box.y1) + 4 : image.shape[0] - int(box.y0) - 4, int(box.x0) + 4 : int(box.x1) - 4]
    assert np.mean(inside.max(axis=2) < 128) > 0.9  # the body fills the unit square that it occupies


def test_stress_measures() -> None:
    shear = np.array([[0.0, 0.0, 0.0, 2.0], [3.0, 3.0, 3.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    assert fields.von_mises(shear) == pytest.approx([2.0 * np.sqrt(3.0), 0.0, 1.0])
    assert fields.von_mises(np.array([[0, 0, 0, 1.0, 1.0, 1.0]])) == pytest.approx([3.0])
    assert fields.prefixed("mean stress (Pa)", 2.5e6) == ("mean stress (MPa)", 1e6)


def test_times_are_written_with_equal_digits_and_fitting_units() -> None:
    stamps = film.stamps(np.linspace(0.0, 10.0, 21), "s")
    assert [stamps[i] for i in (0, 1, 20)] == ["t = \u20070.0 s", "t = \u20070.5 s", "t = 10.0 s"]
    assert film.stamps(np.array([0.0, 0.001]), "s")[1] == "t = 1.0 ms"
    assert film.stamps(np.array([0.0, 0.25]), "load factor")[1] == "load factor = 0.25"
    assert film.stamps(np.array([0.0, 0.5]), "")[1] == "t = 0.5"


def test_the_field_that_is_shown_fits_the_scene() -> None:
    body = heap(0.5)
    elastic, plastic = (report.scene_of({"scene": name}) for name in ("beam_drop", "footing"))
    assert film.choose(body, elastic) == "von_mises"
    assert film.choose(body, plastic) == "displacement"
    assert film.choose(body | {"plastic_strain": np.zeros(36)}, plastic) == "plastic_strain"
    assert film.choose(body, None) == "speed"
    assert film.choose({"stress": body["stress"]}, None) == "mean_stress"


def test_bodies_have_a_colour_each_and_neighbours_differ_in_grey() -> None:
    look = Look("region", (0.0, 1.0), "neither", np.array([[0.0, 0.0], [1.0, 1.0]]), 0.1)
    first, second = (look.colours["cmap"](look.colours["norm"](i))[:3] for i in (0, 1))
    assert abs(np.dot(first, [0.3, 0.59, 0.11]) - np.dot(second, [0.3, 0.59, 0.11])) > 0.25


def test_meshes_that_change_are_filmed(tmp_path: Path) -> None:
    folder = written(tmp_path, [(0.0, plane("quad")), (0.5, plane("triangle")), (1.0, heap(1.0))])
    made = film.make(folder, "displacement", asked=True)
    assert made is not None and made.path is not None and len(decoded(made.path)[1]) >= 3


def test_drops_that_left_the_mesh_are_dots_and_far_ones_do_not_shrink_the_picture(tmp_path: Path) -> None:
    """Points of no cell; the meshes before and after have other numbers of points and cells."""
    mesh = plane("triangle")
    dry = {k: v for k, v in mesh.items() if k != "stress"} | {"velocity": np.ones((16, 2))}
    wet = {
        "points": np.concatenate([mesh["points"], [[3.5, 3.0, 0.0], [3.0, 900.0, 0.0]]]),
        "cells": mesh["cells"],
        "cell": "triangle",
        "velocity": np.ones((18, 2)),
        "pressure": np.arange(18.0),
        "carried": np.append(np.zeros(16), [0.04, 0.04]),
    }
    assert list(paint.alone(wet)) == [16, 17] and not len(paint.alone(dry)) and not len(paint.alone(heap(0.0)))
    low, high = paint.bounds(wet)
    assert low[1] == 0.0 and high[1] == pytest.approx(mesh["points"][:, 1].max() + 0.25 * np.ptp(mesh["points"], axis=0).max())
    drawn = paint.body(Figure().add_subplot(), wet, wet["pressure"], 0.0, {})
    assert sum(isinstance(part, EllipseCollection) for part in drawn) == 1
    assert film.make(written(tmp_path, [(0.0, dry), (1.0, wet)]), "speed", asked=True) is not None


def test_a_body_in_space_is_filmed_by_matplotlib_where_pyvista_cannot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "LIMIT", 1e-3)  # no process starts that fast
    one = solid()
    folder = written(tmp_path, [(t, one | {"points": one["points"] * (1 + t)}) for t in (0.0, 0.5)])
    made = film.make(folder, asked=True)
    assert made is not None and made.path is not None and is_picture(made.stills)


def test_a_body_in_space_is_filmed_by_pyvista(tmp_path: Path) -> None:
    one = solid()
    folder = written(tmp_path / "run", [(t, one | {"points": one["points"] * (1 + t)}) for t in (0.0, 0.5)])
    look = film.survey(Frames(folder), [0, 1], "displacement", None, True)
    images = film.in_space(folder, tmp_path, look, [0, 1])
    if not images:
        pytest.skip("PyVista cannot draw here: no EGL")
    assert all(is_picture(path) for path in images.values())


# --- from a run -------------------------------------------------------------------------------------------------------
def test_a_run_is_filmed(tmp_path: Path) -> None:
    result = geofem.run("axial", "mpm-linear", n=4, frames=6, out=tmp_path)
    assert result.status == "ok"
    made = film.make(tmp_path, "speed", report.scene_of(result.row), asked=True)
    assert made is not None and made.path is not None and is_picture(made.stills)
    assert len(decoded(made.path)[1]) >= 6
