"""How a map turns the source's surface: what is a direction there is another on the target.

The rotation at a vertex is the one that fits the edges around it best, laid onto the source, to where they are on the
target (the polar part of the map's differential; Sorkine and Alexa, As-rigid-as-possible surface modeling, 2007). A
normal is fitted with the edges of each triangle, so that flat places have a rotation too. Maps are rough from one
triangle to the next, so rotations are pooled over a neighbourhood.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, eye_array

from zoomout_core.surface import Floats, Surface, edge_graph, triangle_normals
from zoomout_core.transfer.attribute import Domain
from zoomout_core.transfer.draped import Draped

# Rotations are pooled about this far, for a surface of unit area.
POOLING = 0.01
# What a place without confidence counts for.
LEAST_CONFIDENCE = 1e-3


def rotations(draped: Draped, domain: Domain) -> Floats:
    """(count, 3, 3) what turns a direction of the source into one of the target, at points, faces or corners.

    They are reflections where the map mirrors the source.
    """
    target, fitted = draped.target, _fitted(draped)
    if domain is Domain.FACE:
        return closest_rotations(np.add.reduceat(fitted[target.corner_vertex], target.face_start[:-1]))
    at_points = closest_rotations(fitted)
    return at_points if domain is Domain.POINT else at_points[target.corner_vertex]


def closest_rotations(matrices: Floats) -> Floats:
    """(q, 3, 3) the rotations closest to matrices (q, 3, 3), or reflections if most of these turn inside out.

    Polar decomposition by singular values (Higham 1986); the last one's sign makes all of one handedness.
    """
    left, stretch, right = np.linalg.svd(matrices)
    handed = np.sign(np.linalg.det(left @ right))
    # By volume, which is zero for what is flat and could be either.
    mirrored = (handed * stretch.prod(axis=1)).sum() < 0
    left[:, :, 2] *= (handed * (-1 if mirrored else 1))[:, None]
    return np.asarray(left @ right)


def _fitted(draped: Draped) -> Floats:
    """(n_t, 3, 3) sums of products of the target's edges with the source's, around each vertex."""
    source, target = draped.source, draped.target
    triangles = target.triangles
    here, there = target.vertices[triangles], draped.points[triangles]
    sides, laid_sides = (np.roll(corners, -1, axis=1) - corners for corners in (here, there))
    products = np.einsum("msx,msy->mxy", sides, laid_sides)
    normals = triangle_normals(source.vertices, source.triangles)[draped.surface_map.triangle[triangles]].mean(axis=1)
    laid_normals = triangle_normals(draped.points, triangles)
    facing = np.einsum("mx,mx->m", laid_normals, normals)
    # For an equilateral triangle this is what a side's direction counts.
    weight = 0.5 * np.sqrt((sides**2).sum(axis=(1, 2)) * (laid_sides**2).sum(axis=(1, 2))) * facing
    products += (weight[:, None] * triangle_normals(target.vertices, triangles))[:, :, None] * laid_normals[:, None, :]
    products *= (draped.confidence[triangles].mean(axis=1) + LEAST_CONFIDENCE)[:, None, None]

    knot_of = target.working.vertex_of
    count = knot_of.max() + 1
    knots = knot_of[triangles]
    known = np.repeat((knots >= 0).all(axis=1), 3)
    corner, triangle = knots.ravel()[known], np.repeat(np.arange(len(triangles)), 3)[known]
    at = coo_array((np.ones(len(corner)), (corner, triangle)), shape=(count, len(triangles))).tocsr()
    fitted = at @ products.reshape(-1, 9)
    fitted = _pooled(fitted, target)
    fitted = np.concatenate([fitted, np.zeros((1, 9))])  # the last for vertices of no face
    return fitted[knot_of].reshape(-1, 3, 3)


def _pooled(values: Floats, surface: Surface) -> Floats:
    """Values (k, ...) of the working vertices, each with those of a neighbourhood: of about one size, however fine."""
    working = surface.working
    graph = edge_graph(working.vertices, working.triangles)
    graph.data = np.exp(-((graph.data / POOLING) ** 2))
    graph = graph + eye_array(graph.shape[0])
    total = np.asarray(graph.sum(axis=1)).reshape(-1, 1)
    edge = 1 / np.sqrt(len(working.triangles))
    for _ in range(max(1, round((POOLING / edge) ** 2))):
        values = np.asarray(graph @ values) / total
    return values
