# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration of a shell to another: limits, initial rotations and distances in both directions."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import directions
from loose_parts import egg
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.matching.components.shell_registration import (
    SHELL_ICP,
    Shells,
    _along_axes,
    _partners,
    register_shells,
)
from zoomout_core.tuning import retune

ONE = np.zeros(1, dtype=np.int64)


def similarity(scale: float = 1.0, turn: tuple[float, float, float] = (0, 0, 0), sense: int = 1) -> Similarities:
    matrix = Rotation.from_rotvec(turn).as_matrix() * [sense, 1, 1]
    return Similarities(np.array([scale]), matrix[None], np.array([[0.5, -1.0, 2.0]]))


def register_egg(
    truth: Similarities, prior: Similarities, handed: int = 1, seed: int = 0
) -> tuple[Similarities, float]:
    """Register an egg to its image; return the similarity and the residual."""
    points, corners = egg()
    others, other_corners = egg(seed=seed)
    found, left = register_shells(
        Shells.of([(points, corners)]), Shells.of([(truth(others[None])[0], other_corners)]), ONE, ONE, prior, handed
    )
    return found, float(left[0])


def degrees_off(found: Similarities, truth: Similarities) -> float:
    return float(np.degrees(Rotation.from_matrix(found.rotation[0] @ truth.rotation[0].T).magnitude()))


def test_similarity_of_a_shell_is_recovered() -> None:
    truth = similarity(1.2, (0.4, 0.2, -0.3))
    found, left = register_egg(truth, similarity())
    assert degrees_off(found, truth) < 1
    assert found.scale[0] == pytest.approx(1.2, rel=0.01)
    np.testing.assert_allclose(found.translation, truth.translation, atol=0.02)
    assert left < 0.02


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_scaled_shell_far_from_the_origin_is_registered(scale: float) -> None:
    points, corners = egg()
    truth = Similarities(
        np.array([scale]), Rotation.from_rotvec((0.4, 0.2, -0.3)).as_matrix()[None], np.array([[1.0, 2, 3]])
    )
    far = points + np.array([40.0, 0, 0])
    found, left = register_shells(
        Shells.of([(far, corners)]), Shells.of([(truth(far[None])[0], corners)]), ONE, ONE, truth, 1
    )
    assert degrees_off(found, truth) < 1
    assert left[0] < 0.02 * scale


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_residual_is_measured_on_the_source_in_both_directions(scale: float) -> None:
    points, corners = egg()
    half = corners[(points[corners][:, :, 0] < 0).all(axis=1)]
    still = Similarities(np.ones(1), np.eye(3)[None], np.zeros((1, 3)))
    grown = Similarities(np.array([scale]), np.eye(3)[None], np.zeros((1, 3)))
    for one, other in ((corners, half), (half, corners)):
        plain = register_shells(Shells.of([(points, one)]), Shells.of([(points, other)]), ONE, ONE, still, 1)[1]
        large = register_shells(Shells.of([(points, one)]), Shells.of([(scale * points, other)]), ONE, ONE, grown, 1)[1]
        np.testing.assert_allclose(large, scale * plain, rtol=1e-6)


def test_strongly_rotated_shell_is_registered_by_its_axes() -> None:
    # The rotation is too large for closest points alone.
    truth = similarity(1.0, (0.0, 0.0, 1.3))
    found, _ = register_egg(truth, similarity())
    assert degrees_off(found, truth) < 3


def test_ambiguous_axes_keep_the_rotation_of_the_body() -> None:
    # A ball has no preferred rotation, so the body's rotation decides.
    ball, other = (
        Shells.of([(where, ConvexHull(where).simplices)]) for where in (directions(n, n) for n in (200, 230))
    )
    prior = Similarities(np.ones(1), Rotation.from_rotvec([1.0, 0.5, 0.2]).as_matrix()[None], np.zeros((1, 3)))
    found, _ = register_shells(ball, other, ONE, ONE, prior, 1)
    assert degrees_off(found, prior) < 15


def test_scale_is_limited_relative_to_the_prior() -> None:
    for truth, limit in ((3.0, 1.35), (1 / 3, 1 / 1.35)):
        found, _ = register_egg(similarity(truth), similarity())
        assert found.scale[0] == pytest.approx(limit, rel=0.01)
    assert register_egg(similarity(3.0), similarity(2.9))[0].scale[0] == pytest.approx(3, rel=0.02)


@pytest.mark.parametrize("handed", [1, -1])
def test_shells_are_mirrored_only_if_the_body_is(handed: int) -> None:
    truth = similarity(1.0, (0.3, 0.1, 0.2), handed)
    found, left = register_egg(truth, similarity(sense=handed), handed)
    assert np.linalg.det(found.rotation[0]) == pytest.approx(handed)
    assert left < 0.03
    wrong, more = register_egg(truth, similarity(sense=-handed), -handed)
    assert np.linalg.det(wrong.rotation[0]) == pytest.approx(-handed)
    assert more > 3 * left


def test_half_a_shell_leaves_a_residual_in_both_directions() -> None:
    points, corners = egg()
    half = corners[(points[corners][:, :, 0] < 0).all(axis=1)]
    whole, part = Shells.of([(points, corners)]), Shells.of([(points, half)])
    still = Similarities(np.ones(1), np.eye(3)[None], np.zeros((1, 3)))
    left = [register_shells(*pair, ONE, ONE, still, 1)[1][0] for pair in ((whole, part), (part, whole))]
    assert min(left) > 0.1
    assert max(left) < 1.5 * min(left)


def test_nearest_points_are_searched_per_shell() -> None:
    points, corners = egg()
    both = Shells.of([(points, corners), (points + np.array([10, 0, 0]), corners)])
    distance, near = both.nearest(np.zeros((2, 1, 3)), np.array([0, 1]))
    assert distance[0, 0] < 2
    assert distance[1, 0] > 8
    assert near[1, 0, 0] > 8
    far = Shells.of([(points, corners), (points + np.array([900, 0, 0]), corners)])
    assert far.nearest(np.array([[[900.0, 0, 0]]]), np.array([0]))[0][0, 0] > 800


def test_sample_points_are_spread_over_the_whole_shell() -> None:
    points, corners = egg()
    shells = Shells.of([(points, corners)])
    assert shells.sparse.shape[1] >= 20
    gap = np.linalg.norm(points[:, None] - shells.sparse[0], axis=2).min(axis=1).max()
    assert gap < 0.6
    assert shells.dense.shape[1] > 4 * shells.sparse.shape[1]
    np.testing.assert_allclose(
        shells.size, np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()), rtol=0.15
    )


@pytest.mark.parametrize("handed", [1, -1])
def test_axes_take_the_nearest_signs_of_the_right_handedness(handed: int) -> None:
    axes = Rotation.random(40, random_state=1).as_matrix() * [handed, 1, 1]
    truth = Rotation.random(40, random_state=2).as_matrix() * [handed, 1, 1]
    senses = np.random.default_rng(0).choice([-1.0, 1.0], (40, 3, 1))
    theirs = senses * (axes @ truth.transpose(0, 2, 1))
    off = Rotation.from_rotvec(0.4 * directions(40, 1)).as_matrix()
    np.testing.assert_allclose(_along_axes(off @ truth, axes, theirs, handed), truth, atol=1e-9)
    # An initial rotation of the wrong handedness is corrected.
    np.testing.assert_allclose(np.linalg.det(_along_axes(-truth, axes, theirs, handed)), handed)


def test_least_certain_axis_is_flipped_to_avoid_a_mirror() -> None:
    turn = Rotation.from_rotvec(np.radians(100) * np.array([1, 1, 0.3]) / np.linalg.norm([1, 1, 0.3])).as_matrix()
    frame = np.eye(3)[None]
    found = _along_axes(turn[None], frame, frame, 1.0)[0]
    proper = [np.diag(signs) for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    nearest = max(proper, key=lambda axes: np.trace(turn.T @ axes))
    np.testing.assert_allclose(found, nearest, atol=1e-12)


def test_residual_is_that_of_the_returned_similarity() -> None:
    target = Shells.of([egg(), egg((0.5, 0.45, 0.9), 1)])
    source = Shells.of([egg(seed=2), egg((0.2, 0.8, 0.7), 3)])
    ours, theirs = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    starts = Rotation.random(2, random_state=5).as_matrix()
    with retune(SHELL_ICP, rounds=1):
        found, left = register_shells(
            target, source, ours, theirs, Similarities(np.ones(2), starts, np.zeros((2, 3))), 1
        )
    distances = _partners(target, source, ours, theirs, found)[2]
    np.testing.assert_allclose(left, np.sqrt((distances**2).mean(axis=1)))
