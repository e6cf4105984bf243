# SPDX-License-Identifier: GPL-3.0-or-later
"""Drivers of shape keys: they read the target's armature instead of the source's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import SMALLEST, procrustes
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import Message, message, warning
from zoomout_core.transfer import Skeleton, pair_bones, shape_of_source

from .. import mesh_data
from ..mesh_data import Partners, Redirected, RigBones
from ..storage.stored_match import Match
from .adapter import Remarks, TransferRequest

# Degrees: bones that differ by more at rest visibly act at another angle. Bones of two builds differ by less.
TURNED = 20.0


@dataclass(frozen=True, eq=False)
class _Rigs:
    """The armatures of a source and of a target that has its own.

    Attributes:
        target: name of the target's.
        bones: the bones of the source's, in world space.
        others: those of the target's.
        read: names of the bones that drivers read.
    """

    target: str
    bones: RigBones
    others: RigBones
    read: frozenset[str]


@dataclass
class KeyDrivers:
    """Drivers of transferred keys.

    Attributes:
        owners: the sources with shape keys, each with the names of the keys whose drivers it provides.
        rigs: the armatures, if drivers read bones that have partners in another one.
        remarks: collects remarks for the user.
        bones: names of the target's bones by those of the source's, once they are paired.
        turned: names of bones that drivers read, and whose partners have other axes at rest.
    """

    owners: Sequence[tuple[str, Sequence[str]]]
    rigs: _Rigs | None
    remarks: Remarks
    bones: dict[str, str] | None = None
    turned: Sequence[str] = ()

    def pair_bones(self, match: Match, source: Surface, target: Surface) -> None:
        """Find the partners of bones along a match of two surfaces at rest, unless all have the same names."""
        if self.rigs is None:
            return
        bones, others = self.rigs.bones, self.rigs.others
        self.bones = {name: name for name in bones.names if name in others.names}
        if not self.rigs.read <= self.bones.keys():
            heads = zo.move_joints(source, shape_of_source(match, source, target), bones.heads).positions
            size = float(np.ptp(target.vertices, axis=0).max())
            of_target = Skeleton(others.names, others.parents, others.heads)
            self.bones = pair_bones(Skeleton(bones.names, bones.parents, heads), of_target, size)
        whole = procrustes(match.surface_map.interpolate(source.vertices), target.vertices)
        self.turned = _turned_bones(bones, others, self.bones, sorted(self.rigs.read), whole.rotation)

    def write(self, target: Object) -> None:
        """Copy the drivers to a target that has its armature, and let them read that one."""
        sources = [(bpy.context.scene.objects[name], names) for name, names in self.owners]
        keys = target.data.shape_keys
        for source, names in sources:
            mesh_data.write_animation(source.data.shape_keys, keys, names)
        for source, names in sources:
            blocks = {each.data.shape_keys: keys for each, _ in sources}
            armature, armatures = self._armatures(source, target)
            paired = self.rigs is not None and armature == self.rigs.target
            partners = Partners(
                blocks | armatures, self.bones if paired else None, {each: target for each, _ in sources}
            )
            result = mesh_data.redirect_drivers(keys, partners, names)
            self.remarks.add(notes_on_drivers(result, target))
            if paired and self.turned:
                self.remarks.add(
                    [
                        warning(
                            "At rest, bones of '{armature}' that drive shape keys point or roll otherwise than those "
                            "of the source ({bones}): check at which angles these keys act.",
                            armature=armature,
                            bones=", ".join(self.turned),
                        )
                    ]
                )

    def _armatures(self, source: Object, target: Object) -> tuple[str, dict[object, object]]:
        """The name of the armature that drivers read now, and the armatures by those that they read before."""
        of_source, of_target = mesh_data.armatures_of(source), mesh_data.armatures_of(target)
        found = {block: block for each in of_source for block in (each, each.data)}
        if not of_source or not of_target or set(of_source) & set(of_target):
            return "", found
        return of_target[0].name, found | mesh_data.partner_armatures(of_source[0], of_target[0])


def notes_on_drivers(result: Redirected, obj: Object) -> Iterator[Message]:
    """Sentences on drivers of an object's keys that could not be redirected."""
    if result.removed:
        yield warning(
            "Shape keys without their drivers ({keys}): '{object}' and its armature lack what these read ({lacking}).",
            keys=", ".join(result.removed),
            object=obj.name,
            lacking=", ".join(result.lacking),
        )
    if result.outside:
        yield message(
            "Drivers of shape keys still read other objects: {names}.",
            names=", ".join(f"'{name}'" for name in result.outside),
        )


def read_key_drivers(
    request: TransferRequest, owners: Sequence[tuple[str, Sequence[str]]], remarks: Remarks
) -> KeyDrivers:
    """The drivers of transferred keys, and the bones that they may read instead."""
    of_target = mesh_data.armatures_of(request.target)
    for source in (each.original for each in request.sources):
        of_source = mesh_data.armatures_of(source)
        names = dict(owners).get(source.name)
        if not of_target or not of_source or not names or set(of_target) & set(of_source):
            continue
        read = mesh_data.bones_of_drivers(source.data.shape_keys, names, of_source[0])
        if read:
            bones, others = mesh_data.read_rig_bones(of_source[0]), mesh_data.read_rig_bones(of_target[0])
            return KeyDrivers(owners, _Rigs(of_target[0].name, bones, others, frozenset(read)), remarks)
    return KeyDrivers(owners, None, remarks)


def _turned_bones(
    bones: RigBones, others: RigBones, pairs: Mapping[str, str], names: Sequence[str], rotation: Floats
) -> list[str]:
    """The bones, of some names, whose partners have other axes at rest, given the rotation (3, 3) of the body."""
    axes, axes_of_others = _axes(bones), _axes(others)
    turned = []
    for name in (name for name in names if name in pairs):
        before, after = axes[bones.names.index(name)], axes_of_others[others.names.index(pairs[name])]
        cosine = (np.trace(after.T @ rotation @ before) - 1) / 2
        if cosine < np.cos(np.radians(TURNED)):
            turned.append(name)
    return turned


def _axes(bones: RigBones) -> Floats:
    """(b, 3, 3) the axes of bones as columns."""
    along, upright = (
        each / np.maximum(np.linalg.norm(each, axis=1, keepdims=True), SMALLEST)
        for each in (bones.tails - bones.heads, bones.upright)
    )
    return np.stack([np.cross(along, upright), along, upright], axis=2)
