# SPDX-License-Identifier: GPL-3.0-or-later
"""Move the joints of a skin into a mesh of another build, with the nodes and animations of its document.

A pose is a change of each joint's local transform relative to that at rest. It stays the same while the rest transforms
change, so rotations are relative to the surface, and translations scale with the size of the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.mesh.formats.gltf_document import POINTER, VRM_0, Document, local_matrix
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.transfer.rigging.rig import move_rig

if TYPE_CHECKING:
    from pygltflib import AnimationChannelTarget

# Keyframes of cubic splines have a tangent before and behind each value.
CUBIC, TANGENTS = "CUBICSPLINE", 3
ROTATION, TRANSLATION = "rotation", "translation"
# The direction that is up in glTF.
UP = np.array([0.0, 1.0, 0.0])


class _Change(NamedTuple):
    """How the local transform of a joint changes in any pose: rotation and translation from the left."""

    rotation: Floats  # (3, 3)
    scale: float  # of differences of translations
    shift: Floats  # (3,)

    def translate(self, translations: Floats) -> Floats:
        """Change translations (n, 3)."""
        return np.asarray(self.scale * translations @ self.rotation.T + self.shift)

    def rotate(self, quaternions: Floats) -> Floats:
        """Change rotations (n, 4), or tangents of them: quaternions x, y, z, w, which need not be unit."""
        a = Rotation.from_matrix(self.rotation).as_quat()
        vector = a[3] * quaternions[:, :3] + quaternions[:, 3:] * a[:3] + np.cross(a[:3], quaternions[:, :3])
        return np.column_stack([vector, a[3] * quaternions[:, 3] - quaternions[:, :3] @ a[:3]])


def move_skin(source: Asset, bound: Skin, mapped: MappedTarget) -> tuple[Skin, Document | None]:
    """Move the joints of a source into a target that is bound to them.

    The target keeps its own size, and stands where the source stands: on the same ground, with its root joint above
    or below the source's.

    Args:
        source: the asset with the rig.
        bound: the skin of the target, with the source's joints.
        mapped: the target over the source.

    Returns:
        The skin with moved joints, and the source's document with the nodes and animations of these.
    """
    assert source.skin is not None
    at_rest, frames = mapped.target.with_vertices(bound.rest), np.linalg.inv(bound.inverse_bind)
    body = source.surface.with_vertices(source.skin.rest)
    moved = move_rig(mapped, body, at_rest, frames[:, :3, 3], bound.parents)
    size = _own_size(bound)
    rest, positions = size * bound.rest, size * moved.positions
    root = int(np.argmin(bound.parents))
    up = np.linalg.inv(bound.transforms[root, :3, :3]) @ UP
    up /= np.linalg.norm(up)
    lift = (source.skin.rest @ up).min() - (rest @ up).min()
    aside = frames[root, :3, 3] - positions[root]
    shift = aside + (lift - aside @ up) * up
    skin, positions = replace(bound, rest=rest + shift, linear=size * bound.linear), positions + shift
    if source.document is None:
        columns = moved.rotations @ frames[:, :3, :3], positions[:, :, None]
        frames[:, :3] = np.concatenate(columns, axis=2)
        return replace(skin, inverse_bind=np.linalg.inv(frames)), None
    document = source.document.copy()
    keeps_axes = VRM_0 in (document.gltf.extensions or {})  # its joints are not rotated at rest
    turns = np.broadcast_to(np.eye(3), moved.rotations.shape) if keeps_axes else moved.rotations
    placed, changes = _place_joints(document, skin, frames, positions, turns, size)
    _move_animations(document, changes)
    bind = np.linalg.inv(placed)
    return replace(skin, inverse_bind=bind, transforms=document.worlds()[0][skin.nodes] @ bind), document


def _own_size(bound: Skin) -> float:
    """The target's size, relative to that at which it is bound."""
    shrunk = np.median(np.cbrt(np.abs(np.linalg.det(bound.linear))))
    return float(1 / (shrunk * np.cbrt(np.abs(np.linalg.det(bound.transforms[:, :3, :3]))).mean()))


def _place_joints(
    document: Document, skin: Skin, frames: Floats, positions: Floats, turns: Floats, size: float
) -> tuple[Floats, dict[int, _Change]]:
    """Move the nodes of joints.

    Args:
        document: the document; its nodes are changed.
        skin: the joints before.
        frames: (b, 4, 4) their frames at rest.
        positions: (b, 3) their new positions at rest.
        turns: (b, 3, 3) rotations of their frames.
        size: scale of differences of translations.

    Returns:
        (b, 4, 4) the new frames at rest, and the change of each node's local transform.
    """
    nodes, parent = document.gltf.nodes, document.worlds()[1]
    placed, changes = np.empty_like(frames), dict[int, _Change]()
    for joint in parents_first(skin.parents):
        node, above = int(skin.nodes[joint]), int(skin.parents[joint])
        now = local_matrix(nodes[node])
        if above < 0:
            # Transforms above the joints stay, and take the root's rest frame to its place in the document.
            local, frame = now, frames[joint] @ np.linalg.inv(now)
            outside = frame
        else:
            between = _between(nodes, parent, node, int(skin.nodes[above]))
            outside, frame = frames[above] @ between, placed[above] @ between
            local = np.linalg.inv(outside) @ frames[joint]
        wanted = np.linalg.inv(frame[:3, :3]) @ turns[joint] @ outside[:3, :3]
        rotation = nearest_rotations(wanted)
        place = np.linalg.solve(frame[:3, :3], positions[joint] - frame[:3, 3])
        change = _Change(rotation, size, place - size * rotation @ local[:3, 3])
        at_rest = np.eye(4)
        at_rest[:3, :3], at_rest[:3, 3] = rotation @ local[:3, :3], place
        placed[joint], changes[node] = frame @ at_rest, change
        _change_node(nodes[node], change)
    return placed, changes


def _between(nodes: Sequence[object], parent: Integers, node: int, above: int) -> Floats:
    """(4, 4) product of the local transforms of nodes that are between a node and an ancestor."""
    matrix, at = np.eye(4), int(parent[node])
    while at != above:
        matrix, at = local_matrix(nodes[at]) @ matrix, int(parent[at])
    return matrix


def _change_node(node: object, change: _Change) -> None:
    """Change the local transform of a node."""
    if node.matrix is not None:  # type: ignore[attr-defined]
        matrix = local_matrix(node)
        matrix[:3, 3] = change.translate(matrix[None, :3, 3])[0]
        matrix[:3, :3] = change.rotation @ matrix[:3, :3]
        node.matrix = matrix.T.ravel().tolist()  # type: ignore[attr-defined]
        return
    translation, rotation = node.translation or [0, 0, 0], node.rotation or [0, 0, 0, 1]  # type: ignore[attr-defined]
    node.translation = change.translate(np.array([translation]))[0].tolist()  # type: ignore[attr-defined]
    node.rotation = change.rotate(np.array([rotation], dtype=np.float64))[0].tolist()  # type: ignore[attr-defined]


def _move_animations(document: Document, changes: dict[int, _Change]) -> None:
    """Change the keyframes of joints, so that they play the same motion relative to the new rest pose."""
    for animation in document.gltf.animations:
        for channel in animation.channels:
            node, path = _channel_of(channel.target)
            if node not in changes or path not in (ROTATION, TRANSLATION):
                continue
            sampler = deepcopy(animation.samplers[channel.sampler])
            values = np.asarray(document.array(sampler.output), dtype=np.float64)
            if path == ROTATION:
                values = changes[node].rotate(values)
            else:
                is_tangent = (np.arange(len(values)) % TANGENTS != 1) & (sampler.interpolation == CUBIC)
                values = changes[node].translate(values) - np.outer(is_tangent, changes[node].shift)
            sampler.output = document.add_array(values.astype("<f4"))
            channel.sampler = len(animation.samplers)
            animation.samplers.append(sampler)


def _channel_of(target: AnimationChannelTarget) -> tuple[int, str]:
    """The node that a channel animates, -1 for none, and the property."""
    if target.path != "pointer":
        return -1 if target.node is None else target.node, target.path
    steps = str((target.extensions or {}).get(POINTER, {}).get("pointer")).split("/")
    if len(steps) == 4 and steps[1] == "nodes" and steps[2].isdecimal():
        return int(steps[2]), steps[3]
    return -1, ""
