"""The maps of ``geofem stability``, as data: a new one is an entry here, or of the particle finite element method in ``maps_pfem``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geofem.study.ladders import MIXED, P1, P2, P3, Q1, Q2, Q2_REDUCED
from geofem.study.map import LINEAR, Map, Variant
from geofem.study.maps_pfem import PFEM


def fem(label: str, knobs: Mapping[str, Any], n: int = 16) -> Variant:
    return Variant(label, "fem", {**knobs, "n": n})


def kernels(knobs: Mapping[str, Any], few: bool = False) -> tuple[Variant, ...]:
    """The kernels of the material point method with the same knobs. few : leave out those that stretch with the points but one."""
    named = {
        "hat": ("mpm-linear", {}),
        "uniform GIMP": ("mpm-gimp", {}),
        "quadratic B-spline": ("mpm-bspline", {}),
        "contiguous GIMP": ("mpm-gimp", {"kernel": "contiguous"}),
        "CPDI": ("mpm-cpdi", {}),
        "CPDI2": ("mpm-cpdi2", {}),
    }
    left_out = ("contiguous GIMP", "CPDI2") if few else ()
    return tuple(Variant(label, m, {**own, **knobs}) for label, (m, own) in named.items() if label not in left_out)


def cells_along(x: float) -> dict[str, int]:
    """The knobs of ``axis_aligned`` as a strip that is one of its n cells high."""
    return {"n": round(x), "strip": round(x)}


BAR = {"n": 8, "scheme": "usl"}


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
        Map(
            name="fracture",
            title="Numerical fracture: a soft bar pulled out, 2 x 2 points a cell",
            scene="stretch",
            measure="stress",
            variants=kernels({"n": 4, "transfer": "apic"}),
            knob="stretch",
            axis="stretch",
            scale=LINEAR,
            safe=1.25,
            harsh=5.0,
            threshold=0.1,
            along="stretch",
            coarse=6,
        ),
        Map(
            name="cell_crossing",
            title="Cell crossing: a bar that swells and shrinks, amplitude 5 % of its length, 2 x 2 points a cell",
            scene="axis_aligned",
            measure="displacement",
            variants=kernels({}),
            knob="n",
            axis="cells along the bar",
            value=cells_along,
            safe=16,
            harsh=128,
            threshold=0.1,
            scene_knobs={"dim": 1},
            bisections=0,
        ),
        Map(
            name="time_step",
            title="Time step: a bar whose end lies anywhere between two nodes, 2 x 2 points a cell",
            scene="offset_bar",
            measure="displacement",
            quantity="worst relative error over 6 offsets",
            variants=(
                *kernels({**BAR, "small_mass": 0.0}, few=True),
                Variant("hat, light nodes joined", "mpm-linear", {**BAR, "small_mass": 0.1}),
                Variant("hat, nodal step", "mpm-linear", {**BAR, "small_mass": 0.0, "dt_control": "nodal"}),
                Variant("hat, modified (musl)", "mpm-linear", {**BAR, "small_mass": 0.0, "scheme": "musl"}),
            ),
            knob="cfl",
            axis="Courant number",
            safe=0.1,
            harsh=2.0,
            threshold=0.5,
            cases=[{"offset": offset} for offset in (0.0, 0.26, 0.3, 0.4, 0.48, 0.75)],
            bisections=3,
        ),
        Map(
            name="vortex",
            title="Generalised vortex, 16 cells across the ring, 2 x 2 points a cell",
            scene="vortex",
            measure="displacement",
            variants=kernels({"n": 16}),
            knob="A",
            axis="amplitude A (rad)",
            safe=0.1,
            harsh=2.0,
            threshold=0.1,
            coarse=4,
            bisections=2,
        ),
        Map(
            name="nullspace",
            title="Null space: a row of 64 cells stretched evenly, 2 points a cell, worst of 8 offsets",
            scene="frozen row",
            measure="null_modes",
            quantity="nodal motions that no point sees",
            variants=kernels({}),
            knob="stretch",
            axis="stretch",
            scale=LINEAR,
            safe=1.0,
            harsh=4.0,
            threshold=0.02,
            analysis="geofem.methods.mpm.frozen:null_share",
            coarse=7,
            bisections=4,
        ),
        *PFEM,
        Map(
            name="conditioning",
            title="Small cuts: a crack along a row of nodes, 20 x 20 cells",
            scene="williams",
            measure="condition",
            quantity="condition number",
            percent=False,
            variants=tuple(
                Variant(f"{label}, {words}", "xfem", {"enrichment": enrichment, "scaled": scaled})
                for enrichment, label in (("modes", "tip modes"), ("branches", "4 branches"), ("heaviside", "jumps only"))
                for scaled, words in ((True, "scaled"), (False, "unscaled"))
            ),
            knob="fraction",
            axis="part of the cells' height that is cut off",
            safe=0.5,
            harsh=1e-8,
            threshold=1e7,
            analysis="geofem.methods.xfem.failures:conditioning",
            coarse=7,
            bisections=2,
        ),
        Map(
            name="ramp",
            title="Exact field of a crack tip, enriched within a fifth of the side",
            scene="williams",
            measure="energy",
            quantity="relative error in the energy norm",
            variants=(
                Variant("tip modes, ramp", "xfem", {"enrichment": "modes"}),
                Variant("tip modes, no ramp", "xfem", {"enrichment": "modes", "ramp": False}),
                Variant("4 branches, ramp", "xfem", {"enrichment": "corrected"}),
                Variant("4 branches, no ramp", "xfem", {"enrichment": "branches", "ramp": False}),
                Variant("4 branches in the tip's cell", "xfem", {"enrichment": "topological", "ramp": False}),
                Variant("jumps only", "xfem", {"enrichment": "heaviside"}),
            ),
            knob="n",
            axis="cells along the side",
            value=round,
            safe=96,
            harsh=8,
            threshold=0.05,
            analysis="geofem.methods.xfem.failures:ramp",
            coarse=6,
            bisections=0,
        ),
        Map(
            name="disc",
            title="Too wide a disc of tip functions: exact field of a tip, 40 x 40 cells",
            scene="williams",
            measure="condition",
            quantity="condition number",
            percent=False,
            variants=(
                Variant("tip modes", "xfem", {"enrichment": "modes"}),
                Variant("4 branches", "xfem", {"enrichment": "branches"}),
                Variant("4 branches, ramp", "xfem", {"enrichment": "corrected"}),
            ),
            knob="radius",
            axis="radius over the side of the square",
            scale=LINEAR,
            scene_knobs={"n": 40},
            safe=0.0625,
            harsh=0.35,
            threshold=1e7,
            analysis="geofem.methods.xfem.failures:disc",
            coarse=6,
            bisections=2,
        ),
        Map(
            name="misplaced_tip",
            title="A crack told to end off its tip: exact field of a tip, 20 x 20 cells",
            scene="williams",
            measure="K",
            quantity="error of the intensity factors",
            variants=tuple(
                Variant(f"{label}, {words}", "xfem", {"enrichment": enrichment, "way": way})
                for enrichment, label in (("modes", "tip modes"), ("topological", "4 branches in the tip's cell"))
                for way, words in ((0.0, "ahead"), (180.0, "behind"), (90.0, "aside"))
            ),
            knob="cells",
            axis="distance to the true tip in cells",
            safe=0.01,
            harsh=2.0,
            threshold=0.05,
            analysis="geofem.methods.xfem.failures:misplaced",
            coarse=7,
            bisections=2,
        ),
    )
}
"""The maps by name."""
