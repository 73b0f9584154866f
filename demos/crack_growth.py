# %% [markdown]
r"""
# A crack that finds its way between three holes

A beam rests on two supports and is pressed down in the middle. A crack rises from its lower side, off the middle: it bends towards
the load, as it does without holes, and three holes above each other draw it to themselves or let it pass. Ingraffea and
Grigoriu (1990) broke such beams of PMMA, and Bittencourt et al. (1996) computed their paths.

Near its tip, a crack is loaded by two numbers, the **stress intensity factors** $K_I$ (opening) and $K_{II}$ (sliding):

$$ \sigma_{\theta\theta} = \frac{1}{\sqrt{2 \pi r}} \cos\frac{\theta}{2}
   \left( K_I \cos^2\frac{\theta}{2} - \frac{3}{2} K_{II} \sin\theta \right) . $$

It goes on where the hoop stress $\sigma_{\theta\theta}$ is largest (Erdogan and Sih 1963): straight on if $K_{II} = 0$. A path is a chain
of short steps, each with the factors of the crack so far. **XFEM** leaves the mesh alone: nodes near the crack get functions that jump
across it and that are singular at its tip. A step costs a few hundredths of a second here, and no mesh generator.
"""

# %%
from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import geofem
from geofem.scenes.three_holes import CORNERS, HOLES, RADIUS

# %% [markdown]
# `geofem.grow` gives the state after each step: `da` is the length of a step, `step.K` the factors of each tip, `step.path` the
# cracks. Two cracks that start an inch apart take different sides of the holes.

CASES = {(1.5, 5.0): "#D55E00", (1.0, 6.0): "#0072B2"}
"""Length and offset of the crack at the start (inches), and a colour."""


# %%
def paths(n: int, da: float) -> dict[tuple[float, float], list[geofem.Step]]:
    """The steps of both cracks on a mesh with `n` cells along two distances of holes, and a line of the table for each."""
    found = {}
    for a, b in CASES:
        steps = list(geofem.grow("three_holes", a=a, b=b, n=n, da=da))
        tip = np.array([step.tips[0] for step in steps if len(step.tips)] + [steps[-1].path[0][-1]])
        gaps = [max(np.hypot(*(tip - centre).T).min() - RADIUS, 0.0) for centre in HOLES.values()]
        # what the crack releases is what the loads do beyond what the beam stores
        way, rate, work = np.array(
            [(s.advance, s.G[0], s.energy["external"] - s.energy["internal"]) for s in steps if len(s.G)]
        ).T
        error = abs(np.trapezoid(rate, way) / np.ptp(work) - 1.0)
        print(f"{a:>4} {b:>4} {n:>4} {len(steps):>6} " + " ".join(f"{gap:>8.3f}" for gap in gaps) + f" {error:>10.1%}")
        assert error < 0.08
        found[a, b] = steps
    return found


# %% [markdown]
# The table says how near each crack comes to the rims of the holes, and how far all the energy that is freed is from the $J$
# integrals. The longer crack bends around the lowest hole and passes the middle one on its right; the shorter one, further out, ends in
# the middle hole. Halving the cells and the steps moves
# the paths by less than the radius of a hole.


# %%
def main(n: int = 40, da: float = 0.1, figure: Path | None = Path("crack_growth.png")) -> None:
    """Grow both cracks on `n` cells in steps of `da` (inches), and on half the cells; draw into `figure`."""
    print(f"{'a':>4} {'b':>4} {'n':>4} {'steps':>6} {'lower':>8} {'middle':>8} {'upper':>8} {'error of G':>10}")
    coarse, fine = paths(n // 2, 2.0 * da), paths(n, da)
    if figure is not None:
        draw(coarse, fine, figure)
    passed, ended = fine[1.5, 5.0][-1], fine[1.0, 6.0][-1]
    assert len(passed.tips) == 1 and passed.tips[0, 0] > HOLES["middle"][0] + RADIUS
    assert len(ended.tips) == 0 and np.hypot(*(ended.path[0][-1] - HOLES["middle"])) < 1.05 * RADIUS


# %%
def draw(coarse: dict, fine: dict, file: Path) -> None:
    """The paths between the holes, and $K_I$ over the way of the tip."""
    with matplotlib.rc_context({"font.size": 14, "axes.spines.top": False, "axes.spines.right": False}):
        beam, factor = (canvas := Figure(figsize=(12, 6), layout="constrained")).subplots(1, 2)
        beam.fill(*np.array(CORNERS).T, facecolor="#eeeeee", edgecolor="k", linewidth=1.5)
        for centre in HOLES.values():
            beam.add_patch(matplotlib.patches.Circle(centre, RADIUS, facecolor="white", edgecolor="k", linewidth=1.5, zorder=3))
        for (a, b), colour in CASES.items():
            for steps, look in ((coarse[a, b], {"linestyle": (0, (2, 1.5)), "linewidth": 1.5}), (fine[a, b], {"linewidth": 3})):
                beam.plot(*steps[-1].path[0].T, color=colour, **look)
                tip = [step for step in steps if len(step.K)]
                label = f"a = {a:g}, b = {b:g}, {len(steps)} steps"
                factor.plot([s.advance for s in tip], [s.K[0, 0] for s in tip], color=colour, label=label, **look)
        beam.set(xlim=(-7.2, -1.8), ylim=(-4.2, 4.2), aspect="equal", xlabel="x (in)", ylabel="y (in)", title="paths")
        factor.set(xlabel="way of the tip (in)", ylabel="$K_I$ for a unit load", ylim=(0, None), title="opening of the tip")
        factor.legend(frameon=False)
        canvas.savefig(file, dpi=110)


# %%
if __name__ == "__main__":
    main()
