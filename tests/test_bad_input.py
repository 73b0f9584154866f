"""What a user can mend is one line that says what, where and what to do: exit status 2, and nothing half-written in --out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from blocks import STEEL, block, solved
from conftest import Done

import geofem
from geofem import Load, Material, MeshFile, Mistake, Region, Support, scenes
from geofem.scenes._parts import at_least

SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]


def mistake(scene: Any, method: str = "fem", **knobs: Any) -> str:
    """What the run of a mistaken scene or knob says, which must be one line."""
    with pytest.raises(Mistake) as raised:
        geofem.run(scene, method, **knobs)
    assert "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.parametrize(
    "parameters, words",
    [
        ({"E": -1.0, "nu": 0.3}, "E = -1"),
        ({"E": 0.0, "nu": 0.3}, "positive"),
        ({"E": float("nan"), "nu": 0.3}, "finite number"),
        ({"E": 1.0, "nu": 0.6}, "between -1 and 0.5"),
        ({"E": 1.0, "nu": 0.5}, "formulation=mixed"),
        ({"E": 1.0}, "nu"),
        ({"E": 1.0, "nu": 0.3, "mu": 1.0}, "mu"),
    ],
)
def test_material_that_cannot_be(parameters: dict, words: str) -> None:
    said = mistake(block(2, replace(STEEL, parameters=parameters)), n=1)
    assert words in said and "block" in said


def test_incompressible_material_is_for_the_mixed_form() -> None:
    cook = scenes.get("cook")(variant="B")
    region = replace(cook.regions[0], material=Material("linear_elastic", 1.0, {"E": 1.125, "nu": 0.5}))
    rubber = replace(cook, regions=(region,))
    assert "formulation=mixed" in mistake(rubber, n=4)
    # nu = .499999975 of variant B is as good as incompressible: the same answer
    assert solved(rubber, n=4, formulation="mixed").qoi["uy"] == pytest.approx(
        solved(cook, n=4, formulation="mixed").qoi["uy"], rel=1e-5
    )


@pytest.mark.parametrize(
    "knobs, words",
    [
        ({"n": 0}, "n = 0"),
        ({"n": 2.5}, "whole number"),
        ({"order": 4}, "orders 1 to 3"),
        ({"order": 3, "cell": "quadrilateral"}, "orders 1 to 2"),
        ({"cell": "hexahedron"}, "triangle or quadrilateral"),
        ({"cell": "pentagon"}, "pentagon"),
        ({"grading": 0.5}, "grading = 0.5"),
        ({"steps": 0}, "steps = 0"),
        ({"rho_inf": 2}, "rho_inf"),
        ({"formulation": "mixed", "order": 1}, "order 2"),
        ({"frame": "updated"}, "total"),
        ({"quadrature": "reduced"}, "quadrilaterals"),
        ({"formulaton": "mixed"}, "did you mean 'formulation'"),
        ({"variant": "Z"}, "variant"),
    ],
    ids=str,
)
def test_knob_that_cannot_be(knobs: dict, words: str) -> None:
    assert words in mistake("cook", **knobs)


def test_unknown_scene_and_method_name_the_nearest() -> None:
    assert "did you mean 'cook'" in mistake("cok")
    assert "did you mean 'fem'" in mistake("cook", method="fm")


def test_parts_of_the_boundary_that_are_not_there() -> None:
    nowhere = block(2, loads=(Load("traction", (1.0, 0.0), where=at_least(0, 7.0)),))
    assert "picks no facet" in mistake(nowhere, n=1)
    assert "lies outside" in mistake(block(2, corner=(3.0, 3.0)), n=1)


# --- mesh files -------------------------------------------------------------------------------------------------------
def of_file(path: Path, **keywords: Any) -> Any:
    """The block with its cells from a mesh file."""
    scene = block(2, **keywords)
    return replace(scene, regions=(Region("block", MeshFile(path), STEEL),))


def written(path: Path, points: list, cells: list) -> Path:
    meshio.write(path, meshio.Mesh(np.array(points), cells))
    return path


def test_mesh_file_that_cannot_be_used(tmp_path: Path) -> None:
    lines = written(tmp_path / "lines.vtu", SQUARE, [("line", [[0, 1], [1, 2]])])
    assert "lines.vtu" in mistake(of_file(lines))
    flat = written(
        tmp_path / "flat.vtu", [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0]], [("triangle", [[0, 1, 3], [0, 1, 2]])]
    )
    assert "flat.vtu" in mistake(of_file(flat))
    assert "missing.msh" in mistake(of_file(tmp_path / "missing.msh"))


def test_group_that_the_mesh_file_lacks_is_named(tmp_path: Path) -> None:
    square = written(tmp_path / "square.vtu", SQUARE, [("triangle", [[0, 1, 2], [0, 2, 3]])])
    assert "'base'" in mistake(of_file(square, supports=(Support("base", "base", (0, 1)),)))


# --- the command line and its folder ----------------------------------------------------------------------------------
@pytest.mark.parametrize("setting", ["n=0", "order=4", "grading=0.5", "ordr=2", "variant=Z"])
def test_mistake_is_one_line_exit_2_and_an_empty_folder(cli_here: Callable[..., Done], tmp_path: Path, setting: str) -> None:
    out = tmp_path / "out"
    done = cli_here("run", "cook", "--method", "fem", "--set", setting, "--out", out, "--json")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert setting.partition("=")[0] in done.stderr
    assert not out.exists() or not list(out.iterdir())


def test_checkpoint_that_cannot_be_resumed(tmp_path: Path) -> None:
    assert "checkpoint.npz" in mistake("cook", n=2, out=tmp_path, resume=True)
    (tmp_path / "checkpoint.npz").write_bytes(b"PK\x03\x04 no checkpoint")
    assert "checkpoint.npz" in mistake("cook", n=2, out=tmp_path, resume=True)
    np.savez(tmp_path / "checkpoint.npz", identity=np.array("another run"), samples=np.zeros((1, 5)))
    assert "another run" in mistake("cook", n=2, out=tmp_path, resume=True)
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.npz"]
    assert "'out'" in mistake("cook", n=2, resume=True)
