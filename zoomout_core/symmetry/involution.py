# SPDX-License-Identifier: GPL-3.0-or-later
"""A map of a mesh onto itself that is its own inverse: T(T(x)) = x, as closely as the mesh allows."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.embedded_surface import project_to_embedding
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.surface import Surface

# Weight of normals relative to positions, at unit area, which separates the two sides of thin parts.
NORMAL_WEIGHT = 0.1
# Iterations that average a map with its inverse.
AVERAGING_ITERATIONS = 2
# Highest recognised order of a symmetry.
MAX_ORDER = 12
# A repeated map has returned if the mean distance to the start is below the first number, at unit area, or below the
# second number times the first step: coarse meshes return less exactly.
RETURN_DISTANCE = 0.08
RETURN_FRACTION = 0.25


def involution(there: SurfaceMap, shape: ShapeAnalysis) -> SurfaceMap:
    """Make a map of the shape's mesh to itself nearly its own inverse, by averaging it with its inverse in each round.

    The inverse is searched around the map's own images, so limbs that touch are not confused.
    """
    mesh = shape.mesh
    places = np.hstack([mesh.vertices, NORMAL_WEIGHT * mesh.vertex_normals])
    for _ in range(AVERAGING_ITERATIONS):
        images = there.interpolate(places)
        back = SurfaceMap(
            *project_to_embedding(places, images, shape.neighbourhoods, there.vertex), there.source_triangles
        )
        halfway = (images + back.interpolate(places)) / 2
        triangle, barycentric = project_to_embedding(halfway, places, shape.neighbourhoods, there.vertex)
        there = SurfaceMap(triangle, barycentric, there.source_triangles)
    return there


def order_of(sample_map: Integers, shape: ShapeAnalysis) -> int:
    """How many repetitions of a map (s,) of a shape's search samples give the identity; 0 if none up to `MAX_ORDER`."""
    at = sample_map
    home = max(RETURN_DISTANCE, RETURN_FRACTION * mean_distance(at, shape))
    for order in range(1, MAX_ORDER + 1):
        if mean_distance(at, shape) < home:
            return order
        at = sample_map[at]
    return 0


def mean_distance(sample_map: Integers, shape: ShapeAnalysis) -> float:
    """Mean distance along the surface by which a map (s,) moves a shape's search samples, at unit area."""
    return float(shape.weights @ displacement(sample_map, shape))


def displacement(sample_map: Integers, shape: ShapeAnalysis) -> Floats:
    """(s,) distance along the surface by which a map (s,) moves each of a shape's search samples, at unit area.

    An image is replaced by the nearest of the samples from which distances are known.
    """
    images = shape.nearest_distance_sample[sample_map]
    return np.asarray(shape.distances_between[images, np.arange(len(sample_map))])


def return_error(surface_map: SurfaceMap, order: int, surface: Surface) -> float:
    """Mean distance in space between a vertex and its image after `order` repetitions, over the root of the area."""
    places = returned = surface.vertices
    for _ in range(order):
        returned = surface_map.interpolate(returned)
    missed = np.linalg.norm(returned - places, axis=1)
    return float(missed[np.isfinite(missed)].mean() / np.sqrt(surface.area))
