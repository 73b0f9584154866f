"""Rows of a study, as they stand in ``results.jsonl``: reading, grouping, the Pareto front, observed orders, the text table.

A row is ``Result.row`` and: ``label`` (the variant of a method, one line in a chart), ``vary`` (the knob that the ladder
climbs), ``scene_knobs`` (the knobs that make the problem), ``repeats``, ``run`` (folder of its snapshot, relative to the
study's) and ``machine``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geofem.mistake import Mistake
from geofem.result import Result, plain

Row = dict[str, Any]
RESULTS = "results.jsonl"
CLOSEST = 1e-16
"""An error that is exactly zero is drawn, and interpolated, at the rounding of a double."""
BUDGETS = {"cpu": ("cost", "cpu_s", "s of CPU"), "rss": ("cost", "rss_mb", "MB"), "dofs": ("size", "dofs", "dofs")}


def append(folder: Path, row: Row) -> None:
    """Add one row to the study, on disk at once."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / RESULTS).open("a") as file:
        file.write(json.dumps(plain(row), allow_nan=False) + "\n")


def read(folder: Path) -> list[Row]:
    """The rows of a study, or the one row of a single run. Of two rows for the same run the later one holds.

    Raises ``Mistake`` where the folder holds neither, or a line that is not a row.
    """
    if not (folder / RESULTS).exists():
        return [Result.load(folder).row | {"run": "."}]
    found: dict[str, Row] = {}
    for number, line in enumerate((folder / RESULTS).read_text().splitlines(), 1):
        try:
            row = json.loads(line)
            found[json.dumps([row["scene"], row["method"], label(row), row["knobs"]], sort_keys=True)] = row
        except (ValueError, KeyError, TypeError):
            raise Mistake(f"{folder / RESULTS}, line {number}: not a row of results; delete that line") from None
    if not found:
        raise Mistake(f"{folder / RESULTS} is empty; run 'geofem compare --out {folder}' first")
    return list(found.values())


# --- what a row says --------------------------------------------------------------------------------------------------
def label(row: Row) -> str:
    return row.get("label") or row["method"]


def problem(row: Row) -> str:
    """The problem that was solved, as a title: ``cook, variant A``."""
    return ", ".join([row["scene"]] + [f"{name} {value}" for name, value in (row.get("scene_knobs") or {}).items()])


def error(row: Row, measure: str) -> float | None:
    """The relative error of a finished run, None where there is none."""
    value = row["error"].get(measure)
    return value if row["status"] == "ok" and value is not None else None


def cost(row: Row, budget: str = "cpu") -> float | None:
    """CPU seconds, peak memory (MB) or dofs, as ``BUDGETS`` says; None where it was not measured."""
    group, key, _ = BUDGETS[budget]
    return row[group].get(key) or None


def why(row: Row) -> str:
    """Why a run did not finish, in a word if there is one."""
    return row["cause"] or row["message"] or row["status"]


def reference_text(reference: Mapping[str, Any]) -> str:
    """The value or the bounds of a reference: ``23.969``, ``1.375 ... 1.398``; empty for a field or a curve."""
    if reference.get("lower") is not None and reference.get("upper") is not None:
        return f"{reference['lower']:g} … {reference['upper']:g}"
    return "" if reference.get("value") is None else f"{reference['value']:.6g}"


def step(row: Row) -> str:
    """The rung of the ladder: ``n=8``."""
    vary = row.get("vary")
    return f"{vary}={row['knobs'].get(vary)}" if vary else ", ".join(f"{k}={v}" for k, v in row["knobs"].items())


# --- groups -----------------------------------------------------------------------------------------------------------
def by_problem(rows: Iterable[Row]) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(problem(row), []).append(row)
    return groups


def by_label(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """The lines of a chart, each sorted from the coarsest run to the finest."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(label(row), []).append(row)
    return {name: sorted(line, key=lambda row: cost(row, "dofs") or np.inf) for name, line in groups.items()}


def measures(rows: Iterable[Row]) -> list[str]:
    """The measures that have an error in one row at least, in the order of their first appearance."""
    return list(dict.fromkeys(name for row in rows for name, value in row["error"].items() if value is not None))


def pareto(rows: Iterable[Row], measure: str, budget: str = "cpu") -> list[Row]:
    """The runs that no other run beats in error and cost at once, from the cheapest to the most accurate."""
    points = [
        (c, e, i, row) for i, row in enumerate(rows) if (c := cost(row, budget)) and (e := error(row, measure)) is not None
    ]
    front: list[Row] = []
    best = np.inf
    for _, e, _, row in sorted(points, key=lambda point: point[:3]):
        if e < best:
            best = e
            front.append(row)
    return front


def slope(x: Sequence[float], y: Sequence[float]) -> float | None:
    """Least-squares slope of log y over log x; None for fewer than three different x."""
    if len(set(x)) < 3:
        return None
    return float(np.polyfit(np.log(x), np.log(np.maximum(y, CLOSEST)), 1)[0])


def observed_order(line: Iterable[Row], measure: str) -> float | None:
    """p of error ~ h^p with h = 1/n, over the finished runs of one ladder that climbs ``n``; None for fewer than three."""
    points = [(row["knobs"]["n"], e) for row in line if row.get("vary") == "n" and (e := error(row, measure)) is not None]
    fitted = slope([n for n, _ in points], [e for _, e in points])
    return None if fitted is None else -fitted


def machines(rows: Iterable[Row]) -> list[str]:
    return sorted({row["machine"] for row in rows if row.get("machine")})


# --- the text table ---------------------------------------------------------------------------------------------------
COLUMNS = ("variant", "step", "dofs", "points", "error", "CPU (s)", "outcome")


def cells(row: Row) -> tuple[str, ...]:
    """One row of the table, in the order of ``COLUMNS``."""
    errors = [f"{name} {value:.2e}" for name in row["error"] if (value := error(row, name)) is not None]
    seconds = cost(row)
    outcome = "ok" if row["status"] == "ok" else f"{row['status']}: {why(row)}"
    size = [str(row["size"].get(key) or "") for key in ("dofs", "points")]
    return label(row), step(row), *size, ", ".join(errors), "" if seconds is None else f"{seconds:.3g}", outcome


def table(rows: Iterable[Row]) -> str:
    """All rows as text, problem by problem, in columns."""
    blocks = []
    for title, group in by_problem(rows).items():
        lines = [COLUMNS] + [cells(row) for line in by_label(group).values() for row in line]
        widths = [max(len(line[i]) for line in lines) for i in range(len(COLUMNS))]
        text = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip() for line in lines]
        blocks.append("\n".join([title, *text]))
    return "\n\n".join(blocks)
