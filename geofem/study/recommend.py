"""Which measured variant reaches a tolerance at the least cost: interpolated between runs, never beyond them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geofem.mistake import Mistake, unknown
from geofem.study import rows
from geofem.study.rows import BUDGETS, CLOSEST, Row

MARGIN = 1.5
"""A run is to be this much better than the tolerance: the error was measured on one mesh, and another may do worse."""


@dataclass(frozen=True)
class Choice:
    """A variant that reaches the tolerance.

    cost : interpolated between ``below`` (None if the coarsest run is good enough) and ``row``, the run to repeat.
    """

    label: str
    cost: float
    row: Row
    below: Row | None


def worst(row: Row) -> float | None:
    """The largest of a finished run's errors: a recommendation has to hold for all that the scene measures."""
    errors = [value for name in row["error"] if (value := rows.error(row, name)) is not None]
    return max(errors, default=None)


def reach(label: str, line: Sequence[Row], tol: float, budget: str) -> Choice | None:
    """Where a line, coarse to fine, comes to the tolerance and stays there; None if it does not.

    To stay: every finer measured run meets the tolerance too. A line that dips once on its way up has met it by luck.
    """
    points = [(c, max(e, CLOSEST), row) for row in line if (c := rows.cost(row, budget)) and (e := worst(row)) is not None]
    target = tol / MARGIN
    for i, (cost, error, row) in enumerate(points):
        if error > target or any(later > tol for _, later, _ in points[i:]):
            continue
        if i == 0:
            return Choice(label, cost, row, None)
        cheaper, coarser, below = points[i - 1]
        share = np.log(target / coarser) / np.log(error / coarser)
        return Choice(label, float(cheaper * (cost / cheaper) ** share), row, below)
    return None


def recommend(found: Iterable[Row], scene: str, tol: float, budget: str = "cpu") -> list[Choice]:
    """The variants that reach the relative error ``tol`` on one problem of a scene, the cheapest first; empty if none does.

    budget : ``cpu`` (s), ``rss`` (MB) or ``dofs``, what is to be least.
    """
    lines = rows.by_label(row for row in found if row["scene"] == scene)
    choices = [choice for name, line in lines.items() if (choice := reach(name, line, tol, budget))]
    return sorted(choices, key=lambda choice: choice.cost)


def knobs_text(row: Row) -> str:
    return " ".join(f"--set {name}={value}" for name, value in row["knobs"].items())


def measured(row: Row, budget: str) -> str:
    cost = rows.cost(row, budget)
    return f"{rows.step(row)} (error {worst(row):.2g}, {'' if cost is None else f'{cost:.3g} '}{BUDGETS[budget][2]})"


def answer_problem(title: str, group: Sequence[Row], tol: float, budget: str) -> str:
    choices = recommend(group, group[0]["scene"], tol, budget)
    if not choices:
        finished = [(e, row) for row in group if (e := worst(row)) is not None]
        if not finished:
            return f"{title}: no run finished with an error to judge by"
        _, best = min(finished, key=lambda pair: pair[0])
        nearest = f"best is {rows.label(best)}, {measured(best, budget)}"
        return f"{title}: no method reaches {tol:g} (with a margin of {MARGIN:g}): {nearest}"
    first = choices[0]
    where = "the coarsest run measured" if first.below is None else f"between {measured(first.below, budget)} and"
    lines = [
        f"{title}: {first.label}, about {first.cost:.3g} {BUDGETS[budget][2]} for an error of {tol:g}",
        f"  {where} {measured(first.row, budget)}",
        f"  geofem run {first.row['scene']} --method {first.row['method']} {knobs_text(first.row)}",
    ]
    lines += [f"  then {c.label}, {c.cost / first.cost:.1f} times the cost, at {measured(c.row, budget)}" for c in choices[1:4]]
    return "\n".join(lines)


def answer(scene: str, tol: float, budget: str, folder: Path) -> str:
    """What to run for the relative error ``tol``, as text, for each problem of the scene that ``folder`` has measured.

    Raises ``Mistake`` for a tolerance that is not positive, an unknown budget, and a scene without measurements.
    """
    if not tol > 0:
        raise Mistake(f"tolerance {tol:g}: give a positive relative error, like 1e-2")
    if budget not in BUDGETS:
        raise unknown("budget", budget, BUDGETS)
    found = [row for row in rows.read(folder) if row["scene"] == scene]
    if not found:
        raise Mistake(f"{folder} has no measurements of {scene}; run 'geofem compare {scene} --out {folder}' first")
    return "\n\n".join(answer_problem(title, group, tol, budget) for title, group in rows.by_problem(found).items())
