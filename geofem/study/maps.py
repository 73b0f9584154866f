"""The maps of ``geofem stability``, as data: a new one is an entry here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from geofem.study.ladders import MIXED, P1, P2, P3, Q1, Q2, Q2_REDUCED, no_knobs


@dataclass(frozen=True)
class Variant:
    """One row of a map: a method with its knobs."""

    label: str
    method: str
    knobs: Mapping[str, Any] = field(default_factory=no_knobs)


@dataclass(frozen=True)
class Map:
    """What is varied and what counts as failure.

    knob : the scene's or method's knob along the axis; ``value`` makes it of the axis' x, ``axis`` names x with its unit.
    safe, harsh : the ends of the axis (logarithmic), where methods are expected to work and to fail.
    threshold : relative error of ``measure`` from which a run counts as failed.
    reference : a variant to measure against where the scene has no reference for all x; None for the scene's own.
    coarse : runs of the coarse row. bisections : runs that narrow the boundary after it.
    """

    name: str
    title: str
    scene: str
    measure: str
    variants: Sequence[Variant]
    knob: str
    axis: str
    safe: float
    harsh: float
    threshold: float
    value: Callable[[float], Any] = float
    scene_knobs: Mapping[str, Any] = field(default_factory=no_knobs)
    reference: Variant | None = None
    coarse: int = 5
    bisections: int = 4


def fem(label: str, knobs: Mapping[str, Any], n: int = 16) -> Variant:
    return Variant(label, "fem", {**knobs, "n": n})


MAPS = {
    this.name: this
    for this in (
        Map(
            name="locking",
            title="Volumetric locking: Cook's membrane, linear elastic, 16 x 16 cells",
            scene="cook",
            measure="uy",
            variants=(
                fem("P1", P1),
                fem("P2", P2),
                fem("Q1", Q1),
                fem("Q2", Q2),
                fem("Q2 reduced", Q2_REDUCED),
                fem("P2-P1 mixed", MIXED),
            ),
            knob="nu",
            axis="1/2 - Poisson's ratio",
            value=lambda distance: 0.5 - distance,
            safe=0.3,
            harsh=1e-6,
            threshold=0.1,
            scene_knobs={"variant": "C"},
            # With the pressure as an unknown nothing locks: one order more on four times the cells serves as the truth.
            reference=fem("P3-P2 mixed, n = 32", {**P3, "formulation": "mixed"}, n=32),
        ),
    )
}
"""The maps by name."""
