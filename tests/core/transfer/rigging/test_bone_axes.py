# SPDX-License-Identifier: GPL-3.0-or-later
"""Axes of bones change with the pose, but not with the build."""

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from zoomout_core.transfer.rigging.bone_axes import keep_axes

# A limb along z: rings of points around its axis, and bones that meet at a third and two thirds of it.
HEIGHT = np.repeat(np.linspace(0, 3, 301), 8)
AROUND = np.tile(2 * np.pi * np.arange(8) / 8, 301)
POINTS = np.column_stack([0.2 * np.cos(AROUND), 0.2 * np.sin(AROUND), HEIGHT])


def _weights(softness=0.2):
    """(n, 3) weights of the bones, which change over twice the softness around joints."""
    above = [np.clip((HEIGHT - joint) / (2 * softness) + 0.5, 0, 1) for joint in (1.005, 2.005)]  # between rings
    return np.column_stack([1 - above[0], above[0] - above[1], above[1]])


def _bend(*degrees):
    """The limb with each bone rotated about the x axis through the middle of the limb's second joint."""
    turned = [Rotation.from_euler("x", each, degrees=True).apply(POINTS - [0, 0, 2]) for each in degrees]
    return np.einsum("nb,bnx->nx", _weights(), turned)


def _keeps(images, weights=None, trust=None):
    weights = csr_array(_weights() if weights is None else weights)
    return keep_axes(np.eye(3), POINTS, images, weights, np.ones(len(POINTS)) if trust is None else trust)


def test_wider_and_shorter_bones_keep_their_axes():
    assert _keeps(POINTS * [1.6, 1.3, 0.7])


def test_common_rotation_does_not_count():
    turn = Rotation.from_euler("xyz", [40, 20, 70], degrees=True).as_matrix()
    assert keep_axes(turn, POINTS, POINTS @ turn.T, csr_array(_weights()), np.ones(len(POINTS)))


@pytest.mark.parametrize(("degrees", "keeps"), [(9, True), (15, False)])
def test_bend_of_a_limb_changes_an_axis(degrees, keeps):
    assert _keeps(_bend(0, 0, degrees)) is keeps


@pytest.mark.parametrize(("degrees", "keeps"), [(6, True), (10, False)])
def test_bend_in_the_middle_counts_on_both_sides(degrees, keeps):
    assert _keeps(_bend(-degrees, -degrees, degrees)) is keeps


@pytest.mark.parametrize(("area", "keeps"), [(0.003, True), (0.02, False)])
def test_only_small_bones_may_change_their_axes(area, keeps):
    trust = np.ones(len(POINTS))
    trust[HEIGHT > 1.8] *= 2 * area
    assert _keeps(_bend(0, 0, 40), trust=trust) is keeps


def test_bones_without_common_vertices_have_no_axes():
    assert not _keeps(POINTS, _weights(1e-9))
