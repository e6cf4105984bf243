# SPDX-License-Identifier: GPL-3.0-or-later
"""A part that leaves a gap on the whole where it has no cut is in a wrong place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pieces import PartAndWhole

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial import part_match
from zoomout_core.matching.partial.gaps import GAPS, gap_area
from zoomout_core.matching.partial.part_candidates import PartCandidate
from zoomout_core.matching.partial.part_match import PART_MATCH, match_part
from zoomout_core.matching.partial.part_registration import PART_REGISTRATION, register_part
from zoomout_core.matching.ranking.certainty import PART_CERTAINTY, certainty_of_fit


def true_cover(pair: PartAndWhole) -> tuple[Booleans, Floats]:
    """(n,) which vertices of the whole are on the part, and (n,) the distance of the nearest place to its cuts."""
    apart = pair.made_whole.directions @ pair.made_part.directions.T
    return apart.max(axis=1) > 0.99, pair.part.cut_distance_of_vertices[np.argmax(apart, axis=1)]


def tip(pair: PartAndWhole, size: float) -> Booleans:
    """(n,) the vertices of the whole around the covered one that is farthest from the cuts."""
    covered, cut_distance = true_cover(pair)
    points = pair.whole.shape.mesh.vertices
    far = np.argmax(np.where(covered, cut_distance, 0))
    return np.asarray(np.linalg.norm(points - points[far], axis=1) < size)


def gaps_without(pair: PartAndWhole, missed: Booleans) -> float:
    covered, cut_distance = true_cover(pair)
    return gap_area(covered & ~missed, cut_distance, pair.whole, PART_MATCH.near_cut)


def test_area_beyond_the_cuts_of_a_part_is_not_gaps_without(lower: PartAndWhole) -> None:
    nothing = np.zeros(len(lower.whole.shape.mesh.vertices), dtype=bool)
    assert gaps_without(lower, nothing) < 0.005
    assert gaps_without(lower, ~nothing) == 0
    everything = gap_area(~nothing, true_cover(lower)[1], lower.whole, PART_MATCH.near_cut)
    assert everything == 0


@pytest.mark.parametrize("size", [0.15, 0.25])
def test_area_that_a_part_leaves_out_without_a_cut_is_a_gap(lower: PartAndWhole, size: float) -> None:
    missed = tip(lower, size) & true_cover(lower)[0]
    area = float(lower.whole.shape.basis.areas[missed].sum())
    assert area > 0.01
    assert gaps_without(lower, missed) == pytest.approx(area, abs=0.005)


def test_finished_maps_know_their_gaps(lower: PartAndWhole, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second time, the tip of a limb has no partner."""
    fitted = register_part(lower.true_places(), lower.part, lower.whole, PART_REGISTRATION.fine)
    made = PartCandidate(lower.everywhere, lower.true_places(), fitted, {"fit": -4.0, "extent": 1.0})
    pair = Pair(lower.made_whole.surface, lower.made_part.surface, lower.whole.shape, lower.part.shape, 60, 20)
    on_part, missed = part_match._on_part, tip(lower, 0.3)
    monkeypatch.setattr(part_match, "part_candidates", lambda *_: [made])
    monkeypatch.setattr(part_match, "register_part", lambda *_: fitted)

    def without_tip(*args: Any) -> tuple[Any, Booleans]:
        closest, near = on_part(*args)
        return closest, near & ~missed

    (whole,) = match_part(pair)
    monkeypatch.setattr(part_match, "_on_part", without_tip)
    (lacking,) = match_part(pair)
    assert lacking.scores[GAPS] > whole.scores[GAPS] + 0.02
    assert lacking.certainty < whole.certainty


def test_certainty_falls_with_the_area_of_gaps_beyond_the_usual_one() -> None:
    scores = {"fit": -4.5, "extent": 0.6}
    usual = PART_CERTAINTY.usual_gaps
    known, little, much = (certainty_of_fit(scores | {GAPS: area}) for area in (0.0, usual, usual + 0.1))
    assert known == little == certainty_of_fit(scores)
    odds = [np.log(each / (1 - each)) for each in (little, much)]
    assert odds[0] - odds[1] == pytest.approx(0.1 * PART_CERTAINTY.gap_rate)


def test_a_leg_on_the_other_leg_of_a_body_is_not_certain() -> None:
    """The scores are those of a person cut in half, whose leg is on the other leg."""
    scores = {"fit": -4.251, "extent": 0.571, "curvature": 0.84}
    assert certainty_of_fit(scores) > 0.9
    assert certainty_of_fit(scores | {GAPS: 0.146}) < 0.8
