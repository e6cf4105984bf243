"""Make attributes, UV maps, colours, masks and the selection of the active mesh the same on both sides."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import partial

from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.progress import Steps, drain, spread
from zoomout_core.symmetry.mirror import MIXABLE, Winner, symmetrised
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.symmetry.uv import Layout, symmetrised_uv
from zoomout_core.threads import in_background
from zoomout_core.transfer import Attribute, Kind

from ... import mesh_data, stored_symmetry
from ...mesh_data import Layer
from ...properties.settings import take_settings
from ...properties.symmetry import LayerOptions, WinnerOptions
from .base import READING, SymmetryOperator, own_mesh, unedited, writable_mesh

USUAL_DATA = ("uv_maps", "color_attributes", "attributes")


class ZOOMOUT_OT_mirror_attributes(LayerOptions, WinnerOptions, SymmetryOperator):
    bl_idname = "zoomout.mirror_attributes"
    bl_label = "Mirror Attributes"
    bl_description = "Give one side's UVs, colors, attributes, masks or selection to the other one"
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        take_settings(self, context.scene.zoomout.symmetry)
        name, winner, layout = context.active_object.name, self.winner.lower(), self.uv_layout.lower()
        return (yield from mirror_attributes_steps(context, name, self.data(), winner, layout))


def mirror_attributes(
    context: Context,
    obj: Object,
    data: Collection[str] = USUAL_DATA,
    winner: Winner = "left",
    uv_layout: Layout = "own",
) -> str:
    """Make data of an object's mesh the same on both sides, along the symmetry that is kept on it.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        data: which kinds of it, the options of `LayerOptions`.
        winner: the side that stays as it is, "left" or "right", or "average".
        uv_layout: see `zoomout_core.symmetry.uv`.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or no such data; nothing was written.
    """
    return drain(mirror_attributes_steps(context, obj.name, data, winner, uv_layout))


def mirror_attributes_steps(
    context: Context, name: str, data: Collection[str], winner: Winner, uv_layout: Layout
) -> Steps[str]:
    """`mirror_attributes` as a generator, which holds no Blender data while it is suspended."""
    obj = writable_mesh(context, name)
    symmetry = stored_symmetry.read(obj)
    yield READING
    with own_mesh(context, name, symmetry.surface) as (_, mesh):
        read = _read(mesh, data)
    found = [one for one in read if _has_way(one.attribute, winner)]
    skipped = [one.attribute.name for one in read if not _has_way(one.attribute, winner)]
    if not read:
        raise zo.MeshError(f"'{name}' has none of the data that is to be mirrored: choose other data.")
    if not found:
        raise zo.MeshError(f"There is no mean of {', '.join(skipped)}: let the left or the right side win.")
    made = []
    for i, one in enumerate(found):
        work = in_background(partial(_made, one.attribute, symmetry, winner, uv_layout))
        values = yield from spread(work, i / len(found), (i + 1) / len(found), f"Mirroring '{one.attribute.name}'")
        made.append(replace(one, attribute=values))
    obj = unedited(context, name, symmetry.surface)
    for one in made:
        one.write(obj.data)
    obj.data.update()
    left_out = f"; skipped {', '.join(skipped)}, of which there is no mean" if skipped else ""
    return f"Mirrored {', '.join(one.attribute.name for one in made)} of '{name}'{left_out}"


@dataclass(frozen=True, eq=False)
class _Data:
    """An attribute, or what is selected, of one kind of elements.

    Attributes:
        attribute: the values.
        layer: how Blender keeps it, or None for a selection.
    """

    attribute: Attribute
    layer: Layer | None = None

    def write(self, mesh: Mesh) -> None:
        if self.layer is not None:
            mesh_data.write_layer(mesh, replace(self.layer, attribute=self.attribute))
        else:
            mesh_data.write_selection(mesh, self.attribute)


def _read(mesh: Mesh, data: Collection[str]) -> list[_Data]:
    found = []
    for layer in mesh_data.read_layers(mesh)[0]:
        name, role = layer.attribute.name, layer.role.value
        wanted = "masks" if name in mesh_data.SCULPTED else role
        if wanted in data:
            found.append(_Data(layer.attribute, layer))
    if "selection" in data:
        found += [_Data(attribute) for attribute in mesh_data.read_selection(mesh)]
    return found


def _has_way(attribute: Attribute, winner: Winner) -> bool:
    return winner != "average" or attribute.kind in (*MIXABLE, Kind.BOOLEAN)


def _made(attribute: Attribute, symmetry: SelfMap, winner: Winner, uv_layout: Layout) -> Attribute:
    if attribute.kind is Kind.UV:
        return symmetrised_uv(attribute, symmetry, winner, uv_layout)
    return symmetrised(attribute, symmetry, winner)
