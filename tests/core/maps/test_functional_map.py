# SPDX-License-Identifier: GPL-3.0-or-later
"""Pointwise maps convert to functional maps and back, to vertices or to points of triangles."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex

import zoomout_core as zo


@pytest.fixture(scope="module")
def bases(resting: Creature, bent: Creature) -> tuple[zo.SpectralBasis, zo.SpectralBasis]:
    return zo.eigenbasis(resting.surface, 60), zo.eigenbasis(bent.surface, 60)


@pytest.fixture(scope="module")
def truth(resting: Creature, bent: Creature) -> np.ndarray:
    return true_vertex(resting, bent)


def test_surface_map_to_vertices_converts_like_a_vertex_map(resting, bases, truth) -> None:
    surface_map = zo.SurfaceMap.from_vertices(truth, resting.surface)
    np.testing.assert_allclose(
        zo.functional_map_of(surface_map, *bases, 30, 20), zo.functional_map_of(truth, *bases, 30, 20), atol=1e-12
    )


def test_functional_map_uses_all_eigenfunctions_by_default(bases, truth) -> None:
    C = zo.functional_map_of(truth, *bases)
    assert C.shape == (60, 60)
    np.testing.assert_allclose(zo.functional_map_of(truth, *bases, k_source=7), C[:, :7])
    np.testing.assert_allclose(zo.functional_map_of(truth, *bases, k_target=7), C[:7])


def test_functional_map_transfers_functions_in_the_span_of_the_bases(bases, truth) -> None:
    source, target = bases
    smooth = source.eigenvectors[:, :6]
    carried = target.eigenvectors @ zo.functional_map_of(truth, *bases, 6)
    assert np.linalg.norm(carried - smooth[truth]) < 0.1 * np.linalg.norm(smooth[truth])


def test_the_precise_map_of_the_identity_is_the_identity(resting, bases) -> None:
    identity = zo.precise_map_of(np.eye(60), bases[0], bases[0], resting.surface)
    np.testing.assert_allclose(identity.interpolate(resting.surface.vertices), resting.surface.vertices, atol=1e-3)


def test_precise_map_is_more_accurate_than_vertex_map(resting: Creature, bases) -> None:
    """On another mesh of the same pose, the true image of a point is the point itself."""
    finer = creature(6000, seed=4)
    basis = zo.eigenbasis(finer.surface, 60)
    C = zo.zoomout(bases[0], basis, true_vertex(resting, finer), k_final=60).functional_map
    places = resting.surface.vertices
    to_vertices = places[zo.vertex_map_of(C, bases[0], basis)]
    to_points = zo.precise_map_of(C, bases[0], basis, resting.surface).interpolate(places)
    off = [np.linalg.norm(images - finer.surface.vertices, axis=1).mean() for images in (to_vertices, to_points)]
    assert off[1] < 0.6 * off[0]


def test_precise_map_crosses_coincident_borders(resting: Creature, bases, truth) -> None:
    """Splitting the source along all edges and adding an unused vertex does not change the image points."""
    C = zo.functional_map_of(truth, *bases, 40, 40)
    corners = resting.surface.triangles.ravel()
    soup = zo.Surface(
        np.vstack([resting.surface.vertices[corners], [[9.0, 9, 9]]]), np.arange(len(corners)).reshape(-1, 3)
    )
    number = np.append(corners, 0)
    split = zo.SpectralBasis(bases[0].eigenvalues, bases[0].eigenvectors[number], bases[0].areas[number], soup.vertices)
    whole = zo.precise_map_of(C, *bases, resting.surface)
    pieces = zo.precise_map_of(C, split, bases[1], soup)
    np.testing.assert_allclose(
        pieces.interpolate(soup.vertices), whole.interpolate(resting.surface.vertices), atol=1e-6
    )


def test_point_cloud_has_a_precise_map(resting: Creature, bases, truth) -> None:
    cloud = zo.PointCloud(resting.surface.vertices)
    basis = zo.eigenbasis(cloud, 40)
    C = zo.functional_map_of(truth, basis, bases[1], 40, 40)
    images = zo.precise_map_of(C, basis, bases[1], cloud).interpolate(cloud.points)
    off = np.linalg.norm(images - cloud.points[truth], axis=1).mean()
    assert off < 0.05 * np.sqrt(resting.surface.area)


@pytest.mark.parametrize(
    ("functional_map", "sentence"),
    [
        (np.eye(61), "61 target and 61 source functions is larger than the bases of 60 and 60"),
        (np.ones((60, 61)), "larger than the bases"),
        (np.ones((61, 60)), "larger than the bases"),
        (np.ones(60), "must be a matrix"),
        (np.ones((0, 3)), "must be a matrix"),
        (np.full((4, 4), np.nan), "finite numbers"),
        (np.full((4, 4), "a"), "finite numbers"),
    ],
)
def test_invalid_functional_maps_are_refused(resting, bases, functional_map, sentence) -> None:
    for convert in (zo.vertex_map_of, lambda *given: zo.precise_map_of(*given, resting.surface)):
        with pytest.raises(ValueError, match=sentence) as refusal:
            convert(functional_map, *bases)
        assert "\n" not in str(refusal.value)


def test_pointwise_maps_of_other_shapes_are_refused(resting: Creature, bent: Creature, bases, truth) -> None:
    onto_resting = zo.SurfaceMap.from_vertices(truth, resting.surface)
    for pointwise, sizes, sentence in (
        (truth[:-1], (), "for each of 2500 target vertices, not for 2499"),
        (truth + 4000, (), "must be vertex numbers from 0 to 3999"),
        (truth[None], (), "must be a list of vertex numbers"),
        (onto_resting, (), "The map has 2500 vertices, which does not fit 2500 source and 4000 target"),
        (truth, (61,), "larger than the bases"),
        (truth, (0,), "a whole number of 1 or more"),
        (truth, (10, 2.5), "a whole number of 1 or more"),
    ):
        order = bases[::-1] if pointwise is onto_resting else bases
        with pytest.raises(ValueError, match=sentence):
            zo.functional_map_of(pointwise, *order, *sizes)
    from_resting = zo.SurfaceMap.from_vertices(np.zeros(2500, dtype=int), resting.surface)
    with pytest.raises(ValueError, match="does not fit"):
        zo.functional_map_of(from_resting, bases[1], bases[1])
    with pytest.raises(ValueError, match="The source has 2500 vertices, but its basis was computed for 4000"):
        zo.precise_map_of(np.eye(4), *bases, bent.surface)
