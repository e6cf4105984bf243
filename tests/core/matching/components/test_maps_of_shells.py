# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of shells to partners, detection of outer vertices, and landmarks on maps of shells."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loose_parts import identity, shape_of, sheet
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.matching.components.part_motions import MovedTarget
from zoomout_core.matching.components.parts import Side
from zoomout_core.matching.components.shell_images import find_beneath, map_onto_partner, near_hull
from zoomout_core.matching.components.shell_pairs import pair_shells
from zoomout_core.matching.components.shells import ShellMap, _motion, _pin, map_shells
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.registration.nonrigid_icp import Fit
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball


def side_of(*shells: Surface) -> Side:
    mesh = Surface.joined(shells).working
    points = mesh.to_surface(mesh.vertices)
    return Side(mesh, points, np.ones(len(points)), np.zeros(0, dtype=np.int64))


ROD = ball(0.1, radii=(3, 1, 0.5), count=200)
ONE_ROD = side_of(ROD)
STILL = Similarities(np.ones(1), np.eye(3)[None], np.zeros((1, 3)))


@cache
def oriented_surface(source: Side) -> OrientedSurface:
    mesh = source.mesh
    return OrientedSurface(source.points, mesh.triangles, mesh.flipped, 0.02, mesh.component[mesh.triangles[:, 0]])


def map_first_shell(
    target: Side,
    source: Side,
    moved: np.ndarray,
    similarity: Similarities = STILL,
    scale: float = 1.0,
    stays: bool = False,
    partner: int = 0,
) -> tuple[np.ndarray, float]:
    """Images of a target's first shell, moved by the body's map, on its partner, and the stretch of its edges."""
    mesh, shells = source.mesh, oriented_surface(source)
    part = replace(target.parts(target.points)[0], points=moved)
    motion: Any = SimpleNamespace(scale=scale)
    body = MovedTarget(target.points, target.mesh.vertex_normals, motion, stays)
    image, stretch = map_onto_partner(part, partner, similarity, body, shells, source, target)
    return np.einsum("nc,ncx->nx", image.barycentric, source.points[mesh.triangles[image.triangle]]), stretch


def bend_rod(points: np.ndarray) -> np.ndarray:
    """Bend a rod along x into an arc."""
    x, y, z = points.T
    return np.column_stack([(0.25 - z) * np.sin(4 * x), y, 0.25 - (0.25 - z) * np.cos(4 * x)])


def test_stiff_shell_follows_the_similarity_not_the_bent_body() -> None:
    side = ONE_ROD
    on, stretch = map_first_shell(side, side, bend_rod(side.points))
    np.testing.assert_allclose(on, side.points, atol=1e-9)
    assert stretch == pytest.approx(0, abs=1e-9)


def test_bending_shell_follows_the_body() -> None:
    side = ONE_ROD
    curved = side_of(ROD.with_vertices(bend_rod(ROD.vertices)))
    on, stretch = map_first_shell(side, curved, curved.points)
    np.testing.assert_allclose(on, curved.points, atol=1e-9)
    assert 0 < stretch < 0.3


@pytest.mark.parametrize(
    ("off", "stays", "by_similarity"), [(0.006, True, False), (0.006, False, True), (0.06, True, True)]
)
def test_shell_on_its_partner_stays_if_the_body_stays(off: float, stays: bool, by_similarity: bool) -> None:
    side = ONE_ROD
    wave = off * np.sin(40 * side.points[:, :1]) * [1.0, 0, 0] + [0, 0, off]
    on, _ = map_first_shell(side, side, side.points + wave, stays=stays)
    assert (np.abs(on - side.points).max() < 1e-9) == by_similarity


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_stretch_is_measured_in_the_scale_of_the_body(unit: float) -> None:
    source, target = (side_of(ROD.with_vertices(factor * unit * ROD.vertices)) for factor in (1, 2))
    half = replace(STILL, scale=np.array([0.5]))
    for scale, stretch in ((0.5, 0.0), (0.625, 0.2), (0.4, 0.25)):
        assert map_first_shell(target, source, target.points / 2, half, scale)[1] == pytest.approx(stretch, abs=1e-6)


def test_similarity_keeps_the_sides_of_a_thin_shell() -> None:
    thin = ball(0.1, radii=(1, 1, 0.03), count=200)
    about = Rotation.from_rotvec([np.pi, 0, 0]).as_matrix()
    target = side_of(thin.with_vertices(thin.vertices @ about.T))
    # The lift makes the other side nearer.
    on, _ = map_first_shell(
        target, side_of(thin), bend_rod(target.points), Similarities(np.ones(1), about[None], np.array([[0, 0, 0.005]]))
    )
    middle = np.linalg.norm(thin.vertices[:, :2], axis=1) < 0.06
    np.testing.assert_array_equal(np.sign(on[middle, 2]), np.sign(thin.vertices[middle, 2]))


def test_nearest_points_are_on_the_side_of_similar_normals() -> None:
    thin = side_of(ball(0.1, radii=(1, 1, 0.03), count=200))
    outer = np.ones(len(thin.points), dtype=bool)
    for sense in (1, -1):
        image = find_beneath(thin.points * [1, 1, -1.5], sense * thin.mesh.vertex_normals, thin, outer, outer, False)
        on = np.einsum("nc,ncx->nx", image.barycentric, thin.points[thin.mesh.triangles[image.triangle]])
        middle = np.linalg.norm(thin.points[:, :2], axis=1) < 0.06
        np.testing.assert_array_equal(np.sign(on[middle, 2]), sense * np.sign(thin.points[middle, 2]))


def test_shell_maps_only_to_its_partner() -> None:
    both = side_of(ROD, ball(0.09, (0, 0, 0.05), radii=(3, 1, 0.5), count=200))
    at = both.points[both.mesh.component == 0]
    for partner in (0, 1):
        on, _ = map_first_shell(both, both, at, partner=partner)
        assert set(np.round(np.abs(on[:, 2] - 0.05 * partner).max(), 3)[None]) <= {0.05, 0.045}


# --- pairing of shells --------------------------------------------------------------------------------------------


def partners(target: Side, source: Side, scale: float = 1.0) -> dict[int, int]:
    """Paired shell numbers, largest shell first, for a body that stays or grows by `scale`."""
    motion: Any = SimpleNamespace(
        transform=lambda points, normals: (scale * points, normals, np.ones(len(points))), handedness=1.0, scale=scale
    )
    pair: Any = SimpleNamespace(regions=[])
    return dict(pair_shells(pair, motion, target.parts(target.points), source.parts(source.points), source, target)[0])


def number_of(source: Side, at: float) -> int:
    """Number of the shell whose centre has the y coordinate closest to `at`."""
    return int(np.argmin([abs(part.points[:, 1].mean() - at) for part in source.parts(source.points)]))


def test_same_shape_wins_over_a_nearer_shell_of_equal_moments() -> None:
    blunt = ROD.vertices + 0.9 * np.maximum(ROD.vertices, 0) ** 2 / 0.1 * [1 / 3, 1, 2]
    blunt = blunt - blunt.mean(axis=0)
    axes, spread, _ = np.linalg.svd(blunt.T @ blunt)
    where = ROD.vertices / [0.3, 0.1, 0.05]
    smooth = where / np.sqrt((where**2).mean(axis=0)) * np.sqrt(spread / len(blunt)) @ axes.T
    for sign in (1, -1):
        source = side_of(
            ROD.with_vertices(blunt + np.array([0, 0.06 * sign, 0])), ROD.with_vertices(smooth - [0, 0.03 * sign, 0])
        )
        assert partners(side_of(ROD.with_vertices(blunt)), source) == {0: number_of(source, 0.06 * sign)}


def test_near_shell_wins_over_a_far_one_of_more_similar_size() -> None:
    for sign in (1, -1):
        near, far = ROD.vertices * 1.05 + np.array([0, 0.02 * sign, 0]), ROD.vertices - np.array([0, 0.13 * sign, 0])
        source = side_of(ROD.with_vertices(near), ROD.with_vertices(far))
        assert partners(side_of(ROD), source) == {0: number_of(source, 0.02 * sign)}


@pytest.mark.parametrize("scale", [0.4, 2.5])
def test_shells_may_scale_with_the_body(scale: float) -> None:
    target = side_of(ROD.with_vertices(ROD.vertices / scale))
    assert partners(target, side_of(ROD.with_vertices(ROD.vertices + np.array([0, 0.1, 0]))), scale) == {0: 0}


def test_near_shell_is_tried_despite_many_far_ones_of_its_size() -> None:
    far = [ROD.with_vertices(ROD.vertices + np.array([0.0, 0.1 + 0.009 * i, 0])) for i in range(8)]
    source = side_of(ROD.with_vertices(ROD.vertices * 1.05 - np.array([0, 0.01, 0])), *far)
    assert partners(side_of(ROD), source) == {0: number_of(source, -0.01)}


# --- the outside ----------------------------------------------------------------------------------------------------


def skin_of(surface: Surface) -> ShapeAnalysis:
    """The largest part of a surface, marked as a hull around all of it."""
    shape = shape_of(surface, functions=100)
    hull = replace(shape.mesh, is_hull=True)
    return replace(shape, proxy=replace(shape.proxy, full=hull, mesh=hull))


def test_shells_near_the_hull_are_on_the_outside() -> None:
    radius = (4 * np.pi) ** -0.5
    hull = skin_of(ball(radius, count=1500))
    side = side_of(*(ball(radius - below, count=40) for below in (0.0, 0.01, 0.04, 0.2)))
    np.testing.assert_array_equal(near_hull(side, hull), side.mesh.component < 2)


# --- all shells -----------------------------------------------------------------------------------------------------


def map_of(source: Surface, target: Surface, trust: float = 0.8, on_hull: bool = True) -> ShellMap:
    """Map of shells; the largest shell serves as the hull, and maps to the other hull by vertex number.

    Args:
        source: surface that the map goes to.
        target: surface that the map starts from.
        trust: confidence of the hull's map.
        on_hull: whether the hulls' vertices have partners.
    """
    shapes = [skin_of(surface) for surface in (source, target)]
    pair = Pair(source, target, shapes[0], shapes[1], 20, 10)
    partners = Partners(*(np.full(len(shape.mesh.vertices), on_hull) for shape in shapes[::-1]))
    return map_shells(pair, Fit.of_map(identity(shapes[1])), np.full(len(partners.target), trust), partners)


TRUNK = ball(0.3, radii=(1, 0.7, 1.6), count=150)
HORN, KNOB = ball(0.1, (0.3, 0, 0.3), (0.5, 0.6, 1.5), 80), ball(0.08, (-0.3, 0, -0.2), count=80)
ABOUT = Rotation.from_rotvec([0.4, 2.0, 0.7]).as_matrix()


def rotate(surface: Surface) -> Surface:
    return surface.with_vertices(surface.vertices @ ABOUT.T + 3)


def test_shells_map_to_their_partners_with_high_confidence() -> None:
    source = Surface.joined([TRUNK, HORN, KNOB])
    found = map_of(source, rotate(source))
    on = found.surface_map.interpolate(source.vertices[np.argsort(source.working.vertex_of)])
    np.testing.assert_allclose(on, source.vertices[np.argsort(source.working.vertex_of)], atol=5e-3)
    assert found.paired == 3
    assert found.alone == pytest.approx(0, abs=0.01)
    assert not found.in_place
    assert found.confidence.min() > 0.8


@pytest.mark.parametrize("away", [0.0, 1.0])
def test_unpaired_shell_maps_to_the_nearest_point_with_doubt(away: float) -> None:
    source = Surface.joined([TRUNK, HORN])
    loose = KNOB.with_vertices(KNOB.vertices + np.array([-away, 0, 0]))
    target = rotate(Surface.joined([TRUNK, HORN, loose]))
    found = map_of(source, target)
    assert found.paired == 2
    on_knob = target.working.component == 2
    assert 0 <= found.confidence.min() < found.confidence.max() <= 1
    share = loose.area / target.area
    if away:
        assert found.alone == pytest.approx(share, rel=0.1)
        assert found.confidence[on_knob].max() < 0.05
    else:
        assert found.alone < share
        assert 0.1 < found.confidence[on_knob].mean() < 0.8


@pytest.mark.parametrize("on_target", [False, True])
def test_shell_far_from_the_other_surface_has_no_partner(on_target: bool) -> None:
    far = KNOB.with_vertices(KNOB.vertices - np.array([1.0, 0, 0]))
    longer, shorter = Surface.joined([TRUNK, HORN, far]), Surface.joined([TRUNK, HORN])
    source, target = (shorter, rotate(longer)) if on_target else (longer, rotate(shorter))
    found = map_of(source, target).partners
    # All shells but the third.
    np.testing.assert_array_equal(found.target, target.working.component < 2)
    np.testing.assert_array_equal(found.source, source.working.component < 2)


def test_only_paired_shells_have_partners_if_the_hull_has_none() -> None:
    source = Surface.joined([TRUNK, KNOB])
    target = rotate(Surface.joined([TRUNK, KNOB, HORN]))
    found = map_of(source, target, on_hull=False)
    assert found.paired == 2
    np.testing.assert_array_equal(found.partners.target, target.working.component != 1)
    assert found.partners.source.all()


def test_shells_in_place_have_partners_without_the_hull() -> None:
    source = Surface.joined([TRUNK, KNOB])
    in_place = map_of(source, Surface.joined([TRUNK, KNOB, ball(0.01, (0, 0.21, 0), count=20)]), on_hull=False)
    assert in_place.in_place
    assert in_place.paired == 2
    assert np.concatenate(in_place.partners).all()


@pytest.mark.parametrize(("trust", "of_body"), [(0.8, 0.8), (1.3, 1.0), (-0.3, 0.0)])
def test_confidence_is_the_trust_of_the_body_reduced_by_distance(trust: float, of_body: float) -> None:
    target = Surface.joined([TRUNK, *(ball(0.01, (0, 0.21 + off, 0), count=20) for off in (0.01, 0.05, 0.2))])
    found = map_of(TRUNK, target, trust)
    mesh = target.working
    apart = np.linalg.norm(
        found.surface_map.interpolate(TRUNK.working.to_surface(TRUNK.working.vertices))
        - mesh.to_surface(mesh.vertices),
        axis=1,
    )
    squared = (apart[mesh.component > 0] / np.sqrt(TRUNK.area)) ** 2
    np.testing.assert_allclose(found.confidence[mesh.component == 0], of_body, atol=1e-3)
    confidence = found.confidence[mesh.component > 0]
    if of_body:
        fallen = (of_body / confidence - 1) / squared
        np.testing.assert_allclose(fallen, np.median(fallen), rtol=0.02)
    else:
        np.testing.assert_array_equal(confidence, 0)


EYE, SPECK, PACK = ball(0.03, (0, 0.3, 0.1), count=40), ball(0.005, (0, 0.25, 0), count=20), ball(0.12, (0, -0.5, 0))


@pytest.mark.parametrize(
    ("beside", "dressed", "paired"), [(SPECK, True, 0), (SPECK, False, 1), (EYE, True, 2), (PACK, True, 1)]
)
def test_one_skin_beside_debris_is_not_the_body_below_clothes(beside: Surface, dressed: bool, paired: int) -> None:
    body, coat = ball(0.3, radii=(1, 0.7, 1.6), count=500), ball(0.32, radii=(1, 0.7, 1.3), count=500)
    source, target = Surface.joined([body, coat, EYE] if dressed else [body, EYE]), Surface.joined([body, beside])
    found = map_of(source, rotate(target))
    on_body = source.working.component[source.working.triangles[found.surface_map.triangle, 0]] == 0
    assert found.paired == paired
    assert on_body[target.working.component == 0].all() == (paired > 0)


@pytest.mark.parametrize("itself", [False, True])
def test_overlapping_shells_stay_except_in_a_self_map(itself: bool) -> None:
    source = Surface.joined([TRUNK, HORN, KNOB])
    target = source if itself else Surface.joined([TRUNK, HORN, KNOB])
    assert map_of(source, target).in_place is not itself


@pytest.mark.parametrize(("confidence", "by_fit"), [(0.1, True), (0.6, False)])
def test_shells_follow_a_rejected_fit_where_confidence_is_low(confidence: float, by_fit: bool) -> None:
    source, target = TRUNK, rotate(TRUNK)
    shapes = [skin_of(surface) for surface in (source, target)]
    pair = Pair(source, target, shapes[0], shapes[1], 20, 10)
    exchanged = identity(shapes[1])
    tip = shapes[1].mesh.vertices[:, 2] > 0.8 * shapes[1].mesh.vertices[:, 2].max()
    exchanged.triangle[tip] = exchanged.triangle[np.argmin(shapes[1].mesh.vertices[:, 2])]
    fit = Fit(exchanged, shapes[0].mesh.vertices, np.zeros((len(tip), 3, 3)), ~tip)
    side = Side.of(pair.target, pair.target_shape.proxy.full)
    motion, _ = _motion(pair, fit, np.where(tip, confidence, 0.9), side)
    right = np.linalg.norm(motion.images - shapes[0].proxy.vertices, axis=1) < 1e-6
    assert tip.any()
    assert right[~tip].all()
    assert (right[tip] == by_fit).all()


# --- landmarks ------------------------------------------------------------------------------------------------------


def test_landmarks_are_hit_and_distant_points_stay() -> None:
    side = side_of(sheet(1.0, count=20))
    same: Any = SimpleNamespace(proxy=SimpleNamespace(full=SimpleNamespace(from_surface=lambda points: points)))
    pair: Any = SimpleNamespace(source_shape=same, target_shape=same)
    corner = np.zeros(len(side.points), dtype=np.int64)
    corner[side.mesh.triangles.ravel()] = np.arange(side.mesh.triangles.size)
    still = identity(SimpleNamespace(mesh=side.mesh))  # type: ignore[arg-type]
    for at, to in (([[0, 0, 0]], [[0.06, 0, 0]]), ([[0, 0, 0], [0.1, 0, 0]], [[0.02, 0.03, 0], [0.13, -0.02, 0]])):
        given, goals = np.array(at, dtype=float), np.array(to, dtype=float)
        on = _pin(still, (goals, given), side, side, pair).interpolate(side.points)
        vertex = [int(np.argmin(np.linalg.norm(side.points - place, axis=1))) for place in given]
        np.testing.assert_allclose(on[vertex], goals, atol=1e-9)
        moved = np.linalg.norm(on - side.points, axis=1)
        distance = np.linalg.norm(side.points[:, None] - given, axis=2).min(axis=1)
        np.testing.assert_allclose(moved[distance > 0.4], 0, atol=1e-12)
        assert moved[(distance > 0.04) & (distance < 0.06)].min() > 0
        assert moved[distance > 0.2].max() < moved[vertex].min()
