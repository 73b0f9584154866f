"""On several ranks every scene has the answer of one; a run that was stopped goes on, on any number of ranks, as if it had not been."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import LAUNCHER, ROOT, Done

from geofem import Result

pytestmark = pytest.mark.mpi

SCENES = [
    *[("patch", {"motion": m, "n": 3}) for m in ("strain", "rotation", "shear")],
    ("cook", {"variant": "A", "n": 8}),
    ("cook", {"variant": "A", "n": 4, "cell": "quadrilateral"}),
    ("cook", {"variant": "D", "n": 4, "formulation": "mixed"}),
    ("cook", {"variant": "E", "n": 4, "frame": "updated"}),
    ("column", {"law": "hencky", "n": 4}),
    ("cantilever", {"P": 5, "n": 1, "slenderness": 20}),
    ("axial", {"n": 4, "steps": 10}),
    ("beam_drop", {"n": 1, "steps": 20}),
    ("vortex", {"A": 0.2, "n": 2, "steps": 10, "order": 1}),
    ("cavity", {"n": 1}),
    ("footing", {"n": 2, "steps": 2, "tolerance": 1e-10}),
    ("slope", {"case": "undrained", "n": 2}),
    ("vertical_cut", {"n": 2}),
]
LADDER = f"""
import json
import geofem
from mpi4py import MPI
for scene, knobs in {SCENES!r}:
    result = geofem.run(scene, "fem", **knobs)
    last = {{name: float(values[-1]) for name, values in result.history.items()}}
    if MPI.COMM_WORLD.rank == 0:
        numbers = {{**result.qoi, **{{f"error {{k}}": v for k, v in result.error.items()}}, **last}}
        print(json.dumps([scene, result.status, result.size, result.work["newton"], numbers]), flush=True)
"""
STOPPED = """
import sys
import geofem
from geofem import runner
sample, out, stop = runner.Run.sample, sys.argv[1], float(sys.argv[2])
def stopping(self):
    sample(self)
    self.stop = self.model.t >= stop * self.scene.t_end
runner.Run.sample = stopping
scene, knobs = eval(sys.argv[3])
result = geofem.run(scene, "fem", out=out, resume=stop > 1 and bool(sys.argv[4:]), **knobs)
print("status", result.status, flush=True)
"""


def ranks(n: int, *words: str) -> str:
    """What n ranks print that run Python with these words; one rank without a launcher, as a user would."""
    launch = [str(LAUNCHER), "-n", str(n)] if n > 1 else []
    done = subprocess.run([*launch, sys.executable, *words], capture_output=True, text=True, timeout=600, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def rows(text: str) -> list[list]:
    return [json.loads(line) for line in text.splitlines() if line.startswith("[")]


@pytest.fixture(scope="module")
def serial() -> list[list]:
    return rows(ranks(1, "-c", LADDER))


@pytest.mark.slow
@pytest.mark.parametrize("n", [2, 3])
def test_every_scene_has_the_answer_of_one_rank(serial: list[list], n: int) -> None:
    parallel = rows(ranks(n, "-c", LADDER))
    assert len(parallel) == len(serial) == len(SCENES)
    for one, many in zip(serial, parallel):
        assert many[:3] == one[:3] and one[1] == "ok"
        # sums in another order: rounding, which Newton's tolerance of 1e-9 and less hides and collapse may amplify
        for name, value in one[4].items():
            assert many[4][name] == pytest.approx(value, rel=1e-9, abs=1e-9 if name.startswith("error") else 1e-12 + 1e-9 * abs(value)), (
                one[0],
                name,
            )


# --- checkpoints ------------------------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize("before, after", [(2, 1), (1, 2)])
@pytest.mark.parametrize(
    "scene, knobs, tolerance",
    [
        ("beam_drop", {"n": 1, "steps": 20, "tolerance": 1e-12}, 1e-10),
        ("beam_drop", {"n": 1, "steps": 20, "tolerance": 1e-12, "frame": "updated"}, 1e-10),
        ("cavity", {"n": 1, "steps": 6, "tolerance": 1e-12}, 1e-10),
        ("footing", {"n": 2, "steps": 6, "tolerance": 1e-11}, 1e-9),
    ],
    ids=["dynamic", "updated", "plastic", "footing"],
)
def test_a_checkpoint_is_taken_up_by_another_number_of_ranks(
    tmp_path: Path, scene: str, knobs: dict, tolerance: float, before: int, after: int
) -> None:
    run = repr((scene, knobs))
    assert "status ok" in ranks(1, "-c", STOPPED, str(tmp_path / "whole"), "2", run)
    assert "status partial" in ranks(before, "-c", STOPPED, str(tmp_path / "parts"), "0.5", run)
    assert (tmp_path / "parts" / "checkpoint.npz").exists()
    assert "status ok" in ranks(after, "-c", STOPPED, str(tmp_path / "parts"), "2", run, "resume")
    whole, parts = (Result.load(tmp_path / name) for name in ("whole", "parts"))
    assert parts.work["steps"] == whole.work["steps"] and len(parts.history["t"]) == len(whole.history["t"])
    for name, value in (whole.qoi or whole.error).items():
        assert (parts.qoi or parts.error)[name] == pytest.approx(value, rel=tolerance), name
    for name in ("kinetic", "internal", "external"):
        scale = abs(whole.history["internal"]).max()
        assert parts.history[name][-1] == pytest.approx(whole.history[name][-1], abs=10 * tolerance * scale), name


# --- interruption -----------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_interrupt_leaves_a_checkpoint_that_resume_completes(run_cli: Callable[..., Done], tmp_path: Path) -> None:
    words = ["run", "beam_drop", "--method", "fem", "--set", "n=1", "--set", "steps=2000", "--json", "--out", str(tmp_path / "out")]
    # the run says when it has begun; a second signal would end it at once
    process = subprocess.Popen(
        [sys.executable, "-m", "geofem", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=os.environ
    )
    seconds = 4.0
    while process.poll() is None:
        time.sleep(seconds)
        os.kill(process.pid, signal.SIGINT)
        break
    stdout, stderr = process.communicate(timeout=120)
    row = json.loads(stdout)
    assert (process.returncode, row["status"]) == (130, "partial"), stderr
    assert 0 < row["work"]["steps"] < 2000 and "interrupted" in row["message"]
    assert (tmp_path / "out" / "checkpoint.npz").exists()
    done = run_cli(*words, "--resume")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["work"]["steps"] == 2000
