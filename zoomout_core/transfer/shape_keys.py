# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys: offsets of vertices, rotated and scaled from the source's pose and size to the target's.

Deformation transfer for triangle meshes (Sumner and Popović 2004) transfers the gradients of a motion, and solves for
the motion with these gradients. With anchors alone it drifts where the target's pose rotates within the moving region,
so the motion is also attracted by the rotated offsets. These determine it over distances longer than
`FRAMES.smoothing_length`; the gradients do so below, where errors of frames and maps would show as dents.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import bsr_array

from zoomout_core.arrays import Floats
from zoomout_core.messages import message
from zoomout_core.runtime.threads import for_each
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.frames import (
    FRAMES,
    FULL_CONFIDENCE,
    Frames,
    frames_of,
    frames_on,
    on_working_mesh,
    turn_gradients,
)
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigid_keys import move_rigid_parts

# Keys that are solved together; bounds the memory, and more columns at once slow down the solves.
KEYS_AT_ONCE = 5
# Offsets below either length are noise and set to zero: relative to the longest offset of the key, and at unit area.
MIN_RELATIVE_OFFSET = 1e-4
MIN_OFFSET = 1e-7


def carry_offsets(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer offsets (n_s, keys, 3) of vertices, in the space of the surfaces.

    The source's vertices must be those before keys: the rest shape, if the source is posed after keys are applied.
    Offsets rotate and scale with the target's shape. Vertices where a key does not move the source stay exactly in
    place; where confidence is low, a key follows its surroundings. Loose parts that the source's keys move rigidly move
    rigidly.
    """
    offsets = without_noise(np.asarray(attribute.values), mapped.source.area)
    moved = mapped.surface_map.interpolate(offsets.any(axis=(1, 2)).astype(np.float64)) > 0
    doubtful = mapped.confidence < FULL_CONFIDENCE
    carried = np.zeros((len(doubtful), *offsets.shape[1:]), dtype=offsets.dtype)
    if not moved.any():
        return replace(attribute, values=carried)
    frames = frames_on(mapped, moved | doubtful)
    loading = _loading(frames)

    def carry(first: int) -> None:
        some = slice(first, first + KEYS_AT_ONCE)
        carried[:, some] = _carry_block(offsets[:, some].astype(np.float64), frames, loading)

    for_each(carry, range(0, offsets.shape[1], KEYS_AT_ONCE))
    move_rigid_parts(carried, offsets, frames)
    filled = int((carried.any(axis=(1, 2)) & doubtful).sum())
    notes = attribute.notes
    if filled:
        notes += (message("Shape keys were smoothed at {count:,} doubtful vertices.", count=filled),)
    return replace(attribute, values=carried, notes=notes)


def conform_target(mapped: MappedTarget) -> Floats:
    """(n_t, 3) positions of the target's vertices on the source, with more of its own shape at low confidence."""
    target, frames = mapped.target, frames_of(mapped)
    # Gradients of the images where they are trusted, and elsewhere those of the target, rotated by the map.
    own = on_working_mesh(target.working, target.vertices)
    gradients = turn_gradients(frames.doubted_stiffness, np.linalg.inv(frames.turns)) @ own.ravel()
    gradients = gradients.reshape(own.shape) + frames.trusted_stiffness @ frames.points
    conforming = frames.smoothing.fit(frames.points, gradients)
    number = target.working.vertex_of
    return np.where((number >= 0)[:, None], conforming[number], mapped.points)


def without_noise(offsets: Floats, area: float) -> Floats:
    """Set offsets (n, keys, 3) that are too short to be visible on a surface of an area to zero."""
    length = np.sqrt(np.einsum("nkx,nkx->nk", offsets, offsets))
    least = np.maximum(MIN_RELATIVE_OFFSET * length.max(axis=0), MIN_OFFSET * np.sqrt(area))
    return np.where((length < least)[:, :, None], 0, offsets)


def _carry_block(offsets: Floats, frames: Frames, loading: bsr_array) -> Floats:
    """(n_t, keys, 3) offsets of the target's vertices, from those (n_s, keys, 3) of the source's."""
    target = frames.mapped.target
    plain = frames.mapped.surface_map.interpolate(offsets)
    here = on_working_mesh(target.working, plain)[frames.number]
    n, keys, _ = here.shape
    loads = loading @ here.transpose(0, 2, 1).reshape(3 * n, keys)
    solved = frames.smoothing.solve(loads.reshape(n, 3 * keys)).reshape(n, 3, keys).transpose(0, 2, 1)
    motion = np.zeros((len(target.working.vertices), keys, 3))
    motion[frames.number] = solved * (here.any(axis=2) | (frames.trust < 1)[:, None])[:, :, None]

    number = target.working.vertex_of
    carried = motion[number]
    loose = np.flatnonzero(number < 0)
    if len(loose):
        carried[loose] = plain[loose] @ frames.steady_turns[frames.nearest(target.vertices[loose])].transpose(0, 2, 1)
    return without_noise(carried, target.area)


def _loading(frames: Frames) -> bsr_array:
    """(3n, 3n) matrix that rotates offsets (n, 3), as one column, and makes right-hand sides of `Frames.smoothing`."""
    own = (frames.trust * frames.areas)[:, None, None] * frames.steady_turns
    blocks = bsr_array((own, np.arange(len(own)), np.arange(len(own) + 1)))
    return bsr_array(
        blocks + FRAMES.smoothing_length**2 * turn_gradients(frames.trusted_stiffness, frames.steady_turns)
    )
