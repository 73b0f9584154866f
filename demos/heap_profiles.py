# %% [markdown]
r"""
# One heap, two methods: profiles over each other

The same column of grains collapses by **material points**, which carry all history through a grid, and by **particle finite
elements**, whose nodes are the grains and are tessellated anew as they flow. Nothing but the law is common to both. Where their
profiles agree, what is left over is the law's; where they do not, one of the methods adds friction, or takes it away.
"""

# %%
from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import geofem
from geofem import Result
from geofem.scenes.column_collapse import L0, band

# %% [markdown]
# `mpm-gimp` with a blend of two thousandths of PIC is held back by numerical friction on coarse grids, and by less of it with affine
# velocities (`transfer=apic`). `pfem` takes the grains as an elastoplastic solid with history at its nodes, or with the $\mu(I)$
# rheology as a fluid that does not change its volume.
RUNS = {
    "material points, flip": ("mpm-gimp", "mohr_coulomb", {"flip": 0.998}),
    "material points, affine": ("mpm-gimp", "mohr_coulomb", {"transfer": "apic"}),
    "particle finite elements": ("pfem", "mohr_coulomb", {}),
    "the same, flow by mu(I)": ("pfem", "mu_i", {}),
}


# %%
def profile(run: Result, places: np.ndarray) -> np.ndarray:
    """Height of the heap (m) over intervals between ``places`` (m): of the highest node or point in each."""
    x, y = np.asarray(run.snapshot["points"])[:, :2].T
    which = np.digitize(x, places) - 1
    return np.array([y[which == k].max(initial=0.0) for k in range(len(places) - 1)])


# %%
def main(a: float = 1.0, n: int = 10, figure: Path | None = Path("heap_profiles.png")) -> None:
    """Let one column of the aspect ratio ``a`` collapse by each of ``RUNS`` on ``n`` cells a width; draw into ``figure``."""
    low, high = band(a)
    print(f"{'':>25} {'run-out':>8} {'height':>7} {'error':>7}   (band {low:.2f} to {high:.2f})")
    places = L0 * np.arange(0.0, 4.21, 2.0 / n)
    found = {}
    for label, (method, law, knobs) in RUNS.items():
        run = geofem.run("column_collapse", method=method, n=n, a=a, law=law, **knobs)
        assert run.status == "ok", run.message
        print(f"{label:>25} {run.qoi['run_out']:>8.2f} {run.qoi['height']:>7.2f} {run.error['run_out']:>7.1%}")
        # all heaps stand as high at the wall as the experiments say, however far their fronts have run
        assert run.error["height"] < 0.1
        found[label] = profile(run, places)
    if figure is not None:
        draw(found, places, low, high, figure)


# %%
def draw(found: dict[str, np.ndarray], places: np.ndarray, low: float, high: float, path: Path) -> None:
    """Profiles in units of the column's width, and where the experiments' fronts stop."""
    with matplotlib.rc_context({"font.size": 15, "axes.spines.top": False, "axes.spines.right": False}):
        axes = (canvas := Figure(figsize=(10, 4.6), layout="constrained")).subplots()
        axes.axvspan(1 + low, 1 + high, color="#dddddd", label="fronts of experiments and grains")
        for (label, heights), colour, style in zip(
            found.items(), ("#D55E00", "#E69F00", "#0072B2", "#009E73"), ("-", "--", "-", "--")
        ):
            axes.plot(0.5 * (places[1:] + places[:-1]) / L0, heights / L0, style, color=colour, linewidth=2.5, label=label)
        axes.set(xlabel="$x / L_0$", ylabel="height / $L_0$", xlim=(0, 4), ylim=(0, 1.05))
        axes.legend(facecolor="white", edgecolor="white", framealpha=1.0)
        canvas.savefig(path, dpi=110)


# %%
if __name__ == "__main__":
    main()
