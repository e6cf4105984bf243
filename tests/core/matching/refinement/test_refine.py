# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement rounds from a candidate to a dense map: map sizes, and weights of positions in space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from creatures import creature
from reports import fractions_of

from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.refinement import refine as refinement
from zoomout_core.matching.refinement.refine import REFINEMENT, Schedule, refine
from zoomout_core.tuning import retune

K_FINAL, STEP = MatchOptions().k_final, MatchOptions().step
SCHEDULE = Schedule(((10, 0.08), (25, 0.05), (60, 0.04)), (12, 60))


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    return analyse(creature(640).surface.working.part(0)[0], 60, 200, 0)


class Rounds:
    """Records the arguments of each round; positions are weighted by a fixed factor."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, factor: float = 1.0) -> None:
        self.sizes: list[int] = []
        self.widths: list[float] = []
        self.counts: list[int] = []
        self.weights: list[float | None] = []
        self.finishing = 0.0
        aligned, beside = refinement.align_and_match, refinement.beside_places

        def round_of(vertex: Any, pair: Any, k: int, width: float, *among: Any, **weight: float) -> Any:
            self.sizes.append(k)
            self.widths.append(width)
            self.counts.append(len(np.arange(len(pair.source.mesh.vertices))[among[0]]) if among else 0)
            self.weights.append(weight.get("weight"))
            return aligned(vertex, pair, k, width, *among, **weight)

        def last(*args: Any) -> Any:
            self.finishing = args[-1]
            return beside(*args)

        monkeypatch.setattr(refinement, "align_and_match", round_of)
        monkeypatch.setattr(refinement, "beside_places", last)
        monkeypatch.setattr(refinement, "_weight_factor", lambda *_: factor)


def refine_identity(
    shape: ShapeAnalysis, k_final: int = 40, step: int = 7, schedule: Schedule | None = SCHEDULE
) -> np.ndarray:
    return refine(shape, shape, np.eye(10), None, False, k_final, step, schedule)[1]


def test_maps_grow_along_the_schedule_up_to_k_final(shape: ShapeAnalysis, monkeypatch) -> None:
    rounds = Rounds(monkeypatch)
    assert refine_identity(shape).shape == (40, 40)
    assert rounds.sizes == [10, 25, 40, 12, 19, 26, 33, 40, 40, 40]
    # Samples suffice while the map still grows.
    assert rounds.counts[:3] == [200, 200, 640]
    assert rounds.widths == [0.08, 0.05, *[0.04] * 8]


def test_maps_grow_by_the_step_beyond_the_schedule(shape: ShapeAnalysis, monkeypatch) -> None:
    rounds = Rounds(monkeypatch)
    refine_identity(shape, step=7, schedule=Schedule(((10, 0.08),), (12, 14)))
    assert rounds.sizes == [10, 12, 14, 21, 28, 35]


def test_default_schedule_ends_narrower_than_it_begins(shape: ShapeAnalysis, monkeypatch) -> None:
    rounds = Rounds(monkeypatch)
    refine_identity(shape, schedule=None)
    assert rounds.sizes[0] < rounds.sizes[-1] == 40
    assert rounds.widths[0] > rounds.widths[-1] > 0
    own, between = (
        len(schedule.aligning) + len(schedule.settling_sizes(STEP, K_FINAL))
        for schedule in (REFINEMENT.onto_itself, REFINEMENT.between_shapes)
    )
    assert own < between


def test_default_step_goes_through_these_sizes() -> None:
    between, own = REFINEMENT.between_shapes, REFINEMENT.onto_itself
    assert between.settling_sizes(STEP, K_FINAL) == [30, 50, 70, 90, 120]
    assert own.settling_sizes(STEP, K_FINAL) == [90, 120]
    assert between.settling_sizes(STEP, 60) == [30, 50, 60, 60, 60]
    assert between.settling_sizes(STEP, 200) == [30, 50, 70, 90, 120, 140, 160, 180]


def test_a_smaller_step_gives_more_sizes() -> None:
    between = REFINEMENT.between_shapes
    assert between.settling_sizes(10, K_FINAL) == [*range(30, 120, 10), 120]
    counts = [len(between.settling_sizes(step, K_FINAL)) for step in (1, 5, 10, 20, 40, 1000)]
    assert counts == sorted(set(counts), reverse=True)
    assert between.settling_sizes(1000, K_FINAL) == [30, 120]
    assert between.settling_sizes(5, 40) == [30, 35, 40, 40, 40, 40, 40]


@pytest.mark.parametrize("schedule", [REFINEMENT.between_shapes, REFINEMENT.onto_itself])
def test_schedules_go_from_small_smooth_maps_to_large_ones(schedule: Schedule) -> None:
    sizes, widths = zip(*schedule.aligning, strict=True)
    assert sizes[0] > 10
    assert list(sizes) == sorted(sizes)
    assert widths[0] < 0.2
    assert list(widths) == sorted(widths, reverse=True)
    assert widths[-1] > 0.01
    assert schedule.settling[0] < schedule.settling[1]
    assert schedule.settling[0] >= sizes[0]


def test_coarse_mesh_has_a_smaller_map_of_a_minimum_size(monkeypatch) -> None:
    coarse = analyse(creature(200).surface.working.part(0)[0], 60, 120, 0)
    Rounds(monkeypatch)
    assert 20 <= len(refine_identity(coarse, k_final=60)) < 60
    few = analyse(creature(200).surface.working.part(0)[0], 15, 120, 0)
    assert refine_identity(few, k_final=60).shape == (15, 15)


def test_positions_weigh_less_in_settling_and_least_at_the_end(shape: ShapeAnalysis, monkeypatch) -> None:
    rounds = Rounds(monkeypatch)
    refine_identity(shape)
    assert rounds.weights[:3] == [None] * 3
    settling = {weight for weight in rounds.weights if weight is not None}
    assert len(settling) == 1
    assert 1 > max(settling) > rounds.finishing > 0


def test_positions_hardly_count_for_nearly_isometric_shapes(shape: ShapeAnalysis, monkeypatch) -> None:
    found = []
    for factor in (1.0, 0.5, 2.0):
        monkeypatch.undo()
        rounds = Rounds(monkeypatch, factor)
        refine_identity(shape)
        found.append((rounds.weights[-1], rounds.finishing))
    (usual, usual_end), (alike, alike_end), (unlike, unlike_end) = found
    assert alike < 0.2 * usual
    assert unlike == pytest.approx(2 * usual)
    np.testing.assert_allclose([alike_end, unlike_end], [0.5 * usual_end, 2 * usual_end])


def test_weight_of_positions_at_the_end_falls_with_the_map_size(shape: ShapeAnalysis, monkeypatch) -> None:
    rounds = Rounds(monkeypatch)
    refine_identity(shape)
    plain = rounds.finishing
    with retune(REFINEMENT, finishing_size=20):
        refine_identity(shape)
    assert rounds.finishing == pytest.approx(plain / 4)


def test_progress_rises_with_every_round(shape: ShapeAnalysis) -> None:
    fractions = [
        *fractions_of(lambda: refine(shape, shape, np.eye(10), None, False, 40, 20, SCHEDULE)),
        1.0,
    ]
    assert fractions[0] == 0
    assert fractions == sorted(fractions)
    assert max(np.diff(fractions)) < 0.25
    assert len(set(fractions)) > 6


def test_nearest_vertices_are_found_near_samples_of_any_mesh(shape: ShapeAnalysis) -> None:
    tiny = analyse(creature(30).surface.working.part(0)[0], 10, 20, 0)
    for one in (tiny, shape):
        places = one.mesh.vertices
        near = refinement._nearest_near_samples(places, places, one)
        np.testing.assert_array_equal(near, np.arange(len(places)))
