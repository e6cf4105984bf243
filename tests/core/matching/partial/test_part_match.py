# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts are matched to wholes, and wholes to parts, without a hint; vertices without a partner are marked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex
from pieces import analyse_piece, in_lower_half, lower_half

import zoomout_core as zo
from zoomout_core.matching.attempt import ATTEMPTS
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.part_candidates import PART_CANDIDATES
from zoomout_core.matching.partial.part_match import (
    PART_MATCH,
    in_one_unit,
    may_be_part,
    part_of,
)
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.certainty import PART_CERTAINTY
from zoomout_core.mesh.surface import Surface
from zoomout_core.tuning import retune


@pytest.fixture(scope="module")
def made() -> tuple[Creature, Creature]:
    return lower_half(1500)


def match_as_part(source: Surface, target: Surface, **given: Any) -> zo.MatchResult:
    """Match with settings that always try the partial map, always accept it, and search as little as possible."""
    zo.forget_shapes()
    with (
        retune(ATTEMPTS, same_share=1.0),
        retune(PART_MATCH, uncertain=1.0),
        retune(PART_CERTAINTY, misfit=-50.0, another_map=2.0),
        retune(PART_CANDIDATES, landmarks=7, regions=0, registered=4),
    ):
        return zo.match(source, target, k_final=60, samples=400, **given)


def place_errors(result: zo.MatchResult, source: Creature, target: Creature, at: np.ndarray) -> np.ndarray:
    """(q,) distances between images and true places of some vertices, at unit area of the source."""
    true = source.surface.vertices[true_vertex(source, target)[at]]
    images = result.surface_map.interpolate(source.surface.vertices)[at]
    return np.asarray(np.linalg.norm(images - true, axis=1) / np.sqrt(source.surface.area))


def overlap_of(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two selections (n,)."""
    return float((one & other).sum() / (one | other).sum())


def test_a_part_is_matched_to_its_whole(made: tuple[Creature, Creature]) -> None:
    part, whole = made
    result = match_as_part(whole.surface, part.surface)
    assert result.candidates[0].part_match is not None
    assert np.median(place_errors(result, whole, part, np.arange(len(part.directions)))) < 0.03
    assert np.median(result.confidence) > 0.5
    # Both surfaces have a mask, and the notes report the same share.
    assert result.has_partner.mean() > 0.95
    assert overlap_of(result.source_has_partner, in_lower_half(whole)) > 0.85
    missing = whole.surface.share_of_area(~in_lower_half(whole))
    assert result.source_share_without_partner == pytest.approx(missing, abs=0.1)
    share = f"About {result.source_share_without_partner:.0%} of the source has no partner"
    assert any(note.startswith(share) for note in result.notes)
    # Between bases at unit area the constant function, of norm one, maps to itself.
    assert abs(result.functional_map[0, 0]) == pytest.approx(1, abs=1e-6)
    assert result.functional_map.shape[0] < result.functional_map.shape[1]
    # The outline approximates the map before it is computed.
    target, source = result.outline(0)
    true = true_vertex(whole, part)[target]
    apart = np.linalg.norm(whole.surface.vertices[source] - whole.surface.vertices[true], axis=1)
    assert np.median(apart) / np.sqrt(whole.surface.area) < 0.1
    other = result.use(1)
    assert other.chosen == 1
    assert not np.array_equal(other.surface_map.triangle, result.surface_map.triangle)
    assert not np.array_equal(other.source_has_partner, result.source_has_partner)


@pytest.mark.slow
def test_a_whole_is_matched_to_its_part(made: tuple[Creature, Creature]) -> None:
    part, whole = made
    result = match_as_part(part.surface, whole.surface)
    kept = np.linalg.norm(whole.directions - part.directions[true_vertex(part, whole)], axis=1) < 0.05
    assert 0.2 < kept.mean() < 0.8
    assert np.median(place_errors(result, part, whole, kept)) < 0.05
    # Vertices off the part have no confidence, vertices on it have.
    far = np.linalg.norm(whole.directions - part.directions[true_vertex(part, whole)], axis=1) > 0.3
    assert np.median(result.confidence[far]) < 0.05
    assert np.median(result.confidence[kept]) > 0.3
    assert overlap_of(result.has_partner, in_lower_half(whole)) > 0.85
    assert result.source_has_partner.mean() > 0.95
    assert any(f"About {result.share_without_partner:.0%} of the target" in note for note in result.notes)
    # Triangles without a partner do not count as flipped.
    assert not any("flips" in note for note in result.notes)


@cache
def shape_of(surface: Surface) -> ShapeAnalysis:
    return analyse_piece(Creature(surface, surface.vertices))


@pytest.mark.slow
def test_part_match_uses_landmarks_and_keeps_exact_ones(made: tuple[Creature, Creature]) -> None:
    part, whole = made
    here = int(np.argmin(part.surface.vertices[:, 2]))
    near = np.argsort(
        np.linalg.norm(whole.surface.vertices - whole.surface.vertices[true_vertex(whole, part)[here]], axis=1)
    )
    there = int(near[12])
    given = {"initial": "landmarks", "landmarks": ([there], [here]), "exact_landmarks": True}
    result = match_as_part(whole.surface, part.surface, **given)
    assert result.candidates[0].part_match is not None
    assert result.surface_map.vertex[here] == there


def pair_of(source: Surface, target: Surface) -> Pair:
    return Pair(source, target, shape_of(source), shape_of(target), 60, 20)


def test_only_shapes_with_cuts_may_be_parts(made: tuple[Creature, Creature]) -> None:
    part, whole = made
    assert may_be_part(pair_of(whole.surface, part.surface))
    assert may_be_part(pair_of(part.surface, whole.surface))
    closed = creature(400, seed=3).surface
    assert not may_be_part(pair_of(closed, closed))
    coarse = lower_half(400)[0]
    assert len(coarse.directions) < 400
    assert may_be_part(pair_of(whole.surface, coarse.surface))
    pair = pair_of(whole.surface, part.surface)
    hull = replace(pair.target_shape.proxy.full, is_hull=True)
    around = replace(pair.target_shape, proxy=replace(pair.target_shape.proxy, full=hull))
    assert not may_be_part(replace(pair, target_shape=around))


def test_the_larger_shape_is_the_unit_and_the_smaller_one_the_part(made: tuple[Creature, Creature]) -> None:
    part, whole = made
    for source, target in ((part, whole), (whole, part)):
        pair = in_one_unit(pair_of(source.surface, target.surface))
        smaller, larger = part_of(pair)
        assert larger.basis.areas.sum() == pytest.approx(1)
        share = part.surface.area / whole.surface.area
        assert smaller.basis.areas.sum() == pytest.approx(share)
        assert (smaller is pair.source_shape) == (source is part)
