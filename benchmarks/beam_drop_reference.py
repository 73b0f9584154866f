"""Make the reference of the scene ``beam_drop``: its tip history by an overkill run, extrapolated in the time step.

Run it as ``uv run python benchmarks/beam_drop_reference.py``; it writes ``geofem/reference/beam_drop.csv`` (about ten minutes).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geofem.runner import run
from geofem.scenes.beam_drop import beam

ORDER, N, GRADING, STEPS = 3, 8, 2.5, 600
ROWS = 301


def tip(stiffness: float, n: int, steps: int) -> np.ndarray:
    """The tip's u_y (m) at ``ROWS`` equally spaced times of the period."""
    result = run(beam(stiffness), order=ORDER, n=n, grading=GRADING, steps=steps)
    assert result.status == "ok", result.message
    t = result.history["t"]
    return np.interp(np.linspace(0.0, t[-1], ROWS), t, result.history["tip"])


def extrapolated(stiffness: float) -> tuple[np.ndarray, float, float]:
    """The tip history with the second-order error in dt taken off, and what halving dt and h changes, by the amplitude."""
    coarse, fine = tip(stiffness, N, STEPS), tip(stiffness, N, 2 * STEPS)
    in_time = float(np.abs(fine - coarse).max() / np.abs(fine).max())
    in_space = float(np.abs(coarse - tip(stiffness, N // 2, STEPS)).max() / np.abs(fine).max())
    return fine + (fine - coarse) / 3.0, in_time, in_space


if __name__ == "__main__":
    soft, soft_time, soft_space = extrapolated(1)
    stiff, stiff_time, stiff_space = extrapolated(100)
    lines = [
        f"# fem, P{ORDER} triangles, total Lagrangian, {N} cells across graded towards the clamped corners (exponent {GRADING}),",
        f"# trapezoidal rule with {STEPS} and {2 * STEPS} steps, extrapolated; by the amplitude, the last halving of the time step",
        f"# changed the curve by {soft_time:.1e} (stiffness 1) and {stiff_time:.1e} (100), that of the cells by {soft_space:.1e} and "
        f"{stiff_space:.1e};",
        "# made by benchmarks/beam_drop_reference.py",
        "t,tip,tip_stiff100",
        *(f"{t:.4f},{a:.10f},{b:.12f}" for t, a, b in zip(np.linspace(0.0, 1.5, ROWS), soft, stiff)),
    ]
    path = Path(__file__).parents[1] / "geofem" / "reference" / "beam_drop.csv"
    path.write_text("\n".join(lines) + "\n")
    print(path)
