# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror shape keys along a symmetry, split them into sides, or make them symmetric."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import partial
from typing import Literal, TypeAlias, get_args

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.symmetry.flip_name import partner_of
from zoomout_core.symmetry.mirror import Direction
from zoomout_core.symmetry.offsets import mirror_offsets, split_offsets, symmetrise_offsets
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.symmetry.sides import BLEND

from ... import mesh_data
from ...jobs import compute, pause, run
from ...mesh_data import ShapeKey
from ...scene.pair import name_of
from ...storage import stored_symmetry
from .mesh_access import READING, own_mesh, writable_mesh, writing

KeyMode: TypeAlias = Literal["mirror", "split", "symmetrise"]
# Displacements shorter than this fraction of a key's longest one are noise.
NOISE = 1e-4


def mirror_shape_key(
    context: Context,
    obj: Object,
    key: str,
    mode: KeyMode = "mirror",
    direction: Direction = "left_to_right",
    blend: float = BLEND,
) -> str:
    """Create or change shape keys along the symmetry stored on an object's mesh.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        key: the name of the key to start from.
        mode: "mirror" makes the key of the other side, such as Smile.R from Smile.L; "split" makes a left and a right
            key, such as Smile.L and Smile.R from Smile; "symmetrise" makes the key itself symmetric.
        direction: for "symmetrise", see `zoomout_core.symmetry.mirror.symmetrise`; "exchange" with "mirror" also makes
            the key itself from that of the other side.
        blend: for "split", see `zoomout_core.symmetry.offsets.split_offsets`.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or no such key; nothing was written.
    """
    return run(mirror_shape_key_async(context, name_of(obj), key, mode, direction, blend))


async def mirror_shape_key_async(
    context: Context, name: str, key_name: str, mode: KeyMode, direction: Direction, blend: float
) -> str:
    """`mirror_shape_key` as a coroutine, which keeps no Blender data across an `await`."""
    if mode not in get_args(KeyMode):
        raise ValueError(f"mode is {mode!r}: choose one of {', '.join(get_args(KeyMode))}.")
    obj = writable_mesh(context, name)
    symmetry = stored_symmetry.read(obj)
    with stage(READING, 0, 0):
        await pause()
    both = mode == "mirror" and direction == "exchange"
    with own_mesh(context, name, symmetry.surface) as (obj, _):
        key, offsets = read_key(obj, key_name)
        names = _new_names(key_name, mode, obj.data.shape_keys.key_blocks.keys())
        _check_not_locked(obj, {key_name, *names} if both else names)
        partner, theirs = read_key(obj, names[0]) if both else (key, offsets)
    if both:
        keys, work = [key, partner], partial(_mirror, [theirs, offsets], symmetry)
    else:
        keys = [replace(key, name=new) for new in names]
        work = partial(_new_offsets, offsets, symmetry, mode, direction, blend)
    with stage("Mirroring the key"):
        made = await compute(work)
    with writing(context, name, symmetry.surface) as obj:
        for one, shape in zip(keys, made, strict=True):
            _write(obj, one, shape, mode, in_place=both or mode == "symmetrise")
        obj.data.update()
    return _summary(key_name, names, mode, direction)


def read_key(obj: Object, name: str) -> tuple[ShapeKey, Floats]:
    """A shape key of an object, and its displacements (n, 3) from its reference key.

    Raises:
        MeshError: there is no such key, no key is active, or keys are absolute.
    """
    present = obj.data.shape_keys
    if not name:
        raise zo.MeshError("No shape key of '{name}' is active: add one, or make it active.", name=obj.name)
    if present is None or name not in present.key_blocks or name == present.reference_key.name:
        raise zo.MeshError(
            "'{name}' has no shape key {key} besides the Basis: make another key active.", name=obj.name, key=repr(name)
        )
    if not present.use_relative:
        raise zo.MeshError(
            "The shape keys of '{name}' are absolute: turn on Relative in its shape keys.", name=obj.name
        )
    keys = mesh_data.read_own_shape_keys(obj.data)
    number = keys.offsets.labels.index(name)
    return keys.keys[number], keys.offsets.values[:, number].astype(np.float64)


def _new_names(name: str, mode: KeyMode, present: Collection[str]) -> tuple[str, ...]:
    """The names of the keys that are made from a key; `present` has the names of existing keys."""
    if mode == "split":
        return f"{name}.L", f"{name}.R"
    partner = partner_of(name, present)
    if mode == "mirror" and partner == name:
        raise zo.MeshError(
            "The name {name} has no side: end it with .L or .R, or use Left and Right Keys.", name=repr(name)
        )
    return (partner if mode == "mirror" else name,)


def _check_not_locked(obj: Object, names: Collection[str]) -> None:
    """Raise a MeshError if a key of these names exists and is locked."""
    blocks = obj.data.shape_keys.key_blocks
    for name in names:
        if name in blocks and blocks[name].lock_shape:
            raise zo.MeshError(
                "The shape key {key} of '{name}' is locked: unlock it in the list of shape keys.",
                key=repr(name),
                name=obj.name,
            )


def _summary(key: str, names: tuple[str, ...], mode: KeyMode, direction: Direction) -> str:
    """The result in a sentence."""
    first, *others = names
    made = message("'{first}' and '{second}'", first=first, second=others[0]) if others else f"'{first}'"
    if mode == "symmetrise":
        done = "Exchanged the sides of {what}" if direction == "exchange" else "Made {what} symmetric"
        return message(done, what=made)
    done = "Exchanged {key} and {made}" if direction == "exchange" and mode == "mirror" else "From {key} made {made}"
    return message(done, key=repr(key), made=made)


def _mirror(offsets: list[Floats], symmetry: SelfMap) -> list[Floats]:
    """The mirrored displacements (n, 3) of keys."""
    return [_without_noise(mirror_offsets(one, symmetry), one) for one in offsets]


def _new_offsets(offsets: Floats, symmetry: SelfMap, mode: KeyMode, direction: Direction, blend: float) -> list[Floats]:
    """The displacements (n, 3) of each new key."""
    if mode == "mirror":
        return _mirror([offsets], symmetry)
    if mode == "split":
        return [_without_noise(part, offsets) for part in split_offsets(offsets, symmetry, blend)]
    return [_without_noise(symmetrise_offsets(offsets, symmetry, direction), offsets)]


def _without_noise(made: Floats, offsets: Floats) -> Floats:
    """Displacements (n, 3), set to zero where shorter than `NOISE` times the longest of the original ones."""
    least = NOISE * np.linalg.norm(offsets, axis=1).max(initial=0)
    return np.where(np.linalg.norm(made, axis=1, keepdims=True) < least, 0, made)


def _write(obj: Object, key: ShapeKey, offsets: Floats, mode: KeyMode, in_place: bool) -> None:
    """Write a key with displacements from its reference key; an existing key keeps its value.

    Args:
        obj: the object.
        key: the key as it was read, under its new name.
        offsets: (n, 3) displacements.
        mode: see `mirror_shape_key`; with "mirror", vertex group and reference key are those of the other side.
        in_place: whether it overwrites the key that was read, which keeps its settings.
    """
    blocks, settings, base = obj.data.shape_keys.key_blocks, dict(key.settings), key.relative_to
    if not in_place:
        settings["value"] = blocks[key.name].value if key.name in blocks else 0.0
        settings["lock_shape"] = False
        if mode == "mirror":
            settings["vertex_group"] = _other_name(settings["vertex_group"], obj.vertex_groups.keys())
            base = _other_name(base, blocks.keys()) if base else None
    if base is not None:
        offsets = offsets + mesh_data.read_key_positions(obj.data, base) - mesh_data.read_rest_positions(obj.data)
    mesh_data.write_shape_keys(obj, [ShapeKey(key.name, -1, base, settings)], np.ascontiguousarray(offsets)[:, None])


def _other_name(name: str, present: list[str]) -> str:
    """The name for the other side if it is present, otherwise the name itself."""
    partner = partner_of(name, present)
    return partner if partner in present else name
