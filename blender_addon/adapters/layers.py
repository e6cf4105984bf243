# SPDX-License-Identifier: GPL-3.0-or-later
"""UV maps, colour attributes and other attributes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from bpy.types import Object

import zoomout_core as zo
from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Kind
from zoomout_core.transfer.uv.faults import has_jagged_seams

from .. import mesh_data
from ..mesh_data import ActiveLayers, Layer, Role
from .adapter import Adapter, Remarks, TransferJob, TransferRequest


@dataclass
class LayerAdapter:
    """One attribute.

    Attributes:
        layer: its values, and how Blender stores them.
        active: whether the source shows and renders this layer.
        present: the target's attribute of the same name, if the two can be blended.
        lacking: numbers of the sources that do not have it.
        at_rest: surfaces of the source's and the target's own mesh, if the layer turns with the surface.
    """

    layer: Layer
    active: ActiveLayers
    present: Attribute | None
    lacking: tuple[int, ...]
    at_rest: tuple[zo.Surface, zo.Surface] | None = None

    @property
    def kind(self) -> str:
        return self.layer.role.value

    @property
    def names(self) -> list[str]:
        return [self.layer.attribute.name]

    def transfer(self, job: TransferJob) -> None:
        attribute = original = self.layer.attribute
        options = dict[str, Any]()
        if self.at_rest is not None:
            options = dict(zip(("source", "target"), self.at_rest, strict=True))
            if attribute.kind in (Kind.QUATERNION, Kind.MATRIX):
                options["turned"] = True
        attribute = job.transfer(attribute, f"'{attribute.name}'", **options)
        self.layer = replace(self.layer, attribute=job.blend_values(attribute, self.present, lacking=self.lacking))
        if self.layer.role is Role.UV_MAP:
            job.remarks.add(_note_on_seams(self.layer.attribute, original, job))
            job.uv_maps[attribute.name] = self.layer.attribute

    def write(self, target: Object) -> None:
        mesh_data.write_layer(target.data, self.layer)
        mesh_data.write_active_layers(target.data, self.active)


def collect(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    """The requested attributes.

    Raises:
        MeshError: the target has no room for them.
    """
    found, skipped = mesh_data.read_joined_layers(request.sources, request.settings.turning)
    for source in request.sources:
        remarks.skipped |= mesh_data.untransferable_data(source.original, source.mesh)
    if Role.GENERIC.value in request.data:
        remarks.skipped |= skipped
        _note_unturned([layer for layer, _ in found], request, remarks)
    chosen = [joined for joined in found if joined.layer.role.value in request.data]
    layers = [layer for layer, _ in chosen]
    _check_uv_maps(layers, request.target)
    _check_names(layers, request.target, remarks)
    active = mesh_data.read_joined_active_layers(request.sources)
    at_rest = None
    if any(layer.turning for layer in layers):
        at_rest = mesh_data.read_joined_at_rest(request.sources), mesh_data.read_surface_at_rest(request.target)
    return [
        LayerAdapter(
            layer,
            active.among({layer.attribute.name}),
            _present(layer, request, bool(lacking)),
            lacking,
            at_rest if layer.turning else None,
        )
        for layer, lacking in chosen
    ]


def _present(layer: Layer, request: TransferRequest, incomplete: bool) -> Attribute | None:
    """The target's attribute that a layer is blended with, or whose values some vertices keep."""
    mesh, name = request.target.data, layer.attribute.name
    if (
        (request.replaces and not incomplete)
        or name not in mesh.attributes
        or not mesh_data.fits(mesh.attributes[name], layer)
    ):
        return None
    return mesh_data.read_layer(mesh, name, layer.role, layer.turning).attribute


def _note_on_seams(uv: Attribute, original: Attribute, job: TransferJob) -> list[str]:
    """Suggest *Cut Along Seams* if the borders of a transferred UV map's islands are jagged."""
    if not has_jagged_seams(job.pair.source, original.values, job.pair.target, uv.values):
        return []
    return [
        message(
            "{layer}: UV islands of '{target}' end at its own edges, which zigzag: Cut Along Seams before the transfer "
            "makes their borders exact.",
            layer=uv.name,
            target=job.pair.target_name,
        )
    ]


def _note_unturned(layers: list[Layer], request: TransferRequest, remarks: Remarks) -> None:
    """Note the names in `turning` that belong to no attribute that can turn."""
    missing = set(request.settings.turning).difference(layer.attribute.name for layer in layers if layer.turning)
    remarks.add(
        message(
            "{layer}: not rotated, because '{name}' has no vectors, quaternions or matrices of this name.",
            layer=name,
            name=request.source.name,
        )
        for name in sorted(missing)
    )


def _check_uv_maps(layers: list[Layer], target: Object) -> None:
    names = {layer.attribute.name for layer in layers if layer.role is Role.UV_MAP}
    count = len(names.union(target.data.uv_layers.keys()))
    if count > mesh_data.MAX_UV_MAPS:
        raise zo.MeshError(
            "'{target}' would have {count} UV maps, and Blender's limit is {most}: remove some from "
            "it, or from the source.",
            target=target.name,
            count=count,
            most=mesh_data.MAX_UV_MAPS,
        )


def _check_names(layers: list[Layer], target: Object, remarks: Remarks) -> None:
    attributes = target.data.attributes
    for layer in layers:
        name = layer.attribute.name
        if name not in attributes and name in target.vertex_groups:
            raise zo.MeshError(
                "'{name}' is an attribute of the source but a vertex group of '{target}': rename one of them.",
                name=name,
                target=target.name,
            )
        if name in attributes and not mesh_data.fits(attributes[name], layer):
            remarks.notes.append(
                message("{layer}: replaced an attribute of '{name}' of another type.", layer=name, name=target.name)
            )
