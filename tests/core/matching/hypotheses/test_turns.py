# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns of eigenfunctions that share an eigenvalue."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zoomout_core.matching.hypotheses.rotations import rotation_hypotheses


def shape_of(*eigenvalues: float) -> Any:
    return SimpleNamespace(basis=SimpleNamespace(eigenvalues=np.array(eigenvalues)))


ROD = shape_of(0, 1, 6, 6.05, 9, 12)
RING = shape_of(0, 4, 4.01, 9, 15, 20)
PLAIN = shape_of(0, 1, 2, 3, 4, 5)


def test_what_comes_before_a_pair_has_all_signs_and_the_pair_all_turns() -> None:
    for shape, before in ((RING, 0), (ROD, 1)):
        maps = np.array([guess.functional_map for guess in rotation_hypotheses(shape, shape)])
        size = 3 + before
        assert maps.shape[1:] == (size, size)
        np.testing.assert_allclose(maps @ maps.transpose(0, 2, 1), np.broadcast_to(np.eye(size), maps.shape), atol=1e-9)
        assert (maps[:, 0, 0] == 1).all()
        # They are a group: one after the other is one of them again.
        both = (maps[:, None] @ maps).reshape(-1, size, size)
        assert np.abs(both[:, None] - maps).max(axis=(2, 3)).min(axis=1).max() < 1e-9
        apart = np.abs(maps[:, None] - maps).max(axis=(2, 3))
        assert (apart + np.eye(len(maps)) > 0.1).all()
        assert len({guess.origin for guess in rotation_hypotheses(shape, shape)}) == len(maps) // 2**before


@pytest.mark.parametrize("other", [PLAIN, RING, shape_of(0, 1, 6, 6.05)])
def test_both_shapes_must_have_the_pair_and_enough_functions(other: Any) -> None:
    assert rotation_hypotheses(ROD, other) == []
    assert rotation_hypotheses(other, ROD) == []


def test_a_turn_is_called_by_its_angle_and_by_its_side() -> None:
    for guess in rotation_hypotheses(RING, RING):
        turn = guess.functional_map[1:, 1:]
        angle = np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) % 360
        assert f"by {angle:.0f} degrees" in guess.origin
        assert ("mirrored" in guess.origin) == (np.linalg.det(turn) < 0)
