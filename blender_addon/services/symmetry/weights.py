# SPDX-License-Identifier: GPL-3.0-or-later
"""Make vertex weights symmetric."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Context, Object
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.symmetry.flip_name import partner_of
from zoomout_core.symmetry.mirror import Direction, symmetrise, with_partners
from zoomout_core.transfer import Attribute
from zoomout_core.transfer.rigging.weights import sum_to_one

from ... import mesh_data
from ...jobs import compute, pause, run
from ...scene.pair import name_of
from ...storage import stored_symmetry
from .mesh_access import READ, READING, own_mesh, writable_mesh, writing


def symmetrise_weights(context: Context, obj: Object, direction: Direction = "left_to_right", only: str = "") -> str:
    """Make an object's vertex groups symmetric, or exchange their sides, along its mesh's symmetry.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        direction: see `zoomout_core.symmetry.mirror.symmetrise`.
        only: the name of a group, to change only this and its partner; "" for all.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or there are no such groups; nothing was written.
    """
    return run(symmetrise_weights_async(context, name_of(obj), direction, only))


async def symmetrise_weights_async(context: Context, name: str, direction: Direction, only: str = "") -> str:
    """`symmetrise_weights` as a coroutine, which keeps no Blender data across an `await`."""
    obj = writable_mesh(context, name)
    symmetry = stored_symmetry.read(obj)
    with stage(READING, 0, READ):
        await pause()
        weights = await mesh_data.read_weights_in_pieces(partial(own_mesh, context, name, symmetry.surface))
    with own_mesh(context, name, symmetry.surface) as (obj, _):
        chosen = _choose(obj, with_partners(weights, mesh_data.deforming_bones(obj)), only)
    with stage("Mirroring weights", READ, 1):
        weights = await compute(partial(symmetrise, chosen.weights, symmetry, direction, **chosen.sharing))
    with writing(context, name, symmetry.surface) as obj:
        mesh_data.update_weights(obj, chosen.weights, weights)
        obj.data.update()
    return _summary(name, chosen, direction)


@dataclass(frozen=True, eq=False)
class _Chosen:
    """The groups to make symmetric, and their constraints.

    Attributes:
        weights: weights of these groups and their partners.
        sharing: how they share a vertex among them and with others, see `zoomout_core.transfer.rigging.weights`.
        locked: names of groups that are left out because they, or their partners, are locked.
    """

    weights: Attribute
    sharing: dict[str, Any]
    locked: list[str]


def _choose(obj: Object, weights: Attribute, only: str) -> _Chosen:
    if not weights.labels:
        raise zo.MeshError("'{name}' has no vertex groups: add some, or make another mesh active.", name=obj.name)
    wanted = {only, partner_of(only, weights.labels)} if only else set(weights.labels)
    if only and only not in weights.labels:
        raise zo.MeshError("'{name}' has no vertex group '{group}': choose another one.", name=obj.name, group=only)
    locked_groups = mesh_data.locked_groups(obj)
    locked = [
        label
        for label in weights.labels
        if label in wanted and {label, partner_of(label, weights.labels)} & locked_groups
    ]
    columns = [i for i, label in enumerate(weights.labels) if label in wanted and label not in locked]
    if not columns:
        raise zo.MeshError(
            "All the vertex groups to change on '{name}' are locked: unlock at least one.", name=obj.name
        )
    values, deforming = csr_array(weights.values), _deforming(obj, weights)
    labels = tuple(weights.labels[i] for i in columns)
    shared = [i for i, label in enumerate(weights.labels) if label in deforming]
    others = [i for i in shared if i not in columns]
    sharing = {
        "normalised": np.array([label in deforming for label in labels]),
        "sums": values[:, shared].sum(axis=1),
        "room": np.clip(1 - values[:, others].sum(axis=1), 0, 1) if others else np.inf,
    }
    return _Chosen(replace(weights, values=csr_array(values[:, columns]), labels=labels), sharing, locked)


def _summary(name: str, chosen: _Chosen, direction: Direction) -> str:
    """The result for an object's groups, in a sentence."""
    labels = chosen.weights.labels
    groups = message("{count} vertex groups of '{name}'", count=len(labels), name=name)
    done = message("Exchanged the sides of {what}" if direction == "exchange" else "Made {what} symmetric", what=groups)
    if all(partner_of(label, labels) == label for label in labels):
        done = message("{done}; no name has a side, so each group was made symmetric", done=done)
    if chosen.locked:
        done = message("{done}; locked groups were not changed ({groups})", done=done, groups=", ".join(chosen.locked))
    return done


def _deforming(obj: Object, weights: Attribute) -> set[str]:
    """The groups that share a vertex among them: those of bones, or all of a skin without bones."""
    bones = mesh_data.deforming_bones(obj)
    bones |= {partner_of(bone, bones) for bone in bones}
    if bones.intersection(weights.labels):
        return bones
    return set(weights.labels) if sum_to_one(weights.values) else set()
