# SPDX-License-Identifier: GPL-3.0-or-later
"""Confident matches of one source to several targets correct an uncertain one."""

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
    return {name: make_certain(zo.match(SOURCE.surface, made.surface, FAST)) for name, made in TARGETS.items()}


def make_certain(result: zo.MatchResult) -> zo.MatchResult:
    """The same match with the certainty of a match of finer meshes."""
    first, *others = result.candidates
    return replace(result, candidates=(replace(first, certainty=0.99), *others))


def make_doubtful(result: zo.MatchResult) -> zo.MatchResult:
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


def test_confident_matches_are_unchanged(results: dict[str, zo.MatchResult]) -> None:
    assert min(result.certainty for result in results.values()) > 0.9
    assert agree(results, FAST) == results


def test_uncertain_match_takes_the_consistent_candidate(
    results: dict[str, zo.MatchResult],
) -> None:
    given = {**results, "b": make_doubtful(results["b"])}
    found = agree(given, FAST)
    assert found["b"].chosen == 1
    assert "consistent with the maps of other targets" in found["b"].notes[0]
    assert error(found["b"], TARGETS["b"]) < 0.3
    assert found["a"] is results["a"]
    assert found["c"] is results["c"]


@pytest.mark.slow
def test_match_without_consistent_candidate_maps_through_another_target(
    results: dict[str, zo.MatchResult],
) -> None:
    wrong = make_doubtful(results["b"])
    found = agree({**results, "b": replace(wrong, candidates=wrong.candidates[:1])}, FAST)
    assert "the map through" in found["b"].notes[0]
    assert error(found["b"], TARGETS["b"]) < 0.3


def test_nothing_changes_if_all_matches_are_uncertain(results: dict[str, zo.MatchResult]) -> None:
    given = {name: make_doubtful(result) for name, result in results.items()}
    assert agree(given, FAST) == given
