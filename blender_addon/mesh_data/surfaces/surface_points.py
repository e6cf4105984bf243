# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on the evaluated surface of an object, stored so that they persist through posing, editing and saving.

A surface point belongs to a face of the evaluated mesh and moves with it. If an edit changed the number of vertices or
faces, so that the face is unknown, the nearest point of the surface replaces it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bpy.types import Depsgraph, Mesh, Object
from mathutils import Vector
from mathutils.geometry import tessellate_polygon

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.pair import MAX_LANDMARK_DISTANCE

from .surfaces import evaluated_mesh


@dataclass(frozen=True)
class SurfacePoint:
    """A point in a face of the evaluated mesh of an object.

    Attributes:
        face: the face that contains it.
        vertices: three vertices of the face.
        weights: barycentric coordinates in their triangle.
        position: (3,) its position when it was set, in the object's own space.
        counts: the number of vertices and faces that the mesh had then.
    """

    face: int
    vertices: tuple[int, int, int]
    weights: tuple[float, float, float]
    position: tuple[float, float, float]
    counts: tuple[int, int]

    def on(self, mesh: Mesh) -> Vector | None:
        """Its position on the evaluated mesh, in the object's own space; None if its face no longer exists."""
        if self.counts != _counts(mesh) or not set(self.vertices) <= set(mesh.polygons[self.face].vertices):
            return None
        return sum((w * mesh.vertices[v].co for w, v in zip(self.weights, self.vertices, strict=True)), Vector())


def surface_point_in_face(mesh: Mesh, face: int, point: Vector) -> SurfacePoint:
    """The surface point in a face that is closest to a point in the object's own space."""
    vertices = np.array(mesh.polygons[face].vertices)
    corners = np.array([mesh.vertices[vertex].co for vertex in vertices.tolist()])
    triangles = np.array(tessellate_polygon([[Vector(corner) for corner in corners]]))
    triangle, weights = closest_points(np.array([point]), corners, triangles)
    of_face = triangles[triangle[0]]
    return SurfacePoint(
        face,
        tuple(vertices[of_face].tolist()),
        tuple(weights[0].tolist()),
        tuple((weights[0] @ corners[of_face]).tolist()),
        _counts(mesh),
    )


def raycast_surface_point(
    obj: Object, origin: Vector, direction: Vector, depsgraph: Depsgraph
) -> tuple[SurfacePoint, float] | None:
    """The first hit of a ray in world space on an evaluated object, and its distance; None if it misses."""
    inverse = obj.matrix_world.inverted_safe()
    start = inverse @ origin
    hit, point, _, face = obj.ray_cast(start, inverse.to_3x3() @ direction, depsgraph=depsgraph)
    if not hit:
        return None
    with evaluated_mesh(obj, depsgraph) as (_, mesh):
        place = surface_point_in_face(mesh, face, point)
    return place, (obj.matrix_world @ point - origin).dot(direction)


def nearest_surface_point(obj: Object, point: Vector, distance: float, depsgraph: Depsgraph) -> SurfacePoint | None:
    """The surface point closest to a point in an object's own space, if it is within a distance there."""
    found, _, _, face = obj.closest_point_on_mesh(point, distance=distance, depsgraph=depsgraph)
    if not found:
        return None
    with evaluated_mesh(obj, depsgraph) as (_, mesh):
        return surface_point_in_face(mesh, face, point)


def surface_point_of_vertex(obj: Object, vertex: int, depsgraph: Depsgraph) -> SurfacePoint:
    """The point of the evaluated surface at a vertex of the object's own mesh.

    Raises:
        MeshError: the modifiers leave no surface there, or the object is disabled.
    """
    with evaluated_mesh(obj, depsgraph) as (_, mesh):
        same_vertices = len(mesh.vertices) == len(obj.data.vertices)
        point = (mesh if same_vertices else obj.data).vertices[vertex].co.copy()
        most = MAX_LANDMARK_DISTANCE * extent(mesh)
    place = nearest_surface_point(obj, point, most, depsgraph)
    if place is None:
        raise zo.MeshError(
            "Modifiers move the surface of '{name}' away from vertex {vertex}: click on it in Object Mode instead.",
            name=obj.name,
            vertex=vertex,
        )
    return place


def extent(mesh: Mesh) -> float:
    """The square root of a mesh's area, in its own space."""
    areas = np.empty(len(mesh.polygons), np.float32)
    mesh.polygons.foreach_get("area", areas)
    return float(np.sqrt(areas.sum(dtype=np.float64)))


def _counts(mesh: Mesh) -> tuple[int, int]:
    return len(mesh.vertices), len(mesh.polygons)
