# SPDX-License-Identifier: GPL-3.0-or-later
"""Subdivision surfaces (Catmull and Clark 1978): points of the limit surface of a cage of polygons.

They follow from a subdivided mesh by fixed masks (Halstead, Kass and DeRose, Efficient, fair interpolation using
Catmull-Clark surfaces, 1993).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array, vstack

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.cut_mesh import face_edges


class LimitPoints(NamedTuple):
    """Points of the limit surface of a cage with n vertices, e edges of faces and f faces: one at each of these.

    Attributes:
        limit: (n + e + f, n) the points, as mixtures of the cage's vertices; rows sum to one.
        flat: (n + e + f, n) the vertices, the middles of edges, and those of faces.
        near: (n + e + f,) a vertex next to each.
    """

    limit: csr_array
    flat: csr_array
    near: Integers


def limit_points(cage: Surface) -> LimitPoints:
    """Points of the limit surface of a cage.

    Borders are smooth curves; creases are ignored. A vertex without a face stays in place.
    """
    flat, subdivided, quads = _subdivide(cage)
    near = np.arange(flat.shape[0])
    near[quads[:, 1:].ravel()] = np.repeat(quads[:, 0], 3)
    return LimitPoints(csr_array(_limit(quads, len(near)) @ subdivided), flat, near)


def _subdivide(cage: Surface) -> tuple[csr_array, csr_array, Integers]:
    """Subdivide once.

    Returns:
        Matrices of the vertices, middles of edges and middles of faces, before and after, and quads (c, 4), one per
        corner.
    """
    n, corners, f = len(cage.vertices), cage.corner_vertex, len(cage.face_start) - 1
    count = len(corners)
    following = face_edges(cage)[:, 1]
    ends = np.sort(np.stack([corners, corners[following]], axis=1), axis=1)
    edges, edge_of = np.unique(ends, axis=0, return_inverse=True)
    edge_of, e = edge_of.ravel(), len(edges)
    sides = np.bincount(edge_of, minlength=e)

    to_vertex = csr_array((np.ones(count), (np.arange(count), corners)), shape=(count, n))
    face_points = _means(
        csr_array((np.ones(count), (cage.corner_face, np.arange(count))), shape=(f, count)) @ to_vertex
    )
    middles = csr_array((np.full(2 * e, 0.5), (np.repeat(np.arange(e), 2), edges.ravel())), shape=(e, n))
    at_edge = _means(csr_array((np.ones(count), (edge_of, cage.corner_face)), shape=(e, f)))
    inner = diags_array((sides == 2).astype(np.float64))
    edge_points = middles - 0.5 * (inner @ middles) + 0.5 * (inner @ at_edge @ face_points)

    valence = np.bincount(corners, minlength=n)
    of_border = csr_array((np.ones(2 * e), (edges.ravel(), np.repeat(np.arange(e), 2))), shape=(n, e)) @ diags_array(
        (sides != 2).astype(np.float64)
    )
    border_edges = np.asarray(of_border.sum(axis=1)).ravel()
    is_inner, on_border = (border_edges == 0) & (valence > 0), border_edges == 2
    k = np.maximum(valence, 1)
    around_faces = _means(csr_array((np.ones(count), (corners, cage.corner_face)), shape=(n, f))) @ face_points
    around_edges = _means(csr_array((np.ones(2 * e), (edges.ravel(), np.repeat(np.arange(e), 2))), shape=(n, e)))
    own = np.where(is_inner, (k - 3) / k, np.where(on_border, 0.5, 1.0))
    vertex_points = (
        diags_array(own)
        + diags_array(is_inner / k) @ (around_faces + 2 * (around_edges @ middles))
        + diags_array(0.25 * on_border) @ of_border @ middles
    )
    quads = np.stack([corners, n + edge_of, n + e + cage.corner_face, n + edge_of[_previous(following)]], axis=1)
    flat = csr_array(vstack([eye_array(n), middles, face_points]))
    return flat, csr_array(vstack([vertex_points, edge_points, face_points])), quads


def _limit(quads: Integers, count: int) -> csr_array:
    """(count, count) matrix that moves the vertices of a mesh of quads (q, 4) to the limit surface."""
    sides = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, edge_of = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
    on_border = edges[np.bincount(edge_of.ravel(), minlength=len(edges)) != 2]
    borders = np.bincount(on_border.ravel(), minlength=count)
    valence = np.bincount(quads.ravel(), minlength=count)
    inner, border = (valence > 0) & (borders == 0), borders == 2
    k = np.maximum(valence, 1)

    rows = quads.ravel()
    beside = [np.roll(quads, step, axis=1).ravel() for step in (1, -1)]
    across = np.roll(quads, 2, axis=1).ravel()
    shape = count, count
    whole = np.ones(len(rows))
    doubled = np.tile(2 * whole, 2)  # each edge is a side of two quads
    edge_sums = csr_array((doubled, (np.tile(rows, 2), np.concatenate(beside))), shape=shape)
    face_sums = csr_array((whole, (rows, across)), shape=shape)
    both = np.concatenate([on_border, on_border[:, ::-1]]).T
    along = csr_array((np.ones(both.shape[1]), (both[0], both[1])), shape=shape)
    own = np.where(inner, k / (k + 5), np.where(border, 2 / 3, 1.0))
    share: Floats = inner / (k * (k + 5))
    return csr_array(diags_array(own) + diags_array(share) @ (edge_sums + face_sums) + diags_array(border / 6) @ along)


def _previous(following: Integers) -> Integers:
    """(c,) the preceding corner of each in its face."""
    before = np.empty_like(following)
    before[following] = np.arange(len(following))
    return before


def _means(matrix: csr_array) -> csr_array:
    """Scale the rows of a matrix to sum to one; empty rows stay."""
    sums = np.asarray(matrix.sum(axis=1)).ravel()
    used: Booleans = sums != 0
    return csr_array(diags_array(np.where(used, 1 / np.where(used, sums, 1), 0)) @ matrix)
