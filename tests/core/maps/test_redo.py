# SPDX-License-Identifier: GPL-3.0-or-later
"""A map is replaced in a masked part of the target and kept elsewhere."""

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.maps.redo import TRANSITION_WIDTH, redo_shares, redone

BODY = creature(1500, seed=1, bend=0.3).surface
X = BODY.vertices[:, 0]


def test_shares_are_zero_outside_the_mask_and_one_deep_inside():
    right = np.median(X) < X
    mask = right.astype(float)
    shares = redo_shares(mask, BODY)
    assert (shares[mask == 0] == 0).all()
    assert shares.max() == 1
    ends = BODY.edges
    across = np.abs(shares[ends[:, 0]] - shares[ends[:, 1]])
    long = np.linalg.norm(np.ptp(BODY.vertices[ends], axis=1), axis=1)
    # A smoothstep is at most 1.5 times as steep as a linear ramp.
    assert (across <= 1.5 * long / (TRANSITION_WIDTH * np.sqrt(BODY.area)) + 1e-9).all()


def test_mask_narrower_than_transition_still_reaches_one():
    length = np.linalg.norm(np.ptp(BODY.vertices[BODY.edges], axis=1), axis=1)
    longest = np.zeros(len(X))
    np.maximum.at(longest, BODY.edges.ravel(), np.repeat(length, 2))
    seed = longest.argmin()
    ring = np.zeros(len(X))
    ring[BODY.edges[(BODY.edges == seed).any(axis=1)]] = 1
    reach = np.linalg.norm(BODY.vertices[ring > 0] - BODY.vertices[seed], axis=1).max()
    assert reach < 0.7 * TRANSITION_WIDTH * np.sqrt(BODY.area)
    assert redo_shares(ring, BODY).max() == 1


def test_uniform_and_soft_masks_are_kept_unchanged():
    both = zo.Surface.joined([BODY, BODY])
    mask = np.r_[np.zeros(len(X)), np.full(len(X), 0.5)]
    np.testing.assert_array_equal(redo_shares(mask, both), mask)
    np.testing.assert_array_equal(redo_shares(np.ones(len(X)), BODY), 1)


def test_shares_of_zero_and_one_give_old_and_new_images_exactly():
    before = zo.SurfaceMap.from_vertices(np.arange(len(X)), BODY)
    after = zo.SurfaceMap.from_vertices(np.full(len(X), 7), BODY)
    shares = np.linspace(0, 1, len(X))
    made = redone(before, after, shares, BODY)
    for at, kept in ((0, before), (-1, after)):
        assert made.triangle[at] == kept.triangle[at]
        np.testing.assert_array_equal(made.barycentric[at], kept.barycentric[at])
    assert 0 < np.linalg.norm(made.interpolate(BODY.vertices)[len(X) // 2] - BODY.vertices[7]) < np.ptp(X)


@pytest.mark.parametrize("share", [0.25, 0.75])
def test_partial_share_mixes_old_and_new_images(share):
    ends = BODY.edges[::7]
    of_target = np.zeros(len(X), int), np.zeros(len(X), int)
    of_target[0][: len(ends)], of_target[1][: len(ends)] = ends.T
    before, after = (zo.SurfaceMap.from_vertices(vertex, BODY) for vertex in of_target)
    made = redone(before, after, np.full(len(X), share), BODY).interpolate(BODY.vertices)[: len(ends)]
    wanted = (1 - share) * BODY.vertices[ends[:, 0]] + share * BODY.vertices[ends[:, 1]]  # on the edges
    np.testing.assert_allclose(made, wanted, atol=1e-9)
