# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangulate a polygon by clipping ears, the shortest cut first.

An ear is a corner whose triangle with its two neighbours is inside the polygon (the two ears theorem: Meisters 1975).
Cutting one off affects only its neighbours, and only reflex corners can block an ear. These are kept in a grid, so that
short cuts check few of them. Polygons that touch themselves, such as those with holes joined by bridges, are supported;
those that cross themselves are triangulated somehow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from heapq import heapify, heappop, heappush

import numpy as np

from zoomout_core.arrays import Floats, Integers

Point = tuple[float, float]

# Three corners are collinear if the sine of the angle between them is below this, which is rounding.
STRAIGHT = 1e-10
# The order of cutting: ears, then collinear corners, then any other corner.
EAR, ON_A_LINE, NO_EAR = range(3)


def clip_ears(points: Floats, normal: Floats) -> Integers:
    """(size - 2, 3) a triangulation of one polygon (size, 3), seen along its normal (3,)."""
    return np.array(_Polygon(_flat(points, normal)).triangles())


def _flat(points: Floats, normal: Floats) -> list[Point]:
    """Project the points to their approximate plane, counter-clockwise, in a square of about unit size."""
    length = np.linalg.norm(normal)
    along = normal / length if length > 0 else np.array([0.0, 0, 1])
    side = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    side /= np.linalg.norm(side)
    flat = (points - points.mean(axis=0)) @ np.stack([side, np.cross(along, side)], axis=1)
    return [tuple(point) for point in (flat / (np.ptp(flat, axis=0).max() or 1)).tolist()]


def _turn(a: Point, b: Point, c: Point) -> float:
    """Twice the signed area of a triangle: positive if the path from a through b to c turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


class _Polygon:
    """The remaining polygon, as a ring of corners."""

    def __init__(self, points: list[Point]) -> None:
        size = len(points)
        self._points = points
        self._before = [size - 1, *range(size - 1)]
        self._after = [*range(1, size), 0]
        turns = [self._bend(corner) for corner in range(size)]
        self._reflex = {corner for corner in range(size) if turns[corner] <= 0}
        self._low = low = tuple(map(min, zip(*points, strict=True)))
        high = tuple(map(max, zip(*points, strict=True)))
        # Columns and rows per unit length: about as many cells as reflex corners.
        along = max(1.0, len(self._reflex) ** 0.5)
        self._columns, self._rows = (along / ((high[axis] - low[axis]) or 1) for axis in range(2))
        self._cells: dict[tuple[int, int], list[int]] = {}
        for corner in self._reflex:
            x, y = points[corner]
            self._cells.setdefault((self._column(x), self._row(y)), []).append(corner)

    def triangles(self) -> list[tuple[int, int, int]]:
        """Cut off one corner after another."""
        size = len(self._points)
        latest = [self._rank(corner) for corner in range(size)]
        order = latest.copy()
        heapify(order)
        found: list[tuple[int, int, int]] = []
        gone = [False] * size
        while len(found) < size - 3:
            entry = heappop(order)
            corner = entry[2]
            if gone[corner] or entry != latest[corner]:
                continue  # outdated: it has a newer rank
            if entry[0] == NO_EAR:  # where a polygon crosses itself, a cut may change more than its neighbours
                latest[corner] = self._rank(corner)
                if latest[corner] != entry:
                    heappush(order, latest[corner])
                    continue
            before, after = self._before[corner], self._after[corner]
            found.append((before, corner, after))
            gone[corner] = True
            self._reflex.discard(corner)
            self._after[before], self._before[after] = after, before
            for other in (before, after):
                latest[other] = self._rank(other)
                heappush(order, latest[other])
        last = gone.index(False)
        return [*found, (self._before[last], last, self._after[last])]

    def _rank(self, corner: int) -> tuple[int, float, int]:
        """The rank of a corner; the smallest is cut first."""
        bend = self._bend(corner)
        if bend > 0:
            self._reflex.discard(corner)
            if not self._is_blocked(corner):
                (ax, ay), (cx, cy) = self._points[self._before[corner]], self._points[self._after[corner]]
                return EAR, (cx - ax) ** 2 + (cy - ay) ** 2, corner
        return ON_A_LINE if bend == 0 else NO_EAR, -bend, corner

    def _bend(self, corner: int) -> float:
        """How much the polygon turns at a corner, positive to the left; zero up to rounding."""
        a, b, c = (self._points[each] for each in (self._before[corner], corner, self._after[corner]))
        turn = _turn(a, b, c)
        legs = ((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) * ((c[0] - b[0]) ** 2 + (c[1] - b[1]) ** 2)
        return turn if turn * turn > STRAIGHT * STRAIGHT * legs else 0.0

    def _is_blocked(self, corner: int) -> bool:
        """Whether a part of the polygon is in the triangle of a corner and its neighbours."""
        ring = self._before[corner], corner, self._after[corner]
        a, b, c = (self._points[each] for each in ring)
        for other in self._reflex_near(a, b, c):
            if other in ring:
                continue
            p = self._points[other]
            # Negative beyond an edge, zero on its line.
            ab, bc, ca = _turn(a, b, p), _turn(b, c, p), _turn(c, a, p)
            if ab < 0 or bc < 0 or ca < 0:
                continue
            if ab > 0 and bc > 0:
                return True  # inside, or on the cut
            # The corner touches an edge or a corner: does one of its own edges lead into the triangle?
            for end in (self._points[self._before[other]], self._points[self._after[other]]):
                if (
                    (ab > 0 or _turn(a, b, end) > 0)
                    and (bc > 0 or _turn(b, c, end) > 0)
                    and (ca > 0 or _turn(c, a, end) > 0)
                ):
                    return True
        return False

    def _reflex_near(self, *triangle: Point) -> Iterator[int]:
        """The reflex corners in the cells of the grid that a triangle covers."""
        first, last = (self._column(choose(x for x, _ in triangle)) for choose in (min, max))
        for column in range(first, last + 1):
            heights = [y for x, y in triangle if self._column(x) == column]
            if first < last:
                heights += self._crossings(triangle, column) + self._crossings(triangle, column + 1)
            for row in range(self._row(min(heights)), self._row(max(heights)) + 1):
                for corner in self._cells.get((column, row), ()):
                    if corner in self._reflex:
                        yield corner

    def _crossings(self, triangle: Sequence[Point], column: int) -> list[float]:
        """Where the sides of a triangle cross the first line of a column."""
        x = self._low[0] + column / self._columns
        return [
            ay + (x - ax) / (bx - ax) * (by - ay)
            for (ax, ay), (bx, by) in zip(triangle, (*triangle[1:], triangle[0]), strict=True)
            if (ax < x) != (bx < x)
        ]

    def _column(self, x: float) -> int:
        return int((x - self._low[0]) * self._columns)

    def _row(self, y: float) -> int:
        return int((y - self._low[1]) * self._rows)
