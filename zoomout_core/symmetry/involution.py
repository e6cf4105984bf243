# SPDX-License-Identifier: GPL-3.0-or-later
"""A map of a mesh onto itself that undoes itself: T(T(x)) = x, as nearly as the mesh allows."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import project_to_embedding
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.mesh.surface import Surface

# Weight of normals against positions, at unit area, which separates the two sides of thin parts.
NORMAL_WEIGHT = 0.1
# Iterations that average a map with its inverse.
AVERAGING_ITERATIONS = 2
# Highest order of a symmetry that is recognised.
MAX_ORDER = 12
# A map has returned if the mean distance to the start is below this, at unit area, or below this fraction of the
# distance of its first step, since coarse meshes return less exactly.
RETURN_DISTANCE = 0.08
RETURN_FRACTION = 0.25


def involution(there: SurfaceMap, shape: ShapeAnalysis) -> SurfaceMap:
    """A map that is nearly its own inverse: in each round the mean of itself and its inverse.

    The inverse is searched around the map's own images: all is local, and limbs that touch do not matter.

    Args:
        there: from the shape's mesh to itself.
        shape: the shape.
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
    """How many times a symmetry has to be repeated until it leads back; 0 where none is few enough.

    Args:
        sample_map: (s,) for each search sample of the shape the number of the sample that it goes to.
        shape: the shape.
    """
    at = sample_map
    home = max(RETURN_DISTANCE, RETURN_FRACTION * mean_distance(at, shape))
    for order in range(1, MAX_ORDER + 1):
        if mean_distance(at, shape) < home:
            return order
        at = sample_map[at]
    return 0


def mean_distance(sample_map: Integers, shape: ShapeAnalysis) -> float:
    """How far a map (s,) of a shape's search samples takes them along the surface, on average, at unit area."""
    return float(shape.weights @ displacement(sample_map, shape))


def displacement(sample_map: Integers, shape: ShapeAnalysis) -> Floats:
    """(s,) how far a map (s,) of a shape's search samples takes each along the surface, at unit area.

    An image counts as the nearest of the samples that distances are known from.
    """
    images = shape.nearest_distance_sample[sample_map]
    return np.asarray(shape.distances_between[images, np.arange(len(sample_map))])


def return_error(surface_map: SurfaceMap, order: int, surface: Surface) -> float:
    """Mean distance in space between a vertex and where going round `order` times leads, over the root of the area."""
    places = returned = surface.vertices
    for _ in range(order):
        returned = surface_map.interpolate(returned)
    missed = np.linalg.norm(returned - places, axis=1)
    return float(missed[np.isfinite(missed)].mean() / np.sqrt(surface.area))
