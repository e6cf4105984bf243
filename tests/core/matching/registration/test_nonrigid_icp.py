# SPDX-License-Identifier: GPL-3.0-or-later
"""Bend a target onto its source: exact if both are one body, harmless otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex
from reports import reports_of
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.proxy import Proxy
from zoomout_core.matching.registration import nonrigid_icp
from zoomout_core.matching.registration.correspondences import Surroundings
from zoomout_core.matching.registration.nonrigid_icp import Fit, _astray, fit_nonrigid, lift_fit
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

pytestmark = pytest.mark.usefixtures("few_candidates")


def shape_of(made: Creature, proxy_vertices: int | None = None) -> ShapeAnalysis:
    return analyse(made.surface.working.part(0)[0], 120, 1000, 0, proxy_vertices)


def blurred_truth(
    source: Creature, target: Creature, functions: int = 30
) -> tuple[ShapeAnalysis, ShapeAnalysis, SurfaceMap]:
    """The shapes, and the true map smoothed by a few eigenfunctions."""
    shapes = shape_of(source), shape_of(target)
    images = source.surface.working.vertices[true_vertex(source, target)]
    basis = shapes[1].basis
    smooth = basis.eigenvectors[:, :functions] @ basis.coefficients(images)[:functions]
    distance = np.linalg.norm(smooth[:, None] - shapes[0].mesh.vertices[None], axis=2)
    first = SurfaceMap.from_vertices(distance.argmin(axis=1), source.surface)
    return *shapes, SurfaceMap(first.triangle, first.barycentric, shapes[0].mesh.triangles)


def errors(surface_map: SurfaceMap, source: Creature, target: Creature) -> Floats:
    """(n_t,) distance between directions of the images and the true directions."""
    images = surface_map.interpolate(source.directions)
    return np.linalg.norm(images / np.linalg.norm(images, axis=1, keepdims=True) - target.directions, axis=1)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("bend", [0.0, 0.9])
def test_fit_is_several_times_as_accurate_as_the_initial_map(bend: float) -> None:
    source, target = creature(1500, seed=0), creature(1300, seed=1, bend=bend)
    shapes = blurred_truth(source, target)
    before, after = shapes[2], fit_nonrigid(shapes[2], shapes[0], shapes[1], False).surface_map
    assert np.median(errors(after, source, target)) < np.median(errors(before, source, target)) / (
        4 if bend == 0 else 2
    )


@pytest.mark.slow
def test_a_mirrored_map_stays_mirrored() -> None:
    source, target = creature(1500, seed=0), creature(1300, seed=1)
    source_shape, target_shape, _ = blurred_truth(source, target)
    flipped = Creature(target.surface, target.directions * [-1, 1, 1])
    _, _, mirrored = blurred_truth(source, flipped)
    fit = fit_nonrigid(mirrored, source_shape, target_shape, True)
    assert np.median(errors(fit.surface_map, source, flipped)) < np.median(errors(mirrored, source, flipped)) / 2
    assert np.linalg.det(fit.rotations[fit.fits]).max() < 0


SMALL = creature(500, seed=0), creature(480, seed=1, bend=0.5)


@pytest.fixture(scope="module")
def small() -> tuple[ShapeAnalysis, ShapeAnalysis, SurfaceMap]:
    return blurred_truth(*SMALL)


def onto(shape: ShapeAnalysis, vertex: np.ndarray) -> SurfaceMap:
    found = SurfaceMap.from_vertices(vertex, SMALL[0].surface)
    return SurfaceMap(found.triangle, found.barycentric, shape.mesh.triangles)


def test_fit_is_astray_where_eigenfunctions_prefer_the_initial_map(small) -> None:
    source, target, first = small
    truth = true_vertex(*SMALL)
    tail = SMALL[1].directions[:, 1] > 0.8
    wrong = truth.copy()
    wrong[tail] = truth[np.argmax(SMALL[1].directions[:, 2])]
    right, lost = onto(source, truth), onto(source, wrong)
    astray = _astray(lost, right, source, target)
    assert astray[tail].all()
    assert astray[~tail].mean() < 0.2
    for found, before in ((right, lost), (lost, lost), (first, first), (right, first)):
        assert not _astray(found, before, source, target).any()
    assert _astray(lost, first, source, target)[tail].mean() > 0.9


def test_fit_slightly_off_an_exact_map_is_not_astray(small) -> None:
    shape = small[0]
    n = len(shape.mesh.vertices)
    exact = onto(shape, np.arange(n))
    corner = np.argmax(exact.barycentric, axis=1)
    beside = SurfaceMap(
        exact.triangle, 0.9 * np.eye(3)[corner] + 0.1 * np.eye(3)[(corner + 1) % 3], shape.mesh.triangles
    )
    assert _astray(beside, exact, shape, shape).mean() < 0.05


def test_coarse_bent_creature_is_fitted_five_times_as_accurately(small) -> None:
    fit = fit_nonrigid(small[2], small[0], small[1], False)
    off = errors(fit.surface_map, *SMALL)
    assert np.median(off) < np.median(errors(small[2], *SMALL)) / 5
    assert np.quantile(off, 0.9) < 0.035
    assert fit.fits.mean() > 0.97


@pytest.mark.parametrize("stretch", [(1.3, 1, 1), (1, 1, 1.3)])
def test_body_of_other_proportions_is_fitted_better_as_the_rest_shape_adapts(stretch, monkeypatch) -> None:
    source, target = SMALL
    target = replace(target, surface=target.surface.with_vertices(target.surface.vertices * stretch))
    *shapes, first = blurred_truth(source, target)
    adapting = fit_nonrigid(first, *shapes, False).surface_map
    rigid = tuple(level._replace(stretches=False) for level in nonrigid_icp.NONRIGID_SCHEDULE)
    monkeypatch.setattr(nonrigid_icp, "NONRIGID_SCHEDULE", rigid)
    before = errors(fit_nonrigid(first, *shapes, False).surface_map, source, target).mean()
    assert errors(adapting, source, target).mean() < 0.9 * before


def test_initial_map_is_kept_where_the_fit_is_astray(small, monkeypatch) -> None:
    source, target, first = small
    tail = SMALL[1].directions[:, 1] > 0.8
    whole = fit_nonrigid(first, source, target, False)
    assert whole.fits[tail].mean() > 0.5
    monkeypatch.setattr("zoomout_core.matching.registration.nonrigid_icp._astray", lambda *_: tail)
    fit = fit_nonrigid(first, source, target, False)
    assert not fit.fits[tail].any()
    np.testing.assert_array_equal(fit.fits[~tail], whole.fits[~tail])
    for where, expected in ((~fit.fits, first), (fit.fits, whole.surface_map)):
        np.testing.assert_array_equal(fit.surface_map.triangle[where], expected.triangle[where])
        np.testing.assert_array_equal(fit.surface_map.barycentric[where], expected.barycentric[where])
    assert (fit.surface_map.triangle[tail] != whole.surface_map.triangle[tail]).any()


def test_vertices_that_contradict_the_initial_map_do_not_fit(small) -> None:
    shape = small[0]
    tail = SMALL[0].directions[:, 1] > 0.85
    vertex = np.arange(len(tail))
    vertex[tail] = np.argmin(SMALL[0].directions[:, 1])
    fit = fit_nonrigid(onto(shape, vertex), shape, shape, False)
    off = np.linalg.norm(fit.positions - shape.mesh.vertices, axis=1)
    back_in_place = tail & (off < 0.05)
    assert back_in_place.any()
    assert not fit.fits[back_in_place].any()


def test_vertices_on_a_side_of_opposite_normals_do_not_fit(small, monkeypatch) -> None:
    shape = small[0]
    tail = SMALL[0].directions[:, 1] > 0.9
    found = Surroundings.closest

    def turned_at_the_tail(self: Surroundings, positions: Floats, normals: Floats) -> SurfaceMap:
        facing = np.where(tail[:, None], -1, 1) if len(normals) == len(tail) else 1
        return found(self, positions, facing * normals)

    monkeypatch.setattr(Surroundings, "closest", turned_at_the_tail)
    monkeypatch.setattr("zoomout_core.matching.registration.nonrigid_icp._astray", lambda *_: np.zeros(len(tail), bool))
    fit = fit_nonrigid(onto(shape, np.arange(len(tail))), shape, shape, False)
    image_normals = fit.surface_map.interpolate(shape.mesh.vertex_normals)
    assert (np.einsum("nx,nx->n", image_normals, shape.mesh.vertex_normals) > 0).all()
    assert fit.fits[~tail].mean() > 0.9
    assert fit.fits[tail].mean() < 0.9


@pytest.mark.parametrize(("angle", "taken"), [(0.05, True), (0.25, False)])
def test_lift_rejects_points_far_from_the_image_of_the_proxy(angle: float, taken: bool) -> None:
    part = ball(0.3, count=300).working
    proxy = Proxy(part, part, part.vertices, np.arange(300))
    slid = Rotation.from_rotvec([0, 0, angle]).apply(part.vertices)
    fit = Fit(proxy.place, slid, np.tile(np.eye(3), (300, 1, 1)), part.vertices[:, 2] > 0)
    found = lift_fit(fit, proxy, proxy, part.vertices + 1).interpolate(part.vertices)
    belt = (part.vertices[:, 2] > 0.05) & (part.vertices[:, 2] < 0.15)
    off = np.linalg.norm(found - (slid if taken else part.vertices), axis=1)[belt]
    assert np.quantile(off, 0.9) < 3e-3
    np.testing.assert_allclose(found[part.vertices[:, 2] < -0.1], part.vertices[part.vertices[:, 2] < -0.1], atol=1e-9)


def test_goals_of_one_rigid_motion_are_lifted_exactly() -> None:
    part = ball(0.3, radii=(1, 0.8, 0.6), count=600).working
    proxy = Proxy(part, part, part.vertices, np.arange(600))
    rough = part.vertices + np.random.default_rng(0).normal(scale=1.5e-3, size=part.vertices.shape)
    fit = Fit(proxy.place, rough, np.tile(np.eye(3), (600, 1, 1)), np.ones(600, dtype=bool))
    found = lift_fit(fit, proxy, proxy, part.vertices + 1).interpolate(part.vertices)
    np.testing.assert_allclose(found, part.vertices, atol=1e-4)
    # Vertices that moved relative to the rest follow the proxy.
    tip = part.vertices[:, 0] > 0.5 * part.vertices[:, 0].max()
    turn = Rotation.from_rotvec([0, 0.06, 0])
    moved = replace(fit, positions=np.where(tip[:, None], turn.apply(part.vertices), rough))
    found = lift_fit(moved, proxy, proxy, part.vertices + 1).interpolate(part.vertices)
    np.testing.assert_allclose(found[~tip], part.vertices[~tip], atol=2e-4)
    assert np.linalg.norm(found - part.vertices, axis=1)[tip].mean() > 0.008


@pytest.mark.parametrize("mirrored", [False, True])
def test_rotated_or_mirrored_copy_is_registered(small, mirrored: bool) -> None:
    source = small[0]
    made = SMALL[0].surface
    sense = np.array([-1.0 if mirrored else 1.0, 1, 1])
    turn = Rotation.from_rotvec([0.5, 1.0, -0.3]).as_matrix()
    triangles = made.triangles[:, ::-1] if mirrored else made.triangles
    copy = Creature(Surface(made.vertices * sense @ turn.T, triangles), SMALL[0].directions)
    target = shape_of(copy)
    fit, reports = reports_of(lambda: fit_nonrigid(onto(source, np.arange(500)), source, target, mirrored))
    fractions = [report.fraction for report in reports]
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] < fractions[-1] < 1
    assert fractions[-1] > 0.8
    assert fit.fits.mean() > 0.95
    np.testing.assert_allclose(fit.positions[fit.fits], source.mesh.vertices[fit.fits], atol=5e-3)
    back = turn.T if not mirrored else np.diag(sense) @ turn.T
    off = np.einsum("nij,kj->nik", fit.rotations[fit.fits], back) - np.eye(3)
    assert np.median(np.abs(off).max(axis=(1, 2))) < 0.05


def test_details_of_fine_meshes_move_with_their_proxies() -> None:
    smooth = creature(9000).surface
    bumps = 1 + 0.03 * np.random.default_rng(0).random((len(smooth.vertices), 1))
    made = Creature(Surface(smooth.vertices * bumps, smooth.triangles), np.empty((0, 3)))
    shape = shape_of(made, 1500)
    mesh, part = shape.mesh, shape.proxy.full
    corner = np.empty(len(mesh.vertices), dtype=int)
    corner[mesh.triangles.ravel()] = np.arange(mesh.triangles.size)
    itself = SurfaceMap(corner // 3, np.eye(3)[corner % 3], mesh.triangles)
    still = Fit(itself, mesh.vertices, np.tile(np.eye(3), (len(corner), 1, 1)), np.ones(len(corner), dtype=bool))
    moved, unfitted = (
        np.linalg.norm(
            lift_fit(fit, shape.proxy, shape.proxy, part.vertices + 1).interpolate(part.vertices) - part.vertices,
            axis=1,
        )
        for fit in (still, Fit.of_map(itself))
    )
    assert moved.max() < 1e-6
    assert unfitted.mean() > 1e-4


def test_the_same_shape_elsewhere_is_matched_exactly() -> None:
    source = creature(6000).surface
    order = np.random.default_rng(0).permutation(len(source.vertices))
    number = np.argsort(order)
    turn, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    target = Surface(3 * source.vertices[order] @ turn.T + 5, number[source.triangles])
    result = zo.match(source, target)
    off = np.linalg.norm(result.surface_map.interpolate(source.vertices) - source.vertices[order], axis=1)
    assert np.percentile(off, 99) < 1e-4 * np.sqrt(source.area)


@pytest.mark.slow
def test_remeshed_copy_in_place_takes_the_nearest_points() -> None:
    source, target = creature(6000, seed=0).surface, creature(5500, seed=1).surface
    result = zo.match(source, target)
    nearest = SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles)
    off = result.surface_map.interpolate(source.vertices) - nearest.interpolate(source.vertices)
    assert np.percentile(np.linalg.norm(off, axis=1), 95) < 1e-9 * np.sqrt(source.area)


@pytest.mark.slow
def test_slightly_moved_remeshed_copy_is_matched_by_its_shape() -> None:
    source, target = creature(6000, seed=0).surface, creature(5500, seed=1).surface
    size = np.sqrt(source.area)
    beside = target.with_vertices(target.vertices + np.array([0, 0.003, 0]) * size)
    off = zo.match(source, beside).surface_map.interpolate(source.vertices) - target.vertices
    assert np.median(np.linalg.norm(off, axis=1)) < 5e-4 * size
