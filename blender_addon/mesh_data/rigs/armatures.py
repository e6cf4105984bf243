# SPDX-License-Identifier: GPL-3.0-or-later
"""Armatures: the bones that move an object, their hierarchy, and binding another object to the same ones.

The armatures themselves are never changed: they may belong to another file.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import ArmatureModifier, Object, bpy_prop_array
from mathutils import Euler, Matrix, Quaternion, Vector

from zoomout_core.arrays import Floats, Integers

from ..keys.shape_keys import read_key_positions, read_rest_positions
from ..matrices import transform_points, world_matrix
from ..surfaces.surfaces import is_mirrored, positions_in_world

# The properties that determine an object's matrix, besides those of its parent.
OF_PLACE = ("location", "rotation_mode", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
DELTAS = {
    "delta_location": (0, 0, 0),
    "delta_rotation_euler": (0, 0, 0),
    "delta_rotation_quaternion": (1, 0, 0, 0),
    "delta_scale": (1, 1, 1),
}
OF_PARENT = ("parent", "parent_type", "parent_bone", "matrix_parent_inverse")
# Matrices whose entries differ by less, over the largest entry, are equal in single precision.
ROUNDING = 1e-4


@dataclass(frozen=True, eq=False)
class Bones:
    """The deforming bones of all armatures of an object.

    Attributes:
        names: names of the bones and of their vertex groups.
        parents: (b,) the number of each bone's nearest deforming ancestor, -1 for none.
        heads: (b, 3) the place about which each bone turns, at rest, in world space.
    """

    names: tuple[str, ...]
    parents: Integers
    heads: Floats

    def without(self, names: Collection[str]) -> Bones:
        """The bones except those of some names, whose children lose their parent."""
        kept = [number for number, name in enumerate(self.names) if name not in names]
        number = np.full(len(self.names) + 1, -1)
        number[kept] = np.arange(len(kept))
        return Bones(tuple(self.names[each] for each in kept), number[self.parents[kept]], self.heads[kept])


def armatures_of(obj: Object) -> list[Object]:
    """The armatures that deform an object: those of its modifiers in order, else its parent."""
    found = [modifier.object for modifier in armature_modifiers(obj)]
    return list(dict.fromkeys(found)) or ([obj.parent] if _is_deformed_by_parent(obj) else [])


def armature_modifiers(obj: Object) -> list[ArmatureModifier]:
    """The modifiers by which armatures deform an object."""
    return [modifier for modifier in obj.modifiers if modifier.type == "ARMATURE" and modifier.object]


def read_bones(obj: Object) -> Bones:
    """The deforming bones of an object's armatures, the first of each name."""
    above: dict[str, str | None] = {}
    heads: dict[str, Vector] = {}
    for armature in armatures_of(obj):
        for bone in armature.data.bones:
            if bone.use_deform:
                heads.setdefault(bone.name, armature.matrix_world @ bone.head_local)
                parents = (parent.name for parent in bone.parent_recursive if parent.use_deform)
                above.setdefault(bone.name, next(parents, None))
    number = {name: i for i, name in enumerate(above)}
    ancestors = np.array([-1 if parent is None else number[parent] for parent in above.values()], int)
    return Bones(tuple(above), ancestors, np.array([heads[name] for name in above], dtype=np.float64).reshape(-1, 3))


def preserves_volume(obj: Object) -> bool:
    """Whether the armatures of an object preserve its volume."""
    modifiers = armature_modifiers(obj)
    return bool(modifiers) and modifiers[0].use_deform_preserve_volume


def bind_like(source: Object, target: Object) -> None:
    """Give an object the armature modifiers of another one, and parent it to their armature at the same place."""
    given = armature_modifiers(source)
    place = _place_of_modifiers(source, target)
    for number, one in enumerate(given):
        copy_modifier(one, target, place + number)
    if not given:
        target.modifiers.new("Armature", "ARMATURE").object = source.parent
        target.modifiers.move(len(target.modifiers) - 1, place)
    set_parent(target, _parent_for(source), place_beside(source, target))


def copy_modifier(modifier: ArmatureModifier, obj: Object, place: int) -> None:
    """Copy an armature modifier to an object, at a place in its list."""
    made = obj.modifiers.new(modifier.name, "ARMATURE")
    for option in modifier.bl_rna.properties:
        if not option.is_readonly and option.identifier != "name":
            setattr(made, option.identifier, getattr(modifier, option.identifier))
    obj.modifiers.move(len(obj.modifiers) - 1, place)


def hang_like(source: Object, target: Object) -> None:
    """Copy the parent and the transform of another object."""
    for name in (*OF_PARENT, *OF_PLACE, *DELTAS):
        setattr(target, name, copy_value(getattr(source, name)))


def place_beside(source: Object, target: Object) -> Floats:
    """The matrix (4, 4) for binding an object like another one: the same, mirrored if only one of the two is."""
    flipped = is_mirrored(source) != is_mirrored(target)
    return world_matrix(source) @ np.diag([-1.0 if flipped else 1.0, 1, 1, 1])


def can_be_put(source: Object, target: Object) -> bool:
    """Whether binding an object like another one would give it that place; constraints, for instance, prevent it."""
    wanted, before = place_beside(source, target), Place(target)
    try:
        set_parent(target, _parent_for(source), wanted)
        bpy.context.view_layer.update()
        found = world_matrix(target)
    finally:
        before.restore()
        bpy.context.view_layer.update()
    return bool((np.abs(found - wanted) <= ROUNDING * np.abs(wanted).max()).all())


def unbind(obj: Object) -> None:
    """Unbind an object from its armatures; it keeps its place."""
    for modifier in armature_modifiers(obj):
        obj.modifiers.remove(modifier)
    if _is_deformed_by_parent(obj):
        to_object_space = obj.matrix_world.copy()
        obj.parent = None
        obj.matrix_world = to_object_space


def matrix_at_rest(obj: Object) -> Floats:
    """The world matrix (4, 4) that an object would have if its parent bone were at rest."""
    armature = obj.parent
    if armature is None or obj.parent_type != "BONE" or obj.parent_bone not in armature.pose.bones:
        return world_matrix(obj)
    bone, world = armature.pose.bones[obj.parent_bone], world_matrix(armature)
    posed = world @ np.array(bone.matrix)
    return world @ np.array(bone.bone.matrix_local) @ np.linalg.inv(posed) @ world_matrix(obj)


def reshape(
    obj: Object, seen: Floats, at_rest: Floats, linear: Floats, place: Floats, stood: Floats | None = None
) -> None:
    """Move the vertices of an object, and of its shape keys, before it gets another matrix.

    Without shape keys, the object gets its visible shape, which an armature may have posed.

    Args:
        obj: the object, before it is moved.
        seen: (n, 3) visible positions of its vertices, in world space.
        at_rest: (n, 3) their new positions, in world space.
        linear: (n, 3, 3) maps from old to new differences of positions around each vertex.
        place: (4, 4) the matrix that the object will have.
        stood: (4, 4) the matrix that its visible positions depend on; the object's own when not given.
    """
    mesh, to_world = obj.data, world_matrix(obj) if stood is None else stood
    to_object = np.linalg.inv(place)

    def to_object_space(offsets: Floats) -> Floats:
        world = at_rest + np.einsum("nxy,ny->nx", linear, offsets)
        return np.ascontiguousarray(transform_points(to_object, world), np.float32)

    blocks = mesh.shape_keys.key_blocks if mesh.shape_keys else ()
    keys = [transform_points(to_world, read_key_positions(mesh, block.name)) for block in blocks]
    shapes = [to_object_space(key - seen) for key in keys]
    mesh.vertices.foreach_set("co", (shapes[0] if shapes else to_object_space(np.zeros_like(seen))).ravel())
    for block, shape in zip(blocks, shapes, strict=True):
        block.points.foreach_set("co", shape.ravel())
    mesh.update()


def stands_as_modelled(obj: Object, seen: Floats) -> bool:
    """Whether visible vertices (n, 3), in world space, have the positions of the object's own mesh."""
    off = np.abs(positions_in_world(obj, read_rest_positions(obj.data)) - seen).max(initial=0)
    return bool(off <= ROUNDING * np.ptp(seen, axis=0).max(initial=0))


def _is_deformed_by_parent(obj: Object) -> bool:
    return obj.parent is not None and obj.parent.type == "ARMATURE" and obj.parent_type == "ARMATURE"


def _parent_for(source: Object) -> Object:
    """The parent of an object that is bound like another one: one of its armatures."""
    armatures = armatures_of(source)
    return source.parent if source.parent in armatures else armatures[0]


def _place_of_modifiers(source: Object, target: Object) -> int:
    """The index for the source's armature modifiers: after modifiers of types that precede them on the source.

    If the source has no Mirror, they come after the target's: before it, the mirrored half would repeat the pose of the
    other half.
    """
    types = [modifier.type for modifier in source.modifiers]
    before = set(types[: types.index("ARMATURE")] if armature_modifiers(source) else ())
    if "MIRROR" not in types:
        before.add("MIRROR")
    behind = [number for number, modifier in enumerate(target.modifiers) if modifier.type in before]
    return max(behind, default=-1) + 1


def set_parent(obj: Object, parent: Object, place: Floats) -> None:
    """Parent an object, at a world matrix (4, 4) that may be sheared; its children keep their places."""
    children = [(child, world_matrix(child)) for child in obj.children]
    obj.parent, obj.parent_type = parent, "OBJECT"
    for name, value in DELTAS.items():
        setattr(obj, name, value)
    obj.matrix_basis = Matrix()
    obj.matrix_parent_inverse = Matrix((np.linalg.inv(world_matrix(parent)) @ place).tolist())
    for child, standing in children:
        if child.parent_type == "OBJECT":
            inverse = np.linalg.inv(place) @ standing @ np.linalg.inv(np.array(child.matrix_basis, np.float64))
            child.matrix_parent_inverse = Matrix(inverse.tolist())


class Place:
    """The transform properties of an object and of its children, to restore them."""

    def __init__(self, obj: Object) -> None:
        self._obj = obj
        self._own = {name: copy_value(getattr(obj, name)) for name in (*OF_PARENT, *OF_PLACE, *DELTAS)}
        self._children = [(child, child.matrix_parent_inverse.copy()) for child in obj.children]

    def restore(self) -> None:
        """Restore the properties."""
        for name, value in self._own.items():
            setattr(self._obj, name, value)
        for child, inverse in self._children:
            child.matrix_parent_inverse = inverse


def copy_value(value: object) -> object:
    """A copy of a property's value, which does not change with the property."""
    if isinstance(value, (Matrix, Vector, Euler, Quaternion)):
        return value.copy()
    return tuple(value) if isinstance(value, bpy_prop_array) else value
