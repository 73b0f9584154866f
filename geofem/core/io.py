"""Files of a run: pictures and fields that ParaView opens, and checkpoints that any number of ranks can take up.

``Series`` writes .vtu files with a .pvd index from what rank 0 gathered: for all models, particles and changing meshes too.
``FieldFile`` writes VTX (.bp) by all ranks through dolfinx and ADIOS2: for models on one mesh, without gathering anything, with
the full polynomial order. dolfinx 0.11's writer of VTKHDF was tried and is not used: a file takes one field, always called
``u``, at the nodes of the geometry or in the cells, and its mesh cannot move.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import dolfinx.io
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from geofem.core.mpi import on_root
from geofem.mistake import Mistake
from geofem.result import replace_text, write_npz

NODAL = ("displacement", "velocity", "pressure")


class Series:
    """Pictures of a run over time, written by rank 0: ``path`` (.pvd) lists them, each is a .vtu file beside it.

    The points and cells may change from one picture to the next. The index is whole after every picture, so that a run can be
    watched. ``resumed`` (the run's t): pictures up to this t of an earlier run are kept.
    """

    def __init__(self, path: Path, resumed: float | None = None):
        self.path = path.with_suffix(".pvd")
        self.entries: list[tuple[float, str]] = []
        if resumed is not None and self.path.exists():
            found = ElementTree.parse(self.path).iter("DataSet")
            listed = [(float(entry.attrib["timestep"]), entry.attrib["file"]) for entry in found]
            self.entries = [(t, file) for t, file in listed if t <= resumed]

    def write(self, t: float, snapshot: Mapping[str, Any]) -> None:
        """Add a picture: a ``snapshot`` of a model, see ``Result``; an empty one, as on ranks other than 0, is passed over.

        A field with a row for each point is drawn at the points, one with a row for each cell in the cells. If there are as
        many cells as points, only displacements, velocities and pressures, and all fields of particles, are drawn at the points. So are the
        domains of particles, ``edges`` and ``corners``, which a film draws, see ``geofem.study.paint``. The outlines of
        ``rigid`` bodies belong to no point or cell: they stand in an .npz beside the .vtu.
        """
        if not snapshot:
            return
        import meshio

        points, cells, kind = snapshot["points"], np.asarray(snapshot["cells"]), str(snapshot["cell"])
        fields = {k: np.asarray(v) for k, v in snapshot.items() if k not in ("points", "cells", "cell", "rigid")}
        at_points, in_cells = {}, {}
        for name, values in fields.items():
            if values.ndim == 0:
                continue
            if values.ndim == 2 and values.shape[1] == 2:
                values = np.pad(values, ((0, 0), (0, 1)))  # VTK's vectors have three components
            if len(values) == len(points) and (len(points) != len(cells) or kind == "vertex" or name in NODAL):
                at_points[name] = values
            elif len(values) == len(cells):
                in_cells[name] = [values]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        file = f"{self.path.stem}_{len(self.entries):05d}.vtu"
        meshio.Mesh(points, [(kind, cells)], at_points, in_cells).write(self.path.with_name(file))
        beside = self.path.with_name(file).with_suffix(".npz")
        if "rigid" in snapshot:
            write_npz(beside, {"rigid": np.asarray(snapshot["rigid"], float)})
        else:
            beside.unlink(missing_ok=True)
        self.entries.append((t, file))
        rows = "".join(f'<DataSet timestep="{t!r}" file="{file}"/>\n' for t, file in self.entries)
        replace_text(self.path, f'<VTKFile type="Collection" version="0.1"><Collection>\n{rows}</Collection></VTKFile>\n')


class FieldFile:
    """Lagrange functions over time in one VTX file (a folder, ``path`` ending in .bp), written by all ranks together. Collective.

    functions : all of one element on one mesh, their ghosts up to date when they are written; a function is found by its ``name``.
    resumed : the t of a run that is taken up; dolfinx cannot append, and the file is then named after this t.

    The points of each time are where the mesh then stands: in ParaView, warp by the displacement only what does not move. Each
    ``write`` is on the disk when it returns, should the run be killed later. Raises ``Mistake`` where dolfinx lacks ADIOS2.

    The format is BP4, since ParaView reads BP5 only from 5.12 on (github.com/ornladios/ADIOS2/issues/4320). Verified with the
    ADIOS2 package of PyPI (2.12): points, cells, functions and times come back, from 1 and 2 ranks. ParaView's own reader,
    vtkADIOS2VTXReader, could not be tried: VTK's wheel (9.7) does not have it.
    """

    def __init__(self, path: Path, functions: Sequence[fem.Function], resumed: float | None = None):
        if not dolfinx.has_adios2:
            raise Mistake(
                f"{path}: this DOLFINx was built without ADIOS2, which writes .bp files; use the wheel dolfinx-solver-real"
            )
        self.path = path.with_name(f"{path.stem}_from_{resumed:g}.bp" if resumed else f"{path.stem}.bp")
        comm = functions[0].function_space.mesh.comm
        on_root(comm, lambda: self.path.parent.mkdir(parents=True, exist_ok=True))
        self._writer = dolfinx.io.VTXWriter(comm, self.path, list(functions), engine="BP4")

    def write(self, t: float) -> None:
        """Add the present values of the functions as those of time t."""
        self._writer.write(t)

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


def load_checkpoint(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz that rank 0 wrote by ``geofem.result.write_npz``, the same on every rank. Collective.

    Raises ``Mistake`` if the file is not there or cannot be read.
    """
    return MPI.COMM_WORLD.bcast(on_root(MPI.COMM_WORLD, lambda: read_arrays(path)))


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """``load_checkpoint`` on one process."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise Mistake(f"{path}: there is no checkpoint to resume from; run without --resume") from None
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise Mistake(f"{path}: not a checkpoint that can be read ({error}); delete it or give another --out") from None
