# SPDX-License-Identifier: GPL-3.0-or-later
"""Anchors weigh as much as eigenfunctions in an embedding, for any number of either."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.maps.anchors import Anchors, beside, coordinates


@pytest.mark.parametrize(("k", "m"), [(4, 1), (4, 9), (30, 2)])
def test_eigenfunctions_and_anchors_weigh_the_same(k: int, m: int) -> None:
    # One place differs by 1 in every eigenfunction, the other by `share` in every anchor.
    for share, nearest in ((1.05, 0), (0.95, 1)):
        rows = np.vstack([np.ones((1, k)), np.zeros((1, k))])
        anchors = share * np.vstack([np.zeros((1, m)), np.ones((1, m))])
        off = np.linalg.norm(beside(rows, anchors), axis=1)
        assert np.argmin(off) == nearest


def test_each_shape_is_embedded_with_its_own_anchors() -> None:
    random = np.random.default_rng(0)
    source_rows, C = random.standard_normal((6, 5)), np.linalg.qr(random.standard_normal((5, 5)))[0]
    anchors = Anchors(random.standard_normal((6, 2)), random.standard_normal((6, 2)))
    order = random.permutation(6)
    target_rows = (source_rows @ C.T)[order]
    same = Anchors(anchors.source, anchors.source[order])
    queries, embedded = coordinates(target_rows, source_rows, C, same)
    np.testing.assert_allclose(queries, embedded[order])
    queries, embedded = coordinates(target_rows, source_rows, C, None)
    np.testing.assert_allclose(queries, embedded[order])
    swapped = anchors.swap()
    assert swapped.source is anchors.target
    assert swapped.target is anchors.source


def test_anchors_join_and_scale_on_both_sides() -> None:
    one, other = Anchors(np.ones((3, 1)), 2 * np.ones((4, 1))), Anchors(np.zeros((3, 2)), np.zeros((4, 2)))
    both = one.scale(3.0).join(other)
    np.testing.assert_array_equal(both.source, [[3, 0, 0]] * 3)
    np.testing.assert_array_equal(both.target, [[6, 0, 0]] * 4)
    assert one.join(None) is one
    some = both.at(np.array([1]), np.array([2, 3]))
    assert (some.source.shape, some.target.shape) == ((1, 3), (2, 3))
