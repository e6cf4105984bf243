# SPDX-License-Identifier: GPL-3.0-or-later
"""Keys of clothes that follow the keys of a body, on balls."""

from __future__ import annotations

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.dressing.barriers import CONTACT, SidedSurface
from zoomout_core.transfer.dressing.body_keys import BODY_KEYS
from zoomout_core.tuning import retune

BODY = ball(1, count=2500, seed=3)


def shell(radius: float, count: int = 800) -> zo.Surface:
    """Half a ball around the body."""
    whole = ball(radius, count=count, seed=5)
    return zo.Surface(whole.vertices, whole.triangles[whole.vertices[whole.triangles][:, :, 2].min(axis=1) > -0.2])


def bump(height: float, width: float = 0.3) -> np.ndarray:
    """(n, 3) offsets of a bump on top of the body."""
    off = np.linalg.norm(BODY.vertices - [0, 0, 1], axis=1, keepdims=True)
    return np.asarray(height * np.exp(-((off / width) ** 2)) * BODY.vertices)


def test_cloth_on_the_skin_moves_like_the_skin() -> None:
    shirt = shell(1.02)
    bend = BODY.vertices[:, 2:] ** 2 * [0.2, 0.1, 0]
    (found,) = zo.follow_keys(BODY, np.stack([bump(0.2, 0.5), bend], axis=1), [shirt])
    assert found.shape == (len(shirt.vertices), 2, 3)
    worn = np.unique(shirt.triangles)
    place = shirt.vertices[worn] / 1.02
    np.testing.assert_allclose(found[worn, 1], place[:, 2:] ** 2 * [0.2, 0.1, 0], atol=0.02)
    off = np.linalg.norm(place - [0, 0, 1], axis=1, keepdims=True)
    np.testing.assert_allclose(found[worn, 0], 0.2 * np.exp(-((off / 0.5) ** 2)) * place, atol=0.02)


def test_keys_do_not_depend_on_the_unit() -> None:
    shirt, large = shell(1.02), shell(1.02).with_vertices(1000 * shell(1.02).vertices)
    (one,) = zo.follow_keys(BODY, bump(0.2)[:, None], [shirt])
    (other,) = zo.follow_keys(BODY.with_vertices(1000 * BODY.vertices), 1000 * bump(0.2)[:, None], [large])
    np.testing.assert_allclose(other / 1000, one, atol=1e-9)


def test_loose_cloth_follows_broad_motion_but_not_detail() -> None:
    skirt = shell(1.4)
    lift = np.tile([0, 0, 0.5], (len(BODY.vertices), 1))
    waves = 0.1 * np.sin(20 * BODY.vertices[:, :1]) * BODY.vertices
    offsets = np.stack([lift, waves], axis=1)
    (found,) = zo.follow_keys(BODY, offsets, [skirt])
    np.testing.assert_allclose(found[:, 0], np.broadcast_to([0, 0, 0.5], found[:, 0].shape), atol=1e-3)
    with retune(BODY_KEYS, spreading=0.0):
        (narrow,) = zo.follow_keys(BODY, offsets, [skirt])
    assert np.linalg.norm(found[:, 1], axis=1).mean() < 0.3 * np.linalg.norm(narrow[:, 1], axis=1).mean()


def test_influence_stays_narrow_near_the_skin() -> None:
    shirt, ridge = shell(1.04), bump(0.2, 0.1)
    heights = []
    for close in (BODY_KEYS.close, 0.0):
        with retune(BODY_KEYS, close=close):
            heights.append(float(zo.follow_keys(BODY, ridge[:, None], [shirt])[0][:, 0, 2].max()))
    assert heights[0] > 1.1 * heights[1]


def test_skin_does_not_penetrate_the_cloth() -> None:
    shirt, height, width = shell(1.1), 0.8, 0.3

    def clearance() -> float:
        """Smallest radial distance of the shirt from the bump."""
        (found,) = zo.follow_keys(BODY, bump(height, width)[:, None], [shirt])
        moved = (shirt.vertices + found[:, 0])[np.unique(shirt.triangles)]
        radius = np.linalg.norm(moved, axis=1)
        off = np.linalg.norm(moved / radius[:, None] - [0, 0, 1], axis=1)
        return float((radius - 1 - height * np.exp(-((off / width) ** 2))).min())

    with retune(CONTACT, rounds=0):
        assert clearance() < -0.03
    assert clearance() > -0.01


def test_cloth_over_unmoved_skin_stays_exactly_in_place() -> None:
    shirt = shell(1.02)
    (found,) = zo.follow_keys(BODY, np.stack([bump(0.2), 0 * bump(0)], axis=1), [shirt])
    assert not found[:, 1].any()
    far = shirt.vertices[:, 2] < 0
    assert not found[far, 0].any()
    # Cloth in the skin is not pushed out of it by a key.
    (inside,) = zo.follow_keys(BODY, bump(0.2)[:, None], [shell(0.995)])
    assert not inside[shell(0.995).vertices[:, 2] < 0].any()


def test_lines_and_loose_vertices_follow() -> None:
    strand = zo.Lines([[0, 0, 1.0], [0, 0, 1.02], [0, 0.02, 1.0]], [[0, 1]])
    (found,) = zo.follow_keys(BODY, bump(0.2)[:, None], [strand])
    np.testing.assert_allclose(found[:, 0], np.broadcast_to([0, 0, 0.2], (3, 3)), atol=0.02)


@pytest.mark.parametrize("offsets", [np.zeros((3, 1, 3)), np.zeros((2500, 3)), np.full((2500, 1, 3), np.nan)])
def test_invalid_offsets_are_refused(offsets: np.ndarray) -> None:
    with pytest.raises(ValueError, match="give finite ones"):
        zo.follow_keys(BODY, offsets, [BODY])


def test_rest_distance_is_measured_once_for_all_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    shirt, measured = shell(1.02), list[bool]()
    sides = SidedSurface.sides

    def counted(self: SidedSurface, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        measured.append(np.allclose(self.vertices, BODY.vertices / np.sqrt(BODY.area)))
        return sides(self, points)

    monkeypatch.setattr(SidedSurface, "sides", counted)
    zo.follow_keys(BODY, np.stack([bump(0.1), bump(0.2), bump(0.1, 0.5)], axis=1), [shirt])
    assert measured.count(True) == 1
    assert measured.count(False) >= 3


def test_masked_patches_move_rigidly() -> None:
    shirt, offsets = shell(1.02), bump(0.2, 0.5)[:, None]
    mask = np.asarray(np.linalg.norm(shirt.vertices - [0.2, 0, 1], axis=1) < 0.3, float)
    chosen = np.flatnonzero(mask)

    def bent(keep: list[np.ndarray] | None) -> float:
        """Greatest distance of the patch from a rigid motion of it."""
        moved = (shirt.vertices + zo.follow_keys(BODY, offsets, [shirt], keep=keep)[0][:, 0])[chosen]
        rest = shirt.vertices[chosen]
        return float(np.linalg.norm(procrustes(rest, moved, scales=(1, 1))(rest) - moved, axis=1).max())

    assert bent(None) > 0.02
    assert bent([mask]) < 1e-5
