"""ZoomOut: spectral upsampling of a functional map (Melzi et al. 2019).

A small functional map gives a pointwise map, the pointwise map a slightly larger functional map, and so on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import qr, solve_triangular

from zoomout_core.arrays import Floats, Integers, RealsOrIntegers, check_counts
from zoomout_core.maps.anchors import Anchors, beside
from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.maps.nearest import nearest
from zoomout_core.mesh.surface import vertex_numbers
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.sampling import farthest_points
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ZoomOutTuning(Tuning, set_by="peers"):
    """Where upsampling begins, and the rounds on all vertices, which recover the exactness that sampling costs.

    Attributes:
        initial_size: of the functional map of a given pointwise map.
        finishing_size: of the functional map that the rounds on all vertices begin with.
        finishing_rounds: on all vertices, at sizes that are evenly spread.
    """

    initial_size: int = tuned(20, "eigenfunctions", 1, 1000)
    finishing_size: int = tuned(30, "eigenfunctions", 1, 1000)
    finishing_rounds: int = tuned(5, "rounds", 1, 100)


ZOOMOUT = ZoomOutTuning()


@dataclass(frozen=True, eq=False)
class Refined:
    """What ZoomOut returns.

    Attributes:
        functional_map: (k_target, k_source).
        vertex: (n_t,) the source vertex of each target vertex.
    """

    functional_map: Floats
    vertex: Integers


@dataclass(frozen=True, eq=False)
class SampledBasis:
    """A basis at samples, factorised once so that the least squares of every k are a triangular solve.

    Attributes:
        samples: (s,) vertex numbers.
        rows: (s, k) eigenvectors at the samples.
        Q: (s, k) orthonormal; with an upper triangular R its leading columns factorise the leading ones of `rows`.
        R_inverse: (k, k) upper triangular; the inverse of a leading block of R is the same block of this.
    """

    samples: Integers
    rows: Floats
    Q: Floats
    R_inverse: Floats

    @classmethod
    def of(cls, basis: SpectralBasis, samples: Integers) -> SampledBasis:
        """The basis at the samples (s,); at least as many samples as eigenfunctions are needed."""
        rows = basis.eigenvectors[samples]
        Q, R = qr(rows, mode="economic")
        return cls(samples, rows, Q, solve_triangular(R, np.eye(len(R))))

    def fit(self, values: Floats, k: int) -> Floats:
        """(..., k, d) least-squares coefficients of values (..., s, d) at the samples."""
        return np.asarray(self.R_inverse[:k, :k] @ (self.Q[:, :k].T @ values))


def zoomout(
    basis_source: SpectralBasis,
    basis_target: SpectralBasis,
    initial: ArrayLike,
    k_final: int = 120,
    step: int = 5,
    samples: int | None = 500,
) -> Refined:
    """Refine a functional map or a pointwise map by spectral upsampling.

    Args:
        basis_source: of the surface that the map lands on.
        basis_target: of the surface that the map starts from.
        initial: (k_t, k_s) functional map, or (n_t,) source vertex of each target vertex.
        k_final: size of the final functional map.
        step: by how much it grows in an iteration.
        samples: iterate on this many farthest points of each shape (at least k_final are taken), and finish on
            all vertices; None to iterate on all vertices throughout.

    Returns:
        The functional map at k_final and the dense vertex map.

    Raises:
        ValueError: the bases hold fewer than k_final eigenfunctions, the initial map does not fit them, or a
            number is below one.
    """
    initial = checked_start(initial, len(basis_source.areas), len(basis_target.areas))
    available = min(len(basis_source.eigenvalues), len(basis_target.eigenvalues))
    _check_sizes(available, initial.shape, k_final, step, samples)
    if initial.ndim == 1:
        k = min(ZOOMOUT.initial_size, k_final)
        initial = functional_map_of(initial, basis_source, basis_target, k, k)
    if samples is None:
        return _dense(basis_source, basis_target, initial, k_final, step)
    count = max(samples, k_final)
    source = SampledBasis.of(basis_source, _samples(basis_source, count))
    target = SampledBasis.of(basis_target, _samples(basis_target, count))
    functional_map, _ = upsample(source, target, initial, k_final, step)
    return _finished(basis_source, basis_target, functional_map)


def upsample(
    source: SampledBasis,
    target: SampledBasis,
    functional_map: Floats,
    k_final: int,
    step: int,
    anchors: Anchors | None = None,
) -> tuple[Floats, Integers]:
    """The loop on samples: from a small functional map to one with k_final functions on the larger side.

    Args:
        source: samples of the shape that the map lands on.
        target: samples of the shape that the map starts from.
        functional_map: (k_target, k_source), or a stack of them, which takes less time than one after the other.
        k_final: size to reach.
        step: growth in an iteration.
        anchors: given at the samples; what else should agree under the map. Not for a stack.

    Returns:
        The functional map, and (s_t,) for each target sample the number of its source sample; or stacks of both.
    """
    for k_target, k_source in _sizes(functional_map.shape[-2:], k_final, step):
        match = nearest_samples(source, target, functional_map, anchors)
        functional_map = target.fit(source.rows[match, :k_source], k_target)
    return functional_map, nearest_samples(source, target, functional_map, anchors)


def nearest_samples(
    source: SampledBasis, target: SampledBasis, functional_map: Floats, anchors: Anchors | None = None
) -> Integers:
    """(..., s_t) number of the source sample that a functional map (..., k_t, k_s) assigns to each target sample."""
    k_target, k_source = functional_map.shape[-2:]
    embedded = source.rows[:, :k_source] @ np.swapaxes(functional_map, -1, -2)
    if anchors is None:
        return nearest(target.rows[:, :k_target], embedded)
    return nearest(beside(target.rows[:, :k_target], anchors.target), beside(embedded, anchors.source))


def _dense(
    basis_source: SpectralBasis, basis_target: SpectralBasis, functional_map: Floats, k_final: int, step: int
) -> Refined:
    for k_target, k_source in _sizes(functional_map.shape, k_final, step):
        vertex = vertex_map_of(functional_map, basis_source, basis_target)
        functional_map = functional_map_of(vertex, basis_source, basis_target, k_source, k_target)
    return Refined(functional_map, vertex_map_of(functional_map, basis_source, basis_target))


def _finished(basis_source: SpectralBasis, basis_target: SpectralBasis, functional_map: Floats) -> Refined:
    """From the functional map that samples have led to, to the dense map: grown again on all vertices, in big steps."""
    shape = np.array(functional_map.shape)
    start = min(1.0, ZOOMOUT.finishing_size / shape.min())
    first, *sizes = np.rint(shape * np.linspace(start, 1, ZOOMOUT.finishing_rounds)[:, None]).astype(int)
    functional_map = functional_map[: first[0], : first[1]]
    for k_target, k_source in (*sizes, shape):
        vertex = vertex_map_of(functional_map, basis_source, basis_target)
        functional_map = functional_map_of(vertex, basis_source, basis_target, k_source, k_target)
    return Refined(functional_map, vertex_map_of(functional_map, basis_source, basis_target))


def _sizes(shape: tuple[int, ...], k_final: int, step: int) -> list[tuple[int, int]]:
    """The sizes (k_target, k_source) to go through; a start at k_final is iterated once more there."""
    growth = list(range(step, k_final - max(shape) + 1, step))
    if not growth or growth[-1] != k_final - max(shape):
        growth.append(k_final - max(shape))
    return [(shape[0] + more, shape[1] + more) for more in growth]


def _samples(basis: SpectralBasis, count: int) -> Integers:
    used = np.flatnonzero(basis.areas > 0)
    return used[farthest_points(basis.points[used], count)]


def _check_sizes(available: int, shape: tuple[int, ...], k_final: int, step: int, samples: int | None) -> None:
    check_counts(k_final=k_final, step=step, samples=1 if samples is None else samples)
    if k_final > available:
        raise ValueError(f"k_final is {k_final}, but the bases hold {available} eigenfunctions: compute more of them.")
    if len(shape) == 2 and max(shape) > k_final:
        raise ValueError(f"The initial functional map is {shape}, larger than k_final = {k_final}.")


def checked_start(initial: ArrayLike, n_source: int, n_target: int) -> RealsOrIntegers:
    """A map to begin with, as the user gave it: (k_t, k_s) functional map, or (n_t,) source vertices.

    Raises:
        ValueError: it is neither, or not between shapes with these numbers of vertices.
    """
    start = np.asarray(initial)
    if start.ndim == 1:
        if len(start) != n_target:
            raise ValueError(
                f"The initial map must name one of {n_source} source vertices for each of {n_target} target vertices, "
                f"not for {len(start)}."
            )
        return vertex_numbers(start, n_source, "Images on the source")
    if start.ndim != 2 or start.size == 0:
        raise ValueError(f"The initial map must be a vector or a matrix, not of shape {start.shape}.")
    if start.dtype.kind not in "iuf" or not np.isfinite(start).all():
        raise ValueError("The initial functional map must consist of finite numbers: correct it.")
    return start
