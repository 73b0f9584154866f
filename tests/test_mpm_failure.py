"""Where material point methods fail, on purpose: neighbours that part, cell crossing, light nodes, null space, tangling."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from points import loaded

import geofem
from geofem.methods.mpm import GimpMpm, LinearMpm, frozen
from geofem.methods.mpm.timestep import SAFETY
from geofem.result import Result
from geofem.study.maps import MAPS
from geofem.worker import analyse

PARTS = {"hat": lambda ppc: ppc, "gimp": lambda ppc: ppc + 1, "bspline2": lambda ppc: 2 * ppc}
"""Stretch from which two neighbours share no node at the worst offset: twice the reach of a weight less one cell, by their distance."""


# --- neighbours that part -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape", PARTS)
def test_neighbours_part_at_the_stretch_of_their_kernel(shape: str) -> None:
    for ppc in (1, 2, 3, 4):
        at = PARTS[shape](ppc)
        # 200 offsets see a pair part within 1/200 of a cell beyond the limit: ppc / 200 of stretch
        assert frozen.parted(shape, ppc, at - 0.01) == 0 < frozen.parted(shape, ppc, at + 0.02 * ppc)


@pytest.mark.parametrize("shape, most", [("cpgimp", 12.0), ("cpdi", 4.0)])
def test_domains_that_stretch_never_part(shape: str, most: float) -> None:
    for ppc in (1, 3):
        assert not any(frozen.parted(shape, ppc, s, 50) for s in np.linspace(1.0, most, 12))


def test_parting_stretch_is_found_by_bisection() -> None:
    assert frozen.parting_stretch("hat", 2) == pytest.approx(2.0, abs=0.02)
    assert frozen.parting_stretch("hat", 4, most=3.5) is None


def pulled(method: str, stretch: float, **knobs: Any) -> Result:
    """The soft bar with affine velocities, in which the points stay evenly spread."""
    return geofem.run("stretch", method, stretch=stretch, n=4, **{"transfer": "apic", "scheme": "usl", **knobs})


@pytest.mark.parametrize("method, expected", [("mpm-linear", 2.0), ("mpm-gimp", 3.0)])
def test_bar_falls_apart_where_its_neighbours_part(method: str, expected: float) -> None:
    """Within two steps of 0.02 of stretch beyond the geometry's limit, and a look every quarter of a cell."""
    result = pulled(method, 5.0)
    assert result.status == "failed" and result.cause == "fracture"
    assert result.at["stretch"] == pytest.approx(expected, abs=0.15)  # 2.03, 2.98
    assert result.qoi["stretch"] == pytest.approx(result.at["stretch"]) and "share no node" in str(result.message)


def test_contiguous_domains_hold_to_twelve_times_the_length() -> None:
    result = pulled("mpm-gimp", 12.0, kernel="contiguous")
    assert result.status == "ok" and result.error["stress"] < 0.02  # 4e-3


def test_domains_that_keep_touching_hold() -> None:
    result = pulled("mpm-cpdi", 4.0, transfer="flip")
    assert result.status == "ok" and result.error["displacement"] < 0.01  # 1e-3


def test_noise_of_a_stiff_bar_parts_it_early() -> None:
    """Cell crossing moves the points of a stiff bar, so that some part at three quarters of the stretch that they could bear."""
    result = pulled("mpm-linear", 5.0, E=1e5)
    assert result.cause == "fracture" and result.at["stretch"] < 1.6  # 1.45


# --- light nodes and the time step ------------------------------------------------------------------------------------------
def test_last_point_past_a_node_rules_the_step_of_hats() -> None:
    """A node that only a point xi cells past the one before reaches: mass xi m_p and stiffness that of the point, by 2 sqrt(xi)."""
    for xi in (1e-6, 1e-4, 1e-2):
        assert frozen.critical_step("hat", 2, 1.0, 0.25 + xi) == pytest.approx(2 * math.sqrt(xi), rel=5 * xi + 1e-6)


@pytest.mark.parametrize("shape, least", [("gimp", 0.81), ("cpdi", 0.91)])
def test_smooth_kernels_have_a_step_for_all_offsets(shape: str, least: float) -> None:
    assert least < frozen.worst_step(shape) < least + 0.02


@pytest.mark.parametrize("small_mass, least", [(1e-4, 0.02), (1e-2, 0.199), (0.1, 0.6)])
def test_joined_light_nodes_lift_the_step_of_hats(small_mass: float, least: float) -> None:
    """The lightest node left has the share ``small_mass`` of a point: 2 sqrt(small_mass)."""
    offsets = [(0.25 + xi) % 1 for xi in (*np.geomspace(1e-6, 0.1, 26), 1.001 * small_mass)]
    assert frozen.worst_step("hat", offsets=offsets) < 2.1e-3
    assert least <= frozen.worst_step("hat", small_mass=small_mass, offsets=offsets) < 1.06 * 2 * math.sqrt(small_mass)


UNLUCKY = 0.3
"""The last point is a twentieth of a cell past a node: 2 sqrt(.05) = .45."""


def swung(method: str = "mpm-linear", **knobs: Any) -> Result:
    scene = loaded("offset_bar", offset=knobs.pop("offset", UNLUCKY))
    return geofem.run(scene, method, **{"n": 8, "scheme": "usl", "small_mass": 0.0, **knobs})


def test_hats_explode_above_the_step_of_their_lightest_node() -> None:
    bound = 2 * math.sqrt(0.05)
    died, held = swung(cfl=1.1 * bound), swung(cfl=0.6 * bound)
    assert died.status == "failed" and died.cause in ("energy", "cfl") and died.work["steps"] < 100
    assert held.status == "ok"
    assert swung(cfl=0.6, small_mass=0.1).status == "ok", "the remedy"
    assert swung(cfl=0.6, method="mpm-gimp").status == "ok", "smooth kernels have no such node"


def test_nodal_step_is_stable_where_courants_explodes() -> None:
    died, held = swung(cfl=0.9), swung(cfl=0.9, dt_control="nodal")
    assert died.status == "failed" and died.cause in ("energy", "cfl")
    assert held.status == "ok" and held.checks["energy"] < 0.05


def test_strains_from_velocities_of_the_points_spare_light_nodes() -> None:
    """usf and musl: what a light node makes of its force is gone once it went through the points."""
    for scheme in ("musl", "usf"):
        assert swung(cfl=0.9, offset=0.2501, scheme=scheme).status == "ok"


@pytest.mark.parametrize("method", [LinearMpm(), GimpMpm()], ids=lambda m: m.name)
def test_nodal_bound_is_on_the_safe_side(method: Any) -> None:
    """Never below the largest frequency of the bar, and not far above it: it heeds motions across the bar as well."""
    for offset in (0.0, 0.3, 0.6, 0.8):
        model = method.build(loaded("offset_bar", offset=offset), n=8, scheme="usl", dt_control="nodal", small_mass=0.0)
        bound = model._nodal.frequency(model) / SAFETY[model.kind.scheme] * model.h  # waves run at 1 m/s
        cloud = model.bodies[0].cloud
        m, K = frozen.assemble(model.kind, cloud, model.grid.lattice, cloud.volume)
        exact = math.sqrt(frozen.frequencies2(m, K)[-1])
        assert exact * (1 - 1e-9) < bound < 2.5 * exact, (offset, exact, bound)


def test_nodal_step_heeds_the_deformed_material() -> None:
    """A neo-Hookean bar stretched by 5 carries waves sqrt((lambda (1 - ln 5) + 26 mu) / (lambda + 2 mu)) times as fast."""
    model = LinearMpm().build(loaded("offset_bar"), n=8, scheme="usl", dt_control="nodal")
    (body,) = model.bodies
    lam, mu = body.par[:2]
    before, speeds = model._nodal.frequency(model), list(model._sounds)
    body.own("F")[:, 0] = 5.0
    model._sounds, model._nodal._looked = model._speeds_of_waves(), -100
    faster = math.sqrt((lam * (1 - math.log(5.0)) + 26 * mu) / (lam + 2 * mu))
    assert model._sounds[0] == pytest.approx(faster * speeds[0], rel=1e-9)
    assert model._nodal.frequency(model) == pytest.approx(faster * before, rel=1e-9)


# --- null space -----------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape", ["hat", "gimp", "cpdi"])
def test_beyond_a_point_a_cell_every_kernel_has_motions_that_no_point_sees(shape: str) -> None:
    """A row of N points has rank N at most, and stretch N / ppc nodes; before, no node but those at the ends can go unseen."""
    cells = 32
    for ppc in (1, 2):
        for offset in (0.1, 0.37, 0.8):
            assert frozen.null_modes(shape, ppc, 0.9 * ppc, offset, cells) == 0
            unseen = frozen.null_modes(shape, ppc, 1.2 * ppc, offset, cells)
            assert abs(unseen - 0.2 * ppc * cells) <= 3, "stretch N / ppc nodes less N points, give or take the ends"


def test_null_space_is_an_analysis_of_a_map() -> None:
    """Of the nodes of a row at stretch 3 with two points a cell a third goes unseen."""
    result = analyse(MAPS["nullspace"].analysis, "frozen row", "mpm-cpdi", {"stretch": 3.0, "cells": 32})
    assert result.status == "ok" and result.error["null_modes"] == pytest.approx(1 / 3, abs=0.03)
    assert frozen.null_share("mpm-linear", stretch=1.5)["null_modes"] == 0
