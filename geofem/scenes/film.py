"""Steady flow of a layer down a slope: what comes in above leaves below, with the profile of its law.

Set-up. A stretch of length 3 H of an endless layer of depth H = 0.1 m in plane strain on a rough plane that is inclined by `slope`;
x runs down the plane and y across it. Material comes in through the inlet with the exact profile, has it everywhere at t = 0, and
leaves through the outlet, on which the rest of the layer acts with the exact traction. The run lasts until the surface has gone 9 H.
Laws: `newtonian` (mud, density 1000 kg/m3, mu = 30 Pa s), `bingham` (the same with a yield stress of 0.3 of the shear stress at the
floor, m = 100 s), `mu_i` (grains of 10 mm: mu_s = 0.382, mu_2 = 0.643, I_0 = 0.279 of Jop and others 2006; bulk density 1500,
grains 2500 kg/m3).

Measured. Errors `velocity` and `pressure`: root mean square over the layer, as the mean over the second half of the run, by the
speed of the surface and by rho g H.
`discharge`: volume that left through the outlet, by that of the exact profile. `depth`: the mean one, over H.

Reference. Exact: the shear stress rho g (H - y) sin(slope) and the pressure rho g (H - y) cos(slope) carry the weight whatever the
law. Its rate of shear gives a parabola (Nusselt 1916), a parabola below a plug (Bingham), and for grains, which have the same
inertial number at all depths, u = 2/3 I/d (rho g cos(slope) / rho_s)**(1/2) (H**(3/2) - (H - y)**(3/2)) (GDR MiDi 2004).

What must fail. A mesh that follows the material is sheared without end: without new cells it tangles. Grains on a slope below
atan(mu_s) stop, and beyond atan(mu_2) have no steady flow: such slopes are refused.

Length. The depth, H.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Array, Box, History, Inlet, Load, Material, Measure, Outlet, Probe, Region, Scene, Wall
from geofem.scenes._parts import all_of, at_least, at_most, check_choice, check_number

H, G, LONG = 0.1, 9.81, 3.0
MUD, VISCOSITY, YIELD = 1000.0, 30.0, 0.3
BULK, GRAINS, GRAIN = 1500.0, 2500.0, 0.01
MU_S, MU_2, I_0 = 0.382, 0.643, 0.279
SOUND = 10 * math.sqrt(2 * G * H)
LAWS = ("newtonian", "bingham", "mu_i")


def material(law: str, angle: float) -> Material:
    """The material on a slope of that angle (rad)."""
    if law == "mu_i":
        elastic = {"E": 1e6, "nu": 0.3}
        return Material(law, BULK, elastic | {"mu_s": MU_S, "mu_2": MU_2, "I_0": I_0, "d": GRAIN, "rho_s": GRAINS})
    par = {"mu": VISCOSITY, "K": MUD * SOUND**2}
    if law == "bingham":
        par |= {"tau_y": YIELD * MUD * G * H * math.sin(angle), "m": 100.0}
    return Material(law, MUD, par)


def profile(law: str, angle: float, y: Array) -> Array:
    """Velocity (n,) (m/s) down the slope of that angle (rad) at heights y (n,) (m) over the floor."""
    y = np.clip(y, 0.0, H)
    if law == "mu_i":
        number = I_0 * (math.tan(angle) - MU_S) / (MU_2 - math.tan(angle))
        scale = 2 / 3 * number / GRAIN * math.sqrt(BULK * G * math.cos(angle) / GRAINS)
        return scale * (H**1.5 - (H - y) ** 1.5)
    top = H if law == "newtonian" else (1 - YIELD) * H
    y = np.minimum(y, top)
    return MUD * G * math.sin(angle) / VISCOSITY * y * (top - 0.5 * y)


def late(history: History, name: str) -> float:
    """Mean over the second half of the run."""
    t, sampled = history["t"], history[name]
    half = t >= 0.5 * t[-1]
    return float(np.trapezoid(sampled[half], t[half]) / np.ptp(t[half]))


def scene(*, law: str = "newtonian", slope: float = 25.0) -> Scene:
    """Knobs

    law : ``newtonian``, ``bingham`` or ``mu_i``; default ``newtonian``.
    slope : inclination of the plane (degrees); default 25; grains need 20.9 to 32.7.
    """
    check_choice("film", "law", law, LAWS)
    check_number("film", "slope", slope, 1.0, 60.0)
    angle = math.radians(slope)
    if law == "mu_i" and not MU_S < math.tan(angle) < MU_2:
        low, high = (math.degrees(math.atan(mu)) for mu in (MU_S, MU_2))
        raise Mistake(f"scene film: grains flow steadily on slopes between {low:.4g} and {high:.4g} degrees, not at {slope:g}")
    made = material(law, angle)
    weight = made.density * G * np.array([math.sin(angle), -math.cos(angle)])

    def velocity(x: Array, t: float = 0.0) -> Array:
        return np.array([profile(law, angle, x[1]), np.zeros_like(x[1])])

    def pressure(x: Array, t: float) -> Array:
        return -weight[1] * (H - x[1])

    def traction(x: Array, t: float) -> Array:
        return np.array([-pressure(x, t), weight[0] * (H - x[1])])

    length, speed = LONG * H, float(profile(law, angle, np.array([H]))[0])
    t_end = 3 * length / speed
    points = np.linspace(0.0, H, 2001)
    flux = float(np.trapezoid(profile(law, angle, points), points))
    open_ = all_of(at_least(1, 0.0), at_most(1, 2 * H))
    return Scene(
        name="film",
        regions=(Region("layer", Box((0.0, 0.0), (length, H)), made),),
        length=H,
        supports=(),
        loads=(Load("gravity", tuple(weight / made.density)),),
        probes=(
            Probe("velocity_error", "velocity_error", exact=velocity),
            Probe("pressure_error", "pressure_error", exact=pressure),
            Probe("outflow", "outflow"),
            Probe("volume", "volume"),
        ),
        measures=(
            Measure(
                "velocity",
                "-",
                error=lambda history: late(history, "velocity_error") / speed,
                reference=reference("f08_film", "velocity"),
            ),
            Measure(
                "pressure",
                "-",
                error=lambda history: late(history, "pressure_error") / (made.density * G * H),
                reference=reference("f08_film", "pressure"),
            ),
            Measure(
                "discharge",
                "-",
                lambda history: float(history["outflow"][-1]) / (flux * t_end),
                reference=reference("f08_film", "discharge"),
            ),
            Measure(
                "depth",
                "-",
                lambda history: float(history["volume"][-1]) / (length * H),
                reference=reference("f08_film", "depth"),
            ),
        ),
        dynamic=True,
        t_end=t_end,
        initial_velocity=velocity,
        walls=(Wall("floor", at_most(1, 0.0), (0.0, 1.0), math.inf),),
        inlets=(Inlet("above", all_of(at_most(0, 0.0), open_), (1.0, 0.0), velocity),),
        outlets=(Outlet("below", all_of(at_least(0, length), open_), (-1.0, 0.0), traction),),
        room=Box((0.0, 0.0), (length, 1.5 * H)),
        knobs={"law": law, "slope": slope},
    )
