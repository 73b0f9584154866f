"""Files of a run: pictures that another program opens, checkpoints on any number of ranks, and what damaged files say."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from geofem.core import io
from geofem.mistake import Mistake
from geofem.result import write_npz

SQUARES = {
    "points": np.array([[x, y, 0.0] for y in (0, 1) for x in (0, 1, 2)]),
    "cells": np.array([[0, 1, 4, 3], [1, 2, 5, 4]]),
    "cell": "quad",
    "displacement": np.arange(12.0).reshape(6, 2),
    "stress": np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]]),
}
GRAINS = {
    "points": np.eye(3),
    "cells": np.arange(3)[:, None],
    "cell": "vertex",
    "displacement": np.ones((3, 2)),
    "density": np.array([7.0, 8.0, 9.0]),
}
READ = """
import json, sys, pyvista
reader = pyvista.get_reader(sys.argv[1])
out = []
for t in reader.time_values:
    reader.set_active_time_value(t)
    mesh = reader.read()[0]
    out.append([t, mesh.n_points, mesh.n_cells, mesh.point_data["displacement"].tolist(),
                {k: mesh.cell_data[k].tolist() for k in mesh.cell_data}, sorted(mesh.point_data), int(mesh.celltypes[0])])
print(json.dumps(out))
assert "dolfinx" not in sys.modules
"""


WRITE_FIELDS = """
import sys
from pathlib import Path
import geofem.core.io as io, numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
square = mesh.create_unit_square(MPI.COMM_WORLD, 4, 3, ghost_mode=mesh.GhostMode.none)
space = fem.functionspace(square, ("Lagrange", 2, (2,)))
u, v = (fem.Function(space, name=name) for name in ("displacement", "velocity"))
x, X = square.geometry.x, square.geometry.x.copy()
moving = sys.argv[2] == "moving"
file = io.FieldFile(Path(sys.argv[1]), [u, v], resumed=0.25 if sys.argv[2] == "resumed" else None)
for t in (0.0, 0.1 + 0.2, 1.0):
    # on the resting mesh u = t (x^2, x y); a moving one stands at x (1 + t), and u is that of its reference position
    stretch = 1 + t if moving else 1.0
    x[:] = stretch * X
    u.interpolate(lambda y: t * np.stack([y[0] ** 2, y[0] * y[1]]) / stretch**2)
    v.interpolate(lambda y: np.stack([y[1] + t, y[0] - t]))
    file.write(t)
if sys.argv[2] == "killed":
    import os; os._exit(0)
file.close()
"""
READ_FIELDS = """
import json, sys, adios2
out = []
with adios2.FileReader(sys.argv[1]) as file:
    blocks = range(int(file.available_variables()["NumberOfNodes"]["Shape"]))  # one a rank
    names = "geometry", "connectivity", "displacement", "velocity"
    for i in range(file.num_steps()):
        fields = {n: [file.read(n, block_id=b, step_selection=[i, 1]).tolist() for b in blocks] for n in names}
        out.append({"t": float(file.read("step", step_selection=[i, 1])[0]), **fields})
    schema = file.read_attribute("vtk.xml")
print(json.dumps([schema, out]))
assert "dolfinx" not in sys.modules
"""


def run_python(code: str, *words: str | Path) -> str:
    """What a piece of Python prints, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def read_back(path: Path) -> list:
    """What VTK sees in a series, in a process of its own."""
    return json.loads(run_python(READ, path))


def test_a_series_is_read_by_vtk_though_the_mesh_changes_to_particles(tmp_path: Path) -> None:
    series = io.Series(tmp_path / "fields.pvd")
    series.write(0.0, SQUARES)
    series.write(0.1 + 0.2, GRAINS)
    series.write(0.5, {})  # what other ranks than 0 have
    squares, grains = read_back(tmp_path / "fields.pvd")
    assert squares[:3] == [0.0, 6, 2] and squares[5] == ["displacement"] and squares[6] == 9
    assert squares[3][5] == [10.0, 11.0, 0.0]
    assert squares[4] == {"stress": SQUARES["stress"].tolist()}
    assert grains[:3] == [0.1 + 0.2, 3, 3] and grains[5] == ["density", "displacement"] and grains[6] == 1


@pytest.mark.parametrize(("kind", "number"), [("triangle6", 22), ("quad9", 28)])
def test_curved_cells_keep_their_middle_nodes(tmp_path: Path, kind: str, number: int) -> None:
    count = int(kind[-1])
    angle = np.linspace(0, 1, count)
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    io.Series(tmp_path / "one").write(
        0.0, {"points": points, "cells": np.arange(count)[None], "cell": kind, "displacement": points[:, :2]}
    )
    ((_, n_points, n_cells, u, _, _, shape),) = read_back(tmp_path / "one.pvd")
    assert (n_points, n_cells, shape) == (count, 1, number)
    assert np.array_equal(np.array(u), points)


def test_a_resumed_series_keeps_the_pictures_up_to_the_checkpoint(tmp_path: Path) -> None:
    first = io.Series(tmp_path / "fields.pvd")
    for t in (0.0, 0.25, 0.5):
        first.write(t, SQUARES)
    second = io.Series(tmp_path / "fields.pvd", resumed=0.25)
    second.write(0.4, GRAINS)
    assert [(t, file) for t, file in second.entries] == [
        (0.0, "fields_00000.vtu"), (0.25, "fields_00001.vtu"), (0.4, "fields_00002.vtu"),
    ]  # fmt: skip
    assert [row[0] for row in read_back(tmp_path / "fields.pvd")] == [0.0, 0.25, 0.4]


def test_domains_of_points_are_kept_by_the_points_and_rigid_bodies_beside_them(tmp_path: Path) -> None:
    more = {"edges": np.arange(12.0).reshape(3, 4), "corners": np.arange(24.0).reshape(3, 8), "region": np.array([0, 0, 1])}
    rigid = np.array([[0.0, 0.0], [1.0, 0.0], [np.nan, np.nan], [2.0, 2.0]])
    series = io.Series(tmp_path / "fields.pvd")
    series.write(0.0, GRAINS | more | {"rigid": rigid})
    series.write(0.5, GRAINS | more | {"rigid": rigid[:3], "name": "three rows of rigid are no field of three points"})
    ((*_, first, _), (*_, second, _)) = read_back(tmp_path / "fields.pvd")
    assert first == second == ["corners", "density", "displacement", "edges", "region"]
    assert np.array_equal(np.load(tmp_path / "fields_00000.npz")["rigid"], rigid, equal_nan=True)
    io.Series(tmp_path / "fields.pvd").write(0.0, GRAINS)
    assert not (tmp_path / "fields_00000.npz").exists()  # that of an earlier run


def test_a_fresh_series_forgets_an_older_one(tmp_path: Path) -> None:
    for t in (0.0, 0.1):
        series = io.Series(tmp_path / "fields.pvd")
        series.write(t, SQUARES)
    assert [row[0] for row in read_back(tmp_path / "fields.pvd")] == [0.1]


def test_a_checkpoint_comes_back_to_the_bit(tmp_path: Path) -> None:
    arrays = {"u": np.random.default_rng(0).random((7, 2)), "t": np.array(0.1 + 0.2), "identity": np.array("cook")}
    write_npz(tmp_path / "checkpoint.npz", arrays)
    back = io.load_checkpoint(tmp_path / "checkpoint.npz")
    assert back.keys() == arrays.keys()
    assert all(np.array_equal(back[k], arrays[k]) and back[k].dtype == arrays[k].dtype for k in arrays)


def damaged(path: Path, how: str) -> None:
    if how == "text":
        path.write_text("not an archive\n")
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "cut":
        write_npz(path, {"u": np.random.default_rng(0).random(1000)})
        path.write_bytes(path.read_bytes()[:4000])
    elif how == "flipped":
        write_npz(path, {"u": np.random.default_rng(0).random(1000)})
        raw = bytearray(path.read_bytes())
        raw[3000:3010] = bytes(255 - b for b in raw[3000:3010])
        path.write_bytes(bytes(raw))
    elif how == "one array":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    elif how == "pickled":
        with path.open("wb") as file:
            np.savez(file, u=np.array([{"a": 1}], dtype=object))
    elif how == "folder":
        path.mkdir()


@pytest.mark.parametrize("how", ["text", "empty", "cut", "flipped", "one array", "pickled", "folder", "missing"])
def test_a_damaged_checkpoint_is_a_mistake_of_one_line(tmp_path: Path, how: str) -> None:
    path = tmp_path / "checkpoint.npz"
    damaged(path, how)
    with pytest.raises(Mistake) as caught:
        io.load_checkpoint(path)
    text = str(caught.value)
    assert str(path) in text and "\n" not in text
    assert ("--resume" if how == "missing" else "--out") in text


needs_adios2 = pytest.mark.skipif(
    importlib.util.find_spec("adios2") is None, reason="reading .bp files back needs the package adios2: uv pip install adios2"
)


def read_fields(path: Path) -> tuple[str, list[dict]]:
    """What ADIOS2 finds in a .bp file: the schema that ParaView reads it by, and per time the blocks of all ranks, joined."""
    schema, times = json.loads(run_python(READ_FIELDS, path))
    rows = []
    for raw in times:
        offsets = np.cumsum([0] + [len(block) for block in raw["geometry"]])
        # a row of the connectivity is the number of a cell's nodes and then the nodes, numbered within the block
        cells = [np.array(block)[:, 1:] + first for block, first in zip(raw["connectivity"], offsets)]
        joined = {name: np.concatenate(raw[name]) for name in ("geometry", "displacement", "velocity")}
        rows.append({"t": raw["t"], "cells": np.concatenate(cells), **joined})
    return schema, rows


def area(points: np.ndarray, cells: np.ndarray) -> float:
    """Of the straight triangles whose corners are the first three nodes of each cell."""
    a, b, c = (points[cells[:, k], :2] for k in range(3))
    return 0.5 * float(np.abs(np.linalg.det(np.stack([b - a, c - a], axis=1))).sum())


@needs_adios2
@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("how", ["resting", "moving"])
def test_quadratic_fields_come_back_exactly_from_every_rank(
    tmp_path: Path, mpirun: Callable[..., str], ranks: int, how: str
) -> None:
    mpirun(ranks, "-c", WRITE_FIELDS, str(tmp_path / "new" / "fields.bp"), how)
    schema, rows = read_fields(tmp_path / "new" / "fields.bp")
    assert all(f'Name="{name}"' in schema for name in ("displacement", "velocity", "geometry", "connectivity"))
    assert [row["t"] for row in rows] == [0.0, 0.1 + 0.2, 1.0]
    for row in rows:
        t, points = row["t"], row["geometry"]
        stretch = 1 + t if how == "moving" else 1.0
        # 9 x 7 nodes of 24 quadratic triangles on the unit square, those on the border of a rank twice
        assert len(np.unique(np.round(points, 9), axis=0)) == 63
        assert len(row["cells"]) == 24
        corners, middles = points[row["cells"][:, :3]], points[row["cells"][:, 3:]]
        # VTK's order: the nodes between corners 0 and 1, 1 and 2, 2 and 0
        np.testing.assert_allclose(middles, 0.5 * (corners + np.roll(corners, -1, axis=1)), atol=1e-14)
        # rounding only: P2 holds x^2 and x y exactly
        assert area(points, row["cells"]) == pytest.approx(stretch**2, rel=1e-13)
        x, y, zero = points.T
        X, Y = x / stretch, y / stretch
        np.testing.assert_allclose(row["displacement"], np.stack([t * X**2, t * X * Y, zero], axis=1), atol=1e-14)
        np.testing.assert_allclose(row["velocity"], np.stack([y + t, x - t, zero], axis=1), atol=1e-14)


@needs_adios2
def test_fields_of_a_run_that_was_killed_can_be_read(tmp_path: Path) -> None:
    run_python(WRITE_FIELDS, tmp_path / "fields.bp", "killed")
    _, rows = read_fields(tmp_path / "fields.bp")
    assert [row["t"] for row in rows] == [0.0, 0.1 + 0.2, 1.0]


def test_a_resumed_run_leaves_the_fields_written_before(tmp_path: Path) -> None:
    run_python(WRITE_FIELDS, tmp_path / "fields.bp", "resting")
    before = {file.name: file.read_bytes() for file in (tmp_path / "fields.bp").iterdir()}
    run_python(WRITE_FIELDS, tmp_path / "fields.bp", "resumed")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fields.bp", "fields_from_0.25.bp"]
    assert {file.name: file.read_bytes() for file in (tmp_path / "fields.bp").iterdir()} == before
