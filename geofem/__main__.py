"""The command line. It parses before it imports anything heavy, so that ``--help`` and ``list`` answer at once.

Exit status: 0 all went well, 1 the run failed, 2 the user can mend it (one line on stderr says how), 130 interrupted.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from geofem.mistake import Mistake

if TYPE_CHECKING:
    from geofem.result import Result

OK, FAILED, MISTAKE, INTERRUPTED = 0, 1, 2, 130
STATUS = {"ok": OK, "failed": FAILED, "refused": MISTAKE, "partial": INTERRUPTED}
PATIENCE = 5.0
"""Seconds that a rank in trouble waits for the others to come to the same end before it ends them."""
KINDS = ("scenes", "methods", "materials")
WORDS = {"true": True, "false": False, "none": None}


class Parser(argparse.ArgumentParser):
    """A parser whose errors are the user's mistakes, said in one line like all others."""

    def error(self, message: str) -> NoReturn:
        raise Mistake(f"{message}; see {self.prog} --help")


# --- what the user typed ----------------------------------------------------------------------------------------------
def parser() -> argparse.ArgumentParser:
    """The commands and their options."""
    top = Parser(prog="geofem", description="One scene, every continuum method, error against cost.", allow_abbrev=False)
    top.add_argument("--version", action="store_true", help="print the version and stop")
    commands = top.add_subparsers(metavar="COMMAND", parser_class=Parser)

    def command(action: Any, name: str, text: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=text, description=text, allow_abbrev=False)
        made.set_defaults(action=action)
        return made

    def names(text: str) -> list[str]:
        return [name for name in text.split(",") if name]

    shown = command(list_, "list", "what there is: scenes, methods, materials")
    shown.add_argument("kind", nargs="?", choices=KINDS, help="only these")

    one = command(run, "run", "solve one scene by one method")
    one.add_argument("scene", metavar="SCENE")
    one.add_argument("--method", required=True)
    one.add_argument(
        "--set", action="append", default=[], metavar="knob=value", help="a knob of the scene or the method; repeat for more"
    )
    one.add_argument("--out", type=Path, metavar="DIR", help="keep the result, its arrays and a checkpoint here")
    one.add_argument("--json", action="store_true", help="one line of JSON on stdout, all else on stderr")
    one.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    one.add_argument("--petsc", metavar="OPTIONS", help='options for PETSc, with the equals sign: --petsc="-log_view"')
    one.add_argument("--log", choices=("debug", "info", "warning", "error"), default="warning", help="what to tell on stderr")
    one.add_argument(
        "--frames", type=int, default=0, metavar="N", help="write the fields at N times to --out, for ParaView and the film"
    )
    one.add_argument("--quiet", action="store_true", help="no progress bar")

    many = command(
        compare, "compare", "error against cost for scenes and methods; without arguments a sample of a minute or two"
    )
    many.add_argument("scenes", nargs="*", metavar="SCENE")
    many.add_argument("--methods", type=names, metavar="a,b,c", help="only these (default: all that suit the scene)")
    keep(many, "where results, charts and the report go")

    maps = command(stability, "stability", "maps of where methods fail")
    maps.add_argument("maps", nargs="*", metavar="MAP")
    keep(maps, "where the maps go")

    advice = command(recommend, "recommend", "the cheapest measured method that meets a tolerance")
    advice.add_argument("scene", metavar="SCENE")
    advice.add_argument("--tol", type=float, required=True, help="the relative error to meet, as 1e-2")
    advice.add_argument("--budget", choices=("cpu", "rss", "dofs"), default="cpu", help="what is to be cheap")
    keep(advice, "where earlier results are")

    page = command(view, "view", "write one self-contained report.html from results, and a film of a run with frames")
    page.add_argument("folder", type=Path, metavar="DIR")
    page.add_argument("--field", metavar="NAME", help="what colours the film: displacement, speed, mean_stress, von_mises, ...")
    page.add_argument("--film", action=argparse.BooleanOptionalAction, help="insist on a film of the run, or make none (default: "
                      "film.mp4 if the run left frames)")  # fmt: skip

    command(doctor_, "doctor", "what this machine lacks, and the one line that mends it")
    return top


def keep(command: argparse.ArgumentParser, text: str) -> None:
    command.add_argument("--out", type=Path, metavar="DIR", default=Path("results"), help=f"{text} (default: results)")


def knob(setting: str) -> tuple[str, Any]:
    """Name and value of ``knob=value``: an integer, a number, true, false, none, or else a word."""
    name, equals, text = setting.partition("=")
    if not equals or not text or not name.isidentifier():
        raise Mistake(f"--set {setting!r}: write it as knob=value, for example --set n=16")
    if name in ("scene", "method", "out", "resume", "progress", "frames"):
        raise Mistake(f"--set {setting!r}: {name} is no knob; see geofem run --help")
    if text.lower() in WORDS:
        return name, WORDS[text.lower()]
    for kind in (int, float):
        try:
            return name, kind(text)
        except ValueError:
            pass
    return name, text


# --- the commands: each returns the exit status -----------------------------------------------------------------------
def list_(args: argparse.Namespace) -> int:
    from geofem import materials, methods, scenes

    found = {
        "scenes": scenes.known(),
        "methods": {name: entry.summary for name, entry in methods.known().items()},
        "materials": {name: law.summary for name, law in materials.LAWS.items()},
    }
    for kind in [args.kind] if args.kind else KINDS:
        entries = found[kind]
        width = max(map(len, entries))
        print(kind)
        for name in sorted(entries):
            print(f"  {name:{width}}  {entries[name]}")
    return OK


def run(args: argparse.Namespace) -> int:
    if args.resume and args.out is None:
        raise Mistake("--resume goes on from a checkpoint: say where it is with --out DIR")
    knobs = dict(knob(setting) for setting in args.set)
    if args.petsc:
        os.environ["PETSC_OPTIONS"] = f"{os.environ.get('PETSC_OPTIONS', '')} {args.petsc}".strip()
    logging.basicConfig(stream=sys.stderr, format="geofem: %(message)s")
    logging.getLogger("geofem").setLevel(args.log.upper())
    answer = take_stdout()
    check_launcher()

    from geofem import runner

    first = launched_rank() == 0
    if not first:
        logging.disable()
    progress = first and not args.quiet and sys.stderr.isatty()
    result = runner.run(
        args.scene, args.method, out=args.out, resume=args.resume, progress=progress, frames=args.frames, **knobs
    )
    if first:
        print(result.to_json() if args.json else summary(result, args.out), file=answer, flush=True)
        if result.status != "ok":
            print(f"geofem: {ending(result)}", file=sys.stderr)
    return STATUS[result.status]


def compare(args: argparse.Namespace) -> int:
    from geofem.study.sweep import compare as run_ladders

    run_ladders(args.scenes, args.methods, args.out)
    return OK


def stability(args: argparse.Namespace) -> int:
    from geofem.study.stability import run as run_maps

    run_maps(args.maps, args.out)
    return OK


def recommend(args: argparse.Namespace) -> int:
    from geofem.study.recommend import answer

    print(answer(args.scene, args.tol, args.budget, args.out))
    return OK


def view(args: argparse.Namespace) -> int:
    from geofem.study import report

    if args.field and args.film is False:
        raise Mistake("--field colours the film; leave out --no-film")
    wanted = True if args.field else args.film
    print(report.write(args.folder, shown=args.field, film=wanted, progress=sys.stderr.isatty()))
    return OK


def doctor_(args: argparse.Namespace) -> int:
    from geofem import doctor

    findings = doctor.examine()
    for finding in findings:
        print(finding)
    return OK if all(finding.ok for finding in findings) else FAILED


# --- stdout and MPI ---------------------------------------------------------------------------------------------------
def launched(*names: str) -> int:
    """What the launcher of this process (mpirun, srun) left in the environment, known before MPI is loaded; 0 without one."""
    return next((int(os.environ[name]) for name in names if os.environ.get(name, "").isdigit()), 0)


def launched_rank() -> int:
    return launched("PMI_RANK", "OMPI_COMM_WORLD_RANK", "PMIX_RANK")


def take_stdout() -> TextIO:
    """Keep stdout for the answer: from here on whatever a library prints, until the process ends, goes to stderr.

    At the level of file descriptors, since gmsh, PETSc and MPI print from C. Ranks after the first print nothing.
    """
    sys.stdout.flush()
    answer = os.fdopen(os.dup(1), "w")
    target = os.dup(2) if launched_rank() == 0 else os.open(os.devnull, os.O_WRONLY)
    os.dup2(target, 1)
    os.close(target)
    return answer


def check_launcher() -> None:
    """Raises ``Mistake`` if mpirun belongs to another MPI, so that each rank would solve the whole problem by itself."""
    ranks = launched("PMI_SIZE", "OMPI_COMM_WORLD_SIZE")
    if ranks > 1:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # mpi4py says the same at length, and goes on
            from mpi4py import MPI

        if MPI.COMM_WORLD.size != ranks:
            raise Mistake(
                f"mpirun started {ranks} processes that do not see each other, it is not of the MPI that geofem uses: "
                f"type 'uv run mpirun -n {ranks} geofem run ...'"
            )


def leave(text: str, status: int) -> int:
    """Say why on stderr, once if all ranks come to this end; a rank that is in trouble alone ends the others as well."""
    mpi: Any = sys.modules.get("mpi4py.MPI")
    alone = mpi is None or not mpi.Is_initialized() or mpi.COMM_WORLD.size == 1
    together = True
    if not alone:
        request = mpi.COMM_WORLD.Ibarrier()
        last = time.monotonic() + PATIENCE
        while not (together := request.Test()) and time.monotonic() < last:
            time.sleep(0.01)
    if not together:
        from geofem.core.mpi import abort

        abort(text + "\n", status)
    if launched_rank() == 0:
        print(text, file=sys.stderr, flush=True)
    return status


# --- what the user reads ----------------------------------------------------------------------------------------------
def ending(result: Result) -> str:
    """How a run ended that is not ok, in one line."""
    where = ", ".join(f"{name} = {value:.4g}" for name, value in result.at.items())
    cause = f" ({result.cause})" if result.cause else ""
    place = f" at {where}" if where else ""
    return f"{result.scene} by {result.method} {result.status}{cause}{place}: {result.message or 'no message'}"


def summary(result: Result, out: Path | None) -> str:
    """A run in a few lines: what was found, against what, and what it cost."""
    from geofem.study.rows import reference_text

    knobs = ", ".join(f"{name}={value}" for name, value in result.knobs.items())
    lines = [f"{result.scene} by {result.method} ({knobs or 'no knobs'}): {result.status}"]
    for name in dict.fromkeys([*result.qoi, *result.error]):
        parts = [f"{result.qoi[name]:.6g}"] if result.qoi.get(name) is not None else []
        known = result.reference.get(name)
        if known:
            parts.append(f"reference {reference_text(known)} ({known['kind']})")
        if result.error.get(name) is not None:
            parts.append(f"error {100 * result.error[name]:.3g} %")
        lines.append(f"  {name:14}{', '.join(parts)}")
    drifts = ", ".join(f"{name} {value:.2e}" for name, value in result.checks.items() if value is not None)
    counts = ", ".join(f"{value} {name}" for name, value in {**result.size, **result.work}.items() if value)
    lines += [f"  {'drifts':14}{drifts}"] if drifts else []
    lines += [f"  {'size and work':14}{counts}"] if counts else []
    if result.cost:
        times = f"{result.cost.get('cpu_s', 0):.3g} CPU s, set-up {result.cost.get('setup_s', 0):.3g} s"
        memory = f"{result.cost.get('rss_mb', 0):.0f} MB, {result.ranks} rank{'s' if result.ranks > 1 else ''}"
        lines.append(f"  {'cost':14}{times}, {memory}")
    if out is not None:
        lines.append(f"  {'kept in':14}{out}")
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Do what the words of the command line say; returns the exit status."""
    try:
        args = parser().parse_args(words)
        if args.version:
            from geofem import __version__

            print(f"geofem {__version__}")
            return OK
        if "action" not in args:
            raise Mistake("say what to do: list, run, compare, stability, recommend, view or doctor; see geofem --help")
        return args.action(args)
    except Mistake as mistake:
        return leave(f"geofem: {mistake}", MISTAKE)
    except KeyboardInterrupt:
        return leave("geofem: interrupted", INTERRUPTED)
    except Exception as error:
        from geofem.doctor import explain

        lacking = explain(error)
        return leave(f"geofem: {lacking}" if lacking else traceback.format_exc(), FAILED)


if __name__ == "__main__":
    sys.exit(main())
