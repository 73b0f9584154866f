"""Volume that a dam break makes or loses, classical PFEM against the boundary kept: histories as CSV, a picture, and a table.

uv run python benchmarks/pfem_volume.py [cells across, end in s, folder, setup]

The scene is ``dam_break`` after Martin and Moyce in a tank 4 a long, where the water strikes the far wall at 0.16 s; setup
``martin_moyce``, or ``solid`` for space. The classical way is an alpha shape with fixed particles on the walls (in the plane; in space
walls slide) and the equations at the end of the step; each choice is also changed by itself. The table shows the largest drift, the
picture all drifts over time, and what each kind of change between the steps made where the boundary is kept.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from geofem import methods, scenes
from geofem.mistake import Breakdown

KEPT = "boundary kept"
WAYS: dict[str, dict[str, Any]] = {
    KEPT: {},
    "kept, end of the step": {"configuration": "end", "theta": 1.0},
    "alpha shape, walls slide": {"tessellation": "alpha"},
    "alpha shape, walls fixed": {"tessellation": "alpha", "walls": "fixed"},
    "classical": {"tessellation": "alpha", "walls": "fixed", "configuration": "end", "theta": 1.0},
}
KINDS = {"lagrangian": "the steps", "wall": "put on walls", "resample": "nodes and cells made anew", "merge": "fronts joined",
         "separate": "necks cut", "restore": "given back", "mass": "all"}  # fmt: skip
COLOURS = ("#0072B2", "#56B4E9", "#E69F00", "#D55E00", "#CC79A7", "#009E73", "#000000")
IMPACT = 0.16


def ways(setup: str) -> dict[str, dict[str, Any]]:
    """The ways that there are for a setup: in space walls are not made of particles."""
    if setup != "solid":
        return WAYS
    slide = WAYS["classical"] | {"walls": "slide"}
    return {name: knobs for name, knobs in WAYS.items() if knobs.get("walls") != "fixed"} | {"classical, walls slide": slide}


def history(setup: str, n: int, end: float, knobs: dict[str, Any]) -> tuple[dict[str, np.ndarray], float, str]:
    """By name the time ``t`` (s), the volume over that at the start less one (``mass``) and what each kind made of it; CPU
    seconds; and why it broke down."""
    model = methods.get("pfem").build(scenes.get("dam_break")(setup=setup, end=end), n=n, **knobs)
    rows, start, cause = [], time.process_time(), ""
    while True:
        checks = model.checks()
        rows.append([model.t, *(checks.get(name if name == "mass" else f"volume_{name}", 0.0) for name in KINDS)])
        if model.t > end * (1 - 1e-9):
            break
        try:
            model.step(min(model.dt(), end - model.t))
        except Breakdown as stop:
            cause = stop.cause
            break
    return dict(zip(("t", *KINDS), np.array(rows, float).T)), time.process_time() - start, cause


def draw(found: dict[str, dict[str, np.ndarray]], setup: str, path: Path) -> None:
    """Drifts of all ways, and by kind of the one that keeps the boundary."""
    with matplotlib.rc_context({"font.size": 13, "axes.spines.top": False, "axes.spines.right": False}):
        left, right = (canvas := Figure(figsize=(13, 4.8), layout="constrained")).subplots(1, 2)
        for (name, of), colour in zip(found.items(), COLOURS):
            left.plot(of["t"], 100 * of["mass"], color=colour, linewidth=2.5, label=name)
        for (kind, label), colour in zip(KINDS.items(), COLOURS):
            if np.any(found[KEPT][kind]) or kind == "mass":
                right.plot(found[KEPT]["t"], 100 * found[KEPT][kind], color=colour, linewidth=2.0, label=label)
        left.set_title(f"dam break, {'in space' if setup == 'solid' else 'in the plane'}")
        right.set_title(f"{KEPT}: what made it")
        for axes in (left, right):
            axes.axvline(IMPACT, color="#999999", linestyle=":", zorder=0)
            axes.text(IMPACT, 1.0, " impact", color="#777777", fontsize=11, va="top", transform=axes.get_xaxis_transform())
            axes.set(xlabel="time (s)", ylabel="change of volume (%)", xlim=(0, None))
            axes.legend(frameon=False, fontsize=11)
        canvas.savefig(path, dpi=110)


def main(n: int = 10, end: float = 0.3, folder: Path = Path("out"), setup: str = "martin_moyce") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    print(f"{'way':>26} {'before impact':>14} {'after':>9} {'CPU (s)':>8}")
    found = {}
    for name, knobs in ways(setup).items():
        found[name], spent, cause = history(setup, n, end, knobs)
        t, drift = found[name]["t"], found[name]["mass"]
        early = t < IMPACT
        print(
            f"{name:>26} {np.abs(drift[early]).max():>14.1e} {np.abs(drift[~early]).max(initial=0.0):>9.1e} {spent:>8.1f} {cause}",
            flush=True,
        )
        file = folder / f"pfem_volume_{setup}_{name.replace(', ', '_').replace(' ', '_')}.csv"
        columns = np.column_stack(list(found[name].values()))
        np.savetxt(file, columns, delimiter=",", header=",".join(["t (s)", *KINDS]), comments="", fmt="%.9g")
    draw(found, setup, folder / f"pfem_volume_{setup}.png")


if __name__ == "__main__":
    told = sys.argv[1:]
    main(*(kind(word) for kind, word in zip((int, float, Path, str), told)))
