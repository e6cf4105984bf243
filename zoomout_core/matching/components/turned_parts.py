# SPDX-License-Identifier: GPL-3.0-or-later
"""Loose parts that move by themselves, such as a head that looks aside, and the small parts on them.

The map of the body moves a head along with the collar. The head is registered to its partner, and eyes follow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.parts import MAX_PAIRED_PARTS, Part, Side
from zoomout_core.matching.components.shell_pairs import pair_shells
from zoomout_core.matching.components.similarity_field import SimilarityField
from zoomout_core.matching.pair import Pair
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class TurnedPartTuning(Tuning, set_by="characters"):
    """Which loose parts move by themselves."""

    # Smaller parts, as root mean square distance from the centre, follow the surface beside them.
    large: float = tuned(0.06, "at unit area", 0, 1)
    # A part moves by itself if its registration leaves less than this part of its distance from its partner. Shells of
    # characters in one pose have .57 at least, those of turned heads .02 to .27, unless both distances are tiny.
    nearer: float = tuned(0.4, "1", 0, 1)
    in_place: float = tuned(0.002, "at unit area", 0, 1)  # a part that is nearer to its partner is in place


TURNED_PARTS = TurnedPartTuning()


def register_turned_parts(
    pair: Pair,
    motion: SimilarityField,
    source: Side,
    target: Side,
    theirs: Sequence[Part],
    points: Floats,
    normals: Floats,
) -> tuple[Floats, Floats]:
    """Register large loose parts that move by themselves, and take the small parts on them along.

    Args:
        pair: the surfaces.
        motion: that of the body.
        source: the source.
        target: the target.
        theirs: the loose parts of the source.
        points: (n, 3) places of the target's vertices, moved with the body.
        normals: (n, 3) normals there.

    Returns:
        (n, 3) points and (n, 3) normals.
    """
    ours = target.parts(points)
    large = [_count_large(parts) for parts in (ours, theirs)]
    if pair.source is pair.target or not min(large):
        return points, normals
    pairs, similarities = pair_shells(pair, motion, ours[: large[0]], list(theirs[: large[1]]), source, target)
    points, normals, leader = points.copy(), normals.copy(), np.full(len(points), -1)
    for number, ((i, j), similarity) in enumerate(zip(pairs, similarities, strict=True)):
        part = ours[i]
        moved = similarity(target.points[part.vertices][None])[0]
        before, after = (_distance(places, part, theirs[j]) for places in (part.points, moved))
        if part.size >= TURNED_PARTS.large and TURNED_PARTS.in_place < before and after < TURNED_PARTS.nearer * before:
            leader[part.vertices] = number
    if (leader < 0).all():
        return points, normals
    small = np.concatenate([[], *(part.vertices for part in ours if part.size < TURNED_PARTS.large)]).astype(np.int64)
    others = np.setdiff1d(np.arange(len(points)), small)
    leader[small] = leader[others[cKDTree(target.points[others]).query(target.points[small])[1]]]
    for number in np.unique(leader[leader >= 0]):
        led, similarity = np.flatnonzero(leader == number), similarities[number]
        points[led] = similarity(target.points[led][None])[0]
        normals[led] = target.mesh.vertex_normals[led] @ similarity.rotation[0].T
    return points, normals


def _count_large(parts: Sequence[Part]) -> int:
    """How many of the first parts include all large ones."""
    large = [number for number, part in enumerate(parts[:MAX_PAIRED_PARTS]) if part.size >= TURNED_PARTS.large]
    return large[-1] + 1 if large else 0


def _distance(points: Floats, part: Part, partner: Part) -> float:
    """Root mean square distance of a part, its vertices at points (n, 3), from its partner."""
    on = SurfaceMap(*closest_points(points, partner.points, partner.corners), partner.corners)
    return float(np.sqrt(part.weights @ ((on.interpolate(partner.points) - points) ** 2).sum(axis=1)))
