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
    """Points of the limit surface of a cage with n vertices, e edges of faces and f faces: one at each of these."""

    limit: csr_array  # (n + e + f, n) the points, as mixtures of the cage's vertices; rows sum to one
    flat: csr_array  # (n + e + f, n) the vertices, the middles of edges, and those of faces
    near: Integers  # (n + e + f,) a vertex next to each


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
    following = face_edges(cage)[:, 1]
    ends = np.sort(corners[face_edges(cage)], axis=1)
    edges, edge_of = np.unique(ends, axis=0, return_inverse=True)
    edge_of, e = edge_of.ravel(), len(edges)
    sides, of_edge = np.bincount(edge_of, minlength=e), np.repeat(np.arange(e), 2)

    each = np.arange(len(corners))
    face_points = _means(_counts(cage.corner_face, each, (f, len(each))) @ _counts(each, corners, (len(each), n)))
    middles = 0.5 * _counts(of_edge, edges.ravel(), (e, n))
    at_edge = _means(_counts(edge_of, cage.corner_face, (e, f)))
    inner = diags_array((sides == 2).astype(np.float64))
    edge_points = middles - 0.5 * (inner @ middles) + 0.5 * (inner @ at_edge @ face_points)

    valence = np.bincount(corners, minlength=n)
    around = _counts(edges.ravel(), of_edge, (n, e))
    of_border = around @ diags_array((sides != 2).astype(np.float64))
    border_edges = np.asarray(of_border.sum(axis=1)).ravel()
    is_inner, on_border = (border_edges == 0) & (valence > 0), border_edges == 2
    k = np.maximum(valence, 1)
    around_faces = _means(_counts(corners, cage.corner_face, (n, f))) @ face_points
    own = np.where(is_inner, (k - 3) / k, np.where(on_border, 0.5, 1.0))
    vertex_points = (
        diags_array(own)
        + diags_array(is_inner / k) @ (around_faces + 2 * (_means(around) @ middles))
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

    rows, shape = quads.ravel(), (count, count)
    before, across, after = (np.roll(quads, step, axis=1).ravel() for step in (1, 2, -1))
    # Each edge is a side of two quads.
    edge_sums = 2 * _counts(np.tile(rows, 2), np.concatenate([before, after]), shape)
    face_sums = _counts(rows, across, shape)
    both = np.concatenate([on_border, on_border[:, ::-1]])
    along = _counts(both[:, 0], both[:, 1], shape)
    own = np.where(inner, k / (k + 5), np.where(border, 2 / 3, 1.0))
    share: Floats = inner / (k * (k + 5))
    return csr_array(diags_array(own) + diags_array(share) @ (edge_sums + face_sums) + diags_array(border / 6) @ along)


def _previous(following: Integers) -> Integers:
    """(c,) the preceding corner of each in its face."""
    before = np.empty_like(following)
    before[following] = np.arange(len(following))
    return before


def _counts(rows: Integers, columns: Integers, shape: tuple[int, int]) -> csr_array:
    """A matrix of how often each pair of a row (q,) and a column (q,) occurs."""
    return csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)


def _means(matrix: csr_array) -> csr_array:
    """Scale the rows of a matrix to sum to one; empty rows stay."""
    sums = np.asarray(matrix.sum(axis=1)).ravel()
    used: Booleans = sums != 0
    return csr_array(diags_array(np.where(used, 1 / np.where(used, sums, 1), 0)) @ matrix)
