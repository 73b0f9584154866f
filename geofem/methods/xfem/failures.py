"""What goes wrong where the method is misused, as numbers for the maps: on the exact field of a tip in the unit square."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from geofem import scenes
from geofem.methods.xfem import intact
from geofem.methods.xfem.enrichment import TIPS, TipChoice
from geofem.methods.xfem.model import XfemModel
from geofem.scene import Crack, Scene

TIP = 0.5037
"""Place of the tip (x), on no line of the mesh."""
WORST = 1e16
"""A condition number from which on no digit is left."""
STRAIGHT = 0.15
"""So far behind the tip a crack with a misplaced end leaves the true one (m)."""


def solved(scene: Scene, choice: TipChoice | None, n: int, radius: float = 0.2) -> XfemModel:
    """The model of a scene with any enrichment of tips, also with those that the method does not offer, solved."""
    model = XfemModel(scene, intact(scene, n, 1.0), choice, radius, scene.t_end)
    model.step(scene.t_end)
    return model


def conditioning(
    method: str, *, fraction: float, enrichment: str = "modes", scaled: bool = True, n: int = 20
) -> dict[str, float]:
    """``condition`` number where a crack cuts off that part of the height of a row of cells.

    scaled : with the diagonal scaled to ones, as the method solves, or without. n : an even number of cells.
    """
    scene = scenes.get("williams")(tip=(TIP, 0.5 + fraction / n))
    return {"condition": min(solved(scene, TIPS[enrichment], n).cracked.system.condition(scaled=scaled), WORST)}


def ramp(method: str, *, n: int, enrichment: str, ramp: bool = True) -> dict[str, float]:
    """Relative error ``energy`` of an enrichment with and without the ramp that ends it."""
    choice = TIPS[enrichment]
    scene = scenes.get("williams")()
    model = solved(scene, choice and replace(choice, ramp=ramp), n)
    history = {probe.name: np.array([model.probe(probe)]) for probe in scene.probes} | {"t": np.array([model.t])}
    measure: Any = next(m.error for m in scene.measures if m.name == "energy")
    return {"energy": measure(history)}


def disc(method: str, *, radius: float, enrichment: str, n: int = 20) -> dict[str, float]:
    """``condition`` number of the scaled matrix for tip functions within that radius."""
    system = solved(scenes.get("williams")(), TIPS[enrichment], n, radius).cracked.system
    return {"condition": min(system.condition(), WORST)}


def misplaced(method: str, *, cells: float, way: float, enrichment: str = "modes", n: int = 20) -> dict[str, float]:
    """Error ``K`` of the intensity factors (true: 1, 0) if the crack is told to end so many cells off its tip.

    way : the direction to the place told, degrees to the axis ahead of the tip.
    """
    scene = scenes.get("williams")()
    (start, tip), turn = scene.cracks[0].points, np.radians(way)
    told = (tip[0] + cells / n * float(np.cos(turn)), tip[1] + cells / n * float(np.sin(turn)))
    model = solved(replace(scene, cracks=(Crack((start, (tip[0] - STRAIGHT, tip[1]), told)),)), TIPS[enrichment], n)
    return {"K": float(np.hypot(*(model.cracked.intensity(0) - (1.0, 0.0))))}
