"""Shape keys: how far vertices move, turned and scaled from the source's pose and size to the target's.

Deformation transfer for triangle meshes (Sumner and Popović 2004) carries the gradients of a motion over, and solves
for the motion that has them. Held at anchors alone it drifts where the target's pose turns within the region that
moves, so the motion is drawn to the turned offsets as well: these hold over distances longer than `frames.REACH`,
and gradients below, where errors of frames and maps would show as dents.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csc_array

from zoomout_core.arrays import Floats
from zoomout_core.progress import drain
from zoomout_core.threads import for_each
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.draped import Draped
from zoomout_core.transfer.frames import REACH, TRUSTED, Frames, frames_on, on_working_mesh

# Offsets shorter than these parts of a key's longest one, and of the surface's size, are noise.
SMALLEST_OF_KEY, SMALLEST_OF_SURFACE = 1e-4, 1e-7
# Keys that are worked on together: bounds the memory, and solves take longer with more columns at once.
KEYS_AT_ONCE = 5


def carry_offsets(attribute: Attribute, draped: Draped) -> Attribute:
    """Offsets (n, keys, 3) of vertices, in the space of the surfaces.

    They turn and scale with the target's shape. Vertices that lie where a key does not move the source stay exactly
    where they are; where confidence is low, a key follows its surroundings.

    Args:
        attribute: offsets (n_s, keys, 3) from the vertices of the source, which are those that the keys start from:
            those of the rest shape, if the source is posed after it is moved by keys.
        draped: the target on the source.
    """
    offsets = _without_noise(np.asarray(attribute.values), draped.source.area)
    moved = draped.surface_map.interpolate(offsets.any(axis=(1, 2))) > 0
    doubtful = draped.confidence < TRUSTED
    carried = np.zeros((len(doubtful), *offsets.shape[1:]), dtype=offsets.dtype)
    if not moved.any():
        return replace(attribute, values=carried)
    frames = frames_on(draped, moved | doubtful)
    turns = frames.turns

    def carry(first: int) -> None:
        some = slice(first, first + KEYS_AT_ONCE)
        carried[:, some] = _carried(offsets[:, some].astype(np.float64), frames, turns)

    drain(for_each(carry, range(0, offsets.shape[1], KEYS_AT_ONCE)))
    filled = int((carried.any(axis=(1, 2)) & doubtful).sum())
    notes = attribute.notes
    if filled:
        notes += (f"{attribute.name}: {filled} vertices of low confidence follow their surroundings.",)
    return replace(attribute, values=carried, notes=notes)


def conformed(draped: Draped) -> Floats:
    """(n_t, 3) positions that lay the target onto the source; where confidence is low it keeps more of its shape."""
    target = draped.target
    frames = frames_on(draped, np.ones(len(target.vertices), dtype=bool))
    # The gradients of the images where they are trusted, and elsewhere those of the target as the map turns it.
    own = on_working_mesh(target.working, target.vertices)[:, None]
    gradients = _gradients(frames.doubted_stiffness, np.linalg.inv(frames.turns), own)[:, 0]
    gradients += frames.trusted_stiffness @ frames.points
    laid = frames.smooth((frames.trust * frames.areas)[:, None] * frames.points + REACH**2 * gradients)
    number = target.working.vertex_of
    return np.where((number >= 0)[:, None], laid[number], draped.points)


def _without_noise(offsets: Floats, area: float) -> Floats:
    """Offsets (n, keys, 3) on a surface of an area; those that are too short to be seen are set to zero."""
    length = np.linalg.norm(offsets, axis=2)
    least = np.maximum(SMALLEST_OF_KEY * length.max(axis=0), SMALLEST_OF_SURFACE * np.sqrt(area))
    return np.where((length < least)[:, :, None], 0, offsets)


def _carried(offsets: Floats, frames: Frames, turns: Floats) -> Floats:
    """(n_t, keys, 3) offsets of the target's vertices, for (n_s, keys, 3) of the source's and the frames' turns."""
    target = frames.draped.target
    plain = frames.draped.surface_map.interpolate(offsets)
    here = on_working_mesh(target.working, plain)[frames.number]
    loads: Floats = (frames.trust * frames.areas)[:, None, None] * _turned(turns, here)
    loads += REACH**2 * _gradients(frames.trusted_stiffness, turns, here)
    solved = frames.smooth(loads.reshape(len(loads), -1)).reshape(loads.shape)
    solved[~here.any(axis=2) & (frames.trust == 1)[:, None]] = 0
    motion = np.zeros((len(target.working.vertices), *solved.shape[1:]))
    motion[frames.number] = solved

    number = target.working.vertex_of
    carried = motion[number]
    loose = np.flatnonzero(number < 0)
    if len(loose):
        carried[loose] = _turned(turns[frames.nearest(target.vertices[loose])], plain[loose])
    return _without_noise(carried, target.area)


def _turned(turns: Floats, vectors: Floats) -> Floats:
    """(n, k, 3) vectors (n, k, 3), each turned by the matrix (n, 3, 3) of its vertex."""
    return vectors @ turns.transpose(0, 2, 1)


def _gradients(stiffness: csc_array, turns: Floats, values: Floats) -> Floats:
    """The divergence of turned gradients: what the stiffness makes of values that have these gradients.

    For each vertex i the sum of w_ij (M_i + M_j) / 2 (v_i - v_j) over its neighbours, w_ij being the weights of the
    edges and M the matrices.

    Args:
        stiffness: (n, n).
        turns: (n, 3, 3) a matrix for each vertex.
        values: (n, k, 3) vectors.
    """

    def stiff(array: Floats) -> Floats:
        return (stiffness @ array.reshape(len(array), -1)).reshape(array.shape)

    sums: Floats = _turned(turns, stiff(values)) + stiff(_turned(turns, values)) - _turned(stiff(turns), values)
    return sums / 2
