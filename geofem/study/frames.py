"""The frames that a run left in its folder: ``fields.pvd``, its .vtu files, and an .npz beside those with rigid bodies."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from geofem.mistake import Mistake
from geofem.study import paint
from geofem.study.fields import Snapshot


class Frames:
    """Snapshots of a run by number, from the first to the last; ``t`` (n,) are their times. Each is read when it is asked for.

    Vectors have three components, also in the plane. small : the strain is, and all frames have their displacements multiplied by
    ``times``, so that those of the last one show. Raises ``Mistake`` if the index, or later a frame, cannot be read; a folder
    without an index has no frames.
    """

    def __init__(self, folder: Path, small: bool = False):
        path = folder / "fields.pvd"
        listed: dict[float, Path] = {}
        if path.exists():
            try:
                for entry in ElementTree.parse(path).iter("DataSet"):
                    listed[float(entry.attrib["timestep"])] = folder / entry.attrib["file"]
            except (ElementTree.ParseError, KeyError, ValueError, OSError) as error:
                raise Mistake(f"{path}: not an index of frames ({error}); run again with --frames") from None
        self.t = np.array(sorted(listed))
        self.files = [listed[t] for t in self.t]
        self.times = 1.0
        if small and self.files and "displacement" in (last := self[-1]):
            self.times = paint.magnification(last)

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, i: int) -> Snapshot:
        """The snapshot of frame i: ``points``, ``cells``, ``cell`` and fields by points or cells."""
        path = self.files[i]
        try:
            mesh = meshio.vtu.read(path)
            (block,) = mesh.cells
            of_cells = {name: values for name, (values,) in mesh.cell_data.items()}
            out = {"points": mesh.points, "cells": block.data, "cell": block.type, **of_cells, **mesh.point_data}
            beside = path.with_suffix(".npz")
            if beside.exists():
                with np.load(beside, allow_pickle=False) as arrays:
                    out["rigid"] = arrays["rigid"]
        except (meshio.ReadError, ElementTree.ParseError, OSError, ValueError, KeyError) as error:
            raise Mistake(f"{path}: not a frame that can be read ({error}); run again with --frames") from None
        return paint.magnified(out, self.times)
