# SPDX-License-Identifier: GPL-3.0-or-later
"""Loose parts that shape keys move rigidly, such as eyeballs and the teeth of the jaw.

If offsets were transferred for each vertex, errors of the map would bend these parts. Parts with the same motion, such
as a row of teeth, keep a common motion on the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.frames import Frames, on_working_mesh, without_small_turn

# Tolerance for a rigid motion, or for that of another part, relative to its length: vertices of sculpted keys are
# rounded.
TOLERANCE = 0.02
# Share of the vertices of a target's part that are mapped to one part of the source.
MOST = 0.9
# Fewer vertices determine no rotation.
MIN_VERTICES = 4
# All parts together form a rigid frame, such as the teeth and eyes of a skull, if their centres deviate from the best
# similarity by at most this share of their spread. On heads of other people the deviation is .02 to .09.
MAX_MISFIT = 0.1
# Below this ratio of the width of the centres to their length, they hardly determine a rotation: two eyes, for example.
MIN_WIDTH = 0.2


@dataclass(frozen=True, eq=False)
class _RigidParts:
    """Parts of the source with the same rigid motions."""

    motions: Similarities  # of each key
    moved: Booleans  # (keys,) which keys move them
    components: list[int]  # the parts' numbers


def move_rigid_parts(transferred: Floats, offsets: Floats, frames: Frames, other_person: float) -> None:
    """Replace the offsets (n_t, keys, 3) of rigid parts of the target, in place, by rigid motions.

    Takes the offsets (n_s, keys, 3) of the source. Motions are rotated and scaled by the common frame of all parts if
    they form one, otherwise by that of the body beside each part. The map of a round part, such as an eyeball, does not
    determine its rotation. Motions are not scaled between two persons, see `Frames.other_person`.
    """
    target = frames.mapped.target
    partner = _partners(frames)
    body = np.flatnonzero(target.working.component[frames.number] == 0)
    if not (partner > 0).any() or not len(body):
        return
    places_of_body = target.working.to_surface(target.working.vertices[frames.number[body]])
    number = target.working.vertex_of
    partner_of_vertex = np.where(number >= 0, partner[target.working.component[number]], 0)
    frame = _common_frame(partner_of_vertex, frames)
    for rigid in _find_rigid_parts(frames.mapped.source, offsets, np.unique(partner[partner > 0])):
        vertices = np.flatnonzero(np.isin(partner_of_vertex, rigid.components))
        places = target.vertices[vertices]
        centre = places.mean(axis=0)
        beside = body[np.linalg.norm(places_of_body - centre, axis=1).argmin()]
        turn = frames.steady_turns[beside] if frame is None else frame
        turn = turn / np.cbrt(abs(np.linalg.det(turn))) ** other_person
        before = frames.mapped.points[vertices].mean(axis=0) + (places - centre) @ np.linalg.inv(turn).T
        moved = rigid.moved[:, None, None] * (rigid.motions(before) - before) @ turn.T
        transferred[vertices] = np.moveaxis(moved, 0, 1)


def _partners(frames: Frames) -> Integers:
    """The part of the source (components,) that each part of the target is mapped to; 0, the body, if several."""
    source, target = frames.mapped.source.working, frames.mapped.target.working
    surface_map = frames.mapped.surface_map
    at = source.vertex_of[surface_map.source_triangles[surface_map.triangle, 0]]
    image = on_working_mesh(target, np.where(at >= 0, source.component[at], 0))
    partner = np.zeros(target.component.max() + 1, dtype=np.int64)
    for component in range(1, len(partner)):
        found, count = np.unique(image[target.component == component], return_counts=True)
        if count.max() >= MOST * count.sum():
            partner[component] = found[count.argmax()]
    return partner


def _common_frame(partner: Integers, frames: Frames) -> Floats | None:
    """The common rotation and scale (3, 3) of the centres of all parts with a partner (n_t,); None without one."""
    target = frames.mapped.target
    vertices = np.flatnonzero(partner > 0)
    _, part = np.unique(target.working.component[target.working.vertex_of[vertices]], return_inverse=True)
    share = 1 / np.bincount(part)[part, None]
    before, now = (segment_sum(share * points[vertices], part) for points in (frames.mapped.points, target.vertices))
    if len(now) < 3:
        return None
    offset = now - now.mean(axis=0)
    length, width, _ = np.linalg.svd(offset, compute_uv=False)
    if width < MIN_WIDTH * length:
        return None
    side = 1.0 if np.sign(np.linalg.det(frames.steady_turns)).sum() >= 0 else -1.0
    together = procrustes(before, now, handedness=side)
    is_rigid = np.linalg.norm(together(before) - now) <= MAX_MISFIT * np.linalg.norm(offset)
    return without_small_turn(together.linear)[0] if is_rigid else None


def _find_rigid_parts(source: Surface, offsets: Floats, components: Integers) -> list[_RigidParts]:
    """Rigidly moved parts among some of the source's, grouped by motion. Parts that no key moves are excluded."""
    number = source.working.vertex_of
    component = np.where(number >= 0, source.working.component[number], -1)
    found: list[_RigidParts] = []
    for each in components:
        vertices = np.flatnonzero(component == each)
        rest, ways = source.vertices[vertices], np.moveaxis(offsets[vertices], 1, 0).astype(np.float64)
        if len(vertices) < MIN_VERTICES or not ways.any():
            continue
        same = next((rigid for rigid in found if _makes(rigid.motions, rest, ways)), None)
        if same is not None:
            same.components.append(int(each))
            continue
        motions = procrustes(np.broadcast_to(rest, ways.shape), rest + ways, scales=(1, 1))
        if _makes(motions, rest, ways):
            found.append(_RigidParts(motions, ways.any(axis=(1, 2)), [int(each)]))
    return found


def _makes(motions: Similarities, rest: Floats, ways: Floats) -> bool:
    """Whether rigid motions, one for each key, move vertices (n, 3) by offsets (keys, n, 3)."""
    missed = np.linalg.norm(motions(rest) - rest - ways, axis=(1, 2))
    return bool(missed.max() <= TOLERANCE * np.linalg.norm(ways, axis=(1, 2)).max())
