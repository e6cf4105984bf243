# SPDX-License-Identifier: GPL-3.0-or-later
"""Functional maps fitted to descriptors: least-squares solutions, of which the best distinct ones are kept."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature

from zoomout_core.maps.functional_map import resolvent_mask
from zoomout_core.maps.upsample import nearest_samples
from zoomout_core.matching.hypotheses.descriptors import _fit, descriptor_hypotheses
from zoomout_core.matching.hypotheses.hypothesis import alike
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.ranking.scores import scores_of, total_score


def shape_of(count: int, seed: int, k: int = 30) -> ShapeAnalysis:
    return analyse(creature(count, seed).surface.working.part(0)[0], k, 120, 0)


@pytest.fixture(scope="module")
def shapes() -> tuple[ShapeAnalysis, ShapeAnalysis]:
    return shape_of(260, 0), shape_of(240, 1)


@pytest.mark.parametrize("weight", [0.5, -2.0])
def test_fit_minimises_the_descriptor_energy(shapes, weight: float) -> None:
    source, target = shapes
    size, mask_weight = 8, 0.3
    (bands, pairs), (bands_there, pairs_there) = source.descriptors, target.descriptors
    # Both kinds weigh the same in total, and a reflection flips the sign of pseudo-scalars.
    share = abs(weight) ** 2 * bands.shape[1] / pairs.shape[1]
    mean_square = ((bands[:size] ** 2).sum() + share * (pairs[:size] ** 2).sum()) / size
    mask = mask_weight * mean_square * resolvent_mask(source.basis.eigenvalues[:size], target.basis.eigenvalues[:size])

    def energy(C: np.ndarray) -> float:
        off_bands = C @ bands[:size] - bands_there[:size]
        off_pairs = C @ pairs[:size] - np.sign(weight) * pairs_there[:size]
        return float((off_bands**2).sum() + share * (off_pairs**2).sum() + (mask * C**2).sum())

    C = _fit(source, target, size, weight, mask_weight)
    np.testing.assert_array_equal(C[0], np.eye(size)[0])
    np.testing.assert_array_equal(C[:, 0], np.eye(size)[0])
    step = 1e-4
    for i in range(1, size):
        for j in range(1, size):
            change = np.zeros_like(C)
            change[i, j] = step
            assert energy(C + change) > energy(C)
            assert energy(C - change) > energy(C)


def test_fit_of_a_shape_to_itself_is_nearly_the_identity(shapes) -> None:
    C = _fit(shapes[0], shapes[0], 12, 1.0, 0.3)
    assert np.diag(C).min() > 0.5
    assert np.abs(C - np.diag(np.diag(C))).max() < 0.3


@pytest.mark.parametrize("side", [1, -1])
def test_fits_are_sorted_by_score_and_distinct(shapes, side: int) -> None:
    source, target = shapes
    hypotheses = descriptor_hypotheses(source, target, sides=(side,))
    assert 2 <= len(hypotheses) <= 8
    maps = [nearest_samples(source.search, target.search, hypothesis.functional_map) for hypothesis in hypotheses]
    totals = [
        total_score(scores_of(hypothesis.functional_map, sample_map, source, target, side < 0))
        for hypothesis, sample_map in zip(hypotheses, maps, strict=True)
    ]
    assert totals == sorted(totals)
    assert not np.tril(alike([source.coordinates[each] for each in maps], 0.05), -1).any()
    # The origin of a fit records its parameters.
    for hypothesis in hypotheses:
        size, weight, mask_weight = (float(word) for word in hypothesis.origin.split()[1:])
        np.testing.assert_allclose(hypothesis.functional_map, _fit(source, target, int(size), weight, mask_weight))
        assert np.sign(weight) == side


def test_both_sides_are_tried_by_default(shapes) -> None:
    origins = [hypothesis.origin for hypothesis in descriptor_hypotheses(*shapes)]
    sides = ["-" in origin for origin in origins]
    assert sides == sorted(sides)
    assert 2 <= sum(sides) < len(sides)
    assert all(float(origin.split()[2]) for origin in origins)  # the weight of pseudo-scalars is nonzero
    assert all("+" in origin for origin, reverses in zip(origins, sides, strict=True) if not reverses)


def test_evidence_decides_which_fits_come_first(shapes) -> None:
    for size in (8, 16):
        hypotheses = descriptor_hypotheses(*shapes, lambda C, *_: {"axes": 50.0 * (len(C) != size)})  # noqa: B023
        assert len(hypotheses[0].functional_map) == size


def test_fits_are_no_larger_than_either_basis(shapes) -> None:
    few = shape_of(200, 2, k=10)
    for pair in ((shapes[0], few), (few, shapes[0])):
        assert {len(hypothesis.functional_map) for hypothesis in descriptor_hypotheses(*pair)} == {8}
