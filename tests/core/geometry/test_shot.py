# SPDX-License-Identifier: GPL-3.0-or-later
"""SHOT descriptors depend on the neighbourhood of a vertex, not on the placement of the shape."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, directions
from scipy.spatial import ConvexHull, cKDTree

from zoomout_core import PointCloud, Surface, shot
from zoomout_core.geometry import shot as module


@pytest.fixture(scope="module")
def made() -> Creature:
    return creature(600, seed=0)


@pytest.fixture(scope="module")
def descriptors(made: Creature) -> np.ndarray:
    return shot(made.surface, 0.25)


def test_descriptors_with_five_neighbours_have_unit_norm(made, descriptors) -> None:
    assert descriptors.shape == (600, 8 * 2 * 2 * 11)
    assert descriptors.min() >= 0
    vertices = made.surface.vertices / np.sqrt(made.surface.area)
    others = cKDTree(vertices).query_ball_point(vertices, 0.25, return_length=True) - 1
    np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), others >= 5)
    assert 0 < (others < 5).sum() < 20


def test_descriptors_are_invariant_to_placement_scale_and_vertex_order(made, descriptors) -> None:
    random = np.random.default_rng(0)
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    order = random.permutation(600)
    vertices = (made.surface.vertices @ rotation * 9 + [5, 6, 7])[order]
    triangles = np.argsort(order)[made.surface.triangles[:, ::-1]]  # with the opposite winding
    found = shot(Surface(vertices, triangles), 0.25)
    np.testing.assert_allclose(found, descriptors[order], atol=1e-10)
    assert (cKDTree(descriptors).query(found)[1] == order).mean() > 0.97


def test_mirror_image_has_different_descriptors(made, descriptors) -> None:
    surface = made.surface
    mirrored = shot(Surface(surface.vertices * [-1, 1, 1], surface.triangles), 0.25)
    assert np.median((mirrored * descriptors).sum(axis=1)) < 0.95


def test_remeshing_hardly_changes_descriptors(made, descriptors) -> None:
    # The mesh is twice as dense on one side; weighting by area compensates.
    where = np.concatenate([directions(800, seed=4), directions(800, seed=5)])
    keep = (where[:, 2] > 0) | (np.arange(1600) < 800)
    ball = where[keep] * [1, 0.7, 0.5]
    even = directions(1000, seed=6) * [1, 0.7, 0.5]
    dense, plain = (shot(Surface(p, ConvexHull(p / [1, 0.7, 0.5]).simplices), 0.3) for p in (ball, even))
    nearest = cKDTree(even).query(ball)[1]
    # Local frames are ambiguous near the ends of the axes, so compare between them.
    between = (np.abs(ball / [1, 0.7, 0.5]) > 0.3).all(axis=1)
    assert np.median((dense * plain[nearest]).sum(axis=1)[between]) > 0.95


def test_descriptors_are_uniform_on_a_sphere_but_not_on_a_creature(descriptors) -> None:
    points = directions(1200, seed=2)
    on_sphere = shot(Surface(points, ConvexHull(points).simplices), 0.3)
    assert (on_sphere @ on_sphere[0]).min() > 0.9
    assert np.median(descriptors @ descriptors[0]) < 0.6


def test_neighbours_are_interpolated_between_adjacent_bins() -> None:
    # Bin centres: azimuth 22.5 degrees, elevation 45 degrees, radius 1/4, cosine 0.
    turn = np.pi / 8
    local = np.array([[np.cos(turn), np.sin(turn), 1.0]])
    one, zero = np.array([1.0]), np.array([0])

    def histogram(local=local, cosine=0.0, distance=0.25) -> np.ndarray:
        found = module._histograms(local, one * cosine, one * distance, one * 2, zero, 1)
        return found.reshape(8, 2, 2, 11)

    assert histogram()[0, 1, 0, 5] == pytest.approx(2)
    np.testing.assert_allclose(histogram(local * [1, 1, 0])[0, :, 0, 5], [1, 1])
    np.testing.assert_allclose(histogram(distance=0.5)[0, 1, :, 5], [1, 1])
    np.testing.assert_allclose(histogram(cosine=0.5 / 11)[0, 1, 0, 4:8], [0, 1.5, 0.5, 0])
    np.testing.assert_allclose(histogram(np.array([[1.0, 0, 1]]))[:, 1, 0, 5], [1, 0, 0, 0, 0, 0, 0, 1], atol=1e-12)
    # Beyond the outermost bin centres nothing is lost.
    assert histogram(cosine=1.0)[0, 1, 0, 10] == pytest.approx(2)
    assert histogram(distance=1.0)[0, 1, 1, 5] == pytest.approx(2)
    assert histogram(local * [1, 1, -9])[0, 0, 0, 5] == pytest.approx(2)


def test_blocks_bound_memory_without_changing_results(made, descriptors, monkeypatch) -> None:
    looked_at = []
    histograms = module._histograms

    def counted(local, *others):
        looked_at.append(len(local))
        return histograms(local, *others)

    monkeypatch.setattr(module, "_histograms", counted)
    monkeypatch.setattr(module, "BLOCK", 500)
    np.testing.assert_allclose(shot(made.surface, 0.25), descriptors, atol=1e-12)
    assert len(looked_at) > 10
    assert max(looked_at) < 1000


def test_unused_vertices_have_no_descriptor_but_cloud_points_do(made, descriptors) -> None:
    surface = made.surface
    more = Surface(np.vstack([[[9.0, 9, 9]], surface.vertices]), surface.triangles + 1)
    found = shot(more, 0.25)
    assert not found[0].any()
    np.testing.assert_allclose(found[1:], descriptors, atol=1e-12)
    cloud = PointCloud(creature(600, seed=0).surface.vertices)
    np.testing.assert_allclose(np.linalg.norm(shot(cloud, 0.6), axis=1), 1)


def test_angles_of_contiguous_arrays_do_not_depend_on_the_place_in_memory(made, monkeypatch) -> None:
    # numpy takes a slower loop, which rounds differently, where it suspects that a strided input overlaps the result.
    contiguous = []
    arctan2 = np.arctan2

    def watched(y, x):
        contiguous.append(y.flags.c_contiguous and x.flags.c_contiguous)
        return arctan2(y, x)

    monkeypatch.setattr(np, "arctan2", watched)
    shot(made.surface, 0.25)
    assert contiguous
    assert all(contiguous)


@pytest.mark.parametrize("radius", [0, -1.0, float("nan"), float("inf")])
def test_a_radius_must_be_positive(made, radius) -> None:
    with pytest.raises(ValueError, match="give a positive number, relative to the root of the area"):
        shot(made.surface, radius)


def test_frames_are_weighted_principal_axes_with_consistent_signs() -> None:
    offset = np.array([[0.0, 2, 0], [0, -2, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0.1]])
    weight, area = np.array([1.0, 1, 9, 9, 1]), np.array([1.0, 1, 1, 1, 1])
    down, zero = np.array([[0.0, 0.1, -1]]), np.zeros(5, dtype=int)
    x, y, z = module._frames(offset, weight, area, zero, down)[0]
    np.testing.assert_allclose(x, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(z, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(y, np.cross(z, x), atol=1e-12)
    x, _, _ = module._frames(offset, area, [1, 2, 1, 1, 1] * area, zero, down)[0]
    np.testing.assert_allclose(x, [0, -1, 0], atol=1e-12)


def test_frame_weights_decrease_linearly_with_distance(made, monkeypatch) -> None:
    seen = []
    frames = module._frames

    def watched(offset, weight, area, *others):
        seen.append((np.linalg.norm(offset, axis=1), weight / area))
        return frames(offset, weight, area, *others)

    monkeypatch.setattr(module, "_frames", watched)
    shot(made.surface, 0.25)
    for distance, weight in seen:
        np.testing.assert_allclose(weight, 0.25 - distance, atol=1e-12)
