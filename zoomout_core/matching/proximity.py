# SPDX-License-Identifier: GPL-3.0-or-later
"""A map by proximity alone, for clothes on a body: the nearest points, if they are near and face the same way.

Abdrashitov et al., Robust Skin Weights Transfer via Weight Inpainting (2023), section 3.1. Places have no partner if
they are too far away, or near a surface that faces another way, such as the other leg. The transfer fills them in.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np

from zoomout_core.arrays import Booleans, Floats, segment_sum
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.options import MAX_ANGLE, MAX_DISTANCE
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import measurable
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import ShapeLike, as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import border_edges, unit_vectors, vertex_areas
from zoomout_core.messages import message
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.runtime.progress import stage

# Notes on vertices without a partner.
TOO_FAR = "{count:,} of {total:,} vertices have no partner on the source: the nearest point is too far away."
TURNED_AWAY = "{count:,} of {total:,} vertices have no partner on the source: the nearest point faces another way."


@dataclass(frozen=True, eq=False)
class ProximityMatch:
    """A map from the target to the nearest points of the source.

    Attributes:
        surface_map: for every target vertex a point on the source surface.
        confidence: (n_t,) 1 where that is near and faces the same way, else 0.
        notes: sentences for the user.

    Example:
        >>> zo.match_by_proximity(source, source).confidence.shape == (len(source.vertices),)
        True
    """

    surface_map: SurfaceMap
    confidence: Floats
    notes: tuple[str, ...]

    @property
    def has_partner(self) -> Booleans:
        """(n_t,) whether the nearest point is reliable."""
        return self.confidence > 0


@suggest_names
@memory_in_words
def match_by_proximity(
    source: ShapeLike,
    target: ShapeLike,
    max_distance: float = MAX_DISTANCE,
    max_angle: float = MAX_ANGLE,
    either_side: bool = False,
) -> ProximityMatch:
    """Find for every vertex of the target the nearest point on the source, for surfaces that overlap in space.

    The map is not refined. A transfer fills in places where the nearest point is not reliable.

    Args:
        source: the surface that the map lands on, such as a body.
        target: the surface that the map starts from, such as clothes on it, in the same pose.
        max_distance: maximum distance of the nearest point, relative to the square root of the source's area.
        max_angle: maximum angle between the normals at the two points, in degrees. The outer side of an open part of
            the target is determined by its nearest points.
        either_side: whether opposite normals are accepted as well, for clothes with an inner side of their own.

    Raises:
        ValueError: a distance that is not positive, or an angle that is not from 0 to 180.
        MeshError: no part of the target is near the source.

    Example:
        >>> clothes = source.with_vertices(1.01 * source.vertices)
        >>> bool(zo.match_by_proximity(source, clothes).confidence.min() > 0)
        True
    """
    if not isinstance(max_distance, Real) or not 0 < max_distance < np.inf:
        raise ValueError(f"max_distance is {max_distance!r}: give a part of the square root of the source's area.")
    if not isinstance(max_angle, Real) or not 0 <= max_angle <= 180:
        raise ValueError(f"max_angle is {max_angle!r}: give degrees from 0 to 180.")
    min_cosine = np.cos(np.radians(max_angle))
    with stage("Finding the nearest points"):
        return _match(as_surface(source), as_surface(target), max_distance, min_cosine, either_side)


def _match(
    source: Surface, target: Surface, max_distance: float, min_cosine: float, either_side: bool
) -> ProximityMatch:
    placed = measurable(target.vertices)
    places = np.where(placed[:, None], target.vertices, source.vertices[source.triangles[0, 0]])
    surface_map = SurfaceMap(*closest_points(places, source.vertices, source.triangles), source.triangles)
    distance = np.linalg.norm(surface_map.interpolate(source.vertices) - places, axis=1)
    near = placed & (distance <= max_distance * np.sqrt(source.area))
    if not near.any():
        raise MeshError(
            "No part of the target is near the source: align the two in the same pose, or allow a larger distance."
        )
    cosine = _cosines(surface_map, source, target, near)
    facing = (np.abs(cosine) if either_side else cosine) >= min_cosine
    counts = (int((~near).sum()), TOO_FAR), (int((near & ~facing).sum()), TURNED_AWAY)
    notes = tuple(message(text, count=count, total=len(near)) for count, text in counts if count)
    return ProximityMatch(surface_map, (near & facing).astype(float), notes)


def _cosines(surface_map: SurfaceMap, source: Surface, target: Surface, near: Booleans) -> Floats:
    """(n_t,) of the angle between each vertex's normal and that of the source at its image; 0 without a normal."""
    there = unit_vectors(surface_map.interpolate(_normals(source)))
    cosine = np.einsum("nx,nx->n", there, _normals(target))
    working = target.working
    component = working.component[working.vertex_of]  # undefined for vertices without a face
    areas = vertex_areas(working.vertices, working.triangles)[working.vertex_of]
    agreement = segment_sum(cosine * areas * near, component)
    border = border_edges(working.triangles)
    is_open = np.zeros(len(agreement), dtype=bool)
    is_open[working.component[border[:, 0]]] = True
    return np.asarray(cosine * np.where(is_open & (agreement < 0), -1, 1)[component])


def _normals(surface: Surface) -> Floats:
    """(n, 3) outward unit normals of a surface's vertices; zero for vertices without a face."""
    working = surface.working
    return np.where((working.vertex_of >= 0)[:, None], working.vertex_normals[working.vertex_of], 0)
