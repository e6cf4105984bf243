# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of a collection through one latent space close every cycle without losing accuracy."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from creatures import creature, true_vertex

import zoomout_core as zo

CREATURES = [creature(800, seed=seed, bend=bend, asymmetry=0.3) for seed, bend in ((0, 0.0), (1, 0.4), (2, 0.7))]
BASES = [zo.eigenbasis(made.surface, 40) for made in CREATURES]


def start(source: int, target: int) -> np.ndarray:
    """A rough map: the true one in twelve functions, plus noise."""
    true = zo.functional_map_of(true_vertex(CREATURES[source], CREATURES[target]), BASES[source], BASES[target], 12, 12)
    return true + 0.1 * np.random.default_rng(source + 3 * target).standard_normal(true.shape)


@pytest.fixture(scope="module")
def maps() -> zo.ConsistentMaps:
    return zo.consistent_zoomout(BASES, {pair: start(*pair) for pair in ((0, 1), (1, 2), (2, 0))}, 12, 40, 4)


def error(found: np.ndarray, source: int, target: int) -> float:
    places = CREATURES[source].surface.vertices
    true = true_vertex(CREATURES[source], CREATURES[target])
    return float(np.linalg.norm(places[found] - places[true], axis=1).mean())


def test_functional_maps_close_every_cycle(maps: zo.ConsistentMaps) -> None:
    for a, b, c in permutations(range(3)):
        around = maps.functional_map(a, c) @ maps.functional_map(b, a) @ maps.functional_map(c, b)
        assert np.abs(around - np.eye(40)).max() < 1e-8


def test_maps_of_given_and_other_pairs_improve_on_initial_maps(maps: zo.ConsistentMaps) -> None:
    for source, target in permutations(range(3), 2):
        begun = zo.vertex_map_of(start(source, target), BASES[source], BASES[target])
        assert error(maps.vertex_map(source, target), source, target) < 0.8 * error(begun, source, target)


def test_initial_vertex_maps_work_as_well_as_functional_maps(maps: zo.ConsistentMaps) -> None:
    true = {pair: true_vertex(CREATURES[pair[0]], CREATURES[pair[1]]) for pair in ((0, 1), (1, 2))}
    found = zo.consistent_zoomout(BASES, true, 12, 40, 4)
    assert error(found.vertex_map(0, 2), 0, 2) < 2 * error(maps.vertex_map(0, 2), 0, 2)


def test_sparse_and_dense_solvers_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    from zoomout_core.maps import consistent_zoomout as module

    given = {pair: start(*pair) for pair in ((0, 1), (1, 2), (2, 0))}
    dense = module.latent_basis(given, [basis.eigenvalues[:12] for basis in BASES])
    monkeypatch.setattr(module, "MAX_DENSE", 1)
    sparse = module.latent_basis(given, [basis.eigenvalues[:12] for basis in BASES])
    for one, other in zip(dense, sparse, strict=True):
        assert np.abs(np.abs(one) - np.abs(other)).max() < 1e-6


@pytest.mark.parametrize(
    ("pairs", "options", "said"),
    [
        (((0, 1),), {}, "2 unconnected groups"),
        (((0, 1), (1, 2)), {"k_final": 50}, "too few for k_final = 50"),
        (((0, 1), (1, 2)), {"step": 0}, "step"),
    ],
)
def test_invalid_arguments_are_refused(pairs: tuple[tuple[int, int], ...], options: dict[str, int], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        zo.consistent_zoomout(BASES, {pair: start(*pair) for pair in pairs}, **{"k_final": 40, **options})
