# SPDX-License-Identifier: GPL-3.0-or-later
"""ZoomOut: spectral upsampling of a functional map (Melzi et al. 2019).

A small functional map gives a pointwise map, which gives a slightly larger functional map, and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve

from zoomout_core.arrays import Floats, Integers, RealsOrIntegers, check_counts, to_array
from zoomout_core.maps.functional_map import (
    check_fits_bases,
    check_functional_map,
    check_vertices,
    functional_map_of,
    vertex_map_of,
)
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.maps.upsample import Places, nearest_samples, upsample_through
from zoomout_core.maps.zoomout_sizes import ZOOMOUT, Sizes, check_sizes, finishing_sizes, growing_sizes
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.runtime.summary import Summary
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.sampling import farthest_points

# Number of farthest points of each shape, or vertex numbers on the source and on the target; None for all vertices.
Samples: TypeAlias = int | tuple[ArrayLike, ArrayLike] | None


@dataclass(frozen=True, eq=False, repr=False)
class Refined(Summary):
    """The result of ZoomOut.

    Attributes:
        functional_map: (k_target, k_source).
        vertex: (n_t,) the source vertex of each target vertex.
    """

    functional_map: Floats
    vertex: Integers

    def _summary(self) -> dict[str, str]:
        size = " x ".join(map(str, self.functional_map.shape))
        return {"functional map": size, "target": f"{len(self.vertex):,} vertices"}


def zoomout(
    basis_source: SpectralBasis,
    basis_target: SpectralBasis,
    initial: ArrayLike,
    k_final: int = 120,
    step: int = 5,
    samples: Samples = 500,
    sizes: Sizes | None = None,
) -> Refined:
    """Refine a functional map or a pointwise map by spectral upsampling.

    Args:
        basis_source: basis of the surface that the map lands on.
        basis_target: basis of the surface that the map starts from.
        initial: (k_t, k_s) functional map, or (n_t,) source vertex of each target vertex.
        k_final: size of the final functional map, on its larger side.
        step: growth per iteration.
        samples: number of farthest points of each shape to iterate on (at least k_final), or vertex numbers of the
            source and of the target. The last step uses all vertices; None to iterate on all vertices.
        sizes: sizes (k_target, k_source) of the functional map in each iteration, or one number for both. They replace
            k_final and step. For a part and a whole: `slanted_sizes`.

    Returns:
        The functional map at the last size and the dense vertex map.

    Raises:
        ValueError: the bases have too few eigenfunctions, the initial map does not fit them, a number is below one, or
            the functions are linearly dependent at the samples.

    Example:
        >>> C = zo.functional_map_of(truth, *bases, 10, 10)
        >>> zo.zoomout(*bases, C, k_final=40).functional_map.shape
        (40, 40)
    """
    if not (isinstance(basis_source, SpectralBasis) and isinstance(basis_target, SpectralBasis)):
        raise TypeError("Two bases are needed: compute them with `eigenbasis` for the source and the target.")
    functional_map, ahead = _start(basis_source, basis_target, initial, k_final, step, sizes)
    if samples is not None:
        source, target = _sample(basis_source, basis_target, samples, (functional_map.shape, *ahead))
        functional_map, _ = upsample_through(source, target, functional_map, ahead)
        functional_map, ahead = finishing_sizes(functional_map)
    for k_target, k_source in ahead:
        vertex = vertex_map_of(functional_map, basis_source, basis_target)
        functional_map = functional_map_of(vertex, basis_source, basis_target, k_source, k_target)
    return Refined(functional_map, vertex_map_of(functional_map, basis_source, basis_target))


def zoomout_both_ways(
    basis_source: SpectralBasis,
    basis_target: SpectralBasis,
    initial: ArrayLike,
    k_final: int = 120,
    step: int = 5,
    samples: Samples = 500,
    sizes: Sizes | None = None,
) -> tuple[Refined, Refined]:
    """Refine a map and its inverse together, so that they come closer to a bijection.

    Ren et al., MapTree: Recovering multiple solutions in the space of maps (2020). The functional map of each direction
    is fitted to the pointwise maps T and S of both directions: Phi_target C approximates Phi_source[T], and
    Phi_target[S] C approximates Phi_source.

    Args:
        basis_source: basis of the surface that the map lands on.
        basis_target: basis of the surface that the map starts from.
        initial: as for `zoomout`; the inverse starts from the transpose.
        k_final: as for `zoomout`.
        step: as for `zoomout`.
        samples: as for `zoomout`.
        sizes: as for `zoomout`; the inverse has transposed sizes.

    Returns:
        The result of `zoomout`, and the same for the map from the source to the target.

    Raises:
        ValueError: as for `zoomout`.

    Example:
        >>> C = zo.functional_map_of(truth, *bases, 10, 10)
        >>> there, back = zo.zoomout_both_ways(*bases, C, k_final=40)
    """
    there, ahead = _start(basis_source, basis_target, initial, k_final, step, sizes)
    back = there.T
    if samples is not None:
        sampled = _sample(basis_source, basis_target, samples, (there.shape, *ahead))
        source, target = (Places(each.rows, np.full(len(each.rows), 1 / len(each.rows))) for each in sampled)
        there, back = _upsample_both_ways(source, target, there, back, ahead)
        back, _ = finishing_sizes(back)
        there, ahead = finishing_sizes(there)
    source, target = (Places(basis.eigenvectors, basis.areas) for basis in (basis_source, basis_target))
    there, back = _upsample_both_ways(source, target, there, back, ahead)
    return (
        Refined(there, vertex_map_of(there, basis_source, basis_target)),
        Refined(back, vertex_map_of(back, basis_target, basis_source)),
    )


def _upsample_both_ways(
    source: Places, target: Places, there: Floats, back: Floats, sizes: Sequence[tuple[int, int]]
) -> tuple[Floats, Floats]:
    """Upsample a functional map (k_target, k_source) and its inverse through sizes."""
    for k_target, k_source in sizes:
        to_source, to_target = nearest_samples(source, target, there), nearest_samples(target, source, back)
        there = _fit_to_both(source, target, to_source, to_target, k_source, k_target)
        back = _fit_to_both(target, source, to_target, to_source, k_target, k_source)
    return there, back


def _fit_to_both(
    source: Places, target: Places, to_source: Integers, to_target: Integers, k_source: int, k_target: int
) -> Floats:
    """(k_target, k_source) functional map that best fits pointwise maps of both directions (least squares)."""
    along, against = target.rows[:, :k_target], target.rows[to_target, :k_target]
    weighted, weighted_against = target.weights[:, None] * along, source.weights[:, None] * against
    return np.asarray(
        solve(
            weighted.T @ along + weighted_against.T @ against,
            weighted.T @ source.rows[to_source, :k_source] + weighted_against.T @ source.rows[:, :k_source],
            assume_a="pos",
        )
    )


def _start(
    basis_source: SpectralBasis,
    basis_target: SpectralBasis,
    initial: ArrayLike,
    k_final: int,
    step: int,
    sizes: Sizes | None,
) -> tuple[Floats, list[tuple[int, int]]]:
    """The initial functional map and the sizes to go through, see `zoomout`."""
    start = check_start(initial, len(basis_source.areas), len(basis_target.areas))
    if sizes is not None:
        ahead = check_sizes(sizes, basis_source, basis_target)
    else:
        check_counts(k_final=k_final, step=step)
        check_fits_bases((k_final, k_final), basis_source, basis_target)
        if start.ndim == 2 and max(start.shape) > k_final:
            raise ValueError(f"The initial functional map is {start.shape}, larger than k_final = {k_final}.")
        first = min(ZOOMOUT.initial_size, k_final), min(ZOOMOUT.initial_size, k_final)
        ahead = (
            [first, *growing_sizes(first, k_final, step)]
            if start.ndim == 1
            else growing_sizes(start.shape, k_final, step)
        )
    if start.ndim == 2:
        check_fits_bases(start.shape, basis_source, basis_target)
        return start, ahead
    (k_target, k_source), *ahead = ahead
    return functional_map_of(start, basis_source, basis_target, k_source, k_target), ahead


def _sample(
    basis_source: SpectralBasis, basis_target: SpectralBasis, samples: Samples, sizes: Sequence[tuple[int, ...]]
) -> tuple[SampledBasis, SampledBasis]:
    """Both bases at the user's samples, or at farthest points; raises if the functions are linearly dependent there."""
    k_target, k_source = np.max(sizes, axis=0)
    if isinstance(samples, int | np.integer):
        check_counts(samples=samples)
        count = max(int(samples), k_target, k_source)
        samples = _farthest_vertices(basis_source, count), _farthest_vertices(basis_target, count)
    try:
        on_source, on_target = samples  # type: ignore[misc]
    except (TypeError, ValueError):
        raise ValueError(
            f"samples is {samples!r}: give a number, None, or vertex numbers on the source and on the target."
        ) from None
    return (
        _check_samples(on_source, basis_source, k_source, "source"),
        _check_samples(on_target, basis_target, k_target, "target"),
    )


def _farthest_vertices(basis: SpectralBasis, count: int) -> Integers:
    used = np.flatnonzero(basis.areas > 0)
    return used[farthest_points(basis.points[used], count)]


def _check_samples(samples: ArrayLike, basis: SpectralBasis, k: int, side: str) -> SampledBasis:
    sampled = SampledBasis.of(basis, vertex_numbers(samples, len(basis.areas), f"Samples of the {side}"))
    if sampled.rows.shape[1] < k:
        raise ValueError(
            f"The {len(sampled.samples)} samples of the {side} cannot distinguish its {k} functions: give at least "
            "as many samples as functions, spread over the shape."
        )
    return sampled


def check_start(initial: ArrayLike, n_source: int, n_target: int) -> RealsOrIntegers:
    """Check a user's initial map: a functional map (k_t, k_s), or source vertices (n_t,).

    Raises:
        ValueError: it is neither, or not between shapes with these numbers of vertices.
    """
    start = to_array(initial, "The initial map")
    if start.ndim == 1:
        return check_vertices(start, n_source, n_target)
    if start.ndim != 2:
        raise ValueError(f"The initial map must be a vector or a matrix, not of shape {start.shape}.")
    return check_functional_map(start)
