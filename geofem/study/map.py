"""What a map of ``geofem stability`` is: variants, an axis, and what counts as failure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geofem.study.ladders import no_knobs


@dataclass(frozen=True)
class Variant:
    """One row of a map: a method with its knobs."""

    label: str
    method: str
    knobs: Mapping[str, Any] = field(default_factory=no_knobs)


@dataclass(frozen=True)
class Scale:
    """The scale of an axis: ``log`` or ``linear``."""

    name: str = "log"

    def middle(self, a: float, b: float) -> float:
        """The middle between a and b on this scale."""
        return float(np.sqrt(a * b)) if self.name == "log" else 0.5 * (a + b)

    def way(self, a: float, b: float) -> float:
        """How far it is from a to b on this scale."""
        return float(np.log(b / a)) if self.name == "log" else b - a

    def spread(self, a: float, b: float, count: int) -> list[float]:
        """``count`` values from a to b."""
        return (np.geomspace if self.name == "log" else np.linspace)(a, b, count).tolist()


@dataclass(frozen=True)
class Map:
    """What is varied and what counts as failure.

    knob : the scene's or method's knob along the axis; ``value`` makes it of the axis' x, or a mapping of several knobs; ``axis``
        names x with its unit. percent : whether the error is told in percent.
    safe, harsh : the ends of the axis, where methods are expected to work and to fail. scale : of the axis.
    threshold : relative error of ``measure`` from which a run counts as failed. quantity : what the error is called in the picture.
    reference : a variant to measure against where the scene has no reference for all x; None for the scene's own.
    cases : knobs of the runs at each x, the worst of which counts.
    along : the name in a result's ``at`` of the axis itself, where each run goes along it from the safe end to x: the place
        where the first broken run ended is the boundary.
    analysis : ``package.module:function`` that is called with the method's name and the knobs, in place of a run, and answers
        with the measures' errors; ``scene`` is then only a name.
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
    scale: Scale = Scale()
    cases: Sequence[Mapping[str, Any]] = ({},)
    along: str = ""
    analysis: str = ""
    quantity: str = "relative error"
    percent: bool = True
    coarse: int = 5
    bisections: int = 4

    def knobs(self, x: float) -> dict[str, Any]:
        """The knobs that x stands for."""
        value = self.value(x)
        return dict(value) if isinstance(value, Mapping) else {self.knob: value}


LINEAR = Scale("linear")
