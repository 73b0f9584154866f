"""What a newcomer relies on: importing is light and quiet, threads are capped, the public names are there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import geofem

ROOT = Path(__file__).parents[1]
CAPS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def python(code: str, **env: str) -> str:
    """What a fresh interpreter prints that has none of the thread caps in its environment but those given."""
    inherited = {name: value for name, value in os.environ.items() if name not in CAPS}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=inherited | env, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_import_loads_nothing_heavy() -> None:
    heavy = "{'numpy', 'numba', 'scipy', 'dolfinx', 'dolfinx_solver', 'mpi4py', 'petsc4py', 'gmsh', 'matplotlib', 'pyvista'}"
    assert python(f"import sys, geofem; print(sorted({heavy} & set(sys.modules)))") == "[]"


def test_threads_are_capped_before_numba_reads_them() -> None:
    assert python("import geofem, numba; print(numba.config.NUMBA_NUM_THREADS)") == "1"
    assert python(f"import geofem, os; print(*(os.environ[n] for n in {CAPS}))") == "1 1 1"


def test_threads_that_the_user_set_stand() -> None:
    assert python("import geofem, os; print(os.environ['OMP_NUM_THREADS'])", OMP_NUM_THREADS="3") == "3"


@pytest.mark.parametrize("name", geofem.__all__)
def test_public_name_is_there(name: str) -> None:
    """In a process of its own: ``run`` may load dolfinx, and this process must stay free to load pyvista."""
    assert python(f"import geofem; print(callable(geofem.{name}))") == "True"


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = geofem.nothing  # type: ignore[attr-defined]


def test_version_is_that_of_the_package() -> None:
    assert f'version = "{geofem.__version__}"' in (ROOT / "pyproject.toml").read_text()


def test_no_module_of_the_study_loads_dolfinx() -> None:
    """A process that loaded dolfinx must not import pyvista: what reads results stays free of it."""
    code = (
        "import importlib, pkgutil, sys, geofem.study as study\n"
        "for module in pkgutil.iter_modules(study.__path__): importlib.import_module('geofem.study.' + module.name)\n"
        "print(sorted({'dolfinx', 'dolfinx_solver', 'petsc4py'} & set(sys.modules)))"
    )
    assert python(code) == "[]"
