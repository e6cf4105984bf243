# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles choose consistent candidates: they outvote a flip, or map through a third shape if no candidate is right."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from zoomout_core.collection.cycles import choose_agreeing
from zoomout_core.collection.pair_map import CandidateMaps, PairName
from zoomout_core.collection.shapes import ShapeSummary

SAMPLES = 30
PLACES = np.linspace(-1, 1, SAMPLES)
SAME, FLIPPED, SHIFTED = np.arange(SAMPLES), np.arange(SAMPLES)[::-1], np.roll(np.arange(SAMPLES), SAMPLES // 2)


def strip() -> ShapeSummary:
    """A strip of length two with mirror symmetry."""
    distances = np.abs(PLACES[:, None] - PLACES)
    points = np.column_stack([PLACES, 0 * PLACES, 0 * PLACES])
    return ShapeSummary("00", SAME, points, distances, np.zeros(1))


def candidates(*maps: np.ndarray, certainty: float = 0.9) -> CandidateMaps:
    """Candidates of a pair; the first has the given certainty, the others 0.05."""
    rest = [0.05] * (len(maps) - 1)
    backward = [np.argsort(each) for each in maps]
    return CandidateMaps(np.array(maps), np.array(backward), np.array([certainty, *rest]), np.zeros(len(maps), bool))


def collection(count: int) -> tuple[dict[PairName, CandidateMaps], dict[str, ShapeSummary]]:
    """All pairs of equal strips; the right map is each pair's first candidate."""
    names = [f"s{number}" for number in range(count)]
    maps = {PairName(*pair): candidates(SAME, FLIPPED) for pair in combinations(names, 2)}
    return maps, dict.fromkeys(names, strip())


def test_consistent_maps_are_unchanged() -> None:
    maps, shapes = collection(5)
    found = choose_agreeing(maps, shapes.__getitem__)
    assert found.changed == []
    assert found.before == found.after == dict.fromkeys(maps, 0.0)
    assert min(found.certainty.values()) > 0.99


def test_confident_flip_is_outvoted() -> None:
    maps, shapes = collection(5)
    wrong = PairName("s1", "s3")
    maps[wrong] = candidates(FLIPPED, SAME, certainty=0.99)
    found = choose_agreeing(maps, shapes.__getitem__)
    assert found.changed == [wrong]
    assert found.candidate[wrong] == 1
    assert found.before[wrong] > 0.5
    assert max(found.after.values()) == 0


def test_flip_of_a_whole_shape_is_corrected_only_if_uncertain() -> None:
    # Its cycles close, so only the certainty of its maps can reveal the flip.
    maps, shapes = collection(5)
    of_shape = [pair for pair in maps if "s2" in pair]
    for pair in of_shape:
        maps[pair] = candidates(FLIPPED, SAME, certainty=0.9)
    assert choose_agreeing(maps, shapes.__getitem__).changed == []
    # Three of four choices change together; changing a single pair would gain nothing.
    for pair in of_shape[:3]:
        flipped = candidates(FLIPPED, SAME, certainty=0.3)
        flipped.certainty[1] = 0.6
        maps[pair] = flipped
    maps[of_shape[3]] = candidates(SAME, FLIPPED, certainty=0.9)
    assert sorted(choose_agreeing(maps, shapes.__getitem__).changed) == sorted(of_shape[:3])


def test_pair_without_consistent_candidate_maps_through_a_third_shape() -> None:
    maps, shapes = collection(5)
    wrong = PairName("s0", "s4")
    maps[wrong] = candidates(SHIFTED, FLIPPED)
    found = choose_agreeing(maps, shapes.__getitem__)
    assert found.changed == [wrong]
    assert found.through[wrong] in ("s1", "s2", "s3")
    assert (found.maps[wrong].forward[found.candidate[wrong]] == SAME).all()
    assert found.after[wrong] == 0


def test_without_cycles_nothing_changes() -> None:
    maps, shapes = collection(3)
    del maps[PairName("s0", "s1")]
    found = choose_agreeing(maps, shapes.__getitem__)
    assert found.before == {}
    assert found.changed == []
    assert found.certainty == dict.fromkeys(maps, 0.9)


def test_inside_out_candidate_is_not_chosen_by_cycles_alone() -> None:
    maps, shapes = collection(3)
    pair = PairName("s0", "s1")
    maps[pair] = CandidateMaps(
        np.array([FLIPPED, SAME]),
        np.array([FLIPPED, SAME]),
        np.array([0.9, 0.9]),
        np.array([False, True]),
    )
    assert choose_agreeing(maps, shapes.__getitem__).candidate[pair] == 0


@pytest.mark.parametrize("share", [0.1, 0.2])
def test_random_flips_are_corrected(share: float) -> None:
    maps, shapes = collection(8)
    random = np.random.default_rng(1)
    wrong = [pair for pair in maps if random.random() < share]
    for pair in wrong:
        maps[pair] = candidates(FLIPPED, SAME, certainty=0.9)
    assert wrong
    assert sorted(choose_agreeing(maps, shapes.__getitem__).changed) == sorted(wrong)


def test_slightly_likelier_candidate_is_not_chosen() -> None:
    maps, shapes = collection(3)
    pair = PairName("s0", "s1")
    maps[pair] = candidates(SAME, SAME, certainty=0.4)
    maps[pair].certainty[1] = 0.5
    assert choose_agreeing(maps, shapes.__getitem__).changed == []


def test_cycles_can_choose_a_candidate_of_no_certainty() -> None:
    maps, shapes = collection(5)
    wrong = PairName("s1", "s3")
    maps[wrong] = candidates(FLIPPED, SAME, certainty=0.99)
    maps[wrong].certainty[1] = 1e-12
    found = choose_agreeing(maps, shapes.__getitem__)
    assert found.candidate[wrong] == 1
    assert found.through == {}
