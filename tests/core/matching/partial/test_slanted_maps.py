"""Maps from landmarks, and slanted ZoomOut between a part and a whole."""

from __future__ import annotations

import numpy as np
import pytest
from pieces import PartAndWhole

from zoomout_core.matching.partial.incomplete_shape import unlikeness
from zoomout_core.matching.partial.landmark_search import landmarks_of
from zoomout_core.matching.partial.slanted_maps import SLANTED, extended, slanted_map, slanted_sizes
from zoomout_core.tuning import retuned


def test_sizes_are_slanted_by_the_areas_either_way(lower: PartAndWhole) -> None:
    part, whole = lower.part, lower.whole
    with retuned(SLANTED, sizes=(12, 60, 4)):
        sizes = slanted_sizes(part, whole)
        assert slanted_sizes(whole, part) == [(k_source, k_target) for k_target, k_source in sizes]
    assert [k_whole for _, k_whole in sizes] == list(range(12, 61, 4))
    share = part.shape.basis.areas.sum() / whole.shape.basis.areas.sum()
    assert abs(sizes[-1][0] / sizes[-1][1] - share) < 0.15
    assert min(k_part for k_part, _ in sizes) >= SLANTED.fewest
    # Not more than the bases have.
    assert slanted_sizes(part, whole)[-1][1] <= len(whole.shape.basis.eigenvalues)


def test_true_landmarks_are_extended_to_all_places_and_refined(lower: PartAndWhole) -> None:
    part, whole = lower.part, lower.whole
    unlike = unlikeness(part, whole)
    chosen = landmarks_of(part, 7)
    truth = whole.shape.nearest_distance_sample[lower.true_samples()[: len(part.between)]]
    place = extended(chosen, truth[chosen], unlike, part, whole)
    samples, vertices = whole.shape.search.samples, part.shape.search.samples
    rough = lower.errors(samples[place], vertices[: len(place)])
    match = slanted_map(place, part, whole)
    refined = lower.errors(samples[match], vertices)
    assert np.mean(rough) < 0.2
    assert np.mean(refined) < 0.15
    with retuned(SLANTED, rounds=0):
        once = extended(chosen, truth[chosen], unlike, part, whole)
    assert not np.array_equal(once, place)


@pytest.mark.parametrize(("rounds", "weight"), [(0, "unlikeness"), (1, "later_unlikeness")])
def test_places_go_to_their_like_as_well_as_by_distances(lower: PartAndWhole, rounds: int, weight: str) -> None:
    shape = lower.whole
    every = np.arange(len(shape.between))
    chosen = landmarks_of(shape, 6)
    likes_next = 1 - np.roll(np.eye(len(every)), 1, axis=1)
    none = {"unlikeness": 0.0, "later_unlikeness": 0.0}
    for weights, expected in ((none, every), (none | {weight: 10.0}, np.roll(every, -1))):
        with retuned(SLANTED, rounds=rounds, **weights):
            np.testing.assert_array_equal(extended(chosen, chosen, likes_next, shape, shape), expected)


def test_anchors_hold_a_slanted_map(lower: PartAndWhole) -> None:
    part, whole = lower.part, lower.whole
    truth = whole.shape.nearest_distance_sample[lower.true_samples()[: len(part.between)]]
    samples, vertices = whole.shape.search.samples, part.shape.search.samples
    held = lower.errors(samples[slanted_map(truth, part, whole)], vertices).mean()
    with retuned(SLANTED, anchors=3):
        loose = lower.errors(samples[slanted_map(truth, part, whole)], vertices).mean()
    assert held < loose
