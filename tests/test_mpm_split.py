"""Points that are split when their domains outgrow the cells."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from points import SOFT, block, build
from test_mpm_seed import areas

from geofem import materials
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.points import Body
from geofem.methods.mpm.seed import fill
from geofem.methods.mpm.shapes import SHAPES
from geofem.methods.mpm.watch import Splitter
from geofem.scene import Box, Probe

Array = np.ndarray
CASES = [(s, d, t) for s in ("cpgimp", "cpdi", "cpdi2") for d in (2, 3) for t in ("flip", "apic") if (s, d) != ("cpdi2", 3)]


def stretched(shape: str, dim: int, transfer: str) -> tuple[Body, Splitter, float]:
    """A body of 4^d points with random velocities, stresses and deformations; no kernel is compiled for it."""
    kind = Kind(shape, dim, axial=False, small=False, scheme="usl", transfer=transfer, loaded=True, spent=False, cure=False)
    law, h = materials.get("neo_hooke"), 0.25
    seeds = fill(Box((0.0,) * dim, (1.0,) * dim), 0.25)
    body = Body(seeds, SOFT, law.parameters(SOFT, 1.0), kind, SHAPES[shape].domain, h, True)
    rng = np.random.default_rng(3)
    for name in ("v", "C", "tau", "state", "grip"):
        body.own(name)[:] = rng.normal(size=body.own(name).shape)
    F = np.eye(dim) + 0.1 * rng.normal(size=(body.n, dim, dim))
    F[: body.n // 2, 0, 0] += 1.0
    body.own("F")[:, : dim * dim] = F.reshape(body.n, -1)
    if shape == "cpdi2":
        corners = body.own("domain").reshape(-1, 4, 2)
        around = body.own("x")[:, None] + np.einsum("nij,ncj->nci", F, corners - body.own("x")[:, None])
        body.own("domain")[:] = around.reshape(-1, 8)
    body.settle()
    return body, Splitter(kind, SHAPES[shape], 1.3), h


def totals(body: Body, dim: int) -> dict[str, Any]:
    m, v, x = (body.own(name) for name in ("mass", "v", "x"))
    out = {"mass": m.sum(), "volume": body.own("volume").sum(), "momentum": m @ v, "centre": m @ x, "origin": m @ body.own("X")}
    out |= {"grip": body.own("grip").sum(axis=0), "stress": body.own("volume") @ body.own("tau")}
    if body.kind.transfer == "apic":
        # the moment of the affine velocities about the origin, with that of the domains' own inertia left out
        C = body.own("C").reshape(-1, dim, dim)
        out["field"] = np.einsum("p,pi->i", m, v - np.einsum("pij,pj->pi", C, x))
    return out


@pytest.mark.parametrize("shape, dim, transfer", CASES)
def test_a_split_keeps_what_a_point_had(shape: str, dim: int, transfer: str) -> None:
    """Mass, volume, momentum, centre, stress and grip; every number is there once; no domain is left too long."""
    body, splitter, h = stretched(shape, dim, transfer)
    before, count = totals(body, dim), body.n
    long = np.linalg.norm(splitter.edges(body, h), axis=2).max(axis=1)
    assert 0 < np.sum(long > 1.3) < count
    made = splitter._split(body, h)
    assert made == np.sum(long > 1.3) and body.n == body.N == count + made
    for name, value in totals(body, dim).items():
        assert value == pytest.approx(before[name], rel=1e-12, abs=1e-12), name
    ids = body.own("id")
    assert len(np.unique(ids)) == body.n and np.sum(ids >= body.born) == 2 * made
    assert set(np.unique(ids % body.born)) == set(range(count))
    while splitter._split(body, h):
        pass
    assert np.linalg.norm(splitter.edges(body, h), axis=2).max() <= 1.3
    assert len(np.unique(body.own("id"))) == body.n
    if shape == "cpdi2":
        # halves tile their parent
        assert areas(body.own("domain").reshape(-1, 4, 2)).sum() == pytest.approx(
            np.linalg.det(body.own("F")[:, :4].reshape(-1, 2, 2)) @ body.own("volume"), rel=1e-9
        )
    else:
        edges = splitter.edges(body, h)
        exact = body.own("volume") * body.jacobian()
        if shape == "cpdi":
            assert np.abs(np.linalg.det(edges)) * h**dim == pytest.approx(exact, rel=1e-12)


def test_domains_that_do_not_stretch_are_never_split() -> None:
    for shape, small in (("gimp", False), ("bspline2", False), ("cpdi", True)):
        kind = Kind(shape, 2, axial=False, small=small, scheme="usl", transfer="flip", loaded=False, spent=False, cure=False)
        assert Splitter(kind, SHAPES[shape], 0.6).longest == 0.0


@pytest.mark.parametrize(
    "shape, scheme, transfer", [("cpdi", "usl", "flip"), ("cpgimp", "usl", "apic"), ("cpdi2", "usl", "apic")]
)
def test_a_stretching_block_is_split_and_runs_on(shape: str, scheme: str, transfer: str) -> None:
    """Pulled apart until it swings back: conserved quantities are kept, probes follow the parts of a point, the checks agree."""
    at = (0.9, 0.6)
    probes = tuple(Probe(f"u{c}", "displacement", at, c) for c in range(2))
    scene = block(lambda x: np.stack([40.0 * (x[0] - 0.5), 0 * x[1]]), t_end=0.02, probes=probes)
    knobs: dict[str, Any] = {"n": 4, "scheme": scheme, "transfer": transfer}
    split, whole = build(scene, shape, split=0.51, **knobs), build(scene, shape, **knobs)
    farthest = 0.0
    for model in (split, whole):
        while model.t < scene.t_end * (1 - 1e-12):
            model.step(min(model.dt(), scene.t_end - model.t))
            farthest = max(farthest, abs(model.probe(probes[0])))
    assert whole.size()["points"] == 64 and split.size()["points"] > 80
    checks = split.checks()
    assert checks["mass"] < 1e-14 and checks["momentum"] < 1e-12
    ids = split.bodies[0].own("id")
    assert len(np.unique(ids)) == split.bodies[0].n
    for probe in probes:
        # of the way there and back, as that way is nearly back by then
        assert split.probe(probe) == pytest.approx(whole.probe(probe), abs=0.03 * farthest)
    assert split.energy()["kinetic"] == pytest.approx(whole.energy()["kinetic"], rel=0.05)
    # more points, more work
    assert split.work["point_steps"] > 64 * split.work["steps"]
