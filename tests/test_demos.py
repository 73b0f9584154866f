"""What a reader tries first: each demo, at a small size and in a process of its own, and what README says of scenes."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import ROOT, Done, start

from geofem import scenes

SMALL = {
    "beam_drop": "fem=(1, 2), mpm=(4, 8), figure=Path(sys.argv[1])",
    "dam_break": "n=6, setup='koshizuka', figure=Path(sys.argv[1])",
    "crack_growth": "n=30, da=0.15, figure=Path(sys.argv[1])",
    "heap_profiles": "n=6, figure=Path(sys.argv[1])",
    "column_collapse": "low=(1.0,), tall=(4.0,), figure=Path(sys.argv[1])",
}
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


# --- README -----------------------------------------------------------------------------------------------------------
README = (ROOT / "README.md").read_text()


def test_readme_lists_every_scene_with_its_summary_and_kind_of_reference() -> None:
    rows = re.findall(
        r"^\| `(\w+)` \| (.+) \| ([\w-]+) \|$", README.partition("## Scenes")[2].partition("\n## ")[0], re.MULTILINE
    )
    assert {name: text for name, text, _ in rows} == scenes.known()
    for name, _, kind in rows:
        references = [measure.reference for measure in scenes.get(name)().measures]
        assert {reference.kind for reference in references if reference} == {kind}, name


def test_readme_scene_of_ones_own_meets_its_exact_settlement(run_cli: Callable[..., Done], tmp_path: Path) -> None:
    """Uniaxial strain of a linear law under its own weight is quadratic in height: P2 has it to rounding times conditioning."""
    path = tmp_path / "pole.py"
    path.write_text(next(block for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL) if "def pole" in block))
    row = json.loads(run_cli("run", f"{path}:pole", "--method", "fem", "--set", "height=5", "--json").stdout)
    assert row["status"] == "ok" and row["error"]["settlement"] < 1e-9
