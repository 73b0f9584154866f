"""What passes over material points are compiled for, and how they see the points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geofem.methods.mpm.grid import OPTIONS as GRID_OPTIONS

Array = np.ndarray
# Without numba's runtime: its atomic counting of references to rows of arrays took a third of a point's time. The passes can
# then allocate nothing; their scratch is given.
OPTIONS = {**GRID_OPTIONS, "_nrt": False}
SCRATCH = 64
"""Numbers of scratch that a pass needs."""
TINY = 1e-14
"""The least second moment of a point's weights (cells squared): the hats of one that sits on a node tell nothing of a gradient."""
SCHEMES = ("usl", "musl", "usf")


class Cloud(NamedTuple):
    """The points of one body as the passes see them; N points, d dimensions, g and m as in ``geofem.materials``.

    X, x, at, v : (N, d) reference position, position, place on the grid in this step (m), velocity (m/s).
    C : (N, d d) gradient of the velocity within a point's domain (1/s, apic), or the velocity without noise (N, d) (m/s, xpic).
    F : (N, g) deformation gradient. L : (N, d d) its increment's gradient dt L, for the volumetric cure only.
    tau : (N, m) Kirchhoff stress (Pa). state : (N, s). mass (kg), volume (m3, reference), force (N, d) on the point (N).
    domain : see ``Shape.domain``. stretch (N, g) : the deformation gradient of the domains in this step, so that all passes of a step
    see the same domain; the identity at small strain. order : (N,) the order in which points add to the grid; empty: as they are.
    per_density : volume over mass (m3/kg), which saves reading both.
    """

    X: Array
    x: Array
    at: Array
    v: Array
    C: Array
    F: Array
    L: Array
    tau: Array
    state: Array
    mass: Array
    volume: Array
    force: Array
    domain: Array
    stretch: Array
    order: Array
    per_density: float


class Answer(NamedTuple):
    """A material law as the passes need it: its point kernel, whether that looks at the F before the step, and has a state."""

    point: Callable[..., int]
    history: bool
    stateful: bool


@dataclass(frozen=True)
class Kind:
    """What passes are compiled for; ``axial``: axial symmetry, x is the radius, and masses and volumes are per radian.

    scheme : see above. transfer : ``flip`` (blended with pic), ``apic``, ``xpic``. small : small strain, F = I + grad u.
    loaded : points carry forces of their own. spent : the work of the stresses is summed up (where no stored energy tells it).
    cure : the volumetric part of strain and stress is averaged over cells.
    """

    shape: str
    dim: int
    axial: bool
    small: bool
    scheme: str
    transfer: str
    loaded: bool
    spent: bool
    cure: bool
