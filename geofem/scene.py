"""What is to be solved, described once and for every method: geometry, materials, supports, loads, and what to measure.

Every function of position in a scene takes ``x`` of shape (gdim, n), the coordinates of n *material* points in the
reference configuration, and answers with one column per point. A support's ``where`` must be true on the support and
beyond it outside the body (``x[0] <= 0``, never ``x[0] == 0``), so that a background grid can use it as well.
Units are SI unless a scene says that it is dimensionless. Compression is negative.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from geofem.mistake import Mistake
from geofem.shapes import Array, Box, Point, Polygon, Shape
from geofem.shapes import Disc as Disc
from geofem.shapes import MeshFile as MeshFile
from geofem.shapes import Ring as Ring

Where = Callable[[Array], Array] | str
"""A predicate on reference coordinates, (gdim, n) -> (n,) bool, or the name of a physical group of a mesh file."""
History = Mapping[str, Array]
"""What a run sampled: ``t``, one array per probe, and the energies ``kinetic``, ``internal`` and ``external`` (J)."""

PLANES = ("plane_strain", "plane_stress", "axisymmetric", "solid")


def no_parameters() -> Mapping[str, float]:
    return MappingProxyType({})


# --- what it is made of -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Material:
    """A law by its registered name, its density (kg/m3) and its parameters; checked by ``geofem.materials.check``."""

    law: str
    density: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=no_parameters)


@dataclass(frozen=True)
class Region:
    """A body: a shape made of one material."""

    name: str
    shape: Shape
    material: Material


# --- what acts on it --------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Support:
    """Prescribed displacement components on the part of the boundary that ``where`` picks.

    ``value`` (m) is None for zero, or a function (x, t) -> (n,) of the reference position and time, the same for every
    component named, so that components with different values are different supports.
    """

    name: str
    where: Where
    components: tuple[int, ...]
    value: Callable[[Array, float], Array] | None = None


@dataclass(frozen=True)
class Wall:
    """A fixed plane that stops the bodies where ``where`` is true, and lets go of what moves away from it.

    where : predicate, true on the wall and beyond it; unlike that of a support it is asked of *present* positions.
    normal : unit vector along an axis, from the wall towards the bodies.
    friction : Coulomb's coefficient; 0 is a smooth wall, ``math.inf`` a rough one.
    """

    name: str
    where: Callable[[Array], Array]
    normal: Point
    friction: float = 0.0

    def __post_init__(self) -> None:
        check_normal("wall", self.name, self.normal)
        if not self.friction >= 0:
            raise Mistake(f"wall {self.name}: friction = {self.friction:g} must not be negative")


def check_normal(kind: str, name: str, normal: Point) -> None:
    """Raises ``Mistake`` unless the normal of a plane is a unit vector along an axis."""
    if sorted(map(abs, normal)) != [0.0] * (len(normal) - 1) + [1.0]:
        raise Mistake(f"{kind} {name}: normal is a unit vector along an axis, like (0, 1), not {normal}")


@dataclass(frozen=True)
class Inlet:
    """An opening through which material comes in; a body lies on it from the start.

    where : predicate of *present* positions, true on the opening and beyond it, as that of a wall.
    normal : unit vector along an axis, from the opening into the body.
    velocity : (x, t) -> (gdim, n) velocity (m/s) of what comes in at the places x; it does not point out of the body.
    """

    name: str
    where: Callable[[Array], Array]
    normal: Point
    velocity: Callable[[Array, float], Array]

    def __post_init__(self) -> None:
        check_normal("inlet", self.name, self.normal)


@dataclass(frozen=True)
class Outlet:
    """An opening through which material leaves: what has passed it is gone.

    where : predicate of *present* positions, true on the opening and beyond it, as that of a wall.
    normal : unit vector along an axis, from the opening towards the bodies.
    traction : (x, t) -> (gdim, n) traction (Pa) at the places x with which what is beyond acts on what is still there; None: none.
    """

    name: str
    where: Callable[[Array], Array]
    normal: Point
    traction: Callable[[Array, float], Array] | None = None

    def __post_init__(self) -> None:
        check_normal("outlet", self.name, self.normal)


@dataclass(frozen=True)
class Rigid:
    """A rigid body that moves as told and touches the bodies: they slide along it with Coulomb's friction and may part from it.

    shape : a convex polygon at t = 0.
    motion : t -> displacement (m) of the rigid body, a translation; None if it stands still.
    friction : Coulomb's coefficient; 0 is smooth, ``math.inf`` is rough.
    """

    name: str
    shape: Polygon
    motion: Callable[[float], Point] | None = None
    friction: float = 0.0

    def __post_init__(self) -> None:
        p = np.array(self.shape.points)
        side = np.roll(p, -1, axis=0) - p
        after = np.roll(side, -1, axis=0)
        if np.any(side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0] <= 0):
            raise Mistake(f"rigid body {self.name}: its polygon must be convex, without corners of 180 degrees")
        if not self.friction >= 0:
            raise Mistake(f"rigid body {self.name}: friction = {self.friction:g} must not be negative")


@dataclass(frozen=True)
class Load:
    """A load and how it grows.

    kind : ``gravity`` (value: acceleration vector, m/s2), ``body`` (value: a function (x, t) -> (gdim, n), force per mass, m/s2),
        ``traction`` (value: dead force per reference area, Pa), ``pressure`` (value: scalar, Pa, follows the boundary,
        positive when it pushes into the body).
    where : for tractions and pressures, the part of the boundary.
    amplitude : factor as a function of t; by default t itself (a ramp to 1) in a static scene, and 1 in a dynamic one
        and where cracks grow.
    """

    kind: str
    value: Any
    where: Where | None = None
    amplitude: Callable[[float], float] | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("gravity", "body", "traction", "pressure"):
            raise Mistake(f"Load: kind is gravity, body, traction or pressure, not {self.kind!r}")
        if self.kind in ("traction", "pressure") and self.where is None:
            raise Mistake(f"Load: a {self.kind} needs 'where', the part of the boundary it acts on")


@dataclass(frozen=True)
class Cohesion:
    """Traction that faces which part still bear: rigid up to the ``strength`` (Pa), then falling linearly with the opening until
    the ``energy`` (J/m2) is spent; unloading goes straight to the origin."""

    strength: float
    energy: float

    def __post_init__(self) -> None:
        if not (self.strength > 0 and self.energy > 0):
            raise Mistake(f"Cohesion: strength = {self.strength:g} Pa and energy = {self.energy:g} J/m2 must be positive")


@dataclass(frozen=True)
class Crack:
    """A crack: a polyline through ``points`` (2D); its end points that lie inside a body are tips.

    pressure : (x, t) -> (n,) of a fluid that pushes the faces apart (Pa), without further amplitude; None: the faces are dry.
    friction : Coulomb's coefficient of faces that touch; 0 is smooth, None: they do not feel each other and may overlap.
    cohesion : of faces that do not hold by more than that; they touch, without friction. None: they part freely.
    """

    points: tuple[Point, ...]
    pressure: Callable[[Array, float], Array] | None = None
    friction: float | None = None
    cohesion: Cohesion | None = None

    def __post_init__(self) -> None:
        if self.friction is not None and not self.friction >= 0:
            raise Mistake(f"Crack: friction = {self.friction:g} must not be negative")
        if self.friction and self.cohesion:
            raise Mistake("Crack: gives both friction and cohesion; choose one, as cohesive faces touch without friction")


CRITERIA = ("hoop", "energy", "symmetry")


@dataclass(frozen=True)
class Growth:
    """How the cracks of a scene grow under its loads, which act in full from the start: t is the way of the fastest tip (m).

    length : how far the fastest tip goes (m); the scene's ``t_end``.
    criterion : which way a tip turns: hoop, energy or symmetry, see ``geofem.core.growth``.
    toughness : K_Ic (Pa sqrt(m)): the load is taken so that the most loaded tip just moves, and others stay. Fields and factors
        remain those of the scene's load; ``load`` is the factor on it.
    paris : C and m of da/dN = C dK^m (m per cycle, K in Pa sqrt(m)) for a load that pulsates from zero: tips go on in
        proportion to their rates, and cycles are counted (Paris and Erdogan 1963).
    threshold : K (Pa sqrt(m)) up to which a tip stays.
    strength : tensile strength (Pa): where the largest principal stress exceeds it, on the boundary or inside, a straight
        crack of the length ``germ`` (m) opens across it, no nearer to other cracks than that length.
    """

    length: float
    criterion: str = "hoop"
    toughness: float | None = None
    paris: tuple[float, float] | None = None
    threshold: float = 0.0
    strength: float | None = None
    germ: float | None = None

    def __post_init__(self) -> None:
        if not self.length > 0:
            raise Mistake(f"Growth: the length that the fastest tip goes is positive (m), not {self.length:g}")
        if self.criterion not in CRITERIA:
            raise Mistake(f"Growth: the criterion is one of {', '.join(CRITERIA)}, not {self.criterion!r}")
        if self.toughness is not None and (self.paris is not None or not self.toughness > 0):
            raise Mistake(
                "Growth: toughness is positive, and for a load that rises; Paris' law is for one that pulsates: give one"
            )
        if self.paris is not None and not (len(self.paris) == 2 and self.paris[0] > 0 and self.paris[1] > 0):
            raise Mistake(f"Growth: Paris' law has two positive constants, C and m, not {self.paris}")
        if not self.threshold >= 0:
            raise Mistake(f"Growth: the threshold of K must not be negative, got {self.threshold:g}")
        if (self.strength is None) != (self.germ is None) or not all(x is None or x > 0 for x in (self.strength, self.germ)):
            raise Mistake("Growth: for cracks to be born give both, a positive strength (Pa) and their length germ (m)")


# --- what is measured -------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Probe:
    """A number sampled along the run; how is the model's affair, only it knows its fields.

    quantity :
        ``displacement``, ``velocity`` component of the material point ``at`` (reference coordinates);
        ``stress`` Cauchy stress component (0..5 for xx, yy, zz, xy, yz, xz) at the material point ``at``;
        ``reaction`` component of the force (N, per metre in plane strain, per radian in axisymmetry) that the support, wall,
        rigid body or inlet ``of`` exerts on the bodies;
        ``quantile`` coordinate ``component`` (m) below which ``share`` of the mass lies: the front of a flow, its height;
        ``mean_velocity`` component of the velocity of the centre of mass;
        ``largest_speed`` largest magnitude of the velocity (m/s) over all nodes or material points;
        ``volume`` of the bodies now (m2 in the plane, m3);
        ``inflow``, ``outflow`` volume (m2 in the plane) that came in through all inlets, and left through all outlets, so far;
        ``pressure_error`` root mean square over the body of p - exact(x, t) (Pa) at *present* positions x, exact: (x, t) -> (n,),
        with the pressure p, a third of minus the trace of the stress;
        ``velocity_error`` root mean square over the body of |v - exact(x, t)| (m/s) at *present* positions x, exact: -> (gdim, n);
        ``displacement_error`` root mean square over the body of |u - exact(x, t)| (m), exact: (x, t) -> (gdim, n);
        ``energy_error`` square root of the strain energy (J) of u minus a displacement of gradient exact: (x, t) -> (gdim, gdim, n);
        ``KI``, ``KII`` stress intensity factor (Pa sqrt(m)) of the crack tip that started nearest to the point ``at``; 0 once it
        has stopped;
        ``T`` regular stress along the axis (Pa) at that tip;
        ``opening`` normal jump (m) of the displacement across the crack nearest to the point ``at``, negative where faces overlap;
        ``opening_error`` root mean square over all cracks of opening - exact(x, t) (m), exact: (x, t) -> (n,);
        ``tip`` coordinate ``component`` (m) of that tip, where cracks grow;
        ``load`` the factor on the loads at which the most loaded tip moves, ``cycles`` of load so far; see ``Growth``.
    """

    name: str
    quantity: str
    at: Point | None = None
    component: int = 0
    of: str | None = None
    exact: Callable[[Array, float], Array] | None = None
    share: float = 1.0


@dataclass(frozen=True)
class Reference:
    """What a quantity ought to be, and how we know.

    kind : ``exact``, ``overkill``, ``bracket`` (limit analysis), ``experiment``, ``cross-method``.
    value : a number, or None for a bracket or a band, which has ``lower`` and ``upper``, and for what nobody knows yet.
    """

    kind: str
    source: str
    value: float | None = None
    lower: float | None = None
    upper: float | None = None

    @property
    def known(self) -> bool:
        """Whether there is a number or a band to compare with."""
        return self.value is not None or (self.lower is not None and self.upper is not None)

    def error(self, quantity: float) -> float:
        """Relative error of a number; for a bracket or a band, the relative distance to it (zero inside)."""
        if self.lower is not None and self.upper is not None:
            return max(0.0, quantity - self.upper, self.lower - quantity) / abs(0.5 * (self.lower + self.upper))
        assert self.value is not None
        scale = abs(self.value) or 1.0
        return abs(quantity - self.value) / scale


@dataclass(frozen=True)
class Measure:
    """A quantity of interest: a number taken from the history of a run.

    value : (history) -> number, or None for a measure that is an error only, like that of a whole field or curve.
    error : (history) -> relative error; by default that of ``value`` against ``reference``.
    """

    name: str
    unit: str
    value: Callable[[History], float] | None = None
    error: Callable[[History], float] | None = None
    reference: Reference | None = None


@dataclass(frozen=True)
class Scene:
    """One problem, for every method.

    length : the scene's own length (m): ``n`` cells of a method lie across it.
    strain : ``small`` or ``finite``.
    dynamic : False: inertia is ignored, t is a load factor and 0 < t <= t_end is reached in steps.
    growth : how the cracks grow; then t is the way of the fastest tip (m), and t_end its length.
    period : the time (s) of one oscillation of a dynamic scene, by which methods choose their step; t_end if None.
    singular : points where the exact stress is singular or jumps: a method may grade its cells towards them.
    walls, rigids : what the bodies may touch and leave again. inlets, outlets : where material comes in and leaves.
    room : a box around all that the bodies will do, for methods with a background grid.
    intact : True if the bodies hold together however far they are stretched; a method in which they part has failed.
    collapse : True if the run is to find the t at which equilibrium is lost, and to end there with status ``ok``.
    weakening : t -> factor by which the strength (c and tan phi) is divided at t (strength reduction).
    at : t -> where the run stands in the scene's own terms, like {"amplitude": 0.3}; a failure is reported with it.
    savings : what was not modelled and why, as factors: {"symmetry": 0.5} solves half of the full body.
    dimensionless : True if lengths and stresses have no unit, so that pictures show none.
    knobs : the values of the scene's own knobs that it was made with.
    """

    name: str
    regions: tuple[Region, ...]
    length: float
    supports: tuple[Support, ...]
    loads: tuple[Load, ...] = ()
    probes: tuple[Probe, ...] = ()
    measures: tuple[Measure, ...] = ()
    plane: str = "plane_strain"
    strain: str = "finite"
    dynamic: bool = False
    t_end: float = 1.0
    period: float | None = None
    initial_velocity: Callable[[Array], Array] | None = None
    cracks: tuple[Crack, ...] = ()
    growth: Growth | None = None
    walls: tuple[Wall, ...] = ()
    rigids: tuple[Rigid, ...] = ()
    inlets: tuple[Inlet, ...] = ()
    outlets: tuple[Outlet, ...] = ()
    singular: tuple[Point, ...] = ()
    room: Box | None = None
    intact: bool = False
    collapse: bool = False
    weakening: Callable[[float], float] | None = None
    at: Callable[[float], Mapping[str, float]] | None = None
    savings: Mapping[str, float] = field(default_factory=no_parameters)
    dimensionless: bool = False
    knobs: Mapping[str, Any] = field(default_factory=no_parameters)

    def __post_init__(self) -> None:
        if self.plane not in PLANES:
            raise Mistake(f"scene {self.name}: plane is one of {', '.join(PLANES)}, not {self.plane!r}")
        if self.strain not in ("small", "finite"):
            raise Mistake(f"scene {self.name}: strain is small or finite, not {self.strain!r}")
        if not self.regions:
            raise Mistake(f"scene {self.name}: has no region; give it at least one body")
        if self.growth is not None:
            if not self.cracks and self.growth.strength is None:
                raise Mistake(f"scene {self.name}: has no crack that could grow; give it one, or its growth a strength")
            object.__setattr__(self, "t_end", self.growth.length)
        parts: tuple[Support | Wall | Rigid | Inlet, ...] = (*self.supports, *self.walls, *self.rigids, *self.inlets)
        names = [part.name for part in parts]
        for probe in self.probes:
            if probe.quantity in ("inflow", "outflow") and not getattr(self, probe.quantity.replace("flow", "lets")):
                raise Mistake(
                    f"scene {self.name}: probe {probe.name!r} measures the {probe.quantity}, but nothing is open for it"
                )
            if probe.quantity == "reaction" and probe.of not in names:
                raise Mistake(f"scene {self.name}: probe {probe.name!r} measures the reaction of unknown support {probe.of!r}")

    @property
    def gdim(self) -> int:
        return 3 if self.plane == "solid" else 2

    def amplitude(self, load: Load, t: float) -> float:
        """The factor of a load at time t."""
        if load.amplitude is not None:
            return load.amplitude(t)
        return 1.0 if self.dynamic or self.growth is not None else t
