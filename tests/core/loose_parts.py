# SPDX-License-Identifier: GPL-3.0-or-later
"""Balls, rods and sheets around a body, which is a ball of unit area, prepared for matching."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.component_mapping import ComponentMap, map_components
from zoomout_core.matching.components.parts import Part
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.grids import grid, grid_faces
from zoomout_core.samples.spheres import Place, ball, directions

# Radius of the body, whose area is 1, so that lengths are in units of unit area.
RADIUS = (4 * np.pi) ** -0.5


def egg(radii: np.ndarray | Place = (1.0, 0.6, 0.3), seed: int = 0, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and triangles of an ellipsoid that is blunt on three sides, which leaves it no symmetry."""
    where = directions(count, seed)
    return (where + 0.9 * np.maximum(where, 0) ** 2) * radii, ConvexHull(where).simplices


def sheet(width: float, at: Place = (0, 0, 0), count: int = 8, length: float | None = None) -> Surface:
    """A rectangle perpendicular to z, with `count` quads along each side."""
    flat = grid(*(side * np.linspace(-0.5, 0.5, count + 1) for side in (width, length or width)))
    return Surface(flat.vertices + np.array(at), grid_faces(count, count))


def part_of(surface: Surface, moved: np.ndarray | float = 0.0) -> Part:
    """A surface of one component as a part, shifted by `moved`."""
    mesh = surface.working
    n = len(mesh.vertices)
    points = mesh.to_surface(mesh.vertices) + moved
    return Part(mesh, np.arange(n), np.arange(len(mesh.triangles)), points, np.full(n, 1 / n))


BODY = ball(RADIUS, count=200)


def shape_of(surface: Surface, number: int = 0, functions: int = 20) -> ShapeAnalysis:
    """Analyse component `number` of a surface as its body."""
    return analyse(surface.working.part(number)[0], functions, 40, 0)


def identity(shape: ShapeAnalysis) -> SurfaceMap:
    triangles = shape.mesh.triangles
    corner = np.zeros(len(shape.mesh.vertices), dtype=np.int64)
    corner[triangles.ravel()] = np.arange(triangles.size)
    return SurfaceMap(corner // 3, np.eye(3)[corner % 3], triangles)


def pair_around_body(
    source: Sequence[Surface], target: Sequence[Surface], regions: Sequence[tuple[int, int]] = (), number: int = 0
) -> Pair:
    """Pair the body and the source's parts with the body and the target's; regions pair the parts by number."""
    sides = [Surface.joined([BODY, *parts]) for parts in (source, target)]
    first = [np.cumsum([len(BODY.vertices), *(len(part.vertices) for part in parts)]) for parts in (source, target)]
    named = [
        tuple(np.arange(first[side][i], first[side][i + 1]) for side, i in enumerate(numbers)) for numbers in regions
    ]
    shapes = [shape_of(side, number) for side in sides]
    return Pair(sides[0], sides[1], shapes[0], shapes[1], 20, 10, regions=named)  # type: ignore[arg-type]


def map_parts(pair: Pair, trust: float = 1.0) -> ComponentMap:
    """Map the parts while the body stays in place."""
    shape = pair.target_shape
    return map_components(pair, identity(shape), np.full(len(shape.mesh.vertices), trust))
