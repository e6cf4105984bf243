# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions of the rigid pieces of a source: plates of a robot, boots, strands of hair, the trunk and sleeves of a shirt.

The body's map bends smoothly at a joint, where plates slide over each other and clothes bend sharply. Iterated closest
points register each part to the vertices that map to it: Besl and McKay, A method for registration of 3-D shapes
(1992). A part that bends is divided into pieces by place and rotation: Ward, Hierarchical grouping to optimize an
objective function (1963).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import Moments, Similarities, products
from zoomout_core.matching.components.parts import Side
from zoomout_core.matching.components.similarity_field import SimilarityField
from zoomout_core.tuning import Tuning, tuned

# Maximum and minimum number of vertices that register a part.
MAX_SAMPLES, MIN_SAMPLES = 64, 20
# Maximum number of rounds of a registration, and the motion, at unit area, below which most samples have converged.
ROUNDS, CONVERGED_MOTION = 12, 3e-4
# Vertices of a part that bends, at most: with half as many, pieces of a suit are too few to be registered.
BENDING_SAMPLES = 400
# The distance, at unit area, that counts as much as a unit difference of rotations, and the largest distance between
# clusters (Ward's) of a piece.
TURN_WEIGHT, PIECE_SPREAD = 0.15, 1.2
# Distance of parts in an extra coordinate, at unit area: samples of another part are never the nearest.
APART = 1e3
# Ratio of a part's scale to the body's, at first, and to that of most parts afterwards: the same character keeps it.
ROUGH_SCALE, SAME_SCALE = 1.15, 1.02
# The distance, relative to the median, that halves a sample's weight.
HALF_WEIGHT = 2.0


@dataclass(frozen=True)
class PartMotionTuning(Tuning, set_by="everywhere"):
    """Which parts of a source, and which pieces of them, are rigid."""

    # Nine tenths of the vertices of a rigid part are nearer to it. Plates have .001 to .014, clothes .02 and more.
    rigid: float = tuned(0.015, "at unit area", 0, 1)
    # The same for a piece of a part that bends: smaller pieces fit more places.
    rigid_piece: float = tuned(0.01, "at unit area", 0, 1)


PART_MOTIONS = PartMotionTuning()


@dataclass(frozen=True, eq=False)
class PartMotions:
    """Places of a target's vertices on the source, by the part that they belong to."""

    target: Side
    points: Floats  # (n, 3) by the body's map
    normals: Floats  # (n, 3) theirs there
    samples: Integers  # (s,) vertices by which pieces are registered
    part: Integers  # (s,) the part of each
    piece: Integers  # (s,) the piece of each
    rigid: Booleans  # (p,) which pieces have a motion of their own
    similarities: Similarities  # (p,) that move the target onto the pieces

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._rows(self.samples, self.part))

    def _rows(self, vertex: Integers, part: Integers) -> Floats:
        """(q, 4) coordinates of vertices (q,) of parts (q,) in the tree."""
        return np.column_stack([self.target.points[vertex], APART * part])

    def pieces(self, vertex: Integers, part: Integers) -> Integers:
        """(q,) the rigid pieces of vertices (q,) if they belong to parts (q,), -1 if they move with the body."""
        if not len(self.samples) or not len(vertex):
            return np.full(len(vertex), -1)
        distance, near = self._tree.query(self._rows(vertex, part))
        piece = self.piece[near]
        return np.where((distance < APART / 2) & self.rigid[piece], piece, -1)

    def transform(self, vertex: Integers, part: Integers) -> tuple[Floats, Floats]:
        """(q, 3) points and (q, 3) normals of vertices (q,) if they belong to parts (q,)."""
        points, normals, piece = self.points[vertex], self.normals[vertex], self.pieces(vertex, part)
        own = piece >= 0
        points[own], normals[own] = _transform(self.target, self.similarities, vertex[own], piece[own])
        return points, normals


class MovedTarget(NamedTuple):
    """The target's working mesh, moved onto the source by the map of the body."""

    points: Floats  # (n, 3) its vertices
    normals: Floats  # (n, 3) their normals
    motion: SimilarityField
    in_place: bool  # whether the two surfaces overlap, and are not moved


def fit_motions(
    part: Integers, moved: MovedTarget, usable: Booleans, surface: OrientedSurface, source: Side, target: Side
) -> PartMotions:
    """Register the parts of a source, or their pieces, to the vertices that map to them.

    Args:
        part: (n,) the part that each vertex of the target maps to.
        moved: the target, moved to the source.
        usable: (n,) which vertices to register by.
        surface: triangles of the source, grouped by part.
        source: the surface with the parts.
        target: the surface whose vertices are mapped.
    """
    points, normals, motion, _ = moved
    count = int(source.mesh.component.max()) + 1

    def closest(places: Floats, turned: Floats, of_part: Integers) -> tuple[Floats, Floats]:
        triangle, barycentric, distance = surface.closest(places, turned, of_part)
        return surface.points_at(triangle, barycentric), distance

    def register(vertex: Integers, piece: Integers, scales: tuple[float, float]) -> _Registration:
        start = points[vertex], normals[vertex]
        return _register(vertex, piece, part[vertex], start, closest, target, motion.handedness, scales)

    whole = _choose_samples(part, target.points, np.flatnonzero(usable), count, MAX_SAMPLES)
    _, number = np.unique(part[whole], return_inverse=True)
    wholes = register(whole, number, (motion.scale / ROUGH_SCALE, motion.scale * ROUGH_SCALE))
    rigid = wholes.distance <= PART_MOTIONS.rigid
    bends = np.zeros(count, dtype=bool)
    bends[part[whole[~rigid[number]]]] = True
    kept = ~bends[part[whole]]
    bent = _choose_samples(part, target.points, np.flatnonzero(usable & bends[part]), count, BENDING_SAMPLES)
    bent, of_bent = _divide(bent, part[bent], target.points[bent], motion)
    pieces = register(bent, of_bent, wholes.scales)
    samples = np.concatenate([whole[kept], bent])
    return PartMotions(
        target,
        points,
        normals,
        samples,
        part[samples],
        np.concatenate([number[kept], of_bent + len(rigid)]),
        np.concatenate([rigid, pieces.distance <= PART_MOTIONS.rigid_piece]),
        Similarities.concatenate([wholes.similarities, pieces.similarities]),
    )


class _Registration(NamedTuple):
    """Similarities that register pieces of a target to a source."""

    similarities: Similarities  # (p,)
    distance: Floats  # (p,) nine tenths of the vertices of each piece are nearer
    scales: tuple[float, float]  # the range of scales


def _register(
    vertex: Integers,
    piece: Integers,
    part: Integers,
    start: tuple[Floats, Floats],
    closest: Callable[[Floats, Floats, Integers], tuple[Floats, Floats]],
    target: Side,
    handedness: float,
    scales: tuple[float, float],
) -> _Registration:
    """Register vertices (s,) of pieces (s,), ascending, to parts (s,), starting from places and normals (s, 3).

    `closest` returns the closest points (s, 3) for places (s, 3) with normals (s, 3) on parts (s,), and the distances.
    """
    count = int(piece.max()) + 1 if len(piece) else 0
    ranges = np.split(np.arange(len(piece)), np.searchsorted(piece, np.arange(1, count)))[:count]
    places, turned = start
    for number in range(ROUNDS):
        images, distance = closest(places, turned, part)
        median = np.array([np.median(distance[some]) for some in ranges])
        weights = robust_weights(distance, median[piece])
        weights /= np.bincount(piece, weights, count)[piece]
        share = csr_array((weights, (piece, np.arange(len(piece)))), shape=(count, len(piece)))
        moments = Moments.of_products(np.asarray(share @ products(target.points[vertex], images)))
        similarities = moments.similarities(handedness, scales)
        if number == 1 and len(piece):
            typical = float(np.median(similarities.scale[piece[distance <= np.median(distance)]]))
            scales = typical / SAME_SCALE, typical * SAME_SCALE
        before = places
        places, turned = _transform(target, similarities, vertex, piece)
        motion = np.linalg.norm(places - before, axis=1)
        if number > 1 and 2 * np.count_nonzero(motion < CONVERGED_MOTION) > len(motion):
            break
    _, distance = closest(places, turned, part)
    return _Registration(similarities, np.array([np.quantile(distance[some], 0.9) for some in ranges]), scales)


def robust_weights(distances: Floats, median: Floats | float) -> Floats:
    """(s,) Cauchy's weights of samples at distances (s,) from their images, whose median is given, at unit area."""
    return np.asarray(1 / (1 + (distances / np.maximum(HALF_WEIGHT * median, 1e-9)) ** 2))


def _divide(vertex: Integers, part: Integers, points: Floats, motion: SimilarityField) -> tuple[Integers, Integers]:
    """Divide the vertices (s,) of parts (s,), ascending, by their points (s, 3) and the rotation of the body there.

    Returns the vertices (k,) of pieces that are large enough, and their pieces (k,), ascending.
    """
    from scipy.cluster.hierarchy import fcluster, linkage  # on first use: few shapes need it

    features = np.column_stack([TURN_WEIGHT * motion.rotations(points).reshape(-1, 9), points])
    clusters = np.zeros(len(vertex), dtype=np.int64)
    for number in np.unique(part):
        own = part == number
        clusters[own] = fcluster(linkage(features[own], "ward"), PIECE_SPREAD, "distance")
    _, piece, size = np.unique(np.stack([part, clusters]), axis=1, return_inverse=True, return_counts=True)
    piece = piece.ravel()
    order = np.argsort(piece, kind="stable")
    order = order[size[piece[order]] >= MIN_SAMPLES]
    return vertex[order], np.unique(piece[order], return_inverse=True)[1]


def _choose_samples(part: Integers, points: Floats, usable: Integers, count: int, max_count: int) -> Integers:
    """Choose at most `max_count` usable vertices of each part (n,), by part, and none of parts with few.

    They are evenly spread over the distances from the part's centre, in any order of vertices.
    """
    of = part[usable]
    size = np.bincount(of, minlength=count)
    centre = np.column_stack([np.bincount(of, x, count) for x in points[usable].T]) / np.maximum(size, 1)[:, None]
    away = np.linalg.norm(points[usable] - centre[of], axis=1)
    order = np.lexsort((away, of))
    first = np.concatenate([[0], np.cumsum(size)])
    chosen = [
        first[i] + np.linspace(0, size[i] - 1, min(size[i], max_count)).astype(np.int64)
        for i in np.flatnonzero(size >= MIN_SAMPLES)
    ]
    return usable[order[np.concatenate([np.zeros(0, dtype=np.int64), *chosen])]]


def _transform(target: Side, similarities: Similarities, vertex: Integers, piece: Integers) -> tuple[Floats, Floats]:
    """(q, 3) points and (q, 3) normals of vertices (q,), moved by the similarities of pieces (q,)."""
    linear = similarities.linear[piece]
    points = np.einsum("qij,qj->qi", linear, target.points[vertex]) + similarities.translation[piece]
    return points, np.einsum("qij,qj->qi", similarities.rotation[piece], target.mesh.vertex_normals[vertex])
