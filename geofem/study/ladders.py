"""Ladders: one scene solved by one variant of a method at growing resolution; and, as data, which ladders suit which scene."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from geofem import methods as registry
from geofem.mistake import unknown


def no_knobs() -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True)
class Ladder:
    """One line of a chart.

    scene_knobs make the problem, method_knobs the variant; ``vary`` is the knob that takes each of ``values``, coarse to fine.
    label : the variant's name in charts and tables.
    """

    scene: str
    method: str
    label: str
    values: Sequence[Any]
    vary: str = "n"
    scene_knobs: Mapping[str, Any] = field(default_factory=no_knobs)
    method_knobs: Mapping[str, Any] = field(default_factory=no_knobs)

    @property
    def runs(self) -> list[dict[str, Any]]:
        """The knobs of each run."""
        return [{**self.scene_knobs, **self.method_knobs, self.vary: value} for value in self.values]

    @property
    def folder(self) -> str:
        """A name for its folder: readable, and the same whenever the ladder is the same."""
        knobs = json.dumps([dict(self.scene_knobs), dict(self.method_knobs), self.vary], sort_keys=True)
        words = re.sub(r"[^a-z0-9]+", "-", f"{self.scene}-{self.label}".lower()).strip("-")
        return f"{words}-{hashlib.sha256(knobs.encode()).hexdigest()[:6]}"


# --- variants of methods: label -> knobs ------------------------------------------------------------------------------
P1 = {"order": 1, "cell": "triangle"}
P2 = {"order": 2, "cell": "triangle"}
P3 = {"order": 3, "cell": "triangle"}
Q1 = {"order": 1, "cell": "quadrilateral", "quadrature": "full"}
Q2 = {"order": 2, "cell": "quadrilateral", "quadrature": "full"}
Q2_REDUCED = {"order": 2, "cell": "quadrilateral", "quadrature": "reduced"}
CONTIGUOUS = {"kernel": "contiguous"}
QUARTER, NO_QUARTER = {"order": 2, "quarter_point": True}, {"order": 2, "quarter_point": False}
UNIFORM = {"grading": 1.0}
CLASSICAL = {"tessellation": "alpha", "walls": "fixed", "configuration": "end"}
MIXED = {"order": 2, "cell": "triangle", "formulation": "mixed"}


def fem(scene: str, label: str, knobs: Mapping[str, Any], values: Sequence[int], **scene_knobs: Any) -> Ladder:
    return Ladder(scene, "fem", f"FEM {label}", values, scene_knobs=scene_knobs, method_knobs=knobs)


def points(scene: str, method: str, values: Sequence[int], knobs: Mapping[str, Any] = no_knobs(), **scene_knobs: Any) -> Ladder:
    """Material points; of ``knobs`` those that are words, as that of the kernel, stand in the label."""
    family, _, kind = method.partition("-")
    words = [value for value in knobs.values() if isinstance(value, str)]
    return Ladder(
        scene, method, " ".join([family.upper(), kind, *words]).strip(), values, scene_knobs=scene_knobs, method_knobs=knobs
    )


def kernels(scene: str, values: Sequence[int], **scene_knobs: Any) -> list[Ladder]:
    """Every kind of material point with the same cells and as many points a cell."""
    return [
        points(scene, "mpm-linear", values, **scene_knobs),
        points(scene, "mpm-gimp", values, **scene_knobs),
        points(scene, "mpm-gimp", values, CONTIGUOUS, **scene_knobs),
        points(scene, "mpm-cpdi", values, **scene_knobs),
        points(scene, "mpm-cpdi2", values, **scene_knobs),
        points(scene, "mpm-bspline", values, **scene_knobs),
    ]


def xfem(scene: str, enrichment: str, values: Sequence[int], **scene_knobs: Any) -> Ladder:
    knobs = {"enrichment": enrichment}
    return Ladder(scene, "xfem", f"XFEM {enrichment}", values, scene_knobs=scene_knobs, method_knobs=knobs)


def pfem(scene: str, label: str, values: Sequence[int], knobs: Mapping[str, Any] = no_knobs(), **scene_knobs: Any) -> Ladder:
    return Ladder(scene, "pfem", f"PFEM {label}".strip(), values, scene_knobs=scene_knobs, method_knobs=knobs)


def cracked(scene: str, **scene_knobs: Any) -> list[Ladder]:
    """A mesh that follows the crack, with and without quarter-point cells, beside one that does not, with the field of tips."""
    return [
        fem(scene, "quarter points", QUARTER, (4, 8, 16, 32), **scene_knobs),
        fem(scene, "uniform, quarter points", UNIFORM | QUARTER, (8, 16, 32), **scene_knobs),
        fem(scene, "uniform", UNIFORM | NO_QUARTER, (8, 16, 32), **scene_knobs),
        xfem(scene, "modes", (10, 20, 40, 80), **scene_knobs),
        xfem(scene, "heaviside", (10, 20, 40, 80), **scene_knobs),
    ]


LADDERS: dict[str, list[Ladder]] = {
    "cook": [
        fem("cook", "P1", P1, (2, 4, 8, 16, 32), variant="A"),
        fem("cook", "P2", P2, (2, 4, 8, 16, 32), variant="A"),
        fem("cook", "P3", P3, (2, 4, 8, 16), variant="A"),
        fem("cook", "Q2", Q2, (2, 4, 8, 16, 32), variant="A"),
        fem("cook", "P1", P1, (2, 4, 8, 16), variant="D"),
        fem("cook", "P2", P2, (2, 4, 8), variant="D"),
        fem("cook", "P2-P1 mixed", MIXED, (2, 4, 8, 16), variant="D"),
    ],
    "beam_drop": [
        fem("beam_drop", "P2", P2, (1, 2, 4)),
        *kernels("beam_drop", (4, 8, 16)),
        pfem("beam_drop", "", (4, 8, 16)),
    ],
    "axis_aligned": [
        fem("axis_aligned", "P1", P1, (16, 32, 64)),
        fem("axis_aligned", "P2", P2, (8, 16, 32)),
        *kernels("axis_aligned", (16, 32, 64)),
    ],
    "collision": kernels("collision", (10, 20, 40)),
    "column": [
        fem("column", "P1", P1, (8, 16, 32), law="hencky"),
        fem("column", "P2", P2, (8, 16, 32), law="hencky"),
        points("column", "mpm-linear", (8, 16, 32), law="hencky"),
    ],
    "cantilever": [
        fem("cantilever", "P1", P1, (1, 2, 4), load="tip", P=1),
        fem("cantilever", "P2", P2, (1, 2, 4), load="tip", P=1),
    ],
    "cavity": [
        fem("cavity", "Q1", Q1, (2, 4, 8)),
        fem("cavity", "Q2 reduced", Q2_REDUCED, (2, 4, 8)),
    ],
    "footing": [
        fem("footing", "P1", P1, (2, 4, 8)),
        fem("footing", "P2", P2, (2, 4, 8)),
        fem("footing", "Q2 reduced", Q2_REDUCED, (2, 4, 8)),
        pfem("footing", "nodal", (4, 8, 16)),
        pfem("footing", "points, cured", (4, 8), {"state": "points", "cured": True}),
        pfem("footing", "points, not cured", (4, 8), {"state": "points", "cured": False}),
    ],
    "wedge": [
        points("wedge", "mpm-cpdi", (4, 6), {"solver": "implicit", "ppc": 3, "cure": "cell", "load_steps": 60}),
        pfem("wedge", "nodal", (5, 8, 12)),
        pfem("wedge", "points", (5, 8), {"state": "points"}),
    ],
    "sloshing": [
        pfem("sloshing", "", (10, 20, 40)),
        pfem("sloshing", "backward Euler, end", (10, 20, 40), {"theta": 1.0, "configuration": "end"}),
        points("sloshing", "mpm-gimp", (10, 20)),
    ],
    "film": [
        pfem("film", "", (5, 10, 20)),
        pfem("film", "Bingham", (5, 10), law="bingham"),
        pfem("film", "grains", (5, 10, 20), law="mu_i"),
    ],
    "square_drop": [
        pfem("square_drop", "", (4, 8, 16), shape="disc"),
    ],
    "slope": [
        fem("slope", "P2", P2, (2, 4, 8), case="ex1"),
        fem("slope", "Q2 reduced", Q2_REDUCED, (2, 4, 8), case="ex1"),
    ],
    "vertical_cut": [
        fem("vertical_cut", "P1", P1, (2, 4, 8)),
        fem("vertical_cut", "Q2 reduced", Q2_REDUCED, (2, 4, 8)),
    ],
    "axial": [
        fem("axial", "P2", P2, (16, 32, 64)),
        *kernels("axial", (16, 32, 64)),
    ],
    "vortex": [
        fem("vortex", "P1", P1, (4, 8, 16)),
        fem("vortex", "P2", P2, (2, 4, 8)),
        *kernels("vortex", (8, 16, 32)),
    ],
    "column_collapse": [
        points("column_collapse", "mpm-gimp", (5, 10, 20), {"flip": 0.998}, a=1.0),
        points("column_collapse", "mpm-cpdi", (5, 10, 20), {"flip": 0.998, "split": 1.0}, a=1.0),
        points("column_collapse", "mpm-bspline", (5, 10, 20), {"flip": 0.998}, a=1.0),
        points("column_collapse", "mpm-gimp", (5, 10, 20), {"transfer": "apic"}, a=1.0),
        pfem("column_collapse", "nodal", (5, 10, 20), a=1.0),
    ],
    "dam_break": [
        points("dam_break", "mpm-linear", (5, 10, 20)),
        points("dam_break", "mpm-gimp", (5, 10, 20)),
        points("dam_break", "mpm-cpdi", (5, 10, 20), {"split": 1.0}),
        points("dam_break", "mpm-bspline", (5, 10, 20)),
        pfem("dam_break", "", (5, 10, 20)),
        pfem("dam_break", "classical", (5, 10, 20), CLASSICAL),
    ],
    "slope_runout": [
        points("slope_runout", "mpm-gimp", (6, 8, 12)),
        points("slope_runout", "mpm-gimp", (6, 8, 12), {"cure": "cell"}),
        points("slope_runout", "mpm-cpdi", (6, 8, 12), {"cure": "cell", "split": 1.0}),
        points("slope_runout", "mpm-bspline", (6, 8, 12), {"cure": "cell"}),
        pfem("slope_runout", "nodal", (6, 8, 12)),
    ],
    "williams": [
        fem("williams", "quarter points", QUARTER, (4, 8, 16, 32)),
        fem("williams", "without them", NO_QUARTER, (4, 8, 16, 32)),
        xfem("williams", "modes", (10, 20, 40, 80)),
        xfem("williams", "topological", (10, 20, 40, 80)),
        xfem("williams", "heaviside", (10, 20, 40, 80)),
    ],
    "edge_crack": cracked("edge_crack", a=0.5),
    "shear_edge_crack": cracked("shear_edge_crack"),
    "inclined_crack": cracked("inclined_crack", beta=30.0),
    "centre_crack": cracked("centre_crack"),
    "double_edge": cracked("double_edge"),
    "branched": cracked("branched"),
}
"""The ladders of each scene."""

SAMPLE = [
    *(one for one in LADDERS["cook"] if (one.scene_knobs["variant"], one.label) != ("D", "FEM P2")),
    fem("beam_drop", "P2", P2, (1, 2, 4)),
    points("beam_drop", "mpm-linear", (4, 8, 16)),
    points("beam_drop", "mpm-cpdi", (4, 8)),
    pfem("beam_drop", "", (4, 8, 16)),
    fem("vortex", "P2", P2, (2, 4)),
    points("vortex", "mpm-linear", (4, 8, 16)),
    points("vortex", "mpm-cpdi", (8, 16)),
]
"""What ``geofem compare`` runs when nothing is asked for: about two minutes with nothing compiled. Cook's membrane shows orders
of convergence (A) and locking (D), the falling beam shows finite elements, particle finite elements and points with domains converge
where classical material points do not, and the vortex where these die."""


def default_ladders(scene: str, methods: Sequence[str] | None = None) -> list[Ladder]:
    """The ladders of a scene for the named methods, by default for all that the table has for it.

    A method without a line in the table climbs n = 4, 8, 16 with its own defaults, and so does every known method on a scene
    without one. Raises ``Mistake`` for an unknown method.
    """
    known = registry.known()
    listed = LADDERS.get(scene, [])
    chosen = list(methods) if methods is not None else list(dict.fromkeys(ladder.method for ladder in listed)) or list(known)
    ladders: list[Ladder] = []
    for method in chosen:
        if method not in known:
            raise unknown("method", method, known)
        ladders += [ladder for ladder in listed if ladder.method == method] or [points(scene, method, (4, 8, 16))]
    return ladders
