"""Functional maps: linear maps from functions on the source to functions on the target.

Ovsjanikov et al., Functional maps (2012). Here C has shape (k_target, k_source), and with the pointwise map T
from target to source C = Phi_target' A_target Phi_source[T].
"""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.nearest import nearest
from zoomout_core.spectral.eigenbasis import SpectralBasis


def functional_map_of(
    vertex: Integers, basis_source: SpectralBasis, basis_target: SpectralBasis, k_source: int, k_target: int
) -> Floats:
    """(k_target, k_source) functional map of a vertex map (n_t,), weighted by the target's areas."""
    weighted = basis_target.areas[:, None] * basis_source.eigenvectors[vertex, :k_source]
    return basis_target.eigenvectors[:, :k_target].T @ weighted


def vertex_map_of(functional_map: Floats, basis_source: SpectralBasis, basis_target: SpectralBasis) -> Integers:
    """(n_t,) vertex map of a functional map (k_t, k_s): the ZoomOut conversion."""
    k_target, k_source = functional_map.shape
    embedded = basis_source.eigenvectors[:, :k_source] @ functional_map.T
    return nearest(basis_target.eigenvectors[:, :k_target], embedded)


def commutativity_error(functional_map: Floats, eigenvalues_source: Floats, eigenvalues_target: Floats) -> float:
    """||Lambda_target C - C Lambda_source||, relative to the largest eigenvalue; zero for an isometry."""
    k_target, k_source = functional_map.shape
    difference = eigenvalues_target[:k_target, None] - eigenvalues_source[:k_source]
    largest = max(eigenvalues_target[k_target - 1], eigenvalues_source[k_source - 1])
    return float(np.linalg.norm(difference * functional_map) / largest)


def frequency_error(functional_map: Floats, eigenvalues_source: Floats, eigenvalues_target: Floats) -> float:
    """Mean difference of frequency (square root of the eigenvalue) that C couples, relative to the highest."""
    k_target, k_source = functional_map.shape
    source, target = np.sqrt(eigenvalues_source[:k_source]), np.sqrt(eigenvalues_target[:k_target])
    coupled = np.abs(target[:, None] - source) * np.abs(functional_map)
    return float(coupled.sum() / (k_target * max(source[-1], target[-1])))


def orthonormality_error(functional_map: Floats) -> float:
    """ZoomOut's energy: the sum over k of ||C_k' C_k - I||^2 / k over the leading square blocks."""
    energy = 0.0
    for k in range(1, min(functional_map.shape) + 1):
        block = functional_map[:k, :k]
        energy += float(np.linalg.norm(block.T @ block - np.eye(k)) ** 2) / k
    return energy
