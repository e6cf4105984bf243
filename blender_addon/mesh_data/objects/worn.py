# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that another object wears, as shapes in world space, and copies of them in other shapes."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import Collection as BlenderCollection
from bpy.types import Context, Depsgraph, Object

import zoomout_core as zo
from zoomout_core import outfits
from zoomout_core.arrays import Floats
from zoomout_core.messages import message

from ..arrays import hash_of, read_array
from ..attributes.vertex_groups import read_mask
from ..keys.shape_keys import read_rest_positions
from ..matrices import transform_points, world_matrix
from ..rigs.armatures import armatures_of, bind_like, hang_like, matrix_at_rest, reshape, set_parent, stands_as_modelled
from ..surfaces.base_mesh import read_base_positions, read_target_surface
from ..surfaces.inspection import content_hash
from ..surfaces.surfaces import VERTEX_PRESERVING, check_evaluated
from .strands import read_strands, write_strands

# Types of objects that can be worn.
TYPES = frozenset({"MESH", "CURVES"})
# Modifiers that are bound to the vertices of another mesh.
BOUND_TO_VERTICES = frozenset({"MESH_DEFORM", "SURFACE_DEFORM"})
# A custom property of copies: the name of the original object.
COPY_OF = "zoomout_dressed"
# Another one: the vertex group of the parts that keep their form.
KEPT = "zoomout_kept"


@dataclass(frozen=True, eq=False)
class Worn:
    """An object that is worn.

    Attributes:
        name: name of the object.
        shape: its shape in world space.
        stood: (4, 4) the world matrix of that shape.
        at_rest: whether the shape is undeformed.
        hangs_from_bone: whether its parent is a bone.
        is_hair: whether it is hair, by its name or those of its materials.
        takes_keys: whether it can have shape keys.
        content: hash of its own data, to detect edits.
        kept: name of the vertex group of parts that keep their form; empty if it has none.
        mask: (n,) the weights of that group; None if it has none.
    """

    name: str
    shape: zo.Surface | zo.Lines
    stood: Floats
    at_rest: bool
    hangs_from_bone: bool
    is_hair: bool
    takes_keys: bool
    content: str
    kept: str
    mask: Floats | None

    def place(self, moved: Floats) -> Floats:
        """(4, 4) the world matrix of a copy, given the motion (4, 4) of all worn objects, if not at rest."""
        return self.stood if self.at_rest else moved @ self.stood


def read_worn(obj: Object, depsgraph: Depsgraph, at_rest: bool, kept: str = "") -> Worn:
    """Read an object that is worn.

    Args:
        obj: an object of one of `TYPES`.
        depsgraph: Blender's.
        at_rest: whether to read it undeformed, at its place while bones are at rest; otherwise it is read as displayed,
            before modifiers that add or remove vertices.
        kept: name of the vertex group, if it has one of that name, of parts that keep their form.

    Raises:
        MeshError: the object has another type, has no points, or is not evaluated.
    """
    if obj.type not in TYPES:
        raise zo.MeshError("'{name}' is neither a mesh nor hair curves: convert it to one of them.", name=obj.name)
    stood = matrix_at_rest(obj) if at_rest else world_matrix(obj)
    has_kept = obj.type == "MESH" and kept in obj.vertex_groups
    read_shape = _curves if obj.type == "CURVES" else _mesh
    return Worn(
        name=obj.name,
        shape=read_shape(obj, depsgraph, at_rest, stood),
        stood=stood,
        at_rest=at_rest,
        hangs_from_bone=obj.parent is not None and obj.parent_type == "BONE",
        is_hair=outfits.parts.is_hair(obj.name, [slot.material.name for slot in obj.material_slots if slot.material]),
        takes_keys=obj.type == "MESH",
        content=content_of(obj),
        kept=kept if has_kept else "",
        mask=read_mask(obj, kept) if has_kept else None,
    )


def content_of(obj: Object) -> str:
    """A hash of an object's own data."""
    if obj.type == "MESH":
        return content_hash(obj.data)
    return hash_of("curves", read_array(obj.data.position_data, "vector", np.float32, 3))


def add_worn_copy(
    worn: Worn,
    obj: Object,
    positions: Floats,
    turns: Floats,
    wearer: Object,
    bodies: Collection[Object],
    collection: BlenderCollection,
    moved: Floats,
) -> tuple[Object, list[str]]:
    """Add a copy of an object in another shape, for another object to wear.

    At rest, the copy keeps the parent and deformation of the original. Otherwise, its parent is the wearer,
    and it has none of the modifiers that made its shape.

    Args:
        worn: the original as it was read.
        obj: the original object.
        positions: (n, 3) the copy's points, in world space.
        turns: (n, 3, 3) maps from old to new differences of positions.
        wearer: the object that wears the copy.
        bodies: objects that wear the original; the copy refers to the wearer instead.
        collection: the collection for the copy.
        moved: (4, 4) the motion of all worn objects, if not at rest.

    Returns:
        The copy, and notes.
    """
    copy = obj.copy()
    copy.data = obj.data.copy()
    copy.name = copy.data.name = f"{obj.name} on {wearer.name}"
    copy[COPY_OF] = obj.name
    copy[KEPT] = worn.kept
    collection.objects.link(copy)
    copy.select_set(False)
    notes = _refer_to(copy, wearer, bodies)
    place = worn.place(moved)
    if not worn.at_rest:
        seen, is_deformed = (
            worn.shape.vertices,
            bool(armatures_of(obj)) or any(each.type in VERTEX_PRESERVING for each in obj.modifiers),
        )
        _free(copy)
        if copy.type == "MESH" and copy.data.shape_keys and is_deformed and not stands_as_modelled(obj, seen):
            copy.shape_key_clear()
            notes.append(
                message(
                    "The shape keys of '{name}' were left out, because it is deformed: undo the deformation first.",
                    name=obj.name,
                )
            )
    _write_positions(copy, worn, positions, turns, place)
    if not worn.at_rest or copy.parent in bodies:
        set_parent(copy, wearer, place)
    return copy, notes


def worn_copies(wearer: Object) -> list[Object]:
    """The copies that are children of their wearer."""
    return list(filter(is_worn_copy, wearer.children))


def bind_worn_copy(context: Context, worn: Worn, positions: Floats, turns: Floats, wearer: Object) -> None:
    """Move a copy to rest, and bind it like its original, if that still exists.

    Args:
        context: Blender's.
        worn: the copy as it was read.
        positions: (n, 3) its points at rest, in world space.
        turns: (n, 3, 3) maps from old to new differences of positions.
        wearer: the object that wears it, already bound.
    """
    copy = context.scene.objects[worn.name]
    original = context.scene.objects.get(copy[COPY_OF])
    place = world_matrix(wearer) if original is None else matrix_at_rest(original)
    _write_positions(copy, worn, positions, turns, place)
    set_parent(copy, wearer, place)
    if original is None:
        return
    if original.type == "MESH" and armatures_of(original):
        bind_like(original, copy)
    elif original.parent_type == "BONE":
        hang_like(original, copy)


def is_worn_copy(obj: Object) -> bool:
    """Whether an object is a copy that another one wears."""
    return COPY_OF in obj


def dress_name(wearer: str) -> str:
    """The name of the collection of the copies that an object wears."""
    return f"{wearer} Dress"


def original_name(obj: Object, wearer: str) -> str:
    """The name of the object that was copied for a wearer to make this one; its own name if it is not such a copy."""
    is_copy = is_worn_copy(obj) and any(each.name == dress_name(wearer) for each in obj.users_collection)
    return str(obj[COPY_OF]) if is_copy else obj.name


def kept_group(copy: Object) -> str:
    """The vertex group of the parts of a copy that keep their form; empty if there are none."""
    return str(copy.get(KEPT, ""))


def groups_to_keep(objects: Iterable[Object]) -> list[str]:
    """Names of the vertex groups of objects, other than those of their bones."""
    found: dict[str, None] = {}
    for obj in objects:
        if obj.type == "MESH":
            bones = {bone.name for armature in armatures_of(obj) for bone in armature.data.bones}
            found |= dict.fromkeys(group.name for group in obj.vertex_groups if group.name not in bones)
    return list(found)


def worn_copies_in(collection: BlenderCollection, name: str) -> list[Object]:
    """Earlier copies of an object in a collection."""
    return [each for each in collection.objects if each.get(COPY_OF) == name]


def collection_beside(context: Context, obj: Object, name: str) -> BlenderCollection:
    """The collection of some name beside an object, created if missing."""
    parent = next(iter(obj.users_collection), context.scene.collection)
    found = parent.children.get(name)
    if found is None:
        found = bpy.data.collections.new(name)
        parent.children.link(found)
    return found


def _mesh(obj: Object, depsgraph: Depsgraph, at_rest: bool, stood: Floats) -> zo.Surface | zo.Lines:
    mesh = obj.data
    if not mesh.vertices:
        raise zo.MeshError("'{name}' has no vertices: leave it out.", name=obj.name)
    check_evaluated(obj, depsgraph)
    own = read_rest_positions(mesh) if at_rest else read_base_positions(obj, depsgraph)
    positions = transform_points(stood, own)
    if mesh.polygons:
        return read_target_surface(obj, depsgraph).with_vertices(positions)
    return zo.Lines(positions, read_array(mesh.edges, "vertices", np.int32, 2))


def _curves(obj: Object, depsgraph: Depsgraph, at_rest: bool, stood: Floats) -> zo.Lines:
    lines = read_strands(obj, None if at_rest else depsgraph)
    if not at_rest:
        return lines
    return zo.Lines(transform_points(stood @ np.linalg.inv(world_matrix(obj)), lines.vertices), lines.edges)


def _write_positions(copy: Object, worn: Worn, positions: Floats, turns: Floats, place: Floats) -> None:
    """Move the points of a copy to positions (n, 3) in world space, before it gets the matrix `place` (4, 4)."""
    if copy.type == "CURVES":
        write_strands(copy.data, transform_points(np.linalg.inv(place), positions))
    else:
        reshape(copy, worn.shape.vertices, positions, turns, place, worn.stood)


def _free(copy: Object) -> None:
    """Remove the animation, constraints and modifiers that determine a copy's shape and place."""
    copy.animation_data_clear()
    for constraint in list(copy.constraints):
        copy.constraints.remove(constraint)
    for modifier in [each for each in copy.modifiers if each.type in VERTEX_PRESERVING]:
        copy.modifiers.remove(modifier)


def _refer_to(copy: Object, wearer: Object, bodies: Collection[Object]) -> list[str]:
    """Redirect a copy's references from bodies to the wearer, as far as possible; returns notes."""
    notes = list[str]()
    for modifier in list(copy.modifiers):
        for prop in modifier.bl_rna.properties:
            if prop.type != "POINTER" or prop.is_readonly or getattr(modifier, prop.identifier) not in bodies:
                continue
            if modifier.type in BOUND_TO_VERTICES:
                name = modifier.name
                copy.modifiers.remove(modifier)
                notes.append(
                    message(
                        "'{name}' is no longer bound by '{modifier}', which was bound to another mesh: bind it again.",
                        name=copy.name,
                        modifier=name,
                    )
                )
                break
            setattr(modifier, prop.identifier, wearer)
    return notes
