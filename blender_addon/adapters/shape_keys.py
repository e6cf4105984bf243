# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys, and the source's own shape as one."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np
from bpy.types import Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import Attribute
from zoomout_core.transfer.rigging.unpose import Rest

from .. import mesh_data
from ..mesh_data import ShapeKey, ShapeKeys
from .adapter import Adapter, Remarks, TransferJob, TransferRequest
from .key_drivers import KeyDrivers, read_key_drivers


@dataclass
class ShapeKeyAdapter:
    """Shape keys.

    Keys move a mesh before it is posed, so they are transferred between both rest shapes, along the match as posed.

    Attributes:
        drivers: the drivers of the keys.
        keys: the keys and their settings.
        offsets: displacement of each vertex, in world space.
        source_rest: (n_s, 3) positions at rest, in world space.
        target_rest: (n_t, 3) positions of the target at rest, in world space.
        present: displacements of the target's own keys of these names, like `offsets`; zero for keys that it lacks.
    """

    drivers: KeyDrivers
    keys: Sequence[ShapeKey]
    offsets: Attribute
    source_rest: Floats
    target_rest: Floats
    present: Attribute
    kind: str = "shape_keys"

    @property
    def names(self) -> list[str]:
        return [key.name for key in self.keys]

    def transfer(self, job: TransferJob) -> None:
        source = job.pair.source.with_vertices(self.source_rest)
        target = job.pair.target.with_vertices(self.target_rest)
        self.drivers.pair_bones(job.match, source, target)
        transferred = job.transfer(self.offsets, message("shape keys"), source, target)
        self.offsets = job.blend_values(transferred, self.present)

    def transfer_to_rest(self, job: TransferJob, rest: Rest) -> None:
        """Transfer to a target that is moved to rest, in place of its present pose.

        Offsets that are first rotated into that pose, and back by the inverse of skinning, are off where bones bend.
        """
        off = self.target_rest - job.pair.target.vertices  # where keys of its own displace it
        self.target_rest = rest.positions + np.einsum("nxy,ny->nx", rest.linear, off)
        self.present = replace(self.present, values=np.einsum("nxy,nky->nkx", rest.linear, self.present.values))
        self.transfer(job)

    def turn(self, linear: Floats) -> None:
        """Turn and scale the transferred keys by a matrix (3, 3)."""
        self.offsets = replace(self.offsets, values=self.offsets.values @ linear.T)

    def write(self, target: Object) -> None:
        mesh_data.write_shape_keys(target, self.keys, mesh_data.to_object(target, self.offsets.values))
        self.drivers.write(target)


@dataclass
class ShapeAdapter:
    """The source's evaluated shape, on the vertices of the target.

    It is placed at the target: the origins of both objects coincide.

    Attributes:
        name: name of the key.
        origin: (3,) the source's origin, in world space.
        shape: (n_t, 3) positions in world space, relative to the origin; empty before the transfer.
    """

    name: str
    origin: Floats
    shape: Floats = field(default_factory=lambda: np.empty((0, 3)))
    kind: str = "shape"

    @property
    def names(self) -> list[str]:
        return [self.name]

    def transfer(self, job: TransferJob) -> None:
        with stage("Transferring the shape"):
            positions = zo.conform(job.match, job.pair.source, job.pair.target)
        self.shape = positions - self.origin

    def write(self, target: Object) -> None:
        mesh_data.write_shape(target, self.name, mesh_data.to_object(target, self.shape))


def collect(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    """The source's shape keys and its shape, as far as they are requested.

    Raises:
        MeshError: the target cannot have such shape keys.
    """
    found: list[Adapter] = []
    if "shape_keys" in request.data:
        found += _collect_keys(request, remarks)
    if "shape" in request.data:
        check_takes_keys(request.target, [request.source.name])
        if any(modifier.show_viewport for modifier in request.target.modifiers):
            remarks.notes.append(
                message(
                    "The key '{source}' stores the visible shape of the source, and the modifiers of "
                    "'{target}' deform it further.",
                    source=request.source.name,
                    target=request.target.name,
                )
            )
        found.append(ShapeAdapter(request.source.name, mesh_data.origin(request.source)))
    return found


def _collect_keys(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    target = request.target
    if all(_absent(source.original) for source in request.sources):
        return []
    bare = [_without_keys(source) for source in request.sources]  # before copies are evaluated, see `COLLECTORS`
    faces = [mesh_data.read_faces(source.mesh) for source in request.sources]
    originals = [one.original for one in request.sources]
    locked = _locked_keys(target)
    found = [
        None if (keys := _keys_of(source, each, remarks)) is None else _without_locked(keys, locked, remarks)
        for source, each in zip(originals, faces, strict=True)
    ]
    joined, own = mesh_data.join_shape_keys([keys or none for keys, none in zip(found, bare, strict=True)])
    if not joined.keys:
        return []
    check_takes_keys(target, joined.offsets.labels)
    _note_masks(joined.keys, request, remarks)
    owners = [(source.name, names) for source, names in zip(originals, own, strict=True) if names]
    for name, _ in owners:
        _note_animation(bpy.context.scene.objects[name], target, remarks)
    target_rest = mesh_data.positions_in_world(target, mesh_data.read_rest_positions(target.data))
    present = _present_offsets(target, joined.offsets.labels)
    drivers = read_key_drivers(request, owners, remarks)
    return [ShapeKeyAdapter(drivers, joined.keys, joined.offsets, joined.rest, target_rest, present)]


def _present_offsets(target: Object, names: Sequence[str]) -> Attribute:
    """Displacements of an object's vertices by keys of these names, in world space; zero for keys that it lacks."""
    values = np.zeros((len(target.data.vertices), len(names), 3))
    if not _absent(target):
        own = mesh_data.read_own_shape_keys(target.data).offsets
        for column, name in enumerate(names):
            if name in own.labels:
                values[:, column] = own.values[:, own.labels.index(name)]
    return mesh_data.offsets_of(tuple(names), mesh_data.directions_in_world(target, values))


def _absent(source: Object) -> bool:
    present = source.data.shape_keys
    return present is None or len(present.key_blocks) < 2


def _locked_keys(target: Object) -> set[str]:
    keys = target.data.shape_keys
    return set() if keys is None else {key.name for key in keys.key_blocks if key.lock_shape}


def _without_locked(found: ShapeKeys, locked: Collection[str], remarks: Remarks) -> ShapeKeys:
    """The keys that are not locked on the target; the others are skipped."""
    kept = [column for column, key in enumerate(found.keys) if key.name not in locked]
    names = {key.name for key in found.keys}
    remarks.skipped |= dict.fromkeys(sorted(names.intersection(locked)), message("the target's shape key is locked"))
    keys = tuple(found.keys[column] for column in kept)
    return replace(
        found, keys=keys, offsets=mesh_data.offsets_of(tuple(key.name for key in keys), found.offsets.values[:, kept])
    )


def _without_keys(source: mesh_data.EvaluatedObject) -> ShapeKeys:
    """An object at rest, in world space, without its keys."""
    own = source.original.data
    has_other_faces = mesh_data.read_faces(source.mesh) != mesh_data.read_faces(own)
    rest = mesh_data.read_positions(source.mesh) if has_other_faces else mesh_data.read_rest_positions(own)
    rest = mesh_data.positions_in_world(source.original, rest)
    return ShapeKeys((), mesh_data.offsets_of((), np.empty((len(rest), 0, 3))), rest)


def _keys_of(source: Object, faces: mesh_data.Faces, remarks: Remarks) -> ShapeKeys | None:
    """The keys of an object, in world space; None if none can be transferred."""
    if _absent(source):
        return None
    if not source.data.shape_keys.use_relative:
        remarks.skipped[message("shape keys")] = message(
            "those of '{source}' are absolute: turn on Relative in its shape keys", source=source.name
        )
        return None
    found = mesh_data.read_shape_keys(source, faces)
    if found is None:
        remarks.skipped[message("shape keys")] = message(
            "modifiers of '{source}' change its faces when a single key is active: disable those "
            "that add or remove vertices",
            source=source.name,
        )
        return None
    offsets = replace(found.offsets, values=mesh_data.directions_in_world(source, found.offsets.values))
    return ShapeKeys(found.keys, offsets, mesh_data.positions_in_world(source, found.rest))


def check_takes_keys(target: Object, names: Sequence[str]) -> None:
    """Raise a MeshError if an object cannot have shape keys of some names."""
    if mesh_data.is_flat(target):
        raise zo.MeshError(
            "'{target}' has a scale of zero and cannot have shape keys: change its scale.", target=target.name
        )
    keys = target.data.shape_keys
    if keys is None:
        return
    if not keys.use_relative:
        raise zo.MeshError(
            "The shape keys of '{name}' are absolute: turn on Relative in its shape keys.", name=target.name
        )
    if keys.reference_key.name in names:
        raise zo.MeshError(
            "'{key}' is the Basis shape key of '{target}': rename the source's key or this one.",
            key=keys.reference_key.name,
            target=target.name,
        )


def _note_masks(keys: Sequence[ShapeKey], request: TransferRequest, remarks: Remarks) -> None:
    masks = {key.settings["vertex_group"] for key in keys} - {"", *request.target.vertex_groups.keys()}
    if "vertex_groups" in request.data:
        masks -= {group.name for source in request.sources for group in source.original.vertex_groups}
    if masks:
        remarks.notes.append(
            message(
                "Shape keys use vertex groups that '{target}' lacks ({groups}): transfer these as well.",
                target=request.target.name,
                groups=", ".join(sorted(masks)),
            )
        )


def _note_animation(source: Object, target: Object, remarks: Remarks) -> None:
    played = source.data.shape_keys.animation_data
    own = target.data.shape_keys and target.data.shape_keys.animation_data
    if played is None:
        return
    if played.action and own and own.action:
        remarks.add([message("The shape keys of '{target}' keep their current action.", target=target.name)])
    if played.nla_tracks:
        remarks.skipped[message("NLA tracks of shape keys")] = (
            "they are not transferred, unlike the keys' drivers and action"
        )
