# %% [markdown]
r"""
# A dam breaks: whose volume is it?

A column of water, $a$ wide and $2a$ high, stands in the corner of a tank. The gate is pulled away, and its front at $x = Z a$ runs
along the floor, timed by Koshizuka and Oka (1996) against $T = t \sqrt{2g/a}$.

In the **particle finite element method** the nodes are the water. They move with it, and are joined to triangles anew when those have
become too thin. Where the water ends is not given: the classical method keeps a triangle of the Delaunay triangulation if its
circumscribed circle is smaller than $\alpha$ spacings, an *alpha shape*. Each triangle that enters or leaves makes or takes volume.
Two choices stop that:

1. the equations hold in the *middle* of the step, where $\int \nabla\cdot u$ is the change of the area to the last digit;
2. the moved boundary is *kept* in the new triangulation, and nodes at the wall slide on it.
"""

# %%
from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import geofem
from geofem.reference import series
from geofem.scenes.dam_break import SETUPS

# %% [markdown]
# Both ways are knobs of the method, so that the classical one can be had too: an alpha shape, fixed particles on the walls,
# and equations at the end of the step.

# %%
OURS: dict[str, Any] = {}
CLASSICAL: dict[str, Any] = {"tessellation": "alpha", "walls": "fixed", "configuration": "end", "theta": 1.0}
WAYS = {"boundary kept": (OURS, "#0072B2"), "alpha shape": (CLASSICAL, "#D55E00")}


def falls(n: int, setup: str) -> dict[str, geofem.Result]:
    """A run of each way on ``n`` cells across the column, and a line of the table for it."""
    found = {}
    for name, (knobs, _) in WAYS.items():
        run = found[name] = geofem.run("dam_break", method="pfem", n=n, setup=setup, **knobs)
        assert run.status == "ok", run.message
        print(f"{name:>14} {run.error['front']:>11.1%} {run.qoi['volume']:>13.2e} {run.cost['cpu_s']:>8.1f}")
    return found


# %% [markdown]
# The gate takes time to open, and every code runs ahead of the record: fronts are compared after one shift of time. The classical way
# may meet the front as well, or better: water that sticks to its walls is slower, as water with friction is. Look at the volume.


# %%
def main(n: int = 10, setup: str = "koshizuka", figure: Path | None = Path("dam_break.png")) -> None:
    """Let the dam break on ``n`` cells across the column; draw front and volume into ``figure``."""
    print(f"{'way':>14} {'front error':>11} {'volume drift':>13} {'CPU (s)':>8}")
    found = falls(n, setup)
    if figure is not None:
        draw(found, setup, figure)
    assert found["boundary kept"].error["front"] < 0.05
    assert found["boundary kept"].qoi["volume"] < 1e-3
    assert found["alpha shape"].qoi["volume"] > 10 * found["boundary kept"].qoi["volume"]


# %%
def draw(found: dict[str, geofem.Result], setup: str, path: Path) -> None:
    """The front beside the experiment, and the volume by its start."""
    own = SETUPS[setup]
    with matplotlib.rc_context({"font.size": 15, "axes.spines.top": False, "axes.spines.right": False}):
        left, right = (canvas := Figure(figsize=(12, 5), layout="constrained")).subplots(1, 2)
        _, table = series(own.table)
        shown = table["T"] < own.end
        left.plot(table["T"][shown], table["Z"][shown], "ko", label="experiment")
        for name, run in found.items():
            T, volume = np.asarray(run.history["t"]) / own.unit, np.asarray(run.history["volume"])
            left.plot(T + run.qoi["shift"], own.front(run.history)[1], color=WAYS[name][1], linewidth=2.5, label=name)
            right.plot(T, 100 * (volume / volume[0] - 1), color=WAYS[name][1], linewidth=2.5)
        left.set(xlabel="T, shifted", ylabel="front Z = x / a", xlim=(0, own.end))
        right.set(xlabel=r"$T = t \sqrt{2 g / a}$", ylabel="volume made (%)", xlim=(0, own.end))
        left.legend(frameon=False, loc="upper left")
        canvas.savefig(path, dpi=110)


# %%
if __name__ == "__main__":
    main()
