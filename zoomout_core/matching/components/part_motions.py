# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions of the rigid parts of a source: plates of a robot, boots, strands of hair.

The body's map bends smoothly at a joint, where plates slide over each other. Each part is registered to the vertices
that map to it, by iterated closest points: Besl and McKay, A method for registration of 3-D shapes (1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import Moments, Similarities, products
from zoomout_core.matching.components.parts import Side
from zoomout_core.matching.components.similarity_field import SimilarityField
from zoomout_core.tuning import Tuning, tuned

# Vertices by which a part is registered: at most, and at least; and the rounds.
MAX_SAMPLES, MIN_SAMPLES, ROUNDS = 64, 20, 12
# Ratio of a part's scale to the body's, at first, and to that of most parts afterwards: the same character keeps it.
ROUGH_SCALE, SAME_SCALE = 1.15, 1.02
# The distance, relative to the part's median, that halves a sample's weight.
HALF_WEIGHT = 2.0


@dataclass(frozen=True)
class PartMotionTuning(Tuning, set_by="everywhere"):
    """Which parts of a source move as rigid pieces."""

    # Nine tenths of the vertices of a rigid part are nearer to it. Plates have .001 to .014, clothes .02 and more.
    rigid: float = tuned(0.015, "at unit area", 0, 1)


PART_MOTIONS = PartMotionTuning()


@dataclass(frozen=True, eq=False)
class PartMotions:
    """Where the vertices of a target lie on the source, by the part that they belong to."""

    target: Side
    points: Floats  # (n, 3) by the body's map
    normals: Floats  # (n, 3) theirs there
    rigid: Booleans  # (c,) which parts of the source have a motion of their own
    similarities: Similarities  # (c,) that move the target onto the parts

    def carry(self, vertex: Integers, part: Integers) -> tuple[Floats, Floats]:
        """(q, 3) points and (q, 3) normals of vertices (q,) if they belong to parts (q,)."""
        points, normals = self.points[vertex], self.normals[vertex]
        own = self.rigid[part]
        points[own], normals[own] = _carry(self.target, self.similarities, vertex[own], part[own])
        return points, normals


def fit_motions(
    part: Integers,
    points: Floats,
    normals: Floats,
    usable: Booleans,
    surface: OrientedSurface,
    triangles: Integers,
    source: Side,
    target: Side,
    motion: SimilarityField,
) -> PartMotions:
    """Register the parts of a source to the vertices that map to them.

    Args:
        part: (n,) the part that each vertex of the target maps to.
        points: (n, 3) the vertices, moved to the source by the body's map.
        normals: (n, 3) theirs there.
        usable: (n,) which vertices to register by.
        surface: triangles of the source, grouped by part.
        triangles: (m, 3) these.
        source: the surface with the parts.
        target: the surface whose vertices are mapped.
        motion: that moved the vertices.
    """
    count = int(source.mesh.component.max()) + 1
    vertex = _choose_samples(part, target.points, np.flatnonzero(usable), count)
    of = part[vertex]
    places, turned, scales = points[vertex], normals[vertex], (motion.scale / ROUGH_SCALE, motion.scale * ROUGH_SCALE)
    first = np.searchsorted(of, np.arange(count + 1))
    tried = np.flatnonzero(np.diff(first))
    for number in range(ROUNDS):
        triangle, barycentric, distance = surface.closest(places, turned, of)
        images = np.einsum("nc,ncx->nx", barycentric, source.points[triangles[triangle]])
        median = np.zeros(count)
        median[tried] = [np.median(distance[first[i] : first[i + 1]]) for i in tried]
        weights = 1 / (1 + (distance / np.maximum(HALF_WEIGHT * median[of], 1e-9)) ** 2)
        weights /= np.bincount(of, weights, count)[of]
        share = csr_array((weights, (of, np.arange(len(of)))), shape=(count, len(of)))
        moments = Moments.of_products(share @ products(target.points[vertex], images))
        similarities = moments.similarities(motion.handedness, scales)
        if number == 1 and len(of):
            typical = float(np.median(similarities.scale[of[distance <= np.median(distance)]]))
            scales = typical / SAME_SCALE, typical * SAME_SCALE
        places, turned = _carry(target, similarities, vertex, of)
    distance = surface.closest(places, turned, of)[2]
    rigid = np.zeros(count, dtype=bool)
    rigid[tried] = [np.quantile(distance[first[i] : first[i + 1]], 0.9) <= PART_MOTIONS.rigid for i in tried]
    return PartMotions(target, points, normals, rigid, similarities)


def _choose_samples(part: Integers, points: Floats, usable: Integers, count: int) -> Integers:
    """Some of the usable vertices of each part (n,), by part; none of parts with few.

    They are evenly spread over the distances from the part's centre, in any order of vertices.
    """
    of = part[usable]
    size = np.bincount(of, minlength=count)
    centre = np.column_stack([np.bincount(of, x, count) for x in points[usable].T]) / np.maximum(size, 1)[:, None]
    away = np.linalg.norm(points[usable] - centre[of], axis=1)
    order = np.lexsort((away, of))
    first = np.concatenate([[0], np.cumsum(size)])
    chosen = [
        first[i] + np.linspace(0, size[i] - 1, min(size[i], MAX_SAMPLES)).astype(np.int64)
        for i in np.flatnonzero(size >= MIN_SAMPLES)
    ]
    return usable[order[np.concatenate([np.zeros(0, dtype=np.int64), *chosen])]]


def _carry(target: Side, similarities: Similarities, vertex: Integers, part: Integers) -> tuple[Floats, Floats]:
    """(q, 3) points and (q, 3) normals of vertices (q,), moved by the similarities of parts (q,)."""
    linear = similarities.linear[part]
    points = np.einsum("qij,qj->qi", linear, target.points[vertex]) + similarities.translation[part]
    return points, np.einsum("qij,qj->qi", similarities.rotation[part], target.mesh.vertex_normals[vertex])
