"""Sweeps: every ladder runs in a worker process of its own, so that a crash costs one ladder and memory and CPU are its own."""

from __future__ import annotations

import json
import os
import platform
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from tqdm import tqdm

from geofem import scenes as registry
from geofem.methods import known as known_methods
from geofem.mistake import Mistake, unknown
from geofem.result import Result
from geofem.study import report, rows
from geofem.study.ladders import SAMPLE, Ladder, default_ladders
from geofem.study.rows import Row

WORKER = [sys.executable, "-m", "geofem.worker"]
TIMEOUT = 600.0
"""Seconds a run may take with all its repeats and, in the first run of a worker, with imports and compilation."""


def machine() -> str:
    """This machine in a line: ``AMD EPYC, 2 cores``."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0] if names else model
    return f"{model}, {len(os.sched_getaffinity(0))} cores"


def lines_of(stream: TextIO, into: queue.Queue[str | None]) -> None:
    """Put each row that the worker prints into the queue, and None when it prints no more; a library's chatter is no row."""
    for line in stream:
        if line.startswith("{"):
            into.put(line)
    into.put(None)


def death(process: subprocess.Popen[str], log: Path) -> tuple[str, str]:
    """Status of the run at which a worker ended, and why, in a line; what the worker calls a mistake is a refusal."""
    code = process.wait()
    said = log.read_text(errors="replace").strip().splitlines() or [f"see {log}"]
    if code == 2:
        return "refused", said[-1]
    if code < 0:
        return "failed", f"worker died with signal {-code} ({signal.Signals(-code).name})"
    return "failed", f"worker ended with status {code}: {said[-1]}"


def batch(
    scene: str, method: str, runs: Sequence[dict[str, Any]], folder: Path, repeats: int, timeout: float, analysis: str = ""
) -> Iterator[Row]:
    """Run one scene by one method with each of ``runs``, its knobs, in one worker; one row for each as it finishes.

    analysis : ``package.module:function`` to call with each in place of a run, see ``geofem.worker``.

    The worker saves run i into ``folder/i``, and what it says on stderr stands in ``folder/worker.log``; the folder is emptied
    first. If it dies, or a run takes longer than ``timeout`` (s), the last row is that run's, with status ``failed``, and the
    runs after it have none.
    """
    shutil.rmtree(folder, ignore_errors=True)  # a run that dies must not show the body of an earlier one
    folder.mkdir(parents=True)
    log = folder / "worker.log"
    task = {
        "scene": scene,
        "method": method,
        "runs": list(runs),
        "repeats": repeats,
        "folder": str(folder),
        "analysis": analysis,
    }
    with log.open("w") as stderr:
        # A session of its own: Ctrl-C reaches this process alone, and what a worker starts dies with it.
        process = subprocess.Popen(
            WORKER, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, text=True, start_new_session=True
        )
    assert process.stdin and process.stdout
    answers: queue.Queue[str | None] = queue.Queue()
    reader = threading.Thread(target=lines_of, args=(process.stdout, answers), daemon=True)
    reader.start()
    try:
        try:
            process.stdin.write(json.dumps(task) + "\n")
            process.stdin.close()
        except BrokenPipeError:
            pass  # it died before it read its task: the loop below says how
        for knobs in runs:
            failure = Result(scene, method, knobs=dict(knobs), status="failed")
            try:
                line = answers.get(timeout=timeout)
            except queue.Empty:
                failure.cause, failure.message = "timeout", f"took longer than {timeout:g} s"
                yield failure.row
                return
            if line is None:
                failure.status, failure.message = death(process, log)
                yield failure.row
                return
            yield json.loads(line)
        process.wait(timeout=10)
    except subprocess.TimeoutExpired:
        pass  # all rows are here, and a worker that does not end is ended below
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        reader.join(timeout=5)
        process.stdout.close()


def run(ladders: Iterable[Ladder], out: Path, repeats: int = 3, timeout: float = TIMEOUT) -> list[Row]:
    """Run the ladders one after another and add each row to ``out/results.jsonl`` at once. Ctrl-C keeps what is there.

    Only one ladder runs at a time: two would share caches and memory bandwidth, and the CPU times would show it.
    """
    ladders = list(ladders)
    here = machine()
    found: list[Row] = []
    with tqdm(total=sum(len(ladder.values) for ladder in ladders), file=sys.stderr, unit="run", disable=None) as progress:
        try:
            for ladder in ladders:
                progress.set_description(f"{ladder.scene} {ladder.label}")
                folder = Path("runs") / ladder.folder
                extra: Row = {"label": ladder.label, "vary": ladder.vary, "scene_knobs": dict(ladder.scene_knobs)}
                extra["machine"] = here
                for i, row in enumerate(batch(ladder.scene, ladder.method, ladder.runs, out / folder, repeats, timeout)):
                    row |= extra | {"run": str(folder / str(i)), "repeats": row["cost"].get("runs", 1)}
                    rows.append(out, row)
                    found.append(row)
                    progress.update()
        except KeyboardInterrupt:
            print(f"interrupted: {len(found)} rows are kept in {out / rows.RESULTS}", file=sys.stderr)
    return found


def compare(scenes: Sequence[str], methods: Sequence[str] | None, out: Path, repeats: int = 3) -> list[Row]:
    """Solve each scene by each method at growing resolution; store, print the table, draw the charts, write the report.

    Without a scene, the sample of about a minute, of the named methods if any. Returns the new rows; the charts and the report
    show these and what ``out`` held before. Raises ``Mistake`` for an unknown scene or method, and if nothing could be run.
    """
    for name in methods or ():
        if name not in known_methods():
            raise unknown("method", name, known_methods())
    for name in scenes:
        if ":" not in name:  # file.py:function is the worker's to find
            registry.get(name)
    if scenes:
        ladders = [ladder for scene in scenes for ladder in default_ladders(scene, methods)]
    else:
        ladders = [ladder for ladder in SAMPLE if methods is None or ladder.method in methods]
    if not ladders:
        raise Mistake(f"the sample has no ladder for {', '.join(methods or ())}: name a scene as well")
    found = run(ladders, out, repeats)
    if found:
        print(rows.table(found))
        print(f"\nreport: {report.write(out)}")
        if all(row["status"] == "refused" for row in found):
            raise Mistake(f"nothing could be run: {rows.why(found[0])}")
    return found
