# SPDX-License-Identifier: GPL-3.0-or-later
"""Deblurring with upsampling: Algorithm 1 of Melzi et al. 2019, after Ezuz and Ben-Chen 2017.

Ezuz and Ben-Chen, Deblurring and denoising of maps between shapes (2017), convert a functional map C to a vertex map T
by transporting the target's eigenfunctions: T(p) = argmin_q ||Phi_source(q) - Phi_target(p) C||. ZoomOut transports the
source's: argmin_q ||Phi_source(q) C' - Phi_target(p)||. The loop around it is the same.
"""

from __future__ import annotations

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.zoomout import Refined
from zoomout_core.spectral.eigenbasis import SpectralBasis


def deblur(
    basis_source: SpectralBasis,
    basis_target: SpectralBasis,
    initial: Integers,
    k_initial: int = 20,
    k_final: int = 120,
    step: int = 5,
) -> Refined:
    """Refine a vertex map by upsampling with the conversion of Ezuz and Ben-Chen.

    Args:
        basis_source: at least k_final eigenfunctions of the source, on which the images are.
        basis_target: as many of the target.
        initial: (n_t,) source vertex of each target vertex.
        k_initial: size of the first functional map.
        k_final: size of the last; it differs from k_initial by a multiple of `step`.
        step: growth in an iteration.
    """
    vertex = initial
    for k in range(k_initial, k_final + 1, step):
        functional_map = functional_map_of(vertex, basis_source, basis_target, k, k)
        vertex = deblur_map(functional_map, basis_source, basis_target)
    return Refined(functional_map, vertex)


def deblur_map(functional_map: Floats, basis_source: SpectralBasis, basis_target: SpectralBasis) -> Integers:
    """(n_t,) vertex map of a functional map (k_t, k_s), by transporting the target's eigenfunctions to the source."""
    k_target, k_source = functional_map.shape
    return nearest(basis_target.eigenvectors[:, :k_target] @ functional_map, basis_source.eigenvectors[:, :k_source])
