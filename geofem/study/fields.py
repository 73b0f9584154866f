"""What can be drawn of a snapshot: the fields by name, their titles with units, and what their colours span."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray
Snapshot = Mapping[str, Any]
"""Arrays of a body at one time, see ``paint``: from ``result.npz`` or from a frame of the series."""


def length(vectors: Array) -> Array:
    return np.linalg.norm(vectors, axis=1)


def mean_stress(stress: Array) -> Array:
    """A third of the trace; stress (n, 4 or 6): xx, yy, zz and shear stresses."""
    return stress[:, :3].mean(axis=1)


def von_mises(stress: Array) -> Array:
    """sqrt(3 J2) of the stress (n, 4 or 6)."""
    deviator = stress[:, :3] - mean_stress(stress)[:, None]
    return np.sqrt(1.5 * np.sum(deviator**2, axis=1) + 3.0 * np.sum(stress[:, 3:] ** 2, axis=1))


@dataclass(frozen=True)
class Field:
    """title : ends with the unit, if there is one. needs : the array of the snapshot. value : that array -> (n,).

    tail : per cent of the values that the colours leave out at either end: a stress grows without bound at corners.
    signed : False where the colours start at zero over a whole film.
    """

    title: str
    needs: str
    value: Callable[[Array], Array] = np.ravel
    tail: float = 0.0
    signed: bool = False


FIELDS = {
    "displacement": Field("displacement magnitude (m)", "displacement", length),
    "speed": Field("speed (m/s)", "velocity", length, tail=0.5),
    "mean_stress": Field("mean stress (Pa)", "stress", mean_stress, tail=2.0, signed=True),
    "von_mises": Field("von Mises stress (Pa)", "stress", von_mises, tail=2.0),
    "pressure": Field("pressure (Pa)", "pressure", tail=2.0, signed=True),
    "plastic_strain": Field("equivalent plastic strain", "plastic_strain", tail=1.0),
    "region": Field("body", "region", signed=True),
}
TITLES = {name: field.title for name, field in FIELDS.items()}


def available(snapshot: Snapshot) -> list[str]:
    """The names of ``FIELDS`` that can be drawn of this snapshot."""
    return [name for name, field in FIELDS.items() if field.needs in snapshot]


def colouring(snapshot: Snapshot, name: str) -> Array:
    """One number per point or cell; stresses in Pa, compression negative."""
    return FIELDS[name].value(np.asarray(snapshot[FIELDS[name].needs], float))


def limits(values: Array, name: str) -> tuple[float, float]:
    """What the colours span of one picture; values that are not numbers do not count."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, (FIELDS[name].tail, 100.0 - FIELDS[name].tail))
    return float(low), float(high if high > low else low + 1e-12)


def title(words: str, si: bool) -> str:
    """A label that ends with its unit, or without it for a dimensionless scene."""
    return words if si else words.partition(" (")[0]


def prefixed(words: str, largest: float) -> tuple[str, float]:
    """A title in Pa as one in kPa, MPa or GPa where the largest value is that large, and by what to divide the values."""
    for prefix, factor in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if words.endswith("(Pa)") and largest >= factor:
            return words.replace("(Pa)", f"({prefix}Pa)"), factor
    return words, 1.0
