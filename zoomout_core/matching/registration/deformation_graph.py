# SPDX-License-Identifier: GPL-3.0-or-later
"""Deformation graphs: nodes spread over a mesh that move it (Sumner, Schmid and Pauly, Embedded deformation for shape
manipulation, 2007), fitted by the Gauss-Newton method.

Bodies differ in their proportions. The rest shape may therefore adapt to the stretch of the surroundings of each node,
which then costs less.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers, SingleFloats, segment_sum, take_rows
from zoomout_core.geometry.procrustes import Moments, products
from zoomout_core.matching.preparation.analysis import ShapeAnalysis

# Diagonals grow by this part (Marquardt 1963), which exceeds the rounding of single precision. Single precision takes
# two thirds of the time, and is exact enough because the next step searches closest points again. The second, relative
# to the mean of the diagonal, fixes nodes that no residual depends on.
DAMPING, MIN_DIAGONAL = 1e-5, 1e-9
# Nodes that move each vertex.
NODES_PER_VERTEX = 5
# Weight of the squared difference in rotation of neighbouring nodes against that in position, in area / radian^2.
ROTATION_WEIGHT = 0.0005
# Scale s of the weight 1 / (1 + (r / s)^2) of neighbours that disagree by r, at unit area: joints bend.
JOINT_SCALE = 0.01
# Steps towards closest points are scaled by the first number, and the second is the fraction of the previous step that
# is added (Polyak 1964). Surfaces that slide along each other converge slowly; this saves a third of the rounds.
OVER_RELAXATION = 1.6
MOMENTUM = 0.3
# Weight of no stretch against that of the images of a node's neighbours.
RIGIDITY = 1.0


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes spread over the target, and their weights at its vertices."""

    vertex: Integers  # (d,) their vertices
    near: Integers  # (n, c) the nodes that move each vertex
    weight: Floats  # (n, c) the weights of these nodes
    first: Integers  # (e,) a node of a pair that shares vertices
    second: Integers  # (e,) the other node; each pair occurs in both orders
    bond: Floats  # (e,) the fraction of the first node's influence that it shares with the second

    @classmethod
    def on(cls, target: ShapeAnalysis, count: int) -> Nodes:
        distances = target.distances[:count]
        c = min(NODES_PER_VERTEX, len(distances) - 1)
        near, distance = _smallest(distances.T, c + 1)
        weight = np.maximum(1 - distance[:, :c] / np.maximum(distance[:, c:], 1e-300), 1e-6) ** 2
        near, weight = near[:, :c], weight / weight.sum(axis=1, keepdims=True)
        count = len(distances)
        pairs = [(i, j) for i in range(c) for j in range(c)]
        both = np.concatenate([near[:, i] * count + near[:, j] for i, j in pairs])
        overlap = np.concatenate([target.basis.areas * weight[:, i] * weight[:, j] for i, j in pairs])
        shared = segment_sum(overlap, both, count**2).reshape(count, count)
        np.fill_diagonal(shared, 0)
        first, second = np.nonzero(shared > 1e-3 * np.median(shared[shared > 0]))
        bond = shared[first, second]
        bond = bond / np.bincount(first, bond)[first]
        return cls(target.sampled.samples[:count], near, weight, first, second, bond)

    @cached_property
    def place(self) -> Integers:
        """(d,) the place of each node in an order in which nodes that share vertices or pairs are close together.

        The system of their motion then has a narrow band (Cuthill and McKee 1969).
        """
        (n, c), d = self.near.shape, len(self.vertex)
        moves = csr_array((np.ones(n * c), self.near.ravel(), c * np.arange(n + 1)), shape=(n, d))
        pairs = csr_array((np.ones(len(self.first)), (self.first, self.second)), shape=(d, d))
        return np.argsort(reverse_cuthill_mckee(csr_array(moves.T @ moves + pairs), symmetric_mode=True))


def _smallest(values: Floats, count: int) -> tuple[Integers, Floats]:
    """(n, count) columns of the smallest values (n, d) of each row, in rising order, and (n, count) these values.

    For few of them, a search for each takes a fifth of the time of a partition.
    """
    left, rows = values.copy(order="C"), np.arange(len(values))
    columns = np.empty((len(values), count), dtype=np.int64)
    for number in range(count):
        columns[:, number] = left.argmin(axis=1)
        left[rows, columns[:, number]] = np.inf
    return columns, np.take_along_axis(values, columns, axis=1)


@dataclass(eq=False)
class DeformationGraph:
    """Nodes in motion."""

    nodes: Nodes
    rest: Floats  # (n, 3) the target's vertices, mirrored if the map mirrors
    normals: Floats  # (n, 3) its normals, as well
    rotations: Floats  # (d, 3, 3) of the nodes
    images: Floats  # (d, 3) positions of the nodes
    stride: Floats  # (d, 6) the last step towards closest points: rotation vectors and translations
    # (d, 3, 3) symmetric matrices that stretch the surroundings of each node before its rotation.
    stretch: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.stretch = np.tile(np.eye(3), (len(self.rotations), 1, 1))

    @classmethod
    def from_images(
        cls, nodes: Nodes, rest: Floats, normals: Floats, images: Floats, areas: Floats
    ) -> DeformationGraph:
        """The motion that takes the surroundings of each node to the images (n, 3) of the vertices (Kabsch 1976)."""
        count, c = len(nodes.vertex), nodes.near.shape[1]
        weight = (areas[:, None] * nodes.weight).ravel()
        owner = nodes.near.ravel()
        values = np.hstack([products(rest, images), np.ones((len(rest), 1))])
        sums = segment_sum(weight[:, None] * np.repeat(values, c, axis=0), owner, count)
        # Pooled with neighbours, since a few points do not determine a rotation.
        pooled = np.array(sums)
        np.add.at(pooled, nodes.first, nodes.bond[:, None] * sums[nodes.second])
        rotations = Moments.of_products(pooled[:, :16] / pooled[:, 16:]).rotations()
        own = sums[:, :6] / sums[:, 16:]
        shift = np.einsum("dij,dj->di", rotations, rest[nodes.vertex] - own[:, :3])
        return cls(nodes, rest, normals, rotations, own[:, 3:6] + shift, np.zeros((count, 6)))

    def adapt_stretch(self) -> None:
        """Adapt the rest shape to the stretch of each node's surroundings by the images: by half, with `RIGIDITY` 1."""
        first, second, bond = self.nodes.first, self.nodes.second, self.nodes.bond[:, None]
        places = self.rest[self.nodes.vertex]
        away = places[second] - places[first]
        images = np.einsum("eji,ej->ei", self.rotations[first], self.images[second] - self.images[first])
        outer = np.stack([images[:, :, None] * away[:, None], away[:, :, None] * away[:, None]], axis=1)
        sums = segment_sum(bond * outer.reshape(-1, 18), first, len(self.rotations))
        pooled = sums + segment_sum(bond * sums[second], first, len(self.rotations))
        moments = pooled.reshape(-1, 2, 3, 3)
        spread = np.trace(moments[:, 1], axis1=1, axis2=2)
        # A node without neighbours does not stretch.
        rigid = np.where(spread > 0, RIGIDITY / 3 * spread, 1.0)[:, None, None] * np.eye(3)
        linear = (moments[:, 0] + rigid) @ np.linalg.inv(moments[:, 1] + rigid)
        self.stretch = (linear + linear.transpose(0, 2, 1)) / 2

    def offsets(self, vertex: Integers) -> Floats:
        """(q, c, 3) some vertices relative to the nodes that move them, stretched and rotated by these."""
        near = self.nodes.near[vertex]
        away = self.rest[vertex, None] - self.rest[self.nodes.vertex][near]
        return np.einsum("qcij,qcj->qci", (self.rotations @ self.stretch)[near], away)

    def deform(self) -> tuple[Floats, Floats, Floats]:
        """(n, 3) all vertices, (n, 3) their normals, and (n, 3, 3) their rotations."""
        near, weight = self.nodes.near, self.nodes.weight
        positions = np.zeros_like(self.rest)
        blends = np.zeros((len(self.rest), 3, 3))
        linear = self.rotations @ self.stretch
        for node, share in zip(near.T, weight.T, strict=True):
            away = self.rest - take_rows(self.rest, self.nodes.vertex[node])
            moved = np.einsum("nij,nj->ni", take_rows(linear, node), away)
            positions += share[:, None] * (moved + take_rows(self.images, node))
            blends += share[:, None, None] * take_rows(self.rotations, node)
        return positions, np.einsum("nij,nj->ni", blends, self.normals), blends

    def step(
        self, vertex: Integers, residual: Floats, root_weight: Floats, stiffness: float, approaching: bool
    ) -> float:
        """One Gauss-Newton step; returns the mean motion of the nodes, before the step is lengthened.

        The vertices (q,) should move by the residuals (q, 3), whose weights have the square roots `root_weight` (q, 3,
        3). For the stiffness see `Level`. `approaching` residuals are those of closest points, others at the next step.
        """
        near, weight = self.nodes.near[vertex], self.nodes.weight[vertex]
        turning = root_weight[:, None] @ crossing(self.offsets(vertex)) * weight[..., None, None]
        shifting = root_weight[:, None] * weight[..., None, None]
        pulling = _Rows(
            near, np.concatenate([turning, shifting], axis=-1), np.einsum("qij,qj->qi", root_weight, residual)
        )
        matrix, rhs = _normal_equations([pulling, *self._stiffness(stiffness)], self.nodes.place)
        diagonal = matrix[0]
        matrix[0] = (1 + DAMPING) * diagonal + MIN_DIAGONAL * diagonal.mean()
        change = solveh_banded(matrix, rhs, overwrite_ab=True, lower=True, check_finite=False)
        change = change.astype(np.float64).reshape(-1, 6)[self.nodes.place]
        moved = float(np.linalg.norm(change[:, 3:], axis=1).mean())
        if approaching:
            change = self.stride = OVER_RELAXATION * change + MOMENTUM * self.stride
        self.rotations = Rotation.from_rotvec(change[:, :3]).as_matrix() @ self.rotations
        self.images = self.images + change[:, 3:]
        return moved

    def _stiffness(self, stiffness: float) -> list[_Rows]:
        """Residuals of neighbouring nodes: of the positions they predict for each other, and of their rotations."""
        first, second = self.nodes.first, self.nodes.second
        places = self.rest[self.nodes.vertex]
        away = np.einsum("eij,ej->ei", (self.rotations @ self.stretch)[first], places[second] - places[first])
        apart = away + self.images[first] - self.images[second]
        relative = np.einsum("eij,ekj->eik", self.rotations[second], self.rotations[first])
        turn = np.stack([relative[:, i, j] - relative[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1) / 2
        placing, turning = np.zeros((2, len(first), 2, 3, 6))
        placing[:, 0, :, :3] = crossing(away)
        placing[:, 0, :, 3:], placing[:, 1, :, 3:] = np.eye(3), -np.eye(3)
        turning[:, 0, :, :3], turning[:, 1, :, :3] = np.eye(3), -np.eye(3)
        robust = 1 + (np.linalg.norm(apart, axis=1) / JOINT_SCALE) ** 2
        root_weight = np.sqrt(stiffness * self.nodes.bond / len(places) / robust)
        both, turning_weight = np.stack([first, second], axis=1), np.sqrt(ROTATION_WEIGHT) * root_weight
        return [
            _Rows(both, root_weight[:, None, None, None] * placing, -root_weight[:, None] * apart),
            _Rows(both, turning_weight[:, None, None, None] * turning, turning_weight[:, None] * turn),
        ]


class _Rows(NamedTuple):
    """Some rows of a linear system for the nodes' motion, three at a time."""

    node: Integers  # (r, c) the nodes that they depend on
    blocks: Floats  # (r, c, 3, 6) derivatives by a small rotation and translation of each
    goal: Floats  # (r, 3) right-hand sides


def crossing(vectors: Floats) -> Floats:
    """(..., 3, 3) derivatives of vectors (..., 3) by a small rotation, as a rotation vector."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(*vectors.shape, 3)


def _normal_equations(parts: list[_Rows], place: Integers) -> tuple[SingleFloats, SingleFloats]:
    """The system for the motion of d nodes, in the order `place` (d,), in single precision.

    Returns (b, 6 d) the diagonal of the symmetric matrix and those below it, and (6 d,) the right-hand side.
    """
    width = np.concatenate([np.full(len(part.node), part.node.shape[1]) for part in parts])
    node = place[np.concatenate([part.node.ravel() for part in parts])]
    blocks = np.concatenate([part.blocks.reshape(-1, 3, 6) for part in parts], dtype=np.float32)
    goal = np.concatenate([part.goal.ravel() for part in parts], dtype=np.float32)
    start = np.concatenate([[0], np.cumsum(width)])
    jacobian = bsr_array((blocks, node, start), shape=(3 * len(width), 6 * len(place)))
    transpose = jacobian.T
    return _lower_diagonals(transpose @ jacobian), transpose @ goal


def _lower_diagonals(matrix: bsr_array) -> SingleFloats:
    """(b, n) the diagonal of a symmetric matrix (n, n) of square blocks, and those below it."""
    size = matrix.blocksize[0]
    block_row = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
    lower = np.flatnonzero(block_row >= matrix.indices)
    within = np.arange(size)
    row = size * block_row[lower, None, None] + within[:, None]
    column = size * matrix.indices[lower, None, None] + within
    below = np.abs(row - column)  # blocks on the diagonal have each of their entries twice
    diagonals = np.zeros((below.max() + 1, matrix.shape[0]), dtype=np.float32, order="F")
    diagonals[below, np.minimum(row, column)] = matrix.data[lower]
    return diagonals
