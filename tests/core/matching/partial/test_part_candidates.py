"""Places of a part on a whole, ranked: the right one comes first, and each place once."""

from __future__ import annotations

import numpy as np
import pytest
from pieces import PartAndWhole

from zoomout_core.matching.partial.part_candidates import (
    PART_CANDIDATES,
    PartCandidate,
    _differing,
    _sifted,
    images_apart,
    landmark_sets,
    part_candidates_steps,
)
from zoomout_core.runtime.stepping import drain
from zoomout_core.tuning import retuned


@pytest.fixture(scope="module")
def found(lower: PartAndWhole) -> list[PartCandidate]:
    with retuned(PART_CANDIDATES, regions=2, registered=8, compared=3):
        return drain(part_candidates_steps(lower.part, lower.whole))


def test_the_right_place_comes_first(lower: PartAndWhole, found: list[PartCandidate]) -> None:
    assert np.median(lower.errors(found[0].registered.closest.vertex)) < 0.05
    fits = [candidate.scores["fit"] for candidate in found]
    assert fits == sorted(fits)


def test_what_has_come_to_lie_on_the_same_places_is_bent_further_once(lower: PartAndWhole) -> None:
    true = lower.true_places()
    shaken = np.where(np.random.default_rng(0).random(len(true)) < 0.2, np.roll(true, 1), true)
    assert images_apart(true, shaken, lower.whole) > PART_CANDIDATES.same_map
    bent = [_sifted(0.0, places, lower.part, lower.whole).places for places in (true, shaken)]
    assert images_apart(*bent, lower.whole) < PART_CANDIDATES.same_map
    assert _differing(bent, 2, lower.whole) == [0]
    assert _differing([true, shaken], 2, lower.whole) == [0, 1]
    assert _differing([true, shaken], 1, lower.whole) == [0]


def test_the_best_of_those_that_are_bent_roughly_are_bent_further(lower: PartAndWhole) -> None:
    with retuned(PART_CANDIDATES, regions=1, registered=4, compared=1):
        (alone,) = drain(part_candidates_steps(lower.part, lower.whole))
    roughly = _sifted(0.0, alone.places, lower.part, lower.whole).registered
    assert np.mean(roughly.residual) > np.mean(alone.registered.residual)


def test_the_score_is_of_normals_strain_and_what_is_not_beyond_a_cut(
    lower: PartAndWhole, found: list[PartCandidate]
) -> None:
    for candidate in found:
        scores = candidate.scores
        expected = np.log(scores["normals"] + 0.01) + PART_CANDIDATES.strain * np.log(scores["strain"] + 0.02)
        assert scores["beyond"] == pytest.approx(0, abs=1e-12)
        assert scores["extent"] == pytest.approx(lower.part.shape.basis.areas.sum())
        assert scores["fit"] == pytest.approx(expected)


def test_regions_are_searched_one_by_one(lower: PartAndWhole) -> None:
    spread, *regions = landmark_sets(lower.part)
    assert len(spread) == PART_CANDIDATES.landmarks
    assert [len(each) for each in regions] == [PART_CANDIDATES.landmarks_in_region] * PART_CANDIDATES.regions
    width = [np.mean(lower.part.between[np.ix_(each, each)]) for each in (spread, *regions)]
    assert max(width[1:]) < width[0]
