# SPDX-License-Identifier: GPL-3.0-or-later
"""Closest points on triangle soups with agreeing normals, for surfaces with two layers close together.

Triangles may have any size: sampled points represent them in neighbour searches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_on_triangles, query_tree, search_tree
from zoomout_core.mesh.triangles import area_normals, triangle_areas, unit_vectors
from zoomout_core.tuning import Tuning, tuned

# Distance of groups in an extra coordinate, in units of the surface's extent.
APART = 1e3
# Queries processed together; bounds the memory.
QUERIES_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class OrientedSearchTuning(Tuning, set_by="characters"):
    """How densely to sample a surface for closest-point searches.

    Attributes:
        points: number of samples of a surface.
        min_points: additional samples of each group of triangles.
        candidates: number of samples nearest to a query whose triangles are tested.
    """

    points: int = tuned(120_000, "points", 0, 10_000_000)
    min_points: int = tuned(48, "points", 1, 100_000)
    candidates: int = tuned(6, "points", 2, 1000)


ORIENTED_SEARCH = OrientedSearchTuning()


def surface_samples(vertices: Floats, triangles: Integers, count: int) -> tuple[Floats, Integers]:
    """(count, 3) points that represent equal areas of triangles (m, 3), and (count,) their triangles.

    They are stratified along the triangles' order; within a triangle they follow the additive recurrence of the plastic
    number (Roberts, The unreasonable effectiveness of quasirandom sequences, 2018).
    """
    cumulative = np.cumsum(triangle_areas(vertices, triangles))
    at = (np.arange(count) + 0.5) / count * cumulative[-1]
    chosen = np.minimum(np.searchsorted(cumulative, at), len(triangles) - 1)
    u, v = np.modf(np.arange(1, count + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532]))[0].T
    beyond = u + v > 1
    u, v = np.where(beyond, 1 - u, u), np.where(beyond, 1 - v, v)
    a, b, c = (vertices[triangles[chosen, i]] for i in range(3))
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), chosen


class OrientedSurface:
    """Triangles, prepared for searches of the points closest to places with normals.

    Args:
        vertices: (n, 3) positions.
        triangles: (m, 3) vertex numbers.
        flipped: (m,) which triangles wind inwards.
        normal_weight: the distance that counts as much as a unit difference of normals.
        group: (m,) integers from 0, to search closest points only within a group of triangles.
        points: number of samples; by the tuning, when not given.
        traits: (m, d) further coordinates of the triangles, in units of length, for searches of similar ones.
    """

    def __init__(
        self,
        vertices: Floats,
        triangles: Integers,
        flipped: Booleans,
        normal_weight: float,
        group: Integers | None = None,
        points: int | None = None,
        traits: Floats | None = None,
    ) -> None:
        self._vertices, self._triangles, self._weight = vertices, triangles, normal_weight
        of_group = np.zeros(len(triangles), dtype=np.int64) if group is None else group
        self._boxes = _bounding_boxes(vertices[triangles], of_group)
        area = np.bincount(of_group, triangle_areas(vertices, triangles))
        members = np.split(np.argsort(of_group, kind="stable"), np.cumsum(np.bincount(of_group))[:-1])
        samples, on = ORIENTED_SEARCH.points if points is None else points, list[Integers]()
        places = list[Floats]()
        for chosen, share in zip(members, area / max(area.sum(), 1e-300), strict=True):
            if len(chosen):
                count = ORIENTED_SEARCH.min_points + int(samples * share)
                place, at = surface_samples(vertices, triangles[chosen], count)
                places.append(place)
                on.append(chosen[at])
        self._on = np.concatenate(on)
        normals = np.zeros((len(self._on), 3))
        if normal_weight > 0:
            of_triangles = unit_vectors(area_normals(vertices, triangles)) * np.where(flipped, -1, 1)[:, None]
            normals = of_triangles[self._on]
        self._apart = 0.0 if group is None else APART * float(np.ptp(vertices, axis=0).max())
        own = np.empty((len(triangles), 0)) if traits is None else traits
        rows = self._rows(np.concatenate(places), normals, of_group[self._on], own[self._on])
        self._tree = search_tree(rows)

    def has_group(self, group: Integers) -> Booleans:
        """(q,) whether there are triangles of groups (q,)."""
        low, _ = self._boxes
        return np.isfinite(low[:, 0])[np.minimum(group, len(low) - 1)] & (group < len(low))

    def points_at(self, triangle: Integers, barycentric: Floats) -> Floats:
        """(q, 3) points by their triangles (q,) and barycentric coordinates (q, 3)."""
        return np.asarray(np.einsum("qc,qcx->qx", barycentric, self._vertices[self._triangles[triangle]]))

    def min_distance(self, points: Floats, group: Integers) -> Floats:
        """(q,) distances from points (q, 3) to the bounding boxes of groups (q,), lower bounds for their triangles."""
        low, high = (each[group] for each in self._boxes)
        return np.asarray(np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1))

    def closest(
        self, points: Floats, normals: Floats, group: Integers | None = None, traits: Floats | None = None
    ) -> tuple[Integers, Floats, Floats]:
        """The closest points for places (q, 3) with unit normals (q, 3) and traits (q, d), in groups (q,).

        Returns:
            (q,) triangle numbers, (q, 3) barycentric coordinates, and (q,) distances.
        """
        of_group = np.zeros(len(points), dtype=np.int64) if group is None else group
        own = np.empty((len(points), 0)) if traits is None else traits
        pieces = [
            self._closest(points[some], self._rows(points[some], normals[some], of_group[some], own[some]))
            for some in np.array_split(np.arange(len(points)), 1 + len(points) // QUERIES_AT_ONCE)
        ]
        triangle, barycentric, distance = (np.concatenate(part) for part in zip(*pieces, strict=True))
        return triangle, barycentric, distance

    def _rows(self, points: Floats, normals: Floats, group: Integers, traits: Floats) -> Floats:
        """(q, d) coordinates of points in the tree: those of normals and groups only if they count."""
        of_normals, of_groups = self._weight * normals[:, : 3 * (self._weight > 0)], self._apart * group[:, None]
        return np.hstack([points, of_normals, of_groups[:, : self._apart > 0], traits])

    def _closest(self, points: Floats, rows: Floats) -> tuple[Integers, Floats, Floats]:
        candidate = self._on[query_tree(self._tree, rows, ORIENTED_SEARCH.candidates)[1]]
        a, b, c = (self._vertices[self._triangles[candidate, i]] for i in range(3))
        weights, off = closest_on_triangles(points[:, None], a, b, c)
        distance = np.sqrt(np.einsum("qcx,qcx->qc", off, off))
        best = np.argmin(distance, axis=1)
        query = np.arange(len(points))
        return candidate[query, best], weights[query, best], distance[query, best]


def _bounding_boxes(corners: Floats, group: Integers) -> tuple[Floats, Floats]:
    """(g, 3) lowest and (g, 3) highest coordinates of groups (m,) of triangles (m, 3, 3), infinite for empty groups."""
    order = np.argsort(group, kind="stable")
    numbers, first = np.unique(group[order], return_index=True)
    low, high = (np.full((numbers[-1] + 1, 3), bound) for bound in (np.inf, -np.inf))
    low[numbers] = np.minimum.reduceat(corners.min(axis=1)[order], first)
    high[numbers] = np.maximum.reduceat(corners.max(axis=1)[order], first)
    return low, high
