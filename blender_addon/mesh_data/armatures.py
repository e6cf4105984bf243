"""Armatures: which bones move an object, where these hang, and binding another object to the same ones.

The armatures themselves are never written to: they may belong to another file.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import ArmatureModifier, Object, bpy_prop_array
from mathutils import Euler, Matrix, Quaternion, Vector

from zoomout_core.arrays import Floats, Integers

from .shape_keys import read_key_positions, read_rest_positions
from .surfaces import positions_in_world

# What an object's matrix follows from, besides its parent.
OF_PLACE = ("location", "rotation_mode", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
DELTAS = {
    "delta_location": (0, 0, 0),
    "delta_rotation_euler": (0, 0, 0),
    "delta_rotation_quaternion": (1, 0, 0, 0),
    "delta_scale": (1, 1, 1),
}
OF_PARENT = ("parent", "parent_type", "parent_bone", "matrix_parent_inverse")
# Two matrices whose entries differ by less, over the largest, are the same in single precision.
ROUNDING = 1e-4


@dataclass(frozen=True, eq=False)
class Bones:
    """The deforming bones of all armatures of an object.

    Attributes:
        names: of the bones, as vertex groups are called.
        parents: (b,) the number of the next deforming bone above each, -1 for none.
    """

    names: tuple[str, ...]
    parents: Integers


def armatures_of(obj: Object) -> list[Object]:
    """The armatures that deform an object: by its modifiers in their order, else as its parent."""
    found = [modifier.object for modifier in armature_modifiers(obj)]
    return list(dict.fromkeys(found)) or ([obj.parent] if _is_deformed_by_parent(obj) else [])


def armature_modifiers(obj: Object) -> list[ArmatureModifier]:
    """The modifiers that let armatures deform an object."""
    return [modifier for modifier in obj.modifiers if modifier.type == "ARMATURE" and modifier.object]


def read_bones(obj: Object) -> Bones:
    """The deforming bones of an object's armatures; of bones of one name the first one counts."""
    above: dict[str, str | None] = {}
    for armature in armatures_of(obj):
        for bone in armature.data.bones:
            if bone.use_deform:
                parents = (parent.name for parent in bone.parent_recursive if parent.use_deform)
                above.setdefault(bone.name, next(parents, None))
    number = {name: i for i, name in enumerate(above)}
    return Bones(tuple(above), np.array([-1 if parent is None else number[parent] for parent in above.values()], int))


def preserves_volume(obj: Object) -> bool:
    """Whether the armatures of an object preserve its volume."""
    modifiers = armature_modifiers(obj)
    return bool(modifiers) and modifiers[0].use_deform_preserve_volume


def bind_like(source: Object, target: Object) -> None:
    """Give an object the armature modifiers of another one, and their armature as its parent, at the other's place."""
    given = armature_modifiers(source)
    place = _place_of_modifiers(source, target)
    for number, one in enumerate(given):
        made = target.modifiers.new(one.name, "ARMATURE")
        for option in one.bl_rna.properties:
            if not option.is_readonly and option.identifier != "name":
                setattr(made, option.identifier, getattr(one, option.identifier))
        target.modifiers.move(len(target.modifiers) - 1, place + number)
    if not given:
        target.modifiers.new("Armature", "ARMATURE").object = source.parent
        target.modifiers.move(len(target.modifiers) - 1, place)
    put(target, _parent_for(source), place_beside(source, target))


def hang_like(source: Object, target: Object) -> None:
    """Hang an object from what another one hangs from, in the same place."""
    for name in (*OF_PARENT, *OF_PLACE, *DELTAS):
        setattr(target, name, _copied(getattr(source, name)))


def place_beside(source: Object, target: Object) -> Matrix:
    """The matrix that an object is given to be bound like another one: the same, mirrored where only one of both is."""
    flipped = source.matrix_world.is_negative != target.matrix_world.is_negative
    return source.matrix_world @ (Matrix.Diagonal((-1, 1, 1, 1)) if flipped else Matrix())


def can_be_put(source: Object, target: Object) -> bool:
    """Whether an object would stand where another one does, if it were bound like that: nothing else holds it."""
    wanted = place_beside(source, target)
    with _restored(target):
        put(target, _parent_for(source), wanted)
        bpy.context.view_layer.update()
        found = target.matrix_world.copy()
    bpy.context.view_layer.update()
    size = max(abs(entry) for row in wanted for entry in row)
    return all((a - b).length <= ROUNDING * size for a, b in zip(found, wanted, strict=True))


def unbind(obj: Object) -> None:
    """Take an object off its armatures; it keeps its place."""
    for modifier in armature_modifiers(obj):
        obj.modifiers.remove(modifier)
    if _is_deformed_by_parent(obj):
        placed = obj.matrix_world.copy()
        obj.parent = None
        obj.matrix_world = placed


def matrix_at_rest(obj: Object) -> Matrix:
    """The matrix of an object in the world, were the bone that it hangs from at rest."""
    armature = obj.parent
    if armature is None or obj.parent_type != "BONE" or obj.parent_bone not in armature.pose.bones:
        return obj.matrix_world.copy()
    bone, world = armature.pose.bones[obj.parent_bone], armature.matrix_world
    return world @ bone.bone.matrix_local @ (world @ bone.matrix).inverted() @ obj.matrix_world


def reshape(
    obj: Object, seen: Floats, at_rest: Floats, linear: Floats, place: Matrix, stood: Matrix | None = None
) -> None:
    """Move the vertices of an object, and of its shape keys, before it is given another place.

    Where it has no shape keys, it gets the shape that is seen of it, which an armature may have posed.

    Args:
        obj: as it stands.
        seen: (n, 3) where its vertices are seen, in world space.
        at_rest: (n, 3) where these are to be, in world space.
        linear: (n, 3, 3) what becomes of differences around each vertex.
        place: the matrix that the object will have.
        stood: the matrix by which its vertices are seen there; the object's own when not given.
    """
    mesh, to_world = obj.data, np.array(obj.matrix_world if stood is None else stood)
    to_object = np.array(place.inverted())

    def placed(offsets: Floats) -> Floats:
        world = at_rest + np.einsum("nxy,ny->nx", linear, offsets)
        return np.ascontiguousarray(world @ to_object[:3, :3].T + to_object[:3, 3], np.float32)

    blocks = mesh.shape_keys.key_blocks if mesh.shape_keys else ()
    keys = [read_key_positions(mesh, block.name) @ to_world[:3, :3].T + to_world[:3, 3] for block in blocks]
    shapes = [placed(key - seen) for key in keys]
    mesh.vertices.foreach_set("co", (shapes[0] if shapes else placed(np.zeros_like(seen))).ravel())
    for block, shape in zip(blocks, shapes, strict=True):
        block.points.foreach_set("co", shape.ravel())
    mesh.update()


def stands_as_modelled(obj: Object, seen: Floats) -> bool:
    """Whether vertices are seen (n, 3), in world space, where the mesh of an object has them."""
    off = np.abs(positions_in_world(obj, read_rest_positions(obj.data)) - seen).max(initial=0)
    return bool(off <= ROUNDING * np.ptp(seen, axis=0).max(initial=0))


def _is_deformed_by_parent(obj: Object) -> bool:
    return obj.parent is not None and obj.parent.type == "ARMATURE" and obj.parent_type == "ARMATURE"


def _parent_for(source: Object) -> Object:
    """The armature that an object bound like another one hangs from."""
    armatures = armatures_of(source)
    return source.parent if source.parent in armatures else armatures[0]


def _place_of_modifiers(source: Object, target: Object) -> int:
    """Where the source has its armatures among other modifiers: behind those of a type that come first there."""
    before: set[str] = set()
    for modifier in source.modifiers:
        if modifier.type == "ARMATURE":
            break
        before.add(modifier.type)
    if not armature_modifiers(source):
        return 0
    behind = [number for number, modifier in enumerate(target.modifiers) if modifier.type in before]
    return max(behind, default=-1) + 1


def put(obj: Object, parent: Object, place: Matrix) -> None:
    """Hang an object from a parent, at a place in the world, sheared as that may be."""
    children = [(child, child.matrix_world.copy()) for child in obj.children]
    obj.parent, obj.parent_type = parent, "OBJECT"
    for name, value in DELTAS.items():
        setattr(obj, name, value)
    obj.matrix_basis = Matrix()
    obj.matrix_parent_inverse = parent.matrix_world.inverted() @ place
    for child, standing in children:
        if child.parent_type == "OBJECT":
            child.matrix_parent_inverse = place.inverted() @ standing @ child.matrix_basis.inverted()


@contextmanager
def _restored(obj: Object) -> Iterator[None]:
    """What an object's place follows from, and that of its children, is as before at the end."""
    names = (*OF_PARENT, *OF_PLACE, *DELTAS)
    before = {name: _copied(getattr(obj, name)) for name in names}
    children = [(child, child.matrix_parent_inverse.copy()) for child in obj.children]
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(obj, name, value)
        for child, inverse in children:
            child.matrix_parent_inverse = inverse


def _copied(value: object) -> object:
    """A value of a property, which writing to the property leaves as it is."""
    if isinstance(value, (Matrix, Vector, Euler, Quaternion)):
        return value.copy()
    return tuple(value) if isinstance(value, bpy_prop_array) else value
