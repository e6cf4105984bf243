# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranked placements of a part on a whole: the right one is first, and each occurs once."""

from __future__ import annotations

import numpy as np
import pytest
from pieces import PartAndWhole

from zoomout_core.matching.partial.part_candidates import (
    PART_CANDIDATES,
    PartCandidate,
    _differing,
    _Found,
    _register,
    images_apart,
    landmark_sets,
    part_candidates,
)
from zoomout_core.tuning import retune


@pytest.fixture(scope="module")
def found(lower: PartAndWhole) -> list[PartCandidate]:
    with retune(PART_CANDIDATES, regions=2, registered=8, compared=3):
        return part_candidates([lower.everywhere])


def test_right_place_ranks_first(lower: PartAndWhole, found: list[PartCandidate]) -> None:
    assert np.median(lower.errors(found[0].registered.closest.vertex)) < 0.05
    fits = [candidate.scores["fit"] for candidate in found]
    assert fits == sorted(fits)


def test_candidates_with_equal_images_are_registered_once(lower: PartAndWhole) -> None:
    true, region = lower.true_places(), lower.everywhere
    shaken = np.where(np.random.default_rng(0).random(len(true)) < 0.2, np.roll(true, 1), true)
    found = [_Found(0.0, region, places) for places in (true, shaken)]
    assert images_apart(*found) > PART_CANDIDATES.same_map
    bent = [_register(each) for each in found]
    assert images_apart(*bent) < PART_CANDIDATES.same_map
    assert _differing(bent, 2) == bent[:1]
    assert _differing(found, 2) == found
    assert _differing(found, 1) == found[:1]


def test_best_rough_candidates_are_registered_finely(lower: PartAndWhole) -> None:
    with retune(PART_CANDIDATES, regions=1, registered=4, compared=1):
        (alone,) = part_candidates([lower.everywhere])
    roughly = _register(_Found(0.0, alone.region, alone.places)).registered
    assert np.mean(roughly.residual) > np.mean(alone.registered.residual)


def test_fit_combines_normals_strain_and_area_within_cuts(lower: PartAndWhole, found: list[PartCandidate]) -> None:
    for candidate in found:
        scores = candidate.scores
        expected = np.log(scores["normals"] + 0.01) + PART_CANDIDATES.strain * np.log(scores["strain"] + 0.02)
        assert scores["beyond"] == pytest.approx(0, abs=1e-12)
        assert scores["extent"] == pytest.approx(lower.part.shape.basis.areas.sum())
        assert scores["fit"] == pytest.approx(expected)


def test_landmark_sets_cover_the_part_and_single_regions(lower: PartAndWhole) -> None:
    spread, *regions = landmark_sets(lower.part, PART_CANDIDATES.regions)
    assert len(spread) == PART_CANDIDATES.landmarks
    assert [len(each) for each in regions] == [PART_CANDIDATES.landmarks_in_region] * PART_CANDIDATES.regions
    width = [np.mean(lower.part.between[np.ix_(each, each)]) for each in (spread, *regions)]
    assert max(width[1:]) < width[0]
