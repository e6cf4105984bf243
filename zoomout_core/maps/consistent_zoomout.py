# SPDX-License-Identifier: GPL-3.0-or-later
"""Consistent ZoomOut: maps of a whole collection that agree along cycles (Huang, Ren, Wonka, Ovsjanikov 2020).

All functional maps are composed through one latent space, whose basis is computed from the known maps. Maps through it
close every cycle. They are upsampled to more functions as ZoomOut does for a single map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import bsr_array
from scipy.sparse.linalg import eigsh

from zoomout_core.arrays import Floats, Integers, check_counts
from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.mesh.triangles import components
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.sampling import farthest_points

# Numbers of two shapes: the source, which the map lands on, and the target, which it starts from.
PairOfShapes: TypeAlias = tuple[int, int]
# Minimum number of farthest points of each shape that the iterations run on.
SAMPLES = 500
# Rows of the latent problem up to which a dense solver is used; for larger ones the sparse solver is faster.
MAX_DENSE = 2000
# Shift of the sparse problem, which makes it factorisable: its smallest eigenvalues are near zero.
SHIFT = -1e-3


@dataclass(frozen=True, eq=False)
class ConsistentMaps:
    """Maps between all shapes of a collection that agree along every cycle.

    Attributes:
        latent: for each shape the latent functions as combinations (k, d) of its functions: a canonical consistent
            latent basis.
        bases: the given bases.

    Example:
        >>> C = zo.functional_map_of(truth, *bases, 20, 20)
        >>> zo.consistent_zoomout(bases, {(0, 1): C, (1, 0): C.T}, k_final=30).latent[0].shape[0]
        30
    """

    latent: list[Floats]
    bases: Sequence[SpectralBasis]

    def functional_map(self, source: int, target: int) -> Floats:
        """(k, k) functional map of the target to the source, through the latent space."""
        return np.asarray(self.latent[target] @ np.linalg.pinv(self.latent[source]))

    def vertex_map(self, source: int, target: int) -> Integers:
        """(n_t,) the source vertex of each target vertex."""
        embedded = [
            self.bases[shape].eigenvectors[:, : len(self.latent[shape])] @ self.latent[shape]
            for shape in (target, source)
        ]
        return nearest(*embedded)


def consistent_zoomout(
    bases: Sequence[SpectralBasis],
    maps: Mapping[PairOfShapes, Floats | Integers],
    k_initial: int = 20,
    k_final: int = 120,
    step: int = 5,
    samples: int = SAMPLES,
) -> ConsistentMaps:
    """Refine maps between the shapes of a collection together, so that they agree along cycles.

    Args:
        bases: bases of the shapes.
        maps: for pairs (source, target) of shape numbers, which must connect all shapes: functional maps (k_t, k_s), or
            (n_t,) the source vertex of each target vertex.
        k_initial: functions of each shape at the start.
        k_final: functions of each shape at the end.
        step: growth per iteration.
        samples: farthest points of each shape that the iterations run on; at least k_final are taken.

    Returns:
        The maps between all shapes, through a latent space of k_final functions.

    Raises:
        ValueError: the pairs do not connect all shapes, a number is below one, or a basis has too few functions.

    Example:
        >>> C = zo.functional_map_of(truth, *bases, 20, 20)
        >>> maps = zo.consistent_zoomout(bases, {(0, 1): C, (1, 0): C.T}, k_final=30)
    """
    check_counts(k_initial=k_initial, k_final=k_final, step=step, samples=samples)
    if not bases or not all(isinstance(basis, SpectralBasis) for basis in bases):
        raise TypeError("Give the bases of the shapes, see `eigenbasis`, in a list.")
    fewest = min(len(basis.eigenvalues) for basis in bases)
    if k_final > fewest:
        raise ValueError(f"A basis has {fewest} eigenfunctions, too few for k_final = {k_final}: compute more of them.")
    groups = int(components(np.array(list(maps)).reshape(-1, 2).astype(np.int64), len(bases)).max()) + 1
    if groups > 1:
        raise ValueError(
            f"The pairs split the {len(bases)} shapes into {groups} unconnected groups: add pairs that connect them."
        )
    sampled = [SampledBasis.of(basis, farthest_points(basis.points, max(samples, k_final))) for basis in bases]
    k_initial = min(k_initial, k_final, *(min(each.shape) for each in maps.values() if each.ndim == 2))
    functional_maps: dict[PairOfShapes, Floats] = {
        (source, target): np.asarray(given[:k_initial, :k_initial], dtype=np.float64)
        if given.ndim == 2
        else functional_map_of(given.astype(np.int64), bases[source], bases[target], k_initial, k_initial)
        for (source, target), given in maps.items()
    }
    k = len(next(iter(functional_maps.values())))
    while True:
        latent = latent_basis(functional_maps, [basis.eigenvalues[:k] for basis in bases])
        if k == k_final:
            return ConsistentMaps(latent, bases)
        k = min(k + step, k_final)
        embedded = [each.rows[:, : len(functions)] @ functions for each, functions in zip(sampled, latent, strict=True)]
        functional_maps = {
            (source, target): sampled[target].fit(
                sampled[source].rows[nearest(embedded[target], embedded[source]), :k], k
            )
            for source, target in functional_maps
        }


def latent_basis(functional_maps: Mapping[PairOfShapes, Floats], eigenvalues: Sequence[Floats]) -> list[Floats]:
    """A canonical consistent latent basis of functional maps (Huang, Achlioptas, Guibas, Ovsjanikov 2019).

    It minimises the sum of ||C Y_source - Y_target||^2 over the maps C (k, k), subject to a sum of Y^T Y over the
    shapes that is the identity. It is rotated so that the mean of Y^T diag(eigenvalues) Y is diagonal: its functions
    are ordered like those of each shape. The columns (k, k) for each shape are its latent functions.
    """
    k, count = len(eigenvalues[0]), len(eigenvalues)
    diagonal = np.zeros((count, k, k))
    couplings = [-block for C in functional_maps.values() for block in (C.T, C)]
    places = [place for source, target in functional_maps for place in ((source, target), (target, source))]
    for (source, target), C in functional_maps.items():
        diagonal[source] += C.T @ C
        diagonal[target] += np.eye(k)
    blocks = np.concatenate([diagonal, couplings])
    rows, columns = np.array([*((shape, shape) for shape in range(count)), *places]).T
    order = np.lexsort((columns, rows))
    starts = np.searchsorted(rows[order], np.arange(count + 1))
    matrix = bsr_array((blocks[order], columns[order], starts), shape=(count * k, count * k))
    if count * k <= MAX_DENSE:
        _, vectors = eigh(matrix.toarray(), subset_by_index=(0, k - 1))
    else:
        start = np.ones(count * k)
        _, vectors = eigsh(matrix.tocsc(), k, sigma=SHIFT, v0=start)
    latent = vectors.reshape(count, k, k)
    frequencies = sum(each.T @ (values[:, None] * each) for each, values in zip(latent, eigenvalues, strict=True))
    _, turned = eigh(frequencies)
    # Give the maps through the latent space the norm of the given ones.
    return [np.asarray(np.sqrt(count) * each @ turned) for each in latent]
