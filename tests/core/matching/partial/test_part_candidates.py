"""Places of a part on a whole, ranked: the right one comes first, and each place once."""

from __future__ import annotations

import numpy as np
import pytest
from pieces import PartAndWhole

from zoomout_core.matching.partial.part_candidates import (
    PART_CANDIDATES,
    PartCandidate,
    images_apart,
    part_candidates_steps,
)
from zoomout_core.runtime.stepping import drain
from zoomout_core.tuning import retuned


@pytest.fixture(scope="module")
def found(lower: PartAndWhole) -> list[PartCandidate]:
    with retuned(PART_CANDIDATES, searches=((7, 0.6), (5, 0.6)), registered=4):
        return drain(part_candidates_steps(lower.part, lower.whole))


def test_the_right_place_comes_first(lower: PartAndWhole, found: list[PartCandidate]) -> None:
    assert np.median(lower.errors(found[0].registered.closest.vertex)) < 0.05
    fits = [candidate.scores["fit"] for candidate in found]
    assert fits == sorted(fits)


def test_each_place_is_tried_once_and_the_promising_ones_only(lower: PartAndWhole, found: list[PartCandidate]) -> None:
    assert 1 < len(found) <= 4
    apart = [
        images_apart(one.match, other.match, lower.whole) for i, one in enumerate(found) for other in found[i + 1 :]
    ]
    assert min(apart) > PART_CANDIDATES.same_map
    with retuned(PART_CANDIDATES, searches=((7, 0.6),), registered=1):
        (alone,) = drain(part_candidates_steps(lower.part, lower.whole))
    assert alone.scores["promise"] <= min(candidate.scores["promise"] for candidate in found) + 0.5


def test_the_score_is_of_normals_and_strain(found: list[PartCandidate]) -> None:
    for candidate in found:
        scores = candidate.scores
        expected = np.log(scores["normals"] + 0.01) + PART_CANDIDATES.strain * np.log(scores["strain"] + 0.02)
        assert scores["fit"] == pytest.approx(expected)
