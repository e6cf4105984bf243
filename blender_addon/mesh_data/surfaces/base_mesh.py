# SPDX-License-Identifier: GPL-3.0-or-later
"""The base of an object: its own mesh as shape keys and modifiers move it, before modifiers change its vertices.

Data is written to the mesh itself, so a target is matched by its base; the result of later modifiers is only displayed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from bpy.types import Depsgraph, Mesh, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.transfer import Attribute, Domain, Kind

from ..attributes.layers import Layer, Role, read_layer, write_layer
from .surfaces import (
    VERTEX_PRESERVING,
    Faces,
    check_evaluated,
    evaluated_mesh,
    read_faces,
    read_positions,
    without_faces,
    world_surface,
)

# Name of an attribute on a temporary mesh.
PASSED = "zoomout_passed"
# Modifiers that pose any mesh: after one that adds vertices, they still move the base in the same way.
POSING = frozenset({"ARMATURE", "LATTICE"})


@contextmanager
def temporary_copy(obj: Object, depsgraph: Depsgraph) -> Iterator[Object]:
    """A copy of an object that shares its mesh, in the scene until the block ends."""
    copy = obj.copy()
    try:
        depsgraph.scene.collection.objects.link(copy)
        yield copy
    finally:
        bpy.data.objects.remove(copy)


def read_base_positions(obj: Object, depsgraph: Depsgraph) -> np.ndarray:
    """(n, 3) positions of the vertices of an object's own mesh, in its own space.

    Modifiers apply up to the first that changes the vertices; after that, only those in `POSING`.

    Raises:
        MeshError: the object is not evaluated.
    """
    with base_mesh(obj, depsgraph) as (_, mesh):
        return read_positions(mesh)


@contextmanager
def base_mesh(obj: Object, depsgraph: Depsgraph) -> Iterator[tuple[Object, Mesh]]:
    """An evaluated object, and its mesh after modifiers that keep its vertices, see `read_base_positions`.

    Raises:
        MeshError: the object is not evaluated.
    """
    with evaluated_mesh(obj, depsgraph) as seen:
        if read_faces(seen[1]) == read_faces(obj.data):
            yield seen
            return
    with temporary_copy(obj, depsgraph) as copy:
        remove_generating(copy)
        depsgraph.view_layer.update()
        with evaluated_mesh(copy, depsgraph) as seen:
            yield seen


def keeps_vertices(obj: Object) -> bool:
    """Whether no visible modifier changes an object's vertices, so that its base is read without a copy of it."""
    return all(each.type in VERTEX_PRESERVING for each in obj.modifiers if each.show_viewport)


def is_cage(obj: Object) -> bool:
    """Whether Catmull-Clark subdivision is the last visible modifier, and the only one that adds vertices."""
    adding = [each for each in obj.modifiers if each.show_viewport and each.type not in VERTEX_PRESERVING]
    if [each.type for each in adding] != ["SUBSURF"]:
        return False
    (subdivision,) = adding
    shown = [each for each in obj.modifiers if each.show_viewport]
    return shown[-1] == subdivision and subdivision.subdivision_type == "CATMULL_CLARK" and bool(subdivision.levels)


def read_target_surface(obj: Object, depsgraph: Depsgraph) -> zo.Surface:
    """The surface of an object's own mesh at `read_base_positions`, in world space.

    Raises:
        MeshError: the mesh itself has no surface, or the object is not evaluated.
    """
    if not obj.data.polygons:
        raise zo.MeshError(without_faces(obj))
    positions = read_base_positions(obj, depsgraph)
    return world_surface(obj.evaluated_get(depsgraph), obj.data, positions, obj.data)


def read_target_faces(obj: Object, depsgraph: Depsgraph) -> Faces:
    """The faces of the surface from `read_target_surface`, in a fraction of its time.

    Raises:
        MeshError: the object is not evaluated.
    """
    check_evaluated(obj, depsgraph)
    return read_faces(obj.data)


def read_mirrored_surface(obj: Object, depsgraph: Depsgraph) -> zo.Surface | None:
    """The surface from `read_target_surface`, with the other half that a Mirror modifier adds.

    Returns:
        The whole surface, in world space. It begins with the vertices of the mesh itself, except that the modifier may
        merge some into the plane. None if there is no Mirror modifier, if others that change vertices come first, or
        if it bisects the mesh.
    """
    generating = [one for one in obj.modifiers if one.show_viewport and one.type not in VERTEX_PRESERVING]
    if not generating or generating[0].type != "MIRROR" or any(generating[0].use_bisect_axis):
        return None
    own = read_base_positions(obj, depsgraph)
    with temporary_copy(obj, depsgraph) as copy:
        remove_generating(copy, keep=generating[0].name)
        depsgraph.view_layer.update()
        with evaluated_mesh(copy, depsgraph) as (evaluated, mesh):
            whole = read_positions(mesh)
            off = np.abs(whole[: len(own)] - own).max() if len(whole) > len(own) else np.inf
            surface = world_surface(evaluated, mesh, whole, mesh)
    return surface if off <= generating[0].merge_threshold else None


def values_through_modifiers(obj: Object, depsgraph: Depsgraph, values: Floats) -> Floats | None:
    """Pass values of an object's own vertices (n, 3) or corners (c, 2) through all its modifiers.

    Returns:
        Values of the elements of the evaluated mesh; None if modifiers lose them, as *Remesh* does.
    """
    domain = Domain.POINT if values.shape[1] == 3 else Domain.CORNER
    vectors = np.zeros((len(values), 3), np.float32)
    vectors[:, : values.shape[1]] = values
    with temporary_copy(obj, depsgraph) as copy:
        copy.data = mesh = obj.data.copy()
        write_layer(mesh, Layer(Attribute(PASSED, domain, Kind.VECTOR, vectors), Role.GENERIC, "FLOAT_VECTOR"))
        depsgraph.view_layer.update()
        with evaluated_mesh(copy, depsgraph) as (_, made):
            kept = made.attributes.get(PASSED)
            lost = kept is None or kept.domain != domain.name
            found = None if lost else read_layer(made, PASSED).attribute.values[:, : values.shape[1]]
    bpy.data.meshes.remove(mesh)
    return found


def remove_generating(obj: Object, keep: str = "") -> None:
    """Remove the first modifier of an object that may change its vertices and all after it, except those in `POSING`.

    The modifier named `keep` stays.
    """
    changed = False
    for modifier in list(obj.modifiers):
        changed = changed or (modifier.show_viewport and modifier.type not in VERTEX_PRESERVING)
        if changed and modifier.type not in POSING and modifier.name != keep:
            obj.modifiers.remove(modifier)
