# SPDX-License-Identifier: GPL-3.0-or-later
"""Close the eyelids of a target under blinks, as far as those of the source close.

The eyes of two persons differ in height, so that a blink leaves a gap between lids that are farther apart. The lid
that moves more is therefore moved towards the other one. Its rim determines the displacement, which screened smoothing
extends over the lid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, row_norms
from zoomout_core.geometry.gradients import without_sums
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.triangles import unit_vectors, vertex_areas
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.frames import Frames, on_working_mesh
from zoomout_core.transfer.keys.face_landmarks import (
    BLINK_LEFT,
    BLINK_RIGHT,
    KEYS,
    TOUCHING,
    FaceSlits,
    are_parted,
    find_keys,
)

# Share of the gap that is closed. Head models add the same offsets to all persons, so that even true blinks leave a gap
# between lids that are farther apart. On the five heads that set the share, 0.4 and 0.5 raise errors on some of them.
CLOSED = 0.3
# Lengths relative to the distance between the eyes, about 65 mm.
RIM = 0.04  # around the rims of the source's lids: images of the target's
AROUND = 0.6  # an opening: where lids move
SMOOTHING = 0.08  # of the displacement, where weights are areas
MAX_GAP = 0.005  # that needs no note: 0.3 mm
# Weights of vertices relative to their areas, and of those on a rim relative to the mean area. What a blink
# moves by less than a share of its largest motion is fixed.
FREE, ON_RIM, FIXED = 0.05, 100.0, 1e4
HARDLY = 0.02


@dataclass(frozen=True, eq=False)
class _Lids:
    """Lids around an opening, among the n vertices of the target's working mesh."""

    frames: Frames
    skin: Booleans  # (n,) the vertices around the opening
    moves: Booleans  # (n,) those that the blink moves
    moving: Integers  # (p,) vertices on the rim with more motion
    still: Integers  # (p,) vertices opposite on the other rim
    wanted: Floats  # (p, 3) vectors from the other rim to the moving one when the source's eye is closed
    growth: Floats  # (p,) lengths on the target of unit lengths on the source

    @classmethod
    def of(cls, offsets: Floats, rim: Floats, size: float, frames: Frames) -> _Lids:
        """The lids that a key (n_s, 3) closes, by places (r, 3) on the source's rims and the distance of its eyes."""
        working, rest = frames.mapped.target.working, frames.points
        motion = on_working_mesh(working, frames.mapped.surface_map.interpolate(offsets))
        length = row_norms(motion)
        moves = length > HARDLY * length.max(initial=0)
        moves &= np.isin(np.arange(len(rest)), frames.number)
        near = row_norms(rest - rim.mean(axis=0)) < AROUND * size
        areas = vertex_areas(working.vertices, working.triangles)
        skin = near & (working.component == np.argmax(np.bincount(working.component, near * areas)))
        on_rim = np.flatnonzero(skin & (cKDTree(rim).query(rest, distance_upper_bound=RIM * size)[0] < np.inf))
        closed = rest + motion
        pairs = on_rim[cKDTree(closed[on_rim]).query_pairs(TOUCHING * size, output_type="ndarray")]
        shut, apart = (row_norms(shape[pairs[:, 0]] - shape[pairs[:, 1]]) for shape in (closed, rest))
        pairs = _orient(pairs[are_parted(shut, apart, float((apart - shut).max(initial=0)))], length, rest)
        moving, still = _nearest(pairs[moves[pairs[:, 0]]], closed).T
        turns = frames.steady_turns[np.searchsorted(frames.number, moving)]
        wanted = np.einsum("pxy,py->px", turns, closed[moving] - closed[still])
        return cls(frames, skin, moves, moving, still, wanted, np.linalg.norm(turns, axis=(1, 2)) / np.sqrt(3))

    def gaps(self, key: Floats) -> tuple[Floats, Floats]:
        """(p,) how much farther apart the rims are under a key (n_t, 3) than wanted, and the direction (3,) across."""
        working = self.frames.mapped.target.working
        places = working.scale * working.vertices
        across = unit_vectors((places[self.moving] - places[self.still]).mean(axis=0)[None])[0]
        posed = places + on_working_mesh(working, key)
        return np.maximum((posed[self.moving] - posed[self.still] - self.wanted) @ across, 0), across

    def extend(self, values: Floats, size: float) -> Floats:
        """(n,) values of the lid that moves, from those (p,) on its rim, by the distance of the source's eyes."""
        frames, n = self.frames, len(self.skin)
        count = np.bincount(self.moving, minlength=n)
        on_rim = np.bincount(self.moving, values, n) / np.maximum(count, 1)
        chosen = np.flatnonzero(self.skin[frames.number])
        inside = frames.number[chosen]
        areas = frames.areas[chosen]
        weights = areas * np.where(self.moves[inside], FREE, FIXED) + ON_RIM * areas.mean() * count[inside]
        length = SMOOTHING * size / np.sqrt(frames.mapped.source.area)
        smoothing = ScreenedSmoothing.of(weights, without_sums(frames.stiffness[chosen][:, chosen]), length)
        # Lashes follow the skin beside them.
        nearest = cKDTree(frames.points[inside]).query(frames.points, distance_upper_bound=AROUND * size)[1]
        extended = np.append(smoothing.smooth(on_rim[inside, None])[:, 0], 0)
        return np.where(self.moves, extended[nearest], 0)


def close_lids(transferred: Floats, keys: Attribute, face: FaceSlits, frames: Frames) -> tuple[str, ...]:
    """Close lids of a target under its keys (n_t, keys, 3), which change in place, by those of the source's face.

    Returns:
        Names of the keys that leave lids farther apart than on the source, by more than `MAX_GAP` on average.
    """
    source = frames.mapped.source
    rims = [source.vertices[face.vertices[np.concatenate(face.slits[use])]] for use in (BLINK_LEFT, BLINK_RIGHT)]
    if not all(len(rim) for rim in rims):
        return ()
    size = float(np.linalg.norm(rims[0].mean(axis=0) - rims[1].mean(axis=0)))
    still_open = []
    for use, rim in zip((BLINK_LEFT, BLINK_RIGHT), rims, strict=True):
        name = find_keys(keys, KEYS[use])[0]  # in no convention is a blink of one eye a sum of keys
        column = keys.labels.index(name)
        lids = _Lids.of(np.asarray(keys.values[:, column], dtype=np.float64), rim, size, frames)
        if _close(transferred[:, column], lids, size) > MAX_GAP * size:
            still_open.append(name)
    return tuple(still_open)


def _close(key: Floats, lids: _Lids, size: float) -> float:
    """Close lids under a key (n_t, 3), which changes in place.

    Returns the mean gap that remains, in the unit of the source.
    """
    if not len(lids.moving):
        return 0.0
    gaps, across = lids.gaps(key)
    vertex_of = lids.frames.mapped.target.working.vertex_of
    closing = np.append(CLOSED * lids.extend(gaps, size), 0)  # the last one is for vertices without a face
    key -= closing[vertex_of][:, None] * across
    return float((lids.gaps(key)[0] / lids.growth).mean())


def _orient(pairs: Integers, motion: Floats, rest: Floats) -> Integers:
    """Pairs (p, 2) with the rim first that moves by larger lengths (n,) on the whole, among places (n, 3)."""
    more = motion[pairs[:, 0]] > motion[pairs[:, 1]]
    pairs = np.where(more[:, None], pairs, pairs[:, ::-1])
    apart = rest[pairs[:, 0]] - rest[pairs[:, 1]]
    return np.where((apart @ apart.sum(axis=0) > 0)[:, None], pairs, pairs[:, ::-1])


def _nearest(pairs: Integers, places: Floats) -> Integers:
    """Those of pairs (p, 2) in which a vertex is with its nearest partner, among places (n, 3)."""
    order = np.argsort(row_norms(places[pairs[:, 0]] - places[pairs[:, 1]]), kind="stable")
    pairs = pairs[order]
    firsts = [np.unique(side, return_index=True)[1] for side in pairs.T]
    return pairs[np.unique(np.concatenate(firsts))]
