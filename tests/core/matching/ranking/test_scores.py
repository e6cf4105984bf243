# SPDX-License-Identifier: GPL-3.0-or-later
"""Each criterion and each kind of evidence affects the score in the intended direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.spatial.transform import Rotation

from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.ranking import scores
from zoomout_core.matching.ranking.scores import (
    EVIDENCE_WEIGHTS,
    correlation,
    fit_in_space,
    map_after_alignment,
    orientation_agreement,
    scores_of,
    total_score,
)
from zoomout_core.mesh.surface import Surface
from zoomout_core.tuning import retune

SCORES = {
    "place": 0.05,
    "facing": 0.1,
    "commutativity": 0.1,
    "frequency": 0.1,
    "distance": 0.1,
    "curvature": 0.5,
    "handedness": 0.3,
}


def shape_of(surface: Surface) -> ShapeAnalysis:
    return analyse(surface.working.part(0)[0], 60, 200, 0)


@pytest.fixture(scope="module")
def shapes() -> tuple[ShapeAnalysis, ShapeAnalysis]:
    return shape_of(creature(500, seed=0).surface), shape_of(creature(480, seed=1).surface)


@pytest.mark.parametrize("criterion", SCORES)
def test_better_value_of_each_criterion_lowers_the_score(criterion: str) -> None:
    better = 0.1 if criterion in ("curvature", "handedness") else -0.04
    assert total_score(SCORES | {criterion: SCORES[criterion] + better}) < total_score(SCORES) - 0.05


@pytest.mark.parametrize("kind", ["landmarks", "earlier map", "place in space", "axes", "regions"])
def test_disagreement_with_evidence_raises_the_score(kind: str) -> None:
    # For each kind, 10% of full disagreement, or of the square root of the area, changes the score.
    assert kind in EVIDENCE_WEIGHTS
    assert total_score(SCORES | {kind: 0.1}) > total_score(SCORES) + 0.1


def test_landmarks_outweigh_the_difference_to_a_mirror_image() -> None:
    # A flip changes the total score by 2 to 4; a landmark on the wrong hand is off by much more than 0.1.
    for criterion, off in (("landmarks", 0.25), ("earlier map", 0.45)):
        assert total_score(SCORES | {criterion: off}) > total_score(SCORES) + 4


def test_place_weighs_most_and_handedness_less_than_two_criteria() -> None:
    doubled = {name: total_score(SCORES | {name: 2 * SCORES[name]}) for name in SCORES if name != "handedness"}
    assert all(doubled["place"] > other for name, other in doubled.items() if name not in ("place", "curvature"))
    lost = total_score(SCORES | {"handedness": SCORES["handedness"] - 1}) - total_score(SCORES)
    assert 0.5 < lost / (total_score(SCORES | {"commutativity": np.e * 0.1}) - total_score(SCORES)) < 2


def test_missing_criteria_do_not_affect_the_score() -> None:
    unknown = {name: score for name, score in SCORES.items() if name not in ("place", "facing")}
    assert total_score(unknown) == pytest.approx(total_score(unknown | {"place": 1.0, "facing": 1.0}))
    assert total_score(SCORES | dict.fromkeys(EVIDENCE_WEIGHTS, 0.0)) == pytest.approx(total_score(SCORES))


def test_handedness_is_linear_and_a_perfect_score_is_finite() -> None:
    steps = [
        total_score(SCORES | {"handedness": start}) - total_score(SCORES | {"handedness": start + 0.1})
        for start in (0.0, 0.6)
    ]
    assert steps[0] == pytest.approx(steps[1])
    assert np.isfinite(total_score(dict.fromkeys(SCORES, 0.0) | {"curvature": 1.0}))


def test_correlation_ignores_offset_and_scale_but_not_sign() -> None:
    random = np.random.default_rng(0)
    x, weights = random.standard_normal((400, 3)), np.full(400, 1 / 400)
    assert correlation(x, 3 * x + 5, weights) == pytest.approx(1)
    assert correlation(x, 2 - 0.1 * x, weights) == pytest.approx(-1)
    assert abs(correlation(x, random.standard_normal((400, 3)), weights)) < 0.2
    both = np.column_stack([x[:, 0], x[:, 1]])
    assert correlation(both, both * [1, -1], weights) == pytest.approx(0, abs=1e-9)


def test_correlation_is_weighted() -> None:
    x, y = np.array([[0.0], [1], [2], [9]]), np.array([[0.0], [1], [2], [-9]])
    assert correlation(x, y, np.array([1, 1, 1, 0]) / 3) == pytest.approx(1)
    assert correlation(x, y, np.full(4, 0.25)) < 0


def test_nearly_constant_function_has_no_correlation() -> None:
    x = np.random.default_rng(0).standard_normal((50, 1))
    for scale in (1e-4, 1, 1e4):
        flat = scale * (1 + 1e-9 * x)
        assert abs(correlation(flat, x, np.full(50, 0.02))) < 1e-3


def test_isometry_has_perfect_scores_and_a_shuffled_map_poor_ones(
    shapes: tuple[ShapeAnalysis, ShapeAnalysis],
) -> None:
    shape = shapes[0]
    identity = np.arange(len(shape.search.samples))
    kept = scores_of(np.eye(40), identity, shape, shape, False)
    for name, value in (("commutativity", 0), ("frequency", 0), ("distance", 0), ("curvature", 1), ("handedness", 1)):
        assert kept[name] == pytest.approx(value, abs=1e-5), name
    reversed_ = scores_of(np.eye(40), identity, shape, shape, True)
    assert reversed_["handedness"] == pytest.approx(-1, abs=1e-5)
    shuffled = np.random.default_rng(0).permutation(identity)
    C = shape.search.fit(shape.search.rows[shuffled, :40], 40)
    lost = scores_of(C, shuffled, shape, shape, False)
    assert lost["commutativity"] > 0.1
    assert lost["frequency"] > 0.1
    assert lost["distance"] > 0.1
    assert abs(lost["curvature"]) < 0.3
    assert abs(lost["handedness"]) < 0.3


def test_orientation_agreement_is_negative_for_a_mirror_image(shapes: tuple[ShapeAnalysis, ShapeAnalysis]) -> None:
    shape = shapes[0]
    identity = np.arange(len(shape.search.samples))
    mirror = shape_of(Surface(shape.mesh.vertices * [-1, 1, 1], shape.mesh.oriented_triangles[:, ::-1]))
    assert 0.9 < orientation_agreement(identity, shape, shape) <= 1
    near = np.linalg.norm(
        (shape.mesh.vertices[shape.search.samples] * [-1, 1, 1])[None]
        - mirror.mesh.vertices[mirror.search.samples][:, None],
        axis=2,
    ).argmin(axis=1)
    assert -1 <= orientation_agreement(near, shape, mirror) < -0.9


def test_a_map_onto_a_single_place_has_no_orientation(shapes: tuple[ShapeAnalysis, ShapeAnalysis]) -> None:
    shape = shapes[0]
    flat = replace(shape, proxy=replace(shape.proxy, mesh=replace(shape.mesh, vertices=0 * shape.mesh.vertices)))
    assert orientation_agreement(np.zeros(len(shape.search.samples), dtype=int), flat, shape) == 0


def test_right_map_fits_in_space_at_any_rotation(
    shapes: tuple[ShapeAnalysis, ShapeAnalysis],
) -> None:
    shape = shapes[0]
    identity = np.arange(len(shape.search.samples))
    turn = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix()
    turned = shape_of(Surface(shape.mesh.vertices @ turn.T, shape.mesh.oriented_triangles))
    right = fit_in_space(identity, None, False, shape, turned)
    assert 0 <= right["place"] < 0.01
    assert 0 <= right["facing"] < 0.02
    wrong = fit_in_space(np.random.default_rng(0).permutation(identity), None, False, shape, turned)
    assert wrong["place"] > 3 * right["place"]
    assert wrong["facing"] > 3 * right["facing"]


def test_alignment_improves_a_rough_map() -> None:
    source, target = creature(500, seed=0), creature(480, seed=1, bend=0.4)
    shapes = shape_of(source.surface), shape_of(target.surface)
    truth = true_vertex(source, target)
    C = functional_map_of(truth, shapes[0].basis, shapes[1].basis, 12, 12)
    rows = shapes[1].search.rows[:, :12]
    embedded = shapes[0].search.rows[:, :12] @ C.T
    rough = np.linalg.norm(rows[:, None] - embedded, axis=2).argmin(axis=1)
    vertex, aligned = map_after_alignment(rough, None, False, *shapes)

    def missed(images: np.ndarray) -> float:
        return float(
            np.linalg.norm(source.directions[images] - target.directions[shapes[1].search.samples], axis=1).mean()
        )

    assert missed(vertex) < 0.8 * missed(shapes[0].search.samples[rough])
    assert aligned.positions.shape == (len(rough), 3)


@pytest.fixture(scope="module")
def rough(shapes: tuple[ShapeAnalysis, ShapeAnalysis]) -> tuple[np.ndarray, np.ndarray]:
    """(s,) true source vertex of each search sample of the target, and (s,) a source sample near it."""
    source, target = shapes
    truth = true_vertex(creature(500, seed=0), creature(480, seed=1))[target.search.samples]
    places = source.mesh.vertices
    near = np.linalg.norm(places[truth][:, None] - places[source.search.samples], axis=2).argsort(axis=1)[:, :8]
    return truth, near[np.arange(len(near)), np.random.default_rng(0).integers(0, 8, len(near))]


def test_alignment_smooths_images_by_a_moderate_width(shapes, rough) -> None:
    truth, sample_map = rough
    places = shapes[0].mesh.vertices

    def off() -> float:
        vertex, _ = map_after_alignment(sample_map, None, False, *shapes)
        return float(np.linalg.norm(places[vertex] - places[truth], axis=1).mean())

    smoothed = off()
    for width in (0.0, 1.0):
        with retune(scores.SCORES, alignment_width=width):
            assert smoothed < 0.95 * off()


def test_map_after_alignment_uses_vertices_between_samples(shapes, rough) -> None:
    truth, sample_map = rough
    source = shapes[0]
    vertex, _ = map_after_alignment(sample_map, None, False, *shapes)
    assert not np.isin(vertex, source.sampled.samples).all()
    # The first round uses only samples, and brings distant images near.
    places = source.mesh.vertices
    off, before = (
        np.linalg.norm(places[v] - places[truth], axis=1) for v in (vertex, source.search.samples[sample_map])
    )
    assert off.mean() < 0.5 * before.mean()
