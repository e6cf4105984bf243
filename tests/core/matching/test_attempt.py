# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice among attempts with several bodies."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zoomout_core.matching.attempt import Attempt, best_of
from zoomout_core.matching.ranking.candidate import Candidate

PLACES = np.random.default_rng(1).standard_normal((100, 3))


def body(certainty: float, coverage: float, moved: np.ndarray, scale: float = 1.0) -> Attempt:
    """An attempt that displaces each place by `moved` (100,)."""
    samples, images = np.arange(100), PLACES + np.stack([moved, 0 * moved, 0 * moved], axis=1)

    def shape(vertices: np.ndarray) -> Any:
        full = SimpleNamespace(to_surface=lambda points: scale * points, scale=scale)
        return SimpleNamespace(
            proxy=SimpleNamespace(full=full, vertices=vertices),
            search=SimpleNamespace(samples=samples),
            min_distances=lambda here, there: np.linalg.norm(vertices[here] - vertices[there], axis=1),
            weights=np.full(100, 0.01),
        )

    pair: Any = SimpleNamespace(source_shape=shape(images), target_shape=shape(PLACES))
    nothing = np.zeros((0, 0))
    first = Candidate("", False, False, nothing, nothing, samples, None, None, certainty, {})
    return Attempt(pair, [first, replace(first, certainty=0.01)], coverage)


def is_taken_for_the_same(moved: np.ndarray, scale: float = 1.0) -> bool:
    """Whether an attempt of larger coverage inherits the certainty of a more certain, narrower rival."""
    wide, narrow = body(0.4, 1.0, 0 * moved, scale), body(0.9, 0.5, moved, scale)
    chosen = best_of([narrow, wide])
    return chosen.coverage == 1.0 and chosen.candidates[0].certainty == 0.9


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_maps_are_the_same_if_most_places_nearly_agree(scale: float) -> None:
    assert is_taken_for_the_same(np.full(100, 0.1), scale)
    assert not is_taken_for_the_same(np.full(100, 0.25), scale)
    few, many = np.zeros(100), np.zeros(100)
    few[:15], many[:40] = 1, 1
    assert is_taken_for_the_same(few, scale)
    assert not is_taken_for_the_same(many, scale)


@pytest.mark.parametrize(("off", "expected"), [(0, 0.9), (15, 0.6), (40, 0.9)])
def test_certainty_is_shared_with_a_rival_that_agrees_as_well(off: int, expected: float) -> None:
    # The rival differs in some places: if in few, it counts as the same map as the one of the other attempt.
    here = np.zeros(100)
    wide, narrow = body(0.4, 1.0, here), body(0.9, 0.5, here)
    samples = np.arange(100)
    samples[:off] = np.arange(100)[::-1][:off]
    first = wide.candidates[0]
    rival = replace(first, certainty=0.2, sample_map=samples)
    chosen = best_of([narrow, replace(wide, candidates=[first, rival])])
    assert chosen.candidates[0].certainty == pytest.approx(expected)


def test_attempts_are_compared_by_certainty_times_coverage() -> None:
    far = np.ones(100)
    assert best_of([body(0.6, 1.0, 0 * far), body(0.9, 0.5, far)]).coverage == 1.0
    assert best_of([body(0.3, 1.0, 0 * far), body(0.9, 0.5, far)]).coverage == 0.5


def test_attempt_is_judged_by_its_first_candidate() -> None:
    wide, narrow = body(0.9, 1.0, np.zeros(100)), body(0.4, 0.5, np.zeros(100))
    assert best_of([wide, narrow]).candidates[0].certainty == 0.9


def test_later_attempt_of_equal_coverage_must_be_clearly_better() -> None:
    here = np.zeros(100)
    loose, tight, hardly_surer = (body(certainty, 1.0, here) for certainty in (0.3, 0.6, 0.36))
    assert best_of([loose, tight]).pair is tight.pair
    assert best_of([tight, loose]).pair is tight.pair
    chosen = best_of([loose, hardly_surer])
    assert chosen.pair is loose.pair
    assert chosen.candidates[0].certainty == 0.36
