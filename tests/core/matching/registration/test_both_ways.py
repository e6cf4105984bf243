# SPDX-License-Identifier: GPL-3.0-or-later
"""The mean of a registration and the inverse of the reverse one is more precise, and keeps what has no mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from creatures import Creature, creature

from zoomout_core.arrays import Floats
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.registration import both_ways
from zoomout_core.matching.registration.both_ways import MAX_DIFFERENCE, average_both_ways
from zoomout_core.matching.registration.correspondences import Surroundings
from zoomout_core.matching.registration.nonrigid_icp import Fit, fit_nonrigid
from zoomout_core.mesh.surface import Surface

STRETCH = 1.0, 1.0, 1.3


@cache
def creatures(mirrored: bool = False) -> tuple[Creature, Creature]:
    """Two creatures of other proportions."""
    source, target = creature(500, seed=0), creature(480, seed=1, bend=0.5)
    sense, order = ([-1, 1, 1], [0, 2, 1]) if mirrored else ([1, 1, 1], [0, 1, 2])
    surface = Surface(target.surface.vertices * STRETCH * sense, target.surface.triangles[:, order])
    return source, replace(target, surface=surface)


@cache
def shapes(mirrored: bool = False) -> tuple[ShapeAnalysis, ShapeAnalysis]:
    source, target = (analyse(each.surface.working.part(0)[0], 60, 500, 0, None) for each in creatures(mirrored))
    return source, target


@cache
def fit(mirrored: bool = False) -> Fit:
    """The registration that starts from the true map."""
    (source, target), (source_shape, target_shape) = creatures(mirrored), shapes(mirrored)
    apart = np.linalg.norm(target.directions[:, None] - source.directions[None], axis=2)
    first = SurfaceMap.from_vertices(apart.argmin(axis=1), source.surface)
    first = SurfaceMap(first.triangle, first.barycentric, source_shape.mesh.triangles)
    return fit_nonrigid(first, source_shape, target_shape, mirrored)


def errors(found: Fit) -> Floats:
    """(n_t,) distances between the directions of the images and the true ones."""
    source, target = creatures()
    directions = found.surface_map.interpolate(source.directions)
    return np.linalg.norm(directions / np.linalg.norm(directions, axis=1, keepdims=True) - target.directions, axis=1)


def images(found: Fit) -> Floats:
    return found.surface_map.interpolate(shapes()[0].mesh.vertices)


def inverse_by(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[SurfaceMap, Floats], tuple[SurfaceMap, Floats]]
) -> None:
    """Change the inverse of the reverse registration, and the distances in it."""
    inverse_fit = both_ways._inverse_fit
    monkeypatch.setattr(both_ways, "_inverse_fit", lambda *given: change(*inverse_fit(*given)))


def test_mean_is_more_precise_than_either_registration(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[SurfaceMap] = []
    inverse_by(monkeypatch, lambda inverse, gap: (found.append(inverse) or inverse, gap))
    averaged = average_both_ways(fit(), *shapes(), False)
    before = errors(fit()).mean()
    assert errors(averaged).mean() < 0.96 * before
    assert errors(averaged).mean() < errors(replace(fit(), surface_map=found[0])).mean()
    np.testing.assert_allclose(averaged.positions[averaged.fits], images(averaged)[averaged.fits], atol=0.03)


def test_mirrored_shapes_have_mirrored_means() -> None:
    there, mirrored = average_both_ways(fit(), *shapes(), False), average_both_ways(fit(True), *shapes(True), True)
    assert np.abs(images(there) - images(fit())).max() > 0.01
    np.testing.assert_allclose(images(mirrored), images(there), atol=2e-3)


def test_similar_images_are_averaged_halfway(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[SurfaceMap] = []
    inverse_by(monkeypatch, lambda inverse, gap: (found.append(inverse) or inverse, np.zeros_like(gap)))
    averaged = average_both_ways(fit(), *shapes(), False)
    ends = images(fit()), images(replace(fit(), surface_map=found[0]))
    apart = np.linalg.norm(ends[1] - ends[0], axis=1)
    close = fit().fits & (apart < MAX_DIFFERENCE / 4) & (apart > MAX_DIFFERENCE / 40)
    assert close.mean() > 0.3
    halfway = np.linalg.norm(averaged.positions - sum(ends) / 2, axis=1)
    assert (halfway[close] < apart[close] / 10).all()


def test_inverse_rejects_vertices_that_face_the_other_way() -> None:
    source, target = shapes()
    nearest = Surroundings.of(target).closest(source.mesh.vertices, -source.mesh.vertex_normals)
    _, gap = both_ways._inverse_fit(nearest, source, target, False, 1.0)
    assert np.isinf(gap).any()


def test_rejected_vertices_keep_their_images() -> None:
    fits = fit().fits & (creatures()[1].directions[:, 2] < 0)
    averaged = average_both_ways(replace(fit(), fits=fits), *shapes(), False)
    np.testing.assert_array_equal(averaged.fits, fits)
    np.testing.assert_array_equal(images(averaged)[~fits], images(fit())[~fits])
    np.testing.assert_array_equal(averaged.positions[~fits], fit().positions[~fits])
    assert (images(averaged)[fits] != images(fit())[fits]).any(axis=1).mean() > 0.9


def test_map_without_a_registration_is_kept() -> None:
    first = Fit.of_map(fit().surface_map)
    assert average_both_ways(first, *shapes(), False) is first


@pytest.mark.parametrize("gap", [2 * MAX_DIFFERENCE, np.inf])
def test_vertices_that_the_inverse_does_not_reach_are_not_averaged(gap: float, monkeypatch: pytest.MonkeyPatch) -> None:
    tail = creatures()[1].directions[:, 1] > 0.5
    inverse_by(monkeypatch, lambda inverse, gaps: (inverse, np.where(tail, gap, gaps)))
    averaged = average_both_ways(fit(), *shapes(), False)
    np.testing.assert_array_equal(images(averaged)[tail], images(fit())[tail])
    assert (images(averaged)[~tail] != images(fit())[~tail]).any(axis=1).mean() > 0.8


def test_images_on_different_parts_are_not_averaged(monkeypatch: pytest.MonkeyPatch) -> None:
    tail = creatures()[1].directions[:, 1] > 0.5
    opposite = int(np.argmin(creatures()[0].directions[:, 1]))
    corner = np.argwhere(shapes()[0].mesh.triangles == opposite)[0]

    def elsewhere(inverse: SurfaceMap, gap: Floats) -> tuple[SurfaceMap, Floats]:
        triangle, barycentric = inverse.triangle.copy(), inverse.barycentric.copy()
        triangle[tail], barycentric[tail] = corner[0], np.eye(3)[corner[1]]
        return SurfaceMap(triangle, barycentric, inverse.source_triangles), gap

    inverse_by(monkeypatch, elsewhere)
    averaged = average_both_ways(fit(), *shapes(), False)
    np.testing.assert_array_equal(images(averaged)[tail], images(fit())[tail])


def test_registrations_with_opposite_normals_are_averaged_alike() -> None:
    # As of open surfaces, whose outer sides are unknown: the source's normals point to the other side.
    source, target = shapes()
    mesh = replace(source.mesh, triangles=source.mesh.triangles[:, ::-1])
    flipped = replace(source, proxy=replace(source.proxy, mesh=mesh))
    turned = fit().surface_map
    turned = SurfaceMap(turned.triangle, turned.barycentric[:, ::-1], mesh.triangles)
    averaged = average_both_ways(replace(fit(), surface_map=turned), flipped, target, False)
    assert (mesh.vertex_normals * source.mesh.vertex_normals).sum(axis=1).max() < 0
    np.testing.assert_allclose(images(averaged), images(average_both_ways(fit(), source, target, False)), atol=2e-3)
