"""Each demo runs as a reader would start it, in a process of its own, at a small size; its last lines assert its numbers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from conftest import ROOT, start

SMALL = {"beam_drop": "fem=(1, 2), mpm=(4, 8), figure=Path(sys.argv[1])"}
"""Keywords of a demo's ``main`` that make it quick."""


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "demos").glob("*.py")))
def test_demo_finds_its_numbers_and_draws_its_figure(name: str, tmp_path: Path) -> None:
    figure = tmp_path / "figure.png"
    code = f"import runpy, sys; from pathlib import Path; runpy.run_path('demos/{name}.py')['main']({SMALL[name]})"
    done = start(sys.executable, "-c", code, str(figure), timeout=300)
    assert done.returncode == 0, done.stderr
    assert "error" in done.stdout and figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("path", sorted((ROOT / "demos").glob("*.py")), ids=lambda path: path.stem)
def test_demo_fits_a_sitting(path: Path) -> None:
    """A text for students: under 100 lines."""
    assert len(path.read_text().splitlines()) < 100
