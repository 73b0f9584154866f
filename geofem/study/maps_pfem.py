"""The maps of the particle finite element method, as data."""

from __future__ import annotations

from typing import Any

from geofem.study.map import LINEAR, Map, Variant

CLASSICAL: dict[str, Any] = {"tessellation": "alpha", "configuration": "end", "theta": 1.0, "walls": "fixed"}
"""The particle finite element method as it was first written."""
LONG = 0.05
"""Longest step (s) where nothing but the Courant number is to limit it."""
DRIFT: dict[str, Any] = {
    "scene": "dam_break",
    "scene_knobs": {"setup": "koshizuka"},
    "measure": "volume",
    "quantity": "largest drift of the volume",
    "threshold": 0.005,
    "coarse": 5,
}
"""The volume of a dam break, which ought to stay what it was."""


def variant(label: str, **knobs: Any) -> Variant:
    return Variant(label, "pfem", knobs)


def sizes(label: str, *cells: int, **knobs: Any) -> tuple[Variant, ...]:
    """One variant by numbers of cells across."""
    return tuple(variant(f"{label}, n = {n}", n=n, **knobs) for n in cells)


PFEM = (
    Map(
        name="alpha",
        title="Volume that an alpha shape makes: a dam break until the far wall",
        variants=(
            *sizes("alpha shape", 6, 8, 12, **CLASSICAL),
            *sizes("middle of the step", 8, **{**CLASSICAL, "configuration": "mid"}),
            *sizes("boundary kept", 8),
        ),
        knob="alpha",
        axis="alpha: largest circumscribed circle of a cell over the spacing",
        scale=LINEAR,
        safe=1.1,
        harsh=1.7,
        bisections=0,
        **DRIFT,
    ),
    Map(
        name="courant",
        title="Volume that long steps make: a dam break until the far wall, n = 8",
        variants=tuple(
            variant(f"{where} of the step, theta = {theta:g}", n=8, dt=LONG, configuration=way, theta=theta)
            for way, where, theta in (
                ("mid", "middle", 0.5),
                ("mid", "middle", 1.0),
                ("end", "end", 1.0),
                ("start", "start", 1.0),
            )
        ),
        knob="cfl",
        axis="spacings that a node goes in a step",
        safe=0.05,
        harsh=2.0,
        bisections=2,
        **DRIFT,
    ),
    Map(
        name="transfer",
        title="History of cells: a bell carried round by a vortex, its nodes tessellated anew in each step",
        scene="vortex of nodes",
        measure="peak",
        quantity="part of the peak that is lost",
        variants=(*sizes("copied", 20, 40, way="copied"), *sizes("averaged", 20, 40, way="averaged")),
        knob="turns",
        axis="turns of the vortex",
        safe=0.005,
        harsh=2.0,
        threshold=0.2,
        analysis="geofem.methods.pfem.vortex:turned",
        coarse=6,
        bisections=3,
    ),
    Map(
        name="checkerboard",
        title="Too little stabilisation: pressure of a small wave, 20 steps",
        scene="sloshing",
        measure="roughness",
        quantity="roughness of the pressure",
        variants=(
            *sizes("P1-P1", 6, 10, 20),
            *sizes("MINI", 10, element="mini"),
        ),
        knob="stabilisation",
        axis="factor on the stabilisation",
        safe=10.0,
        harsh=1e-6,
        threshold=0.01,
        analysis="geofem.methods.pfem.failures:checkerboard",
        coarse=8,
        bisections=2,
    ),
    Map(
        name="sticking",
        title="Walls that water sticks to: the flow along the floor after a dam break",
        scene="dam_break",
        measure="layer",
        quantity="part of the depth held back",
        variants=(
            variant("nodes slide on walls"),
            variant("fixed particles", walls="fixed"),
            variant("fixed particles, alpha shape", **CLASSICAL),
        ),
        knob="n",
        axis="cells across the column",
        value=round,
        safe=24,
        harsh=4,
        threshold=0.1,
        analysis="geofem.methods.pfem.failures:sticking",
        coarse=5,
        bisections=0,
    ),
    Map(
        name="slivers",
        title="Slivers in space: a cube of 11 x 11 x 11 nodes, shifted at random",
        scene="cube of nodes",
        measure="slivers",
        quantity="share of slivers",
        variants=(
            variant("Delaunay", way="delaunay"),
            variant("edges taken out", way="swapped"),
            variant("and dropped at the boundary", way="mended"),
        ),
        knob="jitter",
        axis="largest shift by the spacing",
        safe=0.4,
        harsh=0.004,
        threshold=0.01,
        analysis="geofem.methods.pfem.failures:sliver_share",
        coarse=6,
        bisections=3,
    ),
)
