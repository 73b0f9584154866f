"""The parts of the extended finite element method one by one: rules on cut cells, sides and angles, and fields."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from geofem.core import mesh as meshes
from geofem.core.neartip import kolosov
from geofem.methods.xfem import fields, geometry, grid, rules
from geofem.scene import Box, Crack, Material, Region, Scene
from geofem.scenes._tip import TipField

# isort: split
from dolfinx import fem

KINKED = ((-0.1, 0.45), (0.33, 0.52), (0.36, 0.4), (0.62, 0.43))
"""Kinks of more than a right angle inside cells."""


def unit_square(crack=KINKED, n=10):
    """A grid on the unit square and a cutter of it for one crack whose last point is a tip."""
    square = Region("square", Box((0.0, 0.0), (1.0, 1.0)), Material("linear_elastic", 1.0, {"E": 1.0, "nu": 0.3}))
    scene = Scene("plain", (square,), 1.0, (), strain="small", cracks=(Crack(tuple(crack)),))
    body = meshes.build(MPI.COMM_WORLD, scene, n=n)
    mesh_grid = grid.Grid(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))), body.regions)
    lines = geometry.polylines(scene.cracks)
    tips = geometry.find_tips(mesh_grid, lines, np.zeros((1, 2), bool), np.empty((0, 2), int))
    touch = geometry.touching(mesh_grid, lines, tips)
    return mesh_grid, lines, rules.Cutter(mesh_grid, lines, touch, np.array(crack[-1:]))


def test_rules_on_cut_cells_are_exact_for_polynomials():
    grid, _, cutter = unit_square()
    rule = cutter.rule(np.arange(len(grid.T)))
    for a in range(5):
        for b in range(5 - a):
            exact = 1 / (a + 1) / (b + 1)
            assert rule.w @ (rule.x[:, 0] ** a * rule.x[:, 1] ** b) == pytest.approx(exact, rel=1e-13)
    per_cell = np.add.reduceat(rule.w, rule.start[:-1])
    np.testing.assert_allclose(per_cell, grid.area, rtol=1e-12)


def test_each_triangle_of_a_cut_cell_lies_on_one_side():
    _, lines, cutter = unit_square(n=7)
    cells = cutter.touch.cells
    triangles = cutter.triangles(cells, np.full(len(cells), rules.FAR))
    for corners in triangles.corners:
        # nearly at the corners, where a triangle across the crack would be on both sides; nothing is said beyond the tip
        inner = corners.mean(axis=0) + 0.99 * (corners - corners.mean(axis=0))
        if inner[:, 0].max() < 0.62:
            found = {geometry.side(*x, lines, 0, 0.0) for x in inner}
            assert len(found) == 1


def test_polar_rules_take_the_singularity_of_the_tip():
    tip = (0.5037, 0.5071)
    grid, _, cutter = unit_square(((-0.1, 0.5071), tip), n=4)
    rule = cutter.rule(np.arange(len(grid.T)))
    found = rule.w @ (1 / np.hypot(*(rule.x - tip).T))
    theta, w = np.polynomial.legendre.leggauss(200)
    exact = 0.0
    angles = np.sort([np.arctan2(y - tip[1], x - tip[0]) for x in (0, 1) for y in (0, 1)])
    for low, high in zip(angles, [*angles[1:], angles[0] + 2 * np.pi]):
        t = 0.5 * (low + high) + 0.5 * (high - low) * theta
        with np.errstate(divide="ignore"):
            reach = np.min([np.where(d > 0, 1 - a, -a) / d for d, a in zip((np.cos(t), np.sin(t)), tip)], axis=0)
        exact += 0.5 * (high - low) * w @ reach
    # 8 points a direction; the tip is so near an edge that one triangle around it is very flat
    assert found == pytest.approx(exact, rel=1e-3)


def test_touched_cells_are_those_that_every_cell_would_tell():
    grid, lines, cutter = unit_square(n=13)
    told = [
        c
        for c in range(len(grid.T))
        if any(geometry.touches(a, b, *grid.X[grid.T[c]]) for a, b in zip(lines.points, lines.points[1:]))
    ]
    assert cutter.touch.cells.tolist() == told


def test_the_angle_jumps_on_the_kinked_crack_and_nowhere_else():
    lines = geometry.polylines((Crack(((0.0, 0.3), (0.2, 0.0), (0.5, 0.0), (1.0, 0.0))),))
    tips = geometry.Tips(np.array([[1.0, 0.0]]), np.array([[1.0, 0.0]]), np.ones(1), np.zeros(1, int), np.array([3]))
    for a, b in zip(lines.points, lines.points[1:]):
        normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.hypot(*(b - a))
        x = 0.5 * (a + b)
        up, down = (geometry.polar(*(x + s * 1e-9 * normal), lines, tips, 0, 0.0)[1] for s in (1, -1))
        assert up - down == pytest.approx(2 * np.pi, abs=1e-6)
    # across the straight axis, where it has left the crack
    up, down = (geometry.polar(0.1, s * 1e-9, lines, tips, 0, 0.0)[1] for s in (1, -1))
    assert up == pytest.approx(down, abs=1e-6)


def test_kernels_and_scene_agree_on_the_tip_field():
    axis = np.array([np.cos(0.3), np.sin(0.3)])
    lines = geometry.polylines((Crack((tuple(-axis), (0.0, 0.0))),))
    tips = geometry.Tips(np.zeros((1, 2)), axis[None], np.ones(1), np.zeros(1, int), np.array([1]))
    x = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 2))
    u, g = fields.modes_at(x, lines, tips, 0, kolosov(0.3, "plane_strain"))
    for m, (first, second) in enumerate(((1.0, 0.0), (0.0, 1.0))):
        field = TipField((0.0, 0.0), 0.3, first, second, 0.5, 0.3)
        np.testing.assert_allclose(u[:, m], field.displacement(x.T).T, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(g[:, m], np.moveaxis(field.gradient(x.T), 2, 0), rtol=1e-10, atol=1e-14)
        h = 1e-6
        for k, step in enumerate(h * np.eye(2)):
            slope = (field.displacement((x + step).T) - field.displacement((x - step).T)) / (2 * h)
            np.testing.assert_allclose(field.gradient(x.T)[:, k], slope, rtol=1e-4, atol=1e-6)
