"""The one loop: build, step, sample, result; with clock, progress, checkpoints, and failures caught as results."""

from __future__ import annotations

import gc
import inspect
import json
import logging
import math
import signal
import sys
import time
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from tqdm import tqdm

from geofem import doctor, materials, methods, scenes
from geofem.core import io
from geofem.core.mpi import install_abort_hook
from geofem.cost import CLOCK, peak_rss_mb
from geofem.methods import Model
from geofem.mistake import Breakdown, Mistake, unknown
from geofem.result import Result, write_npz
from geofem.scene import Measure, Scene

log = logging.getLogger("geofem")
SAMPLES = 1000
"""A run is sampled at most about this many times."""
CHECKPOINT_SECONDS = 60.0
"""Wall seconds between checkpoints."""
SceneLike = str | Scene | Callable[..., Scene]


# --- what to run ------------------------------------------------------------------------------------------------------
def resolve(scene: SceneLike, method_name: str, knobs: Mapping[str, Any]) -> tuple[Scene, dict[str, Any]]:
    """The scene built with its own knobs, and the knobs that are left for the method.

    scene : a registered name, a function that returns a ``Scene``, ``file.py:function``, or a ``Scene``.
    Raises ``Mistake`` for a knob that neither the scene nor the method knows.
    """
    method_knobs = parameters(methods.get(method_name).build, skip=1)
    if isinstance(scene, Scene):
        build, scene_knobs = (lambda: scene), set()
    else:
        build = function_of(scene) if isinstance(scene, str) else scene
        scene_knobs = parameters(build)
    for name in knobs:
        if name not in scene_knobs | method_knobs:
            raise unknown("knob", name, scene_knobs | method_knobs)
    made = build(**{k: v for k, v in knobs.items() if k in scene_knobs})
    for region in made.regions:
        materials.check(region.material, f"scene {made.name}, region {region.name!r}", incompressible_ok=True)
    return made, {k: v for k, v in knobs.items() if k in method_knobs}


def parameters(function: Callable[..., Any], skip: int = 0) -> set[str]:
    """Names of the parameters of a function, the first ``skip`` left out."""
    return set(list(inspect.signature(function).parameters)[skip:])


def function_of(name: str) -> Callable[..., Scene]:
    """A registered scene's function, or the one that ``file.py:function`` names."""
    path, colon, attribute = name.rpartition(":")
    if not colon:
        return scenes.get(name)
    spec = spec_from_file_location(Path(path).stem, path) if Path(path).is_file() else None
    if spec is None or spec.loader is None:
        raise Mistake(f"scene {name!r}: there is no Python file {path!r}; write file.py:function")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    if not hasattr(module, attribute):
        raise Mistake(f"scene {name!r}: {path} has no function {attribute!r}")
    return getattr(module, attribute)


# --- the run ----------------------------------------------------------------------------------------------------------
def run(
    scene: SceneLike,
    method: str = "fem",
    *,
    out: Path | str | None = None,
    resume: bool = False,
    progress: bool = False,
    frames: int = 0,
    **knobs: Any,
) -> Result:
    """Solve a scene by a method.

    Parameters
    ----------
    scene : a registered name, ``file.py:function``, a function that returns a ``Scene``, or a ``Scene``.
    method : a registered name.
    out : folder for ``result.json``, ``result.npz``, ``checkpoint.npz`` and fields; nothing is written without it.
    resume : go on from ``out/checkpoint.npz``, on any number of ranks.
    progress : one line with the time left, on rank 0.
    frames : number of times at which the fields are written to ``out`` for ParaView.
    knobs : of the scene and of the method.

    Returns a ``Result`` on every rank (history too; the snapshot on rank 0). Raises ``Mistake`` for what the user can mend.
    """
    folder = Path(out) if out is not None else None
    if folder is None and (resume or frames):
        raise Mistake("'resume' and 'frames' need 'out', the folder of the run")
    made, method_knobs = resolve(scene, method, knobs)
    name = made.name if not isinstance(scene, str) else scene
    result = Result(
        name, method, knobs={**made.knobs, **knobs}, ranks=MPI.COMM_WORLD.size, versions=versions(), savings=dict(made.savings)
    )
    result.reference = {m.name: reference_of(m) for m in made.measures if m.reference is not None}
    reason = methods.get(method).refuses(made)
    if reason is not None:
        result.status, result.message = "refused", reason
        return result
    prepare()
    CLOCK.reset()
    start_wall, start_cpu = time.perf_counter(), time.process_time()
    with CompileTimes():
        model = methods.get(method).build(made, **method_knobs)
        run_of_model = Run(made, model, result, folder, progress, frames)
        setup = time.process_time() - start_cpu - CLOCK.seconds["jit"]
        if resume:
            run_of_model.resume()
        try:
            run_of_model.loop()
        finally:
            run_of_model.close()
    finish(made, model, result)
    result.cost = cost(start_wall, start_cpu, setup)
    if folder is not None and MPI.COMM_WORLD.rank == 0:
        result.save(folder)
    del model, run_of_model
    tidy()
    return result


def tidy() -> None:
    """Free the meshes, matrices and communicators of a run that has ended; a process has only some 2000 communicators. Collective."""
    gc.collect()
    PETSc.garbage_cleanup(MPI.COMM_WORLD)


@cache
def prepare() -> None:
    """Once a process: see that no rank waits for one that has failed, or for a compilation that was killed. Collective."""
    if MPI.COMM_WORLD.size > 1 and sys.excepthook is sys.__excepthook__:
        install_abort_hook()
    if MPI.COMM_WORLD.rank == 0:
        for lock in doctor.heal_stale_locks():
            log.warning("removed %s, left by a compilation that was interrupted", lock)
    MPI.COMM_WORLD.Barrier()


class Run:
    """The state of one run: the model, what was sampled so far, and when to stop."""

    def __init__(self, scene: Scene, model: Model, result: Result, folder: Path | None, progress: bool, frames: int):
        self.scene, self.model, self.result, self.folder = scene, model, result, folder
        self.comm = MPI.COMM_WORLD
        self.samples: list[list[float]] = []
        self.names = ["t", *(p.name for p in scene.probes), "kinetic", "internal", "external"]
        self.stop = False
        self.bar = tqdm(total=1.0, file=sys.stderr, desc=f"{result.scene} {result.method}", leave=False, mininterval=0.5,
                        bar_format="{desc} {percentage:3.0f}% |{bar:30}| t left {remaining} {postfix}",
                        disable=not progress or self.comm.rank != 0)  # fmt: skip
        self.every_frame = scene.t_end / frames if frames else math.inf
        self.drawn = -math.inf
        self.series: io.Series | None = None
        self.fields: io.FieldFile | None = None

    def loop(self) -> None:
        """Step to the end, to the breakdown or to an interruption; the result has the status and cause."""
        scene, model, result = self.scene, self.model, self.result
        every = scene.t_end / SAMPLES
        last_checkpoint = time.monotonic()
        tiny = 1e-9 * scene.t_end
        if not self.samples:
            self.sample()
        frame = model.t + self.every_frame
        if math.isfinite(self.every_frame):
            self.draw()
        with Interrupts(self):
            while model.t < scene.t_end - tiny:
                try:
                    model.step(min(model.dt(), scene.t_end - model.t))
                except Breakdown as end:
                    self.break_down(end)
                    if self.series is not None and model.t > self.drawn:
                        self.draw()  # where the method died
                    break
                if model.t >= self.samples[-1][0] + every - tiny or model.t >= scene.t_end - tiny:
                    self.sample()
                if model.t >= frame - tiny:
                    self.draw()
                    frame += self.every_frame
                self.bar.update(model.t / scene.t_end - self.bar.n)
                due = self.folder is not None and time.monotonic() - last_checkpoint > CHECKPOINT_SECONDS
                stop, due = self.agreed(self.stop, due)
                if stop or due:
                    self.checkpoint()
                    last_checkpoint = time.monotonic()
                if stop:
                    result.status, result.message = "partial", f"interrupted at t = {model.t:.6g} of {scene.t_end:g}"
                    result.at = self.place()
                    break
        if self.samples[-1][0] < model.t:
            self.sample()
        result.history = dict(zip(self.names, np.array(self.samples).T))

    def close(self) -> None:
        """End the progress line and finish the file of fields, also after an error."""
        self.bar.close()
        if self.fields is not None:
            self.fields.close()

    def draw(self) -> None:
        """Add the present fields to the series that ParaView opens. Collective."""
        assert self.folder is not None
        functions = self.model.functions()
        if self.series is None:
            resumed = self.model.t if self.model.t > 0.0 else None
            self.series = io.Series(self.folder / "fields.pvd", resumed)
            self.fields = io.FieldFile(self.folder / "fields.bp", functions, resumed) if functions else None
        self.drawn = self.model.t
        self.series.write(self.model.t, self.model.snapshot())
        if self.fields is not None:
            self.fields.write(self.model.t)

    def break_down(self, end: Breakdown) -> None:
        """Note where and why the run came to its end; losing equilibrium ends a collapse scene well, and so does the rest of all cracks."""
        self.result.at = self.place()
        self.result.message = str(end)
        if end.cause != "arrest" and not (self.scene.collapse and end.cause == "newton"):
            self.result.status, self.result.cause = "failed", end.cause

    def place(self) -> dict[str, float]:
        """Where the run stands."""
        t = self.model.t
        return {"t": t, **(self.scene.at(t) if self.scene.at else {})}

    def sample(self) -> None:
        energy = self.model.energy()
        probes = [self.model.probe(probe) for probe in self.scene.probes]
        self.samples.append([self.model.t, *probes, energy["kinetic"], energy["internal"], energy["external"]])

    def agreed(self, *flags: bool) -> list[bool]:
        """Flags that are true on all ranks if they are on one."""
        if self.comm.size == 1:
            return list(flags)
        return [self.comm.allreduce(flag, op=MPI.LOR) for flag in flags]

    # --- checkpoints ----------------------------------------------------------------------------------------------
    @property
    def identity(self) -> str:
        return json.dumps([self.result.scene, self.result.method, self.result.row["knobs"]], sort_keys=True)

    def checkpoint(self) -> None:
        """Write all that is needed to go on, whole or not at all. Collective."""
        state = self.model.state()
        if self.folder is not None and self.comm.rank == 0:
            self.folder.mkdir(parents=True, exist_ok=True)
            arrays = {f"model_{k}": v for k, v in state.items()}
            write_npz(
                self.folder / "checkpoint.npz",
                arrays | {"samples": np.array(self.samples), "identity": np.array(self.identity)},
            )

    def resume(self) -> None:
        """Take up ``checkpoint.npz``. Raises ``Mistake`` if it is missing, unreadable or of another run."""
        assert self.folder is not None
        path = self.folder / "checkpoint.npz"
        arrays = io.load_checkpoint(path)
        if str(arrays.get("identity", "")) != self.identity:
            raise Mistake(f"{path}: is the checkpoint of another run; give the same scene, method and knobs, or another --out")
        self.samples = arrays["samples"].tolist()
        self.model.restore({k.removeprefix("model_"): v for k, v in arrays.items() if k.startswith("model_")})


class Interrupts:
    """While active, Ctrl-C and SIGTERM ask the run to stop after the current step instead of ending the process."""

    def __init__(self, of: Run):
        self.run = of

    def __enter__(self) -> None:
        self.old = {s: signal.signal(s, self.ask) for s in (signal.SIGINT, signal.SIGTERM)}

    def __exit__(self, *_: object) -> None:
        for number, handler in self.old.items():
            signal.signal(number, handler)

    def ask(self, *_: object) -> None:
        if self.run.stop:
            raise KeyboardInterrupt
        self.run.stop = True
        log.warning("stopping after this step (once more to stop at once)")


# --- what it came to --------------------------------------------------------------------------------------------------
def finish(scene: Scene, model: Model, result: Result) -> None:
    """Quantities, errors, checks and sizes of a run that has ended."""
    history = result.history
    for measure in scene.measures:
        try:
            value = measure.value(history) if measure.value else None
            if value is not None:
                result.qoi[measure.name] = float(value)
            if measure.error is not None:
                result.error[measure.name] = float(measure.error(history))
            elif value is not None and measure.reference is not None and measure.reference.known:
                result.error[measure.name] = measure.reference.error(float(value))
        except (ValueError, IndexError) as error:
            # a run that broke down may have no second period to measure
            if result.status == "ok":
                raise
            log.info("no %s: %s", measure.name, error)
    total = history["kinetic"] + history["internal"] - history["external"]
    scale = np.max(history["kinetic"] + np.abs(history["internal"]))
    energy = float(np.max(np.abs(total - total[0])) / scale) if scene.dynamic and scale > 0 else None
    result.checks = {**model.checks(), "energy": energy}
    result.size, result.work = model.size(), dict(model.work)
    result.work = {"steps": 0, "newton": 0, "linear": 0, "point_steps": 0, "remeshes": 0} | result.work
    result.savings |= model.savings()
    result.snapshot = model.snapshot()


def reference_of(measure: Measure) -> dict[str, Any]:
    reference = measure.reference
    assert reference is not None
    out: dict[str, Any] = {"value": reference.value, "kind": reference.kind, "source": reference.source, "unit": measure.unit}
    if reference.lower is not None:
        out |= {"lower": reference.lower, "upper": reference.upper}
    return out


def cost(start_wall: float, start_cpu: float, setup: float) -> dict[str, Any]:
    """CPU seconds summed over ranks, compilation apart; wall seconds and peak memory of the largest rank."""
    comm = MPI.COMM_WORLD
    phases = comm.allreduce({k: float(v) for k, v in CLOCK.seconds.items()}, op=merge)
    cpu = comm.allreduce(time.process_time() - start_cpu, op=MPI.SUM) - phases.get("jit", 0.0)
    return {
        "cpu_s": cpu,
        "wall_s": comm.allreduce(time.perf_counter() - start_wall, op=MPI.MAX),
        "setup_s": comm.allreduce(setup, op=MPI.SUM),
        "phases": phases,
        "rss_mb": comm.allreduce(peak_rss_mb(), op=MPI.MAX),
    }


def merge(a: dict[str, float], b: dict[str, float], *_: object) -> dict[str, float]:
    """Sums by name, for reductions of dictionaries."""
    return {k: a.get(k, 0.0) + b.get(k, 0.0) for k in {*a, *b}}


def versions() -> dict[str, str]:
    found = {"python": sys.version.split()[0]}
    for package in ("geofem", "dolfinx-solver-real", "fenics-dolfinx", "numba", "numpy", "gmsh"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


class CompileTimes(numba.core.event.Listener):
    """Books numba's compilations under the phase ``jit``."""

    def __enter__(self) -> None:
        self._open: list[Any] = []
        numba.core.event.register("numba:compile", self)

    def __exit__(self, *_: object) -> None:
        numba.core.event.unregister("numba:compile", self)

    def on_start(self, event: Any) -> None:
        self._open.append(CLOCK.phase("jit"))
        self._open[-1].__enter__()

    def on_end(self, event: Any) -> None:
        self._open.pop().__exit__(None, None, None)
