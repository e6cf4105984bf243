# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarse copies and patches of wrapped meshes agree with the whole mesh where they must."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.transfer.wrapping.coarsening import Coarsening
from zoomout_core.transfer.wrapping.elastic import Elastic, Pins, RestMesh

BALL = ball(1, count=700, seed=3)


def rest_mesh() -> RestMesh:
    mesh = BALL.working
    stiffness, areas = mesh_laplacian(mesh.vertices, mesh.oriented_triangles)
    ones, averaging = np.ones(len(areas)), ScreenedSmoothing.of(areas, stiffness, 0.02)
    return RestMesh(
        mesh.vertices, mesh.vertex_normals, mesh.oriented_triangles, stiffness, areas, ones, ones, averaging
    )


def no_pins() -> Pins:
    return Pins(csr_array((0, 700)), np.zeros((0, 3)))


def test_similarities_are_lifted_exactly() -> None:
    rest, triangles = BALL.vertices, BALL.triangles
    coarse = Coarsening.of(rest, triangles, 150)
    assert 100 < len(coarse.vertices) < 250
    linear = 1.7 * Rotation.from_rotvec([0.3, -0.8, 0.2]).as_matrix()
    turns = np.tile(linear, (len(coarse.vertices), 1, 1))
    lifted = coarse.lift(rest, rest[coarse.vertices] @ linear.T + 5, turns, np.zeros_like(rest))
    assert np.abs(lifted - rest @ linear.T - 5).max() < 1e-9


def test_components_are_lifted_independently() -> None:
    """Only the outer one of two concentric balls moves."""
    both = Surface.joined([BALL, BALL.with_vertices(0.98 * BALL.vertices)])
    coarse = Coarsening.of(both.vertices, both.triangles, 200)
    outer = coarse.vertices < 700
    moved = both.vertices[coarse.vertices] + np.where(outer, 3.0, 0.0)[:, None]
    turns = np.tile(np.eye(3), (len(moved), 1, 1))
    lifted = coarse.lift(both.vertices, moved, turns, both.vertices)
    assert np.abs(lifted - both.vertices - np.repeat([3.0, 0.0], 700)[:, None]).max() < 1e-9


def test_vanished_components_take_the_fallback_positions() -> None:
    speck = BALL.with_vertices(1e-3 * BALL.vertices + 4)
    both = Surface.joined([BALL, speck])
    coarse = Coarsening.of(both.vertices, both.triangles, 100)
    lost = np.setdiff1d(np.arange(1400), coarse.found)
    turns = np.tile(np.eye(3), (len(coarse.vertices), 1, 1))
    lifted = coarse.lift(both.vertices, both.vertices[coarse.vertices], turns, np.full((1400, 3), 9.0))
    assert np.isfinite(lifted).all()
    assert (lifted[lost] == 9).all()
    assert (lost >= 700).all()


@pytest.mark.parametrize("released", [False, True])
def test_patch_agrees_with_the_whole_system_nearby(released: bool) -> None:
    mesh, length = rest_mesh(), 0.03
    top = mesh.rest[:, 2] > 0.8 * mesh.rest[:, 2].max()
    some = np.flatnonzero(mesh.rest[:, 2] > 0)
    pull, before = np.where(top & released, 0.0, 1.0), Elastic(mesh, np.ones(700), length, no_pins())
    goals = mesh.rest + np.random.default_rng(0).normal(0, 0.02, (700, 3))
    loads = mesh.loads(np.tile(np.eye(3), (700, 1, 1)))
    start, whole = before.solve(goals, loads), Elastic(mesh, pull, length, no_pins()).solve(goals, loads)
    found = before.release(pull, some).solve(goals, loads, start)
    moved = np.abs(whole - start).max()
    assert np.abs(found - whole).max() < 1e-3 * moved + 1e-12
    assert (moved > 1e-3) == released
    rest = np.delete(np.arange(700), some)
    assert (found[rest] == start[rest]).all()
