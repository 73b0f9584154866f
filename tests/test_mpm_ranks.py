"""Material points on several ranks are those of one rank; checkpoints are taken up on any number of them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from points import SOFT, block, build, spin

from geofem import scenes
from geofem.scene import Box, Polygon, Probe, Region, Rigid, Scene, Wall

pytestmark = [pytest.mark.mpi, pytest.mark.slow]

FLOOR = Wall("floor", lambda x: x[1] <= -0.1, (0.0, 1.0), 0.3)
PLATE = Rigid("plate", Polygon(((0.2, 0.95), (1.8, 0.9), (1.8, 1.5))), lambda t: (2.0 * t, -6.0 * t), 0.4)
PROBES = (
    Probe("u", "displacement", (0.9, 0.6), 0),
    Probe("top", "quantile", None, 1, share=0.99),
    Probe("F", "reaction", of="plate", component=1),
)
STEPS = 8


def turning() -> Scene:
    """A block that turns and moves over the borders of slabs, on a floor and under a rigid body."""
    second = Region("second", Box((1.0, 0.0), (1.5, 0.5)), SOFT)
    return block(
        spin,
        walls=(FLOOR,),
        rigids=(PLATE,),
        probes=PROBES,
        regions=(Region("block", Box((0.0, 0.0), (1.0, 1.0)), SOFT), second),
    )


def strip() -> Scene:
    """A strip of one cell across, all of it on one rank at first, flies at 60 m/s: others are empty until it comes to them."""
    thin = Region("strip", Box((0.0, 0.0), (1 / 6, 1.0)), SOFT)
    return block(lambda x: np.stack([60.0 + 0 * x[0], 5.0 * x[0]]), regions=(thin,), probes=PROBES[:2])


def pulled() -> Scene:
    return block(lambda x: np.stack([60.0 * (x[0] - 0.4), 0 * x[1]]), probes=PROBES[:2], intact=True)


def grains() -> Scene:
    """The granular column slides along its floor, which rubs, while it slumps."""
    return replace(scenes.get("column_collapse")(), initial_velocity=lambda x: np.stack([3.0 + 0 * x[0], 0 * x[1]]))


CASES: dict[str, tuple[Callable[[], Scene], dict[str, Any]]] = {
    "hat": (turning, {"shape": "hat", "scheme": "usf", "small_mass": 0.1}),
    "cpgimp": (turning, {"shape": "cpgimp", "scheme": "usl", "transfer": "apic"}),
    "cpdi2": (turning, {"shape": "cpdi2", "scheme": "usl", "transfer": "apic"}),
    "bspline2": (turning, {"shape": "bspline2", "scheme": "musl", "transfer": "xpic", "xpic": 3}),
    "split": (pulled, {"shape": "cpdi", "scheme": "usl", "split": 0.51}),
    "grains": (grains, {"shape": "cpdi", "scheme": "usl", "split": 0.51}),
    "cure": (turning, {"shape": "gimp", "scheme": "usl", "cure": "cell"}),
    "empty": (strip, {"shape": "gimp", "scheme": "usl"}),
}


def make(name: str):
    scene, knobs = CASES[name]
    return build(scene(), n=6, sort_after=0.2, **knobs)


def go(model: Any, steps: int) -> dict[str, Any]:
    for _ in range(steps):
        model.step(model.dt())
    return model.state() | {
        "probes": np.array([model.probe(probe) for probe in model.scene.probes]),
        "size": np.array([*model.size().values()]),
    }


def save(folder: Path, label: str, state: dict[str, Any]) -> None:
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank == 0:
        np.savez(folder / f"{label}.npz", **state)
    MPI.COMM_WORLD.Barrier()


def both(folder: Path, ranks: int, resume: int) -> None:
    """Every case on all ranks of this process's world: whole, half, and from the middle of a run of ``resume`` ranks."""
    from geofem.methods.mpm import model as module

    module.WORTH_SORTING = 0
    for name in CASES:
        model = make(name)
        half = go(model, STEPS)
        save(folder, f"{name}-half-{ranks}", half)
        save(folder, f"{name}-whole-{ranks}", go(model, STEPS))
        if resume:
            again(folder, name, f"{name}-half-{resume}", f"{name}-resumed-{ranks}")


def again(folder: Path, name: str, start: str, label: str) -> None:
    model = make(name)
    with np.load(folder / f"{start}.npz") as file:
        model.restore({key: file[key] for key in file.files})
    save(folder, label, go(model, STEPS))


PROGRAM = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import geofem
from pathlib import Path
from mpi4py import MPI
import test_mpm_ranks
test_mpm_ranks.both(Path({{folder!r}}), MPI.COMM_WORLD.size, {{resume}})
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, mpirun: Callable[..., str]) -> Path:
    """Runs on 1, 2 and 3 ranks; the second takes up checkpoints of the first, and the third those of the second."""
    path = tmp_path_factory.mktemp("ranks")
    worth = sys.modules["geofem.methods.mpm.model"].WORTH_SORTING
    both(path, 1, 0)
    for ranks in (2, 3):
        mpirun(ranks, PROGRAM.format(folder=str(path), resume=ranks - 1))
    for name in CASES:
        again(path, name, f"{name}-half-3", f"{name}-resumed-1")
    sys.modules["geofem.methods.mpm.model"].WORTH_SORTING = worth
    return path


@pytest.mark.parametrize("name", CASES)
def test_ranks_and_checkpoints_change_nothing(folder: Path, name: str) -> None:
    """Points agree to 1e-12 of the largest value, most to the bit; sums over ranks to rounding."""
    with np.load(folder / f"{name}-whole-1.npz") as file:
        expected = {key: file[key] for key in file.files}
    assert np.array_equal(expected["id_0"], np.arange(len(expected["id_0"]))) or "split" in CASES[name][1]
    for label in ("whole-2", "whole-3", "resumed-1", "resumed-2", "resumed-3"):
        with np.load(folder / f"{name}-{label}.npz") as found:
            assert set(found.files) == set(expected)
            for key, value in expected.items():
                got = found[key]
                assert got.shape == value.shape, (label, key)
                scale = np.abs(value[np.isfinite(value)]).max(initial=0.0)
                assert got == pytest.approx(value, rel=1e-12, abs=1e-12 * scale + 1e-300), (label, key)


def test_bodies_crossed_the_borders(folder: Path) -> None:
    """The strip moved over two cells, the block was split, and grains changed their cells: what was compared did happen."""
    with np.load(folder / "empty-whole-1.npz") as file:
        assert (file["x_0"] - file["X_0"])[:, 0].min() > 2 / 6
    with np.load(folder / "split-whole-1.npz") as file:
        assert len(file["id_0"]) > 160
    with np.load(folder / "grains-whole-1.npz") as file:
        way = (file["x_0"] - file["X_0"])[:, 0] / (scenes.get("column_collapse")().length / 6)
        assert way.max() > 0.25 and len(file["id_0"]) > 144  # points begin a quarter of a cell from its border


def test_more_ranks_than_rows_is_a_mistake() -> None:
    from geofem.methods.mpm.parallel import make_slabs
    from geofem.mistake import Mistake

    class Many:
        size, rank = 9, 0

    with pytest.raises(Mistake, match="too few for 9 ranks"):
        make_slabs(Many(), np.zeros(4, int), 8, 3)  # type: ignore[arg-type]
