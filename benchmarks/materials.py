"""Material kernels: million points updated per CPU second on one core, with stress, tangent and state; compilation left out.

python benchmarks/materials.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from geofem import materials
from geofem.scene import Material

COUNT = 100_000
ELASTIC = {"E": 1000.0, "nu": 0.3}
CASES = {
    "linear_elastic": ELASTIC,
    "hencky": ELASTIC,
    "neo_hooke": ELASTIC,
    "von_mises": ELASTIC | {"k": 1.0},
    "tresca": ELASTIC | {"c": 1.0},
    "mohr_coulomb": ELASTIC | {"c": 1.0, "phi": 28.0, "psi": 11.0},
    "drucker_prager": ELASTIC | {"c": 1.0, "phi": 28.0, "psi": 11.0},
    "mu_i": ELASTIC | {"mu_s": 0.4, "mu_2": 0.7, "I_0": 0.3, "d": 1e-3},
    "newtonian": {"mu": 1.0, "K": 1000.0},
    "newtonian, water": {"mu": 1.0, "K": 1000.0, "gamma": 7.0, "cavitation": 0.0},
}


def rate(kernel: Callable[..., int], *arguments: Any) -> tuple[float, float]:
    """(million points per CPU second, the best of 5 repetitions; share of plastic points)."""
    share = kernel(*arguments) / COUNT  # compiles
    times = []
    for _ in range(5):
        start = time.process_time()
        kernel(*arguments)
        times.append(time.process_time() - start)
    return COUNT / min(times) / 1e6, share


def loop_over(point: Callable[..., int]) -> Callable[..., int]:
    """A particle loop like that of the material point method."""

    @njit(cache=True)
    def loop(F, F_old, state, par, dt, tau, new_state):
        plastic = 0
        for n in range(F.shape[0]):
            plastic += point(F[n], F_old[n], state[n], par, dt, tau[n], new_state[n])
        return plastic

    return loop


def main() -> None:
    random = np.random.default_rng(0)
    print(
        f"{'law':>16} {'dim':>4} {'small':>7} {'plastic':>8} {'finite':>7} {'point':>7} {'plastic':>8}   M points per CPU second"
    )
    for case, parameters in CASES.items():
        law = case.split(",")[0]
        kernels = materials.get(law)
        par = kernels.parameters(Material(law, 0.0, parameters))
        for dim, m, g in ((2, 4, 5), (3, 6, 9)):
            state = kernels.initial_state(COUNT, m)
            new, stress, tangent = np.empty_like(state), np.empty((COUNT, m)), np.empty((COUNT, m, m))
            small, share = float("nan"), float("nan")
            if kernels.small is not None:
                strain = random.normal(size=(COUNT, m)) * 3e-3
                small, share = rate(kernels.small, strain, state, par, stress, tangent, new)
            unit = np.array([1.0, 0.0, 0.0, 1.0, 1.0]) if g == 5 else np.eye(3).ravel()
            F_old = unit + random.normal(size=(COUNT, g)) * 0.1
            F = F_old + random.normal(size=(COUNT, g)) * 3e-3
            P, A = np.empty((COUNT, g)), np.empty((COUNT, g, g))
            finite, share_finite = rate(kernels.finite, F, F_old, state, par, 0.1, P, A, new)
            point, _ = rate(loop_over(kernels.point), F, F_old, state, par, 0.1, stress, new)
            print(f"{case:>16} {dim:>4} {small:7.2f} {share:8.2f} {finite:7.2f} {point:7.2f} {share_finite:8.2f}")


if __name__ == "__main__":
    main()
