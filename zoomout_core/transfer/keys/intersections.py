# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces of a target that shape keys push through others, such as lips through teeth, unlike those of its source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
import scipy

from zoomout_core.arrays import Booleans, Floats, Integers, row_norms, take_rows
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals

# Finds the pairs (p, 2) of triangles that intersect, each once, among positions (n, 3) and triangles (m, 3): two of the
# first chosen ones (c,), ascending, or one of these and one of the others (o,). Neighbours may be among them.
IntersectingTriangles = Callable[[Floats, Integers, Integers, Integers], Integers]

# The strengths at which keys are looked at.
STRENGTHS = 0.5, 1.0
# Shares of a key's largest motion. Triangles that move less than the first are still, and two still ones are not
# compared. Triangles that intersect less deeply than the second only touch, like closing lips: a tenth of a millimetre
# for a blink.
STILL, TOUCHING = 0.05, 0.01
# Cells along the largest side of what a key moves, and from one to another whose triangles may intersect its own.
CELLS, BESIDE = 32, 2


@dataclass(frozen=True, eq=False)
class Intersections:
    """Finds where keys push faces of a target through others.

    Two triangles count if they intersect in the middle of a key or at its end, neither at rest nor on the source.

    Attributes:
        source: the source at rest.
        target: the target at rest.
        images: (n_t, 3) the vertices of the source around the image of each vertex of the target; -1 where the map is
            not valid, such as when modifiers change the faces of the source.
        intersecting_triangles: finds triangles that intersect, such as by trees of bounding volumes, which the host
            has.
    """

    source: Surface
    target: Surface
    images: Integers
    intersecting_triangles: IntersectingTriangles

    def find(self, of_source: Floats, of_target: Floats) -> Booleans:
        """(n_t,) the vertices of faces that intersect others, where a key moves source (n_s, 3) and target (n_t, 3).

        Vertices whose map is not valid are left out.
        """
        found = np.zeros(len(self.target.vertices), dtype=bool)
        triangles, length = self.target.triangles, row_norms(of_target)
        largest = float(length.max(initial=0))
        moving = _at_any(length > STILL * largest, triangles)
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
        """Pairs (p, 2) of triangles that intersect, of which one is among some chosen ones (m,)."""
        first, others = np.flatnonzero(chosen), np.flatnonzero(~chosen)
        if len(first) and len(others):
            others = np.flatnonzero(_are_near(posed, triangles, chosen))
        return self.intersecting_triangles(posed, triangles, first, others)

    def _new_pairs(self, posed: Floats, moving: Booleans, depth: float) -> Integers:
        """Pairs (p, 2) of triangles that intersect by more than a depth, and do not at rest."""
        triangles = self.target.triangles
        pairs = self._pairs(posed, triangles, moving)
        pairs = _without(pairs, triangles, self._intersecting_at_rest)
        pairs = _without_neighbours(pairs, triangles, self.target.vertices)
        return pairs[_depths(posed, triangles, pairs) > depth]

    @cached_property
    def _intersecting_at_rest(self) -> Booleans:
        """(n_t,) the vertices at and beside faces that intersect others at rest."""
        vertices, triangles = self.target.vertices, self.target.triangles
        pairs = self._pairs(vertices, triangles, np.ones(len(triangles), dtype=bool))
        pairs = _without_neighbours(pairs, triangles, vertices)
        return _widen(np.isin(np.arange(len(vertices)), triangles[pairs]), triangles)

    def _intersecting_images(self, posed: Floats, corners: Integers) -> Booleans:
        """(n_t,) the target's vertices whose images are at or beside faces of the posed source that intersect others.

        Faces of the source are looked at around the images of some of the target's vertices, `corners`.
        """
        triangles = self.source.triangles
        images = self.images[np.unique(corners)]
        around = np.isin(np.arange(len(posed)), images[images[:, 0] >= 0])
        around = _widen(_widen(around, triangles), triangles)
        pairs = self._pairs(posed, triangles, around[triangles].all(axis=1))
        pairs = _without_neighbours(pairs, triangles, self.source.vertices)
        intersecting = _widen(np.isin(np.arange(len(posed)), triangles[pairs]), triangles)
        return intersecting[self.images].any(axis=1)


def _are_near(posed: Floats, triangles: Integers, chosen: Booleans) -> Booleans:
    """(m,) which triangles that are not chosen (m,) are in the cells of a grid in or beside which chosen ones are.

    Cells are at least as large as the triangles, so that none that intersects a chosen one is left out.
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
    return near & _at_any(reached, triangles) & ~chosen


def _at_any(chosen: Booleans, triangles: Integers) -> Booleans:
    """(m,) which triangles (m, 3) have a corner among some vertices (n,)."""
    return np.asarray(reduce(np.logical_or, [chosen[corner] for corner in triangles.T]))


def _without(pairs: Integers, triangles: Integers, known: Booleans) -> Integers:
    """The pairs (p, 2) of triangles that are not both at known vertices (n,)."""
    return pairs[~_at_any(known, triangles)[pairs].all(axis=1)]


def _without_neighbours(pairs: Integers, triangles: Integers, vertices: Floats) -> Integers:
    """The pairs (p, 2) of triangles without a common corner at rest, where seams of UV maps may have split vertices."""
    one, other = (vertices[triangles[side]] for side in pairs.T)
    return pairs[~(one[:, :, None] == other[:, None]).all(axis=3).any(axis=(1, 2))]


def _depths(posed: Floats, triangles: Integers, pairs: Integers) -> Floats:
    """(p,) how far each two triangles must be moved along one of their normals to part."""
    one, other = pairs.T
    return np.minimum(
        _depths_below(posed, triangles[one], triangles[other]), _depths_below(posed, triangles[other], triangles[one])
    )


def _depths_below(posed: Floats, triangles: Integers, others: Integers) -> Floats:
    """(p,) how far each triangle (p, 3) must be moved along the normal of another one to be on one side of it."""
    heights = np.einsum("pcx,px->pc", posed[triangles] - posed[others[:, :1]], triangle_normals(posed, others))
    return np.minimum(heights.max(axis=1), -heights.min(axis=1))


def _widen(chosen: Booleans, triangles: Integers) -> Booleans:
    """Some vertices (n,), and those that share a triangle with them."""
    wider = chosen.copy()
    wider[triangles[_at_any(chosen, triangles)]] = True
    return wider
