# SPDX-License-Identifier: GPL-3.0-or-later
"""Unmoved parts are registered exactly, on proxies and full meshes; moved parts are left unchanged."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex
from scipy.spatial.transform import Rotation

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.proxy import Proxy
from zoomout_core.matching.registration.correspondences import GeodesicLimit, Surroundings
from zoomout_core.matching.registration.rigid_icp import rigid_vertices, settle
from zoomout_core.samples.spheres import ball

TURN = Rotation.from_rotvec([0.2, 1.0, -0.4]).as_matrix()


def shape_of(made: Creature) -> ShapeAnalysis:
    return analyse(made.surface.working.part(0)[0], 120, 400, 0)


@pytest.fixture(scope="module")
def made() -> Creature:
    return creature(900, seed=0)


@pytest.fixture(scope="module")
def shape(made: Creature) -> ShapeAnalysis:
    return shape_of(made)


def find_unmoved(
    source: ShapeAnalysis, target: ShapeAnalysis, vertex: np.ndarray, turn: np.ndarray = TURN
) -> tuple[np.ndarray, np.ndarray]:
    """Which vertices of a rotated target moved only rigidly, and their positions."""
    corner_at = np.zeros(len(source.mesh.vertices), dtype=int)
    corner_at[source.mesh.triangles.ravel()] = np.arange(source.mesh.triangles.size)
    corner = corner_at[vertex]
    first = SurfaceMap(corner // 3, np.eye(3)[corner % 3], source.mesh.triangles)
    rest, normals = target.mesh.vertices @ turn.T, target.mesh.vertex_normals @ turn.T
    return rigid_vertices(first, rest, normals, Surroundings.of(source), GeodesicLimit(first.vertex, source), target)


def test_rotated_copy_counts_as_unmoved(shape: ShapeAnalysis) -> None:
    everywhere, placed = find_unmoved(shape, shape, np.arange(len(shape.mesh.vertices)))
    assert everywhere.all()
    np.testing.assert_allclose(placed, shape.mesh.vertices, atol=1e-3)


def test_rough_map_suffices_to_find_unmoved_vertices(shape: ShapeAnalysis) -> None:
    vertices = shape.mesh.vertices
    noise = np.random.default_rng(0).normal(scale=0.03, size=vertices.shape)
    rough = np.linalg.norm((vertices + noise)[:, None] - vertices, axis=2).argmin(axis=1)
    everywhere, placed = find_unmoved(shape, shape, rough)
    assert everywhere.mean() > 0.95
    assert np.median(np.linalg.norm(placed - vertices, axis=1)) < 2e-3


def test_a_limb_that_bends_has_moved_and_the_body_has_not(made: Creature, shape: ShapeAnalysis) -> None:
    source = shape_of(creature(1000, seed=1, bend=0.9))
    where, _ = find_unmoved(source, shape, true_vertex(creature(1000, seed=1, bend=0.9), made), np.eye(3))
    arms = np.abs(made.surface.working.vertices[:, 0]) > 0.8 * np.abs(made.surface.working.vertices[:, 0]).max()
    body = np.abs(made.directions[:, 2]) < 0.3
    body &= (np.abs(made.directions[:, 0]) < 0.8) & (np.abs(made.directions[:, 1]) < 0.8)
    assert not where[arms].any()
    assert where[body].mean() > 0.5


def test_vertices_mapped_elsewhere_do_not_count_as_unmoved(made: Creature, shape: ShapeAnalysis) -> None:
    tail = made.directions[:, 1] > 0.85
    vertex = np.arange(len(tail))
    vertex[tail] = np.flatnonzero(made.directions[:, 1] < -0.95)[0]
    where, _ = find_unmoved(shape, shape, vertex, np.eye(3))
    assert not where[made.directions[:, 1] > 0.9].any()
    assert where[made.directions[:, 1] < 0.7].mean() > 0.9


@pytest.mark.parametrize("centre", [60, 120, 240])
def test_few_outliers_follow_their_unmoved_surroundings(shape: ShapeAnalysis, centre: int) -> None:
    distance = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices[centre], axis=1)
    vertex = np.arange(len(distance))
    vertex[np.argsort(distance)[:6]] = np.argmax(distance)
    assert find_unmoved(shape, shape, vertex, np.eye(3))[0].all()


# --- full meshes ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def full() -> Proxy:
    part = creature(1500).surface.working
    return Proxy(part, part, part.vertices, np.arange(len(part.vertices)))


def settle_goals(full: Proxy, goal: np.ndarray, fits: np.ndarray | None = None, in_space: np.ndarray | None = None):
    """Settle goals of a smaller, rotated copy; return them and their tolerated distance from the source."""
    vertices = full.full.vertices
    fits = np.ones(len(vertices), dtype=bool) if fits is None else fits
    return settle(goal, fits, 0.5 * vertices @ TURN.T + 1, goal + 1 if in_space is None else in_space, full)


def rough(full: Proxy) -> np.ndarray:
    """Goals as from a proxy, with errors of a few thousandths."""
    return full.full.vertices + np.random.default_rng(0).normal(scale=1.5e-3, size=full.full.vertices.shape)


def test_goals_of_a_similarity_become_exact(full: Proxy) -> None:
    found, nearness = settle_goals(full, rough(full))
    assert np.abs(found - full.full.vertices).max() < 1e-4
    assert nearness > 1e-3


def test_goals_without_a_similarity_stay(full: Proxy) -> None:
    shrunk = rough(full) * [1.0, 1.0, 0.7]
    np.testing.assert_array_equal(settle_goals(full, shrunk)[0], shrunk)


def test_motion_that_misses_the_source_is_rejected(full: Proxy) -> None:
    # Vertices are alternately above and below the source, so no rigid motion fits.
    side = np.where(np.arange(len(full.full.vertices)) % 2, 1, -1)[:, None]
    apart = full.full.vertices + 2e-3 * side * full.full.vertex_normals
    found, _ = settle(apart, np.ones(len(apart), dtype=bool), apart, apart + 1, full)
    np.testing.assert_array_equal(found, apart)


def test_few_reliable_goals_do_not_determine_a_motion(full: Proxy) -> None:
    goal = rough(full)
    fits = np.arange(len(goal)) < 300
    np.testing.assert_array_equal(settle_goals(full, goal, fits)[0], goal)


def test_meshes_already_in_place_stay_there_exactly(full: Proxy) -> None:
    in_space = full.full.vertices.copy()
    np.testing.assert_array_equal(settle_goals(full, rough(full), in_space=in_space)[0], in_space)
    beside = in_space + 2e-3
    found, _ = settle_goals(full, rough(full), in_space=beside)
    assert np.abs(found - in_space).max() < 1e-4


def test_a_limb_that_has_moved_keeps_its_goals(full: Proxy) -> None:
    goal, limb = rough(full), creature(1500).directions[:, 2] < -0.5
    assert 0.15 < limb.mean() < 0.4
    goal[limb] += [0, 0.1, 0]
    found, _ = settle_goals(full, goal)
    np.testing.assert_array_equal(found[limb], goal[limb])
    assert np.abs(found - full.full.vertices)[~limb].max() < 1e-4


def test_scattered_wrong_goals_do_not_disturb_the_others(full: Proxy) -> None:
    goal, random = rough(full), np.random.default_rng(2)
    wrong = random.random(len(goal)) < 0.3
    goal[wrong] += random.normal(scale=0.1, size=(wrong.sum(), 3))
    found, _ = settle_goals(full, goal)
    assert np.abs(found - full.full.vertices)[~wrong].max() < 1e-4


def test_few_deviating_goals_are_corrected(full: Proxy) -> None:
    goal, few = rough(full), np.zeros(len(full.full.vertices), dtype=bool)
    few[::25] = True
    goal[few] += [0, 0.1, 0]
    found, _ = settle_goals(full, goal)
    assert np.abs(found - full.full.vertices).max() < 1e-4


def test_few_vertices_that_the_motion_misplaces_keep_their_goals(full: Proxy) -> None:
    points, few = full.full.vertices.copy(), np.zeros(len(full.full.vertices), dtype=bool)
    few[::25] = True
    points[few] += 0.04 * full.full.vertex_normals[few]
    goal = rough(full)
    goal[few] = points[few] + [0, 0.1, 0]
    found, _ = settle(goal, np.ones(len(goal), dtype=bool), points, goal + 1, full)
    np.testing.assert_array_equal(found[few], goal[few])
    assert np.abs(found - points)[~few].max() < 1e-4


@pytest.fixture(scope="module")
def plum() -> Proxy:
    part = ball(0.3, radii=(1, 0.8, 0.6), count=2000).working
    return Proxy(part, part, part.vertices, np.arange(len(part.vertices)))


@pytest.mark.parametrize(("size", "stays"), [(0.999, True), (0.9992, True), (0.9997, False), (1.001, False)])
def test_remeshed_copy_stays_in_place_if_it_fits_as_well(plum: Proxy, size: float, stays: bool) -> None:
    # Vertices of a convex surface are above another mesh's triangles; at 0.999 of the size they are on them.
    other = ball(0.3, radii=(1, 0.8, 0.6), count=1900, seed=1).working
    in_space = size * plum.full.from_surface(other.to_surface(other.vertices))
    random = np.random.default_rng(0)
    goal = in_space / size + random.normal(scale=1e-3, size=in_space.shape)
    found, _ = settle(goal, np.ones(len(goal), dtype=bool), other.vertices, in_space, plum)
    assert np.array_equal(found, in_space) == stays
    assert np.median(np.linalg.norm(found - 0.999 * in_space / size, axis=1)) < 3e-4


@pytest.mark.slow
def test_goals_change_continuously_as_a_surface_moves_away(plum: Proxy) -> None:
    other = ball(0.3, radii=(1, 0.8, 0.6), count=1900, seed=1).working
    at = plum.full.from_surface(other.to_surface(other.vertices))
    goal = at + np.random.default_rng(0).normal(scale=1e-3, size=at.shape)
    fits = np.ones(len(goal), dtype=bool)
    sizes = np.linspace(0.999, 1.0, 81)
    found = [settle(goal, fits, other.vertices, size * at, plum)[0] for size in sizes]
    steps = [np.linalg.norm(after - before, axis=1).max() for before, after in pairwise(found)]
    stood = [np.array_equal(one, size * at) for one, size in zip(found, sizes, strict=True)]
    assert stood[0]
    assert not stood[-1]
    assert max(steps) < 5e-5
