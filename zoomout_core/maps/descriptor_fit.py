# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit a functional map that takes one shape's descriptors to the other's, by least squares.

C F = G (Ovsjanikov et al. 2012). C should commute with multiplication by the descriptors (Nogneng and Ovsjanikov 2017),
be nearly diagonal according to eigenvalues or their resolvents (Ren et al. 2019), and have a known orientation (Ren et
al. 2018). The energy is a convex quadratic: small maps take one dense solve, large ones conjugate gradients.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh, solve

from zoomout_core.arrays import Floats
from zoomout_core.maps.functional_map import eigenvalue_mask, resolvent_mask
from zoomout_core.spectral.eigenbasis import SpectralBasis, check_size
from zoomout_core.spectral.operators import check_descriptors, multiplication_operators

MASKS = {"eigenvalues": eigenvalue_mask, "resolvent": resolvent_mask}
# Maximum number of unknowns for a dense matrix: 20 MB.
DENSE = 1600
# Combinations of operators with less than this share of the largest energy are rounding.
RANK_TOLERANCE = 1e-14
# Share of the terms' mean curvature that is added in every direction, for directions that no term determines.
RIDGE = 1e-10
# Share of a constant function's squared norm that may be outside of a basis's null space.
NOT_CONSTANT = 1e-3
# Conjugate gradients end when the gradient, scaled by the curvature, has dropped to this share, or after MAX_STEPS.
GRADIENT_TOLERANCE, MAX_STEPS = 1e-7, 2000


def fit_functional_map(
    basis_source: SpectralBasis,
    basis_target: SpectralBasis,
    descriptors_source: ArrayLike,
    descriptors_target: ArrayLike,
    k: int | tuple[int, int] = 20,
    *,
    descriptor_weight: float = 0.1,
    multiplication_weight: float = 1.0,
    laplacian_weight: float = 0.1,
    orientation_weight: float = 1.0,
    orientation_operators: tuple[ArrayLike, ArrayLike] | None = None,
    orientation: Literal["keep", "reverse"] = "keep",
    mask: Literal["eigenvalues", "resolvent"] = "eigenvalues",
    normalize: bool = True,
) -> Floats:
    """Compute the functional map C that best fits the source's descriptors F to the target's G, to start `zoomout`.

    It minimises, with means over the descriptors, so that their number does not matter,

        a/2 mean ||C F_i - G_i||^2 + b/2 mean ||X_i C - C Y_i||^2 + c/2 sum D o C^2 + w/2 mean ||O_i C -+ C P_i||^2

    where X_i and Y_i multiply by a descriptor, O_i and P_i are the orientation operators of target and source, and each
    pair of operators is divided by the root mean square of its two norms. The constant function goes to itself.

    Args:
        basis_source: basis of the surface that the map lands on.
        basis_target: basis of the surface that the map starts from.
        descriptors_source: (n_s, d) functions at the source's vertices.
        descriptors_target: (n_t, d) the same functions at the target's vertices.
        k: size of the map, or (k_source, k_target).
        descriptor_weight: a.
        multiplication_weight: b.
        laplacian_weight: c; the mask D has the mean one in each row.
        orientation_weight: sets w relative to all other terms. Terms are compared by their means over diagonal maps of
            +-1, which include the map of an isometry, so that signs of eigenfunctions do not matter. Ren et al. use
            0.1, which is enough to keep the orientation, but not always to reverse it.
        orientation_operators: (e, k, k) operators of source and target by `zo.orientation_operators`, possibly of other
            descriptors; larger ones are cropped. None to leave the orientation open.
        orientation: "keep" the orientation, as rigid motions and other poses do, or "reverse" it, as reflections do.
        mask: make D from squared differences of eigenvalues, or from the eigenvalues' resolvents (exponent 1/2).
        normalize: divide each descriptor by its root mean square over the area, which at unit area is its norm.

    Returns:
        (k_target, k_source) functional map.

    Raises:
        ValueError: descriptors are missing, not finite, or do not fit their basis or each other; a size exceeds its
            basis, or a basis has no constant function; operators do not fit; weights are negative, or both a and b are
            zero.

    Example:
        >>> f, g = (zo.wave_kernel_signature(basis) for basis in bases)
        >>> zo.fit_functional_map(*bases, f, g, k=10).shape
        (10, 10)
    """
    k_source, k_target = _sizes(k)
    F = check_descriptors(basis_source, descriptors_source, "The source's descriptors")
    G = check_descriptors(basis_target, descriptors_target, "The target's descriptors")
    if F.shape[1] != G.shape[1]:
        raise ValueError(
            f"The source has {F.shape[1]} descriptors, but the target has {G.shape[1]}: give the same descriptors in "
            "the same order."
        )
    _check_weights(descriptor_weight, multiplication_weight, laplacian_weight, orientation_weight)
    if orientation not in ("keep", "reverse"):
        raise ValueError(f"The orientation is {orientation!r}: say 'keep' or 'reverse'.")
    if mask not in MASKS:
        raise ValueError(f"The mask is {mask!r}: say 'eigenvalues' or 'resolvent'.")
    first_source, constant_source = _constant_first(basis_source, k_source)
    first_target, constant_target = _constant_first(basis_target, k_target)
    if normalize:
        F, G = _of_unit_size(basis_source, F), _of_unit_size(basis_target, G)

    left, right = _normalise(
        _change_basis(multiplication_operators(basis_target, G, k_target), first_target),
        _change_basis(multiplication_operators(basis_source, F, k_source), first_source),
    )
    root_a, root_b = np.sqrt(descriptor_weight / F.shape[1]), np.sqrt(multiplication_weight / F.shape[1])
    energy = _Energy(
        root_a * first_source.T @ basis_source.coefficients(F)[:k_source],
        root_a * first_target.T @ basis_target.coefficients(G)[:k_target],
        root_b * left,
        root_b * right,
        laplacian_weight * MASKS[mask](basis_source.eigenvalues[:k_source], basis_target.eigenvalues[:k_target]),
    )
    if orientation_operators is not None:
        on_source, on_target = _check_operators(orientation_operators, k_source, k_target)
        oriented = _normalise(_change_basis(on_target, first_target), _change_basis(on_source, first_source))
        energy = energy.with_orientation(*oriented, orientation_weight, 1 if orientation == "keep" else -1)
    C = _minimiser(energy.compress(), constant_target / constant_source)
    return np.asarray(first_target @ C @ first_source.T)


@dataclass(frozen=True, eq=False)
class _Energy:
    """1/2 ||C F - G||^2 + 1/2 sum_i ||L_i C - C R_i||^2 + 1/2 sum D o C^2 of maps C (k_t, k_s).

    Attributes:
        F: (k_s, d) coefficients of the source's descriptors.
        G: (k_t, d) coefficients of the target's descriptors.
        left: (e, k_t, k_t) operators on the target.
        right: (e, k_s, k_s) operators on the source.
        mask: (k_t, k_s).
    """

    F: Floats
    G: Floats
    left: Floats
    right: Floats
    mask: Floats

    def gradient(self, C: Floats) -> Floats:
        """(k_t, k_s) derivatives of the energy."""
        return self.curvature(C) - self.G @ self.F.T

    def curvature(self, C: Floats) -> Floats:
        """(k_t, k_s) second derivatives in the direction of C."""
        apart = self.left @ C - C @ self.right
        commuting = np.tensordot(self.left, apart, ([0, 1], [0, 1])) - np.tensordot(apart, self.right, ([0, 2], [0, 2]))
        return np.asarray(C @ (self.F @ self.F.T) + self.mask * C + commuting)

    def diagonal_curvature(self) -> Floats:
        """(k_t, k_s) second derivatives by each entry."""
        left, right = (np.diagonal(each, axis1=1, axis2=2) for each in (self.left, self.right))
        rows = (self.left**2).sum(axis=(0, 1))[:, None]
        columns = (self.right**2).sum(axis=(0, 2)) + (self.F**2).sum(axis=1)
        return np.asarray(self.mask + rows + columns - 2 * left.T @ right)

    def mean_curvature(self) -> float:
        """The mean of the second derivatives by each entry, without the commuting terms."""
        k_target, k_source = self.mask.shape
        on_source = (self.F**2).sum() + (self.right**2).sum()
        return float(on_source / k_source + (self.left**2).sum() / k_target + self.mask.mean())

    def curvature_matrix(self) -> Floats:
        """(k_t, k_s, k_t, k_s) second derivatives by each pair of entries."""
        both = np.tensordot(self.left, self.right, (0, 0))
        matrix = -both.transpose(1, 3, 0, 2) - both.transpose(0, 2, 1, 3)
        row, column = np.arange(self.mask.shape[0]), np.arange(self.mask.shape[1])
        matrix[:, column, :, column] += np.tensordot(self.left, self.left, ([0, 1], [0, 1]))
        matrix[row, :, row, :] += np.tensordot(self.right, self.right, ([0, 2], [0, 2])) + self.F @ self.F.T
        matrix[row[:, None], column, row[:, None], column] += self.mask
        return np.asarray(matrix)

    def mean_value(self) -> float:
        """The mean energy of the diagonal maps of +-1 that take the constant function to itself.

        Off-diagonal entries of the operators have either sign equally often, so their squares just add up.
        """
        k = min(self.mask.shape)
        left, right = (np.diagonal(each, axis1=1, axis2=2)[:, :k] for each in (self.left, self.right))
        descriptors = (self.F[:k] ** 2).sum() + (self.G**2).sum() - 2 * self.F[0] @ self.G[0]
        commuting = (self.left[:, :, :k] ** 2).sum() + (self.right[:, :k] ** 2).sum() - 2 * (left * right).sum()
        return float(descriptors + commuting + np.trace(self.mask)) / 2

    def with_orientation(self, left: Floats, right: Floats, weight: float, sign: int) -> _Energy:
        """Add orientation operators (e, k_t, k_t), (e, k_s, k_s) with a weight relative to this energy."""
        nothing = np.zeros((len(self.F), 1)), np.zeros((len(self.G), 1))
        size = _Energy(*nothing, left, right, np.zeros_like(self.mask)).mean_value()
        root = np.sqrt(weight * self.mean_value() / size) if size > 0 else 0.0
        return replace(
            self, left=np.concatenate([self.left, root * left]), right=np.concatenate([self.right, sign * root * right])
        )

    def compress(self) -> _Energy:
        """The same energy with the fewest operators that span all: signatures at many energies hardly differ.

        An orthogonal mixture of the pairs of operators preserves the sum of squares.
        """
        pairs = np.hstack([each.reshape(len(each), -1) for each in (self.left, self.right)])
        energies, mixtures = eigh(pairs @ pairs.T)
        pairs = mixtures[:, energies > RANK_TOLERANCE * energies[-1]].T @ pairs
        left, right = np.split(pairs, [self.left[0].size], axis=1)
        return replace(
            self, left=left.reshape(-1, *self.left.shape[1:]), right=right.reshape(-1, *self.right.shape[1:])
        )


def _minimiser(energy: _Energy, constant: float) -> Floats:
    """(k_t, k_s) map of minimum energy whose first column is zero except for its first entry, which is given."""
    C = np.zeros(energy.mask.shape)
    C[0, 0] = constant
    downhill = -energy.gradient(C)[:, 1:]
    ridge = RIDGE * energy.mean_curvature() or RIDGE
    if downhill.size <= DENSE:
        matrix = energy.curvature_matrix()[:, 1:, :, 1:].reshape(downhill.size, downhill.size)
        matrix += ridge * np.eye(downhill.size)
        C[:, 1:] = solve(matrix, downhill.ravel(), assume_a="pos").reshape(downhill.shape)
    else:
        C[:, 1:] = _conjugate_gradients(energy, downhill, ridge)
    return C


def _conjugate_gradients(energy: _Energy, downhill: Floats, ridge: float) -> Floats:
    """(k_t, k_s - 1) optimal columns after the first; `downhill` is the negative gradient where they are zero."""
    diagonal = energy.diagonal_curvature()[:, 1:] + ridge
    found, residual = np.zeros_like(downhill), downhill
    scaled = residual / diagonal
    direction, size = scaled, float((residual * scaled).sum())
    enough = GRADIENT_TOLERANCE**2 * size
    for _ in range(MAX_STEPS):
        if size <= enough:
            break
        bent = energy.curvature(np.column_stack([np.zeros(len(direction)), direction]))[:, 1:] + ridge * direction
        step = size / float((direction * bent).sum())
        found = found + step * direction
        residual = residual - step * bent
        scaled = residual / diagonal
        before, size = size, float((residual * scaled).sum())
        direction = scaled + size / before * direction
    return found


def _constant_first(basis: SpectralBasis, k: int) -> tuple[Floats, float]:
    """(k, k) orthogonal matrix whose first column is the constant function, and this function's norm.

    It mixes only the null space.
    """
    check_size(basis, k)
    if k <= basis.components:
        raise ValueError(
            f"k is {k}, but the {basis.components} components already have that many constant functions: increase k."
        )
    constant = basis.areas @ basis.eigenvectors[:, : basis.components]
    norm = float(np.linalg.norm(constant))
    if not abs(norm**2 / basis.areas.sum() - 1) < NOT_CONSTANT:
        raise ValueError("The basis does not begin with the constant function: give one of zo.eigenbasis.")
    null_space, R = np.linalg.qr(constant[:, None], mode="complete")
    null_space[:, 0] *= np.sign(R[0, 0])
    turn = np.eye(k)
    turn[: basis.components, : basis.components] = null_space
    return turn, norm


def _change_basis(operators: Floats, turn: Floats) -> Floats:
    """Transform operators (e, k, k) to another basis (k, k)."""
    return np.asarray(turn.T @ operators @ turn)


def _normalise(left: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Divide pairs of operators by the root mean square of their two norms; zero ones stay."""
    size = np.sqrt(((left**2).sum(axis=(1, 2)) + (right**2).sum(axis=(1, 2))) / 2)[:, None, None]
    size[size == 0] = 1
    return left / size, right / size


def _of_unit_size(basis: SpectralBasis, functions: Floats) -> Floats:
    size = np.sqrt(basis.areas @ functions**2 / basis.areas.sum())
    return functions / np.where(size > 0, size, 1)


def _sizes(k: int | tuple[int, int]) -> tuple[int, int]:
    sizes = k if isinstance(k, tuple | list) else (k, k)
    if len(sizes) != 2:
        raise ValueError(f"k is {k!r}: give a whole number, or one for the source and one for the target.")
    return sizes[0], sizes[1]


def _check_weights(descriptor: float, multiplication: float, laplacian: float, orientation: float) -> None:
    weights = {"descriptor": descriptor, "multiplication": multiplication}
    for name, weight in (weights | {"laplacian": laplacian, "orientation": orientation}).items():
        if not 0 <= weight < np.inf:
            raise ValueError(f"{name}_weight is {weight!r}: give a number that is not below zero.")
    if not any(weights.values()):
        raise ValueError("Neither the descriptors nor their multiplication have a weight: give one to either.")


def _check_operators(operators: tuple[ArrayLike, ArrayLike], k_source: int, k_target: int) -> tuple[Floats, Floats]:
    """Check a user's orientation operators of source and target, and return their leading blocks."""
    if len(operators) != 2:
        raise ValueError("Orientation operators must be those of the source and those of the target.")
    source, target = (np.asarray(each, dtype=np.float64) for each in operators)
    for name, array, k in (("source", source, k_source), ("target", target, k_target)):
        if array.ndim != 3 or array.shape[1] != array.shape[2] or array.shape[1] < k or len(array) == 0:
            raise ValueError(
                f"The {name}'s orientation operators have the shape {array.shape}: matrices of {k} rows and columns or "
                "more are needed."
            )
        if not np.isfinite(array).all():
            raise ValueError(f"The {name}'s orientation operators must be finite numbers: correct them.")
    if len(source) != len(target):
        raise ValueError(
            f"The source has {len(source)} orientation operators, but the target has {len(target)}: give the same "
            "number."
        )
    return source[:, :k_source, :k_source], target[:, :k_target, :k_target]
