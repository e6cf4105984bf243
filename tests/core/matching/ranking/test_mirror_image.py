# SPDX-License-Identifier: GPL-3.0-or-later
"""A left bone beside a right one is recognised, and its landmarks are placed by a mirrored map."""

from __future__ import annotations

import numpy as np
import pytest
from specimens import WALL, grow, hollow

import zoomout_core as zo
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral.sampling import farthest_points

pytestmark = pytest.mark.usefixtures("remember_matches")
FAST = {"k_final": 60}
MIRROR = np.array([-1.0, 1, 1])


def test_mirrored_candidate_places_landmarks_on_a_mirror_image() -> None:
    source, other = hollow(500, 0), hollow(450, 1)
    target = Surface(MIRROR * grow(other.vertices), other.triangles[:, ::-1])
    result = zo.match(source, target, **FAST)
    number = zo.mirror_candidate(result)
    assert number is not None
    points = source.vertices[farthest_points(source.vertices[:500], 20)]
    assert (zo.transfer_landmarks(result, points).confidence == 0).all()
    mirrored = result.use(number)
    assert zo.mirror_candidate(mirrored) is None
    found = zo.transfer_landmarks(mirrored, points)
    assert np.median(np.linalg.norm(found.points - MIRROR * grow(points), axis=1)) < WALL
    assert found.confidence.max() > 0.5
