# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys: their offsets as an array, and how Blender plays them.

Offsets count from the key that a key is relative to, which need not be the Basis. They belong to the mesh before
its modifiers: an armature poses what the keys have moved.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from bpy.types import FCurve, Key, Mesh, Object

from zoomout_core.arrays import Floats
from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Domain, Kind

from .arrays import read_array
from .surfaces import VERTEX_PRESERVING, Faces, read_faces, read_positions

# Properties of a key besides its place and the key that it is relative to; the range comes before the value in it.
SETTINGS = ("slider_max", "slider_min", "value", "mute", "interpolation", "vertex_group", "lock_shape")
BASIS = "Basis"


@dataclass(frozen=True)
class ShapeKey:
    """A shape key without its shape.

    Attributes:
        name: as the user knows it.
        base: the number of the key that its offsets count from, -1 for the Basis.
        relative_to: the name of the key that Blender takes it relative to; None for the Basis.
        settings: values of the properties in `SETTINGS`.
    """

    name: str
    base: int
    relative_to: str | None
    settings: dict[str, Any]


@dataclass(frozen=True, eq=False)
class ShapeKeys:
    """The shape keys of a mesh but the first, which is the shape that they start from.

    Attributes:
        keys: in the order of Blender's list.
        offsets: (n, keys, 3) in the object's space.
        rest: (n, 3) the shape that they start from.
    """

    keys: tuple[ShapeKey, ...]
    offsets: Attribute
    rest: Floats


def offsets_of(names: tuple[str, ...], values: Floats) -> Attribute:
    """Offsets (n, keys, 3) of shape keys of some names."""
    return Attribute(message("shape keys"), Domain.POINT, Kind.OFFSET, values, names)


def read_rest_positions(mesh: Mesh) -> Floats:
    """(n, 3) positions of the vertices that shape keys start from, or of the mesh if it has none."""
    if mesh.shape_keys is None:
        return read_positions(mesh)
    return read_array(mesh.shape_keys.reference_key.points, "co", np.float32, 3)


def read_key_positions(mesh: Mesh, name: str) -> Floats:
    """(n, 3) positions of the vertices that a shape key stores."""
    return read_array(mesh.shape_keys.key_blocks[name].points, "co", np.float32, 3)


def move_vertices(mesh: Mesh, offsets: Floats) -> None:
    """Move the vertices of a mesh by (n, 3), in its own space; its shape keys move along."""
    mesh.vertices.foreach_set("co", np.ascontiguousarray(read_positions(mesh) + offsets, np.float32).ravel())
    for block in mesh.shape_keys.key_blocks if mesh.shape_keys else ():
        moved = read_key_positions(mesh, block.name) + offsets
        block.points.foreach_set("co", np.ascontiguousarray(moved, np.float32).ravel())


def read_shape_keys(obj: Object, faces: Faces) -> ShapeKeys | None:
    """The shape keys of an object that has some, on the vertices that its modifiers leave.

    Args:
        obj: the object as it is in the file.
        faces: of its mesh as the modifiers leave it.

    Returns:
        The keys, or None where other modifiers than those that deform make a difference to the mesh's faces.
    """
    if faces == read_faces(obj.data):
        return read_own_shape_keys(obj.data)
    keys = _keys(obj.data.shape_keys)
    with _undeformed_copy(obj) as copy:
        found = _evaluated_offsets(copy, keys, faces)
    return None if found is None else _shape_keys(keys, *found)


def read_undeformed_positions(obj: Object, faces: Faces) -> Floats | None:
    """(n, 3) positions of an object, without what deforms it, on the vertices that its modifiers leave.

    Args:
        obj: the object as it is in the file.
        faces: of its mesh as the modifiers leave it.

    Returns:
        The positions, or None where other modifiers than those that deform make a difference to the mesh's faces.
    """
    if faces == read_faces(obj.data):
        return read_rest_positions(obj.data)
    with _undeformed_copy(obj) as copy:
        return _evaluated_positions(copy, faces)


def read_own_shape_keys(mesh: Mesh) -> ShapeKeys:
    """The shape keys of a mesh that has some, on its own vertices."""
    keys, rest = _keys(mesh.shape_keys), read_rest_positions(mesh)
    shapes = {key.name: read_key_positions(mesh, key.name) for key in keys}
    bases = [rest if key.base < 0 else shapes[keys[key.base].name] for key in keys]
    return _shape_keys(keys, rest, [shapes[key.name] - base for key, base in zip(keys, bases, strict=True)])


def join_shape_keys(of_each: Sequence[ShapeKeys]) -> tuple[ShapeKeys, list[list[str]]]:
    """The shape keys of several objects as of one: keys of a name are one, and do not move what lacks them.

    How a key is set, and what it is relative to, is as on the first object that has it: where it is relative to another
    one, its offsets are of no use, and it does not move that object.

    Args:
        of_each: of each object, in one space.

    Returns:
        The keys, and for each object the names of those that it has before the others.
    """
    if len(of_each) == 1:
        return of_each[0], [list(of_each[0].offsets.labels)]
    columns = {
        name: i for i, name in enumerate(dict.fromkeys(name for each in of_each for name in each.offsets.labels))
    }
    joined, own, offsets = dict[str, ShapeKey](), [], []
    for each in of_each:
        new = {key.name: _renumber(key, each.keys, columns) for key in each.keys if key.name not in joined}
        joined |= new
        own.append(list(new))
        offsets.append(np.zeros((len(each.rest), len(columns), 3)))
        for number, key in enumerate(each.keys):
            if joined[key.name].relative_to == key.relative_to:
                offsets[-1][:, columns[key.name]] = each.offsets.values[:, number]
    rest = np.concatenate([each.rest for each in of_each])
    return ShapeKeys(tuple(joined.values()), offsets_of(tuple(columns), np.concatenate(offsets)), rest), own


def _renumber(key: ShapeKey, keys: Sequence[ShapeKey], columns: Mapping[str, int]) -> ShapeKey:
    """A key among others, whose base is numbered as in `columns`."""
    return replace(key, base=-1 if key.base < 0 else columns[keys[key.base].name])


def write_shape_keys(obj: Object, keys: Sequence[ShapeKey], offsets: Floats) -> None:
    """Write keys with offsets (n, keys, 3) in the object's space; those of the same names are overwritten.

    Other keys that are relative to those move along, as when a key is edited: what they do stays the same.
    """
    mesh = obj.data
    active = obj.active_shape_key_index
    if mesh.shape_keys is None:
        obj.shape_key_add(name=BASIS, from_mix=False)
    blocks = mesh.shape_keys.key_blocks
    rest = read_rest_positions(mesh)
    following = _following(mesh.shape_keys, {key.name for key in keys})
    before = {name: read_key_positions(mesh, name) for name in set(following.values())}
    shapes: list[Floats | None] = [None] * len(keys)

    def shape(number: int) -> Floats:
        found = shapes[number]
        if found is None:
            base = keys[number].base
            found = shapes[number] = offsets[:, number] + (rest if base < 0 else shape(base))
        return found

    for number, key in enumerate(keys):
        block = blocks.get(key.name) or obj.shape_key_add(name=key.name, from_mix=False)
        block.points.foreach_set("co", np.ascontiguousarray(shape(number), np.float32).ravel())
        block.slider_min = -10.0  # its least, so that no maximum lies below it
        for name, value in key.settings.items():
            setattr(block, name, value)
    for key in keys:
        blocks[key.name].relative_key = blocks[key.relative_to] if key.relative_to else mesh.shape_keys.reference_key
    for follower, name in following.items():
        moved: Floats = read_key_positions(mesh, follower) + read_key_positions(mesh, name) - before[name]
        blocks[follower].points.foreach_set("co", np.ascontiguousarray(moved, np.float32).ravel())
    obj.active_shape_key_index = active
    mesh.shape_keys.update_tag()


def write_shape(obj: Object, name: str, shape: Floats) -> None:
    """Write a key of a shape (n, 3) in the object's space that nothing shows yet; one of that name is overwritten."""
    settings = {"slider_max": 1.0, "slider_min": 0.0, "value": 0.0, "mute": False, "vertex_group": ""}
    write_shape_keys(obj, [ShapeKey(name, -1, None, settings)], (shape - read_rest_positions(obj.data))[:, None])


def write_animation(source: Key, target: Key, names: Sequence[str]) -> None:
    """Give keys of some names the drivers that they have on the source, and its action where there is no other."""
    animation = source.animation_data
    if animation is None:
        return
    own = target.animation_data_create()
    for curve in _drivers(source, names):
        present = own.drivers.find(curve.data_path, index=curve.array_index)
        if present is not None:
            own.drivers.remove(present)
        copied = own.drivers.from_existing(src_driver=curve)
        for variable in copied.driver.variables:
            for end in variable.targets:
                if end.id == source:
                    end.id = target
    if animation.action is not None and own.action is None:
        own.action = animation.action.copy()
        slot = getattr(animation, "action_slot", None)  # from Blender 4.4 on
        if slot is not None:
            own.action_slot = own.action.slots[slot.identifier]


def _drivers(key: Key, names: Sequence[str]) -> list[FCurve]:
    paths = tuple(f'key_blocks["{bpy.utils.escape_identifier(name)}"].' for name in names)
    return [curve for curve in key.animation_data.drivers if curve.data_path.startswith(paths)]


def _following(key: Key, names: Collection[str]) -> dict[str, str]:
    """Keys that are relative, directly or by way of others, to one of these names, by their names; themselves not."""
    following = {}
    for block in key.key_blocks:
        base = block.relative_key
        for _ in key.key_blocks:  # they may be relative to each other in a circle
            if base == key.reference_key or block.name in names:
                break
            if base.name in names:
                following[block.name] = base.name
                break
            base = base.relative_key
    return following


def _shape_keys(keys: tuple[ShapeKey, ...], rest: Floats, offsets: list[Floats]) -> ShapeKeys:
    return ShapeKeys(keys, offsets_of(tuple(key.name for key in keys), np.stack(offsets, axis=1)), rest)


def _keys(key: Key) -> tuple[ShapeKey, ...]:
    blocks = [block for block in key.key_blocks if block != key.reference_key]
    numbers = {block.name: number for number, block in enumerate(blocks)}
    keys = []
    for block in blocks:
        base = block.relative_key
        settings = {name: getattr(block, name) for name in SETTINGS}
        relative_to = None if base == key.reference_key else base.name
        # Keys that are relative to each other in a circle have nothing to start from but the Basis.
        number = numbers[base.name] if relative_to and _ends(block, key) else -1
        keys.append(ShapeKey(block.name, number, relative_to, settings))
    return tuple(keys)


def _ends(block: bpy.types.ShapeKey, key: Key) -> bool:
    """Whether the keys that a key is relative to, one after the other, end at the Basis."""
    for _ in key.key_blocks:
        if block == key.reference_key:
            return True
        block = block.relative_key
    return False


@contextmanager
def _undeformed_copy(obj: Object) -> Iterator[Object]:
    """A temporary copy of an object without deforming modifiers; those that generate vertices stay."""
    copy = obj.copy()
    copy.data = obj.data.copy()
    try:
        keys = copy.data.shape_keys
        for owner in (copy, keys) if keys else (copy,):
            owner.animation_data_clear()
        copy.parent = None  # which may be an armature that deforms it without a modifier
        for modifier in [modifier for modifier in copy.modifiers if modifier.type in VERTEX_PRESERVING]:
            copy.modifiers.remove(modifier)
        copy.show_only_shape_key = False
        for block in keys.key_blocks if keys else ():
            block.vertex_group, block.mute = "", False
            block.slider_min, block.slider_max, block.value = 0, 1, 0
        bpy.context.scene.collection.objects.link(copy)
        yield copy
    finally:
        keyed = copy.data
        bpy.data.objects.remove(copy)
        bpy.data.meshes.remove(keyed)


def _evaluated_offsets(obj: Object, keys: Sequence[ShapeKey], faces: Faces) -> tuple[Floats, list[Floats]] | None:
    """What the modifiers make of the rest shape and of each key's offset; None if they make other faces."""
    blocks = obj.data.shape_keys.key_blocks
    rest, offsets = _evaluated_positions(obj, faces), []
    for key in keys:
        blocks[key.name].relative_key = blocks[keys[key.base].name] if key.base >= 0 else blocks[0]
        blocks[key.name].value = 1
        shape = _evaluated_positions(obj, faces)
        blocks[key.name].value = 0
        if rest is None or shape is None:
            return None
        offsets.append(shape - rest)
    return None if rest is None else (rest, offsets)


def _evaluated_positions(obj: Object, faces: Faces) -> Floats | None:
    """(n, 3) positions that the modifiers leave, or None if they make other faces."""
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    try:
        mesh = evaluated.to_mesh()
        return read_positions(mesh) if read_faces(mesh) == faces else None
    finally:
        evaluated.to_mesh_clear()
