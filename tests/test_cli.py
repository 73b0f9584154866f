"""The command line's contract: one line of JSON, one line for a mistake, exit statuses, one voice under mpirun."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import LAUNCHER, Done, start

import geofem
from geofem import __main__ as cli
from geofem.mistake import Mistake
from geofem.result import KEYS, Result

Cli = Callable[..., Done]
COOK = ("run", "cook", "--method", "fem", "--set", "n=2")


def one_line(done: Done) -> dict[str, Any]:
    """The row of a run with --json, which must be all that stands on stdout."""
    assert done.stdout.count("\n") == 1 and done.stdout.endswith("\n"), (done.stdout, done.stderr)
    return json.loads(done.stdout)


def mended(done: Done) -> str:
    """What a user's mistake says, which must be one line on stderr and nothing on stdout, with exit status 2."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert done.stderr.startswith("geofem: ") and done.stderr.count("\n") == 1, done.stderr
    return done.stderr


def pretend(body: str, *words: str, ranks: int = 1, env: dict[str, str] | None = None) -> Done:
    """``geofem WORDS`` in a process of its own whose runner is ``def run(scene, method, **keywords)`` with this body."""
    code = (
        "import os, sys, types\n"
        "from geofem.mistake import Mistake\n"
        "from geofem.result import Result\n"
        f"def run(scene, method, **keywords):\n    {body}\n"
        "sys.modules['geofem.runner'] = types.SimpleNamespace(run=run)\n"
        "import geofem; geofem.runner = sys.modules['geofem.runner']\n"
        "from geofem.__main__ import main; sys.exit(main(sys.argv[1:]))"
    )
    launch = [str(LAUNCHER), "-n", str(ranks)] if ranks > 1 else []
    return subprocess.run(
        [*launch, sys.executable, "-c", code, *words], capture_output=True, text=True, env=os.environ | (env or {}), timeout=120
    )


# --- what is typed ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("words", [["--help"], ["run", "--help"], ["list"], ["list", "materials"]])
def test_help_and_list_load_nothing_heavy(words: list[str]) -> None:
    code = (
        "import sys\n"
        "from geofem.__main__ import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "heavy = {'dolfinx', 'mpi4py', 'numba', 'scipy', 'matplotlib', 'gmsh', 'pyvista'}\n"
        "if '--help' in sys.argv: heavy.add('numpy')\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = start(sys.executable, "-c", code, *words, timeout=120)
    assert done.stderr == "[]\n" and done.stdout


def test_list_names_scenes_methods_and_materials(run_cli: Cli) -> None:
    everything = run_cli("list").stdout
    for word in ("scenes", "methods", "materials", "cook", "fem", "mpm-linear", "neo_hooke"):
        assert word in everything
    only = run_cli("list", "methods").stdout
    assert "fem" in only and "cook" not in only


@pytest.mark.parametrize(
    "text, name, value",
    [
        ("n=16", "n", 16),
        ("dt=1e-3", "dt", 1e-3),
        ("beta=-30.", "beta", -30.0),
        ("graded=true", "graded", True),
        ("graded=False", "graded", False),
        ("end=none", "end", None),
        ("law=neo_hooke", "law", "neo_hooke"),
        ("file=a=b", "file", "a=b"),
    ],
)
def test_value_of_a_knob(text: str, name: str, value: object) -> None:
    found = cli.knob(text)
    assert found == (name, value) and type(found[1]) is type(value)


@pytest.mark.parametrize("text", ["n", "n=", "=4", "2n=4", "out=x"])
def test_malformed_knob_is_a_mistake(text: str) -> None:
    with pytest.raises(Mistake, match="--set"):
        cli.knob(text)


@pytest.mark.parametrize(
    "words, names",
    [
        ([], "list, run, compare"),
        (["rum"], "rum"),
        (["run", "cook"], "--method"),
        (["run", "cook", "--method", "fem", "--set", "n"], "knob=value"),
        (["run", "cook", "--method", "fem", "--resume"], "--out"),
        (["recommend", "cook", "--tol", "much"], "much"),
        (["recommend", "cook", "--tol", "1e-2", "--out", "no-such-folder"], "no-such-folder"),
        (["view", "no-such-folder"], "no-such-folder"),
        (["stability", "no-such-map"], "no-such-map"),
    ],
)
def test_mistake_in_the_words_is_one_line(cli_here: Cli, words: list[str], names: str) -> None:
    assert names in mended(cli_here(*words))


@pytest.mark.parametrize(
    "words, names",
    [
        (["run", "cok", "--method", "fem"], "did you mean 'cook'"),
        (["run", "cook", "--method", "fen"], "did you mean 'fem'"),
        ([*COOK, "--set", "ordre=2"], "did you mean 'order'"),
        (["compare", "cok", "--methods", "fem"], "did you mean 'cook'"),
    ],
)
def test_unknown_name_is_one_line_with_the_nearest(cli_here: Cli, tmp_path: Path, words: list[str], names: str) -> None:
    extra = ["--out", str(tmp_path)] if words[0] == "compare" else []
    assert names in mended(cli_here(*words, *extra))


# --- what is answered -------------------------------------------------------------------------------------------------
def test_json_is_the_only_line_on_stdout_whatever_libraries_print() -> None:
    """A library writes to file descriptor 1 from C, during the run and when the process ends."""
    body = "os.write(1, b'C library\\n'); print('python'); os.system('echo child'); return Result(scene, method, keywords)"
    done = pretend(body, *COOK, "--json")
    row = one_line(done)
    assert set(row) == set(KEYS)
    assert row["knobs"]["n"] == 2
    assert all(word in done.stderr for word in ("C library", "python", "child"))


@pytest.mark.parametrize("status, code", [("ok", 0), ("failed", 1), ("refused", 2), ("partial", 130)])
def test_exit_status_tells_how_the_run_ended(status: str, code: int) -> None:
    body = f"return Result(scene, method, status={status!r}, cause='tangle', at={{'t': 0.25}}, message='cell 7 is inside out')"
    for words in (COOK, (*COOK, "--json")):
        done = pretend(body, *words)
        assert done.returncode == code
        said = "" if status == "ok" else f"geofem: cook by fem {status} (tangle) at t = 0.25: cell 7 is inside out\n"
        assert done.stderr == said
        assert status in done.stdout
    assert one_line(done)["status"] == status


def test_options_reach_the_run(tmp_path: Path) -> None:
    body = "return Result(scene, method, {**keywords, 'out': str(keywords['out']), 'petsc': os.environ['PETSC_OPTIONS']})"
    options = ("--out", str(tmp_path), "--resume", "--petsc=-ksp_monitor", "--quiet", "--frames", "5")
    knobs = one_line(pretend(body, *COOK, "--json", *options, env={"PETSC_OPTIONS": "-log_view"}))["knobs"]
    assert knobs == {
        "n": 2,
        "out": str(tmp_path),
        "resume": True,
        "progress": False,
        "frames": 5,
        "petsc": "-log_view -ksp_monitor",
    }


def test_summary_says_what_was_found_against_what_and_at_what_cost() -> None:
    result = Result("cook", "fem", {"n": 2}, qoi={"uy": 12.0}, error={"uy": 0.5}, size={"dofs": 18}, cost={"cpu_s": 1.25})
    result.reference = {"uy": {"value": 24.0, "kind": "overkill", "source": "P4"}}
    text = cli.summary(result, Path("here"))
    for words in ("cook by fem (n=2): ok", "12", "reference 24 (overkill)", "error 50 %", "18 dofs", "1.25 CPU s", "here"):
        assert words in text


def test_interrupt_before_the_first_step_is_130() -> None:
    # a shell that starts the tests in the background has told them to ignore the signal; and any thread may get it
    body = "import signal, time; signal.signal(signal.SIGINT, signal.default_int_handler); "
    done = pretend(f"{body}os.kill(os.getpid(), {int(signal.SIGINT)}); time.sleep(60)", *COOK, "--json")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "geofem: interrupted\n")


def test_lack_of_the_machine_is_one_line_with_what_mends_it() -> None:
    done = pretend("raise OSError('libGLU.so.1: cannot open shared object file: No such file or directory')", *COOK)
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "libglu1-mesa" in done.stderr


def test_error_of_the_code_shows_its_traceback() -> None:
    done = pretend("raise ValueError('shapes do not match')", *COOK)
    assert done.returncode == 1 and "Traceback" in done.stderr and "shapes do not match" in done.stderr


# --- ranks ------------------------------------------------------------------------------------------------------------
@pytest.mark.mpi
def test_ranks_speak_with_one_voice() -> None:
    body = "from mpi4py import MPI; print('noise'); return Result(scene, method, ranks=MPI.COMM_WORLD.size)"
    done = pretend(body, *COOK, "--json", ranks=2)
    assert done.returncode == 0 and one_line(done)["ranks"] == 2
    assert done.stderr.count("noise") == 1


@pytest.mark.mpi
def test_mistake_of_all_ranks_is_said_once() -> None:
    done = pretend("raise Mistake('no such mesh')", *COOK, "--json", ranks=2)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("geofem: no such mesh") == 1


@pytest.mark.mpi
def test_rank_in_trouble_alone_ends_the_others() -> None:
    """Rank 0 waits in a collective call for rank 1, which has failed: without an abort this would never end."""
    body = (
        "from mpi4py import MPI\n"
        "    if MPI.COMM_WORLD.rank == 1: raise Mistake('this node has no such mesh')\n"
        "    MPI.COMM_WORLD.Dup().bcast(None, root=1)"
    )
    done = pretend(body, *COOK, "--json", ranks=2)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("geofem: this node has no such mesh") == 1


def test_foreign_mpirun_is_a_mistake() -> None:
    """Open MPI's mpirun tells its ranks by its own variables; this MPI does not read them, and each rank is alone."""
    done = pretend("return Result(scene, method)", *COOK, env={"OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": "0"})
    assert "uv run mpirun -n 2" in mended(done)


# --- real runs --------------------------------------------------------------------------------------------------------
def test_run_prints_one_row_with_error_and_cost_and_keeps_it_in_out(run_cli: Cli, tmp_path: Path) -> None:
    done = run_cli(*COOK, "--json", "--out", tmp_path)
    row = one_line(done)
    assert done.returncode == 0 and set(row) == set(KEYS)
    assert (row["scene"], row["method"], row["status"], row["ranks"]) == ("cook", "fem", "ok", 1)
    assert row["knobs"]["n"] == 2
    reference, found = row["reference"]["uy"]["value"], row["qoi"]["uy"]
    # The definition of a relative error; both sides round once.
    assert row["error"]["uy"] == pytest.approx(abs(found - reference) / abs(reference), rel=1e-12)
    assert row["size"]["dofs"] > 0 and row["cost"]["cpu_s"] > 0 and row["work"]["linear"] >= 1
    kept = Result.load(tmp_path)
    assert kept.row == row
    assert kept.history["t"][-1] == pytest.approx(1.0)


def test_run_writes_nothing_without_out(run_cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "import os, sys; os.chdir(sys.argv.pop(1)); from geofem.__main__ import main; sys.exit(main())"
    done = start(sys.executable, "-c", code, str(tmp_path), *COOK, timeout=600)
    assert done.returncode == 0 and "error" in done.stdout, done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.mpi
def test_two_ranks_find_the_same() -> None:
    """The discrete problem does not depend on its partition; sums in another order differ by rounding times conditioning."""
    alone = geofem.run("cook", "fem", n=2)
    done = start(str(LAUNCHER), "-n", "2", sys.executable, "-m", "geofem", *COOK, "--json", timeout=600)
    together = one_line(done)
    assert together["ranks"] == 2
    assert together["qoi"]["uy"] == pytest.approx(alone.qoi["uy"], rel=1e-9)
    assert together["size"] == alone.size


def test_doctor_finds_nothing_here(run_cli: Cli) -> None:
    """On a machine where the tests run, all that geofem needs is there; a lock of another test's compile is no lack."""
    done = run_cli("doctor")
    lacking = [line for line in done.stdout.splitlines() if line.startswith("LACKS") and "unfinished" not in line]
    assert lacking == [], done.stdout
