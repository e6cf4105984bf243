# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that would tear a mesh are found by turning the bones, and smoothed from their surroundings."""

from __future__ import annotations

import numpy as np
from bent_tube import LENGTH, PARENTS, tube, weights_of
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.transfer.rigging import poses
from zoomout_core.transfer.rigging.poses import extreme_poses, poses_about
from zoomout_core.transfer.rigging.stretch import (
    STRETCH,
    check_weights,
    play,
    play_offsets,
    smooth_weights,
    stretched_edges,
)
from zoomout_core.tuning import retune

HEADS = np.array([[0, 0, 0], [0, 0, 2], [0, 0, 4.0]])
SOURCE, TARGET = tube(20, 61), tube(15, 47, turned=0.4)
MAP = zo.SurfaceMap(*closest_points(TARGET.vertices, SOURCE.vertices, SOURCE.triangles), SOURCE.triangles)
POSES = extreme_poses(HEADS, PARENTS)


def on_side(radius: float = 0.5) -> np.ndarray:
    """A patch on the lowest bone."""
    return np.linalg.norm(TARGET.vertices - [0.6, 0, 1.0], axis=1) < radius


def wrong_weights(patch: np.ndarray) -> csr_array:
    """The true weights, but those of the topmost bone on a patch."""
    weights = weights_of(TARGET.vertices).toarray()
    weights[patch] = [0, 0, 1]
    return csr_array(weights)


def test_target_may_have_its_own_poses() -> None:
    longer = TARGET.with_vertices(TARGET.vertices * [1, 1, 1.5])
    about = poses_about(POSES, HEADS, HEADS * [1, 1, 1.5], PARENTS)
    own = check_weights(SOURCE, weights_of(SOURCE.vertices), longer, weights_of(TARGET.vertices), MAP, POSES, about)
    still = np.tile(np.eye(3, 4), (1, 3, 1, 1))
    torn = wrong_weights(on_side())
    assert not own.stretched.any()
    assert not check_weights(SOURCE, weights_of(SOURCE.vertices), TARGET, torn, MAP, POSES[:1], still).smoothed.any()
    assert check_weights(SOURCE, weights_of(SOURCE.vertices), TARGET, torn, MAP, POSES[:1]).smoothed.any()


def test_a_surface_without_weights_does_not_stretch() -> None:
    played = play(TARGET, csr_array((len(TARGET.vertices), 3)), POSES)
    np.testing.assert_array_equal(played.growth, 1)


def test_true_weights_stretch_nothing_and_are_kept() -> None:
    weights = weights_of(TARGET.vertices)
    checked = check_weights(SOURCE, weights_of(SOURCE.vertices), TARGET, weights, MAP, POSES)
    assert not checked.stretched.any()
    assert not checked.smoothed.any()
    assert checked.weights is weights


def test_a_patch_of_another_bone_is_found_and_smoothed() -> None:
    patch = on_side()
    weights = wrong_weights(patch)
    played = [play(SOURCE, weights_of(SOURCE.vertices), POSES), play(TARGET, weights, POSES)]
    torn = stretched_edges(*played, MAP, LENGTH)
    assert torn.any()
    ends = played[1].edges[torn]
    assert (patch[ends[:, 0]] != patch[ends[:, 1]]).all()
    checked = check_weights(SOURCE, weights_of(SOURCE.vertices), TARGET, weights, MAP, POSES)
    assert not checked.stretched.any()
    assert checked.smoothed[patch].all()
    assert np.abs((checked.weights - weights_of(TARGET.vertices)).toarray()).max() < 0.2
    np.testing.assert_array_equal(checked.weights.toarray()[~checked.smoothed], weights.toarray()[~checked.smoothed])


def test_repairs_widen_only_where_edges_still_stretch() -> None:
    given = SOURCE, weights_of(SOURCE.vertices), TARGET
    small, large = (wrong_weights(on_side(radius)) for radius in (0.15, 0.5))
    counts = []
    for weights in (small, large):
        checked = check_weights(*given, weights, MAP, POSES)
        assert not checked.stretched.any()
        counts.append(int(checked.smoothed.sum()))
    assert counts[0] < counts[1] / 4
    with retune(STRETCH, rounds=1):
        assert check_weights(*given, large, MAP, POSES).stretched.any()


def test_repairs_widen_in_every_round() -> None:
    with retune(poses.POSES, angle=90.0):
        turned = extreme_poses(HEADS, PARENTS)
    given = SOURCE, weights_of(SOURCE.vertices), TARGET, wrong_weights(on_side(0.8)), MAP, turned
    assert not check_weights(*given).stretched.any()
    with retune(STRETCH, widening=1.0):
        assert check_weights(*given).stretched.any()


def test_each_patch_is_judged_independently() -> None:
    with retune(poses.POSES, angle=90.0):
        turned = extreme_poses(HEADS, PARENTS)
    near, far = on_side(0.8), np.linalg.norm(TARGET.vertices - [-0.6, 0, 3.0], axis=1) < 0.15
    weights = wrong_weights(near | far)
    with retune(STRETCH, rounds=1):
        checked = check_weights(SOURCE, weights_of(SOURCE.vertices), TARGET, weights, MAP, turned)
    assert checked.smoothed[far].all()
    assert not checked.stretched[far].any()
    assert not checked.smoothed[near].any()


def test_short_edges_are_ignored() -> None:
    played = [play(each, weights_of(each.vertices), POSES) for each in (SOURCE, TARGET)]
    torn = played[1]._replace(growth=np.full(len(played[1].edges), 100.0))
    assert stretched_edges(played[0], torn, MAP, LENGTH).any()
    assert not stretched_edges(played[0], torn, MAP, 1000 * LENGTH).any()


def test_edges_that_stretch_as_much_on_the_source_are_accepted() -> None:
    weights = weights_of(TARGET.vertices)
    source = play(SOURCE, weights_of(SOURCE.vertices), POSES)
    target = play(TARGET, weights, POSES)
    growth = target._replace(growth=np.full(len(target.edges), 3.0))
    assert stretched_edges(source, growth, MAP, LENGTH).any()
    also = source._replace(growth=np.full(len(source.edges), 2.0))
    assert not stretched_edges(also, growth, MAP, LENGTH).any()


def test_smoothed_weights_keep_their_sums() -> None:
    weights = csr_array(wrong_weights(on_side()).toarray() * 0.5)
    smoothed = smooth_weights(weights, TARGET, on_side(1.0))
    np.testing.assert_allclose(smoothed.sum(axis=1), 0.5)


def test_edges_are_measured_for_each_key() -> None:
    square = zo.Surface([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    lifted = np.zeros((4, 3))
    lifted[3, 2] = 1
    still, moved = play_offsets(square, [np.zeros((4, 3)), lifted])
    np.testing.assert_array_equal(still.growth, 1)
    at_corner = (moved.edges == 3).any(axis=1)
    np.testing.assert_allclose(moved.growth[at_corner], np.sqrt(2))
    np.testing.assert_allclose(moved.length[at_corner], np.sqrt(2))
    np.testing.assert_array_equal(moved.growth[~at_corner], 1)
