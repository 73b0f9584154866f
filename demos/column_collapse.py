# %% [markdown]
r"""
# How far a heap runs: the limit of a constant angle of friction

A column of grains, $H_0$ high and $L_0$ wide, stands against a smooth wall. The wall on its other side is pulled away, and the
heap comes to rest with its front at $L_f$. In experiments the run-out depends on next to nothing but the aspect ratio
$a = H_0 / L_0$ (Lube, Huppert, Sparks and Freundt 2005):

$$ \frac{L_f - L_0}{L_0} \approx 1.2\, a \quad (a < 1.8), \qquad 1.9\, a^{2/3} \quad (a > 2.8), $$

from half a column width to several. A mesh that follows the grains tangles at once; **material points** carry mass, stress and
history through a grid that is put back after every step, and flow as far as they like.

The law is Mohr-Coulomb's: shear stress at most $\tan\varphi$ times the pressure, however fast the grains are sheared. That is a
*model*, and this text tells its error from that of the method: refining the grid removes the second kind only.
"""

# %%
from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import geofem
from geofem.scenes.column_collapse import band

# %% [markdown]
# `n` is the number of cells across $L_0$. A blend with two thousandths of PIC (`flip=0.998`) takes away the noise of the points,
# which would otherwise lower the friction of sheared layers. The error of a run is its distance to the band of experiments.


# %%
def run_outs(law: str, ratios: tuple[float, ...], n: int) -> dict[float, float]:
    """The run-out over each aspect ratio, and a line of the table for each."""
    found = {}
    for a in ratios:
        run = geofem.run("column_collapse", method="mpm-gimp", n=n, flip=0.998, a=a, law=law)
        assert run.status == "ok", run.message
        # mass is what no step may make or lose
        assert abs(run.checks["mass"]) < 1e-12
        found[a] = run.qoi["run_out"]
        low, high = band(a)
        print(
            f"{law:>13} {a:>5g} {found[a]:>8.2f} {low:>7.2f} {high:>6.2f} {run.error['run_out']:>9.1%} {run.cost['cpu_s']:>8.1f}"
        )
    return found


# %% [markdown]
# Columns lower than about twice their width stay inside the band. Taller ones fall freely first and run too far: the grains of the
# experiment lose energy in collisions, of which a constant angle knows nothing. A friction that grows with the rate of shear, the
# $\mu(I)$ rheology, takes some of the excess off.


# %%
def main(
    low: tuple[float, ...] = (0.5, 1.0, 1.5),
    tall: tuple[float, ...] = (4.0, 7.0),
    n: int = 10,
    figure: Path | None = Path("column_collapse.png"),
) -> None:
    """Let columns of the aspect ratios ``low`` and ``tall`` collapse on ``n`` cells a width; draw into ``figure``."""
    print(f"{'law':>13} {'a':>5} {'run-out':>8} {'band':>14} {'error':>9} {'CPU (s)':>8}")
    found = {law: run_outs(law, low + tall, n) for law in ("mohr_coulomb", "mu_i")}
    if figure is not None:
        draw(found, figure)
    for a in low:
        assert band(a)[0] < found["mohr_coulomb"][a] < band(a)[1]
    for a in tall:  # the error of the model
        assert found["mohr_coulomb"][a] > band(a)[1]
        assert found["mu_i"][a] < found["mohr_coulomb"][a]


# %%
def draw(found: dict[str, dict[float, float]], path: Path) -> None:
    """Run-out over aspect ratio, on the band of experiments and simulations of single grains."""
    with matplotlib.rc_context({"font.size": 15, "axes.spines.top": False, "axes.spines.right": False}):
        axes = (canvas := Figure(figsize=(9, 5.4), layout="constrained")).subplots()
        a = np.linspace(0.4, 8.0, 200)
        axes.fill_between(a, *np.array([band(ratio) for ratio in a]).T, color="#cccccc", label="experiments and grains")
        for (law, points), colour, marker in zip(found.items(), ("#D55E00", "#0072B2"), "os"):
            axes.plot(*zip(*points.items()), marker, color=colour, markersize=10, label=law)
        axes.set(xlabel="aspect ratio a = $H_0 / L_0$", ylabel="run-out $(L_f - L_0) / L_0$", xlim=(0, 8), ylim=(0, None))
        axes.legend(frameon=False, loc="upper left")
        canvas.savefig(path, dpi=110)


# %%
if __name__ == "__main__":
    main()
