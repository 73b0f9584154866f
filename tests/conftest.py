"""What tests share: the command line and mpirun, each in a process of its own, as a user would start them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import geofem  # noqa: F401 - caps the threads before a test loads numpy or numba

ROOT = Path(__file__).parents[1]
LAUNCHER = Path(sys.executable).parent / "mpirun"
"""The launcher that was installed with this Python's MPI; another one's ranks would not see each other."""
Done = subprocess.CompletedProcess[str]


def start(*command: str, timeout: float) -> Done:
    """Run a command to its end. The folder of this Python comes first on PATH, as under ``uv run``."""
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"}
    return subprocess.run(
        command, capture_output=True, text=True, timeout=timeout, env=env, cwd=ROOT, stdin=subprocess.DEVNULL, check=False
    )


@pytest.fixture(scope="session")
def run_cli() -> Callable[..., Done]:
    """``run_cli("list")``: the finished process of ``geofem list``, with its stdout, stderr and returncode."""

    def call(*words: str | Path, timeout: float = 600) -> Done:
        return start(sys.executable, "-m", "geofem", *map(str, words), timeout=timeout)

    return call


@pytest.fixture(scope="session")
def mpirun() -> Callable[..., str]:
    """``mpirun(2, code)``: what n ranks print that run a piece of Python, or ``python -m ...`` for words. Fails if they do."""

    def call(n: int, *words: str, timeout: float = 600) -> str:
        if not LAUNCHER.exists():
            pytest.skip(f"no mpirun beside {sys.executable}")
        python = [sys.executable, "-c", words[0]] if len(words) == 1 else [sys.executable, *words]
        done = start(str(LAUNCHER), "-n", str(n), *python, timeout=timeout)
        assert done.returncode == 0, f"status {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    return call
