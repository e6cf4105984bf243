# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress an avatar in the outfit of another one: fitted, bound to its joints, and with keys that follow the body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import NORMALS, SHAPE_KEYS, Asset
from zoomout_core.assets.gltf.append import NewJoint
from zoomout_core.assets.gltf.springs import Partner
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.messages import Message, message, warning
from zoomout_core.outfits.parts import hair_objects, mask_of, surfaces_of_objects
from zoomout_core.outfits.rigged_avatar import align_avatars, rigged_body
from zoomout_core.outfits.skeleton import Fit, bind_clothes, move_skinned
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.dressing.body_keys import follow_keys
from zoomout_core.transfer.dressing.dress import clear_in_poses, fit_to_shape
from zoomout_core.transfer.dressing.fitted_object import Manner
from zoomout_core.transfer.dressing.layers import Dressed
from zoomout_core.transfer.dressing.missing_skin import PLACED_BY_BONES, PLACED_BY_SHAPE, ClothedBody, place_by_bones
from zoomout_core.transfer.dressing.posed_contact import PosedBody
from zoomout_core.transfer.rigging.poses import extend_poses, gentle_poses
from zoomout_core.transfer.rigging.skinning import renumber_bones

# Fractions of the progress at the end of the fit, and of its correction in poses. Then body keys are added.
FITTED, CLEARED = 0.3, 0.5
# The axis that points up.
UP = 1


@dataclass(frozen=True, eq=False)
class DressedAvatar:
    """Clothes on an avatar.

    Attributes:
        clothes: the clothes with their positions, keys and skin on the avatar. The nodes of the skin are those of the
            avatar's document, followed by the new joints.
        joints: the outfit's own joints, for the avatar's document.
        partners: the avatar's node for each other node of the outfit.
        notes: sentences for the user.
        missing_skin: how clothes were placed that have no skin below them; None if there are none.
    """

    clothes: Asset
    joints: tuple[NewJoint, ...]
    partners: Mapping[int, Partner]
    notes: tuple[str, ...]
    missing_skin: Message | None = None


def dress_avatar(
    shape: Floats,
    source: Asset,
    worn: Asset,
    target: Asset,
    *,
    clothed: ClothedBody | None = None,
    keep: Sequence[str] = (),
    stiffness: float = 0.5,
    gap: float = 0.0,
) -> DressedAvatar:
    """Dress an avatar in the outfit of another one.

    Args:
        shape: (n, 3) the vertices of the body that wears it in the shape of the body to dress, see `shape_of_source`.
        source: the body that wears it.
        worn: the outfit, of the same file.
        target: the body to dress, of another file.
        clothed: the source as a body whose missing skin is replaced by cloth; None if its skin is complete.
        keep: patterns of the names of its meshes or materials that keep their form, such as `Buckle*`.
        stiffness: stiffness of soft objects, see `dress`.
        gap: minimum distance from the skin, see `dress`.
    """
    objects = surfaces_of_objects(worn)
    masks = np.split(mask_of(worn, keep), np.cumsum([len(each.vertices) for each in objects])[:-1])
    manners: list[Manner] = ["hair" if is_hair else "automatic" for is_hair in hair_objects(worn)]
    unknown = [pattern for pattern in keep if not mask_of(worn, [pattern]).any()]
    with portion(0, FITTED):
        shape = align_avatars(shape, source, target)
        placed, missing = shape, None
        if clothed is not None:
            other = rigged_body(target)
            by_bones = None if other is None else place_by_bones(clothed, shape, other)
            if by_bones is not None:
                placed, shape = by_bones
            missing = message(PLACED_BY_SHAPE if by_bones is None else PLACED_BY_BONES, share=clothed.share)
        dressed = fit_to_shape(
            source.surface,
            placed,
            target.surface,
            objects,
            manners=manners,
            keep=masks,
            stiffness=stiffness,
            gap=gap,
        )
    bound = bind_clothes(_place(worn, dressed), Fit(source, shape, objects, dressed.vertices, masks), target)
    with portion(FITTED, CLEARED):
        dressed = _clear_in_poses(dressed, bound.clothes, target)
    clothes = move_skinned(_place(worn, dressed), bound.clothes.skin)
    with portion(CLEARED, 1):
        clothes = _add_body_keys(clothes, target, objects, dressed, masks)
    notes = [
        warning("No mesh or material of the outfit is called like '{pattern}': nothing there was kept.", pattern=each)
        for each in unknown
    ]
    return DressedAvatar(clothes, bound.joints, bound.partners, (*notes, *dressed.notes, *bound.notes), missing)


def _turn(asset: Asset, turns: Floats) -> Asset:
    """Rotate the shape keys and normals of an asset by matrices (n, 3, 3) of its vertices."""
    attributes = []
    for each in asset.attributes:
        values = np.asarray(each.values)
        if each.name == SHAPE_KEYS:
            each = replace(each, values=np.einsum("nxy,nky->nkx", turns, values))
        elif each.name == NORMALS:
            each = replace(
                each, values=unit_vectors(np.einsum("cxy,cy->cx", turns[asset.surface.corner_vertex], values))
            )
        attributes.append(each)
    return replace(asset, attributes=tuple(attributes))


def _place(worn: Asset, dressed: Dressed) -> Asset:
    """The worn object at its fitted position."""
    moved = replace(worn, surface=worn.surface.with_vertices(np.concatenate(dressed.vertices)))
    return _turn(moved, np.concatenate(dressed.turns))


def _clear_in_poses(dressed: Dressed, clothes: Asset, target: Asset) -> Dressed:
    """Keep objects outside a body in poses of its joints, by their skin; without a skin, they are unchanged."""
    if clothes.skin is None or target.skin is None or target.document is None:
        return dressed
    heads = target.document.worlds()[0][target.skin.nodes, :3, 3]
    poses = extend_poses(gentle_poses(heads, target.skin.parents, UP), clothes.skin.parents)
    count = len(target.skin.names)
    of_body = renumber_bones(target.skin.weights, np.arange(count), len(clothes.skin.names))
    ends = np.cumsum([0, *(len(vertices) for vertices in dressed.vertices)])
    weights = [normalise(csr_array(clothes.skin.weights[start:stop])) for start, stop in pairwise(ends)]
    body = PosedBody(normalise(of_body), poses)
    return clear_in_poses(dressed, body, weights)


def _add_body_keys(
    clothes: Asset, target: Asset, objects: list[Surface], dressed: Dressed, masks: Sequence[Floats]
) -> Asset:
    """Add a key for each key of the body that moves the clothes. It replaces one of the same name."""
    of_body, own = target.find(SHAPE_KEYS), clothes.find(SHAPE_KEYS)
    if of_body is None:
        return clothes
    fitted = [each.with_vertices(points) for each, points in zip(objects, dressed.vertices, strict=True)]
    followed = np.concatenate(follow_keys(target.surface, of_body.values, fitted, keep=masks))
    moving = np.flatnonzero(followed.any(axis=(0, 2)))
    values = {of_body.labels[key]: followed[:, key] for key in moving}
    if own is not None:
        values = {name: own.values[:, key] for key, name in enumerate(own.labels)} | values
    others = tuple(each for each in clothes.attributes if each is not own)
    if not values:
        return replace(clothes, attributes=others)
    stacked = np.stack(list(values.values()), axis=1)
    keys = Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, stacked, tuple(values))
    return replace(clothes, attributes=(*others, keys))
