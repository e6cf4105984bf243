# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind clothes of one avatar to the joints of another one.

Joints that move only clothes, such as those of skirts, ribbons and hair, are added to the other avatar. All others, and
humanoid bones of both avatars, are replaced by their partners: those of the same humanoid bone, name or place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array, vstack

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import Asset, Skin, to_rest
from zoomout_core.assets.gltf.append import NewJoint
from zoomout_core.assets.gltf.springs import Partner
from zoomout_core.assets.skeletons import skeleton_of
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import Similarities, nearest_rotations
from zoomout_core.maps.surface_map import interpolation_matrix
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.formats.gltf_document import free_name
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import plural, plural_warning
from zoomout_core.outfits.rigged_avatar import heads_of, moving_joints
from zoomout_core.transfer.dressing.body_weights import WeightedBody, follow_weights
from zoomout_core.transfer.rigging.bone_pairs import pair_bones, same_humanoid
from zoomout_core.transfer.rigging.joints import motions_around, move_joints
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.transfer.rigging.skinning import matrices_of, renumber_bones


@dataclass(frozen=True, eq=False)
class BoundClothes:
    """Clothes with the skin of another avatar.

    Attributes:
        clothes: the clothes.
        joints: the outfit's own joints, to be added to the avatar's document.
        partners: the avatar's node for each other node of the outfit, that of the nearest joint at or above it.
        notes: sentences for the user.
    """

    clothes: Asset
    joints: tuple[NewJoint, ...] = ()
    partners: Mapping[int, Partner] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Fit:
    """The fit of clothes, and of the body below them, to another body.

    Attributes:
        body: the body that wore them.
        shape: (n, 3) its vertices in the shape of the other body.
        objects: the worn objects, in the order of the clothes' vertices.
        fitted: for each of these (n, 3) its vertices on the other body.
        keep: for each of these (n,) weights of the vertices that keep their form.
    """

    body: Asset
    shape: Floats
    objects: Sequence[Surface]
    fitted: Sequence[Floats]
    keep: Sequence[Floats]


def bind_clothes(clothes: Asset, fit: Fit, target: Asset) -> BoundClothes:
    """Bind clothes to the joints of another avatar.

    Args:
        clothes: the fitted clothes, with their original skin.
        fit: their fit.
        target: the body of the avatar.
    """
    if target.skin is None or target.document is None:
        return BoundClothes(replace(clothes, skin=None))
    if clothes.skin is None or clothes.document is None or fit.body.skin is None:
        return BoundClothes(replace(clothes, skin=_skin_of_body(clothes.surface, target.surface, target.skin)))
    humanoid, other_humanoid = _humanoid_joints(clothes, target)
    # Avatars often lack the skin below their clothes: joints of legs may move only the trousers.
    own = moving_joints(clothes.skin) & ~moving_joints(fit.body.skin) & ~humanoid
    pairs = _pair_joints(clothes, own, fit, target, moving_joints(target.skin) | other_humanoid)
    joints, numbers, anchors = _copy_joints(clothes, own, fit, target, pairs)
    notes = []
    if joints:
        notes.append(
            plural(
                len(joints),
                "1 joint of the outfit was added to the avatar.",
                "{count} joints of the outfit were added to the avatar.",
            )
        )
    used = np.unique(clothes.skin.weights.indices)
    lost = [clothes.skin.names[joint] for joint in used.tolist() if not own[joint] and joint not in pairs]
    if lost:
        notes.append(
            plural_warning(
                len(lost),
                "A joint that moves the outfit, {joint}, has no partner in the avatar: its parent moves the outfit "
                "instead; check it there.",
                "{count} joints that move the outfit have no partner in the avatar, such as {joint}: their parents "
                "move it instead; check the outfit there.",
                joint=lost[0],
            )
        )
    columns = _columns(clothes.skin, target.skin, pairs, numbers)
    skin = _make_skin(clothes, fit, target, joints, numbers, anchors, columns)
    return BoundClothes(replace(clothes, skin=skin), joints, _partners(clothes, fit, target, pairs), tuple(notes))


def move_skinned(clothes: Asset, skin: Skin | None) -> Asset:
    """Adapt the skin of clothes to other positions of their vertices."""
    if skin is None:
        return replace(clothes, skin=None)
    rest, linear = to_rest(clothes.surface.vertices, skin.weights, skin.transforms)
    return replace(clothes, skin=replace(skin, rest=rest, linear=linear))


def _skin_of_body(surface: Surface, body: Surface, skin: Skin) -> Skin:
    """Make a skin for a surface without one, with the weights of the nearest points of the body."""
    triangle, barycentric = closest_points(surface.vertices, body.vertices, body.triangles)
    nearest = interpolation_matrix(body.triangles[triangle], barycentric, len(body.vertices))
    weights = normalise(csr_array(nearest @ skin.weights))
    rest, linear = to_rest(surface.vertices, weights, skin.transforms)
    return replace(skin, rest=rest, linear=linear, weights=weights)


def _humanoid_joints(clothes: Asset, target: Asset) -> tuple[Booleans, Booleans]:
    """The joints (b,) of the outfit and (b_t,) of the avatar that are the same humanoid bones."""
    bones, others = (
        skeleton_of(each, np.arange(len(each.skin.names)), heads_of(each))  # type: ignore[union-attr]
        for each in (clothes, target)
    )
    pairs = same_humanoid(bones, others)
    return np.isin(bones.names, list(pairs)), np.isin(others.names, list(pairs.values()))


def _pair_joints(clothes: Asset, own: Booleans, fit: Fit, target: Asset, free: Booleans) -> dict[int, int]:
    """The avatar's joint for each joint of the clothes that has a partner and does not move clothes alone.

    Args:
        clothes: the clothes.
        own: (b,) their joints that move them alone.
        fit: their fit.
        target: the body of the avatar.
        free: (b_t,) joints of the avatar that may be partners.
    """
    size = float(np.ptp(target.surface.vertices, axis=0).max())
    heads = move_joints(fit.body.surface, fit.shape, heads_of(clothes)).positions
    sides = [(clothes, ~own, heads), (target, free, heads_of(target))]
    chosen = [np.flatnonzero(kept) for _, kept, _ in sides]
    bones, others = (
        skeleton_of(asset, joints, places) for (asset, _, places), joints in zip(sides, chosen, strict=True)
    )
    pairs = pair_bones(bones, others, size)
    number, other = (
        dict(zip(skeleton.names, joints.tolist(), strict=True))
        for skeleton, joints in zip((bones, others), chosen, strict=True)
    )
    return {number[name]: other[pairs[name]] for name in pairs}


def _partners(clothes: Asset, fit: Fit, target: Asset, pairs: Mapping[int, int]) -> dict[int, Partner]:
    """The avatar's node for each node of the outfit's document that has a joint with a partner at or above it."""
    skin, document = clothes.skin, clothes.document
    assert skin is not None
    assert document is not None
    assert target.skin is not None
    assert target.document is not None
    (worlds, parent), of_target = document.worlds(), target.document.worlds()[0]
    joint_of = {node: joint for joint, node in enumerate(skin.nodes.tolist())}
    motions = _matrices(motions_around(fit.body.surface.vertices, fit.shape, worlds[:, :3, 3]))
    found = {}
    for node in range(len(worlds)):
        other = _anchor(joint_of, pairs, node, parent)
        if other >= 0:
            number = int(target.skin.nodes[other])
            found[node] = Partner(number, np.linalg.solve(of_target[number], motions[node] @ worlds[node]))
    return found


def _matrices(motions: Similarities) -> Floats:
    """(j, 4, 4) similarities as matrices."""
    rows = matrices_of(motions)
    return np.concatenate([rows, np.tile([[0.0, 0, 0, 1]], (len(rows), 1, 1))], axis=1)


def _copy_joints(
    clothes: Asset, own: Booleans, fit: Fit, target: Asset, pairs: Mapping[int, int]
) -> tuple[tuple[NewJoint, ...], dict[int, int], list[int]]:
    """Copy the outfit's own joints, with the nodes below them, such as ends of chains.

    Returns:
        The joints, the number of each copied node in the outfit's document, and the number of its parent joint in the
        avatar's skin.
    """
    skin, document = clothes.skin, clothes.document
    assert skin is not None
    assert document is not None
    assert target.skin is not None
    assert target.document is not None
    worlds, parent = document.worlds()
    joint_of = {node: joint for joint, node in enumerate(skin.nodes.tolist())}
    wearer = _wearers(clothes, own)
    copied: dict[int, int] = {}  # the own joint above, or at, each copied node
    for node in document.in_order(parent):
        joint = joint_of.get(node, -1)
        if joint >= 0 and own[joint]:
            copied[node] = joint
        elif int(parent[node]) in copied and document.gltf.nodes[node].mesh is None:
            copied[node] = copied[int(parent[node])]
    nodes = list(copied)
    places, turned = worlds[nodes, :3, 3].reshape(-1, 3), nearest_rotations(worlds[nodes, :3, :3].reshape(-1, 3, 3))
    moved = worlds[nodes].reshape(-1, 4, 4)
    for number, (before, after) in enumerate(zip(fit.objects, fit.fitted, strict=True)):
        chosen = np.flatnonzero([wearer[copied[node]] == number for node in nodes])
        motions = motions_around(before.vertices, after, places[chosen])
        moved[chosen] = _matrices(motions) @ moved[chosen]
        places[chosen], turned[chosen] = moved[chosen, :3, 3], motions.rotation @ turned[chosen]
    first, of_target = len(target.document.gltf.nodes), target.document.worlds()[0]
    made, numbers, anchors, world = list[NewJoint](), dict[int, int](), list[int](), dict[int, Floats]()
    taken = {each.name for each in target.document.gltf.nodes}
    for place, rotation, exact, node in zip(places, turned, moved, nodes, strict=True):
        above = int(parent[node])
        if above in numbers:
            anchor, parent_node, parent_world = anchors[numbers[above] - first], numbers[above], world[above]
        else:
            anchor = max(_anchor(joint_of, pairs, above, parent), 0)
            parent_node = int(target.skin.nodes[anchor])
            parent_world = of_target[parent_node]
        world[node] = np.block([[rotation, place[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
        name = free_name(document.gltf.nodes[node].name or f"Joint {node}", taken)
        taken.add(name)
        axes = np.linalg.solve(world[node], exact)
        made.append(NewJoint(name, parent_node, np.linalg.solve(parent_world, world[node]), node, axes))
        numbers[node] = first + len(anchors)
        anchors.append(anchor)
    return tuple(made), numbers, anchors


def _wearers(clothes: Asset, own: Booleans) -> dict[int, int]:
    """The number of the object that each of the outfit's own joints belongs to: the one that its chain moves most."""
    assert clothes.skin is not None
    ends, skin = np.cumsum([0, *(count for _, count in clothes.objects)]).tolist(), clothes.skin
    moved = np.array([np.asarray(skin.weights[start:stop].sum(axis=0)) for start, stop in pairwise(ends)])
    root: dict[int, int] = {}
    for joint in parents_first(skin.parents):
        if own[joint]:
            root[joint] = root.get(int(skin.parents[joint]), joint)
    return {
        joint: int(moved[:, [each for each in root if root[each] == top]].sum(axis=1).argmax())
        for joint, top in root.items()
    }


def _anchor(joint_of: Mapping[int, int], pairs: Mapping[int, int], node: int, parent: Integers) -> int:
    """The partner of the nearest joint among a node and those above it that has one; -1 without one."""
    while node >= 0:
        if joint_of.get(node, -1) in pairs:
            return pairs[joint_of[node]]
        node = int(parent[node])
    return -1


def _columns(skin: Skin, of_target: Skin, pairs: Mapping[int, int], numbers: Mapping[int, int]) -> Integers:
    """(b,) the column of each joint's weights in the avatar's skin followed by the new joints."""
    first = min(numbers.values(), default=0)
    columns = np.zeros(len(skin.names), dtype=np.int64)
    for joint in parents_first(skin.parents):
        node, above = int(skin.nodes[joint]), int(skin.parents[joint])
        if node in numbers:
            columns[joint] = len(of_target.names) + numbers[node] - first
        else:
            columns[joint] = pairs.get(joint, columns[above] if above >= 0 else 0)
    return columns


def _make_skin(
    clothes: Asset,
    fit: Fit,
    target: Asset,
    joints: Sequence[NewJoint],
    numbers: Mapping[int, int],
    anchors: Sequence[int],
    columns: Integers,
) -> Skin:
    """The skin of clothes: the avatar's joints, and then the new ones."""
    of_target, skin, of_body, document = target.skin, clothes.skin, fit.body.skin, target.document
    assert of_target is not None
    assert skin is not None
    assert of_body is not None
    assert document is not None
    count, first = len(of_target.names), len(document.gltf.nodes)
    worlds = list(document.worlds()[0])
    parents = of_target.parents.tolist()
    inverse_bind, transforms = list(of_target.inverse_bind), list(of_target.transforms)
    for joint, anchor in zip(joints, anchors, strict=True):
        worlds.append(worlds[joint.parent] @ joint.matrix)
        parents.append(count + joint.parent - first if joint.parent >= first else anchor)
        transforms.append(of_target.transforms[anchor])
        inverse_bind.append(np.linalg.solve(worlds[-1], of_target.transforms[anchor]))
    every = count + len(joints)
    weights, before = (normalise(renumber_bones(each.weights, columns, every)) for each in (skin, of_body))
    after = normalise(renumber_bones(of_target.weights, np.arange(count), every))
    ends = np.cumsum([0, *(len(each.vertices) for each in fit.objects)])
    followed = follow_weights(
        WeightedBody(fit.body.surface, before),
        WeightedBody(target.surface, after),
        fit.objects,
        fit.fitted,
        [weights[start:stop] for start, stop in pairwise(ends)],
        fit.keep,
        fit.shape,
    )
    weights = csr_array(vstack(followed, format="csr"))
    rest, linear = to_rest(clothes.surface.vertices, weights, np.array(transforms))
    return Skin(
        np.concatenate([of_target.nodes, np.arange(first, first + len(numbers))]).astype(np.int64),
        (*of_target.names, *(joint.name for joint in joints)),
        np.array(parents),
        np.array(inverse_bind),
        np.array(transforms),
        rest,
        linear,
        weights,
    )
