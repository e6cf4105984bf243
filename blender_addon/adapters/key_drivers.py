# SPDX-License-Identifier: GPL-3.0-or-later
"""Drivers of shape keys: they read the target's armature instead of the source's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

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


@dataclass(eq=False)
class _Rigs:
    """The armatures of a source and of a target that has its own.

    Attributes:
        bones: the bones of the source's, in world space.
        others: those of the target's.
        read: names of the bones that drivers read.
        pairs: names of the target's bones by those of the source's.
        turned: names of bones that drivers read, and whose partners have other axes at rest.
    """

    bones: RigBones
    others: RigBones
    read: set[str]
    pairs: dict[str, str] = field(default_factory=dict)
    turned: Sequence[str] = ()

    def pair_bones(self, match: Match, source: Surface, target: Surface) -> None:
        """Find the partners of bones along a match of two surfaces at rest, unless all have the same names."""
        bones, others = self.bones, self.others
        self.pairs = {name: name for name in bones.names if name in others.names}
        if not self.read <= self.pairs.keys():
            heads = zo.move_joints(source, shape_of_source(match, source, target), bones.heads).positions
            size = float(np.ptp(target.vertices, axis=0).max())
            of_target = Skeleton(others.names, others.parents, others.heads)
            self.pairs = pair_bones(Skeleton(bones.names, bones.parents, heads), of_target, size)
        whole = procrustes(match.surface_map.interpolate(source.vertices), target.vertices)
        self.turned = _turned_bones(bones, others, self.pairs, sorted(self.read), whole.rotation)


@dataclass
class KeyDrivers:
    """Drivers of transferred keys.

    Attributes:
        owners: the sources with shape keys, each with the names of the keys whose drivers it provides.
        rigs: the armatures of which drivers read bones, by their names, for sources whose armature is another one than
            the target's.
        remarks: collects remarks for the user.
    """

    owners: Sequence[tuple[str, Sequence[str]]]
    rigs: Mapping[tuple[str, str], _Rigs]
    remarks: Remarks

    def pair_bones(self, match: Match, source: Surface, target: Surface) -> None:
        """Find the partners of bones along a match of two surfaces at rest."""
        for rigs in self.rigs.values():
            rigs.pair_bones(match, source, target)

    def write(self, target: Object) -> None:
        """Copy the drivers to a target that has its armature, and let them read that one."""
        sources = [(bpy.context.scene.objects[name], names) for name, names in self.owners]
        keys = target.data.shape_keys
        for source, names in sources:
            mesh_data.write_animation(source.data.shape_keys, keys, names)
        for source, names in sources:
            blocks: dict[Any, Any] = {each.data.shape_keys: keys for each, _ in sources}
            armatures, rigs = _own_armatures(source, target), None
            if armatures is None:
                blocks |= {block: block for each in mesh_data.armatures_of(source) for block in (each, each.data)}
            else:
                here, there = armatures
                blocks |= mesh_data.partner_armatures(here, there)
                rigs = self.rigs.get((here.name, there.name))  # not for a copy of the source's, bound to by now
            pairs = None if rigs is None else rigs.pairs
            partners = Partners(blocks, pairs, {each: target for each, _ in sources})
            result = mesh_data.redirect_drivers(keys, partners, names)
            self.remarks.add(notes_on_drivers(result, target))
            if rigs is not None and rigs.turned:
                self.remarks.add(
                    [
                        warning(
                            "At rest, bones of '{armature}' that drive shape keys have other directions or rolls "
                            "than those of the source ({bones}): check at which angles these keys act.",
                            armature=there.name,
                            bones=", ".join(rigs.turned),
                        )
                    ]
                )


def _own_armatures(source: Object, target: Object) -> tuple[Object, Object] | None:
    """The first armatures of a source and of a target, if none deforms both."""
    of_source, of_target = mesh_data.armatures_of(source), mesh_data.armatures_of(target)
    if not of_source or not of_target or set(of_source) & set(of_target):
        return None
    return of_source[0], of_target[0]


def notes_on_drivers(result: Redirected, obj: Object) -> list[Message]:
    """Sentences on drivers of an object's keys that could not be redirected."""
    notes = []
    if result.removed:
        notes.append(
            warning(
                "Shape keys without their drivers ({keys}): '{object}' and its armature lack what these read "
                "({lacking}).",
                keys=", ".join(result.removed),
                object=obj.name,
                lacking=", ".join(result.lacking),
            )
        )
    if result.outside:
        names = ", ".join(f"'{name}'" for name in result.outside)
        notes.append(message("Drivers of shape keys still read other objects: {names}.", names=names))
    return notes


def read_key_drivers(
    request: TransferRequest, owners: Sequence[tuple[str, Sequence[str]]], remarks: Remarks
) -> KeyDrivers:
    """The drivers of transferred keys, and the bones that they may read instead."""
    found = dict[tuple[str, str], _Rigs]()
    for source in (each.original for each in request.sources):
        names, armatures = dict(owners).get(source.name), _own_armatures(source, request.target)
        if not names or armatures is None:
            continue
        here, there = armatures
        read, key = mesh_data.bones_of_drivers(source.data.shape_keys, names, here), (here.name, there.name)
        if read and key not in found:
            found[key] = _Rigs(mesh_data.read_rig_bones(here), mesh_data.read_rig_bones(there), set())
        if read:
            found[key].read |= read
    return KeyDrivers(owners, found, remarks)


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
