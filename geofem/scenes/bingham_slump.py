"""Slump of a yield-stress fluid: a column of mud spreads, and stops where its weight no longer moves it.

Set-up. A column of Bingham fluid in plane strain, H = 0.1 m high and as wide, against a smooth wall at x <= 0 (the plane of symmetry of
a column twice as wide), on a rough floor; at t = 0 the other wall is gone and gravity acts. Density 1000 kg/m3, plastic viscosity
5 Pa s, yield stress tau_y = `B` rho g H. Below the yield stress the fluid creeps with a viscosity of mu + `m` tau_y (Papanastasiou 1987).
Sound, for methods that need it, is ten times faster than sqrt(2 g H). The run lasts 20 sqrt(H / g), when all but the last
creep is over.

Measured. `run_out`: where the farthest of the fluid lies at the end, over H; `height`: the highest of it, over H. `rest`: the kinetic
energy at the end by the largest of the run.

Reference. A bracket by two theories of a thin layer that has just come to rest, whose floor bears tau_y everywhere. With the pressure
of its depth alone, rho g h dh/dx = -tau_y (Liu and Mei 1989): h**2 = 2 B H (x_f - x), and the volume H**2 gives x_f / H =
(9 / 8 B)**(1/3). A layer that yields throughout also bears normal stresses along x, sigma_x - sigma_y = 2 (tau_y**2 - tau_xy**2)**(1/2)
with tau_xy = tau_y (1 - y / h), a pull of pi tau_y h / 2 in all: (h - pi B H / 2) dh/dx = -B H, a shape that ends in a blunt front, pi
B H high, and is shorter and higher (to that order as in Dubash and others 2009). Both leave out inertia, which carries the
fluid on, and a core below the middle that never yields, which holds it back: 5 % beyond either is allowed.

What must fail. A mesh that follows the fluid tangles as its front rolls over the floor. With `m` small the fluid never stops; with `m`
large the solver meets a kink. An explicit method is unstable if its step exceeds the time in which the viscosity mu + `m` tau_y
levels out a cell: material points need a hundred times smaller steps here than sound asks for.

Length. The height of the column, H.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geofem.reference import reference
from geofem.scene import Box, History, Load, Material, Measure, Probe, Region, Scene, Wall
from geofem.scenes._parts import at_most, check_number

H, G, DENSITY, VISCOSITY = 0.1, 9.81, 1000.0, 5.0
SOUND = 10 * math.sqrt(2 * G * H)
UNIT = math.sqrt(H / G)
END = 20 * UNIT
MARGIN = 0.05


def thin(B: float) -> tuple[float, float]:
    """Run-out and height over H with the pressure of the depth alone."""
    run_out = (9 / (8 * B)) ** (1 / 3)
    return run_out, math.sqrt(2 * B * run_out)


def yielding(B: float) -> tuple[float, float]:
    """Run-out and height over H with the normal stresses of a layer that yields throughout: h = e + (e**2 + 2 B (x_f - x))**(1/2)
    with e = pi B / 2, and the area 1."""
    e = 0.5 * math.pi * B

    def area(run_out: float) -> float:
        return e * run_out + ((e * e + 2 * B * run_out) ** 1.5 - e**3) / (3 * B)

    low, high = 0.0, thin(B)[0]  # the area is 0 at 0, and above 1 at the run-out of the thin layer
    for _ in range(60):
        run_out = 0.5 * (low + high)
        low, high = (run_out, high) if area(run_out) < 1.0 else (low, run_out)
    return run_out, e + math.sqrt(e * e + 2 * B * run_out)


def rest(history: History) -> float:
    """Kinetic energy at the end by the largest one."""
    most = float(np.max(history["kinetic"]))
    return float(history["kinetic"][-1]) / most if most > 0 else 0.0


def scene(*, B: float = 0.05, m: float = 20.0) -> Scene:
    """Knobs

    B : Bingham number, the yield stress over rho g H, dimensionless; default 0.05.
    m : time of regularisation (s); default 20.
    """
    check_number("bingham_slump", "B", B, 0.01, 0.1)
    check_number("bingham_slump", "m", m, 0.1, 1e4)
    far, flat = thin(B)
    near, steep = yielding(B)
    mud = Material("bingham", DENSITY, {"mu": VISCOSITY, "tau_y": B * DENSITY * G * H, "m": m, "K": DENSITY * SOUND**2})
    return Scene(
        name="bingham_slump",
        regions=(Region("mud", Box((0.0, 0.0), (H, H)), mud),),
        length=H,
        supports=(),
        loads=(Load("gravity", (0.0, -G)),),
        probes=(
            Probe("front", "quantile", component=0, share=1.0),
            Probe("top", "quantile", component=1, share=1.0),
        ),
        measures=(
            Measure(
                "run_out",
                "-",
                lambda history: float(history["front"][-1]) / H,
                reference=replace(
                    reference("f07_bingham_slump", "run_out"), lower=(1 - MARGIN) * near, upper=(1 + MARGIN) * far
                ),
            ),
            Measure(
                "height",
                "-",
                lambda history: float(history["top"][-1]) / H,
                reference=replace(
                    reference("f07_bingham_slump", "height"), lower=(1 - MARGIN) * flat, upper=(1 + MARGIN) * steep
                ),
            ),
            Measure("rest", "-", rest),
        ),
        dynamic=True,
        t_end=END,
        walls=(
            Wall("floor", at_most(1, 0.0), (0.0, 1.0), math.inf),
            Wall("symmetry", at_most(0, 0.0), (1.0, 0.0)),
        ),
        room=Box((0.0, 0.0), (2 * far * H, 1.2 * H)),
        at=lambda t: {"T": t / UNIT},
        savings={"symmetry": 0.5},
        knobs={"B": B, "m": m},
    )
