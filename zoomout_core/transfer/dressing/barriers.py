# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that worn objects must not enter: the skin, and the layers beneath them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.oriented_closest_points import ORIENTED_SEARCH, OrientedSurface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas, unit_vectors, vertex_normals
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ContactTuning(Tuning, set_by="outfits"):
    """How to keep worn objects out of the skin.

    Attributes:
        reach: maximum distance from the skin at which a place is tested.
        layer_reach: the same for a layer beneath.
        over: minimum share of the places of a connected part near a layer that are above it. Below it, both cross each
            other and have no order.
        max_margin: maximum distance from the skin that is kept.
        min_margin: minimum distance from the skin that is kept.
        mended: maximum original depth in the skin at which a place of a soft object is pushed out.
        facing: minimum cosine between the direction to the skin and its normal for a known side.
        spread: length over which a push is spread.
        firmness: weight of a push relative to staying.
        rounds: maximum number of rounds of testing and pushing.
        settled: share of a margin that may be missing.
        fine: length of edges below which only their ends are tested.
        looked_at: distance from the margin above which a place is not tested again.
    """

    reach: float = tuned(0.08, "at unit area", 0, 1)
    layer_reach: float = tuned(0.02, "at unit area", 0, 1)
    over: float = tuned(0.8, "1", 0, 1)
    max_margin: float = tuned(0.01, "at unit area", 0, 1)
    min_margin: float = tuned(0.001, "at unit area", 0, 1)
    mended: float = tuned(0.01, "at unit area", 0, 1)
    facing: float = tuned(0.5, "1", 0, 1)
    spread: float = tuned(0.01, "at unit area", 1e-6, 1)
    firmness: float = tuned(30.0, "1", 0, 1e6)
    rounds: int = tuned(8, "rounds", 0, 100)
    settled: float = tuned(3e-4, "at unit area", 0, 1)
    fine: float = tuned(0.02, "at unit area", 0, 1)
    looked_at: float = tuned(0.02, "at unit area", 0, 1)


CONTACT = ContactTuning()
# Minimum mean number of samples of a triangle of a worn object.
SAMPLES = 8
# The smallest and the largest distance from the skin that is kept; places between them keep their own.
Margins: TypeAlias = tuple[float, float]


class SidedSurface:
    """A surface whose normals point outwards.

    Args:
        vertices: (n, 3) positions.
        triangles: (m, 3) their triangles.
        is_part: whether it is a worn object at unit area of the body, whose samples need not be denser than the body's.
    """

    def __init__(self, vertices: Floats, triangles: Integers, *, is_part: bool = False) -> None:
        self.vertices, self.triangles, self._is_part = vertices, triangles, is_part

    @cached_property
    def normals(self) -> Floats:
        """(n, 3) unit normals of the vertices."""
        return vertex_normals(self.vertices, self.triangles)

    @cached_property
    def _search(self) -> OrientedSurface:
        """The search for closest points, created on demand: most layers are far from everything else."""
        points, triangles = ORIENTED_SEARCH.points, self.triangles
        if self._is_part:
            share = float(triangle_areas(self.vertices, triangles).sum())
            points = min(points, max(int(share * points), SAMPLES * len(triangles)))
        upright = np.zeros(len(triangles), dtype=bool)
        return OrientedSurface(self.vertices, triangles, upright, 0.0, points=points)

    @classmethod
    def of(cls, surface: Surface, unit: float) -> SidedSurface:
        """A surface in a unit, wound outwards."""
        triangles, working = surface.triangles.copy(), surface.working
        inward = working.triangle_of[working.flipped]
        triangles[inward] = triangles[inward, ::-1]
        return cls(surface.vertices / unit, triangles)

    def with_vertices(self, vertices: Floats) -> SidedSurface:
        """The same triangles on other vertices (n, 3)."""
        return SidedSurface(vertices, self.triangles)

    def beside(self, points: Floats, reach: float) -> Integers:
        """(b,) numbers of the points (p, 3) in the widened bounding box, which may be within reach."""
        corners = self.vertices[np.unique(self.triangles)]
        return np.flatnonzero(
            ((points > corners.min(axis=0) - reach) & (points < corners.max(axis=0) + reach)).all(axis=1)
        )

    def closest(self, points: Floats) -> tuple[Integers, Floats, Floats]:
        """Triangles, barycentric coordinates and distances of the points closest to points (p, 3).

        They are found by position alone, because worn objects may face either way.
        """
        return self._search.closest(points, np.zeros_like(points))

    def sides(self, points: Floats) -> tuple[Floats, Floats, Booleans]:
        """The distances (p,) of points (p, 3), negative inside, and the skin's normals there (p, 3).

        Also returns (p,) whether the side is known. Beside a border it is not.
        """
        triangle, barycentric, distance = self.closest(points)
        corners = self.triangles[triangle]
        off = points - np.einsum("pc,pcx->px", barycentric, self.vertices[corners])
        normals = unit_vectors(np.einsum("pc,pcx->px", barycentric, self.normals[corners]))
        along = np.einsum("px,px->p", off, normals)
        return np.where(along < 0, -distance, distance), normals, np.abs(along) >= CONTACT.facing * distance


class Barrier(NamedTuple):
    """A surface that a worn object must not enter."""

    before: SidedSurface  # the surface before the change of shape
    after: SidedSurface  # the surface after it
    is_layer: bool = False  # whether it is another worn object; places below it or far from it are then free


class Bounds(Protocol):
    """Surfaces that places must keep a distance from."""

    def pushes(self, places: Floats) -> tuple[Integers, Floats]:
        """(v,) numbers of the places (p, 3) that are too close, and (v, 3) how they must move."""
        ...


def margins_with(gap: float) -> Margins:
    """Margins of at least a gap."""
    smallest = max(CONTACT.min_margin, gap)
    return smallest, max(CONTACT.max_margin, smallest)
