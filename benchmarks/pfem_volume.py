"""Volume that a dam break makes or loses, classical PFEM against the boundary kept: histories as a CSV and a table of the largest.

uv run python benchmarks/pfem_volume.py [cells across, end in s, folder]

The scene is ``dam_break`` after Martin and Moyce in a tank 4 a long, where the water strikes the far wall at 0.16 s. The classical
way is an alpha shape with fixed particles on the walls and the equations at the end of the step; each choice is also changed by itself.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import geofem

WAYS: dict[str, dict[str, Any]] = {
    "boundary kept": {},
    "kept, end of the step": {"configuration": "end", "theta": 1.0},
    "alpha shape, walls slide": {"tessellation": "alpha"},
    "alpha shape, walls fixed": {"tessellation": "alpha", "walls": "fixed"},
    "classical": {"tessellation": "alpha", "walls": "fixed", "configuration": "end", "theta": 1.0},
}
IMPACT = 0.16


def main(n: int = 10, end: float = 0.3, folder: Path = Path("out")) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    print(f"{'way':>26} {'before impact':>14} {'after':>9} {'CPU (s)':>8}")
    for name, knobs in WAYS.items():
        run = geofem.run("dam_break", method="pfem", n=n, end=end, **knobs)
        t, volume = np.asarray(run.history["t"]), np.asarray(run.history["volume"])
        drift = volume / volume[0] - 1
        early = t < IMPACT
        print(
            f"{name:>26} {np.abs(drift[early]).max():>14.1e} {np.abs(drift[~early]).max(initial=0.0):>9.1e} "
            f"{run.cost['cpu_s']:>8.1f} {'' if run.status == 'ok' else run.cause}",
            flush=True,
        )
        file = folder / f"pfem_volume_{name.replace(', ', '_').replace(' ', '_')}.csv"
        np.savetxt(file, np.column_stack([t, drift]), delimiter=",", header="t (s),V / V0 - 1", comments="", fmt="%.9g")


if __name__ == "__main__":
    told = sys.argv[1:]
    main(*(kind(word) for kind, word in zip((int, float, Path), told)))
