# SPDX-License-Identifier: GPL-3.0-or-later
"""Blinks close the lids of higher eyes further, and those that stay open are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from face_masks import make_face
from transfer_meshes import nearest_map

import zoomout_core as zo
from zoomout_core.transfer.keys import closed_lids

FACE = make_face()
PLACES, VALUES = FACE.surface.vertices, np.array(FACE.keys.values)
OPENING = -VALUES[:, :2].sum(axis=1)
LIDS = [np.linalg.norm(VALUES[:, key], axis=1) > 0.11 for key in (0, 1)]
NOTE = "Eyelids close less than on the source: {}."


def blink(
    higher: tuple[float, float], closed: float | None = None, keys: zo.Attribute = FACE.keys, scale: float = 1
) -> zo.Attribute:
    """The keys on a face whose left and right upper lids are higher by shares of their motion."""
    rise = sum(-share * VALUES[:, key] for key, share in enumerate(higher))
    target = FACE.surface.with_vertices(scale * (PLACES + rise))
    with pytest.MonkeyPatch.context() as patch:
        if closed is not None:
            patch.setattr(closed_lids, "CLOSED", closed)
        return zo.transfer(keys, nearest_map(PLACES, FACE.surface), FACE.surface, target)


def gap(keys: zo.Attribute, higher: float, key: int = 0) -> float:
    """How far the middle of a lid stays above its place on the source."""
    missing = np.asarray(keys.values)[LIDS[key], key] - (1 + higher) * VALUES[LIDS[key], key]
    return float(missing[:, 1].mean())


def test_blinks_close_higher_lids_by_a_share_of_the_gap() -> None:
    alone = gap(blink((0.4, 0.4), closed=0), 0.4)
    assert alone > 0.03
    assert gap(blink((0.4, 0.4)), 0.4) == pytest.approx((1 - closed_lids.CLOSED) * alone, rel=0.05)
    assert abs(gap(blink((0.4, 0.4), closed=1), 0.4)) < 0.02 * alone


def test_each_eye_is_closed_by_its_own_gap() -> None:
    found, before = np.asarray(blink((0.4, 0)).values), np.asarray(blink((0.4, 0), closed=0).values)
    assert np.abs(found[:, 0] - before[:, 0]).max() > 0.01
    np.testing.assert_array_equal(found[:, 2:], before[:, 2:])
    np.testing.assert_allclose(found[:, 1], before[:, 1], atol=2e-3)


def test_the_lid_that_stays_still_is_not_moved() -> None:
    found = np.asarray(blink((0.4, 0.4)).values)
    assert not found[~VALUES[:, 0].any(axis=1), 0].any()


def test_lids_that_close_stay_as_they_are() -> None:
    for higher in (0.0, -0.3):  # lower eyes, whose lids cross already
        found, before = blink((higher, higher)), blink((higher, higher), closed=0)
        np.testing.assert_allclose(found.values, before.values, atol=1e-5)
        assert found.notes == ()


@pytest.mark.parametrize("scale", [0.001, 1000])
def test_results_do_not_depend_on_the_unit_of_the_target(scale: float) -> None:
    one, other = blink((0.4, 0.4)), blink((0.4, 0.4), scale=scale)
    np.testing.assert_allclose(one.values, np.asarray(other.values) / scale, atol=1e-4)
    assert one.notes == other.notes
    assert blink((0, 0), scale=scale).notes == ()


@pytest.mark.parametrize(
    ("higher", "names"),
    [((0.4, 0.4), "eyeBlinkLeft, eyeBlinkRight"), ((0.4, 0), "eyeBlinkLeft"), ((0, 0.4), "eyeBlinkRight")],
)
def test_keys_that_leave_lids_open_are_named(higher: tuple[float, float], names: str) -> None:
    assert blink(higher).notes == (NOTE.format(names),)
    assert blink(higher, closed=1).notes == ()


def test_keys_of_unknown_names_are_not_changed() -> None:
    unknown = replace(FACE.keys, labels=("a", "b", "c", "d"))
    found = blink((0.4, 0.4), keys=unknown)
    np.testing.assert_array_equal(found.values, blink((0.4, 0.4), closed=0, keys=unknown).values)
    assert found.notes == ()


def test_the_lid_that_moves_less_stays_as_it_is() -> None:
    lower = np.flatnonzero(FACE.opens[1] * (np.abs(PLACES[:, 1] - PLACES[FACE.corners[2], 1]) < 0.001) > 0.7)
    lower = lower[~VALUES[lower, 0].any(axis=1)]
    values = VALUES.copy()
    values[lower, 0, 1] += 0.01
    keys = replace(FACE.keys, values=values)
    change = np.asarray(blink((0.4, 0), keys=keys).values) - np.asarray(blink((0.4, 0), closed=0, keys=keys).values)
    upper = np.abs(change[LIDS[0], 0, 1]).mean()
    assert upper > 0.005
    assert np.abs(change[lower, 0, 1]).max() < 0.02 * upper


def test_lashes_follow_a_lid_that_is_closed_further_and_still_parts_do_not() -> None:
    at = np.flatnonzero(LIDS[0])[[0, 1, 0]]
    lash = PLACES[at] + [[0, 0, 0.05], [0, 0, 0.05], [0, 0, 0.1]]
    parts = len(PLACES) + np.arange(6).reshape(2, 3)  # the second one is in front of the lash
    faces = np.concatenate([FACE.surface.triangles, parts])
    places = np.concatenate([PLACES, lash, lash + np.array([0, 0, 0.1])])
    values = np.concatenate([VALUES, VALUES[at], 0 * VALUES[at]])
    rise = np.concatenate([OPENING, OPENING[at], 0 * OPENING[at]])
    source, target = zo.Surface(places, faces), zo.Surface(places + 0.4 * rise, faces)

    def transferred() -> np.ndarray:
        keys = replace(FACE.keys, values=values)
        return np.asarray(zo.transfer(keys, nearest_map(places, source), source, target).values)[:, 0, 1]

    found = transferred()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(closed_lids, "CLOSED", 0.0)
        change = found - transferred()
    assert change[at].max() < -0.01
    np.testing.assert_allclose(change[parts[0]], change[at], rtol=0.2)
    assert not change[parts[1]].any()
