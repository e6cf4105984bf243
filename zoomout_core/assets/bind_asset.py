# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind an asset to the joints of another one."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.assets.asset import WEIGHTS, Asset, Skin, to_rest
from zoomout_core.assets.check_rig import check_rig
from zoomout_core.assets.gltf.move_skin import move_skin
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.motion import MotionCheck, note_on_motions
from zoomout_core.transfer.rigging.rest_pose import PosedTarget, align
from zoomout_core.transfer.rigging.rig import note_on_idle_joints
from zoomout_core.transfer.rigging.skinning import skinning_matrices
from zoomout_core.transfer.rigging.unpose import Rest, unpose
from zoomout_core.transfer.rules import transfer_along


class Binding(NamedTuple):
    """How a target is bound to the joints of its source; see the arguments of `transfer_asset`."""

    shape: str
    max_weights: int | None
    move_rig: bool


def bind_to_joints(
    asset: Asset, source: Asset, skin: Skin, mapped: MappedTarget, posed: PosedTarget | None, binding: Binding
) -> tuple[Asset, tuple[MotionCheck, ...], list[str]]:
    """Bind an asset to the joints of its source, and move these into it if requested.

    Returns:
        The asset with its skin, how each animation differs from the source's if joints were moved, and notes.
    """
    own, at_rest, notes = _bind(skin, mapped, posed, binding.shape, binding.max_weights)
    document = source.document
    if binding.move_rig:
        own, document = move_skin(source, own, at_rest)
    look = document if asset.look is source.document else asset.look
    asset = replace(asset, skin=own, document=document, nodes=(), look=look)
    if not binding.move_rig:
        return asset, (), notes
    motions = check_rig(source, asset, at_rest.surface_map)
    idle = note_on_idle_joints(skin.names, skin.weights, own.weights)
    return asset, motions, [*notes, *idle, *note_on_motions(motions)]


def _bind(
    skin: Skin, mapped: MappedTarget, posed: PosedTarget | None, shape: str, limit: int | None
) -> tuple[Skin, MappedTarget, list[str]]:
    """The skin of the target, with its rest pose, the target over the source at rest, and notes.

    The pose of the target is None if it is that of the source.
    """
    target, at_rest, notes = mapped.target, mapped, list[str]()
    if posed is None:
        weights = skin_weights(skin, mapped, limit)
        rest = Rest(*to_rest(target.vertices, weights, skin.transforms), 0)
    else:
        at_rest, weights, pose = posed.mapped, skin_weights(skin, posed.mapped, limit), posed.pose
        if shape == "keep shape" or (shape == "automatic" and pose.is_rest):
            rest = align(target, pose)
        else:
            matrices = skinning_matrices(pose.transforms, weights)
            rest = unpose(target, matrices, pose.scale, posed.mapped.confidence)
            notes.append(
                f"The target was in a different pose, with its joints rotated by {pose.bend:.0f}° on average, and "
                "was moved to the rest pose. If it was at rest, transfer again with --shape keep-shape."
            )
    return replace(skin, rest=rest.positions, linear=rest.linear, weights=weights), at_rest, notes


def skin_weights(skin: Skin, mapped: MappedTarget, limit: int | None = None) -> csr_array:
    """(n_t, b) weights that sum to one; a vertex without any takes those of the nearest vertex with some.

    At most `limit` joints have weights at a vertex, see `mix_weights`.
    """
    attribute = Attribute(WEIGHTS, Domain.POINT, Kind.WEIGHT, skin.weights, skin.names)
    weights = csr_array(transfer_along(attribute, mapped, limit=limit).values)
    without = np.diff(weights.indptr) == 0
    if without.any():
        places = mapped.target.vertices
        nearest = cKDTree(places[~without]).query(places)[1]
        weights = csr_array(weights[np.where(without, np.flatnonzero(~without)[nearest], np.arange(len(places)))])
    return normalise(weights)
