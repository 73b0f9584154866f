# %% [markdown]
r"""
# The same beam by two methods

A beam of $4 \times 1$ m is clamped at its left end. At $t = 0$ gravity is switched on: its tip falls by 1.74 m and
swings back. The body is neo-Hookean, and both methods below solve the same weak balance of momentum on the current
configuration $\Omega_t$: find $u$ such that for every $w$ that vanishes on the clamp

$$ \int_{\Omega_t} \rho\, \ddot u \cdot w \,dx + \int_{\Omega_t} \sigma(F) : \nabla w \,dx = \int_{\Omega_t} \rho\, g \cdot w \,dx . $$

They differ in what they do with the mesh after a step:

* **finite elements** carry it with the material, and keep $F = I + \nabla u$ at the quadrature points of its cells;
* the **material point method** puts it back where it was and keeps $F$ at points that move through it.

A point that crosses from one cell to the next meets another gradient $\nabla N_i$ of the linear shape functions $N_i$, and
the internal force jumps by a share of the stress that does not shrink with the cell. Finer cells are crossed more often:
the error *grows*. With a beam a hundred times stiffer hardly a point leaves its cell, and the same code converges.
"""

# %%
from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import geofem
from geofem.reference import series

# %% [markdown]
# A run takes the name of the scene, that of the method, and knobs: the scene's own (`stiffness`) and the method's (`n`, the
# number of cells across the thickness). It returns the sampled history, the errors against the scene's reference, and the cost.


# %%
def errors(method: str, resolutions: tuple[int, ...], stiffness: int) -> dict[int, geofem.Result]:
    """One run for each n, and a line of the table for each."""
    results = {}
    for n in resolutions:
        results[n] = run = geofem.run("beam_drop", method=method, n=n, stiffness=stiffness)
        assert run.status == "ok", run.message
        print(f"{method:>10} {stiffness:>9} {n:>4} {run.size['dofs']:>6} {run.error['tip']:>9.2%} {run.cost['cpu_s']:>8.2f}")
    return results


# %% [markdown]
# `tip` is the largest error over time of the vertical displacement of the free end, divided by its amplitude.


# %%
def main(
    fem: tuple[int, ...] = (1, 2, 4),
    mpm: tuple[int, ...] = (4, 8, 16),
    figure: Path | None = Path("beam_drop.png"),
) -> None:
    """Solve at the numbers of cells ``fem`` and ``mpm`` across the thickness; draw into ``figure`` if there is one."""
    print(f"{'method':>10} {'stiffness':>9} {'n':>4} {'dofs':>6} {'error':>9} {'CPU (s)':>8}")
    soft = {"fem": errors("fem", fem, 1), "mpm-linear": errors("mpm-linear", mpm, 1)}
    stiff = errors("mpm-linear", mpm, 100)
    if figure is not None:
        draw(soft, figure)
    by_fem, by_mpm, by_stiff = (
        [run.error["tip"] for run in line.values()] for line in (soft["fem"], soft["mpm-linear"], stiff)
    )
    # Finite elements converge: better than first order in the size of the cells.
    assert by_fem[-1] < by_fem[0] * fem[0] / fem[-1]
    # Material points move away from the answer as they are refined ...
    assert by_mpm[-1] > by_mpm[0] > 0.2
    # ... unless they stay in their cells.
    assert by_stiff[-1] < by_stiff[0] / 1.5


# %%
def draw(soft: dict[str, dict[int, geofem.Result]], path: Path) -> None:
    """The tip's fall by both methods at their coarsest and finest, on the reference."""
    _, reference = series("beam_drop")
    with matplotlib.rc_context({"font.size": 15, "axes.spines.top": False, "axes.spines.right": False}):
        axes = (canvas := Figure(figsize=(9, 5.4), layout="constrained")).subplots()
        axes.plot(reference["t"], reference["tip"], color="#bbbbbb", linewidth=9, label="reference")
        for (method, runs), colour in zip(soft.items(), ("#0072B2", "#D55E00")):
            for n, dashes in zip((min(runs), max(runs)), ((4, 2), (None, None))):
                t, tip = (np.asarray(runs[n].history[name]) for name in ("t", "tip"))
                axes.plot(t, tip, color=colour, dashes=dashes, linewidth=2.5, label=f"{method}, n = {n}")
        axes.set(xlabel="time (s)", ylabel="vertical displacement of the tip (m)")
        axes.legend(frameon=False, ncols=2, loc="upper center")
        axes.set_ylim(top=0.75)
        canvas.savefig(path, dpi=110)


# %%
if __name__ == "__main__":
    main()
