"""The maps of the particle finite element method, as data."""

from __future__ import annotations

from geofem.study.map import LINEAR, Map, Variant

CLASSICAL = {"tessellation": "alpha", "configuration": "end", "theta": 1.0}
"""The particle finite element method as it was first written."""
LONG = {"dt": 0.05}
"""Steps (s) that nothing but the Courant number limits."""

PFEM = (
    Map(
        name="alpha",
        title="Volume that an alpha shape makes: a dam break until the far wall",
        scene="dam_break",
        measure="volume",
        quantity="largest drift of the volume",
        variants=(
            *(Variant(f"alpha shape, n = {n}", "pfem", {**CLASSICAL, "walls": "fixed", "n": n}) for n in (6, 8, 12)),
            Variant("middle of the step, n = 8", "pfem", {**CLASSICAL, "walls": "fixed", "configuration": "mid", "n": 8}),
            Variant("boundary kept, n = 8", "pfem", {"n": 8}),
        ),
        knob="alpha",
        axis="alpha: largest circumscribed circle of a cell over the spacing",
        scale=LINEAR,
        scene_knobs={"setup": "koshizuka"},
        safe=1.1,
        harsh=1.7,
        threshold=0.005,
        coarse=5,
        bisections=0,
    ),
    Map(
        name="courant",
        title="Volume that long steps make: a dam break until the far wall, n = 8",
        scene="dam_break",
        measure="volume",
        quantity="largest drift of the volume",
        variants=tuple(
            Variant(f"{where} of the step, theta = {theta:g}", "pfem", {**LONG, "n": 8, "theta": theta, "configuration": way})
            for way, where, theta in (
                ("mid", "middle", 0.5),
                ("mid", "middle", 1.0),
                ("end", "end", 1.0),
                ("start", "start", 1.0),
            )
        ),
        knob="cfl",
        axis="spacings that a node goes in a step",
        scene_knobs={"setup": "koshizuka"},
        safe=0.05,
        harsh=2.0,
        threshold=0.005,
        coarse=5,
        bisections=2,
    ),
    Map(
        name="transfer",
        title="History of cells: a bell carried round by a vortex, its nodes tessellated anew in each step",
        scene="vortex of nodes",
        measure="peak",
        quantity="part of the peak that is lost",
        variants=tuple(
            Variant(f"{way}, n = {n}", "pfem", {"way": way, "n": n}) for way in ("copied", "averaged") for n in (20, 40)
        ),
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
            *(Variant(f"P1-P1, n = {n}", "pfem", {"n": n}) for n in (6, 10, 20)),
            Variant("MINI, n = 10", "pfem", {"n": 10, "element": "mini"}),
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
            Variant("nodes slide on walls", "pfem"),
            Variant("fixed particles", "pfem", {"walls": "fixed"}),
            Variant("fixed particles, alpha shape", "pfem", {**CLASSICAL, "walls": "fixed"}),
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
            Variant("Delaunay", "pfem", {"way": "delaunay"}),
            Variant("edges taken out", "pfem", {"way": "swapped"}),
            Variant("and dropped at the boundary", "pfem", {"way": "mended"}),
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
