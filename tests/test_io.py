"""Files of a run: pictures that another program opens, checkpoints on any number of ranks, and what damaged files say."""

from __future__ import annotations

import json
import subprocess
import sys
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


def read_back(path: Path) -> list:
    """What VTK sees in a series, in a process of its own."""
    done = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


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
