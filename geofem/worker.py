"""One ladder of a study in a process of its own: a JSON task on standard input, a JSON row per run on standard output.

The task is ``{"scene", "method", "runs": [knobs, ...], "repeats", "folder"}``. Imports and compilation are paid once; every run
is repeated and its least CPU time is kept, as other work on the machine only ever adds to it.

With ``"analysis": "package.module:function"`` nothing is run: ``function(method, **knobs)`` answers with errors by their names.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

from geofem.mistake import Mistake
from geofem.result import Result
from geofem.runner import run

ENOUGH_SECONDS = 20.0
"""A run is not repeated once its repeats have taken this long: noise matters less the longer it is."""
SHORT_SECONDS, SHORT_REPEATS = 0.1, 5
"""A run that takes less than this is repeated so often, if runs are repeated at all: the clock's noise weighs more."""


def analyse(name: str, scene: str, method: str, knobs: dict[str, Any]) -> Result:
    """The answer of an analysis as a result."""
    module, _, function = name.partition(":")
    start = time.process_time()
    error = getattr(import_module(module), function)(method, **knobs)
    cost = {"cpu_s": time.process_time() - start, "wall_s": 0.0}
    return Result(scene, method, knobs=knobs, error=error, qoi=dict(error), cost=cost)


def main() -> int:
    task = json.load(sys.stdin)
    # whatever libraries print must not mix with the rows
    rows = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for i, knobs in enumerate(task["runs"]):
        try:
            if task.get("analysis"):
                results, repeats = [analyse(task["analysis"], task["scene"], task["method"], knobs)], 1
            else:
                results, repeats = [run(task["scene"], task["method"], **knobs)], task["repeats"]
            if repeats > 1 and results[0].cost.get("cpu_s", 0.0) < SHORT_SECONDS:
                repeats = max(repeats, SHORT_REPEATS)
            while results[0].status == "ok" and len(results) < repeats:
                # not by the clock: the first run may have waited for a minute of compilation, which is not its cost
                if sum(r.cost["cpu_s"] for r in results) > ENOUGH_SECONDS:
                    break
                results.append(run(task["scene"], task["method"], **knobs))
        except Mistake as mistake:
            print(mistake, file=sys.stderr)
            return 2
        best = min(results, key=lambda r: r.cost.get("cpu_s", 0.0))
        best.cost["runs"] = len(results)
        best.save(Path(task["folder"]) / str(i))
        print(best.to_json(), file=rows, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
