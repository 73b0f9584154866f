"""Small things that keep a parallel run together: no hang when one rank fails, and arrays gathered by number."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable
from types import TracebackType
from typing import NoReturn

import numpy as np
from mpi4py import MPI

from geofem.mistake import Mistake


def abort(text: str, status: int) -> NoReturn:
    """Say why on stderr and end all ranks with this exit status."""
    print(text, file=sys.stderr, flush=True, end="")
    # mpirun kills the ranks at once, and now and then before it has passed on what they said last
    time.sleep(0.5)
    MPI.COMM_WORLD.Abort(status)
    # this comes back now and then, before mpirun has done its work
    os._exit(status)


def install_abort_hook() -> None:
    """End all ranks when one of them ends in an exception that nothing caught, instead of leaving them waiting for it.

    A ``Mistake`` prints its one line and gives exit status 2, everything else its traceback and status 1.
    """

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        world = MPI.COMM_WORLD
        if isinstance(error, Mistake):
            if world.rank:
                # most mistakes are made by all ranks at once: let rank 0 say it and end the run
                time.sleep(1.0)
            text, status = f"geofem: {error}\n", 2
        else:
            where = f"rank {world.rank} of {world.size}: " if world.size > 1 else ""
            text, status = where + "".join(traceback.format_exception(kind, error, trace)), 1
        if world.size > 1:
            abort(text, status)
        print(text, file=sys.stderr, flush=True, end="")
        # without other ranks the interpreter ends by itself, but with status 1 whatever the exception was
        sys.exit(status)

    sys.excepthook = hook


def on_root[T](comm: MPI.Intracomm, work: Callable[[], T]) -> T | None:
    """Do serial work on rank 0: its value there, None elsewhere. If it fails, every rank raises.

    Raises a ``Mistake`` on every rank if rank 0 raised one, otherwise rank 0's exception there and RuntimeError elsewhere.
    """
    value, error = None, None
    if comm.rank == 0:
        try:
            value = work()
        except Exception as caught:
            error = caught
    failed = comm.bcast(None if error is None else (isinstance(error, Mistake), str(error)))
    if error is not None:
        raise error
    if failed:
        mistaken, message = failed
        raise Mistake(message) if mistaken else RuntimeError(f"rank 0 failed: {message}")
    return value


def gather_by_id(comm: MPI.Intracomm, ids: np.ndarray, values: np.ndarray, n: int) -> np.ndarray | None:
    """The array of shape (n, ...) on rank 0 whose row ``ids[i]`` is ``values[i]`` of some rank; None on the others.

    ids : (k,) global numbers, e.g. ``Body.original_cells``. values : (k, ...) one row for each.
    The result does not depend on the number of ranks. Rows that no rank names are zero.
    """
    parts = comm.gather((np.asarray(ids), np.asarray(values)))
    if parts is None:
        return None
    whole = np.zeros((n, *values.shape[1:]), values.dtype)
    for rows, part in parts:
        whole[rows] = part
    return whole
