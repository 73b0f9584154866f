"""What this machine lacks for geofem, each with the one line that mends it: ``geofem doctor``, and the text of failed runs.

Every check is a small function that returns a ``Finding`` and runs what may crash in a process of its own. This module
imports the standard library only: it must work where dolfinx does not.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

DOLFINX = "0.11"
JIT_TIMEOUT = 600.0
"""Seconds after which a form that is still being compiled is given up; the largest measured compile took 6 s."""
FREE_GB = 1.0
"""Disk that a first run may fill: the JIT cache takes some 0.1 GB, checkpoints and reports the rest."""
LOCAL_DISKS = ("ext2", "ext3", "ext4", "xfs", "btrfs", "zfs", "f2fs", "overlay", "tmpfs")
"""File systems that no other machine writes to."""

COMPILER_MEND = "sudo apt-get install -y gcc libc6-dev"
HEADERS_MEND = "uv python install 3.12 && uv sync --reinstall; or, for Debian's own Python: sudo apt-get install -y python3-dev"
GRAPHICS_MEND = (
    "sudo apt-get install -y libglu1-mesa libgl1 libegl1 libxrender1 libxcursor1 libxfixes3 libxft2 libxinerama1 libgomp1"
)
MPI_MEND = "uv sync --reinstall-package mpich --reinstall-package mpi4py"
CGAL_MEND = "sudo apt-get install -y g++ libcgal-dev"


@dataclass(frozen=True)
class Finding:
    """What one check saw. ``mend`` is the one line to type where it is not ok."""

    ok: bool
    what: str
    mend: str = ""

    def __str__(self) -> str:
        return f"ok    {self.what}" if self.ok else f"LACKS {self.what}\n      mend: {self.mend}"


def run(*command: str) -> subprocess.CompletedProcess[str]:
    """The outcome of a short command; one that hangs or is not there counts as failed."""
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=120, stdin=subprocess.DEVNULL)
    except (OSError, subprocess.TimeoutExpired) as error:
        return subprocess.CompletedProcess(command, 127, "", str(error))


def python(code: str) -> subprocess.CompletedProcess[str]:
    """The outcome of a line of Python in a process of its own."""
    return run(sys.executable, "-c", code)


def last_line(text: str) -> str:
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "nothing said")


# --- compiling --------------------------------------------------------------------------------------------------------
def compiler_command() -> list[str]:
    """The command that CFFI builds with: $CC, or the compiler that this Python names."""
    return shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")


def compiler() -> Finding:
    name = compiler_command()[0]
    found = shutil.which(name)
    if found:
        return Finding(True, f"C compiler: {found}")
    other = shutil.which("gcc") or shutil.which("cc")
    mend = f"export CC={other}" if other else COMPILER_MEND
    return Finding(False, f"C compiler: {name} is not on PATH; dolfinx compiles each weak form with it", mend)


def headers(include: Path | None = None) -> Finding:
    """Are the headers of Python (in ``include``) and of the C library there?"""
    include = include or Path(sysconfig.get_paths()["include"])
    if not (include / "Python.h").exists():
        return Finding(False, f"Python headers: no Python.h in {include}", HEADERS_MEND)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "headers.c")
        source.write_text("#include <Python.h>\n#include <math.h>\n#include <complex.h>\n")
        done = run(*compiler_command(), "-fsyntax-only", f"-I{include}", str(source))
    if done.returncode:
        return Finding(False, f"C headers: {last_line(done.stderr)}", COMPILER_MEND)
    return Finding(True, f"Python and C headers: {include}")


# --- libraries --------------------------------------------------------------------------------------------------------
def dolfinx(installed: Callable[[str], str] = importlib.metadata.version) -> Finding:
    """Is DOLFINx there, of the version that geofem is written for, and does it load?"""
    for package in ("dolfinx-solver-real", "fenics-dolfinx"):
        try:
            version = installed(package)
        except importlib.metadata.PackageNotFoundError:
            continue
        if not version.startswith(DOLFINX):
            return Finding(False, f"{package} {version}: geofem needs {DOLFINX}", "uv sync")
        done = python("import geofem.core, dolfinx")
        if done.returncode:
            return Finding(False, f"{package} {version} does not load: {last_line(done.stderr)}", "uv sync --reinstall")
        return Finding(True, f"{package} {version}")
    return Finding(False, "DOLFINx is not installed for this Python", "uv sync")


def gmsh() -> Finding:
    done = python("import gmsh; gmsh.initialize(); print(gmsh.__version__)")
    if done.returncode:
        return Finding(False, f"gmsh: {last_line(done.stderr)}", GRAPHICS_MEND)
    return Finding(True, f"gmsh {last_line(done.stdout)}")


def cgal() -> Finding:
    """Which CGAL tessellates for pfem: its headers, compiled at first use, or the package compas_cgal, which has the plane only?"""
    command = shlex.split(os.environ.get("CXX") or "c++")
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "headers.cpp")
        source.write_text("#include <CGAL/version.h>\n#include <gmp.h>\n#include <mpfr.h>\n")
        done = run(*command, "-std=c++17", "-fsyntax-only", str(source))
    if done.returncode == 0:
        return Finding(True, f"CGAL: native, compiled by {command[0]} at first use")
    package = python("from compas_cgal import _triangulation")
    if package.returncode:
        return Finding(False, f"CGAL: no headers, and compas_cgal does not load: {last_line(package.stderr)}", "uv sync")
    return Finding(True, f"CGAL: compas in the plane, scipy's Qhull in space; for native, the faster one: {CGAL_MEND}")


def rendering(libraries: tuple[str, ...] = ("libEGL.so.1", "libGL.so.1")) -> Finding:
    """Can pyvista draw without a screen? It opens these libraries when it first renders."""
    for library in libraries:
        try:
            ctypes.CDLL(library)
        except OSError:
            return Finding(False, f"pictures without a screen: {library} is not there", GRAPHICS_MEND)
    return Finding(True, f"pictures without a screen: {', '.join(libraries)}")


# --- MPI --------------------------------------------------------------------------------------------------------------
def vendor(text: str) -> str:
    """Whose MPI says this of itself; Intel MPI is an MPICH, and each starts the other's programs."""
    if re.search("open.?mpi", text, re.IGNORECASE):
        return "Open MPI"
    return "MPICH" if re.search("mpich|hydra|intel", text, re.IGNORECASE) else "an unknown MPI"


def launcher() -> Finding:
    """Would the mpirun on PATH start ranks that see each other?"""
    library = python("from mpi4py import MPI; print(MPI.get_vendor()[0])")
    if library.returncode:
        return Finding(False, f"MPI: {last_line(library.stderr)}", MPI_MEND)
    ours = vendor(library.stdout)
    found = shutil.which("mpirun")
    if found is None:
        return Finding(True, f"MPI: {ours}; no mpirun on PATH, start parallel runs by: uv run mpirun -n 2 geofem run ...")
    if (theirs := vendor(run(found, "--version").stdout)) != ours:
        text = f"MPI: {found} is of {theirs}, but mpi4py uses {ours}; each rank would run alone"
        return Finding(False, text, "uv run mpirun -n 2 geofem run ...")
    return Finding(True, f"MPI: {ours}, started by {found}")


# --- caches and disk --------------------------------------------------------------------------------------------------
def jit_cache() -> Path:
    """Where dolfinx keeps compiled forms."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fenics"


def numba_caches() -> list[Path]:
    """Where numba keeps compiled kernels: the first of these that it can write to."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return [Path(os.environ["NUMBA_CACHE_DIR"])]
    return [Path(__file__).parent / "__pycache__", jit_cache().with_name("numba")]


def writable(folder: Path) -> bool:
    """Tried by writing, since the permission bits do not tell of root, quotas and read-only disks."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def form_cache() -> Finding:
    folder = jit_cache()
    if writable(folder):
        return Finding(True, f"cache of compiled forms: {folder}")
    return Finding(False, f"cache of compiled forms: {folder} cannot be written", "export XDG_CACHE_HOME=/tmp/$USER-cache")


def kernel_cache() -> Finding:
    folders = numba_caches()
    for folder in folders:
        if writable(folder):
            return Finding(True, f"cache of compiled kernels: {folder}")
    text = f"cache of compiled kernels: none of {', '.join(map(str, folders))} can be written"
    return Finding(False, text, "export NUMBA_CACHE_DIR=/tmp/$USER-numba")


def disk() -> Finding:
    folder = next(p for p in (jit_cache(), *jit_cache().parents) if p.exists())
    free = shutil.disk_usage(folder).free / 1e9
    if free < FREE_GB:
        text = f"disk: {free:.1f} GB free at {folder}, a first run may need {FREE_GB:g} GB"
        return Finding(False, text, "uv cache prune; or: export XDG_CACHE_HOME=/a/larger/disk")
    return Finding(True, f"disk: {free:.0f} GB free at {folder}")


# --- locks of the form compiler ---------------------------------------------------------------------------------------
def on_local_disk(folder: Path) -> bool:
    """Is the folder on a disk of this machine, so that every process that may write there is in /proc?"""
    device = os.stat(folder).st_dev
    number = f"{os.major(device)}:{os.minor(device)}"
    for line in Path("/proc/self/mountinfo").read_text().splitlines():
        fields, _, kind = line.partition(" - ")  # proc(5): field 3 is major:minor, the type follows " - "
        if fields.split()[2] == number:
            return kind.split()[0] in LOCAL_DISKS
    return False


def compilers_started() -> Iterator[float]:
    """When each other living process that has loaded basix, and so may be compiling a form, was started (s, epoch)."""
    boot = next(int(line.split()[1]) for line in Path("/proc/stat").read_text().splitlines() if line.startswith("btime"))
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if int(process.name) != os.getpid() and "_basixcpp" in (process / "maps").read_text():
                ticks = (process / "stat").read_text().rpartition(")")[2].split()[19]  # proc(5): field 22, starttime
                yield boot + int(ticks) / os.sysconf("SC_CLK_TCK")
        except OSError:  # it has ended, or is another user's, who does not write into this cache
            continue


def stale_locks(cache: Path | None = None) -> list[Path]:
    """Forms that some process began to compile and never finished: dolfinx would wait for them in vain.

    FFCx (codegeneration/jit.py, get_cached_module) marks a compile that is under way by NAME.c and a finished one by
    NAME.c.cached. A mark is stale when it is older than ``JIT_TIMEOUT``, or, on a disk of this machine, when no living
    process that could have made it is older than the mark.
    """
    cache = cache or jit_cache()
    names = {entry.name for entry in os.scandir(cache)} if cache.is_dir() else set()
    open_marks = [cache / n for n in names if n.startswith("libffcx_") and n.endswith(".c") and f"{n}.cached" not in names]
    if not open_marks:
        return []
    owners = list(compilers_started()) if on_local_disk(cache) else [0.0]
    stale = []
    for mark in open_marks:
        try:
            made = mark.stat().st_mtime
        except FileNotFoundError:
            continue
        # A second of grace: the boot time in /proc/stat is a whole number.
        if made < time.time() - JIT_TIMEOUT or not any(start <= made + 1.0 for start in owners):
            stale.append(mark)
    return sorted(stale)


def heal_stale_locks(cache: Path | None = None) -> list[Path]:
    """Remove stale locks with their half-made files, so that the forms are compiled again; answers what was removed.

    Call it on rank 0, before compiling.
    """
    healed = stale_locks(cache)
    for mark in healed:
        for part in mark.parent.glob(f"{mark.stem}.*"):
            part.unlink(missing_ok=True)
    return healed


def locks() -> Finding:
    stale = stale_locks()
    if not stale:
        return Finding(True, "no compile of a form was left unfinished")
    text = f"{len(stale)} compile(s) of a form left unfinished, the first {stale[0].name}; runs would wait for them"
    return Finding(False, text, "rm " + " ".join(shlex.quote(str(mark)) for mark in stale))


# --- all together -----------------------------------------------------------------------------------------------------
CHECKS: tuple[Callable[[], Finding], ...] = (
    compiler, headers, dolfinx, gmsh, cgal, rendering, launcher, form_cache, kernel_cache, locks, disk,
)  # fmt: skip

SYMPTOMS: tuple[tuple[str, tuple[Callable[[], Finding], ...]], ...] = (
    (r"command '[^']*' failed|CompileError|LinkError|Failed JIT compilation", (compiler, headers, form_cache, disk)),
    (r"JIT compilation timed out", (locks,)),
    (r"Permission denied|Read-only file system|Not a directory", (form_cache, kernel_cache)),
    (r"cannot cache function", (kernel_cache,)),
    (r"No space left on device|Disk quota exceeded", (disk, form_cache)),
    (r"No module named '(dolfinx|petsc4py|basix|ufl|ffcx)", (dolfinx,)),
    (r"(?i)PMI|MPI_Init|cannot load MPI library", (launcher,)),
)
"""Words of an exception, and the checks that may tell why."""


def examine() -> list[Finding]:
    """Every check, in order."""
    return [check() for check in CHECKS]


def explain(error: BaseException) -> str | None:
    """Why a run failed, if it was for something that this machine lacks: what, and the line that mends it."""
    text = ""
    cause: BaseException | None = error
    while cause is not None:
        text += f"{type(cause).__name__}: {cause}\n"
        cause = cause.__cause__ or cause.__context__
    missing = re.search(r"(lib[\w+.-]+\.so[\d.]*): cannot open shared object file", text)
    if missing:
        mend = MPI_MEND if missing[1].startswith("libmpi") else GRAPHICS_MEND
        return f"the library {missing[1]} is not there; mend: {mend}"
    for pattern, checks in SYMPTOMS:
        if re.search(pattern, text):
            for check in checks:
                if not (finding := check()).ok:
                    return f"{finding.what}; mend: {finding.mend}"
    return None
