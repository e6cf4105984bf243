# SPDX-License-Identifier: GPL-3.0-or-later
"""Move the vertices of a simplified mesh so that it is close to the original one in all poses.

Minimises the distances of the original vertices from the planes of the triangles that are closest to them at rest, in
the sum of squares over the poses. They are linear in the rest positions, as each pose moves a vertex by a fixed matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import bsr_array, coo_array, csc_array, diags_array, eye_array, kron

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.mesh.triangles import unique_edges, vertex_normals
from zoomout_core.transfer.skinning import transform_points
from zoomout_core.tuning import Tuning, tuned

# Weights of the smoothness of the displacements, and of their size, relative to those of the distances.
SMOOTHNESS, DAMPING = 0.008, 0.02


@dataclass(frozen=True)
class LevelFitTuning(Tuning, set_by="production"):
    """How levels of detail are fitted to the mesh.

    Attributes:
        rounds: times that closest points are found and the vertices moved.
        slip: weight of displacements along the surface, with which textures slip, relative to that of the distances.
        poses: weight of the distances in all other poses, relative to that at rest.
    """

    rounds: int = tuned(4, "1", 0, 20)
    slip: float = tuned(0.3, "1", 0, 100)
    poses: float = tuned(3.0, "1", 0, 10)


LEVEL_FIT = LevelFitTuning()


def fit_level(
    vertices: Floats, triangles: Integers, motions: Sequence[Floats], points: Floats, goals: Sequence[Floats]
) -> Floats:
    """(k, 3) rest positions of a level that is close to the original mesh in all poses.

    Args:
        vertices: (k, 3) rest positions to begin with.
        triangles: (m, 3) vertex numbers.
        motions: for each pose but rest (k, 3, 4) transforms of the vertices.
        points: (n, 3) the vertices of the original mesh at rest.
        goals: for each of these poses the original vertices (n, 3).
    """
    still = np.tile(np.eye(4)[:3], (len(vertices), 1, 1))
    weights = [1.0, *[LEVEL_FIT.poses / max(len(motions), 1)] * len(motions)]
    fitted = vertices.copy()
    edges, _ = unique_edges(triangles)
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
    graph = graph + graph.T
    laplacian: Any = diags_array(np.asarray(graph.sum(axis=1)).ravel()) - graph
    smoothness = kron(laplacian, eye_array(3))
    normals = vertex_normals(vertices, triangles)
    across = normals[:, :, None] * normals[:, None]
    blocks = DAMPING * across + LEVEL_FIT.slip * (np.eye(3) - across)
    held = bsr_array((blocks, np.arange(len(vertices)), np.arange(len(vertices) + 1)))
    for _ in range(LEVEL_FIT.rounds):
        triangle, barycentric = SurfaceSearch(fitted, triangles).closest(points)
        corners = triangles[triangle]
        normal_matrix, right = csc_array((fitted.size, fitted.size)), np.zeros(fitted.size)
        for motion, goal, weight in zip([still, *motions], [points, *goals], weights, strict=True):
            rows, distance = _distances(fitted, motion, corners, barycentric, goal)
            normal_matrix = normal_matrix + weight * (rows.T @ rows)
            right += weight * (rows.T @ distance)
        scale = float(normal_matrix.diagonal().mean())
        system = normal_matrix + scale * (SMOOTHNESS * smoothness + held)
        right -= scale * (held @ (fitted - vertices).ravel())
        fitted = fitted + factorise(system).solve(right).reshape(-1, 3)
    return fitted


def _distances(
    vertices: Floats, motion: Floats, corners: Integers, barycentric: Floats, goal: Floats
) -> tuple[csc_array, Floats]:
    """(n, 3 k) how the distances from planes depend on the rest positions, and the distances (n,) now, in a pose."""
    moved = transform_points(motion, vertices)
    a, b, c = (moved[corners[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    values = np.einsum("nx,nkxz->nkz", normal, motion[corners][..., :3]) * barycentric[:, :, None]
    row = np.repeat(np.arange(len(goal)), 9)
    column = (3 * corners[:, :, None] + np.arange(3)).ravel()
    rows = coo_array((values.ravel(), (row, column)), shape=(len(goal), vertices.size)).tocsc()
    nearest = np.einsum("nk,nkx->nx", barycentric, moved[corners])
    return rows, np.einsum("nx,nx->n", normal, goal - nearest)
