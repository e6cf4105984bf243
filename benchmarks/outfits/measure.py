# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures of a worn object beside the object that is expected there."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unique_edges

# Places farther from the skin, in centimetres, do not count for thickness.
NEAR = 5.0
# Places are in the skin if they are deeper than this, in centimetres.
DEEP = 0.1
# An edge is a fold if the angle between its faces exceeds this, unless it was one before.
FOLD = np.cos(np.radians(120))
# An edge is stretched if it grows by more than this multiple of the body's growth.
STRETCHED = 2.0
# A face is torn if one of its edges grows by more than this multiple, and is longer than this, in centimetres.
TORN, LONG = 5.0, 3.0


class Skin:
    """A body, with signed distances of points."""

    def __init__(self, body: Surface) -> None:
        self.size = float(np.sqrt(body.area))
        self._body = body
        self._search = OrientedSurface(body.vertices, body.triangles, np.zeros(len(body.triangles), dtype=bool), 0.0)
        self._normals = body.working.vertex_normals[body.working.vertex_of]

    def distances(self, points: Floats) -> Floats:
        """(q,) distances from the skin, negative inside."""
        triangle, weights, distance = self._search.closest(points, np.zeros_like(points))
        corners = self._body.triangles[triangle]
        off = points - np.einsum("qc,qcx->qx", weights, self._body.vertices[corners])
        along = np.einsum("qx,qc,qcx->q", off, weights, self._normals[corners])
        return np.where(along < 0, -distance, distance)


class Expected:
    """The place of a worn object that is expected on the second of two skins.

    Args:
        thing: the object on the first skin.
        skins: both skins.
        centimetre: its length in units of the first one.
        truth: (n, 3) its vertices on the second one, if they are known.
    """

    def __init__(
        self, thing: Surface, skins: tuple[Skin, Skin], centimetre: float, truth: Floats | None = None
    ) -> None:
        self._thing, self._skin, self._truth = thing, skins[1], truth
        self._growth = skins[1].size / skins[0].size
        self._centimetre = centimetre
        self._was = skins[0].distances(sample_places(thing, thing.vertices)) / centimetre
        self._off = self._was if truth is None else self._distances(truth)
        self._edges, self._edge_of = unique_edges(thing.triangles)

    def figures(self, found: Floats) -> dict[str, float]:
        """The figures of vertices (n, 3).

        `error`: mean distance of vertices from the truth, in centimetres. `off surface`: mean distance from its
        surface, which is zero if the garment only slides along itself. `in skin`: percentage of places (vertices and
        centroids of triangles) that are in the target's skin but not so in the truth or, if that is unknown, on the
        source; `was in`: that are so there; `all in skin`: that are in the target's skin. `thickness`: median change of
        the distance from the skin, in centimetres, at equal body size. `spread`: standard deviation of the logarithm of
        the ratio of edge lengths. `stretched`: percentage of edges that grow by more than twice the body's growth.
        `torn`: faces with an edge that grows by far more. `folds`: edges at which faces fold over.
        """
        thing = self._thing
        off, near = self._distances(found), (self._was > 0) & (self._was < NEAR)
        stretch, _ = self._stretch(found)
        return {
            "error": np.nan if self._truth is None else self._mean_distance(found, self._truth),
            "off surface": np.nan if self._truth is None else self._mean_distance(found, self._on_truth(found)),
            **self.in_pose(found),
            "thickness": float(np.median(np.abs(off - self._was)[near])) if near.any() else np.nan,
            "spread": float(np.log(stretch).std()),
            "folds": float((_folds(thing, found) & ~_folds(thing, thing.vertices)).sum()),
        }

    def _mean_distance(self, found: Floats, others: Floats) -> float:
        """The mean distance of vertices (n, 3) from others (n, 3), in centimetres."""
        return float(np.linalg.norm(found - others, axis=1).mean() / self._centimetre)

    def _on_truth(self, found: Floats) -> Floats:
        """(n, 3) the points of the true surface closest to vertices (n, 3)."""
        assert self._truth is not None
        triangle, weights = closest_points(found, self._truth, self._thing.triangles)
        return np.asarray(np.einsum("nc,ncx->nx", weights, self._truth[self._thing.triangles[triangle]]))

    def in_pose(self, found: Floats) -> dict[str, float]:
        """Those of the figures that a pose may change."""
        off = self._distances(found)
        stretch, length = self._stretch(found)
        torn = (stretch > TORN * self._growth) & (length > LONG * self._centimetre * self._growth)
        return {
            "in skin": 100 * float(((off < -DEEP) & (self._off >= -DEEP)).mean()),
            "was in": 100 * float((self._off < -DEEP).mean()),
            "all in skin": 100 * float((off < -DEEP).mean()),
            "stretched": 100 * float((stretch > STRETCHED * self._growth).mean()),
            "torn": float(torn[self._edge_of].any(axis=1).sum()),
        }

    def _stretch(self, found: Floats) -> tuple[Floats, Floats]:
        """(e,) how many times as long as before the edges are, and (e,) their lengths."""
        before, after = (
            np.linalg.norm(np.diff(points[self._edges], axis=1)[:, 0], axis=1)
            for points in (self._thing.vertices, found)
        )
        return np.maximum(after, 1e-12) / np.maximum(before, 1e-12), after

    def _distances(self, points: Floats) -> Floats:
        """(p,) distances of places from the second skin, in centimetres at the size of the first one."""
        return self._skin.distances(sample_places(self._thing, points)) / self._centimetre / self._growth


def sample_places(thing: Surface, points: Floats) -> Floats:
    """(n + m, 3) vertices and centroids of triangles of a thing with vertices (n, 3)."""
    return np.concatenate([points, points[thing.triangles].mean(axis=1)])


def _folds(thing: Surface, points: Floats) -> Booleans:
    """(e,) edges between two triangles, one of which folds over the other."""
    working = thing.working
    used = np.flatnonzero(working.vertex_of >= 0)
    first = np.empty(len(working.vertices), dtype=np.int64)
    first[working.vertex_of[used]] = used
    corners = working.oriented_triangles
    normals = triangle_normals(points[first], corners)
    _, edge_of = unique_edges(corners)
    order = np.argsort(edge_of.ravel(), kind="stable")
    edge, face = edge_of.ravel()[order], order // 3
    same = edge[1:] == edge[:-1]
    return np.asarray(same & (np.einsum("mx,mx->m", normals[face[1:]], normals[face[:-1]]) < FOLD))
