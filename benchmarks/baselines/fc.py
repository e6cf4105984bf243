# SPDX-License-Identifier: GPL-3.0-or-later
"""Functional correspondence (FC): a functional map from descriptors, and spectral ICP.

Ovsjanikov, Ben-Chen, Solomon, Butscher and Guibas, Functional maps: a flexible representation of maps between shapes
(2012). C F = G for the descriptors F and G of the two shapes and Lambda_target C = C Lambda_source, in the
least-squares sense; then nearest neighbours alternate with the nearest orthonormal matrix. Both shapes must be whole.

ZoomOut's comparison on partial shapes abbreviates its methods as PFM, GTM, FC and CPD. It does not spell FC out;
we take it for the method that "partial functional correspondence" (PFM) extends to parts. "Fully spectral
partial matching" (Litany et al. 2017) is the other candidate; its own authors write FSPM.
"""

from __future__ import annotations

import numpy as np

import zoomout_core as zo
from benchmarks.baselines.bcicp import Side
from benchmarks.baselines.spectral_icp import spectral_icp
from zoomout_core.arrays import Integers
from zoomout_core.maps.functional_map import vertex_map_of

# Size of the functional map, and radius of the SHOT descriptors relative to the square root of the source's area.
SIZE, RADIUS = 50, 0.1
# Weight of the Laplacian relative to that of the descriptors.
COMMUTATIVITY = 0.03


def fc(source: Side, target: Side, k: int = SIZE, iterations: int = 10) -> Integers:
    """Match two surfaces by SHOT descriptors.

    Args:
        source: the surface whose vertices are the images.
        target: the surface to be mapped, in the same unit; both need at least k eigenfunctions.
        k: size of the functional map.
        iterations: of spectral ICP, at least one.

    Returns:
        (n_t,) source vertex of each target vertex.
    """
    share = target.surface.area / source.surface.area
    of_source, of_target = zo.shot(source.surface, RADIUS), zo.shot(target.surface, RADIUS / np.sqrt(share))
    functional_map = zo.fit_functional_map(
        source.basis,
        target.basis.at_area(share),
        of_source,
        of_target,
        k,
        descriptor_weight=1.0,
        multiplication_weight=0.0,
        laplacian_weight=COMMUTATIVITY,
    )
    initial = vertex_map_of(functional_map, source.basis, target.basis)
    return spectral_icp(source.basis, target.basis, initial, k, iterations).vertex
