"""The doctor: each lack, made on purpose, is named with the line that mends it; a sound machine is left alone."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from geofem import doctor

FORM = "libffcx_forms_0123456789abcdef"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of forms, in the place where dolfinx would look for it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "fenics"
    folder.mkdir(parents=True)
    return folder


@pytest.fixture
def bare_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH that holds nothing but this folder."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder


@pytest.fixture
def not_a_folder(tmp_path: Path) -> Path:
    """A path below a file: nobody, not even root, can make a folder of it."""
    (tmp_path / "file").touch()
    return tmp_path / "file" / "cache"


def program(path: Path, says: str) -> None:
    path.write_text(f"#!/bin/sh\necho '{says}'\n")
    path.chmod(0o755)


def unfinished(cache: Path, age: float = 0.0, name: str = FORM) -> Path:
    """What a killed compile leaves: the source, an object file, and no mark that it is ready."""
    mark = cache / f"{name}.c"
    for path in (mark, cache / f"{name}.o"):
        path.write_text("/* half */")
        os.utime(path, (time.time() - age,) * 2)
    return mark


# --- compiling --------------------------------------------------------------------------------------------------------
def test_missing_compiler_is_named_with_its_package(bare_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    finding = doctor.compiler()
    assert not finding.ok
    assert finding.mend == "sudo apt-get install -y gcc libc6-dev"


def test_wrong_cc_is_mended_by_the_compiler_that_is_there(bare_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program(bare_path / "gcc", "gcc")
    monkeypatch.setenv("CC", "no-such-compiler -O2")
    finding = doctor.compiler()
    assert not finding.ok and "no-such-compiler" in finding.what
    assert finding.mend == f"export CC={bare_path / 'gcc'}"


def test_compiler_and_headers_are_found_where_they_are() -> None:
    assert doctor.compiler().ok and doctor.headers().ok


def test_missing_python_headers(tmp_path: Path) -> None:
    finding = doctor.headers(tmp_path)
    assert not finding.ok and "Python.h" in finding.what and "python3-dev" in finding.mend


def test_missing_c_headers_are_told_by_the_compiler(tmp_path: Path) -> None:
    (tmp_path / "Python.h").write_text("#include <no_such_header.h>\n")
    finding = doctor.headers(tmp_path)
    assert not finding.ok and "libc6-dev" in finding.mend


# --- libraries --------------------------------------------------------------------------------------------------------
def test_missing_or_old_dolfinx() -> None:
    def none(package: str) -> str:
        raise importlib.metadata.PackageNotFoundError(package)

    assert not doctor.dolfinx(none).ok
    old = doctor.dolfinx(lambda package: "0.9.0")
    assert not old.ok and "0.9.0" in old.what and old.mend == "uv sync"


def test_gmsh_that_does_not_load_is_mended_by_the_graphics_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    said = "Traceback ...\nOSError: libGLU.so.1: cannot open shared object file: No such file or directory\n"
    monkeypatch.setattr(doctor, "python", lambda code: subprocess.CompletedProcess([], 1, "", said))
    finding = doctor.gmsh()
    assert not finding.ok and "libGLU.so.1" in finding.what and "libglu1-mesa" in finding.mend


def test_cgal_is_native_with_its_headers_and_a_package_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program(tmp_path / "c++", "")
    monkeypatch.setenv("CXX", str(tmp_path / "c++"))
    assert "native, compiled" in doctor.cgal().what
    monkeypatch.setenv("CXX", "no-such-compiler")
    finding = doctor.cgal()
    assert finding.ok and "compas" in finding.what and "apt-get install -y g++ libcgal-dev" in finding.what
    monkeypatch.setattr(doctor, "python", lambda code: subprocess.CompletedProcess([], 1, "", "no such module"))
    finding = doctor.cgal()
    assert not finding.ok and finding.mend == "uv sync"


def test_missing_rendering_library() -> None:
    finding = doctor.rendering(("libno_such_library.so.1",))
    assert not finding.ok and "libno_such_library.so.1" in finding.what and "libegl1" in finding.mend


# --- MPI --------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "text, name",
    [
        ("mpirun (Open MPI) 4.1.4\n", "Open MPI"),
        ("HYDRA build details:\n    Version: 4.0.2\n", "MPICH"),
        ("Intel(R) MPI Library for Linux* OS, Version 2021.11\n", "MPICH"),
    ],
)
def test_vendor_of_an_mpi(text: str, name: str) -> None:
    assert doctor.vendor(text) == name


@pytest.mark.parametrize("says, ok", [("mpirun (Open MPI) 4.1.4", False), ("HYDRA build details:", True)])
def test_mpirun_of_another_vendor(bare_path: Path, monkeypatch: pytest.MonkeyPatch, says: str, ok: bool) -> None:
    program(bare_path / "mpirun", says)
    monkeypatch.setattr(doctor, "python", lambda code: subprocess.CompletedProcess([], 0, "MPICH\n", ""))
    finding = doctor.launcher()
    assert finding.ok == ok
    assert ok or finding.mend.startswith("uv run mpirun")


# --- caches and disk --------------------------------------------------------------------------------------------------
def test_unwritable_caches(not_a_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(not_a_folder))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(not_a_folder))
    forms, kernels = doctor.form_cache(), doctor.kernel_cache()
    assert not forms.ok and "XDG_CACHE_HOME" in forms.mend
    assert not kernels.ok and "NUMBA_CACHE_DIR" in kernels.mend


def test_form_cache_is_where_dolfinx_looks(cache: Path) -> None:
    code = "import geofem.core\nfrom dolfinx.jit import get_options\nprint(get_options()['cache_dir'])"
    done = doctor.python(code)
    assert done.stdout.strip() == str(doctor.jit_cache()) == str(cache), done.stderr


def test_full_disk(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor.disk().ok
    monkeypatch.setattr(doctor, "FREE_GB", 1e9)
    assert not doctor.disk().ok


# --- locks of the form compiler ---------------------------------------------------------------------------------------
def test_finished_compile_is_left_alone(cache: Path) -> None:
    mark = unfinished(cache, age=2 * doctor.JIT_TIMEOUT)
    mark.with_suffix(".c.cached").touch()
    assert doctor.heal_stale_locks() == [] and mark.exists()


def test_old_lock_is_healed_with_its_half_made_files(cache: Path) -> None:
    mark = unfinished(cache, age=2 * doctor.JIT_TIMEOUT)
    other = unfinished(cache, name="libffcx_forms_other")
    other.with_suffix(".c.cached").touch()
    assert doctor.heal_stale_locks() == [mark]
    assert sorted(path.name for path in cache.iterdir()) == sorted(f"libffcx_forms_other{s}" for s in (".c", ".c.cached", ".o"))


def test_fresh_lock_without_a_living_owner_is_healed(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = unfinished(cache)
    monkeypatch.setattr(doctor, "on_local_disk", lambda folder: True)
    monkeypatch.setattr(doctor, "compilers_started", lambda: iter([time.time() + 60.0]))
    assert doctor.heal_stale_locks() == [mark]


def test_fresh_lock_is_kept_while_its_owner_may_live(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = unfinished(cache)
    monkeypatch.setattr(doctor, "on_local_disk", lambda folder: True)
    monkeypatch.setattr(doctor, "compilers_started", lambda: iter([time.time() - 60.0]))
    assert doctor.heal_stale_locks() == [] and mark.exists()


def test_fresh_lock_on_a_shared_disk_is_kept(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = unfinished(cache)
    monkeypatch.setattr(doctor, "on_local_disk", lambda folder: False)
    monkeypatch.setattr(doctor, "compilers_started", lambda: iter(()))
    assert doctor.heal_stale_locks() == [] and mark.exists()


def test_living_process_with_basix_is_seen_and_this_one_is_not() -> None:
    """Whoever has loaded basix may be compiling; the start that /proc tells is right to a tick and a second of boot time."""
    code = "import basix, sys; print('ready', flush=True); sys.stdin.read()"
    before = time.time()
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout and other.stdout.readline() == "ready\n"
        assert any(abs(start - before) < 2.0 for start in doctor.compilers_started())
    finally:
        other.communicate("")


def test_doctor_names_the_lock_and_what_it_says_mends_it(cache: Path) -> None:
    mark = unfinished(cache, age=2 * doctor.JIT_TIMEOUT)
    finding = doctor.locks()
    assert not finding.ok and mark.name in finding.what
    subprocess.run(["sh", "-c", finding.mend], check=True)
    assert doctor.locks().ok


# --- why a run failed -------------------------------------------------------------------------------------------------
def test_failed_compile_is_explained_by_the_missing_compiler(bare_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    text = doctor.explain(RuntimeError("Failed JIT compilation of form: command 'gcc' failed: No such file or directory"))
    assert text is not None and "sudo apt-get install -y gcc" in text and "\n" not in text


def test_missing_library_is_explained_through_the_chain_of_causes() -> None:
    try:
        try:
            raise OSError("libGLU.so.1: cannot open shared object file: No such file or directory")
        except OSError as cause:
            raise RuntimeError("no mesh") from cause
    except RuntimeError as error:
        text = doctor.explain(error)
    assert text is not None and "libGLU.so.1" in text and "libglu1-mesa" in text


def test_missing_mpi_is_not_explained_by_graphics() -> None:
    text = doctor.explain(ImportError("libmpi.so.12: cannot open shared object file: No such file or directory"))
    assert text is not None and text.endswith(doctor.MPI_MEND)


def test_unwritable_cache_is_explained(not_a_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(not_a_folder))
    text = doctor.explain(PermissionError(13, "Permission denied", str(not_a_folder)))
    assert text is not None and "XDG_CACHE_HOME" in text


def test_stale_lock_is_explained(cache: Path) -> None:
    mark = unfinished(cache, age=2 * doctor.JIT_TIMEOUT)
    text = doctor.explain(TimeoutError("JIT compilation timed out, probably due to a failed previous compile."))
    assert text is not None and str(mark) in text


def test_an_error_of_the_code_is_not_blamed_on_the_machine() -> None:
    assert doctor.explain(ValueError("shapes (2,) and (3,) do not match")) is None
