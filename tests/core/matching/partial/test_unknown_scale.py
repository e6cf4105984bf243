# SPDX-License-Identifier: GPL-3.0-or-later
"""The scale of a part in another unit is found, and it is matched as if both had one unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pieces import PartAndWhole

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.matching import retry
from zoomout_core.matching.attempt import ATTEMPTS, Attempt
from zoomout_core.matching.constraints import Constraints
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial import unknown_scale
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale
from zoomout_core.matching.partial.part_candidates import PART_CANDIDATES
from zoomout_core.matching.partial.part_match import PART_MATCH
from zoomout_core.matching.partial.unknown_scale import (
    UNKNOWN_SCALE,
    RoughPlace,
    match_at_unknown_scale,
    nearly_best,
    rough_places,
    stretch,
    times_as_large,
)
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.certainty import PART_CERTAINTY
from zoomout_core.matching.ranking.scores import no_disagreement
from zoomout_core.matching.report.notes import OTHER_UNITS, RESCALED
from zoomout_core.tuning import retune

FEWER_SEARCHES = {"landmarks": 7, "regions": 0, "registered": 4}


def pair_of(source: IncompleteShape, target: IncompleteShape) -> Pair:
    surfaces = (SimpleNamespace() for _ in range(2))
    return Pair(*surfaces, source.shape, target.shape, 60, 20)  # type: ignore[arg-type]


def true_scale(lower: PartAndWhole) -> float:
    """Scale of the part if the whole has unit area."""
    areas = [shape.shape.basis.areas.sum() for shape in (lower.part, lower.whole)]
    return float(np.sqrt(areas[0] / areas[1]))


def test_a_part_in_another_unit_is_matched_to_its_whole(lower: PartAndWhole) -> None:
    zo.forget_shapes()
    part, whole = lower.made_part.surface, lower.made_whole.surface
    with (
        retune(ATTEMPTS, same_share=1.0),
        retune(PART_MATCH, uncertain=1.0),
        retune(PART_CERTAINTY, misfit=2.0, another_map=2.0),
        retune(PART_CANDIDATES, **FEWER_SEARCHES),
        retune(UNKNOWN_SCALE, scales=(0.4, 0.7, 1.0)),
    ):
        result = zo.match(whole, part.with_vertices(40 * part.vertices), k_final=60, samples=400)
    assert result.candidates[0].part_match is not None
    errors = lower.errors(result.surface_map.vertex)
    assert np.median(errors) < 0.05
    times = times_as_large(result.pair)
    assert 40 * times == pytest.approx(1, rel=0.15)
    assert RESCALED.format(times=times) in result.notes
    assert OTHER_UNITS not in result.notes


@pytest.mark.slow
def test_either_shape_may_be_the_part(lower: PartAndWhole) -> None:
    with retune(PART_CANDIDATES, **FEWER_SEARCHES), retune(UNKNOWN_SCALE, likely=0.0, scales=(0.55, 0.9)):
        for shapes, is_target in (((lower.whole, lower.part), True), ((lower.part, lower.whole), False)):
            found = match_at_unknown_scale(pair_of(*shapes), lambda _: no_disagreement)
            assert found is not None
            pair, candidates = found
            part, whole = (pair.target_shape, pair.source_shape)[:: 1 if is_target else -1]
            assert whole.basis.areas.sum() == pytest.approx(1)
            assert np.sqrt(part.basis.areas.sum()) == pytest.approx(true_scale(lower), rel=0.1)
            assert candidates[0].certainty == max(candidate.certainty for candidate in candidates)


def test_shapes_without_a_long_border_are_not_searched(lower: PartAndWhole) -> None:
    assert match_at_unknown_scale(pair_of(lower.whole, lower.whole), lambda _: no_disagreement) is None


def test_scales_compete_only_after_each_has_its_place(monkeypatch: pytest.MonkeyPatch, lower: PartAndWhole) -> None:
    """Maps at the smallest scale promise the most, and yet the right one is found, and its scale is fitted."""
    true, sizes = lower.true_places(), []
    at_true = true_scale(lower)

    def rough(regions: Sequence[Any], _sets: object, max_count: int) -> list[Any]:
        (region,) = regions
        sizes.append(max_count)
        scale = float(np.sqrt(region.part.shape.basis.areas.sum()))
        off = abs(np.log(scale / at_true))
        places = true if off < 0.3 else np.roll(true, 40)
        extent = float(region.part.shape.basis.areas.sum())
        return [SimpleNamespace(region=region, places=places, scores={"fit": -5.0 + 4 * off, "extent": extent})]

    monkeypatch.setattr(unknown_scale, "rough_candidates", rough)
    part = at_scale(lower.part.shape, 1 / at_true)
    found = rough_places(part, lower.whole.shape, [0.2, 0.9 * at_true])[0]
    assert sizes == [UNKNOWN_SCALE.maps_per_scale] * 2
    assert found.scale == pytest.approx(at_true, rel=0.08)
    assert lower.whole.between[found.places, true].mean() < 0.1


def test_scale_is_estimated_from_distances_between_images(lower: PartAndWhole) -> None:
    true = lower.true_places()
    for scale in (0.8, 1.0, 1.3):
        part = IncompleteShape(at_scale(lower.part.shape, scale))
        placed: Any = SimpleNamespace(region=SimpleNamespace(part=part, whole=lower.whole), places=true)
        assert scale * stretch(placed) == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize(
    ("certain_at", "fragments", "known", "tried"),
    [
        (0.5, 1, 0.0, [0.5]),
        (None, 1, 0.0, [0.5, 0.1, 0.14, 0.19]),
        (0.14, 1, 0.4, [0.5, 0.1, 0.14, 0.19]),
        (None, 1, 0.6, [0.5]),
        (None, 2, 0.0, [0.5]),
    ],
)
def test_small_scales_are_tried_if_no_larger_one_is_likely(
    monkeypatch: pytest.MonkeyPatch,
    lower: PartAndWhole,
    certain_at: float | None,
    fragments: int,
    known: float,
    tried: list[float],
) -> None:
    seen: list[float] = []

    def placed(pair: Pair, _: object, given: Sequence[Integers] = ()) -> list[Any]:
        seen.append(float(np.sqrt(pair.target_shape.basis.areas.sum())))
        certain = certain_at is not None and seen[-1] == pytest.approx(certain_at)
        return [SimpleNamespace(certainty=0.9 if certain else 0.2 - 0.01 * len(seen))]

    monkeypatch.setattr(unknown_scale, "match_part", placed)
    monkeypatch.setattr(unknown_scale, "rough_places", lambda *_: [RoughPlace(0.2, 0.5, np.arange(4), -4.0)])
    source = lower.part if fragments == 2 else lower.whole
    found = match_at_unknown_scale(pair_of(source, lower.part), lambda _: no_disagreement, known)
    assert found is not None
    if fragments == 1:
        assert seen == pytest.approx(tried)
        taken = float(np.sqrt(found[0].target_shape.basis.areas.sum()))
        assert taken == pytest.approx(certain_at or 0.5)
    else:
        assert len(seen) == 1


@pytest.mark.parametrize(
    ("certainties", "scales", "expected"),
    [
        ((0.61, 0.6, 0.4), (0.65, 0.52, 0.9), [0.65, 0.52]),
        ((0.61, 0.5, 0.4), (0.65, 0.52, 0.9), [0.65]),
        ((0.93, 0.92, 0.2), (0.76, 0.775, 0.58), [0.76]),
    ],
)
def test_another_scale_that_is_nearly_as_certain_is_matched_too(
    certainties: tuple[float, ...], scales: tuple[float, ...], expected: list[float]
) -> None:
    places = [
        RoughPlace(certainty, scale, np.arange(4), -4.0) for certainty, scale in zip(certainties, scales, strict=True)
    ]
    assert [one.scale for one in nearly_best(places)] == expected


def test_poorly_fitting_fragments_are_not_rescaled(monkeypatch: pytest.MonkeyPatch, lower: PartAndWhole) -> None:
    seen: list[Pair] = []

    def placed(pair: Pair, _: object, given: Sequence[Integers] = ()) -> list[Any]:
        seen.append(pair)
        return [SimpleNamespace(certainty=0.9)]

    def roughly(_part: object, _whole: object, scales: list[float]) -> list[RoughPlace]:
        tried.append(min(scales))
        return [RoughPlace(0.12, 0.5, np.arange(4), -4.0)]

    tried: list[float] = []
    monkeypatch.setattr(unknown_scale, "rough_places", roughly)
    monkeypatch.setattr(unknown_scale, "match_part", placed)
    assert match_at_unknown_scale(pair_of(lower.part, lower.part), lambda _: no_disagreement) is None
    assert not seen
    assert match_at_unknown_scale(pair_of(lower.whole, lower.part), lambda _: no_disagreement) is not None
    assert min(tried[:-1]) > UNKNOWN_SCALE.of_fragments > tried[-1] == min(UNKNOWN_SCALE.scales)


def in_another_unit(part: IncompleteShape, times: float) -> ShapeAnalysis:
    """A part whose file has lengths that are larger by a factor."""
    proxy = part.shape.proxy
    return replace(part.shape, proxy=replace(proxy, full=replace(proxy.full, scale=times * proxy.full.scale)))


@pytest.mark.parametrize("times", [1.0, 0.7, 50.0])
def test_fragments_are_not_searched_for_again_in_the_units_of_their_files(
    monkeypatch: pytest.MonkeyPatch, lower: PartAndWhole, times: float
) -> None:
    tried: list[list[float]] = []

    def roughly(_part: object, _whole: object, scales: list[float]) -> list[RoughPlace]:
        tried.append(scales)
        return [RoughPlace(0.0, 0.5, np.arange(4), -4.0)]

    monkeypatch.setattr(unknown_scale, "rough_places", roughly)
    pair = replace(pair_of(lower.part, lower.part), target_shape=in_another_unit(lower.part, times))
    assert match_at_unknown_scale(pair, lambda _: no_disagreement) is None
    large = [scale for scale in UNKNOWN_SCALE.scales if scale >= UNKNOWN_SCALE.of_fragments]
    for scales, in_files in zip(tried, (1 / times, times), strict=True):
        near = [abs(np.log(scale / in_files)) < np.log(UNKNOWN_SCALE.one_unit) for scale in large]
        assert scales == [scale for scale, skipped in zip(large, near, strict=True) if not skipped]
        assert any(near) == (0.5 < in_files < 1.2)


@pytest.mark.parametrize(("scale", "taken"), [(0.9, False), (1.1, False), (0.7, True)])
def test_places_of_fragments_that_fit_in_the_units_of_their_files_are_ignored(
    monkeypatch: pytest.MonkeyPatch, lower: PartAndWhole, scale: float, taken: bool
) -> None:
    """The finer search in that unit has found no likely map."""
    candidate: Any = SimpleNamespace(certainty=0.9)
    monkeypatch.setattr(unknown_scale, "match_part", lambda *_: [candidate])
    monkeypatch.setattr(unknown_scale, "rough_places", lambda *_: [RoughPlace(0.9, scale, np.arange(4), -4.0)])
    found = match_at_unknown_scale(pair_of(lower.part, lower.part), lambda _: no_disagreement)
    assert (found is not None) == taken


def test_no_scale_to_search_at_gives_no_place(lower: PartAndWhole) -> None:
    with retune(UNKNOWN_SCALE, one_unit=100.0):
        assert match_at_unknown_scale(pair_of(lower.part, lower.part), lambda _: no_disagreement) is None


@pytest.mark.parametrize(
    ("times", "certainty", "taken", "noted"),
    [(30.0, 0.6, True, True), (30.0, 0.45, False, False), (1.1, 0.45, True, False), (1.1, 0.25, False, False)],
)
def test_other_unit_must_be_more_likely_than_the_same_one(
    monkeypatch: pytest.MonkeyPatch, times: float, certainty: float, taken: bool, noted: bool
) -> None:
    def shape(scale: float) -> Any:
        return SimpleNamespace(
            basis=SimpleNamespace(areas=np.full(4, 0.25 * scale)),
            proxy=SimpleNamespace(full=SimpleNamespace(scale=scale)),
        )

    given = SimpleNamespace(source_shape=shape(1.0), target_shape=shape(1.0))
    elsewhere = Pair(*(SimpleNamespace() for _ in range(2)), shape(times), shape(1.0), 60, 20)  # type: ignore[arg-type]
    monkeypatch.setattr(retry, "in_one_unit", lambda pair: pair)
    monkeypatch.setattr(retry, "match_part", lambda *_: [SimpleNamespace(certainty=0.3)])
    rescaled = elsewhere, [SimpleNamespace(certainty=certainty)]
    monkeypatch.setattr(retry, "match_at_unknown_scale", lambda *_: rescaled)
    monkeypatch.setattr(retry, "agree", lambda *_: False)
    monkeypatch.setattr(retry, "are_fragments", lambda _: False)
    whole = Attempt(given, [SimpleNamespace(certainty=0.1, turns=1)], 0.9)  # type: ignore[arg-type, list-item]
    monkeypatch.setattr(Constraints, "disagreement", lambda *_: None)
    found = retry.attempt_part(whole, Constraints(None, np.zeros((0, 3)), []))
    assert (found.candidates[0].certainty == certainty) == taken
    assert any("different units" in note for note in getattr(found.pair, "notes", ())) == noted


@pytest.mark.parametrize(
    ("certainty", "stretched", "searched"),
    [(0.6, 1.0, False), (0.6, 0.9, False), (0.6, 1.2, True), (0.6, 0.85, True), (0.45, 1.0, True), (0.8, 1.2, False)],
)
def test_no_other_unit_is_tried_if_a_likely_map_keeps_lengths(
    monkeypatch: pytest.MonkeyPatch, certainty: float, stretched: float, searched: bool
) -> None:
    """Nor if it is certain enough; the map of the wholes may still be more certain."""

    def search(*_: object) -> None:
        tried.append(True)

    tried: list[bool] = []
    shape: Any = SimpleNamespace(basis=SimpleNamespace(areas=np.ones(4)))
    pair = Pair(*(SimpleNamespace() for _ in range(2)), shape, shape, 60, 20)  # type: ignore[arg-type]
    monkeypatch.setattr(retry, "in_one_unit", lambda pair: pair)
    monkeypatch.setattr(retry, "units_differ", lambda _: False)
    monkeypatch.setattr(retry, "are_fragments", lambda _: False)
    monkeypatch.setattr(retry, "agree", lambda *_: False)
    monkeypatch.setattr(retry, "match_part", lambda *_: [SimpleNamespace(certainty=certainty, part_match=stretched)])
    monkeypatch.setattr(unknown_scale, "stretch", lambda stretched: stretched)
    monkeypatch.setattr(retry, "match_at_unknown_scale", search)
    monkeypatch.setattr(Constraints, "disagreement", lambda *_: None)
    for of_wholes in (0.1, 0.82):
        tried.clear()
        whole = Attempt(pair, [SimpleNamespace(certainty=of_wholes, turns=1)], 0.9)  # type: ignore[list-item]
        found = retry.attempt_part(whole, Constraints(None, np.zeros((0, 3)), []))
        assert found.candidates[0].certainty == max(certainty, of_wholes)
        assert bool(tried) == (searched or (of_wholes > certainty and stretched > UNKNOWN_SCALE.right_unit))
