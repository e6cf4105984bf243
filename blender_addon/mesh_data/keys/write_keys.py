# SPDX-License-Identifier: GPL-3.0-or-later
"""Write shape keys, their settings, names and animation."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import bpy
import numpy as np
from bpy.types import Key, Mesh, Object

from zoomout_core.arrays import Floats

from ..surfaces.surfaces import read_positions
from .shape_keys import ShapeKey, read_key_positions, read_rest_positions

BASIS = "Basis"


def move_vertices(mesh: Mesh, offsets: Floats) -> None:
    """Move the vertices of a mesh by offsets (n, 3), in its own space, together with its shape keys."""
    mesh.vertices.foreach_set("co", np.ascontiguousarray(read_positions(mesh) + offsets, np.float32).ravel())
    for block in mesh.shape_keys.key_blocks if mesh.shape_keys else ():
        moved = read_key_positions(mesh, block.name) + offsets
        block.points.foreach_set("co", np.ascontiguousarray(moved, np.float32).ravel())


def write_shape_keys(obj: Object, keys: Sequence[ShapeKey], offsets: Floats) -> None:
    """Write keys with offsets (n, keys, 3) in the object's space; keys of the same names are overwritten.

    Other keys that are relative to these move along, as in Blender, so that their offsets stay the same.
    """
    mesh = obj.data
    active = obj.active_shape_key_index
    if mesh.shape_keys is None:
        obj.shape_key_add(name=BASIS, from_mix=False)
    blocks = mesh.shape_keys.key_blocks
    rest = read_rest_positions(mesh)
    following = _following(mesh.shape_keys, {key.name for key in keys})
    before = {name: read_key_positions(mesh, name) for name in set(following.values())}
    for key, shape in zip(keys, _shapes_of(keys, offsets, rest), strict=True):
        block = blocks.get(key.name) or obj.shape_key_add(name=key.name, from_mix=False)
        block.points.foreach_set("co", np.ascontiguousarray(shape, np.float32).ravel())
        block.slider_min = -10.0  # its lower limit, so that no maximum is below it
        for name, value in key.settings.items():
            setattr(block, name, value)
    for key in keys:
        blocks[key.name].relative_key = blocks[key.relative_to] if key.relative_to else mesh.shape_keys.reference_key
    for follower, name in following.items():
        moved: Floats = read_key_positions(mesh, follower) + read_key_positions(mesh, name) - before[name]
        blocks[follower].points.foreach_set("co", np.ascontiguousarray(moved, np.float32).ravel())
    obj.active_shape_key_index = active
    mesh.shape_keys.update_tag()


def _shapes_of(keys: Sequence[ShapeKey], offsets: Floats, rest: Floats) -> list[Floats]:
    """The positions (n, 3) of each key with offsets (n, keys, 3) from another key, or from the Basis (n, 3)."""
    shapes = dict[int, Floats]()

    def shape(number: int) -> Floats:
        if number not in shapes:
            base = keys[number].base
            shapes[number] = offsets[:, number] + (rest if base < 0 else shape(base))
        return shapes[number]

    return [shape(number) for number in range(len(keys))]


def rename_shape_keys(key: Key, names: Mapping[str, str]) -> None:
    """Rename the shape keys of a mesh; Blender updates the paths of animations and drivers.

    Args:
        key: the mesh's shape keys.
        names: new names by old ones; new names may be old ones of others that are renamed, too.
    """
    blocks = [(key.key_blocks[old], new) for old, new in names.items() if old != new]
    for new in {new for _, new in blocks}.intersection(names):
        key.key_blocks[new].name = f"{new} before"
    for block, new in blocks:
        block.name = new


def write_shape(obj: Object, name: str, shape: Floats) -> None:
    """Write a shape (n, 3) in the object's space as a key of value 0; a key of that name is overwritten."""
    settings = {"slider_max": 1.0, "slider_min": 0.0, "value": 0.0, "mute": False, "vertex_group": ""}
    write_shape_keys(obj, [ShapeKey(name, -1, None, settings)], (shape - read_rest_positions(obj.data))[:, None])


def write_animation(source: Key, target: Key, names: Sequence[str]) -> None:
    """Copy the source's drivers of some keys, which read the same values, and its action if the target has none."""
    animation = source.animation_data
    if animation is None:
        return
    own = target.animation_data_create()
    paths = tuple(path_of_key(name) for name in names)
    for curve in [curve for curve in animation.drivers if curve.data_path.startswith(paths)]:
        present = own.drivers.find(curve.data_path, index=curve.array_index)
        if present is not None:
            own.drivers.remove(present)
        own.drivers.from_existing(src_driver=curve)
    if animation.action is not None and own.action is None:
        own.action = animation.action.copy()
        slot = getattr(animation, "action_slot", None)  # from Blender 4.4 on
        if slot is not None:
            own.action_slot = own.action.slots[slot.identifier]


def path_of_key(name: str) -> str:
    """The data path of a key's properties, without their names."""
    return f'key_blocks["{bpy.utils.escape_identifier(name)}"].'


def _following(key: Key, names: Collection[str]) -> dict[str, str]:
    """Other keys that are relative, directly or indirectly, to keys of these names: key name to the first such name."""
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
