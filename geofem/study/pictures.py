"""Pictures of deformed bodies from snapshots: solids by PyVista, bodies in the plane by Matplotlib, which draws sharper axes.

PyVista needs EGL to draw without a screen, and where EGL is broken it takes the process down: it runs in a process of its own,
under a time limit, and Matplotlib takes over where that process does not bring a picture home.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from geofem.result import Result
from geofem.study import paint
from geofem.study.chart import STYLE
from geofem.study.fields import FIELDS, TITLES, Array, Snapshot, available, colouring, limits, prefixed, title
from geofem.study.paint import is_solid

CELL_TYPES = {"tetra": 10, "hexahedron": 12, "tetra10": 24, "hexahedron20": 25, "hexahedron27": 29}
"""meshio's names and VTK's numbers (vtkCellType.h)."""
FACES = {"tetra": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
         "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))}  # fmt: skip
HEXAHEDRON = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
COLOURS = "viridis"
LIMIT = 60.0
"""Seconds that PyVista may take."""
PICTURED = ("displacement", "mean_stress", "pressure")
"""What the report draws of a run's end."""


def fields(snapshot: Snapshot) -> list[str]:
    """What the report draws of this snapshot."""
    return [field for field in available(snapshot) if field in PICTURED]


def bar(figure: Figure, mappable: Any, field: str, si: bool, **options: Any) -> Any:
    """A colour bar with its title; stresses in kPa or MPa where they are large."""
    largest = float(np.abs(mappable.get_clim()).max())
    words, factor = prefixed(TITLES[field], largest) if si else (title(TITLES[field], si), 1.0)
    drawn = figure.colorbar(mappable, label=words, **options)
    if factor != 1.0:

        def in_units(value: float, _: int) -> str:
            return f"{value / factor:g}".replace("-", "\N{MINUS SIGN}")

        drawn.ax.yaxis.set_major_formatter(FuncFormatter(in_units))
        drawn.ax.xaxis.set_major_formatter(FuncFormatter(in_units))
    return drawn


# --- Matplotlib -------------------------------------------------------------------------------------------------------
def outer_faces(cells: np.ndarray, cell: str) -> tuple[np.ndarray, np.ndarray]:
    """The faces that belong to one cell only, by their corners (m, k), and the cell (m,) of each."""
    family = cell.rstrip("0123456789")
    faces = np.concatenate([cells[:, list(face)] for face in FACES[family]])
    owner = np.tile(np.arange(len(cells)), len(FACES[family]))
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]], owner[first[count == 1]]


def paint_solid(axes: Any, snapshot: Snapshot, values: Array, look: dict[str, Any]) -> list[Any]:
    """Draw a body in space into axes of three dimensions; returns what was added to them. look : ``cmap``, ``norm``."""
    points = np.asarray(snapshot["points"])
    if str(snapshot["cell"]) == "vertex":
        return [axes.scatter(*points.T, c=values, s=6, linewidths=0, **look)]
    faces, owner = outer_faces(np.asarray(snapshot["cells"]), str(snapshot["cell"]))
    shown = values[faces].mean(axis=1) if len(values) == len(points) else values[owner]
    return [axes.add_collection3d(Poly3DCollection(points[faces], array=shown, edgecolor="#00000055", linewidth=0.4, **look))]


def enlarged(times: float) -> str:
    """What a picture says of its displacements."""
    return f"displacements drawn {times:g} times"


def set_up(axes: Any, box: Array, si: bool) -> None:
    """Fix what part of the plane, or of space, the axes show, box : (2, gdim), and label them."""
    for axis, low, high in zip("xyz", *box):
        getattr(axes, f"set_{axis}lim")(low, high)
        getattr(axes, f"set_{axis}label")(title(f"{axis} (m)", si))
    axes.set_aspect("equal")
    if box.shape[1] == 3:
        axes.locator_params(nbins=4)


def by_matplotlib(snapshot: Snapshot, path: Path, field: str, si: bool, times: float = 1.0) -> None:
    """Draw the body with Matplotlib into a PNG file, its displacements multiplied."""
    values = colouring(snapshot, field)
    snapshot = paint.magnified(snapshot, times)
    solid = is_solid(snapshot)
    side = paint.spacing(snapshot) if str(snapshot["cell"]) == "vertex" else 0.0
    box = paint.room(paint.bounds(snapshot, side)[None], paint.polygons(snapshot))
    look: dict[str, Any] = {"cmap": COLOURS, "norm": Normalize(*limits(values, field))}
    with matplotlib.rc_context(STYLE | {"font.size": 13}):
        width, height = (1.0, 1.0) if solid else np.ptp(box, axis=0)
        figure = Figure(figsize=(2.0 + 4.6 * float(np.clip(width / height, 0.5, 1.6)), 5.2), layout="constrained")
        axes: Any = figure.add_subplot(projection="3d") if solid else figure.add_subplot()
        set_up(axes, box, si)
        if times != 1.0:
            axes.set_title(enlarged(times), loc="left", fontsize="medium")
        paint_solid(axes, snapshot, values, look) if solid else paint.body(axes, snapshot, values, side, look)
        extend = "both" if FIELDS[field].tail else "neither"
        bar(figure, ScalarMappable(**look), field, si, ax=axes, shrink=0.85, extend=extend)
        figure.savefig(path, dpi=120)


# --- PyVista ----------------------------------------------------------------------------------------------------------
def dataset(snapshot: Snapshot, values: Array, words: str) -> Any:
    """The body as PyVista takes it, with its values under ``words``; material points with ``edges`` (n, 9) as their domains."""
    import pyvista

    points = np.asarray(snapshot["points"], float)
    cell = str(snapshot["cell"])
    if cell == "vertex" and "edges" in snapshot:
        half = np.asarray(snapshot["edges"], float).reshape(-1, 3, 3)
        points = (points[:, None] + HEXAHEDRON @ half).reshape(-1, 3)
        body = pyvista.UnstructuredGrid({12: np.arange(len(points)).reshape(-1, 8)}, points)
    elif cell == "vertex":
        body = pyvista.PolyData(points)
    else:
        body = pyvista.UnstructuredGrid({CELL_TYPES[cell]: np.asarray(snapshot["cells"])}, points)
    (body.point_data if len(values) == body.n_points else body.cell_data)[words] = values
    return body


def add_body(plotter: Any, body: Any, words: str, span: tuple[float, float], side: float, **options: Any) -> None:
    """Draw what ``dataset`` made: cells with their edges, points as balls about ``side`` (m) wide."""
    pixels = float(np.clip(700.0 * side / (body.length or 1.0), 4.0, 40.0))
    dots = {"style": "points", "point_size": pixels, "render_points_as_spheres": True}
    cells = {"show_edges": body.n_cells < 20_000, "ambient": 0.3, "edge_opacity": 0.3}
    of_points = body.n_cells == body.n_points
    plotter.add_mesh(body, scalars=words, cmap=COLOURS, clim=span, **(dots if of_points else cells), **options)


def look_at(plotter: Any, si: bool, bounds: Any) -> None:
    """Axes with labels around ``bounds``, seen from the front, a little from the right and above."""
    sides = np.ptp(np.reshape(bounds, (3, 2)), axis=1)
    names = {f"{axis}title": title(f"{axis} (m)", si) for axis in "xyz"}
    labels = {f"n_{axis}labels": 3 if side > 0.4 * sides.max() else 2 for axis, side in zip("xyz", sides)}
    plotter.show_bounds(bounds=bounds, color="black", font_size=20, location="outer", fmt="%.3g", **names, **labels)
    plotter.view_vector((0.6, -1.2, 0.5), viewup=(0, 0, 1))


def by_pyvista(snapshot: Snapshot, path: Path, field: str, si: bool = True) -> None:
    """Draw a solid with PyVista into a PNG file; in a process of its own only, see the module's docstring."""
    import pyvista

    values = colouring(snapshot, field)
    words, factor = (
        prefixed(TITLES[field], float(np.abs(limits(values, field)).max())) if si else (title(TITLES[field], si), 1.0)
    )
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 840))
    plotter.set_background("white")
    options = {"title_font_size": 28, "label_font_size": 26, "color": "black", "fmt": "%.3g", "width": 0.6, "position_x": 0.2}
    body = dataset(snapshot, values / factor, words)
    side = paint.spacing(snapshot) if str(snapshot["cell"]) == "vertex" else 0.0
    add_body(plotter, body, words, limits(values / factor, field), side, scalar_bar_args=options)
    look_at(plotter, si, body.bounds)
    plotter.screenshot(str(path))


def apart(module: str, *words: Any, seconds: float) -> bool:
    """Run a module of this package with PyVista in a process of its own; False if that failed or took too long."""
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    # Without a screen VTK tries X first, and some of its versions end the process there.
    environment.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    command = [sys.executable, "-m", module, *map(str, words)]
    try:
        subprocess.run(command, env=environment, capture_output=True, timeout=seconds, check=True)
    except (OSError, subprocess.SubprocessError):
        return False
    return True


def by_pyvista_apart(folder: Path, path: Path, field: str, si: bool = True) -> bool:
    """Draw with PyVista in a process of its own; False if that brought no picture."""
    path.unlink(missing_ok=True)
    if not apart("geofem.study.pictures", folder, path, field, "si" if si else "bare", seconds=LIMIT):
        path.unlink(missing_ok=True)
        return False
    return path.exists()


def draw(folder: Path, path: Path, field: str = "displacement", si: bool = True, small: bool = False) -> Path:
    """Draw the deformed body of the result in ``folder``, coloured by one of its ``fields``, into the PNG file ``path``.

    si : units are written beside the names; False for a dimensionless scene.
    small : the strain is, and displacements are drawn as large as shows them.
    Raises ``Mistake`` if the folder holds no result.
    """
    snapshot = Result.load(folder).snapshot
    path.parent.mkdir(parents=True, exist_ok=True)
    if not (is_solid(snapshot) and by_pyvista_apart(folder, path, field, si)):
        by_matplotlib(snapshot, path, field, si, paint.magnification(snapshot) if small else 1.0)
    return path


if __name__ == "__main__":
    by_pyvista(Result.load(Path(sys.argv[1])).snapshot, Path(sys.argv[2]), sys.argv[3], sys.argv[4] == "si")
