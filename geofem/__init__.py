"""geofem: one scene, every continuum method, error against cost.

>>> import geofem
>>> result = geofem.run("cook", method="fem", n=16)  # doctest: +SKIP
>>> result.error["uy"]  # doctest: +SKIP
>>> for step in geofem.grow("three_holes", n=40, da=0.1):  # doctest: +SKIP
...     print(step.advance, step.K, step.path)

Importing the package loads neither dolfinx nor numba: a public name is fetched when it is first used.
"""

from __future__ import annotations

import hashlib
import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geofem.core.propagation import Step
    from geofem.growing import grow, vary
    from geofem.mistake import Breakdown, Mistake
    from geofem.result import Result
    from geofem.runner import run
    from geofem.scene import (
        Box,
        Cohesion,
        Crack,
        Disc,
        Growth,
        Inlet,
        Load,
        Material,
        Measure,
        MeshFile,
        Outlet,
        Polygon,
        Probe,
        Reference,
        Region,
        Rigid,
        Ring,
        Scene,
        Support,
        Wall,
    )
    from geofem.study.sweep import compare

# One thread a process: CPU seconds then mean the same on every machine, and MPI ranks do not fight for cores. The
# libraries read these once, when they load. What the user has set stands.
for _cap in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_cap, "1")

# Numba looks at the file of a kernel to see whether its machine code is still good, not at the files of the functions that it
# calls: code of another state of the package must not be found.
_files = sorted((str(path), path.stat().st_mtime_ns) for path in Path(__file__).parent.rglob("*.py"))
_stamp = hashlib.sha256(repr(_files).encode()).hexdigest()[:12]
_caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
os.environ.setdefault("NUMBA_CACHE_DIR", str(_caches / "geofem" / f"numba-{_stamp}"))

__all__ = [
    "Box", "Breakdown", "Cohesion", "Crack", "Disc", "Growth", "Inlet", "Load", "Material", "Measure", "MeshFile", "Mistake",
    "Outlet", "Polygon", "Probe", "Reference", "Region", "Result", "Rigid", "Ring", "Scene", "Step", "Support", "Wall",
    "compare", "grow", "run", "vary",
]  # fmt: skip

_HOMES = {
    "run": "geofem.runner",
    "compare": "geofem.study.sweep",
    "Step": "geofem.core.propagation",
    "grow": "geofem.growing",
    "vary": "geofem.growing",
    "Result": "geofem.result",
    "Mistake": "geofem.mistake",
    "Breakdown": "geofem.mistake",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # costs more than all else here, and few ask

        return version("geofem")
    if name not in __all__:
        raise AttributeError(f"module 'geofem' has no attribute {name!r}")
    return getattr(import_module(_HOMES.get(name, "geofem.scene")), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
