"""What tests share: the command line and mpirun, each in a process of its own, as a user would start them."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import geofem.__main__  # caps the threads before a test loads numpy or numba

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


@pytest.fixture
def cli_here(capfd: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """``run_cli`` in this process, which has loaded already what a command that ends before it solves anything would load first."""

    def call(*words: str | Path) -> Done:
        level = logging.getLogger("geofem").level
        capfd.readouterr()
        typed = [str(word) for word in words]
        status = geofem.__main__.main(typed)
        logging.getLogger("geofem").setLevel(level)
        return Done(typed, status, *capfd.readouterr())

    return call


@pytest.fixture(scope="session")
def mpirun() -> Callable[..., str]:
    """``mpirun(2, code)``: what n ranks print that run a piece of Python, or ``python -m ...`` for words. Fails if they do.

    A piece of Python runs on one rank in this process: dolfinx and the compiled kernels are loaded already.
    """

    def call(n: int, *words: str, timeout: float = 600) -> str:
        if not LAUNCHER.exists():
            pytest.skip(f"no mpirun beside {sys.executable}")
        if n == 1 and len(words) == 1:
            with contextlib.redirect_stdout(io.StringIO()) as told:
                exec(words[0], {"__name__": "__main__"})
            return told.getvalue()
        python = [sys.executable, "-c", words[0]] if len(words) == 1 else [sys.executable, *words]
        done = start(str(LAUNCHER), "-n", str(n), *python, timeout=timeout)
        assert done.returncode == 0, f"status {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    return call


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], int]]:
    """How often FFCx and numba have compiled in this process since the test began; other workers fill the same caches meanwhile."""
    import dolfinx_solver  # noqa: F401
    from ffcx.codegeneration import jit
    from numba.core.event import install_recorder

    forms = []
    compile_objects = jit._compile_objects

    def spy(*args: Any, **kwargs: Any) -> Any:
        forms.append(1)
        return compile_objects(*args, **kwargs)

    monkeypatch.setattr(jit, "_compile_objects", spy)
    with install_recorder("numba:compile") as kernels:
        yield lambda: len(forms) + len(kernels.buffer)
