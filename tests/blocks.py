"""What the tests of ``fem`` share: small scenes of blocks whose exact answer is a polynomial, and a run that must succeed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import geofem
from geofem import Box, Load, Material, Probe, Region, Result, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most

Array = np.ndarray
STRESSES = {2: ("xx", "yy", "zz", "xy"), 3: ("xx", "yy", "zz", "xy", "yz", "xz")}
STEEL = Material("linear_elastic", 2.0, {"E": 1000.0, "nu": 0.3})
RUBBER = Material("neo_hooke", 2.0, {"E": 1000.0, "nu": 0.3})


def solved(scene: str | Scene, **knobs: Any) -> Result:
    """The result of ``fem`` on a scene, which must have come to its end."""
    result = geofem.run(scene, "fem", **knobs)
    assert result.status == "ok", result.message
    return result


def last(result: Result, *names: str) -> Array:
    """The last values of the probes of these names."""
    return np.array([result.history[name][-1] for name in names])


def rollers(gdim: int) -> tuple[Support, ...]:
    """Supports that hold the block's lowest face in each direction, and nothing else."""
    return tuple(Support(f"roller_{i}", at_most(i, 0.0), (i,)) for i in range(gdim))


def faces(gdim: int) -> Callable[[Array], Array]:
    """The whole boundary of the unit block."""
    return any_of(*(at_most(i, 0.0) for i in range(gdim)), *(at_least(i, 1.0) for i in range(gdim)))


def stresses(at: tuple[float, ...]) -> tuple[Probe, ...]:
    """Probes of all Cauchy stresses at a point, named xx, yy, ..."""
    return tuple(Probe(name, "stress", at=at, component=k) for k, name in enumerate(STRESSES[len(at)]))


def displacements(at: tuple[float, ...]) -> tuple[Probe, ...]:
    """Probes of all displacements of a point, named u0, u1, ..."""
    return tuple(Probe(f"u{i}", "displacement", at=at, component=i) for i in range(len(at)))


def block(gdim: int, material: Material = STEEL, supports: tuple[Support, ...] | None = None, loads: tuple[Load, ...] = (),
          corner: tuple[float, ...] | None = None, inside: tuple[float, ...] | None = None, **keywords: Any) -> Scene:  # fmt: skip
    """A unit block on rollers, with probes of the displacement at ``corner`` (1, 1, ..) and of the stress ``inside``."""
    keywords.setdefault("strain", "small" if material.law == "linear_elastic" else "finite")
    keywords.setdefault("plane", "solid" if gdim == 3 else "plane_strain")
    probes = keywords.pop("probes", ())
    return Scene(
        name="block",
        regions=(Region("block", Box((0.0,) * gdim, (1.0,) * gdim), material),),
        length=1.0,
        supports=rollers(gdim) if supports is None else supports,
        loads=loads,
        probes=(*displacements(corner or (1.0,) * gdim), *stresses(inside or (0.31, 0.42, 0.23)[:gdim]), *probes),
        **keywords,
    )


def driven(gdim: int, material: Material, field: Callable[[Array, float], Array], **keywords: Any) -> Scene:
    """A block whose whole boundary follows a displacement field (x, t) -> (gdim, n)."""
    supports = tuple(
        Support(f"boundary_{i}", faces(gdim), (i,), lambda x, t, i=i: field(x, t)[i])  # type: ignore[misc]
        for i in range(gdim)
    )
    return block(gdim, material, supports, **keywords)
