"""Cracks on several ranks are those of one rank, by xfem and by fem on meshes that fit them: one start of the ranks serves all cases."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_xfem_faces import loaded, pressed, pulled

import geofem
from geofem import methods, scenes
from geofem.result import Result
from geofem.scene import Box, Crack, Load, Material, Region, Scene, Support

Told = tuple[list[Any], float, float]
"""Values, and the relative and the absolute difference that there may be."""


def sizes(size: dict[str, int]) -> Told:
    return list(size.values()), 0.0, 0.0


def told(result: Result, rel: float, least: float, energy: float) -> list[Told]:
    assert result.status == "ok", result.message
    errors = (list(result.error.values()), 1e-7, 1e-10)
    return [
        sizes(result.size),
        (list(result.qoi.values()), rel, least),
        errors,
        ([float(result.history["internal"][-1])], energy, 1e-12),
    ]


def meshes_that_fit() -> Iterator[list[Told]]:
    for scene, knobs in (("williams", {"n": 8, "angle": 17.0}), ("inclined_crack", {"n": 8, "beta": 37.0})):
        yield told(geofem.run(scene, "fem", **knobs), 1e-9, 1e-11, 1e-10)
    for step in geofem.grow("shear_edge_crack", "fem", n=8, da=0.35, until=0.7):
        K = [step.K[0, 0], step.K[0, 1], step.tips[0, 0]]
        yield [sizes(step.model.size()), (K, 1e-9, 1e-11), ([step.energy["external"]], 1e-10, 1e-12)]


def cut_meshes() -> Iterator[list[Told]]:
    for scene, knobs in (
        ("williams", {"n": 12}),
        ("williams", {"n": 12, "tip": (0.5, 0.5)}),
        ("inclined_crack", {"n": 12}),
    ):
        yield told(geofem.run(scene, "xfem", **knobs), 1e-8, 1e-10, 1e-9)
    edge = scenes.get("edge_crack")()
    model: Any = methods.get("xfem").build(replace(edge, loads=(*edge.loads, Load("gravity", (0.1, -0.2)))), n=12)
    model.step(1.0)
    model.propagation.step(0.1)
    tip = [*model.paths()[0][-1].tolist(), model.cracked.release(0)]
    yield [sizes(model.size()), (tip, 1e-8, 1e-10), ([model.energy()["external"]], 1e-9, 1e-12)]


def branches() -> Iterator[list[Told]]:
    square = Region("square", Box((0.0, 0.0), (1.0, 1.0)), Material("linear_elastic", 1.0, {"E": 1.0, "nu": 0.3}))
    foot = Support("foot", lambda x: x[1] < 1e-9, (0, 1))
    pull = Load("traction", (0.3, 1.0), where=lambda x: x[1] > 1 - 1e-9)
    bent, crossed = (
        [((-0.1, 0.5), (0.7, 0.52)), ((0.5, 0.515), (0.52, 0.8))],
        [((0.2, 0.5), (0.8, 0.5)), ((0.5, 0.2), (0.5, 0.8))],
    )
    for cracks in (bent, crossed):
        scene = Scene("plain", (square,), 1.0, (foot,), (pull,), cracks=tuple(map(Crack, cracks)), strain="small")
        model: Any = methods.get("xfem").build(scene, n=12)
        model.step(1.0)
        K = [float(k) for tip in range(len(model.cracked.tips.at)) for k in model.cracked.intensity(tip)]
        yield [sizes(model.size()), (K, 0.0, 1e-9 * max(map(abs, K))), ([model.energy()["internal"]], 1e-10, 1e-12)]


def faces() -> Iterator[list[Told]]:
    """Of faces under pressure, in cohesion and in contact."""
    result = geofem.run("hydraulic_fracture", "xfem", n=10)
    found = [[*result.qoi.values(), result.error["opening"], result.checks["overlap"]]]
    model: Any = methods.get("xfem").build(loaded()[0], n=10)
    model.step(1.0)
    found.append([*model.cracked.intensity(0), model.cracked.tension(0), model.cracked.release(0)])
    model = pressed(0.3, n=20)
    found.append([*model.cracked.factors[0].ravel(), *model.cracked.contact.traction.ravel(), model.cracked.overlap()])
    model = pulled(lambda t: 0.03 * t, 3)
    for _ in range(3):
        model.step(1 / 3)
    found.append([model.cracked.contact.dissipated(), model.energy()["external"], model.size()["dofs"]])
    for numbers in found:
        yield [([float(x) for x in numbers], 1e-9, 1e-10)]


def paths() -> Iterator[list[Told]]:
    for step in geofem.grow("inclined_crack", beta=30.0, n=16, da=0.25, until=0.5):
        yield [(step.path[0].ravel().tolist(), 0.0, 1e-9), (step.K.ravel().tolist(), 1e-9, 1e-9)]


CASES: tuple[Callable[[], Iterator[list[Told]]], ...] = (meshes_that_fit, cut_meshes, branches, faces, paths)
PROGRAM = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import test_crack_ranks
test_crack_ranks.tell()
"""


def tell() -> None:
    """Print all that the cases find, a line a case, on rank 0."""
    from mpi4py import MPI

    for case in CASES:
        found = list(case())
        if MPI.COMM_WORLD.rank == 0:
            print("found", json.dumps([case.__name__, found]), flush=True)


@pytest.mark.mpi
@pytest.mark.slow
def test_cracks_are_the_same_on_any_number_of_ranks(mpirun: Callable[..., str]) -> None:
    alone, *others = (
        [json.loads(line[6:]) for line in mpirun(ranks, PROGRAM).splitlines() if line.startswith("found")]
        for ranks in (1, 2, 3)
    )
    assert [name for name, _ in alone] == [case.__name__ for case in CASES]
    for ranks, found in zip((2, 3), others):
        for (name, one), (same, many) in zip(alone, found, strict=True):
            assert name == same
            for step, (expected, got) in enumerate(zip(one, many, strict=True)):
                for (values, rel, least), (numbers, *_) in zip(expected, got, strict=True):
                    assert numbers == pytest.approx(values, rel=rel, abs=least), (ranks, name, step)
