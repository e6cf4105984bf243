# SPDX-License-Identifier: GPL-3.0-or-later
"""ZoomOut on samples as in its paper: all iterations on samples, then one conversion to a dense map.

Melzi et al. 2019, section 4.4. The core's `zoomout_core.zoomout` with samples adds a few iterations on all vertices,
which recover the accuracy that sampling costs.
"""

from __future__ import annotations

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.maps.upsample import upsample
from zoomout_core.maps.zoomout import Refined
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.sampling import farthest_points


def sampled_zoomout(
    source: SpectralBasis,
    target: SpectralBasis,
    initial: Floats | Integers,
    k_final: int,
    step: int,
    samples: int = 500,
    k_initial: int = 20,
) -> Refined:
    """Refine a functional map (k_t, k_s), or a vertex map (n_t,) by its functional map of size k_initial.

    Args:
        source: basis of the surface with the images.
        target: basis of the surface to be mapped.
        initial: the map.
        k_final: size of the final functional map.
        step: its increase per iteration.
        samples: number of farthest points of each surface.
        k_initial: size of the functional map of a vertex map.
    """
    on_source, on_target = (
        SampledBasis.of(basis, farthest_points(basis.points, samples)) for basis in (source, target)
    )
    start = initial.astype(float)
    if initial.ndim == 1:
        start = functional_map_of(initial, source, target, k_initial, k_initial)
    functional_map, _ = upsample(on_source, on_target, start, k_final, step)
    return Refined(functional_map, vertex_map_of(functional_map, source, target))
