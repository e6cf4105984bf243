# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses for symmetries: pairings of extremities, descriptors, and blocks of eigenfunctions.

A symmetry is a map of a shape onto itself, so the hypotheses for maps between shapes apply here, too. They find
reflections, and maps that keep the orientation but are not the identity. Round objects and tables have repeated
eigenvalues and need a separate search. A symmetry maps every eigenspace to itself: by a sign in one dimension, by any
rotation or reflection in two. The tree of such choices is pruned as it grows, in the spirit of MapTree (Ren, Melzi,
Ovsjanikov and Wonka 2020).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product

import numpy as np
from scipy.linalg import block_diag

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.maps.functional_map import commutativity_error, orthonormality_error
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.maps.upsample import upsample
from zoomout_core.matching.hypotheses.descriptors import descriptor_hypotheses
from zoomout_core.matching.hypotheses.extremities import extremity_hypotheses
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis

# Consecutive eigenvalues whose relative difference is smaller count as repeated.
REPEATED_EIGENVALUE_GAP = 0.03
# Evenly spaced angles by which a pair of repeated eigenfunctions is rotated.
ROTATION_ANGLES = 8
# Beam search over maps of eigenspaces to themselves: minimum eigenfunctions at its leaves, and samples used.
BEAM_FUNCTIONS = 6
BEAM_SAMPLES = 200
# Number of eigenfunctions by which ZoomOut extends a map before it is scored.
LOOK_AHEAD = 5
# Maps kept at each level, with repeated eigenvalues, and otherwise.
ROUND_BEAM_WIDTH = 12
BEAM_WIDTH = 8
# Relative Frobenius norm of the difference below which two maps are the same.
SAME_MAP_DIFFERENCE = 0.5
# Leading eigenvalues that are examined, and the minimum number of repeated groups among them for a round shape.
LEADING_EIGENVALUES = 12
MIN_REPEATED_GROUPS = 2


def mirroring_pairings(shape: ShapeAnalysis) -> list[Hypothesis]:
    """Pairings of the shape's extremities with each other that turn it inside out, like a mirror.

    A mirror that takes one tip to another takes the other one back.
    """
    return extremity_hypotheses(shape, shape, sides=(-1,), wanted=_there_and_back)


def turning_pairings(shape: ShapeAnalysis) -> list[Hypothesis]:
    """Pairings that keep the orientation, for repeated eigenvalues, which rotations of order 3 or more cause.

    Half turns alone are signs of eigenfunctions, and are found as such.
    """
    return extremity_hypotheses(shape, shape, sides=(1,)) if _may_be_round(shape) else []


def mirroring_descriptors(shape: ShapeAnalysis) -> list[Hypothesis]:
    """Fits of the shape's descriptors to themselves, with the signs of pseudo-scalars changed."""
    return descriptor_hypotheses(shape, shape, sides=(-1,))


def blocks_of_eigenfunctions(shape: ShapeAnalysis) -> list[Hypothesis]:
    """Choices of signs, and of rotations for repeated eigenvalues, of the first eigenfunctions."""
    groups = _groups(shape.basis.eigenvalues[: BEAM_FUNCTIONS + 2])
    if not _may_be_round(shape):
        groups = [1] * BEAM_FUNCTIONS
    sampled = SampledBasis.of(shape.basis, shape.sampled.samples[:BEAM_SAMPLES])
    most = sampled.rows.shape[1] - LOOK_AHEAD
    width = ROUND_BEAM_WIDTH if _may_be_round(shape) else BEAM_WIDTH
    kept = [np.ones((1, 1))]
    for size in groups:
        if len(kept[0]) > BEAM_FUNCTIONS or len(kept[0]) + size > most:
            break
        kept = _grow(kept, _choices(size), width, sampled, shape.basis.eigenvalues)
    return [Hypothesis(f"blocks of {len(C)} eigenfunctions, choice {i}", C) for i, C in enumerate(kept)]


GENERATORS: tuple[Callable[[ShapeAnalysis], list[Hypothesis]], ...] = (
    mirroring_pairings,
    turning_pairings,
    mirroring_descriptors,
    blocks_of_eigenfunctions,
)


def _there_and_back(first: Integers, second: Integers) -> bool:
    """Whether a pairing of a shape's tips, as two parallel lists of numbers, is its own inverse."""
    partner = dict(zip(first.tolist(), second.tolist(), strict=True))
    return all(partner.get(there) == here for here, there in partner.items())


def _may_be_round(shape: ShapeAnalysis) -> bool:
    """Whether there may be rotations of order 3 or more: then many eigenvalues repeat; two may be close by chance."""
    sizes = _groups(shape.basis.eigenvalues[: LEADING_EIGENVALUES + 1])
    return sum(sizes) < LEADING_EIGENVALUES or sum(size > 1 for size in sizes) >= MIN_REPEATED_GROUPS


def _groups(eigenvalues: Floats) -> list[int]:
    """Sizes of the groups of equal eigenvalues, without the constant function, up to a group that is too large."""
    apart = np.flatnonzero(np.diff(eigenvalues[1:]) > REPEATED_EIGENVALUE_GAP * eigenvalues[1:-1]) + 1
    sizes = np.diff([0, *apart, len(eigenvalues) - 1])
    too_large = np.flatnonzero(sizes > 3)
    return [int(size) for size in sizes[: too_large[0] if len(too_large) else None]]


def _choices(size: int) -> list[Floats]:
    """How an eigenspace may be mapped to itself: signs, rotations in steps, or signed permutations."""
    if size == 1:
        return [np.array([[sign]]) for sign in (1.0, -1.0)]
    if size == 2:
        count = ROTATION_ANGLES
        return [_turn(2 * np.pi * step / count, mirror) for step, mirror in product(range(count), (1, -1))]
    return [np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)]


def _turn(angle: float, mirror: int) -> Floats:
    """(2, 2) rotation of the plane by an angle, or a reflection if `mirror` is -1."""
    return np.array([[np.cos(angle), -mirror * np.sin(angle)], [np.sin(angle), mirror * np.cos(angle)]])


def _grow(
    maps: list[Floats], choices: list[Floats], width: int, sampled: SampledBasis, eigenvalues: Floats
) -> list[Floats]:
    """Append each choice to each map and refine; returns the distinct maps that commute best with the Laplacian."""
    longer = np.stack([block_diag(C, choice) for C, choice in product(maps, choices)])
    k = longer.shape[-1]
    refined, _ = upsample(sampled, sampled, longer, k + LOOK_AHEAD, 1)
    grown = nearest_rotations(refined[:, :k, :k], None)
    scores = [commutativity_error(C, eigenvalues, eigenvalues) + orthonormality_error(C) for C in refined]
    kept: list[Floats] = []
    for i in np.argsort(scores, kind="stable"):
        differences = [np.linalg.norm(grown[i] - other) / np.linalg.norm(other) for other in kept]
        if len(kept) < width and min(differences, default=np.inf) > SAME_MAP_DIFFERENCE:
            kept.append(grown[i])
    return kept
