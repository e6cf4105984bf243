# SPDX-License-Identifier: GPL-3.0-or-later
"""Confident matches of one source to several targets correct a doubtful one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex

import zoomout_core as zo
from zoomout_core.collection.agree import agree
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.presets import DETAIL

pytestmark = pytest.mark.usefixtures("quick_search")

# Two candidates of "c" are nearly the same, and the evidence of heights exchanges them.
FAST = MatchOptions(**DETAIL["fast"], upright=False)  # type: ignore[arg-type]
SOURCE = creature(500, asymmetry=0.3)
TARGETS = {name: creature(500, seed=seed, bend=0.3 * seed, asymmetry=0.3) for seed, name in enumerate("abc", start=1)}


@pytest.fixture(scope="module")
def results() -> dict[str, zo.MatchResult]:
    return {name: sure(zo.match(SOURCE.surface, made.surface, FAST)) for name, made in TARGETS.items()}


def sure(result: zo.MatchResult) -> zo.MatchResult:
    """The same match with the certainty of a match of finer meshes."""
    first, *others = result.candidates
    return replace(result, candidates=(replace(first, certainty=0.99), *others))


def doubtful(result: zo.MatchResult) -> zo.MatchResult:
    """The same match with an uncertain, wrong candidate first."""
    right = result.candidates[0]
    wrong = replace(
        right,
        sample_map=np.roll(right.sample_map, len(right.sample_map) // 2),
        reverse_functional_map=np.roll(right.reverse_functional_map, 3, axis=0),
        certainty=0.6,
    )
    return replace(result, candidates=(wrong, replace(right, certainty=0.3)), chosen=0)


def error(result: zo.MatchResult, made: Creature) -> float:
    places = SOURCE.surface.vertices
    images = places[result.surface_map.vertex]
    return float(np.median(np.linalg.norm(images - places[true_vertex(SOURCE, made)], axis=1)))


def test_sure_matches_are_left_as_they_are(results: dict[str, zo.MatchResult]) -> None:
    assert min(result.certainty for result in results.values()) > 0.9
    assert agree(results, FAST) == results


def test_one_that_is_unsure_takes_the_candidate_that_agrees_with_the_others(
    results: dict[str, zo.MatchResult],
) -> None:
    given = {**results, "b": doubtful(results["b"])}
    found = agree(given, FAST)
    assert found["b"].chosen == 1
    assert "consistent with the maps of other targets" in found["b"].notes[0]
    assert error(found["b"], TARGETS["b"]) < 0.3
    assert found["a"] is results["a"]
    assert found["c"] is results["c"]


@pytest.mark.slow
def test_where_it_has_no_such_candidate_the_map_leads_through_another_target(
    results: dict[str, zo.MatchResult],
) -> None:
    wrong = doubtful(results["b"])
    found = agree({**results, "b": replace(wrong, candidates=wrong.candidates[:1])}, FAST)
    assert "the map through" in found["b"].notes[0]
    assert error(found["b"], TARGETS["b"]) < 0.3


def test_where_none_is_sure_there_is_nobody_to_ask(results: dict[str, zo.MatchResult]) -> None:
    given = {name: doubtful(result) for name, result in results.items()}
    assert agree(given, FAST) == given
