# SPDX-License-Identifier: GPL-3.0-or-later
"""Give a part of a target joints and weights of a second source, such as those of its face, below its own joints.

Both rigs share joints of the same humanoid bone or name: those of the target stay where they are, and receive the
weights of the source's. Joints of the source that mostly move the part, and have no partner there, are moved into the
target and added below the partner of the nearest joint above them, or below the first joint of the part if that moves
another part. Weights of the source's other joints are replaced by the target's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import Asset, Skin, to_rest
from zoomout_core.assets.gltf.document import library
from zoomout_core.assets.skeletons import make_unique, skeleton_of
from zoomout_core.mesh.surface import MeshError
from zoomout_core.messages import Message, message, plural
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.bone_pairs import pair_bones
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.transfer.rigging.rig import move_rig
from zoomout_core.transfer.rigging.skinning import normalise, renumber_bones

# Share of what a joint moves above which it belongs to a part.
MOSTLY = 0.5


@dataclass(frozen=True, eq=False)
class _Added:
    """Joints to add to a target.

    Attributes:
        joints: (a,) their numbers in the source, each after its parent.
        parents: (a,) the joint of the target's new skin that each hangs from.
        frames: (a, 4, 4) their frames in the rest pose of the target.
    """

    joints: Integers
    parents: Integers
    frames: Floats


def add_joints(
    source: Asset, target: Asset, mapped: MappedTarget, weights: csr_array, mask: Floats
) -> tuple[Asset, tuple[Message, ...]]:
    """Add the joints of a source that move a part to a target, and give the part their weights.

    Args:
        source: the asset with the joints.
        target: the asset with joints of its own, which stay.
        mapped: the target over the source.
        weights: (n_t, b) weights of the source's joints at the vertices of the target.
        mask: (n_t,) share of the source's weights, in [0, 1].

    Returns:
        The target, and sentences for the user.

    Raises:
        MeshError: the source or the target has no joints.
    """
    own, skin = source.skin, target.skin
    if own is None or skin is None or target.document is None:
        raise MeshError("Joints for a part need a rigged source, and a rigged glTF target to add them to.")
    counted = mask * mapped.target.vertex_areas
    inside, inside_own = (_mostly_in(counted, mapped.target.vertex_areas, each) for each in (weights, skin.weights))
    partners = _partners(source, target, inside, inside_own)
    above = np.where((partners >= 0) & inside_own[partners], partners, -1)
    anchor = _first_joint(skin.parents, int(np.argmax(skin.weights.T @ counted)), inside_own)
    added = _place(source, target, mapped, np.flatnonzero(inside & (partners < 0)), above, anchor)
    count = len(skin.names)
    columns = partners.copy()
    columns[added.joints] = count + np.arange(len(added.joints))
    received = renumber_bones(weights, columns, count + len(added.joints))
    before = renumber_bones(skin.weights, np.arange(count), count + len(added.joints))
    shares = np.asarray(received.sum(axis=1)).ravel()  # the rest is of joints that are neither shared nor added
    mixed = normalise(csr_array(diags_array(mask) @ received + diags_array(1 - mask * shares) @ before))
    made = _append(target, skin, own, added, mixed, mask > 0)
    if not len(added.joints):
        return made, ()
    names = {"joint": skin.names[added.parents[0]], "first": own.names[added.joints[0]]}
    joints = plural(len(added.joints), "1 joint", "{count} joints")
    return made, (message("Added below {joint}: {joints} of the source, such as {first}.", joints=joints, **names),)


def _mostly_in(counted: Floats, areas: Floats, weights: csr_array) -> Booleans:
    """(b,) which joints move mostly a part, from the area in it and all area of vertices (n,)."""
    moved = weights.T @ areas
    return np.asarray((moved > 0) & (weights.T @ counted > MOSTLY * moved))


def _first_joint(parents: Integers, joint: int, inside: Booleans) -> int:
    """The first joint of a part (b,), from one of its joints upwards."""
    while parents[joint] >= 0 and inside[parents[joint]]:
        joint = int(parents[joint])
    return joint


def _partners(source: Asset, target: Asset, inside: Booleans, inside_own: Booleans) -> Integers:
    """(b,) the target's joint that is shared with each joint of the source, -1 for none.

    A joint that moves the part is not shared with one elsewhere that has its name by chance.
    """
    assert source.skin is not None
    assert target.skin is not None
    names, of_target = source.skin.names, target.skin.names
    bones, others = (
        skeleton_of(each, np.arange(count), np.zeros((count, 3)))
        for each, count in ((source, len(names)), (target, len(of_target)))
    )
    number = {name: joint for joint, name in reversed(list(enumerate(of_target)))}
    pairs = pair_bones(bones, others, 0)  # by names alone: no two joints are nearer to each other than that
    found = np.array([number[pairs[name]] if name in pairs else -1 for name in names], dtype=np.int64)
    return np.where(inside & ~inside_own[found], -1, found)


def _place(
    source: Asset, target: Asset, mapped: MappedTarget, joints: Integers, partners: Integers, anchor: int
) -> _Added:
    """Place joints (a,) of a source in a target.

    Those without a joint above them that has a partner (b,) hang from the anchor.
    """
    own, skin = source.skin, target.skin
    assert own is not None
    assert skin is not None
    frames = np.linalg.inv(own.inverse_bind)
    body, at_rest = source.surface.with_vertices(own.rest), mapped.target.with_vertices(skin.rest)
    chosen = [joint for joint in parents_first(own.parents) if joint in set(joints.tolist())]
    numbers, parents = {joint: len(skin.names) + at for at, joint in enumerate(chosen)}, list[int]()
    for joint in chosen:
        above = int(own.parents[joint])
        while above >= 0 and above not in numbers and partners[above] < 0:
            above = int(own.parents[above])
        parents.append(anchor if above < 0 else numbers.get(above, int(partners[above])))
    placed = np.tile(np.eye(4), (len(chosen), 1, 1))
    if chosen:
        moved = move_rig(replace(mapped, source=body, target=at_rest), body, at_rest, frames[:, :3, 3], own.parents)
        placed[:, :3, :3], placed[:, :3, 3] = (moved.rotations @ _rotations(frames))[chosen], moved.positions[chosen]
    return _Added(np.array(chosen, dtype=np.int64), np.array(parents, dtype=np.int64), placed)


def _rotations(frames: Floats) -> Floats:
    """(b, 3, 3) frames (b, 4, 4) without their common scale, so that joints have that of the target."""
    return frames[:, :3, :3] / np.cbrt(np.abs(np.linalg.det(frames[:, :3, :3])))[:, None, None]


def _append(target: Asset, skin: Skin, own: Skin, added: _Added, weights: csr_array, part: Booleans) -> Asset:
    """The target with added joints, and weights of all its joints, which differ from its own in a part (n,)."""
    assert target.document is not None
    document = target.document.copy()
    nodes, taken = document.gltf.nodes, {each.name for each in document.gltf.nodes}
    names, of_joint = list(skin.names), skin.nodes.tolist()
    frames, transforms = list(np.linalg.inv(skin.inverse_bind)), list(skin.transforms)
    for joint, above, frame in zip(added.joints.tolist(), added.parents.tolist(), added.frames, strict=True):
        local = np.linalg.solve(frames[above], frame)
        name = make_unique(own.names[joint], taken)
        parent = nodes[of_joint[above]]
        parent.children = [*(parent.children or []), len(nodes)]
        of_joint.append(len(nodes))
        nodes.append(library().Node(name=name, matrix=local.T.ravel().tolist()))
        names.append(name)
        frames.append(frame)
        transforms.append(transforms[above])
    moves, rest, linear = np.array(transforms), skin.rest.copy(), skin.linear.copy()
    rest[part], linear[part] = to_rest(target.surface.vertices[part], csr_array(weights[part]), moves)
    joined = Skin(
        np.array(of_joint, dtype=np.int64),
        tuple(names),
        np.concatenate([skin.parents, added.parents]).astype(np.int64),
        np.linalg.inv(np.array(frames)),
        moves,
        rest,
        linear,
        weights,
    )
    look = document if target.look is target.document else target.look
    return replace(target, skin=joined, document=document, look=look)
