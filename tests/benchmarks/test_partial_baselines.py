# SPDX-License-Identifier: GPL-3.0-or-later
"""The methods of partial matching used for comparison: cases solved by hand, and easy pairs."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.spatial import cKDTree

import zoomout_core as zo
from benchmarks.baselines import gtm as gtm_module
from benchmarks.baselines.bcicp import Side
from benchmarks.baselines.cpd import LAMBDA, OUTLIERS, cpd, kernel, probabilities, register
from benchmarks.baselines.fc import fc
from benchmarks.baselines.gtm import DISTORTION, agreeing, gtm, interpolate, payoffs
from zoomout_core.mesh.surface import Surface

# --- coherent point drift -----------------------------------------------------------------------------------


def test_cpd_probabilities_include_outliers() -> None:
    centres, point = np.array([[0.0, 0, 0], [2.0, 0, 0]]), np.array([[0.5, 0, 0]])
    share = probabilities(centres, point, variance=0.5)
    # At squared distances 1/4 and 9/4 and 2 sigma^2 = 1; the mixture's constant (pi)^(3/2) w / (1 - w) M / N.
    likelihood = np.exp([-0.25, -2.25])
    expected = likelihood / (likelihood.sum() + np.pi**1.5 * OUTLIERS / (1 - OUTLIERS) * 2)
    np.testing.assert_allclose(share[:, 0], expected)


def test_an_iteration_solves_the_papers_system() -> None:
    random = np.random.default_rng(0)
    moving, fixed = random.standard_normal((2, 30, 3))
    drift = register(moving, fixed, iterations=1)
    variance = ((moving[:, None] - fixed) ** 2).sum(axis=2).mean() / 3
    share = probabilities(moving, fixed, variance)
    system = np.diag(share.sum(axis=1)) @ kernel(moving, moving) + LAMBDA * variance * np.eye(30)
    weights = np.linalg.solve(system, share @ fixed - share.sum(axis=1)[:, None] * moving)
    np.testing.assert_allclose(drift.move(moving), moving + kernel(moving, moving) @ weights, atol=1e-6)


def test_cpd_registers_a_bent_copy() -> None:
    points = creature(600).surface.vertices
    bent = points + 0.15 * np.sin(2 * points[:, [1, 2, 0]])
    found = cpd(points, bent, samples=600)
    right = (found == np.arange(600)).mean()
    unmoved = (cKDTree(points).query(bent)[1] == np.arange(600)).mean()
    assert right > 0.9
    assert unmoved < 0.3


# --- game-theoretic matching --------------------------------------------------------------------------------


def test_payoff_measures_distance_preservation() -> None:
    pairs = np.array([[0, 0], [1, 1], [1, 0], [2, 1]])
    between_targets = np.array([[0, 1, np.inf], [1, 0, 1], [np.inf, 1, 0]])
    between_sources = np.array([[0, 1 + DISTORTION], [1 + DISTORTION, 0]])
    paid = payoffs(pairs, between_targets, between_sources)
    np.testing.assert_allclose(paid[0], [0, np.exp(-0.5), 0, 0])  # itself, one off by s, a shared point, no path
    np.testing.assert_allclose(paid[2], [0, 0, 0, np.exp(-0.5)])
    np.testing.assert_allclose(paid, paid.T)


def test_consistent_group_of_matches_survives() -> None:
    # Three strategies that all agree, and two that agree with one other each.
    payoff = np.zeros((5, 5))
    payoff[:3, :3] = 1 - np.eye(3)
    payoff[3, 4] = payoff[4, 3] = payoff[2, 3] = payoff[3, 2] = 0.9
    np.testing.assert_array_equal(agreeing(payoff), [0, 1, 2])
    with pytest.raises(ValueError, match="No two matches agree"):
        agreeing(np.zeros((3, 3)))


def test_interpolation_preserves_distances_to_matches() -> None:
    # On a line of five vertices the matched points are the ends; the source is the same line, turned round.
    line = np.arange(5) / 4
    from_targets = np.vstack([line, 1 - line])
    np.testing.assert_array_equal(interpolate(from_targets, from_targets[::-1]), [4, 3, 2, 1, 0])
    torn = from_targets[::-1].copy()
    torn[:, 4] = np.inf  # vertices that the matches do not reach are not images
    np.testing.assert_array_equal(interpolate(from_targets, torn), [3, 3, 2, 1, 0])
    from_targets[:, 2] = np.inf
    np.testing.assert_array_equal(interpolate(from_targets, from_targets[::-1])[[0, 2]], [4, -1])


# --- easy pairs ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pair() -> tuple[Surface, Surface, np.ndarray]:
    """Two poses of a creature on different meshes, the second twice as large, and the truth."""
    source, target = creature(1200, 0, asymmetry=0.3), creature(1100, 1, bend=0.3, asymmetry=0.3)
    return source.surface, target.surface, true_vertex(source, target)


def error(vertex: np.ndarray, source: Surface, truth: np.ndarray, places: np.ndarray) -> float:
    """Mean geodesic error, times 1000."""
    return float(1000 * zo.geodesic_error(vertex, source, places, truth[places]).mean())


def test_game_theory_matches_a_part(pair: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gtm_module, "RADIUS", 0.3)  # these are smooth, and carry little information within a small ball
    monkeypatch.setattr(gtm_module, "TARGET_SAMPLES", 120)
    monkeypatch.setattr(gtm_module, "SOURCE_SAMPLES", 500)
    source, target, truth = pair
    kept = target.vertices[:, 2] > np.quantile(target.vertices[:, 2], 0.3)
    part, numbers = cut(target, kept)
    vertex = gtm(source, part)
    assert vertex.shape == (len(part.vertices),)
    assert error(vertex, source, truth[numbers], np.arange(len(numbers))) < 80


def test_functional_correspondence_matches_a_whole(pair: tuple) -> None:
    source, target, truth = pair
    vertex = fc(*(Side(surface, zo.eigenbasis(surface, 30)) for surface in (source, target)), k=20)
    assert error(vertex, source, truth, np.arange(len(truth))) < 80


def cut(surface: Surface, kept: np.ndarray) -> tuple[Surface, np.ndarray]:
    """The part of a surface on some of its vertices (n,), and their indices."""
    triangles = surface.triangles[kept[surface.triangles].all(axis=1)]
    numbers, local = np.unique(triangles, return_inverse=True)
    return Surface(surface.vertices[numbers], local.reshape(-1, 3)), numbers
