# SPDX-License-Identifier: GPL-3.0-or-later
"""Avatars' bodies with their joints: aligned with those of others, and completed by clothes where they lack skin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.assets.asset import SHAPE_KEYS, Asset, Skin, to_rest
from zoomout_core.assets.skeletons import skeleton_of
from zoomout_core.outfits.parts import AvatarParts, hair_objects, surfaces_of_objects
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.dressing.joint_alignment import JointPairs, align_joints
from zoomout_core.transfer.dressing.missing_skin import DEPTH, ClothedBody, complete_body
from zoomout_core.transfer.rigging.joint_map import RiggedBody
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.transfer.rigging.skinning import renumber_bones


def align_avatars(shape: Floats, source: Asset, target: Asset) -> Floats:
    """(n, 3) the shape of one avatar's body, aligned with the joints of another one, see `align_joints`.

    Args:
        shape: (n, 3) its vertices in the shape of the other body.
        source: the body of the first avatar.
        target: that of the other one.
    """
    first, second = rigged_body(source), rigged_body(target)
    if first is None or second is None:
        return shape
    return align_joints(source.surface, shape, target.surface, JointPairs.of(first.bones, first.weights, second.bones))


def rigged_body(body: Asset) -> RiggedBody | None:
    """A body with the joints that move something; None without a skin."""
    if body.skin is None or body.document is None:
        return None
    joints = np.flatnonzero(moving_joints(body.skin))
    weights = csr_array(body.skin.weights[:, joints])
    return RiggedBody(body.surface, skeleton_of(body, joints, heads_of(body)), weights)


def complete_avatar(parts: AvatarParts, depth: float = DEPTH) -> tuple[Asset, ClothedBody | None]:
    """Complete the body of a dressed avatar by the clothes that have no skin below them, see `complete_body`.

    Args:
        parts: the avatar.
        depth: depth below the clothes, see `complete_body`.

    Returns:
        The completed body, also as one with bones; the given body, and None, if its skin is complete.
    """
    body, worn = parts
    if worn is None or worn.skin is None or body.skin is None or body.document is None:
        return body, None
    joints = np.flatnonzero(moving_joints(body.skin) | moving_joints(worn.skin))
    rigged = RiggedBody(
        body.surface, skeleton_of(body, joints, heads_of(body)), csr_array(body.skin.weights[:, joints])
    )
    surfaces, ends = surfaces_of_objects(worn), np.cumsum([0, *(count for _, count in worn.objects)]).tolist()
    chosen = [number for number, hair in enumerate(hair_objects(worn)) if not hair]
    weights = csr_array(worn.skin.weights[:, joints])
    clothed = complete_body(
        rigged,
        [surfaces[number] for number in chosen],
        [weights[ends[number] : ends[number + 1]] for number in chosen],
        depth,
    )
    if clothed is None:
        return body, None
    weights = renumber_bones(clothed.body.weights, joints, len(body.skin.names))
    surface = clothed.body.surface
    rest, linear = to_rest(surface.vertices, weights, body.skin.transforms)
    skin = replace(body.skin, rest=rest, linear=linear, weights=weights)
    return replace(body, surface=surface, attributes=_with_keys(body, len(surface.vertices)), skin=skin), clothed


def _with_keys(body: Asset, count: int) -> tuple[Attribute, ...]:
    """The shape keys of a body with a number of vertices, which do not move those added to the body."""
    keys = body.find(SHAPE_KEYS)
    if keys is None:
        return ()
    values = np.zeros((count, *keys.values.shape[1:]))
    values[: len(keys.values)] = keys.values
    return (replace(keys, values=values),)


def moving_joints(skin: Skin) -> Booleans:
    """(b,) the joints that move something, directly or through joints below them."""
    moving = np.isin(np.arange(len(skin.names)), skin.weights.indices[skin.weights.data > 0])
    for joint in reversed(parents_first(skin.parents)):
        if skin.parents[joint] >= 0:
            moving[skin.parents[joint]] |= moving[joint]
    return moving


def heads_of(asset: Asset) -> Floats:
    """(b, 3) places of an asset's joints."""
    assert asset.skin is not None
    assert asset.document is not None
    return asset.document.worlds()[0][asset.skin.nodes, :3, 3]
