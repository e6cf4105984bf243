# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect that two surfaces are in the same place, and use it to judge a map."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature, directions
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.matching.components.overlap import leaves_in_place, overlapping
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.memory_cache import cached_analysis
from zoomout_core.mesh.surface import Surface


def pair_of(source: Surface, target: Surface) -> Pair:
    parts = [surface.working.part(0)[0] for surface in (source, target)]
    return Pair(source, target, *(cached_analysis(part, 60, 200, 0, None) for part in parts), 60, 20)


def test_overlapping_surfaces_are_detected() -> None:
    resting, other, bent = creature(800).surface, creature(700, seed=1).surface, creature(700, seed=1, bend=0.9).surface
    places = overlapping(pair_of(resting, other))
    assert places is not None
    on_surface = resting.working.to_surface(places)[other.working.vertex_of]
    assert np.allclose(on_surface, other.vertices)
    assert overlapping(pair_of(resting, bent)) is None
    beside = Surface(other.vertices + np.array([0.8, 0, 0]), other.triangles)
    assert overlapping(pair_of(resting, beside)) is None


def test_a_map_that_swaps_limbs_does_not_leave_things_in_place() -> None:
    places = np.random.default_rng(0).standard_normal((100, 3))
    areas = np.ones(100)
    off = 0.05 * np.ones((100, 3))
    still = np.tile(np.eye(3), (100, 1, 1))
    assert leaves_in_place(places + off, places, areas, still)
    swapped = places.copy()
    swapped[:30] += 1
    assert not leaves_in_place(swapped, places, areas, still)


@pytest.mark.parametrize(("angle", "share", "stays"), [(15, 0.3, True), (40, 0.02, True), (40, 0.1, False)])
def test_a_part_that_turns_in_place_does_not_stay(angle: float, share: float, stays: bool) -> None:
    places, areas = np.random.default_rng(0).standard_normal((100, 3)), np.ones(100)
    rotations = np.tile(np.eye(3), (100, 1, 1))
    rotations[: round(100 * share)] = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    assert leaves_in_place(places, places, areas, rotations) is stays


@pytest.mark.slow
def test_map_in_place_wins_a_tie_but_is_uncertain() -> None:
    balls = [Surface(points, ConvexHull(points).simplices) for points in (directions(2000, 3), directions(1500, 4))]
    result = zo.match(*balls)
    off = np.linalg.norm(result.surface_map.interpolate(balls[0].vertices) - balls[1].vertices, axis=1)
    assert off.mean() < 0.2
    assert result.certainty < 0.5
