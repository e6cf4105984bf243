# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's objects as surfaces of the core, in world space."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from bpy.types import Depsgraph, Mesh, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import single_precision_step
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.messages import Message, message

from ..arrays import read_array
from ..matrices import transform_points, world_matrix

# Modifiers that move vertices or change data, but neither add nor remove vertices.
VERTEX_PRESERVING = frozenset(
    {
        "ARMATURE", "CAST", "CLOTH", "COLLISION", "CORRECTIVE_SMOOTH", "CURVE", "DATA_TRANSFER", "DISPLACE",
        "HOOK", "LAPLACIANDEFORM", "LAPLACIANSMOOTH", "LATTICE", "MESH_CACHE", "MESH_DEFORM",
        "MESH_SEQUENCE_CACHE", "NORMAL_EDIT", "SHRINKWRAP", "SIMPLE_DEFORM", "SMOOTH", "SOFT_BODY", "SURFACE",
        "SURFACE_DEFORM", "UV_PROJECT", "UV_WARP", "VERTEX_WEIGHT_EDIT", "VERTEX_WEIGHT_MIX",
        "VERTEX_WEIGHT_PROXIMITY", "WARP", "WAVE", "WEIGHTED_NORMAL",
    }
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Faces:
    """How the faces of a mesh connect its vertices.

    Attributes:
        vertices: number of vertices.
        start: (f,) the first corner of each face.
        corner_vertex: (c,) the vertex of each corner.
    """

    vertices: int
    start: Integers
    corner_vertex: Integers

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Faces)
            and self.vertices == other.vertices
            and np.array_equal(self.start, other.start)
            and np.array_equal(self.corner_vertex, other.corner_vertex)
        )

    __hash__ = None  # type: ignore[assignment]


@contextmanager
def evaluated_mesh(obj: Object, depsgraph: Depsgraph) -> Iterator[tuple[Object, Mesh]]:
    """The evaluated object and its mesh, with all data layers.

    Raises:
        MeshError: the object is disabled, so that Blender does not evaluate it.
    """
    evaluated = check_evaluated(obj, depsgraph)
    try:
        yield evaluated, evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    finally:
        evaluated.to_mesh_clear()


def is_disabled(obj: Object) -> bool:
    """Whether an object or all its collections are disabled in the viewport.

    Blender may keep an earlier evaluation of such an object if something refers to it, such as the chosen source.
    """
    collections = obj.users_collection
    return bool(obj.hide_viewport or (collections and all(each.hide_viewport for each in collections)))


def check_evaluated(obj: Object, depsgraph: Depsgraph) -> Object:
    """The evaluated object.

    Raises:
        MeshError: the object is disabled, so that Blender does not evaluate it.
    """
    evaluated = obj.evaluated_get(depsgraph)
    if not evaluated.is_evaluated or is_disabled(obj):
        raise zo.MeshError(
            "'{name}' or its collection is disabled in the viewport: enable it, because its "
            "modifiers are not evaluated.",
            name=obj.name,
        )
    return evaluated


def read_source_surface(obj: Object, depsgraph: Depsgraph) -> zo.Surface:
    """The evaluated surface of an object, in world space.

    If modifiers keep the faces, these are triangulated like those of the object's own mesh: Blender triangulates a
    quad differently when a pose folds it, which would invalidate a match.

    Raises:
        MeshError: there is no surface, or the object is not evaluated.
    """
    with evaluated_mesh(obj, depsgraph) as (evaluated, mesh):
        own = obj.data if read_faces(mesh) == read_faces(obj.data) else mesh
        return world_surface(evaluated, own, read_positions(mesh), mesh)


def read_source_faces(obj: Object, depsgraph: Depsgraph) -> Faces:
    """The faces of the surface from `read_source_surface`, in a fraction of its time.

    Raises:
        MeshError: the object is not evaluated.
    """
    with evaluated_mesh(obj, depsgraph) as (_, mesh):
        return read_faces(mesh)


def read_surface_at_rest(obj: Object, evaluated: Mesh | None = None, positions: np.ndarray | None = None) -> zo.Surface:
    """The surface of an object's own mesh, in the mesh's own space.

    Args:
        obj: the object.
        evaluated: the evaluated mesh; it is used instead if modifiers change the faces.
        positions: (n, 3) positions of the vertices, if other than the mesh's.

    Raises:
        MeshError: there is no surface.
    """
    mesh = obj.data if evaluated is None or read_faces(evaluated) == read_faces(obj.data) else evaluated
    points = read_positions(mesh) if positions is None else positions
    return _surface(obj, mesh, points, mesh if evaluated is None else evaluated)


def read_positions(mesh: Mesh) -> np.ndarray:
    """(n, 3) positions of the vertices, in the mesh's own space."""
    return read_array(mesh.vertices, "co", np.float32, 3)


def read_faces(mesh: Mesh) -> Faces:
    """The faces of a mesh, which are equal for meshes of the same topology."""
    return Faces(
        len(mesh.vertices),
        read_array(mesh.polygons, "loop_start", np.int32),
        _read_corner_vertices(mesh),
    )


def positions_in_world(obj: Object, positions: Floats) -> Floats:
    """Transform positions (..., 3) from the object's space to world space."""
    return transform_points(world_matrix(obj), positions)


def directions_in_world(obj: Object, directions: Floats) -> Floats:
    """Transform differences of positions (..., 3) from the object's space to world space."""
    return directions @ world_matrix(obj)[:3, :3].T


def positions_in_object(obj: Object, positions: Floats) -> Floats:
    """Transform positions (..., 3) from world space to the object's space; the nearest ones for a flat object."""
    return to_object(obj, positions - origin(obj))


def to_object(obj: Object, directions: Floats) -> Floats:
    """Transform differences of positions (..., 3) from world to the object's space; the nearest for a flat object."""
    return directions @ np.linalg.pinv(world_matrix(obj)[:3, :3]).T


def origin(obj: Object) -> Floats:
    """(3,) the origin of an object, in world space."""
    return world_matrix(obj)[:3, 3]


def area_in_world(obj: Object) -> float:
    """The area of an object's own mesh, in world space."""
    mesh = obj.data
    mesh.calc_loop_triangles()
    triangles = read_array(mesh.loop_triangles, "vertices", np.int32, 3)
    return float(triangle_areas(positions_in_world(obj, read_positions(mesh)), triangles).sum())


def is_flat(obj: Object) -> bool:
    """Whether an object's matrix is singular, such as with a scale of zero."""
    return bool(np.linalg.matrix_rank(np.array(obj.matrix_world)[:3, :3]) < 3)


def world_surface(obj: Object, mesh: Mesh, positions: np.ndarray, with_edges: Mesh) -> zo.Surface:
    """A mesh in world space, with Blender's numbers of corners and triangles, and the edges of `with_edges`.

    A mirroring object matrix would turn the surface inside out, so the winding of triangles is then reversed.
    """
    surface = _surface(obj, mesh, positions_in_world(obj, positions), with_edges, is_mirrored(obj))
    with _naming(obj):
        surface.rounding = single_precision_step(positions) * float(np.linalg.norm(world_matrix(obj)[:3, :3], 2))
    return surface


def _surface(obj: Object, mesh: Mesh, points: np.ndarray, with_edges: Mesh, mirrored: bool = False) -> zo.Surface:
    mesh.calc_loop_triangles()
    triangle_corners = read_array(mesh.loop_triangles, "loops", np.int32, 3)
    if mirrored:
        triangle_corners = triangle_corners[:, ::-1]
    face_start = np.append(read_array(mesh.polygons, "loop_start", np.int32), len(mesh.loops))
    with _naming(obj):
        if not mesh.polygons and obj.original.data.polygons:
            raise zo.MeshError(
                "Its modifiers leave no faces: turn them off, or add Realize Instances if they make instances."
            )
        return zo.Surface.from_corners(
            points,
            _read_corner_vertices(mesh),
            face_start,
            triangle_corners,
            _read_edges(with_edges),
        )


@contextmanager
def _naming(obj: Object) -> Iterator[None]:
    """Name an object in the error that it cannot be used."""
    try:
        yield
    except zo.MeshError as error:
        reason = _find_broken_input(obj) or error
        raise zo.MeshError("'{name}' cannot be used. {reason}", name=obj.name, reason=reason) from error


def _find_broken_input(obj: Object) -> Message | None:
    """The reason why an object cannot be used, if it is its matrix or a shape key instead of the mesh."""
    if not np.isfinite(np.array(obj.matrix_world)).all():
        return message("Its location, rotation or scale is not finite: clear its transforms.")
    if is_flat(obj):
        return message("It or a parent has a scale of zero: change that scale.")
    keys = obj.original.data.shape_keys
    for key in [] if keys is None else keys.key_blocks[1:]:
        if not (np.isfinite(key.value) and np.isfinite(read_array(key.data, "co", np.float32, 3)).all()):
            return message("Its shape key '{key}' is not finite: remove it, or repair it.", key=key.name)
    return None


def _read_corner_vertices(mesh: Mesh) -> Integers:
    """(c,) the vertex of each corner, read from Blender's attribute at once.

    Through `loops`, Blender would call a function for each corner, which is many times slower.
    """
    if not mesh.loops:  # then there may be no attribute
        return np.empty(0, np.int32)
    return read_array(mesh.attributes[".corner_vert"].data, "value", np.int32)


def _read_edges(mesh: Mesh) -> Integers:
    """(e, 2) the vertices of each edge, read like those of corners."""
    if not mesh.edges:
        return np.empty((0, 2), np.int32)
    return read_array(mesh.attributes[".edge_verts"].data, "value", np.int32, 2)


def is_mirrored(obj: Object) -> bool:
    """Whether an object's matrix turns its mesh into its mirror image."""
    return obj.matrix_world.is_negative


def without_faces(obj: Object) -> str:
    """The reason why an object without faces in its own mesh cannot receive data, and the remedy."""
    making = [m.name for m in obj.modifiers if m.show_viewport and m.type not in VERTEX_PRESERVING]
    if not making:
        return message("'{name}' has no faces: choose a mesh with a surface.", name=obj.name)
    names = ", ".join(f"'{name}'" for name in making)
    return message(
        "The mesh of '{name}' has no faces before its modifiers: apply {modifiers}, because data "
        "is written to the mesh itself.",
        name=obj.name,
        modifiers=names,
    )
