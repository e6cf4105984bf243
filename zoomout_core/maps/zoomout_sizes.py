# SPDX-License-Identifier: GPL-3.0-or-later
"""Sizes of the functional maps that ZoomOut goes through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from zoomout_core.arrays import Floats, check_counts
from zoomout_core.maps.functional_map import check_fits_bases
from zoomout_core.spectral.eigenbasis import SpectralBasis
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


def finishing_sizes(functional_map: Floats) -> tuple[Floats, list[tuple[int, int]]]:
    """The initial map and sizes of the rounds on all vertices, in big steps, for the result on samples."""
    shape = np.array(functional_map.shape)
    start = min(1.0, ZOOMOUT.finishing_size / shape.min())
    grown = np.rint(shape * np.linspace(start, 1, ZOOMOUT.finishing_rounds)[:, None]).astype(int)
    first, *sizes = ((int(k_target), int(k_source)) for k_target, k_source in (*grown, shape))
    return functional_map[: first[0], : first[1]], sizes


def growing_sizes(shape: tuple[int, ...], k_final: int, step: int) -> list[tuple[int, int]]:
    """The sizes (k_target, k_source) to go through; a map that starts at k_final gets one iteration there."""
    growth = list(range(step, k_final - max(shape) + 1, step))
    if not growth or growth[-1] != k_final - max(shape):
        growth.append(k_final - max(shape))
    return [(shape[0] + more, shape[1] + more) for more in growth]


def check_sizes(sizes: Sizes, basis_source: SpectralBasis, basis_target: SpectralBasis) -> list[tuple[int, int]]:
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
