# SPDX-License-Identifier: GPL-3.0-or-later
"""Partial functional maps (PFM).

Rodola, Cosmo, Bronstein, Torsello and Cremers, Partial functional correspondence (2017). The target is a part of the
source. A functional map C (k_t, k_s) and a soft region v on the source minimise, with a_j the coefficients of the
target's descriptors, g_j the source's descriptors, eta(v) = (1 + tanh(6 v - 3)) / 2, both shapes in one unit,

    sum_j ||C' a_j - Phi_s' A_s (eta(v) g_j)||                      descriptors agree on the region (L2,1)
    + SLANT ||W o C||^2 + ORTHOGONALITY ||C C' - D||^2              C is slanted, its first r rows orthonormal
    + AREA (target's area - area of eta(v))^2                       the region is as large as the target
    + LENGTH integral of xi(v) |grad v|                             and has a short border (Mumford and Shah)

where r of the target's eigenvalues are below the source's k-th, D is the identity in the first r rows, and W is the
distance from the line of slope r / k, with less weight at high indices. Steps in C and in v alternate, the first step
in C with the whole source. At the end C is refined by iterative closest points with r orthonormal rows. The weights
are not the authors', whose descriptors are scaled differently: each term is of order one on the pairs of `partial`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array

from benchmarks.baselines.bcicp import Side
from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.nearest import nearest
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.spectral.eigenbasis import SpectralBasis

# Weights of the terms, for descriptors of unit norm at each vertex, and a source of unit area.
SLANT, ORTHOGONALITY, AREA, LENGTH = 0.01, 10.0, 100.0, 0.02
# Decay of the slant's weight with the numbers of functions.
DECAY = 0.03
# Width of xi, a Gaussian about v = 1/2.
BORDER = 0.2
# Initial v on all of the source; at 1 the gradient of the membership is almost zero.
UNDECIDED = 0.6
ROUNDS = 3
STEPS_MAP, STEPS_REGION = 100, 40
ICP_ITERATIONS = 20
# Minimum length, so that lengths of zero have a gradient.
SMOOTHING = 1e-6


@dataclass(frozen=True, eq=False)
class Partial:
    """Where a part is on the whole.

    Attributes:
        functional_map: (r, k) from the source's functions to the target's first r.
        vertex: (n_t,) source vertex of each target vertex.
        region: (n_s,) membership of each source vertex in the region, from 0 to 1.
    """

    functional_map: Floats
    vertex: Integers
    region: Floats


def pfm(
    source: Side,
    target: Side,
    descriptors_source: Floats,
    descriptors_target: Floats,
    k: int = 100,
    rounds: int = ROUNDS,
) -> Partial:
    """Match a part to a whole by descriptors, and locate it on the whole.

    Args:
        source: the whole; k eigenfunctions at least.
        target: the part; as many.
        descriptors_source: (n_s, d) functions at the source's vertices, in one unit with
        descriptors_target: (n_t, d) the same at the target's.
        k: size of the functional map.
        rounds: steps in C and in v.
    """
    problem = _Problem.of(source, target, descriptors_source, descriptors_target, k)
    C = problem.first_map()
    v = np.full(len(source.basis.areas), UNDECIDED)
    for _ in range(rounds):
        v = problem.place.minimiser(v, C.T @ problem.fit.A)
        C = problem.fit.minimiser(C, problem.place.coefficients(membership(v)))
    return Partial(*closest_points(C[: problem.fit.r], problem.rows_source, problem.basis), membership(v))


def first_map(source: Side, target: Side, descriptors_source: Floats, descriptors_target: Floats, k: int) -> Integers:
    """(n_t,) the initial vertex map of `pfm`, for which the region is the whole source."""
    problem = _Problem.of(source, target, descriptors_source, descriptors_target, k)
    return closest_points(problem.first_map()[: problem.fit.r], problem.rows_source, problem.basis, 0)[1]


@dataclass(frozen=True, eq=False)
class _Problem:
    """Both energies of a pair.

    Attributes:
        basis: of the target, in the source's unit.
        rows_source: (n_s, k) the source's eigenvectors.
        fit: the terms of the functional map.
        place: the terms of the region.
    """

    basis: SpectralBasis
    rows_source: Floats
    fit: MapEnergy
    place: RegionEnergy

    @classmethod
    def of(cls, source: Side, target: Side, on_source: Floats, on_target: Floats, k: int) -> _Problem:
        """Set up the system for two shapes with descriptors (n_s, d) and (n_t, d), and k eigenfunctions of each."""
        share = target.surface.area / source.surface.area
        basis = target.basis.at_area(share)
        r = int((basis.eigenvalues[:k] < source.basis.eigenvalues[k - 1]).sum())
        fit = MapEnergy(basis.coefficients(on_target)[:k], slant(k, r), r)
        return cls(basis, source.basis.eigenvectors[:, :k], fit, RegionEnergy.of(source, on_source, share, k))

    def first_map(self) -> Floats:
        """(k, k) the functional map that fits the descriptors of the whole source."""
        whole = self.place.coefficients(np.ones(len(self.rows_source)))
        return self.fit.minimiser(np.zeros(self.fit.W.shape), whole)


def slant(k: int, r: int) -> Floats:
    """(k, k) W: distance of the indices (i, j) of target and source functions from the line i = j r / k."""
    i, j = np.indices((k, k))
    return np.exp(-DECAY * np.hypot(i, j)) * np.abs(k * i - r * j) / np.hypot(k, r)


def membership(v: Floats) -> Floats:
    """(n,) eta(v), from 0 to 1."""
    return (1 + np.tanh(6 * v - 3)) / 2


@dataclass(frozen=True, eq=False)
class MapEnergy:
    """The terms of the functional map.

    Attributes:
        A: (k, d) coefficients of the target's descriptors.
        W: (k, k) weights of the slant.
        r: number of rows that should be orthonormal.
    """

    A: Floats
    W: Floats
    r: int

    def at(self, C: Floats, B: Floats) -> tuple[float, Floats]:
        """The energy of a map C (k, k) and its gradient (k, k), given the region's coefficients B (k, d)."""
        data, directions = lengths(C.T @ self.A - B)
        slanted = self.W * C
        gram = C @ C.T
        gram[np.arange(self.r), np.arange(self.r)] -= 1
        return (
            data + SLANT * (slanted**2).sum() + ORTHOGONALITY * (gram**2).sum(),
            self.A @ directions.T + 2 * SLANT * self.W * slanted + 4 * ORTHOGONALITY * gram @ C,
        )

    def minimiser(self, C: Floats, B: Floats) -> Floats:
        """(k, k) minimiser that L-BFGS finds from a map C (k, k)."""

        def energy(flat: Floats) -> tuple[float, Floats]:
            value, gradient = self.at(flat.reshape(C.shape), B)
            return value, gradient.ravel()

        found = minimize(energy, C.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": STEPS_MAP, "gtol": 0.0})
        return np.asarray(found.x.reshape(C.shape))


@dataclass(frozen=True, eq=False)
class RegionEnergy:
    """The terms of the region, on a source of unit area.

    Attributes:
        rows: (n, k) its eigenvectors.
        areas: (n,) of its vertices.
        descriptors: (n, d).
        share: the target's area.
        gradient: (3 m, n) the gradient of functions on its m triangles: x of all, y of all, z of all.
        mean: (m, n) the mean of functions on triangles.
        triangle_areas: (m,).
    """

    rows: Floats
    areas: Floats
    descriptors: Floats
    share: float
    gradient: csr_array
    mean: csr_array
    triangle_areas: Floats

    @classmethod
    def of(cls, source: Side, descriptors: Floats, share: float, k: int) -> RegionEnergy:
        """From a source of any area, the first k of its functions, and a target with a share of its area."""
        points = source.surface.vertices / np.sqrt(source.surface.area)
        triangles = source.surface.triangles
        m = len(triangles)
        mean = csr_array((np.full(3 * m, 1 / 3), triangles.ravel(), np.arange(0, 3 * m + 1, 3)), (m, len(points)))
        basis = source.basis
        return cls(
            basis.eigenvectors[:, :k],
            basis.areas,
            descriptors,
            share,
            gradient_operator(points, triangles),
            mean,
            triangle_areas(points, triangles),
        )

    def coefficients(self, eta: Floats) -> Floats:
        """(k, d) of the descriptors on a region with memberships (n,)."""
        return np.asarray((self.rows.T * (self.areas * eta)) @ self.descriptors)

    def at(self, v: Floats, wanted: Floats) -> tuple[float, Floats]:
        """The energy of v (n,) and its gradient (n,), given the desired coefficients (k, d) of the descriptors."""
        eta = membership(v)
        data, directions = lengths(self.coefficients(eta) - wanted)
        of_eta = self.areas * np.einsum("nd,nd->n", self.rows @ directions, self.descriptors)
        surplus = self.areas @ eta - self.share
        of_eta += 2 * AREA * surplus * self.areas
        border, of_border = self._border(v)
        value = data + AREA * surplus**2 + LENGTH * border
        return float(value), np.asarray(of_eta * 12 * eta * (1 - eta) + LENGTH * of_border)

    def minimiser(self, v: Floats, wanted: Floats) -> Floats:
        """(n,) minimiser that L-BFGS finds from v (n,)."""

        def energy(flat: Floats) -> tuple[float, Floats]:
            return self.at(flat, wanted)

        found = minimize(energy, v, jac=True, method="L-BFGS-B", options={"maxiter": STEPS_REGION, "gtol": 0.0})
        return np.asarray(found.x)

    def _border(self, v: Floats) -> tuple[float, Floats]:
        """The length of the region's border, and (n,) its gradient."""
        along = (self.gradient @ v).reshape(3, -1)
        steepness = np.sqrt((along**2).sum(axis=0) + SMOOTHING)
        off = self.mean @ v - 0.5
        xi = self.triangle_areas * np.exp(-(off**2) / (2 * BORDER**2)) / (np.sqrt(2 * np.pi) * BORDER)
        gradient = self.gradient.T @ (xi / steepness * along).ravel() - self.mean.T @ (xi * steepness * off / BORDER**2)
        return float(xi @ steepness), np.asarray(gradient)


def closest_points(
    C: Floats, rows_source: Floats, basis: SpectralBasis, iterations: int = ICP_ITERATIONS
) -> tuple[Floats, Integers]:
    """Alternate nearest neighbours with functional maps whose rows are orthonormal.

    Args:
        C: (r, k) functional map.
        rows_source: (n_s, k) the source's eigenvectors.
        basis: of the target, r eigenfunctions at least.
        iterations: of both steps, followed by a final search for nearest neighbours.

    Returns:
        (r, k) the map, and (n_t,) source vertex of each target vertex.
    """
    rows_target = basis.eigenvectors[:, : len(C)]
    for _ in range(iterations):
        images = rows_source[nearest(rows_target @ C, rows_source)]
        C = orthonormal_rows(rows_target.T @ (basis.areas[:, None] * images))
    return C, nearest(rows_target @ C, rows_source)


def orthonormal_rows(matrix: Floats) -> Floats:
    """(r, k) the matrix with orthonormal rows nearest to one (r, k)."""
    left, _, right = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(left @ right)


def lengths(columns: Floats) -> tuple[float, Floats]:
    """The sum of the columns' norms, and its gradient: the normalised columns (k, d)."""
    length = np.sqrt((columns**2).sum(axis=0) + SMOOTHING**2)
    return float(length.sum()), columns / length


def gradient_operator(points: Floats, triangles: Integers) -> csr_array:
    """(3 m, n) the gradient of functions on m triangles: x of all, y of all, z of all; zero on degenerate ones."""
    m, corners = len(triangles), points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    squared = np.maximum((normals**2).sum(axis=1), np.finfo(float).tiny)[:, None]
    # Gradient of a corner's hat function: the opposite edge turned by a right angle, divided by twice the area.
    hats = [np.cross(normals, corners[:, (i + 2) % 3] - corners[:, (i + 1) % 3]) / squared for i in range(3)]
    columns = np.tile(triangles[:, :, None], 3).transpose(2, 0, 1)  # (axis, triangle, corner)
    values = np.stack(hats, axis=1).transpose(2, 0, 1)
    return csr_array((values.ravel(), columns.ravel(), np.arange(0, 9 * m + 1, 3)), (3 * m, len(points)))
