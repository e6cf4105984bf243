# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror attributes, UV maps, colours, materials, edge marks, masks and the selection along a symmetry."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.messages import enumeration, message
from zoomout_core.runtime.progress import stage
from zoomout_core.symmetry.flip_name import partner_of
from zoomout_core.symmetry.mirror import Direction, has_mean, mirror, own_share_of, symmetrise
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.symmetry.uv import Layout, symmetrise_uv
from zoomout_core.transfer import Attribute, Kind

from ... import mesh_data
from ...jobs import compute, pause, run
from ...mesh_data import Layer
from ...scene.pair import name_of
from ...storage import stored_symmetry
from .mesh_access import READING, own_mesh, writable_mesh, writing

USUAL_DATA = ("uv_maps", "color_attributes", "attributes", "materials", "edges")


def mirror_attributes(
    context: Context,
    obj: Object,
    data: Collection[str] = USUAL_DATA,
    direction: Direction = "left_to_right",
    uv_layout: Layout = "own",
) -> str:
    """Make data of an object's mesh symmetric, or exchange its sides, along the stored symmetry.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        data: the kinds of data, options of `LayerOptions`.
        direction: see `zoomout_core.symmetry.mirror.symmetrise`.
        uv_layout: see `zoomout_core.symmetry.uv`.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or no such data; nothing was written.
    """
    return run(mirror_attributes_async(context, name_of(obj), data, direction, uv_layout))


async def mirror_attributes_async(
    context: Context, name: str, data: Collection[str], direction: Direction, uv_layout: Layout
) -> str:
    """`mirror_attributes` as a coroutine, which keeps no Blender data across an `await`."""
    obj = writable_mesh(context, name)
    symmetry = stored_symmetry.read(obj)
    with stage(READING, 0, 0):
        await pause()
        with own_mesh(context, name, symmetry.surface) as (obj, _):
            read = _read(obj, data)
    found = [one for one in read if direction != "average" or has_mean(one.attribute)]
    skipped = [one.attribute.name for one in read if one not in found]
    if not read:
        raise zo.MeshError("'{name}' has none of the data to mirror: choose other data.", name=name)
    if not found:
        raise zo.MeshError(
            "{names} cannot be averaged: copy the left or the right side, or exchange them.", names=enumeration(skipped)
        )
    made = await compute(partial(_symmetrise_all, found, symmetry, direction, uv_layout))
    with writing(context, name, symmetry.surface) as obj:
        for one in made:
            one.write(obj, one.attribute)
        obj.data.update()
    left_out = message("; skipped {names}, which cannot be averaged", names=enumeration(skipped)) if skipped else ""
    names = enumeration(dict.fromkeys(one.attribute.name for one in made))
    done = (
        "Exchanged the sides of {what} of '{name}'{left_out}"
        if direction == "exchange"
        else "Mirrored {what} of '{name}'{left_out}"
    )
    return message(done, what=names, name=name, left_out=left_out)


@dataclass(frozen=True, eq=False)
class _Data:
    """Values of one kind of elements: an attribute, marks of edges, materials, or a selection.

    Attributes:
        attribute: the values.
        write: writes such values to an object.
        partner: for each material the slot of its partner on the other side.
    """

    attribute: Attribute
    write: Callable[[Object, Attribute], None]
    partner: Integers | None = None


def _read(obj: Object, data: Collection[str]) -> list[_Data]:
    found, mesh = [], obj.data
    for layer in mesh_data.read_layers(mesh)[0]:
        name, role = layer.attribute.name, layer.role.value
        wanted = "masks" if name in mesh_data.SCULPTED else role
        if wanted in data:
            found.append(_Data(layer.attribute, partial(_write_layer, layer)))
    if "materials" in data and mesh.materials:
        names, slots = mesh_data.read_materials(obj, mesh)
        found.append(_Data(slots, partial(_write_materials, names), _partners(names)))
    if "edges" in data:
        found += [_Data(marks, _on_mesh(mesh_data.write_marks)) for marks in mesh_data.read_marks(mesh)]
    if "selection" in data:
        found += [_Data(chosen, _on_mesh(mesh_data.write_selection)) for chosen in mesh_data.read_selection(mesh)]
    return found


def _partners(names: Sequence[str | None]) -> Integers:
    """(slots,) the slot of the material for the other side, such as Boot.R for Boot.L; without one, its own slot."""
    partners = [name and partner_of(name, names) for name in names]
    return np.array([names.index(other) if other in names else slot for slot, other in enumerate(partners)])


def _on_mesh(write: Callable[[Mesh, Attribute], None]) -> Callable[[Object, Attribute], None]:
    return lambda obj, attribute: write(obj.data, attribute)


def _write_layer(layer: Layer, obj: Object, attribute: Attribute) -> None:
    mesh_data.write_layer(obj.data, replace(layer, attribute=attribute))


def _write_materials(names: Sequence[str | None], obj: Object, slots: Attribute) -> None:
    mesh_data.write_materials(obj, names, slots)


def _symmetrise_all(found: Sequence[_Data], symmetry: SelfMap, direction: Direction, uv_layout: Layout) -> list[_Data]:
    made = []
    for i, one in enumerate(found):
        with stage(message("Mirroring '{name}'", name=one.attribute.name), i / len(found), (i + 1) / len(found)):
            made.append(replace(one, attribute=_symmetrise(one, symmetry, direction, uv_layout)))
    return made


def _symmetrise(one: _Data, symmetry: SelfMap, direction: Direction, uv_layout: Layout) -> Attribute:
    attribute = one.attribute
    if attribute.kind is Kind.UV:
        return symmetrise_uv(attribute, symmetry, direction, uv_layout)
    if one.partner is None:
        return symmetrise(attribute, symmetry, direction)
    other = mirror(replace(attribute, values=one.partner[attribute.values]), symmetry)
    own = own_share_of(attribute.domain, symmetry, direction) >= 0.5
    return replace(attribute, values=np.where(own, attribute.values, other.values))
