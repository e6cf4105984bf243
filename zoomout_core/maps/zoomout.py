# SPDX-License-Identifier: GPL-3.0-or-later
"""ZoomOut: spectral upsampling of a functional map (Melzi et al. 2019).

A small functional map gives a pointwise map, which gives a slightly larger functional map, and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve

from zoomout_core.arrays import Floats, Integers, RealsOrIntegers, check_counts, to_array
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.functional_map import (
    check_fits_bases,
    check_functional_map,
    check_vertices,
    functional_map_of,
    vertex_map_of,
)
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.runtime.summary import Summary
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.sampling import farthest_points
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ZoomOutTuning(Tuning, set_by="peers"):
    """Where upsampling begins, and the rounds on all vertices, which recover the accuracy lost by sampling.

    Attributes:
        initial_size: size of the functional map of a given pointwise map.
        finishing_size: size of the functional map at the start of the rounds on all vertices.
        finishing_rounds: number of rounds on all vertices, at evenly spaced sizes.
    """

    initial_size: int = tuned(20, "eigenfunctions", 1, 1000)
    finishing_size: int = tuned(30, "eigenfunctions", 1, 1000)
    finishing_rounds: int = tuned(5, "rounds", 1, 100)


ZOOMOUT = ZoomOutTuning()

# Sizes of functional maps, each (k_target, k_source), or one number for both.
Sizes: TypeAlias = Sequence[int | tuple[int, int]]
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
        functional_map, _ = _upsample_through(source, target, functional_map, ahead)
        functional_map, ahead = _finishing(functional_map)
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
        source, target = (_Places(each.rows, np.full(len(each.rows), 1 / len(each.rows))) for each in sampled)
        there, back = _upsample_both_ways(source, target, there, back, ahead)
        back, _ = _finishing(back)
        there, ahead = _finishing(there)
    source, target = (_Places(basis.eigenvectors, basis.areas) for basis in (basis_source, basis_target))
    there, back = _upsample_both_ways(source, target, there, back, ahead)
    return (
        Refined(there, vertex_map_of(there, basis_source, basis_target)),
        Refined(back, vertex_map_of(back, basis_target, basis_source)),
    )


def slanted_sizes(
    basis_source: SpectralBasis, basis_target: SpectralBasis, k_initial: int = 20, k_final: int = 120, step: int = 5
) -> list[tuple[int, int]]:
    """Sizes of functional maps between a part and a whole, either way, for `zoomout`.

    A part has fewer functions below a frequency, in proportion to its area (Rodola et al., Partial functional
    correspondence, 2017), so its side of the functional map grows more slowly. Both bases must have the same scale, see
    `SpectralBasis.at_area`.

    Args:
        basis_source: basis of the surface that the map lands on.
        basis_target: basis of the surface that the map starts from.
        k_initial: number of the whole's functions at the start.
        k_final: number of the whole's functions at the end.
        step: growth of this number per iteration.

    Returns:
        (k_target, k_source) of each iteration. If the target is the part, k_source = k_final k_target / r, rounded,
        where r is the number of its eigenvalues below the k_final-th one of the source. If the source is the part, the
        roles are exchanged.

    Raises:
        ValueError: a number is below one, or the bases have too few eigenfunctions.

    Example:
        >>> sizes = zo.slanted_sizes(*bases, k_initial=20, k_final=40)  # (k_target, k_source) of each round
        >>> len(sizes[0])
        2
    """
    check_counts(k_initial=k_initial, k_final=k_final, step=step)
    on_source, on_target = basis_source.eigenvalues, basis_target.eigenvalues
    k = min(k_final, len(on_source), len(on_target))
    target_is_part = on_target[k - 1] >= on_source[k - 1]
    part, whole = (on_target, on_source) if target_is_part else (on_source, on_target)
    r = int((part <= whole[min(k_final, len(whole)) - 1]).sum())
    if len(whole) < k_final or r == len(part) < k_final:
        raise ValueError(
            f"{len(whole)} eigenfunctions of the whole and {len(part)} of the part are too few for k_final = "
            f"{k_final}: compute more eigenfunctions."
        )
    r = min(r, k_final)
    grown = np.append(np.arange(min(k_initial, k_final), k_final, step), k_final)
    k_part = np.unique(np.maximum(np.rint(grown * (r / k_final)).astype(int), 1))
    k_whole = np.rint(k_part * (k_final / r)).astype(int)
    k_target, k_source = (k_part, k_whole) if target_is_part else (k_whole, k_part)
    return list(zip(k_target.tolist(), k_source.tolist(), strict=True))


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
    return _upsample_through(source, target, functional_map, _growth(functional_map.shape[-2:], k_final, step), anchors)


def _upsample_through(
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
    source: SampledBasis | _Places,
    target: SampledBasis | _Places,
    functional_map: Floats,
    anchors: Anchors | None = None,
) -> Integers:
    """(..., s_t) number of the source sample that a functional map (..., k_t, k_s) assigns to each target sample."""
    return nearest(*coordinates(target.rows, source.rows, functional_map, anchors))


class _Places(NamedTuple):
    """Eigenvectors (p, k) at vertices of a shape on which a map is refined, and their weights (p,) in its fits."""

    rows: Floats
    weights: Floats


def _upsample_both_ways(
    source: _Places, target: _Places, there: Floats, back: Floats, sizes: Sequence[tuple[int, int]]
) -> tuple[Floats, Floats]:
    """Upsample a functional map (k_target, k_source) and its inverse through sizes."""
    for k_target, k_source in sizes:
        to_source, to_target = nearest_samples(source, target, there), nearest_samples(target, source, back)
        there = _fit_to_both(source, target, to_source, to_target, k_source, k_target)
        back = _fit_to_both(target, source, to_target, to_source, k_target, k_source)
    return there, back


def _fit_to_both(
    source: _Places, target: _Places, to_source: Integers, to_target: Integers, k_source: int, k_target: int
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
        ahead = _check_sizes(sizes, basis_source, basis_target)
    else:
        check_counts(k_final=k_final, step=step)
        check_fits_bases((k_final, k_final), basis_source, basis_target)
        if start.ndim == 2 and max(start.shape) > k_final:
            raise ValueError(f"The initial functional map is {start.shape}, larger than k_final = {k_final}.")
        first = min(ZOOMOUT.initial_size, k_final), min(ZOOMOUT.initial_size, k_final)
        ahead = [first, *_growth(first, k_final, step)] if start.ndim == 1 else _growth(start.shape, k_final, step)
    if start.ndim == 2:
        check_fits_bases(start.shape, basis_source, basis_target)
        return start, ahead
    (k_target, k_source), *ahead = ahead
    return functional_map_of(start, basis_source, basis_target, k_source, k_target), ahead


def _finishing(functional_map: Floats) -> tuple[Floats, list[tuple[int, int]]]:
    """The initial map and sizes of the rounds on all vertices, in big steps, for the result on samples."""
    shape = np.array(functional_map.shape)
    start = min(1.0, ZOOMOUT.finishing_size / shape.min())
    grown = np.rint(shape * np.linspace(start, 1, ZOOMOUT.finishing_rounds)[:, None]).astype(int)
    first, *sizes = ((int(k_target), int(k_source)) for k_target, k_source in (*grown, shape))
    return functional_map[: first[0], : first[1]], sizes


def _growth(shape: tuple[int, ...], k_final: int, step: int) -> list[tuple[int, int]]:
    """The sizes (k_target, k_source) to go through; a map that starts at k_final gets one iteration there."""
    growth = list(range(step, k_final - max(shape) + 1, step))
    if not growth or growth[-1] != k_final - max(shape):
        growth.append(k_final - max(shape))
    return [(shape[0] + more, shape[1] + more) for more in growth]


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


def _check_sizes(sizes: Sizes, basis_source: SpectralBasis, basis_target: SpectralBasis) -> list[tuple[int, int]]:
    pairs: list[Any]
    try:
        pairs = [(size, size) if np.ndim(size) == 0 else tuple(size) for size in sizes]  # type: ignore[arg-type]
    except (TypeError, ValueError):
        pairs = []
    if not pairs or not all(len(pair) == 2 for pair in pairs):
        raise ValueError(f"sizes is {sizes!r}: give a list of whole numbers, or of pairs (k_target, k_source) of them.")
    for pair in pairs:
        check_fits_bases(pair, basis_source, basis_target)
    return pairs


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
