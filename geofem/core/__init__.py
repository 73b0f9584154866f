"""The dolfinx variational core: meshes, forms, solvers, state and files that every method shares.

Import dolfinx only after this package: the wheel ``dolfinx-solver-real`` must be loaded first where it is what provides
dolfinx; conda, apt and docker builds have no such package and go on without.
"""

from __future__ import annotations

import importlib.util
from typing import Any

if importlib.util.find_spec("dolfinx_solver"):
    import dolfinx_solver  # noqa: F401

JIT: dict[str, Any] = {
    # seconds that a rank waits for another one's compilation; a 3D form takes 6 s, on a busy machine a multiple
    "timeout": 600,
    # -ffast-math and -Ofast are spelled out in part: linked in by GCC, they flush denormals to zero in the whole process,
    # and they assume that nothing is nan, which hides a method's breakdown
    "cffi_extra_compile_args": [
        "-O3",
        "-march=native",
        "-g0",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fno-signed-zeros",
        "-fassociative-math",
        "-freciprocal-math",
    ],
}
"""Options of the form compiler: pass them as ``jit_options`` wherever a form or an expression is compiled."""
