# SPDX-License-Identifier: GPL-3.0-or-later
"""Quadric errors of vertices in several poses.

A quadric is a sum of squared distances from planes (Garland and Heckbert 1997): those of the triangles of a vertex, and
planes through its borders and seams. Errors are summed over the poses (Mohr and Gleicher 2003).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers, take_rows
from zoomout_core.mesh.adjacency import Edges
from zoomout_core.mesh.triangles import cross
from zoomout_core.tuning import Tuning, tuned

# Entries of quadrics that are processed together, to bound the memory.
BLOCK = 1 << 19
# Weight of the length of a collapse, to the fourth power as areas times squared errors: it decides where all is flat.
FLAT = 1e-4
# The entries of a symmetric matrix.
ROWS, COLUMNS = np.triu_indices(3)
TWICE = np.where(ROWS == COLUMNS, 1.0, 2.0)


@dataclass(frozen=True)
class SimplificationTuning(Tuning, set_by="production"):
    """How the errors that a collapse makes are weighted.

    Attributes:
        poses: weight of the errors in all other poses, relative to that at rest.
        lines: weight of the distance from borders and seams, relative to that from triangles.
    """

    poses: float = tuned(3.0, "1", 0, 10)
    lines: float = tuned(1.0, "1", 0, 100)


SIMPLIFICATION = SimplificationTuning()


class Quadrics:
    """The quadrics of the vertices of a mesh in its poses.

    Attributes:
        places: (n, p, 3) positions in the poses, in units of the extent at rest.
        weight: (p,) the weights of the poses.
        sums: (n, p, 10) six entries of the symmetric matrix, three of the linear term and the constant, times the areas
            of the planes.
        own: (n,) the error of each vertex at its own place.
        area: (n,) the weighted area of its planes, in all poses.
    """

    def __init__(self, poses: Floats) -> None:
        centre = poses.mean(axis=1, keepdims=True)
        size = max(float(np.ptp(poses[0], axis=0).max()), 1e-30)
        self.places = np.ascontiguousarray(((poses - centre) / size).transpose(1, 0, 2))
        self.weight = np.full(len(poses), SIMPLIFICATION.poses / max(len(poses) - 1, 1))
        self.weight[0] = 1.0

    def sum_planes(self, triangles: Integers, edges: Edges, into: Integers) -> None:
        """Sum the planes of triangles (m, 3) and of the lines among their edges.

        Vertices that were merged have the planes of all of them: `into` (n,) is the vertex that each was merged into.
        """
        self.sums = np.zeros((*self.places.shape[:2], 10))
        self._add_triangles(triangles, into)
        self._add_lines(triangles, edges, into)
        everything = np.arange(len(self.sums))
        self.own = self.errors(everything, everything)
        self.area = self.sums[..., :6][..., ROWS == COLUMNS].sum(axis=(1, 2))  # traces, as normals have unit length

    def _add_planes(self, pose: int, vertices: Integers, places: Floats, normals: Floats, weights: Floats) -> None:
        """Add planes in a pose through places (k, 3) with unit normals (k, 3) to the sums of vertices (k, c)."""
        offset = -(normals * places).sum(axis=1)[:, None]
        rows = np.hstack([normals[:, ROWS] * normals[:, COLUMNS] * TWICE, 2 * normals * offset, offset**2])
        rows *= (weights * self.weight[pose])[:, None]
        count, corners = vertices.shape
        start = np.arange(0, count * corners + 1, corners)
        shape = count, len(self.places)
        incidence = csr_array((np.ones(vertices.size), vertices.ravel(), start), shape=shape)
        self.sums[:, pose] += incidence.T @ rows

    def _add_triangles(self, triangles: Integers, into: Integers) -> None:
        areas = self.normals(triangles, slice(0, 1))[1][:, 0]
        for pose in range(len(self.weight)):
            normals, _ = self.normals(triangles, slice(pose, pose + 1))
            self._add_planes(pose, into[triangles], self.places[triangles[:, 0], pose], normals[:, 0], areas / 3)

    def _add_lines(self, triangles: Integers, edges: Edges, into: Integers) -> None:
        """Add planes through borders and seams, at right angles to their triangles."""
        half = np.flatnonzero(edges.is_line[edges.of_half])
        triangles, ends = triangles[half % len(triangles)], edges.ends[edges.of_half[half]]
        squared = ((self.places[ends[:, 1], 0] - self.places[ends[:, 0], 0]) ** 2).sum(axis=1)
        for pose in range(len(self.weight)):
            start, stop = self.places[ends[:, 0], pose], self.places[ends[:, 1], pose]
            normals = cross(self.normals(triangles, slice(pose, pose + 1))[0][:, 0], stop - start)
            normals /= np.maximum(np.linalg.norm(stop - start, axis=1), 1e-30)[:, None]
            self._add_planes(pose, into[ends], start, normals, SIMPLIFICATION.lines * squared / 2)

    def normals(self, triangles: Integers, poses: slice = slice(None)) -> tuple[Floats, Floats]:
        """(k, p, 3) unit normals of triangles (k, 3) in poses, and (k, p) their areas."""
        a, b, c = (self.places[triangles[:, corner], poses] for corner in range(3))
        normal = cross(b - a, c - a)
        length = np.sqrt(np.einsum("kpx,kpx->kp", normal, normal))
        normal /= np.maximum(length, 1e-30)[..., None]
        return normal, length / 2

    def errors(self, one: Integers, other: Integers) -> Floats:
        """(k,) the quadric errors of vertices `one` at the places of vertices `other`."""
        step = max(1, BLOCK // self.sums[0].size)
        error = np.empty(len(one))
        for start in range(0, len(one), step):
            block = slice(start, start + step)
            place = take_rows(self.places, other[block])
            powers = np.empty((*place.shape[:2], 10))
            np.multiply(place[..., ROWS], place[..., COLUMNS], out=powers[..., :6])
            powers[..., 6:9] = place
            powers[..., 9] = 1
            error[block] = np.einsum("kpq,kpq->k", take_rows(self.sums, one[block]), powers)
        return error

    def costs(self, tail: Integers, head: Integers, distance: float) -> Floats:
        """(k,) the errors of merging vertices `tail` into `head`; infinite if these move farther than a distance.

        The distance is the root mean square of those from the planes, relative to the extent.
        """
        length = ((self.places[tail, 0] - self.places[head, 0]) ** 2).sum(axis=1)
        error = self.errors(tail, head) + self.own[head]
        error[error > distance**2 * (self.area[tail] + self.area[head])] = np.inf
        return error + FLAT * length**2

    def merge(self, tail: Integers, head: Integers) -> None:
        """Add the planes of vertices `tail` (k,) to those of `head` (k,)."""
        np.add.at(self.sums, head, self.sums[tail])
        np.add.at(self.area, head, self.area[tail])
        heads = np.unique(head)
        self.own[heads] = self.errors(heads, heads)
