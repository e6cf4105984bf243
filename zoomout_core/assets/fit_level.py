# SPDX-License-Identifier: GPL-3.0-or-later
"""Move the vertices of a simplified mesh, and change their weights, so that it is close to the original in all poses.

Each original vertex is paired with the closest triangle at rest that belongs to the same connected part and faces the
same side. The fit minimises the sum of squared distances of these vertices from the planes of their triangles, over all
poses. The distances are linear in the rest positions, because each pose moves a vertex by a fixed matrix. The
derivatives of the distances from a triangle's plane differ only by barycentric coordinates, so that the normal
equations are summed over its points first. Conjugate gradients solve them. The distances are linear in the weights,
too. The weights of a vertex are distributed among its joints such that its triangles follow the mesh, not the vertex
alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_array, csr_array, eye_array
from scipy.sparse.linalg import LinearOperator, cg

from zoomout_core.arrays import Floats, Integers, row_norms, segment_sum
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.mesh.affine_maps import blend_matrices, normalise, transform_points
from zoomout_core.mesh.triangles import triangle_normals, vertex_normals
from zoomout_core.transfer.rigging.skinning import row_of, strongest
from zoomout_core.tuning import Tuning, tuned

# Weights of the smoothness of the displacements, and of their size, relative to those of the distances.
SMOOTHNESS, DAMPING = 0.05, 0.1
# Distance of parts in searches of closest points, relative to the extent.
APART = 3.0
# Largest cosine between normals of opposite sides of a sheet; at most creases, normals differ by less than 120 degrees.
OPPOSITE = -0.5
# Pairs of corners of a triangle.
CORNERS = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)]
# Share of the first residual at which conjugate gradients end, and their largest number.
SOLVED, MAX_STEPS = 1e-3, 200


@dataclass(frozen=True)
class LevelFitTuning(Tuning, set_by="production"):
    """How levels of detail are fitted to the mesh.

    Attributes:
        rounds: times that closest points are found and the vertices moved.
        slip: weight of displacements along the surface, with which textures slip, relative to that of the distances.
        poses: weight of the distances in all other poses, relative to that at rest.
        weights: weight of the size of changes of skin weights, relative to the mean of that of the distances.
    """

    rounds: int = tuned(4, "1", 0, 20)
    slip: float = tuned(0.3, "1", 0, 100)
    poses: float = tuned(3.0, "1", 0, 10)
    weights: float = tuned(0.1, "1", 0.001, 1e9)


LEVEL_FIT = LevelFitTuning()


@dataclass(frozen=True, eq=False)
class Places:
    """Places on the original mesh that a level is fitted to.

    Attributes:
        points: (n, 3) them at rest.
        normals: (n, 3) unit normals there.
        parts: (n,) their parts, to which only these parts of the level are fitted.
        goals: (n, 3) them in each pose but rest.
    """

    points: Floats
    normals: Floats
    parts: Integers
    goals: Sequence[Floats]


def fit_level(
    vertices: Floats,
    triangles: Integers,
    parts: Integers,
    motions: Sequence[Floats],
    places: Places,
    rounds: int,
) -> Floats:
    """(k, 3) rest positions of a level that is close to the original mesh in all poses.

    Args:
        vertices: (k, 3) rest positions to begin with.
        triangles: (m, 3) vertex numbers.
        parts: (k,) numbers of the connected parts that the vertices belong to.
        motions: for each pose but rest (k, 3, 4) transforms of the vertices.
        places: where the original mesh is.
        rounds: times that closest points are found and the vertices moved.
    """
    still = np.tile(np.eye(4)[:3], (len(vertices), 1, 1))
    weights = [1.0, *[LEVEL_FIT.poses / max(len(motions), 1)] * len(motions)]
    poses = list(zip([still, *motions], [places.points, *places.goals], weights, strict=True))
    fitted = vertices.copy()
    blocks = _Blocks(len(vertices), triangles)
    laplacian = np.where(blocks.row == blocks.column, np.diff(blocks.start)[blocks.row] - 1, -1)
    smoothness = SMOOTHNESS * laplacian[:, None, None] * np.eye(3)
    along = vertex_normals(vertices, triangles)
    across = along[:, :, None] * along[:, None]
    held = DAMPING * across + LEVEL_FIT.slip * (np.eye(3) - across)
    for _ in range(rounds):
        triangle, barycentric = closest_facing(fitted, triangles, parts, places)
        matrix, right = _normal_equations(fitted, triangles, triangle, barycentric, poses, blocks)
        scale = float(np.trace(matrix[blocks.diagonal], axis1=1, axis2=2).mean()) / 3
        matrix += scale * smoothness
        matrix[blocks.diagonal] += scale * held
        right -= scale * np.einsum("kxy,ky->kx", held, fitted - vertices)
        fitted = fitted + _solve(blocks, matrix, right)
    return fitted


def fit_weights(
    vertices: Floats, triangles: Integers, parts: Integers, weights: csr_array, joints: Floats, places: Places
) -> csr_array:
    """(k, b) weights of the same joints, which sum to one, of a level that is close to the original mesh in all poses.

    Args:
        vertices: (k, 3) rest positions.
        triangles: (m, 3) vertex numbers.
        parts: (k,) numbers of the connected parts that the vertices belong to.
        weights: (k, b) the weights to begin with.
        joints: (f, b, 3, 4) transforms of the joints in the first poses of `places`.
        places: where the original mesh is.
    """
    shares, corner = normalise(weights), triangles.ravel()
    triangle, barycentric = closest_facing(vertices, triangles, parts, places)
    squares = (barycentric[:, :, None] * barycentric[:, None]).reshape(-1, 9)
    products = segment_sum(squares, triangle, len(triangles)).reshape(-1, 3, 3)
    mass = bsr_array((products, np.arange(len(triangles)), np.arange(len(triangles) + 1)))
    row, main = row_of(shares), strongest(shares)
    # The strongest joint of a vertex gets the rest of the weight.
    free = np.flatnonzero(shares.indices != main[row])
    if not len(free):
        return shares
    vertex, joint = row[free], shares.indices[free]
    start = np.searchsorted(vertex, np.arange(len(vertices) + 1))
    slope = csr_array((np.ones(len(free)), np.arange(len(free)), start), shape=(len(vertices), len(free)))[corner]
    of_triangle = row_of(slope) // 3
    matrix, right = csr_array((len(free), len(free))), np.zeros(len(free))
    for pose, goal in zip(joints, places.goals[: len(joints)], strict=True):
        moved = transform_points(blend_matrices(pose, shares), vertices)
        normal = triangle_normals(moved, triangles)
        arm = transform_points(pose[joint] - pose[main[vertex]], vertices[vertex])
        slope.data = np.einsum("ex,ex->e", normal[of_triangle], arm[slope.indices])
        distance = np.einsum("nx,nx->n", normal[triangle], goal - moved[triangles[triangle, 0]])
        matrix = matrix + slope.T @ (mass @ slope)
        right += slope.T @ segment_sum(barycentric * distance[:, None], triangle, len(triangles)).ravel()
    scale = LEVEL_FIT.weights * matrix.diagonal().mean()
    step, _ = cg(matrix + scale * eye_array(len(free)), right, rtol=SOLVED, maxiter=MAX_STEPS)
    found = shares.data.copy()
    found[free] += step
    found[shares.indices == main[row]] -= np.bincount(vertex, step, len(vertices))[np.diff(shares.indptr) > 0]
    fitted = csr_array((np.maximum(found, 0), shares.indices, shares.indptr), shape=shares.shape)
    fitted.eliminate_zeros()
    return normalise(fitted)


def closest_facing(vertices: Floats, triangles: Integers, parts: Integers, places: Places) -> tuple[Integers, Floats]:
    """The closest points of triangles of the same part that do not face opposite to the places.

    Where the closest triangle does, as behind a sheet that is thinner than the triangle is wide, others are searched
    within this width.

    Returns:
        (n,) triangle numbers and (n, 3) barycentric coordinates, which are zero where there is no such triangle.
    """
    # Far from each other, parts do not attract the points of others, which may be closer.
    shift = APART * np.ptp(places.points, axis=0).max() * np.arange(1 + parts.max())[:, None] * [1.0, 0.0, 0.0]
    vertices, points, normals = vertices + shift[parts], places.points + shift[places.parts], places.normals
    triangle, barycentric = SurfaceSearch(vertices, triangles).closest(points)
    facing = triangle_normals(vertices, triangles)
    behind = np.flatnonzero(np.einsum("nx,nx->n", facing[triangle], normals) < OPPOSITE)
    width = row_norms(np.ptp(vertices[triangles[triangle[behind]]], axis=1))
    barycentric[behind] = 0.0
    axis = np.abs(normals[behind]).argmax(axis=1)
    direction = 2 * axis + (normals[behind, axis] < 0)  # the one of six that is closest to the normal
    for number in np.unique(direction):
        ahead = np.flatnonzero(facing[:, number // 2] * (-1) ** number > 0)
        some = direction == number
        if len(ahead):
            found, inside = SurfaceSearch(vertices, triangles[ahead]).closest(points[behind[some]])
            found = ahead[found]
            off = points[behind[some]] - np.einsum("nk,nkx->nx", inside, vertices[triangles[found]])
            near = (row_norms(off) < width[some]) & (
                np.einsum("nx,nx->n", facing[found], normals[behind[some]]) >= OPPOSITE
            )
            triangle[behind[some][near]], barycentric[behind[some][near]] = found[near], inside[near]
    return triangle, barycentric


class _Blocks:
    """The places of 3x3 blocks in a matrix for vertices and their neighbours, row by row.

    Attributes:
        row, column: (b,) the vertices of each block.
        start: (k + 1,) where the rows begin.
        diagonal: (k,) the blocks of the vertices themselves.
        of_corners: (m, 3, 3) the blocks of the pairs of corners of each triangle.
    """

    def __init__(self, count: int, triangles: Integers) -> None:
        keys = triangles[:, :, None] * count + triangles[:, None]
        own = np.arange(count) * (count + 1)
        key, place = np.unique(np.concatenate([own, keys.ravel()]), return_inverse=True)
        self.row, self.column = np.divmod(key, count)
        self.start = np.searchsorted(self.row, np.arange(count + 1))
        self.diagonal, self.of_corners = place[:count], place[count:].reshape(-1, 3, 3)


def _normal_equations(
    vertices: Floats,
    triangles: Integers,
    triangle: Integers,
    barycentric: Floats,
    poses: Sequence[tuple[Floats, Floats, float]],
    blocks: _Blocks,
) -> tuple[Floats, Floats]:
    """The blocks (b, 3, 3) and the right side (k, 3) for the displacements that minimise distances in all poses.

    Args:
        vertices: (k, 3) rest positions.
        triangles: (m, 3) vertex numbers.
        triangle: (n,) the triangle that is closest to each point.
        barycentric: (n, 3) the closest place in it.
        poses: for each pose the transforms (k, 3, 4) of the vertices, the points (n, 3) and the weight.
        blocks: where the matrix has blocks.
    """
    count = len(triangles)
    products = {pair: np.zeros((count, 3, 3)) for pair in CORNERS}  # of the slopes at two corners
    right = np.zeros(vertices.shape)
    for motion, goal, weight in poses:
        moved = transform_points(motion, vertices)
        a, b, c = (moved[triangles[:, corner]] for corner in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        # How the distance depends on the rest position of each corner, at the corner.
        slope = np.einsum("mx,mkxz->mkz", normal, motion[triangles][..., :3])
        for (one, other), product in products.items():
            product += weight * slope[:, one, :, None] * slope[:, other, None]
        distance = np.einsum("nx,nx->n", normal[triangle], goal - a[triangle])  # all corners are on the plane
        pull = weight * slope * segment_sum(barycentric * distance[:, None], triangle, count)[:, :, None]
        right += segment_sum(pull.reshape(-1, 3), triangles.ravel(), len(vertices))
    matrix = np.zeros((len(blocks.row), 9))
    for (one, other), product in products.items():
        product *= np.bincount(triangle, barycentric[:, one] * barycentric[:, other], count)[:, None, None]
        matrix += segment_sum(product.reshape(-1, 9), blocks.of_corners[:, one, other], len(matrix))
        if one != other:
            turned = product.transpose(0, 2, 1).reshape(-1, 9)
            matrix += segment_sum(turned, blocks.of_corners[:, other, one], len(matrix))
    return matrix.reshape(-1, 3, 3), right


def _solve(blocks: _Blocks, matrix: Floats, right: Floats) -> Floats:
    """(k, 3) the solution of a positive definite system of blocks (b, 3, 3), by preconditioned conjugate gradients."""
    size = right.size
    inverse = np.linalg.inv(matrix[blocks.diagonal])

    def precondition(values: Floats) -> Floats:
        return np.asarray(np.einsum("kxy,ky->kx", inverse, values.reshape(-1, 3))).ravel()

    system = bsr_array((matrix, blocks.column, blocks.start), shape=(size, size))
    preconditioner = LinearOperator((size, size), matvec=precondition)
    found, _ = cg(system, right.ravel(), rtol=SOLVED, maxiter=MAX_STEPS, M=preconditioner)
    return np.asarray(found).reshape(-1, 3)
