# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial maps for refinement methods, from descriptors and landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import zoomout_core as zo
from benchmarks.datasets import PairOfMeshes
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import Surface

# Size of fitted functional maps, and number of eigenfunctions in their signatures.
K_INITIAL, K_SIGNATURES = 20, 200
# Number of random landmarks.
LANDMARKS = 2
# Largest number of principal components of descriptors.
PRINCIPAL = 60
# Numbers of energies of wave kernel signatures, and of the kernels at each landmark.
ENERGIES = 100


def from_signatures(source: Surface, target: Surface) -> Integers:
    """(n_t,) the paper's first initial map: from wave kernel signatures, preserving orientation."""
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
    """(n_t,) the map from wave kernel signatures and wave kernels at landmarks.

    Args:
        source: K_SIGNATURES eigenfunctions of the shape with the images.
        target: those of the shape to be mapped.
        on_source: (l,) source vertices.
        on_target: (l,) target vertices at the same places.
    """
    of_source, of_target = (
        np.hstack([zo.wave_kernel_signature(basis, ENERGIES), zo.wave_kernel_map(basis, landmarks, ENERGIES)])
        for basis, landmarks in ((source, on_source), (target, on_target))
    )
    return zo.vertex_map_of(zo.fit_functional_map(source, target, of_source, of_target, K_INITIAL), source, target)


def landmarks_of(pair: PairOfMeshes, seed: int = 0) -> tuple[Integers, Integers]:
    """(2,) source and (2,) target vertices at random known places of a pair."""
    drawn = np.random.default_rng(seed).choice(len(pair.target_vertex), LANDMARKS, replace=False)
    return pair.source_vertex[drawn], pair.target_vertex[drawn]


def from_shot(source: Surface, target: Surface) -> Integers:
    """(n_t,) the map from SHOT descriptors with radii of a tenth and a fifth of the square root of the area."""
    of_source, of_target = (np.hstack([zo.shot(each, radius) for radius in (0.1, 0.2)]) for each in (source, target))
    return from_descriptors(source, target, of_source, of_target)


def from_descriptors(source: Surface, target: Surface, of_source: Floats, of_target: Floats) -> Integers:
    """(n_t,) the map from descriptors (n_s, d) and (n_t, d).

    They are reduced to the principal components of both shapes together.
    """
    basis_source, basis_target = zo.eigenbasis(source, K_SIGNATURES), zo.eigenbasis(target, K_SIGNATURES)
    covariance = np.atleast_2d(np.cov(np.vstack([of_source, of_target]).T))
    axes = np.linalg.eigh(covariance)[1][:, -PRINCIPAL:]
    functional_map = zo.fit_functional_map(basis_source, basis_target, of_source @ axes, of_target @ axes, K_INITIAL)
    return zo.vertex_map_of(functional_map, basis_source, basis_target)
