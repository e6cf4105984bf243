# SPDX-License-Identifier: GPL-3.0-or-later
"""When partial matching is tried, and whether the whole or the partial map is chosen."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from creatures import creature
from reports import reports_of

import zoomout_core as zo
from zoomout_core.matching import retry as retry_module
from zoomout_core.matching.attempt import Attempt
from zoomout_core.matching.constraints import Constraints
from zoomout_core.matching.hypotheses import collect
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.partial.part_match import PART_MATCH
from zoomout_core.matching.partial.region import REGION
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.report.notes import OTHER_UNITS
from zoomout_core.matching.retry import attempt_part, needs_retry, retry
from zoomout_core.runtime.progress import advance
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("few_candidates")

COUNT = 100
PLACES = np.random.default_rng(1).standard_normal((COUNT, 3))
THERE, ELSEWHERE = np.arange(COUNT), np.arange(COUNT)[::-1]
LARGE, SMALL = 1.0, 0.5


def candidate(certainty: float, sample_map: np.ndarray) -> Candidate:
    nothing = np.zeros((0, 0))
    return Candidate("", False, False, nothing, nothing, sample_map, None, None, certainty, {"fit": 0.0, "extent": 1.0})


@dataclass(frozen=True)
class Evidence:
    """Evidence whose `upright` a part must not use, as a limb may point anywhere."""

    upright: bool = True

    def disagreement(self, _: object) -> None:
        assert not self.upright


@pytest.mark.parametrize(("certainty", "tried"), [(0.5, True), (0.9, True), (0.97, False)])
def test_parts_are_tried_unless_the_whole_map_is_nearly_certain(certainty: float, tried: bool) -> None:
    shape: Any = SimpleNamespace(proxy=SimpleNamespace(full=SimpleNamespace(scale=1.0)))
    pair: Any = SimpleNamespace(source_shape=shape, target_shape=shape)
    first = Attempt(pair, [candidate(certainty, THERE)], 1.0)
    assert needs_retry(first, MatchOptions()) == tried
    assert not needs_retry(first, MatchOptions(initial="proximity"))


def without_fragment(*_: object) -> None:
    advance(0.5)


def choose_map(
    monkeypatch: pytest.MonkeyPatch,
    by_whole: float,
    by_part: float,
    areas: tuple[float, float] = (LARGE, SMALL),
    image: np.ndarray = THERE,
    fragments: bool = False,
) -> tuple[str, float]:
    """The chosen map and its certainty, given both maps' certainties, the areas, and the images of the partial map.

    Two fragments are compared by the partial maps only.
    """

    def shape(area: float) -> Any:
        full = SimpleNamespace(to_surface=lambda points: points, scale=1.0)
        return SimpleNamespace(
            proxy=SimpleNamespace(full=full, vertices=PLACES),
            search=SimpleNamespace(samples=np.arange(COUNT)),
            min_distances=lambda here, there: np.linalg.norm(PLACES[here] - PLACES[there], axis=1),
            weights=np.full(COUNT, 1 / COUNT),
            basis=SimpleNamespace(areas=np.full(4, area / 4)),
        )

    def placed(_pair: object, _: object, as_wholes: Sequence[Candidate], upright: bool) -> list[Candidate]:
        assert [one.certainty for one in as_wholes] == ([by_whole, 0.0] if fragments else [])
        assert upright == fragments  # a single part may be a limb, which may point anywhere
        advance(0.5)
        return [candidate(by_part, image), candidate(0.0, ELSEWHERE)]

    each_at_unit_area, in_one_unit = (
        SimpleNamespace(source_shape=shape(of_source), target_shape=shape(of_target))
        for of_source, of_target in ((1.0, 1.0), areas)
    )
    pair: Any = each_at_unit_area
    whole = Attempt(pair, [candidate(by_whole, THERE), candidate(0.0, ELSEWHERE)], 0.9)
    monkeypatch.setattr(retry_module, "in_one_unit", lambda _: in_one_unit)
    monkeypatch.setattr(retry_module, "are_fragments", lambda _: fragments)
    monkeypatch.setattr(retry_module, "match_part", placed)
    monkeypatch.setattr(retry_module, "places_of", lambda candidate, _pair: candidate)
    monkeypatch.setattr(retry_module, "match_at_unknown_scale", without_fragment)
    found = attempt_part(whole, cast(Constraints, Evidence()))
    assert found.coverage == 0.9
    assert len(found.candidates) == 2
    return "part" if found.pair is in_one_unit else "whole", found.candidates[0].certainty


@pytest.mark.parametrize(
    ("by_whole", "by_part", "taken"),
    [(0.3, 0.5, "part"), (0.5, 0.3, "whole"), (0.4, 0.4, "whole"), (0.02, 0.1, "whole"), (0.02, 0.2, "part")],
)
def test_more_certain_map_wins_if_the_part_is_likely_at_all(
    monkeypatch: pytest.MonkeyPatch, by_whole: float, by_part: float, taken: str
) -> None:
    expected = by_part if taken == "part" else by_whole
    assert choose_map(monkeypatch, by_whole, by_part) == (taken, expected)


@pytest.mark.parametrize(
    ("by_whole", "by_part", "fragments", "taken"),
    [(0.1, 0.01, True, "part"), (0.8, 0.01, True, "part"), (0.95, 0.01, True, "whole"), (0.1, 0.01, False, "whole")],
)
def test_unlikely_map_of_fragments_wins_unless_that_of_the_wholes_is_certain(
    monkeypatch: pytest.MonkeyPatch, by_whole: float, by_part: float, fragments: bool, taken: str
) -> None:
    expected = by_part if taken == "part" else by_whole
    assert choose_map(monkeypatch, by_whole, by_part, fragments=fragments) == (taken, expected)


def test_certain_map_of_fragments_as_wholes_is_kept_if_that_of_a_part_fits_but_has_rivals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(retry_module, "certainty_of_fit", lambda _: 0.9)
    assert choose_map(monkeypatch, 0.8, 0.05, fragments=True) == ("part", 0.05)
    assert choose_map(monkeypatch, 0.95, 0.05, fragments=True) == ("whole", 0.95)


def test_unlikely_map_of_fragments_is_kept_if_none_in_another_unit_is_likely(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "without_fragment", lambda pair, *_: (pair, [candidate(0.1, ELSEWHERE)]))
    assert choose_map(monkeypatch, 0.1, 0.05, fragments=True) == ("part", 0.05)
    assert choose_map(monkeypatch, 0.1, 0.05) == ("whole", 0.1)


@pytest.mark.parametrize(("of_fit", "searched"), [(0.1, True), (0.2, False)])
def test_no_other_unit_is_tried_if_one_map_of_fragments_fits_in_spite_of_rivals(
    monkeypatch: pytest.MonkeyPatch, of_fit: float, searched: bool
) -> None:
    tried = []
    monkeypatch.setattr(sys.modules[__name__], "without_fragment", lambda *_: tried.append(True))
    monkeypatch.setattr(retry_module, "certainty_of_fit", lambda _: of_fit)
    assert choose_map(monkeypatch, 0.1, 0.05, fragments=True) == ("part", 0.05)
    assert bool(tried) == searched


@pytest.mark.parametrize(("by_part", "taken"), [(0.5, "part"), (0.4, "part"), (0.3, "whole")])
def test_whole_map_of_a_small_part_counts_for_less(monkeypatch: pytest.MonkeyPatch, by_part: float, taken: str) -> None:
    expected = by_part if taken == "part" else 0.7
    assert choose_map(monkeypatch, 0.7, by_part, (1.0, 0.5 * REGION.small)) == (taken, expected)
    assert choose_map(monkeypatch, 0.7, by_part, (1.0, 2 * REGION.small)) == ("whole", 0.7)
    assert choose_map(monkeypatch, 0.02, 0.1, (1.0, 0.5 * REGION.small)) == ("whole", 0.02)


@pytest.mark.parametrize("areas", [(1.0, 0.9), (0.9, 1.0)])
def test_whole_map_is_kept_at_equal_areas_if_both_maps_agree(
    monkeypatch: pytest.MonkeyPatch, areas: tuple[float, float]
) -> None:
    assert choose_map(monkeypatch, 0.3, 0.5, areas) == ("whole", 0.5)
    assert choose_map(monkeypatch, 0.3, 0.5, areas, ELSEWHERE) == ("part", 0.5)
    assert choose_map(monkeypatch, 0.6, 0.5, areas) == ("whole", 0.6)


@pytest.mark.parametrize("areas", [(LARGE, SMALL), (1.0, 0.9)])
def test_whole_map_of_fragments_counts_only_as_a_part_map(
    monkeypatch: pytest.MonkeyPatch, areas: tuple[float, float]
) -> None:
    assert choose_map(monkeypatch, 0.5, 0.3, areas, fragments=True) == ("part", 0.3)
    assert choose_map(monkeypatch, 0.95, 0.1, areas, fragments=True) == ("whole", 0.95)


@pytest.mark.parametrize("fragments", [False, True])
def test_fragments_are_not_rescaled_if_likely_in_their_unit(monkeypatch: pytest.MonkeyPatch, fragments: bool) -> None:
    tried: list[object] = []
    monkeypatch.setitem(globals(), "without_fragment", lambda *_: tried.append(True))
    choose_map(monkeypatch, 0.1, 0.3, fragments=fragments)
    assert bool(tried) != fragments


@pytest.mark.parametrize(
    ("by_whole", "by_part", "tried"), [(0.8, 0.3, True), (0.92, 0.3, False), (0.3, 0.7, True), (0.3, 0.8, False)]
)
def test_other_units_are_tried_only_if_no_map_is_convincing(
    monkeypatch: pytest.MonkeyPatch, by_whole: float, by_part: float, tried: bool
) -> None:
    known: list[float] = []
    monkeypatch.setitem(globals(), "without_fragment", lambda *given: known.append(given[2]))
    choose_map(monkeypatch, by_whole, by_part)
    assert known == ([max(by_whole, by_part)] if tried else [])


@pytest.mark.parametrize(
    ("uncertain", "options", "has_cuts", "tried", "factor"),
    [
        (1.0, {}, True, True, 1.0),
        (0.0, {}, True, False, 1.0),
        (0.0, {"initial": "landmarks", "landmarks": ([0, 5], [0, 5])}, True, True, 0.15),
        (0.0, {"initial": "landmarks", "landmarks": ([0, 5], [0, 5])}, False, False, 0.15),
        (1.0, {}, False, False, 1.0),
        (1.0, {"partial": "off"}, True, False, 1.0),
        (1.0, {"initial": "landmarks", "landmarks": ([0, 5], [0, 5])}, True, True, 1.0),
        (1.0, {"initial": "proximity"}, True, False, 1.0),
    ],
)
def test_parts_are_searched_if_uncertain_and_cuts_exist(
    monkeypatch: pytest.MonkeyPatch,
    uncertain: float,
    options: dict[str, Any],
    has_cuts: bool,
    tried: bool,
    factor: float,
) -> None:
    seen = []

    def watched(whole: Attempt, _known: object) -> Attempt:
        seen.append(whole)
        return replace(whole, candidates=[replace(whole.candidates[0], certainty=0.125)])

    monkeypatch.setattr(retry_module, "attempt_part", watched)
    monkeypatch.setattr(retry_module, "may_be_part", lambda _: has_cuts)
    monkeypatch.setattr(collect, "GENERATORS", ())
    source, target = creature(200).surface, creature(180, seed=1).surface
    target = target.with_vertices(factor * target.vertices)
    with retune(PART_MATCH, uncertain=uncertain):
        result = zo.match(source, target, k_final=20, samples=100, **options)
    assert len(seen) == tried
    assert (result.candidates[0].certainty == 0.125) == tried


@pytest.mark.parametrize(
    ("initial", "certainty", "cuts", "partial", "part_is_taken", "gone_on_with"),
    [
        ("auto", 0.3, 1, "auto", True, "part"),
        ("auto", 0.3, 1, "auto", False, "more"),
        ("auto", 0.3, 2, "auto", False, "first"),
        ("auto", 0.3, 1, "off", True, "more"),
        ("auto", 0.3, 2, "off", True, "more"),
        ("auto", 0.3, 0, "auto", True, "more"),
        ("auto", 0.7, 0, "auto", True, "first"),
        ("auto", 0.7, 1, "auto", False, "first"),
        ("landmarks", 0.3, 1, "auto", True, "part"),
        ("landmarks", 0.3, 1, "auto", False, "first"),
    ],
)
def test_more_is_tried_if_neither_part_nor_map_is_likely(
    monkeypatch: pytest.MonkeyPatch,
    initial: str,
    certainty: float,
    cuts: int,
    partial: str,
    part_is_taken: bool,
    gone_on_with: str,
) -> None:
    def saying(text: str | None) -> Any:
        def attempt(first: object, *_: object) -> Any:
            advance(0.0)
            advance(1.0)
            return first if text is None else text

        return attempt

    monkeypatch.setattr(retry_module, "attempt_part", saying("part" if part_is_taken else None))
    monkeypatch.setattr(retry_module, "_with_more_guesses", saying("more"))
    monkeypatch.setattr(retry_module, "may_be_part", lambda _: cuts > 0)
    monkeypatch.setattr(retry_module, "are_fragments", lambda _: cuts > 1)
    monkeypatch.setattr(retry_module, "units_differ", lambda _: False)
    first: Any = SimpleNamespace(pair=None, candidates=[SimpleNamespace(certainty=certainty, turns=1)])
    options: Any = SimpleNamespace(initial=initial, partial=partial, initial_map=None)
    known: Any = None
    found, reports = reports_of(lambda: retry(first, known, options))
    fractions = [report.fraction for report in reports]
    assert found is first if gone_on_with == "first" else found == gone_on_with
    # Progress does not restart after a rejected part.
    assert fractions == sorted(fractions)


@pytest.mark.parametrize(
    ("factor", "has_cuts", "partial", "told"),
    [
        (1000, True, "auto", True),
        (0.001, True, "auto", True),
        (1, True, "auto", False),
        (1000, False, "auto", False),
        (1000, True, "off", False),
    ],
)
def test_note_reports_shapes_in_different_units(
    monkeypatch: pytest.MonkeyPatch, factor: float, has_cuts: bool, partial: Any, told: bool
) -> None:
    in_one = []

    def none_found(*_: object) -> list[Candidate]:
        in_one.append(True)
        advance(0.5)
        return []

    monkeypatch.setattr(retry_module, "match_part", none_found)
    monkeypatch.setattr(retry_module, "match_at_unknown_scale", without_fragment)
    monkeypatch.setattr(retry_module, "may_be_part", lambda _: has_cuts)
    monkeypatch.setattr(collect, "GENERATORS", ())
    source, target = creature(200).surface, creature(180, seed=1).surface
    with retune(PART_MATCH, uncertain=1.0):
        other_unit = target.with_vertices(target.vertices * factor)
        result = zo.match(source, other_unit, k_final=20, samples=100, landmarks=([0, 5], [0, 5]), partial=partial)
    assert (OTHER_UNITS in result.notes) == told
    # They are matched in the given unit only if both may share it.
    assert len(in_one) == (factor == 1)
