# SPDX-License-Identifier: GPL-3.0-or-later
"""The pose of a target is estimated from its map to a rigged source, and refined if both have the same body."""

import numpy as np
from bent_tube import LENGTH, PARENTS, bend, pose_surface, tube, weights_of
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.mesh.affine_maps import transform_points
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import map_target
from zoomout_core.transfer.rigging.bone_fit import Pose
from zoomout_core.transfer.rigging.bone_problem import BONES
from zoomout_core.transfer.rigging.rest_pose import REST, align, correct_by_bones, correct_map, find_pose
from zoomout_core.transfer.rigging.skinning import skinning_matrices
from zoomout_core.tuning import retune

SOFT = ((40, 0, 20), (30, 10, 0))


class _Match:
    """The fields of a match that a transfer uses."""

    def __init__(self, surface_map, confidence, has_partner=None):
        self.surface_map, self.confidence, self.has_partner = surface_map, confidence, has_partner


def _map_at_rest(source, target, still, shift=0.0, **match):
    """Map a target by its vertices at rest, `still`, with an error of `shift` along the tube."""
    points = still + np.array([0, 0, shift])
    found = zo.SurfaceMap(*closest_points(points, source.vertices, source.triangles), source.triangles)
    match = {"confidence": np.ones(len(still)), **match}
    return map_target(_Match(found, **match), source, target)


def _errors(found, source, still):
    """Distance of vertices at rest, posed by the found bones, from their true posed places."""
    weights = weights_of(still)
    truth = transform_points(skinning_matrices(bend(*SOFT), weights), still)
    return np.linalg.norm(transform_points(skinning_matrices(found.pose.transforms, weights), still) - truth, axis=1)


def test_slid_map_is_replaced_where_the_target_lies_on_the_source():
    source, still = tube(), tube(13, 55, turned=0.4)
    target = pose_surface(still, bend(*SOFT))
    mapped = _map_at_rest(source, target, still.vertices, shift=0.12)
    found = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    with retune(REST, rounds=0):
        first = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    assert np.median(_errors(found, source, still.vertices)) < 0.5 * np.median(_errors(first, source, still.vertices))
    at_rest = found.mapped.points - still.vertices
    assert np.median(np.linalg.norm(at_rest, axis=1)) < 0.07
    assert first.mapped.surface_map is mapped.surface_map


def test_bones_correct_a_slid_map_on_the_same_body_alone():
    source, still = tube(), tube(13, 55, turned=0.4)
    weights, target = weights_of(source.vertices), pose_surface(still, bend(*SOFT))
    mapped = _map_at_rest(source, target, still.vertices, shift=0.12, confidence=np.full(len(still.vertices), 0.2))
    corrected = correct_map(mapped, find_pose(mapped, source, weights, PARENTS), weights)
    off, before = (np.linalg.norm(each.points - still.vertices, axis=1) for each in (corrected, mapped))
    assert np.median(off) < 0.6 * np.median(before)
    assert (corrected.confidence >= mapped.confidence).all()
    assert np.median(corrected.confidence) > 0.2
    wide = still.with_vertices(still.vertices * [1.5, 1.5, 1])
    other = _map_at_rest(source, pose_surface(wide, bend(*SOFT)), still.vertices)
    assert correct_map(other, find_pose(other, source, weights, PARENTS), weights) is other


def test_corrected_map_stays_above_what_the_target_hides():
    cloth, still = tube(), tube(13, 55, turned=0.4)
    body = cloth.with_vertices(cloth.vertices * [0.97, 0.97, 1])
    source = zo.Surface.joined([cloth, body])
    thin = still.with_vertices(still.vertices * [0.98, 0.98, 1])  # nearer to the body than to the cloth
    weights, target = weights_of(source.vertices), pose_surface(thin, bend(*SOFT))
    on_cloth = closest_points(still.vertices + np.array([0, 0, 0.12]), cloth.vertices, cloth.triangles)
    mapped = map_target(
        _Match(zo.SurfaceMap(*on_cloth, source.triangles), np.ones(len(still.vertices))), source, target
    )
    corrected = correct_map(mapped, find_pose(mapped, source, weights, PARENTS), weights)
    assert corrected is not mapped
    assert (corrected.surface_map.triangle < len(cloth.triangles)).all()
    with retune(REST, reach=0.0):  # the places beside the images are not reached
        unreached = correct_map(mapped, find_pose(mapped, source, weights, PARENTS), weights)
    off, before = (np.median(np.linalg.norm(each.points - thin.vertices, axis=1)) for each in (corrected, unreached))
    assert off < before


def test_corrected_map_reaches_a_part_only_near_its_images():
    cloth, still = tube(), tube(13, 55, turned=0.4)
    body = cloth.with_vertices(cloth.vertices * [0.97, 0.97, 1])
    source = zo.Surface.joined([cloth, body])
    bare = still.vertices[:, 2] > 0.8 * LENGTH
    thin = still.with_vertices(still.vertices * [0.98, 0.98, 1])  # nearer to the body than to the cloth
    weights, target = weights_of(source.vertices), pose_surface(thin, bend(*SOFT))
    outer, inner = (
        closest_points(still.vertices + np.array([0, 0, 0.12]), each.vertices, each.triangles) for each in (cloth, body)
    )
    triangle = np.where(bare, inner[0] + len(cloth.triangles), outer[0])
    barycentric = np.where(bare[:, None], inner[1], outer[1])
    match = _Match(zo.SurfaceMap(triangle, barycentric, source.triangles), np.ones(len(bare)))
    mapped = map_target(match, source, target)
    far = still.vertices[:, 2] < 0.7 * LENGTH
    on_cloth = []
    for reach in (REST.reach, 1.0):
        with retune(REST, reach=reach):
            corrected = correct_map(mapped, find_pose(mapped, source, weights, PARENTS), weights)
        on_cloth.append(corrected.surface_map.triangle < len(cloth.triangles))
    assert on_cloth[0][far].all()
    assert not on_cloth[1][far].all()


def test_map_is_not_corrected_in_place_or_without_weights():
    source, still = tube(), tube(13, 55, turned=0.4)
    weights = weights_of(source.vertices)
    in_place = _map_at_rest(source, still, still.vertices, shift=0.12)
    assert correct_by_bones(in_place, source, weights, PARENTS) is in_place
    posed = _map_at_rest(source, pose_surface(still, bend(*SOFT)), still.vertices, shift=0.12)
    assert correct_by_bones(posed, source, 0 * weights, PARENTS) is posed


def test_bones_correct_the_map_also_where_normals_differ():
    source, still = tube(), tube(13, 55, turned=0.4)
    weights, target = weights_of(source.vertices), pose_surface(still, bend(*SOFT))
    mapped = _map_at_rest(source, target, still.vertices, shift=0.12)
    posed = find_pose(mapped, source, weights, PARENTS)
    with retune(REST, facing=0.999999):  # no normals agree so well
        corrected = correct_map(mapped, posed, weights)
    assert (np.linalg.norm(corrected.points - mapped.points, axis=1) > 0.02).mean() > 0.9


def test_noise_does_not_make_another_body():
    source, still = tube(), tube(36, 160, turned=0.4)
    target = pose_surface(still, bend(*SOFT))
    noise = 0.0025 * np.sqrt(target.area) * np.random.default_rng(0).standard_normal(target.vertices.shape)
    mapped = _map_at_rest(source, target.with_vertices(target.vertices + noise), still.vertices, shift=0.12)
    found = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    assert found.mapped.surface_map is not mapped.surface_map
    with retune(REST, averaged=1e-9):
        coupled = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    assert coupled.mapped.surface_map is mapped.surface_map
    errors = [np.median(_errors(each, source, still.vertices)) for each in (found, coupled)]
    assert errors[0] < 0.7 * errors[1]


def test_source_may_be_posed():
    source, still = tube(), tube(13, 55, turned=0.4)
    target = pose_surface(still, bend(*SOFT))
    mapped = _map_at_rest(source, target, still.vertices)
    waving = pose_surface(source, bend((0, 50, 0), (-30, 0, 0)))
    seen = map_target(_Match(mapped.surface_map, np.ones(len(still.vertices))), waving, target)
    found = find_pose(seen, source, weights_of(source.vertices), PARENTS)
    assert np.median(_errors(found, source, still.vertices)) < 0.02
    assert found.mapped.source is source


def test_another_body_keeps_its_map():
    source, still = tube(), tube(13, 55, turned=0.4)
    stout = still.with_vertices(still.vertices * [1.5, 1.5, 1.0])
    target = pose_surface(stout, bend(*SOFT), weights_of(still.vertices))
    mapped = _map_at_rest(source, target, still.vertices)
    found = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    assert found.mapped.surface_map is mapped.surface_map
    with retune(REST, same_body=1.0, settled=1.0):
        taken = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    assert taken.mapped.surface_map is not mapped.surface_map


def _short_bones(points, count=24):
    """(n, count) weights of a chain of short bones."""
    along = points[:, 2] / LENGTH * count - 0.5
    return csr_array(np.maximum(1 - np.abs(along[:, None] - np.arange(count)), 0))


def _wavy(points, height, waves):
    """Points of another build of the tube, displaced by waves along it, and (n,) their displacements."""
    wave = height * np.sin(2 * np.pi * waves * points[:, 2] / LENGTH)
    return points * [1.1, 0.9, 1.0] + wave[:, None] * [1.0, 0, 0], wave


def test_a_similar_body_is_not_bent_into_the_source():
    source, still = tube(), tube(13, 55, turned=0.4)
    other, wave = _wavy(still.vertices, 0.1, 4)
    mapped = _map_at_rest(source, still.with_vertices(other), still.vertices)
    weights, parents = _short_bones(source.vertices), np.arange(24) - 1

    def find():
        found = find_pose(mapped, source, weights, parents)
        matrices = skinning_matrices(found.pose.transforms, _short_bones(still.vertices))
        return found, np.std(transform_points(matrices, still.vertices)[:, 0] - still.vertices[:, 0])

    (found, moved), size = find(), np.std(wave)
    with retune(REST, settled=0.01):
        same, moved_as_same = find()
    with retune(BONES, of_others=BONES.coherence):
        _, moved_freely = find()
    assert found.mapped.surface_map is mapped.surface_map
    assert same.mapped.surface_map is not mapped.surface_map
    assert moved < 0.7 * size < 0.8 * min(moved_as_same, moved_freely)


def test_vertices_far_from_the_source_keep_their_images():
    source, still = tube(), tube(13, 55, turned=0.4)
    target = pose_surface(still, bend(*SOFT))
    mapped = _map_at_rest(source, target, still.vertices)
    wrong = still.vertices[:, 2] < 0.3
    triangle = np.where(wrong, mapped.surface_map.triangle[~wrong][-1], mapped.surface_map.triangle)
    match = _Match(zo.SurfaceMap(triangle, mapped.surface_map.barycentric, source.triangles), np.ones(len(wrong)))
    found = find_pose(map_target(match, source, target), source, weights_of(source.vertices), PARENTS)
    np.testing.assert_array_equal(found.mapped.surface_map.triangle[wrong], triangle[wrong])
    assert found.mapped.confidence[wrong].max() < np.median(found.mapped.confidence[~wrong])


def test_vertices_without_a_partner_are_ignored():
    source, still = tube(), tube(13, 55, turned=0.4)
    target = pose_surface(still, bend(*SOFT))
    alone = still.vertices[:, 2] > 4.5
    vertices = target.vertices.copy()
    vertices[alone] += [0, 3.0, 0]  # like a hat that only the target has
    mapped = _map_at_rest(source, target.with_vertices(vertices), still.vertices, has_partner=~alone)
    found = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    assert np.median(_errors(found, source, still.vertices)[~alone]) < 0.05
    assert not found.mapped.confidence[alone].any()


def _pose_at_rest(scale, turn, shift):
    """The pose of a target at rest with a common similarity."""
    common = Similarities(np.array(scale), turn, np.array(shift))
    return Pose(Similarities(np.array([scale]), turn[None], np.array([shift])), common, 0.0)


def test_target_at_rest_is_aligned_with_the_source():
    still = tube()
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pose = _pose_at_rest(2.0, turn, [3.0, 4, 5])
    rest = align(still.with_vertices(pose.common(still.vertices)), pose)
    np.testing.assert_allclose(rest.positions, still.vertices, atol=1e-9)
    np.testing.assert_allclose(rest.linear, np.broadcast_to(turn.T / 2, (656, 3, 3)), atol=1e-12)
    assert rest.smoothed == 0


def test_target_at_rest_near_the_source_is_not_moved():
    still = tube()  # square root of its area is about 4.5
    for shift, stays in ((0.08, True), (0.1, False)):
        target = still.with_vertices(still.vertices + shift * np.array([1.0, 0, 0]))
        rest = align(target, _pose_at_rest(1.0, np.eye(3), [shift, 0.0, 0.0]))
        assert np.array_equal(rest.positions, target.vertices) == stays
        np.testing.assert_allclose(rest.linear, np.broadcast_to(np.eye(3), (656, 3, 3)), atol=1e-12)


def test_moved_and_scaled_target_is_at_rest():
    source, still = tube(), tube(13, 55, turned=0.4)
    target = still.with_vertices(2 * still.vertices + np.array([1.0, 0, 3]))
    found = find_pose(_map_at_rest(source, target, still.vertices), source, weights_of(source.vertices), PARENTS)
    assert found.pose.is_rest
    np.testing.assert_allclose(align(target, found.pose).positions, still.vertices, atol=0.02)


def test_a_wrong_map_does_not_bend_a_target_at_rest():
    source, still = tube(), tube(13, 55, turned=0.4)
    target = still.with_vertices(still.vertices + np.array([3.0, 0, 0]))
    images = pose_surface(still, bend((0, 30, 0), (0, -30, 0))).vertices  # closest points of these are elsewhere
    found = find_pose(_map_at_rest(source, target, images), source, weights_of(source.vertices), PARENTS)
    assert found.pose.bend == 0
    assert found.pose.scale == 1
    np.testing.assert_allclose(align(target, found.pose).positions, still.vertices, atol=0.02 * LENGTH)
    assert np.median(np.linalg.norm(found.mapped.points - still.vertices, axis=1)) < 0.02 * LENGTH


def test_a_slight_bend_is_a_pose():
    source, still = tube(), tube(13, 55, turned=0.4)
    target = pose_surface(still, bend((12, 0, 0), (0, 12, 0)))
    found = find_pose(_map_at_rest(source, target, still.vertices), source, weights_of(source.vertices), PARENTS)
    assert not found.pose.is_rest


def _slanting(points):
    """Points of a stout tube around the same axis, whose cross-sections slant one way and the other."""
    slant = 0.8 * np.cos(np.pi * (points[:, 2] - 1) / 2) * points[:, 0]
    return points * [1.6, 1.6, 1.0] + slant[:, None] * np.array([0, 0, 1.0])


def _find_slanting(still, *turns):
    """A map of the tube in another build, perhaps bent, and its pose."""
    source = tube()
    target = still.with_vertices(_slanting(still.vertices))
    if turns:
        target = pose_surface(target, bend(*turns), weights_of(still.vertices))
    mapped = _map_at_rest(source, target, still.vertices)
    return mapped, find_pose(mapped, source, weights_of(source.vertices), PARENTS)


def test_bones_that_keep_their_axes_rotate_because_of_another_build():
    mapped, found = _find_slanting(tube(13, 55, turned=0.4))
    assert found.pose.bend > 1.5 * BONES.same_pose
    assert found.pose.is_rest
    assert found.mapped.surface_map is mapped.surface_map


def test_a_bend_of_another_build_is_a_pose():
    for turns in (((23, 0, 0), (0, 0, 0)), ((0, 0, 0), (0, 23, 0)), ((60, 0, 30), (40, 20, 0))):
        assert not _find_slanting(tube(13, 55, turned=0.4), *turns)[1].pose.is_rest


def test_another_build_that_free_bones_fit_keeps_its_map():
    source, still = tube(), tube(13, 55, turned=0.4)
    mapped = _map_at_rest(source, still.with_vertices(_wavy(still.vertices, 0.06, 2)[0]), still.vertices)
    weights, parents = _short_bones(source.vertices), np.arange(24) - 1
    with retune(REST, settled=0.01):
        found = find_pose(mapped, source, weights, parents)
    assert found.pose.is_rest
    assert found.mapped.surface_map is mapped.surface_map


def test_worn_parts_of_a_target_do_not_move_it():
    source, still = tube(), tube(13, 55, turned=0.4)
    hat = ball(0.25 * LENGTH, (0.35 * LENGTH, 0, 0.9 * LENGTH), count=300)
    target = zo.Surface.joined([still, hat])
    images = np.concatenate([pose_surface(still, bend((0, 30, 0), (0, -30, 0))).vertices, hat.vertices])
    worn = np.arange(len(images)) >= len(still.vertices)
    mapped = _map_at_rest(source, target, images, has_partner=~worn, confidence=np.where(worn, 0.0, 1.0))
    found = find_pose(mapped, source, weights_of(source.vertices), PARENTS)
    assert found.pose.bend == 0
    np.testing.assert_allclose(align(target, found.pose).positions, target.vertices, atol=0.03 * LENGTH)
