# SPDX-License-Identifier: GPL-3.0-or-later
"""Tears of a finished map are found and filled in from their surroundings; remaining ones are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import LIMBS, Creature, creature, mirrored_vertex, on_limb, true_vertex
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import analyse
from zoomout_core.matching.refinement import fill_patches
from zoomout_core.matching.refinement.fill_patches import FILLING, choose_images
from zoomout_core.matching.refinement.image_features import Images
from zoomout_core.matching.refinement.repair import REPAIR, Repair, repair
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.tuning import retune

# Accepted mean error of filled places at unit area: a few edges.
NEAR = 0.08


@pytest.fixture(scope="module")
def pair(resting: Creature, bent: Creature) -> Pair:
    shapes = [analyse(made.surface.working, 40, 200, 0) for made in (resting, bent)]
    return Pair(resting.surface, bent.surface, *shapes, 40, 5)


@pytest.fixture(scope="module")
def truth(resting: Creature, bent: Creature) -> zo.SurfaceMap:
    return zo.SurfaceMap.from_vertices(true_vertex(resting, bent), resting.surface)


def patch_around(pair: Pair, vertex: int, radius: float) -> np.ndarray:
    """Target vertices within a radius of a vertex, at unit area."""
    mesh = pair.target.working
    return np.flatnonzero(np.linalg.norm(mesh.vertices - mesh.vertices[vertex], axis=1) < radius)


def send(surface_map: zo.SurfaceMap, vertices: np.ndarray, images: np.ndarray, pair: Pair) -> zo.SurfaceMap:
    """Replace the images of some vertices by other source vertices."""
    vertex = surface_map.vertex.copy()
    vertex[vertices] = images
    return zo.SurfaceMap.from_vertices(vertex, pair.source)


def misses(pair: Pair, found: zo.SurfaceMap, truth: zo.SurfaceMap, vertices: np.ndarray) -> np.ndarray:
    """Distances between images and true images, at unit area."""
    off = found.interpolate(pair.source.vertices) - truth.interpolate(pair.source.vertices)
    return np.linalg.norm(off[vertices], axis=1) / np.sqrt(pair.source.area)


def test_patch_mapped_to_the_other_side_is_repaired(pair, truth, resting, bent) -> None:
    # Limbs have too few vertices here, so the patch is on the side of the body.
    on_body = ~np.any([on_limb(bent, limb) for limb in range(len(LIMBS))], axis=0)
    patch = patch_around(pair, int(np.argmax(pair.target.vertices[:, 0] * on_body)), 0.06)
    torn = send(truth, patch, mirrored_vertex(resting, bent)[patch], pair)
    assert misses(pair, torn, truth, patch).min() > 3 * NEAR
    found = repair(pair, torn)
    assert misses(pair, found.surface_map, truth, patch).mean() < NEAR
    assert found.filled[patch].all()


def test_vertices_without_a_partner_tear_no_others(pair, truth) -> None:
    """Images of vertices that only one fragment has are on cuts, and no evidence against the others."""
    alone = pair.target.vertices[:, 2] > np.quantile(pair.target.vertices[:, 2], 0.3)
    cut = int(np.argmin(pair.source.vertices[:, 2]))
    partial = send(truth, np.flatnonzero(alone), np.full(np.count_nonzero(alone), cut), pair)
    found, unaware = repair(pair, partial, ~alone), repair(pair, partial)
    assert found.connected[~alone].min() > 0.9
    assert not found.torn.any()
    assert np.median(unaware.connected[~alone]) < 0.5
    np.testing.assert_array_equal(found.surface_map.vertex[~alone], truth.vertex[~alone])


def test_map_without_tears_is_unchanged(pair, truth) -> None:
    found = repair(pair, truth)
    untouched = ~found.filled
    assert untouched.mean() > 0.97
    np.testing.assert_array_equal(found.surface_map.triangle[untouched], truth.triangle[untouched])
    np.testing.assert_array_equal(found.surface_map.barycentric[untouched], truth.barycentric[untouched])


def test_single_outliers_are_filled_in(pair, truth) -> None:
    flung = np.arange(0, len(pair.target.vertices), 97)
    far = np.full(len(flung), int(np.argmax(pair.source.vertices[:, 2])))
    found = repair(pair, send(truth, flung, far, pair))
    assert misses(pair, found.surface_map, truth, flung).mean() < NEAR


def test_filling_does_not_spread_along_long_edges() -> None:
    made = creature(300, seed=0).surface
    shape = analyse(made.working, 40, 200, 0)
    pair, identity = Pair(made, made, shape, shape, 40, 5), zo.SurfaceMap.from_vertices(np.arange(300), made)
    torn = send(identity, np.array([0]), shape.sampled.samples[[np.argmax(shape.distances[:, 0])]], pair)
    filled = [int(repair(pair, torn).filled.sum())]
    with retune(REPAIR, around=1.0):
        filled.append(int(repair(pair, torn).filled.sum()))
    assert 0 < filled[0] < filled[1]


@pytest.mark.parametrize("first", [2, FILLING.candidates])
def test_the_samples_compared_first_do_not_change_the_images(pair, truth, resting, bent, monkeypatch, first) -> None:
    patch = patch_around(pair, 0, 0.2)
    torn = send(truth, patch, mirrored_vertex(resting, bent)[patch], pair)
    expected = repair(pair, torn)
    assert expected.filled.any()
    monkeypatch.setattr(fill_patches, "FIRST_CANDIDATES", first)
    found = repair(pair, torn)
    np.testing.assert_array_equal(found.surface_map.triangle, expected.surface_map.triangle)
    np.testing.assert_array_equal(found.surface_map.barycentric, expected.surface_map.barycentric)


def test_large_patch_is_left_unrepaired_and_reported_as_torn(pair, truth, resting, bent) -> None:
    # A repair cannot decide which of two halves is right.
    height = pair.target.vertices[:, 2]
    half = np.flatnonzero(height > np.median(height))
    torn = send(truth, half, mirrored_vertex(resting, bent)[half], pair)
    found = repair(pair, torn)
    inner = np.abs(height - np.median(height)) > 0.4
    assert inner.mean() > 0.5
    assert found.filled[inner].mean() < 0.05
    assert found.torn[~inner].mean() > 0.1
    assert not found.torn[inner].any()


def test_exact_landmarks_keep_their_images(pair, truth) -> None:
    vertex, image = 100, int(np.argmax(pair.source.vertices[:, 2]))
    torn = send(truth, np.array([vertex]), np.array([image]), pair)
    pinned = replace(pair, exact_landmarks=(np.array([image]), np.array([vertex])))
    assert repair(pair, torn).surface_map.vertex[vertex] != image
    assert repair(pinned, torn).surface_map.vertex[vertex] == image


def facing_plates() -> tuple[Pair, zo.SurfaceMap, np.ndarray]:
    """A source strip folded so that its ends nearly touch, and the unfolded strip as the target."""
    n = 60
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 0.3, 18), indexing="ij")
    angle = np.clip((u - 0.45) / 0.1, 0, 1) * np.pi
    gap = 0.01
    along = np.where(u < 0.45, u, np.where(u > 0.55, 1 - u, 0.45 + 0.03 * np.sin(angle)))
    height = np.where(u < 0.45, 0.0, np.where(u > 0.55, gap, gap * (1 - np.cos(angle)) / 2))
    number = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (x.ravel() for x in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    folded = zo.Surface(np.stack([along, v, height], axis=2).reshape(-1, 3), faces)
    flat = zo.Surface(np.stack([u, v, 0 * u], axis=2).reshape(-1, 3), faces)
    shapes = [analyse(surface.working, 40, 200, 0) for surface in (folded, flat)]
    return Pair(folded, flat, *shapes, 40, 5), zo.SurfaceMap.from_vertices(np.arange(u.size), folded), u.ravel()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("steps", [20, 2])
def test_part_cut_off_by_tears_has_a_small_connected_share(steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    pair, truth, u = facing_plates()
    n = len(np.unique(u))
    moved = np.flatnonzero((u > 0.29) & (u < 0.41))
    torn = send(truth, moved, moved + steps * (len(u) // n), pair)
    found = repair(pair, torn)
    share = pair.target.share_of_area(np.isin(np.arange(len(u)), moved))
    away = np.abs(u - 0.35)
    cut_off = steps > REPAIR.seam
    assert np.median(found.connected[away < 0.03]) == pytest.approx(share if cut_off else 1, abs=0.05)
    assert np.median(found.connected[u > 0.5]) == pytest.approx(1 - share if cut_off else 1, abs=0.35)
    assert repair(pair, truth).connected.min() == 1
    # Halves of a strand of hair do not matter.
    monkeypatch.setattr("zoomout_core.matching.refinement.repair.SMALL_COMPONENT", 1.1)
    assert repair(pair, torn).connected.min() == 1


def test_a_patch_at_a_tip_does_not_shrink_to_its_border() -> None:
    pair, truth, u = facing_plates()
    flipped = replace(pair, source=pair.target, source_shape=pair.target_shape, target=pair.source)
    pair = replace(flipped, target_shape=pair.source_shape)
    corner = np.flatnonzero((u > 0.9) & (pair.source.vertices[:, 1] < 0.06))
    away = np.full(len(corner), int(np.argmax(pair.source.vertices[:, 1] - u)))
    found = repair(pair, send(zo.SurfaceMap.from_vertices(truth.vertex, pair.source), corner, away, pair))
    off = pair.source.vertices[found.surface_map.vertex[corner]] - pair.source.vertices[corner]
    assert np.linalg.norm(off, axis=1).mean() < 0.25 * np.ptp(u[corner])


def test_each_patch_takes_its_least_distorted_images(pair) -> None:
    places = pair.target.working.vertices
    edges, _ = unique_edges(pair.target.working.triangles)
    own = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)
    patches = [patch_around(pair, int(np.argmax(sign * places[:, 0])), 0.15) for sign in (1, -1)]
    shrunk, stretched = places.copy(), places.copy()
    for patch, other in zip(patches, patches[::-1], strict=True):
        shrunk[patch] = places[patch].mean(axis=0)
        stretched[other] *= 10
        filled = np.isin(np.arange(len(places)), [*patch, *other])
        tried = [Images(filled, filled, np.pad(each, ((0, 0), (0, 4)))) for each in (shrunk, stretched)]
        best = choose_images(tried, filled, edges, own, REPAIR.max_stretch)
        assert (best[patch] == 1).all()
        assert (best[other] == 0).all()
        shrunk, stretched = places.copy(), places.copy()


def test_a_jump_between_fine_edges_is_filled_in_round_by_round() -> None:
    pair, truth, u = facing_plates()
    rows, across = len(np.unique(u)), len(u) // len(np.unique(u))
    row, place = np.divmod(truth.vertex, across)
    slipped = np.where(u > 0.6, np.minimum(row + 16, rows - 1), row)  # by far more edges than one round fills in
    images = slipped * across + place
    found = repair(pair, zo.SurfaceMap.from_vertices(images, pair.source))
    assert not found.torn.any()


def test_patch_on_the_facing_surface_is_detected_geodesically() -> None:
    pair, truth, u = facing_plates()
    places = pair.source.vertices
    patch = np.flatnonzero((np.abs(u - 0.2) < 0.03) & (np.abs(places[:, 1] - 0.15) < 0.03))
    other_end = np.flatnonzero(u > 0.6)
    across = other_end[cKDTree(places[other_end]).query(places[patch])[1]]
    torn = send(truth, patch, across, pair)
    apart = np.linalg.norm(places[across] - places[patch], axis=1) / np.sqrt(pair.source.area)
    assert apart.max() < REPAIR.min_length * 3  # no edge is long in Euclidean distance
    found: Repair = repair(pair, torn)
    assert (u[found.surface_map.vertex[patch]] < 0.5).all()


def test_loose_part_across_two_limbs_is_not_torn() -> None:
    folded = facing_plates()[0].source
    y, z = np.meshgrid(np.linspace(0.1, 0.2, 6), np.linspace(-0.04, 0.05, 10), indexing="ij")
    number = np.arange(y.size).reshape(y.shape)
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    lid = zo.Surface(
        np.stack([np.full(y.shape, -0.02), y, z], axis=2).reshape(-1, 3), np.stack(corners, 2).reshape(-1, 4)
    )
    source, target = (zo.Surface.joined([folded, lid]) for _ in range(2))
    shapes = [analyse(each.working.part(0)[0], 40, 200, 0) for each in (source, target)]
    identity = zo.SurfaceMap.from_vertices(np.arange(len(source.vertices)), source)
    found = repair(Pair(source, target, *shapes, 40, 5), identity)  # type: ignore[arg-type]
    assert not found.torn.any()
    assert not found.filled.any()
