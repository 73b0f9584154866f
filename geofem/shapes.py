"""Shapes of bodies: boxes, polygons, rings, discs, and meshes from files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geofem.mistake import Mistake

Array = np.ndarray
Point = tuple[float, ...]


@dataclass(frozen=True)
class Box:
    """A rectangle (2D) or a cuboid (3D) between two corners."""

    low: Point
    high: Point

    def __post_init__(self) -> None:
        if len(self.low) != len(self.high) or not all(a < b for a, b in zip(self.low, self.high)):
            raise Mistake(f"Box: the corner {self.high} must lie above {self.low} in every direction")

    @property
    def bounds(self) -> tuple[Point, Point]:
        return self.low, self.high

    def contains(self, x: Array) -> Array:
        return np.all([(a <= xi) & (xi <= b) for a, b, xi in zip(self.low, self.high, x)], axis=0)


@dataclass(frozen=True)
class Polygon:
    """A simple polygon, corners counter-clockwise, with round holes. Four corners and no hole can be meshed by a mapped grid."""

    points: tuple[Point, ...]
    holes: tuple[Disc, ...] = ()

    def __post_init__(self) -> None:
        x, y = np.array(self.points).T
        if len(self.points) < 3 or np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) <= 0:
            raise Mistake("Polygon: give at least three corners, counter-clockwise")

    @property
    def bounds(self) -> tuple[Point, Point]:
        p = np.array(self.points)
        return tuple(p.min(0).tolist()), tuple(p.max(0).tolist())

    def contains(self, x: Array) -> Array:
        """Even-odd rule: which of the points x (2, n) lie inside."""
        inside = np.zeros(x.shape[1], bool)
        for (ax, ay), (bx, by) in zip(self.points, self.points[1:] + self.points[:1]):
            if ay == by:
                continue
            crosses = (ay > x[1]) != (by > x[1])
            inside ^= crosses & (x[0] < ax + (x[1] - ay) * (bx - ax) / (by - ay))
        return inside & ~np.any([hole.contains(x) for hole in self.holes], axis=0)


@dataclass(frozen=True)
class Ring:
    """The annulus inner <= |x - centre| <= outer (m)."""

    centre: Point
    inner: float
    outer: float

    def __post_init__(self) -> None:
        if not 0 < self.inner < self.outer:
            raise Mistake(f"Ring: needs 0 < inner < outer, got {self.inner:g} and {self.outer:g}")

    @property
    def bounds(self) -> tuple[Point, Point]:
        return (
            tuple(c - self.outer for c in self.centre),
            tuple(c + self.outer for c in self.centre),
        )

    def contains(self, x: Array) -> Array:
        r = np.hypot(x[0] - self.centre[0], x[1] - self.centre[1])
        return (self.inner <= r) & (r <= self.outer)


@dataclass(frozen=True)
class Disc:
    """The disc |x - centre| <= radius (m)."""

    centre: Point
    radius: float

    def __post_init__(self) -> None:
        if not self.radius > 0:
            raise Mistake(f"Disc: the radius must be positive, got {self.radius:g}")

    @property
    def bounds(self) -> tuple[Point, Point]:
        return tuple(c - self.radius for c in self.centre), tuple(c + self.radius for c in self.centre)

    def contains(self, x: Array) -> Array:
        return np.hypot(x[0] - self.centre[0], x[1] - self.centre[1]) <= self.radius


@dataclass(frozen=True)
class MeshFile:
    """A mesh read from a Gmsh .msh file or any format that meshio reads; ``group`` picks one physical group of cells."""

    path: Path
    group: str | None = None


Shape = Box | Polygon | Ring | Disc | MeshFile
