# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys: their offsets as an array, and their settings in Blender.

Offsets are relative to a key's reference key, which need not be the Basis. They apply before modifiers: an armature
poses the mesh that the keys have moved.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from bpy.types import Key, Mesh, Object

from zoomout_core.arrays import Floats
from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Domain, Kind

from ..arrays import read_array
from ..attributes.vertex_groups import read_mask
from ..surfaces.surfaces import VERTEX_PRESERVING, Faces, read_faces, read_positions

# Properties of a key besides its place and its reference key; the range comes before the value, which it clamps.
SETTINGS = ("slider_max", "slider_min", "value", "mute", "interpolation", "vertex_group", "lock_shape")


@dataclass(frozen=True)
class ShapeKey:
    """A shape key without its shape.

    Attributes:
        name: the key's name in Blender.
        base: the number of the key that its offsets are relative to, -1 for the Basis.
        relative_to: the name of its reference key in Blender; None for the Basis.
        settings: values of the properties in `SETTINGS`.
    """

    name: str
    base: int
    relative_to: str | None
    settings: dict[str, Any]


@dataclass(frozen=True, eq=False)
class ShapeKeys:
    """The shape keys of a mesh, without the Basis.

    Attributes:
        keys: the keys in the order of Blender's list.
        offsets: (n, keys, 3) in the object's space.
        rest: (n, 3) positions of the Basis.
    """

    keys: tuple[ShapeKey, ...]
    offsets: Attribute
    rest: Floats


def offsets_of(names: tuple[str, ...], values: Floats) -> Attribute:
    """An attribute of the offsets (n, keys, 3) of shape keys with some names."""
    return Attribute(message("shape keys"), Domain.POINT, Kind.OFFSET, values, names)


def read_rest_positions(mesh: Mesh) -> Floats:
    """(n, 3) positions of the Basis shape key, or of the mesh without shape keys."""
    if mesh.shape_keys is None:
        return read_positions(mesh)
    return read_array(mesh.shape_keys.reference_key.points, "co", np.float32, 3)


def read_key_positions(mesh: Mesh, name: str) -> Floats:
    """(n, 3) positions in a shape key."""
    return read_array(mesh.shape_keys.key_blocks[name].points, "co", np.float32, 3)


def read_shape_keys(obj: Object, faces: Faces) -> ShapeKeys | None:
    """The shape keys of an object that has some, on the vertices of its evaluated mesh.

    Args:
        obj: the object as it is in the file.
        faces: the faces of its evaluated mesh.

    Returns:
        The keys, or None if the faces differ without deforming modifiers or with a single key.
    """
    if faces == read_faces(obj.data):
        return read_own_shape_keys(obj.data)
    keys = _keys(obj.data.shape_keys)
    with _undeformed_copy(obj) as copy:
        found = _evaluated_offsets(copy, keys, faces)
    return None if found is None else _shape_keys(keys, *found)


def read_undeformed_positions(obj: Object, faces: Faces) -> Floats | None:
    """(n, 3) undeformed positions of an object, on the vertices of its evaluated mesh.

    Args:
        obj: the object as it is in the file.
        faces: the faces of its evaluated mesh.

    Returns:
        The positions, or None if the faces differ without deforming modifiers.
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


def read_full_offsets(obj: Object) -> dict[str, Floats]:
    """The offsets (n, 3) that each key of an object adds at a value of 1, by name, in the object's space."""
    if obj.data.shape_keys is None:
        return {}
    own = read_own_shape_keys(obj.data)
    found = {}
    for number, key in enumerate(own.keys):
        offsets, mask = own.offsets.values[:, number].astype(np.float64), key.settings["vertex_group"]
        found[key.name] = offsets * read_mask(obj, mask)[:, None] if mask in obj.vertex_groups else offsets
    return found


def join_shape_keys(of_each: Sequence[ShapeKeys]) -> tuple[ShapeKeys, list[list[str]]]:
    """Join the shape keys of several objects by name; a key does not move objects that lack it.

    A key takes its settings and reference key from the first object that has it. On objects where its reference key
    differs, its offsets do not fit, and it does not move them.

    Args:
        of_each: the shape keys of each object, in a common space.

    Returns:
        The keys, and for each object the names of the keys that it is the first to have.
    """
    if len(of_each) == 1:
        return of_each[0], [list(of_each[0].offsets.labels)]
    names = dict.fromkeys(name for each in of_each for name in each.offsets.labels)
    columns = {name: column for column, name in enumerate(names)}
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
    """A key with its base renumbered by `columns`."""
    return replace(key, base=-1 if key.base < 0 else columns[keys[key.base].name])


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
        # Keys that are relative to each other in a circle start from the Basis.
        number = numbers[base.name] if relative_to and _ends(block, key) else -1
        keys.append(ShapeKey(block.name, number, relative_to, settings))
    return tuple(keys)


def _ends(block: bpy.types.ShapeKey, key: Key) -> bool:
    """Whether a key's chain of reference keys ends at the Basis."""
    for _ in key.key_blocks:
        if block == key.reference_key:
            return True
        block = block.relative_key
    return False


@contextmanager
def _undeformed_copy(obj: Object) -> Iterator[Object]:
    """A temporary copy of an object without deforming modifiers; generating modifiers stay."""
    copy = obj.copy()
    copy.data = obj.data.copy()
    try:
        keys = copy.data.shape_keys
        for owner in (copy, keys) if keys else (copy,):
            owner.animation_data_clear()
        copy.parent = None  # an armature may deform it as its parent
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
    """The rest shape and each key's offset after the modifiers; None if they make other faces."""
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
    """(n, 3) positions after the modifiers, or None if they make other faces."""
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    try:
        mesh = evaluated.to_mesh()
        return read_positions(mesh) if read_faces(mesh) == faces else None
    finally:
        evaluated.to_mesh_clear()


def names_of_keys(obj: Object) -> list[str]:
    """The names of an object's shape keys besides the Basis."""
    key = obj.data.shape_keys
    return [] if key is None else [block.name for block in key.key_blocks if block != key.reference_key]
