# SPDX-License-Identifier: GPL-3.0-or-later
"""Play the animations of a glTF document."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats
from zoomout_core.mesh.formats.gltf_document import Document, local_matrix

if TYPE_CHECKING:
    from pygltflib import Animation

# Paths of channels that move nodes.
PLACE, TURN, SIZE = "translation", "rotation", "scale"
# Interpolations other than linear ones.
STEP, CUBIC = "STEP", "CUBICSPLINE"


def length_of(document: Document, animation: Animation) -> float:
    """The time of an animation's last keyframe, in seconds."""
    return max((float(document.array(each.input).max(initial=0)) for each in animation.samplers), default=0.0)


def play(document: Document, animation: Animation, times: Floats) -> Floats:
    """(f, nodes, 4, 4) world transforms of the nodes at times (f,) in seconds.

    Morph targets, and channels whose keyframes are damaged, are not played.
    """
    channels: dict[int, dict[str, Floats]] = {}
    for channel in animation.channels:
        node, path, sampler = channel.target.node, channel.target.path, animation.samplers[channel.sampler]
        keys = np.asarray(document.array(sampler.input)[:, 0], dtype=np.float64)
        values = np.asarray(document.array(sampler.output), dtype=np.float64)
        rows = len(keys) * (3 if sampler.interpolation == CUBIC else 1)
        if (
            node is not None
            and path in (PLACE, TURN, SIZE)
            and len(keys)
            and len(values) == rows
            and np.isfinite(values).all()
        ):
            is_turn = path == TURN
            channels.setdefault(node, {})[path] = _interpolate(times, keys, values, sampler.interpolation, is_turn)
    nodes, parent = document.gltf.nodes, document.worlds()[1]
    worlds = np.empty((len(times), len(nodes), 4, 4))
    for number in document.in_order(parent):
        own = _local(nodes[number], channels.get(number, {}), len(times))
        worlds[:, number] = own if parent[number] < 0 else worlds[:, parent[number]] @ own
    return worlds


def _local(node: object, played: dict[str, Floats], count: int) -> Floats:
    """(f, 4, 4) transforms of a node relative to its parent."""
    if not played:
        return np.broadcast_to(local_matrix(node), (count, 4, 4))
    turn = played.get(TURN, np.array([node.rotation or [0, 0, 0, 1]], dtype=np.float64))  # type: ignore[attr-defined]
    size = played.get(SIZE, np.array([node.scale or [1, 1, 1]], dtype=np.float64))  # type: ignore[attr-defined]
    made = np.tile(np.eye(4), (count, 1, 1))
    made[:, :3, :3] = _rotations(turn).as_matrix() * size[:, None]
    made[:, :3, 3] = played.get(PLACE, np.array(node.translation or [0, 0, 0]))  # type: ignore[attr-defined]
    return made


def _interpolate(times: Floats, keys: Floats, values: Floats, interpolation: str | None, is_turn: bool) -> Floats:
    """(f, w) values at times (f,), of keyframes at (k,) seconds; quaternions are interpolated on the sphere."""
    after = np.clip(np.searchsorted(keys, times, side="right"), 1, max(len(keys) - 1, 1)).clip(max=len(keys) - 1)
    before = np.maximum(after - 1, 0)
    span = np.maximum(keys[after] - keys[before], np.finfo(np.float64).tiny)
    share = np.clip((times - keys[before]) / span, 0, 1)[:, None]
    if interpolation == STEP:
        found = np.where(share < 1, values[before], values[after])
    elif interpolation == CUBIC:
        rows = values.reshape(len(keys), 3, -1)  # the slope before a keyframe, its value, and the slope behind it
        (_, start, leaving), (arriving, end, _) = (rows[number].swapaxes(0, 1) for number in (before, after))
        leaving, arriving = span[:, None] * leaving, span[:, None] * arriving
        s, t = share, 1 - share
        found = (1 + 2 * s) * t**2 * start + s * t**2 * leaving + s**2 * (3 - 2 * s) * end - s**2 * t * arriving
    elif is_turn:
        start, end = _rotations(values[before]), _rotations(values[after])
        found = (start * Rotation.from_rotvec(share * (start.inv() * end).as_rotvec())).as_quat()
    else:
        found = (1 - share) * values[before] + share * values[after]
    return np.asarray(found)


def _rotations(quaternions: Floats) -> Rotation:
    """Rotations of quaternions (f, 4) x, y, z, w of any length; none where all are zero."""
    is_zero = ~quaternions.any(axis=1, keepdims=True)
    return Rotation.from_quat(np.where(is_zero, [0.0, 0, 0, 1], quaternions))
