# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial maps that methods of refinement are given, made of descriptors and landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import zoomout_core as zo
from benchmarks.datasets import PairOfMeshes
from zoomout_core.arrays import Integers
from zoomout_core.mesh.surface import Surface

# Size of fitted functional maps, and eigenfunctions that their signatures are made of.
K_INITIAL, K_SIGNATURES = 20, 200
# Places that are given, drawn at random.
LANDMARKS = 2
# Principal components of SHOT descriptors that are used.
PRINCIPAL = 60
# Energies of wave kernel signatures, and of the kernels from each landmark.
ENERGIES = 100


def from_signatures(source: Surface, target: Surface) -> Integers:
    """(n_t,) the paper's first initial map: from wave kernel signatures, keeping the orientation."""
    bases = [zo.eigenbasis(surface, K_SIGNATURES) for surface in (source, target)]
    signatures = [zo.wave_kernel_signature(basis) for basis in bases]
    of_source, of_target = (
        zo.orientation_operators(surface, basis, of_surface, K_INITIAL)
        for surface, basis, of_surface in zip((source, target), bases, signatures, strict=True)
    )
    functional_map = zo.fit_functional_map(
        bases[0], bases[1], signatures[0], signatures[1], K_INITIAL, orientation_operators=(of_source, of_target)
    )
    return zo.vertex_map_of(functional_map, bases[0], bases[1])


def from_landmarks(
    source: zo.SpectralBasis, target: zo.SpectralBasis, on_source: ArrayLike, on_target: ArrayLike
) -> Integers:
    """(n_t,) the map of wave kernel signatures and of wave kernels from landmarks.

    Args:
        source: K_SIGNATURES eigenfunctions of the shape that the map lands on.
        target: of the one that it starts from.
        on_source: (l,) vertices of the former,
        on_target: (l,) and those of the latter at the same places.
    """
    of_source, of_target = (
        np.hstack([zo.wave_kernel_signature(basis, ENERGIES), zo.wave_kernel_map(basis, landmarks, ENERGIES)])
        for basis, landmarks in ((source, on_source), (target, on_target))
    )
    return zo.vertex_map_of(zo.fit_functional_map(source, target, of_source, of_target, K_INITIAL), source, target)


def landmarks_of(pair: PairOfMeshes, seed: int = 0) -> tuple[Integers, Integers]:
    """(2,) known places of a pair, drawn at random: vertices of the source, and of the target."""
    drawn = np.random.default_rng(seed).choice(len(pair.target_vertex), LANDMARKS, replace=False)
    return pair.source_vertex[drawn], pair.target_vertex[drawn]


def from_shot(source: Surface, target: Surface) -> Integers:
    """(n_t,) the map of SHOT descriptors in balls of a tenth and of a fifth of the root of the area.

    Of their 704 components the principal ones are taken, of both shapes together.
    """
    basis_source, basis_target = zo.eigenbasis(source, K_SIGNATURES), zo.eigenbasis(target, K_SIGNATURES)
    described = [np.hstack([zo.shot(each, radius) for radius in (0.1, 0.2)]) for each in (source, target)]
    axes = np.linalg.eigh(np.cov(np.vstack(described).T))[1][:, -PRINCIPAL:]
    of_source, of_target = (each @ axes for each in described)
    functional_map = zo.fit_functional_map(basis_source, basis_target, of_source, of_target, K_INITIAL)
    return zo.vertex_map_of(functional_map, basis_source, basis_target)
