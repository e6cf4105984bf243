# SPDX-License-Identifier: GPL-3.0-or-later
"""Add the joints and weights of a second source, such as those of a face, to a part of a target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import Asset, Skin, to_rest
from zoomout_core.assets.skeletons import skeleton_of
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_document import free_name, library
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import Message, message, plural
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.bone_pairs import Skeleton
from zoomout_core.transfer.rigging.rig import move_rig
from zoomout_core.transfer.rigging.shared_bones import SharedBones, share_bones


def add_joints(
    source: Asset, target: Asset, mapped: MappedTarget, weights: csr_array, mask: Floats
) -> tuple[Asset, tuple[Message, ...]]:
    """Add the joints of a source that move a part to a target, and give the part their weights, see `share_bones`.

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
    skeletons = _skeleton(source, own), _skeleton(target, skin)
    shared = share_bones(*skeletons, weights, skin.weights, mask, mapped.target.vertex_areas)
    frames = _place(source, own, mapped.target.with_vertices(skin.rest), mapped, shared.added)
    made = _append(target, skin, [own.names[joint] for joint in shared.added], frames, shared, mask > 0)
    if not len(shared.added):
        return made, ()
    assert made.skin is not None
    names = {"joint": made.skin.names[shared.parents[0]], "first": own.names[shared.added[0]]}
    joints = plural(len(shared.added), "1 joint", "{count} joints")
    return made, (message("Added below {joint}: {joints} of the source, such as {first}.", joints=joints, **names),)


def _skeleton(asset: Asset, skin: Skin) -> Skeleton:
    """The joints of an asset, without their positions."""
    return skeleton_of(asset, np.arange(len(skin.names)), np.zeros((len(skin.names), 3)))


def _place(source: Asset, own: Skin, at_rest: Surface, mapped: MappedTarget, joints: Integers) -> Floats:
    """(a, 4, 4) frames of some joints (a,) of a source in a target at rest, with the scale of the target."""
    placed = np.tile(np.eye(4), (len(joints), 1, 1))
    if len(joints):
        frames, body = np.linalg.inv(own.inverse_bind), source.surface.with_vertices(own.rest)
        moved = move_rig(replace(mapped, source=body, target=at_rest), body, at_rest, frames[:, :3, 3], own.parents)
        turned = moved.rotations @ frames[:, :3, :3] / np.cbrt(np.abs(np.linalg.det(frames[:, :3, :3])))[:, None, None]
        placed[:, :3, :3], placed[:, :3, 3] = turned[joints], moved.positions[joints]
    return placed


def _append(target: Asset, skin: Skin, added: list[str], placed: Floats, shared: SharedBones, part: Booleans) -> Asset:
    """Add joints of these names and frames (a, 4, 4) to a target, with new weights in a part (n,)."""
    assert target.document is not None
    document = target.document.copy()
    nodes, taken = document.gltf.nodes, {each.name for each in document.gltf.nodes}
    names, of_joint = list(skin.names), skin.nodes.tolist()
    frames, transforms = list(np.linalg.inv(skin.inverse_bind)), list(skin.transforms)
    for wanted, above, frame in zip(added, shared.parents.tolist(), placed, strict=True):
        local = np.linalg.solve(frames[above], frame)
        name = free_name(wanted, taken)
        taken.add(name)
        parent = nodes[of_joint[above]]
        parent.children = [*(parent.children or []), len(nodes)]
        of_joint.append(len(nodes))
        nodes.append(library().Node(name=name, matrix=local.T.ravel().tolist()))
        names.append(name)
        frames.append(frame)
        transforms.append(transforms[above])
    moves, rest, linear = np.array(transforms), skin.rest.copy(), skin.linear.copy()
    rest[part], linear[part] = to_rest(target.surface.vertices[part], csr_array(shared.weights[part]), moves)
    joined = Skin(
        np.array(of_joint, dtype=np.int64),
        tuple(names),
        np.concatenate([skin.parents, shared.parents]).astype(np.int64),
        np.linalg.inv(np.array(frames)),
        moves,
        rest,
        linear,
        shared.weights,
    )
    look = document if target.look is target.document else target.look
    return replace(target, skin=joined, document=document, look=look)
