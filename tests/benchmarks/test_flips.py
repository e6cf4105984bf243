# SPDX-License-Identifier: GPL-3.0-or-later
"""Flipped edges: the same vertices and surface, other triangles."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature

from benchmarks.paper.flips import with_flipped_edges
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unique_edges


def edges_of(surface: Surface) -> set[tuple[int, int]]:
    return {(min(edge), max(edge)) for edge in unique_edges(surface.triangles)[0].tolist()}


def test_a_share_of_the_edges_is_flipped() -> None:
    before = creature(600, 0).surface
    after = with_flipped_edges(before, 0.125, seed=0)
    ours, others = edges_of(before), edges_of(after)
    assert len(others) == len(ours)
    assert len(ours - others) == pytest.approx(0.125 * len(ours), rel=0.05)  # a few are flipped back by others
    assert after.area == pytest.approx(before.area, rel=0.1)
    # It stays closed and consistently wound: every side has one that runs against it.
    sides = {(t[i], t[i - 2]) for t in after.triangles.tolist() for i in range(3)}
    assert len(sides) == 3 * len(after.triangles)
    assert sides == {(b, a) for a, b in sides}
    assert edges_of(with_flipped_edges(before, 0.125, seed=1)) != others


def test_borders_folds_and_existing_edges_are_not_flipped() -> None:
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    flat = Surface(square, [[0, 1, 2], [0, 2, 3]])
    assert edges_of(with_flipped_edges(flat, 1, 0)) == {(0, 1), (1, 2), (2, 3), (0, 3), (1, 3)}
    # The other diagonal of a dart is outside of it.
    dart = Surface([[0, 0, 0], [1, -1, 0], [0.2, 0, 0], [1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    assert edges_of(with_flipped_edges(dart, 1, 0)) == edges_of(dart)
    tetrahedron = Surface(np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert edges_of(with_flipped_edges(tetrahedron, 1, 0)) == edges_of(tetrahedron)
