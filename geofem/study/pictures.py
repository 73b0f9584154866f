"""Pictures of deformed bodies from snapshots: solids by PyVista, bodies in the plane by Matplotlib, which draws sharper axes.

PyVista needs EGL to draw without a screen, and where EGL is broken it takes the process down: it runs in a process of its own,
under a time limit, and Matplotlib takes over where that process does not bring a picture home.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from geofem.result import Result
from geofem.study.chart import STYLE

CELL_TYPES = {"tetra": 10, "hexahedron": 12, "tetra10": 24, "hexahedron20": 25, "hexahedron27": 29}
"""meshio's names and VTK's numbers (vtkCellType.h)."""
CORNERS = {"triangle": (0, 1, 2), "triangle6": (0, 3, 1, 4, 2, 5), "quad": (0, 1, 2, 3), "quad8": (0, 4, 1, 5, 2, 6, 3, 7),
           "quad9": (0, 4, 1, 5, 2, 6, 3, 7)}  # fmt: skip
"""The nodes around a cell, with those in the middle of its sides where it has them."""
FACES = {"tetra": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
         "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))}  # fmt: skip
COLOURS = "viridis"
LIMIT = 60.0
"""Seconds that PyVista may take."""

Snapshot = Mapping[str, Any]


def colouring(snapshot: Snapshot, field: str) -> np.ndarray:
    """One number per point or cell: the length of ``displacement`` (m), or the ``mean_stress`` (Pa, compression negative)."""
    if field == "mean_stress":
        return np.asarray(snapshot["stress"], float)[:, :3].mean(axis=1)
    return np.linalg.norm(snapshot["displacement"], axis=1)


def limits(values: np.ndarray, field: str) -> tuple[float, float]:
    """What the colours span; a stress leaves out 2 % at either end, as it grows without bound at corners."""
    low, high = np.percentile(values, (2, 98) if field == "mean_stress" else (0, 100))
    return float(low), float(high if high > low else low + 1e-12)


TITLES = {"displacement": "displacement magnitude (m)", "mean_stress": "mean stress (Pa)"}
"""What can be drawn of a snapshot; the mean stress where it holds the ``stress``."""


def title(words: str, si: bool) -> str:
    """A label that ends with its unit, or without it for a dimensionless scene."""
    return words if si else words.rpartition(" (")[0]


def fields(snapshot: Snapshot) -> list[str]:
    """What can be drawn of this snapshot."""
    return [field for field, needed in (("displacement", "displacement"), ("mean_stress", "stress")) if needed in snapshot]


def is_solid(snapshot: Snapshot) -> bool:
    return np.asarray(snapshot["displacement"]).shape[1] == 3


# --- Matplotlib -------------------------------------------------------------------------------------------------------
def outer_faces(cells: np.ndarray, cell: str) -> tuple[np.ndarray, np.ndarray]:
    """The faces that belong to one cell only, by their corners (m, k), and the cell (m,) of each."""
    family = cell.rstrip("0123456789")
    faces = np.concatenate([cells[:, list(face)] for face in FACES[family]])
    owner = np.tile(np.arange(len(cells)), len(FACES[family]))
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]], owner[first[count == 1]]


def draw_plane(figure: Figure, snapshot: Snapshot, values: np.ndarray, cell: str, si: bool) -> Any:
    points = np.asarray(snapshot["points"])[:, :2]
    axes = figure.subplots()
    if cell == "vertex":
        # Dots of about the distance between neighbouring points, as they lie in a square of the same number.
        dots = np.clip(3e4 / len(points), 2.0, 60.0)
        drawn: Any = axes.scatter(*points.T, c=values, s=dots, cmap=COLOURS, linewidths=0)
    else:
        around = np.asarray(snapshot["cells"])[:, list(CORNERS[cell])]
        if len(values) == len(points):
            fans = [around[:, [0, i, i + 1]] for i in range(1, around.shape[1] - 1)]
            drawn = axes.tripcolor(*points.T, values, triangles=np.concatenate(fans), shading="gouraud", cmap=COLOURS)
        else:
            drawn = axes.add_collection(PolyCollection(points[around], array=values, cmap=COLOURS))
        if len(around) < 1500:
            axes.add_collection(PolyCollection(points[around], facecolor="none", edgecolor="#00000066", linewidth=0.6))
        axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel(title("x (m)", si))
    axes.set_ylabel(title("y (m)", si))
    return drawn


def draw_solid(figure: Figure, snapshot: Snapshot, values: np.ndarray, cell: str, si: bool) -> Any:
    points = np.asarray(snapshot["points"])
    axes: Any = figure.add_subplot(projection="3d")
    if cell == "vertex":
        drawn = axes.scatter(*points.T, c=values, s=6, cmap=COLOURS, linewidths=0)
    else:
        faces, owner = outer_faces(np.asarray(snapshot["cells"]), cell)
        shown = values[faces].mean(axis=1) if len(values) == len(points) else values[owner]
        drawn = axes.add_collection3d(
            Poly3DCollection(points[faces], array=shown, cmap=COLOURS, edgecolor="#00000055", linewidth=0.4)
        )
        axes.auto_scale_xyz(*points.T)
    axes.set_aspect("equal")
    axes.set_xlabel(title("x (m)", si))
    axes.set_ylabel(title("y (m)", si))
    axes.set_zlabel(title("z (m)", si))
    axes.locator_params(nbins=4)
    return drawn


def by_matplotlib(snapshot: Snapshot, path: Path, field: str, si: bool) -> None:
    """Draw the body with Matplotlib into a PNG file."""
    values = colouring(snapshot, field)
    with matplotlib.rc_context(STYLE | {"font.size": 13}):
        width, height = np.ptp(np.asarray(snapshot["points"])[:, :2], axis=0) if not is_solid(snapshot) else (1.0, 1.0)
        figure = Figure(figsize=(2.0 + 4.6 * float(np.clip(width / (height or 1.0), 0.5, 1.6)), 5.2), layout="constrained")
        draw = draw_solid if is_solid(snapshot) else draw_plane
        drawn = draw(figure, snapshot, values, str(snapshot["cell"]), si)
        drawn.set_clim(*limits(values, field))
        extend = "both" if field == "mean_stress" else "neither"
        figure.colorbar(drawn, ax=figure.axes[0], label=title(TITLES[field], si), shrink=0.85, extend=extend)
        figure.savefig(path, dpi=120)


# --- PyVista ----------------------------------------------------------------------------------------------------------
def by_pyvista(snapshot: Snapshot, path: Path, field: str) -> None:
    """Draw a solid with PyVista into a PNG file; in a process of its own only, see the module's docstring."""
    import pyvista

    cell = str(snapshot["cell"])
    points = np.asarray(snapshot["points"], float)
    values = colouring(snapshot, field)
    if cell == "vertex":
        body = pyvista.PolyData(points)
    else:
        cells = np.asarray(snapshot["cells"])
        body = pyvista.UnstructuredGrid({CELL_TYPES[cell]: cells}, points)
    (body.point_data if len(values) == len(points) else body.cell_data)[TITLES[field]] = values
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 840))
    plotter.set_background("white")
    dots = (
        {"style": "points", "point_size": 6, "render_points_as_spheres": True}
        if cell == "vertex"
        else {"show_edges": True, "ambient": 0.3}
    )
    bar = {"title_font_size": 28, "label_font_size": 26, "color": "black", "fmt": "%.3g", "width": 0.6, "position_x": 0.2}
    plotter.add_mesh(
        body, scalars=TITLES[field], cmap=COLOURS, clim=limits(values, field), scalar_bar_args=bar, edge_opacity=0.3, **dots
    )
    names = {f"{axis}title": f"{axis} (m)" for axis in "xyz"}
    labels = {f"n_{axis}labels": 3 for axis in "xyz"}
    plotter.show_bounds(color="black", font_size=24, location="outer", fmt="%.3g", **names, **labels)
    plotter.view_vector((0.6, -1.2, 0.5), viewup=(0, 0, 1))
    plotter.screenshot(str(path))


def by_pyvista_apart(folder: Path, path: Path, field: str) -> bool:
    """Draw with PyVista in a process of its own; False if that brought no picture."""
    path.unlink(missing_ok=True)
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    command = [sys.executable, "-m", "geofem.study.pictures", str(folder), str(path), field]
    try:
        subprocess.run(command, env=environment, capture_output=True, timeout=LIMIT, check=True)
    except (OSError, subprocess.SubprocessError):
        path.unlink(missing_ok=True)
        return False
    return path.exists()


def draw(folder: Path, path: Path, field: str = "displacement", si: bool = True) -> Path:
    """Draw the deformed body of the result in ``folder``, coloured by one of its ``fields``, into the PNG file ``path``.

    si : units are written beside the names; False for a dimensionless scene.
    Raises ``Mistake`` if the folder holds no result.
    """
    snapshot = Result.load(folder).snapshot
    path.parent.mkdir(parents=True, exist_ok=True)
    if not (is_solid(snapshot) and by_pyvista_apart(folder, path, field)):
        by_matplotlib(snapshot, path, field, si)
    return path


if __name__ == "__main__":
    by_pyvista(Result.load(Path(sys.argv[1])).snapshot, Path(sys.argv[2]), sys.argv[3])
