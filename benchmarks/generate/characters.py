# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets of characters of several kinds, with different proportions, poses and meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, product
from pathlib import Path

import numpy as np
from tqdm import tqdm

from zoomout_core.arrays import Integers
from zoomout_core.mesh.surface import Surface

from .bodies import Individual, build_template, draw_individual, posed_mesh
from .folder import Pair, known_on_all, spread, write_set
from .kinds import KINDS

POSES = "ab"
# Exponent of the factors of proportions for non-isometric sets.
STYLISED = 2.0


def write_characters(output: Path, seed: int, count: int, kinds: Sequence[str] = tuple(KINDS)) -> int:
    """Write a set of nearly isometric individuals, with modest differences in proportions.

    Args:
        output: folder of the set.
        seed: for all random choices.
        count: number of pairs of different individuals for each kind.
        kinds: names of the kinds.

    Returns:
        The number of poses that were rejected because they did not give one closed body.

    Raises:
        GenerationError: limbs of a kind touch in all poses tried.
    """
    return _write(output, seed, count, kinds, 1.0, spread)


def write_stylised_characters(output: Path, seed: int, count: int, kinds: Sequence[str] = tuple(KINDS)) -> int:
    """Write a set with exaggerated proportions, and pairs of those individuals that differ most."""
    return _write(output, seed, count, kinds, STYLISED, lambda pairs, most: pairs[:most])


def _write(
    output: Path,
    seed: int,
    count: int,
    kinds: Sequence[str],
    exaggeration: float,
    choose: Callable[[list[Pair], int], list[Pair]],
) -> int:
    meshes: dict[str, Surface] = {}
    correspondence: dict[str, Integers] = {}
    pairs: list[Pair] = []
    refused = 0
    for kind in kinds:
        random = np.random.default_rng([seed, *kind.encode()])
        template = build_template(KINDS[kind])
        individuals = {
            f"{kind}_{i}": draw_individual(template, random, exaggeration, dressed=i % 2 == 1)
            for i in range(_individuals_for(2 * count))
        }
        places: dict[str, Integers] = {}
        for name, pose in tqdm(list(product(individuals, POSES)), desc=kind, leave=False):
            # A separate random stream, so that one more vertex in one mesh changes no other.
            mesh = posed_mesh(template, individuals[name], random.spawn(1)[0])
            meshes[name + pose] = mesh.surface
            places[name + pose] = mesh.places
            if KINDS[kind].symmetric:
                places[f"{name}{pose}.sym"] = mesh.mirrored
            refused += mesh.refused
        correspondence |= known_on_all(places, random)
        pairs += choose(all_pairs(individuals), count)
    write_set(output, meshes, correspondence, pairs)
    return refused


def _individuals_for(pairs: int) -> int:
    """Number of individuals needed for a number of pairs of different ones."""
    number = 2
    while number * (number - 1) // 2 * len(POSES) ** 2 < pairs:
        number += 1
    return number


def all_pairs(individuals: dict[str, Individual]) -> list[Pair]:
    """All pairs of meshes of different individuals, sorted by decreasing difference in proportions."""

    def difference(pair: Pair) -> float:
        return float(np.linalg.norm(individuals[pair[0]].traits - individuals[pair[1]].traits))

    different = sorted(combinations(individuals, 2), key=difference, reverse=True)
    return [(first + a, second + b) for first, second in different for a, b in product(POSES, POSES)]
