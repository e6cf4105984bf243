# SPDX-License-Identifier: GPL-3.0-or-later
"""Find faces that shape keys push through others on the target but not on the source, such as lips through teeth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
import scipy

from zoomout_core.arrays import Booleans, Floats, Integers, row_norms, take_rows
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import at_any, triangle_normals, widen

# Takes positions (n, 3), triangles (m, 3), chosen ones (c,), ascending, and others (o,). Finds each pair (p, 2) of
# triangles that intersect once: two chosen ones, or a chosen one and one of the others. Neighbours may be included.
IntersectingTriangles = Callable[[Floats, Integers, Integers, Integers], Integers]

# The strengths at which keys are checked.
STRENGTHS = 0.5, 1.0
# Shares of a key's largest motion. Triangles that move less than the first count as still; pairs of still triangles are
# skipped. Triangles that intersect less deeply than the second only touch, like closing lips. For a blink, this is a
# tenth of a millimetre.
STILL, TOUCHING = 0.05, 0.01
# Grid cells along the largest side of the region that a key moves, and the distance in cells within which triangles may
# intersect.
CELLS, BESIDE = 32, 2


@dataclass(frozen=True, eq=False)
class Intersections:
    """Finds where keys push faces of a target through others.

    Two triangles count if they intersect at half or full strength of a key, but neither at rest nor on the source.

    Attributes:
        source: the source at rest.
        target: the target at rest.
        images: (n_t, 3) the vertices of the source around the image of each vertex of the target; -1 where the map is
            not valid, for example because modifiers change the faces of the source.
        intersecting_triangles: finds triangles that intersect, for example with the host's bounding volume hierarchy.
    """

    source: Surface
    target: Surface
    images: Integers
    intersecting_triangles: IntersectingTriangles

    def find(self, of_source: Floats, of_target: Floats) -> Booleans:
        """A mask (n_t,) of vertices at intersecting faces when a key moves source (n_s, 3) and target (n_t, 3).

        Vertices whose map is not valid are excluded.
        """
        found = np.zeros(len(self.target.vertices), dtype=bool)
        triangles, length = self.target.triangles, row_norms(of_target)
        largest = float(length.max(initial=0))
        moving = at_any(length > STILL * largest, triangles)
        if not moving.any():
            return found
        for strength in STRENGTHS:
            posed = self.target.vertices + strength * of_target
            pairs = self._new_pairs(posed, moving, TOUCHING * largest)
            if len(pairs):
                on_source = self._intersecting_images(self.source.vertices + strength * of_source, triangles[pairs])
                pairs = _without(pairs, triangles, on_source)
            found[triangles[pairs]] = True
        return found & (self.images[:, 0] >= 0)

    def _pairs(self, posed: Floats, triangles: Integers, chosen: Booleans) -> Integers:
        """Pairs (p, 2) of intersecting triangles, at least one of them chosen (m,)."""
        first, others = np.flatnonzero(chosen), np.flatnonzero(~chosen)
        if len(first) and len(others):
            others = np.flatnonzero(_are_near(posed, triangles, chosen))
        return self.intersecting_triangles(posed, triangles, first, others)

    def _new_pairs(self, posed: Floats, moving: Booleans, depth: float) -> Integers:
        """Pairs (p, 2) of triangles that intersect deeper than a threshold, but not at rest."""
        triangles = self.target.triangles
        pairs = self._pairs(posed, triangles, moving)
        pairs = _without(pairs, triangles, self._intersecting_at_rest)
        pairs = _without_neighbours(pairs, triangles, self.target.vertices)
        return pairs[_depths(posed, triangles, pairs) > depth]

    @cached_property
    def _intersecting_at_rest(self) -> Booleans:
        """A mask (n_t,) of vertices at and beside faces that intersect others at rest."""
        vertices, triangles = self.target.vertices, self.target.triangles
        pairs = self._pairs(vertices, triangles, np.ones(len(triangles), dtype=bool))
        pairs = _without_neighbours(pairs, triangles, vertices)
        return widen(np.isin(np.arange(len(vertices)), triangles[pairs]), triangles)

    def _intersecting_images(self, posed: Floats, corners: Integers) -> Booleans:
        """A mask (n_t,) of vertices whose images are at or beside intersecting faces of the posed source.

        Only the faces of the source around the images of `corners`, vertices of the target, are checked.
        """
        triangles = self.source.triangles
        images = self.images[np.unique(corners)]
        around = np.isin(np.arange(len(posed)), images[images[:, 0] >= 0])
        around = widen(widen(around, triangles), triangles)
        pairs = self._pairs(posed, triangles, around[triangles].all(axis=1))
        pairs = _without_neighbours(pairs, triangles, self.source.vertices)
        intersecting = widen(np.isin(np.arange(len(posed)), triangles[pairs]), triangles)
        return intersecting[self.images].any(axis=1)


def _are_near(posed: Floats, triangles: Integers, chosen: Booleans) -> Booleans:
    """A mask (m,) of the other triangles in the grid cells that contain chosen ones (m,), and in cells beside these.

    Cells are at least as large as the triangles, so no triangle that intersects a chosen one is missed.
    """
    corners = [take_rows(posed, corner) for corner in triangles.T]
    first, last = reduce(np.minimum, corners), reduce(np.maximum, corners)
    low, high = first[chosen].min(axis=0), last[chosen].max(axis=0)
    near = reduce(np.logical_and, ((first <= high) & (last >= low)).T)
    size = max(float((high - low).max()) / CELLS, float((last - first)[near].max()), np.finfo(float).tiny)
    shape = np.floor((high - low) / size).astype(np.int64) + 1 + 2 * BESIDE
    cells = np.floor((posed - low) / size).astype(np.int64) + BESIDE
    occupied = np.zeros(shape, dtype=np.uint8)
    occupied[tuple(cells[np.unique(triangles[chosen])].T)] = 1
    occupied = scipy.ndimage.maximum_filter(occupied, 2 * BESIDE + 1)
    inside = np.flatnonzero(reduce(np.logical_and, ((cells >= 0) & (cells < shape)).T))
    reached = np.zeros(len(posed), dtype=bool)
    reached[inside] = occupied[tuple(cells[inside].T)] > 0
    return near & at_any(reached, triangles) & ~chosen


def _without(pairs: Integers, triangles: Integers, known: Booleans) -> Integers:
    """Exclude pairs (p, 2) of triangles that are both at known vertices (n,)."""
    return pairs[~at_any(known, triangles)[pairs].all(axis=1)]


def _without_neighbours(pairs: Integers, triangles: Integers, vertices: Floats) -> Integers:
    """Exclude pairs (p, 2) of triangles that share a corner at rest, including corners split by UV seams."""
    one, other = (vertices[triangles[side]] for side in pairs.T)
    return pairs[~(one[:, :, None] == other[:, None]).all(axis=3).any(axis=(1, 2))]


def _depths(posed: Floats, triangles: Integers, pairs: Integers) -> Floats:
    """Penetration depths (p,): how far two triangles must move along one of their normals to separate."""
    one, other = pairs.T
    return np.minimum(
        _depths_below(posed, triangles[one], triangles[other]), _depths_below(posed, triangles[other], triangles[one])
    )


def _depths_below(posed: Floats, triangles: Integers, others: Integers) -> Floats:
    """Distances (p,) that each triangle (p, 3) must move along another one's normal to be on one side of it."""
    heights = np.einsum("pcx,px->pc", posed[triangles] - posed[others[:, :1]], triangle_normals(posed, others))
    return np.minimum(heights.max(axis=1), -heights.min(axis=1))
