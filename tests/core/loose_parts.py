# SPDX-License-Identifier: GPL-3.0-or-later
"""Balls, rods and sheets around a ball of unit area that is their body, and what a match needs of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from creatures import directions
from scipy.spatial import ConvexHull

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.components.component_mapping import ComponentMap, map_components
from zoomout_core.matching.components.parts import Part
from zoomout_core.matching.pair import Pair
from zoomout_core.mesh.surface import Surface

Place = tuple[float, float, float]
# Of the body, so that lengths are those at unit area.
RADIUS = (4 * np.pi) ** -0.5


def ball(radius: float, at: Place = (0, 0, 0), radii: Place = (1, 1, 1), count: int = 60, seed: int = 0) -> Surface:
    """An ellipsoid."""
    where = directions(count, seed)
    corners = ConvexHull(where).simplices
    a, b, c = (where[corners[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    corners[inward] = corners[inward][:, ::-1]
    return Surface(radius * where * radii + np.array(at), corners)


def sheet(width: float, at: Place = (0, 0, 0), count: int = 8, length: float | None = None) -> Surface:
    """A rectangle across z, of so many squares along either side."""
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.5, 0.5, count + 1)] * 2, indexing="ij"))
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()[:, None]
    points = np.column_stack([width * u, (length or width) * v, 0 * u]) + np.array(at)
    return Surface(points, np.hstack([corner, corner + count + 1, corner + count + 2, corner + 1]))


def part_of(surface: Surface, moved: np.ndarray | float = 0.0) -> Part:
    """A surface of one component as a part, where it is."""
    mesh = surface.working
    n = len(mesh.vertices)
    points = mesh.to_surface(mesh.vertices) + moved
    return Part(mesh, np.arange(n), np.arange(len(mesh.triangles)), points, np.full(n, 1 / n))


BODY = ball(RADIUS, count=200)


def shape_of(surface: Surface, number: int = 0, functions: int = 20) -> ShapeAnalysis:
    """The component of that number as the body of a surface."""
    return analyse(surface.working.part(number)[0], functions, 40, 0)


def identity(shape: ShapeAnalysis) -> SurfaceMap:
    triangles = shape.mesh.triangles
    corner = np.zeros(len(shape.mesh.vertices), dtype=np.int64)
    corner[triangles.ravel()] = np.arange(triangles.size)
    return SurfaceMap(corner // 3, np.eye(3)[corner % 3], triangles)


def pair_around_body(
    source: Sequence[Surface], target: Sequence[Surface], regions: Sequence[tuple[int, int]] = (), number: int = 0
) -> Pair:
    """The body with some parts, and with others; regions pair them by number."""
    sides = [Surface.joined([BODY, *parts]) for parts in (source, target)]
    first = [np.cumsum([len(BODY.vertices), *(len(part.vertices) for part in parts)]) for parts in (source, target)]
    named = [
        tuple(np.arange(first[side][i], first[side][i + 1]) for side, i in enumerate(numbers)) for numbers in regions
    ]
    shapes = [shape_of(side, number) for side in sides]
    return Pair(sides[0], sides[1], shapes[0], shapes[1], 20, 10, regions=named)  # type: ignore[arg-type]


def map_parts(pair: Pair, trust: float = 1.0) -> ComponentMap:
    """What becomes of the parts where the body stays."""
    shape = pair.target_shape
    return map_components(pair, identity(shape), np.full(len(shape.mesh.vertices), trust))
