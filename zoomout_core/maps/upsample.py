# SPDX-License-Identifier: GPL-3.0-or-later
"""Upsampling of functional maps on samples, the core of ZoomOut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.maps.zoomout_sizes import growing_sizes


def upsample(
    source: SampledBasis,
    target: SampledBasis,
    functional_map: Floats,
    k_final: int,
    step: int,
    anchors: Anchors | None = None,
) -> tuple[Floats, Integers]:
    """Upsample a small functional map (k_target, k_source) on samples to k_final functions on the larger side.

    A stack of maps is faster than one after the other, but takes no anchors: values at the samples that should agree.

    Returns:
        The functional map, and (s_t,) for each target sample the number of its source sample; or stacks of both.
    """
    return upsample_through(
        source, target, functional_map, growing_sizes(functional_map.shape[-2:], k_final, step), anchors
    )


def upsample_through(
    source: SampledBasis,
    target: SampledBasis,
    functional_map: Floats,
    sizes: Sequence[tuple[int, int]],
    anchors: Anchors | None = None,
) -> tuple[Floats, Integers]:
    """Upsample on samples through given sizes, see `upsample`."""
    for k_target, k_source in sizes:
        match = nearest_samples(source, target, functional_map, anchors)
        functional_map = target.fit(source.rows[match, :k_source], k_target)
    return functional_map, nearest_samples(source, target, functional_map, anchors)


def nearest_samples(
    source: SampledBasis | Places,
    target: SampledBasis | Places,
    functional_map: Floats,
    anchors: Anchors | None = None,
) -> Integers:
    """(..., s_t) number of the source sample that a functional map (..., k_t, k_s) assigns to each target sample."""
    return nearest(*coordinates(target.rows, source.rows, functional_map, anchors))


class Places(NamedTuple):
    """Eigenvectors (p, k) at vertices of a shape on which a map is refined, and their weights (p,) in its fits."""

    rows: Floats
    weights: Floats
