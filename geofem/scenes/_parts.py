"""What scenes are made of: predicates that hold on a boundary and beyond it, and checks of knobs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from geofem.mistake import Mistake
from geofem.scene import Array

ROUNDING = 1e-9
"""Slack of the predicates (m): coordinates of a mesh carry rounding errors."""

Predicate = Callable[[Array], Array]


def at_most(axis: int, value: float) -> Predicate:
    """True where x[axis] <= value."""
    return lambda x: x[axis] <= value + ROUNDING


def at_least(axis: int, value: float) -> Predicate:
    """True where x[axis] >= value."""
    return lambda x: x[axis] >= value - ROUNDING


def any_of(*predicates: Predicate) -> Predicate:
    """True where one of the predicates is."""
    return lambda x: np.any([p(x) for p in predicates], axis=0)


def all_of(*predicates: Predicate) -> Predicate:
    """True where all of the predicates are."""
    return lambda x: np.all([p(x) for p in predicates], axis=0)


def check_choice(scene: str, knob: str, value: Any, options: Iterable[Any]) -> None:
    """Raises ``Mistake`` unless the value is one of the options."""
    options = list(options)
    if value not in options:
        raise Mistake(f"scene {scene}: {knob} is one of {', '.join(map(str, options))}, not {value!r}")


def check_number(scene: str, knob: str, value: Any, low: float, high: float) -> None:
    """Raises ``Mistake`` unless the value is a number between low and high, both allowed."""
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not number or not low <= value <= high:
        raise Mistake(f"scene {scene}: {knob} is a number from {low:g} to {high:g}, not {value!r}")
