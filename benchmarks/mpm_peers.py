"""Material points moved by a step in a second, beside taichi and Kratos: million point-steps per CPU second on one thread.

uv run --group bench python benchmarks/mpm_peers.py [geofem] [taichi] [kratos]

Peers that are not installed are left out, and methods of geofem that are not registered.

One problem for all: a free elastic square in small vibration, 160 x 160 cells, 4 points a cell, plane strain, 0.3 of the
Courant step. Every contender has a process of its own, so that neither imports nor threads mix, and runs 30 steps on a coarse
grid first: the share of the kinetic energy that is left must be the same for all, within a hundredth.

geofem      ``Model.step`` of the method with ``scheme="usl"`` and FLIP, all bookkeeping included.
taichi      MLS-MPM (Hu et al. 2018): quadratic B-splines, APIC, written below for its CPU backend with ``fast_math``. ``usual``
            leaves its loops parallel as they are by default, run by one thread; ``serial`` tells it that they are not, so that
            sums on the grid need not be atomic, which is the fastest way found (arrays of structures, a packed grid and more
            optimisation by LLVM gain nothing). Many threads do not work with ``serial``.
Kratos      MPMApplication: explicit, hat functions on quadrilaterals, linear elastic law, its own loop over steps without output.

The laws are the same: ``linear`` is tau = C : (sym F - I), ``neo_hooke`` is tau = G (F F^T - I) + lambda ln J I. Kratos has the
increments of small strains instead.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np

ONE_THREAD = {cap: "1" for cap in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}
N, COARSE = 160, 40
"""Cells along an edge where speed is measured, and where energies are compared."""
ROUNDS, BLOCKS = 2, 6
"""Processes for every contender, and blocks of steps in each, of which the fastest counts."""
E, NU, DENSITY = 1e6, 0.3, 1000.0
LAM, G = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
CFL, SPEED = 0.3, ((LAM + 2 * G) / DENSITY) ** 0.5
PROOF = 30
TIME = PROOF * CFL / COARSE / SPEED
"""Steps after which energies are compared, and the time then (s): nearly half of the kinetic energy is gone."""

Run = tuple[int, Callable[[int], object], Callable[[], float]]
"""Points; a function that makes so many steps; one that gives the kinetic energy (J/m)."""


def velocity(x: np.ndarray) -> np.ndarray:
    """At the start, m/s: x (2, ...) -> (2, ...)."""
    return 0.1 * np.stack([np.cos(np.pi * x[0]), -np.cos(np.pi * x[1])])


def square(law: str) -> Any:
    """The scene: 1 m x 1 m, free."""
    from geofem.scene import Box, Material, Region, Scene

    material = Material(law, DENSITY, {"E": E, "nu": NU})
    return Scene(
        name="square",
        regions=(Region("square", Box((0.0, 0.0), (1.0, 1.0)), material),),
        length=1.0,
        supports=(),
        dynamic=True,
        initial_velocity=velocity,
        room=Box((-0.1, -0.1), (1.1, 1.1)),
    )


def geofem(n: int, method: str, law: str) -> Run | None:
    from geofem import methods

    if method not in methods.known():
        return None
    build = methods.get(method).build
    order = {"order": 2} if "order" in signature(build).parameters else {}
    model = build(square("linear_elastic" if law == "linear" else law), n=n, scheme="usl", cfl=CFL, **order)

    def advance(steps: int) -> None:
        for _ in range(steps):
            model.step(model.dt())

    def kinetic() -> float:
        while model.t < TIME * (1 - 1e-9):
            model.step(min(model.dt(), TIME - model.t))
        return model.energy()["kinetic"]

    return model.size()["points"], advance, kinetic


def taichi(n: int, precision: str, law: str, loops: str) -> Run:
    """v, C of a point carry over; F' = (I + dt C) F; m_i v_i = sum w_ip (m v + (m C - dt V0 tau 4/h2) (x_i - x_p))."""
    import taichi as ti

    real = getattr(ti, precision)
    ti.init(arch=ti.cpu, default_fp=real, cpu_max_num_threads=1, fast_math=True, offline_cache=False, log_level=ti.ERROR)
    serial, linear = loops == "serial", law == "linear"
    h, per_h, margin, points = 1.0 / n, float(n), 4, 4 * n * n
    nodes = n + 2 * margin + 1
    dt, volume = CFL * h / SPEED, 0.25 * h * h
    mass = DENSITY * volume

    x, v = ti.Vector.field(2, real, points), ti.Vector.field(2, real, points)
    C, F = ti.Matrix.field(2, 2, real, points), ti.Matrix.field(2, 2, real, points)
    momentum, nodal_mass = ti.Vector.field(2, real, (nodes, nodes)), ti.field(real, (nodes, nodes))
    start = lattice(n)
    x.from_numpy(start)
    v.from_numpy(velocity(start.T).T)
    F.from_numpy(np.tile(np.eye(2), (points, 1, 1)))

    @ti.func
    def weights(at):
        s = at * per_h + margin
        first = ti.cast(s - 0.5, ti.i32)
        r = s - first
        return first, r, [0.5 * (1.5 - r) ** 2, 0.75 - (r - 1.0) ** 2, 0.5 * (r - 0.5) ** 2]

    @ti.func
    def stress(A):
        I = ti.Matrix.identity(real, 2)
        tau = ti.Matrix.zero(real, 2, 2)
        if ti.static(linear):
            tau = G * (A + A.transpose() - 2.0 * I) + LAM * (A.trace() - 2.0) * I
        else:
            tau = G * (A @ A.transpose() - I) + LAM * ti.log(A.determinant()) * I
        return tau

    @ti.kernel
    def step():
        ti.loop_config(serialize=serial)
        for node in ti.grouped(nodal_mass):
            momentum[node] = ti.Vector.zero(real, 2)
            nodal_mass[node] = 0.0
        ti.loop_config(serialize=serial)
        for p in range(points):
            first, r, w = weights(x[p])
            new = F[p] + dt * (C[p] @ F[p])
            F[p] = new
            affine = (-4.0 * dt * volume * per_h * per_h) * stress(new) + mass * C[p]
            at_first = mass * v[p] - affine @ (r * h)
            for i, j in ti.static(ti.ndrange(3, 3)):
                weight = w[i][0] * w[j][1]
                node = first + ti.Vector([i, j])
                momentum[node] += weight * (at_first + affine @ ti.Vector([i * h, j * h]))
                nodal_mass[node] += weight * mass
        ti.loop_config(serialize=serial)
        for node in ti.grouped(nodal_mass):
            if nodal_mass[node] > 0.0:
                momentum[node] /= nodal_mass[node]
        ti.loop_config(serialize=serial)
        for p in range(points):
            first, r, w = weights(x[p])
            mean = ti.Vector.zero(real, 2)
            affine = ti.Matrix.zero(real, 2, 2)
            for i, j in ti.static(ti.ndrange(3, 3)):
                part = w[i][0] * w[j][1] * momentum[first + ti.Vector([i, j])]
                mean += part
                affine += part.outer_product(ti.Vector([i, j]) - r)
            v[p], C[p] = mean, 4.0 * per_h * affine
            x[p] += dt * mean

    def advance(steps: int) -> None:
        for _ in range(steps):
            step()
        ti.sync()

    def kinetic() -> float:
        advance(PROOF)
        return float(0.5 * mass * (v.to_numpy().astype(float) ** 2).sum())

    return points, advance, kinetic


def lattice(n: int) -> np.ndarray:
    """Positions (4 n2, 2) of the points of n x n cells of the unit square, cell by cell."""
    i, j, a, b = np.meshgrid(np.arange(n), np.arange(n), (0.25, 0.75), (0.25, 0.75), indexing="ij")
    return np.column_stack([(i + a).ravel(), (j + b).ravel()]) / n


def kratos(n: int, scheme: str) -> Run:
    import KratosMultiphysics as Kratos
    import KratosMultiphysics.MPMApplication as Mpm
    from KratosMultiphysics.MPMApplication.mpm_analysis import MpmAnalysis

    Kratos.Logger.GetDefaultOutput().SetSeverity(Kratos.Logger.Severity.WARNING)
    Kratos.ParallelUtilities.SetNumThreads(1)
    model = Kratos.Model()
    with tempfile.TemporaryDirectory() as folder:
        analysis = MpmAnalysis(model, Kratos.Parameters(json.dumps(kratos_case(Path(folder), n, scheme))))
        analysis.Initialize()
    part = model["MPM_Material"]
    info, elements = part.ProcessInfo, list(part.Elements)
    for element in elements:
        at = np.array(element.CalculateOnIntegrationPoints(Mpm.MP_COORD, info)[0])
        element.SetValuesOnIntegrationPoints(Mpm.MP_VELOCITY, [Kratos.Vector([*velocity(at[:2]), 0.0])], info)

    def advance(steps: int) -> None:
        analysis.end_time = analysis.time + (steps - 0.5) * CFL / n / SPEED
        analysis.RunSolutionLoop()

    def kinetic() -> float:
        advance(PROOF)
        total = 0.0
        for element in part.Elements:
            mass = element.CalculateOnIntegrationPoints(Mpm.MP_MASS, info)[0]
            v = np.array(element.CalculateOnIntegrationPoints(Mpm.MP_VELOCITY, info)[0])
            total += 0.5 * mass * float(v @ v)
        return total

    return len(elements), advance, kinetic


def kratos_case(folder: Path, n: int, scheme: str) -> dict[str, Any]:
    """Writes grid, body and material to the folder; returns the project parameters."""
    margin = max(2, n // 10)
    write_mdpa(folder / "grid.mdpa", n + 2 * margin, 1.0 / n, -margin / n, "Element2D4N", "Parts_grid")
    write_mdpa(folder / "body.mdpa", n, 1.0 / n, 0.0, "MPMUpdatedLagrangian2D4N", "Parts_body")
    variables = {
        "THICKNESS": 1.0,
        "MATERIAL_POINTS_PER_ELEMENT": 4,
        "DENSITY": DENSITY,
        "YOUNG_MODULUS": E,
        "POISSON_RATIO": NU,
    }
    material = {
        "model_part_name": "Initial_MPM_Material.Parts_body",
        "properties_id": 1,
        "Material": {
            "constitutive_law": {"name": "LinearElasticIsotropicPlaneStrain2DLaw"},
            "Variables": variables,
            "Tables": {},
        },
    }
    (folder / "material.json").write_text(json.dumps({"properties": [material]}))
    search = {
        "search_algorithm_type": "bin_based",
        "max_number_of_results": 1000,
        "searching_tolerance": 1e-5,
        "remove_entities_not_found": False,
    }
    return {
        "problem_data": {
            "problem_name": "square",
            "parallel_type": "OpenMP",
            "echo_level": 0,
            "start_time": 0.0,
            "end_time": 1.0,
        },
        "solver_settings": {
            "solver_type": "Dynamic",
            "model_part_name": "MPM_Material",
            "domain_size": 2,
            "echo_level": 0,
            "analysis_type": "linear",
            "time_integration_method": "explicit",
            "scheme_type": "forward_euler",
            "stress_update": scheme,
            "grid_model_import_settings": {"input_type": "mdpa", "input_filename": str(folder / "grid")},
            "model_import_settings": {"input_type": "mdpa", "input_filename": str(folder / "body")},
            "material_import_settings": {"materials_filename": str(folder / "material.json")},
            "time_stepping": {"time_step": CFL / n / SPEED},
            "element_search_settings": search,
            "problem_domain_sub_model_part_list": ["Parts_grid", "Parts_body"],
            "processes_sub_model_part_list": [],
        },
        "processes": {"none": []},
    }


def write_mdpa(path: Path, cells: int, h: float, low: float, element: str, group: str) -> None:
    """A square of cells x cells quadrilaterals from (low, low) on, all in one group."""
    nodes, side = np.arange(1, (cells + 1) ** 2 + 1), cells + 1
    corner = (nodes.reshape(side, side)[:-1, :-1]).ravel()
    lines = ["Begin Properties 0", "End Properties", "Begin Nodes"]
    lines += [f"{k} {low + h * ((k - 1) % side):.15g} {low + h * ((k - 1) // side):.15g} 0.0" for k in nodes]
    lines += ["End Nodes", f"Begin Elements {element}"]
    lines += [f"{e} 0 {c} {c + 1} {c + side + 1} {c + side}" for e, c in enumerate(corner, 1)]
    lines += [
        "End Elements",
        f"Begin SubModelPart {group}",
        "Begin SubModelPartNodes",
        *map(str, nodes),
        "End SubModelPartNodes",
    ]
    lines += [
        "Begin SubModelPartElements",
        *map(str, range(1, len(corner) + 1)),
        "End SubModelPartElements",
        "End SubModelPart",
    ]
    path.write_text("\n".join(lines) + "\n")


PACKAGES = {"geofem": ("geofem", "numba"), "taichi": ("taichi",), "kratos": ("KratosMPMApplication",)}
MODULES = {"geofem": "geofem", "taichi": "taichi", "kratos": "KratosMultiphysics"}
STEPS = {"geofem": 10, "taichi": 10, "kratos": 2}
"""In a block."""
CONTENDERS = [
    ("geofem", "mpm-linear", "linear"),
    ("geofem", "mpm-gimp", "linear"),
    ("geofem", "mpm-cpdi", "linear"),
    ("geofem", "mpm-bspline", "linear"),
    ("geofem", "mpm-bspline", "neo_hooke"),
    ("taichi", "f64", "linear", "serial"),
    ("taichi", "f64", "neo_hooke", "serial"),
    ("taichi", "f64", "linear", "usual"),
    ("taichi", "f64", "neo_hooke", "usual"),
    ("taichi", "f32", "linear", "serial"),
    ("taichi", "f32", "neo_hooke", "usual"),
    ("kratos", "usl"),
    ("kratos", "musl"),
]
MARKS = [
    (("geofem", "mpm-bspline", "linear"), ("taichi", "f64", "linear"), 3.0),
    (("geofem", "mpm-bspline", "neo_hooke"), ("taichi", "f64", "neo_hooke"), 3.0),
    (("geofem", "mpm-linear", "linear"), ("kratos",), 30.0),
]
"""Ours, the start of a peer's name, and the ratio to hold."""

Contender = tuple[str, ...]


def measure(contender: Contender) -> dict[str, Any] | None:
    """Million point-steps per CPU second, points, share of the kinetic energy left at ``TIME``; None if not there."""
    who, *how = contender
    if find_spec(MODULES[who]) is None:
        return None
    make: Callable[..., Run | None] = {"geofem": geofem, "taichi": taichi, "kratos": kratos}[who]
    coarse = make(COARSE, *how)
    if coarse is None:
        return None
    left = coarse[2]() / (0.5 * DENSITY * 0.01)  # 0.1 m/s, and the squares of the two cosines are 1/2 each in the mean
    run = make(N, *how)
    assert run is not None
    points, advance, _ = run
    advance(1)  # compiles
    least, steps = np.inf, STEPS[who]
    for _ in range(BLOCKS):
        start = time.process_time()
        advance(steps)
        least = min(least, time.process_time() - start)
    versions = ", ".join(f"{package} {version(package)}" for package in PACKAGES[who])
    return {"rate": steps * points / least / 1e6, "points": points, "left": left, "versions": versions}


def apart(contender: Contender) -> dict[str, Any] | None:
    """``measure`` in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, __file__, "--answer", str(answer), *contender]
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | ONE_THREAD)
        if done.returncode or not answer.exists():
            print(f"{' '.join(contender)} failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}", file=sys.stderr)
            return None
        return json.loads(answer.read_text())


def main(only: list[str]) -> None:
    """``only`` : the programs to run; all if empty."""
    contenders = [contender for contender in CONTENDERS if not only or contender[0] in only]
    best: dict[Contender, dict[str, Any]] = {}
    absent: set[Contender] = set()
    for _ in range(ROUNDS):
        for contender in contenders:
            found = None if contender in absent else apart(contender)
            if found is None:
                absent.add(contender)
            elif contender not in best or found["rate"] > best[contender]["rate"]:
                best[contender] = found
    left = np.median([found["left"] for found in best.values()])
    print("million point-steps per CPU second, one thread")
    print(f"{'':36s}{'points':>8s}{'rate':>8s}   kinetic energy left")
    for contender in contenders:
        name = f"{' '.join(contender):36s}"
        if contender in best:
            row = best[contender]
            wrong = "" if abs(row["left"] / left - 1) < 0.01 else "   NOT THE SAME PROBLEM"
            print(f"{name}{row['points']:8d}{row['rate']:8.3g}{row['left']:10.4f}   {row['versions']}{wrong}")
        else:
            print(f"{name} left out: not installed, not registered or failed")
    print()
    for ours, start, mark in MARKS:
        for peer in contenders:
            if peer[: len(start)] == start and peer in best and ours in best:
                ratio = best[ours]["rate"] / best[peer]["rate"]
                print(f"{' '.join(ours):32s} : {' '.join(peer):30s}{ratio:7.2f}   mark {mark:g}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("contender", nargs="*", help="geofem, taichi, kratos; all by default")
    parser.add_argument(
        "--answer", type=Path, help="measure the one contender of these words in this process, answer in a file"
    )
    arguments = parser.parse_args()
    if arguments.answer:
        arguments.answer.write_text(json.dumps(measure(tuple(arguments.contender))))
    else:
        main(arguments.contender)
