# SPDX-License-Identifier: GPL-3.0-or-later
"""From a candidate on samples to a dense, precise map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.embedded_surface import project_to_embedding
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.nearest import nearest, nearest_among
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.rank import RANKING
from zoomout_core.matching.refinement.confidence import spectral_distance
from zoomout_core.matching.refinement.local_rigid_alignment import (
    RIGID_ALIGNMENT,
    Alignment,
    SampledPair,
    align,
    align_and_match,
    beside_places,
)
from zoomout_core.runtime.progress import advance
from zoomout_core.tuning import Tuning, tuned

# Rounds on samples at the final size: a smaller step adds sizes below that, not rounds at it.
MAX_ROUNDS_AT_FINAL_SIZE = 5


class Schedule(NamedTuple):
    """Rounds on samples."""

    # Size of the functional map, and diffusion length, at unit area, over which images are smoothed, when the target is
    # aligned with the source in space. The alignment decides the orientation of its limbs.
    aligning: tuple[tuple[int, float], ...]
    # First and last size of the functional map, which grows again by the step, with a lower weight of positions in
    # space.
    settling: tuple[int, int]

    def settling_sizes(self, step: int, size: int) -> list[int]:
        """Sizes of the functional map while it settles, growing by `step`: the last step is the longest.

        The size of the final functional map limits the schedule or continues it.
        """
        first, last = self.settling
        scheduled = [*range(first, max(first, last - step) + 1, step), last]
        growing = [k for k in scheduled if k < size]
        at_final_size = min(len(scheduled) - len(growing), MAX_ROUNDS_AT_FINAL_SIZE)
        return [*growing, *[size] * at_final_size, *range(last + step, size, step)]


@dataclass(frozen=True)
class RefinementTuning(Tuning, set_by="correspondence"):
    """The rounds, and the weights of positions in space.

    The weights of positions hold for shapes of the usual ratio of misses along the surface and in space. The less alike
    shapes are, the larger is that ratio, and the weights grow with its square, within limits.
    """

    # Rounds of two shapes.
    between_shapes: Schedule = tuned(
        Schedule(((30, 0.08), (60, 0.06), (120, 0.04), (120, 0.04)), (30, 120)),
        "eigenfunctions, and lengths at unit area",
        0,
        1000,
    )
    # Rounds of a shape with itself, which is isometric: fewer rounds lead as far.
    onto_itself: Schedule = tuned(
        Schedule(((30, 0.08), (60, 0.06)), (90, 120)), "eigenfunctions, and lengths at unit area", 0, 1000
    )
    # Weight of positions in space in the rounds of settling. Nearly isometric shapes agree better along the surface
    # than any alignment in space.
    settling_weight: float = tuned(0.2, "1", 0, 100)
    steepness: float = tuned(4, "1", 0, 20)  # below the usual ratio it falls with this power of the factor more
    # Weight of positions in space on all vertices, where eigenfunctions decide; it keeps triangles from turning over.
    finishing_weight: float = tuned(0.05, "1", 0, 100)
    # Size of the functional map above which that weight falls with the inverse square of the size, as further
    # eigenfunctions do not improve positions.
    finishing_size: int = tuned(120, "eigenfunctions", 1, 1000)
    usual_ratio: float = tuned(2.5, "1", 0.01, 100)  # of the squares of the mean misses along the surface and in space
    min_factor: float = tuned(0.2, "1", 0, 1)  # of the weights
    max_factor: float = tuned(4.0, "1", 1, 100)  # of the weights
    around_sample: int = tuned(48, "vertices", 1, 10_000)  # around the nearest sample, to search for an image
    vertices_per_function: int = tuned(16, "vertices", 1, 1000)  # on coarser meshes, larger maps are worse
    max_functions_back: int = tuned(120, "eigenfunctions", 4, 1000)  # of the map back, for the confidence


REFINEMENT = RefinementTuning()


def refine(
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    functional_map: Floats,  # (k_target, k_source) of the candidate
    anchors: Anchors | None,  # that keep it in place, at all vertices
    mirrored: bool,  # it maps the target's mirror image
    k_final: int,  # size of the final functional map; less on coarse meshes
    step: int,  # its growth in a round, once the target is aligned with the source
    # Schedule of the rounds on samples, None for that of two shapes; a single one on all vertices follows.
    schedule: Schedule | None = None,
) -> tuple[SurfaceMap, Floats]:
    """From a candidate's functional map to a precise map between the shapes' meshes, and its functional map."""
    size = final_size(source, target, k_final)
    schedule = REFINEMENT.between_shapes if schedule is None else schedule
    pair = SampledPair.of(source, target, target.sampled, anchors, mirrored)
    vertex = nearest(*coordinates(pair.sampled.rows, source.basis.eigenvectors, functional_map, pair.anchors))
    for i, (k, width) in enumerate(schedule.aligning):
        advance(0.3 * i / len(schedule.aligning))
        # While the map is still to grow, the source's samples are close enough.
        among = source.sampled.samples if k < size else slice(None)
        vertex, aligned = align_and_match(vertex, pair, min(k, size), width, among)
    factor = _weight_factor(vertex, aligned, source, target, size)
    weight = REFINEMENT.settling_weight * factor * min(1.0, factor) ** REFINEMENT.steepness
    settling, (_, last_width) = schedule.settling_sizes(step, size), schedule.aligning[-1]
    for i, k in enumerate(settling):
        advance(0.3 + 0.4 * i / len(settling))
        vertex, _ = align_and_match(vertex, pair, k, last_width, weight=weight)
    advance(0.7)
    weight = REFINEMENT.finishing_weight * factor * min(1.0, REFINEMENT.finishing_size / size) ** 2
    dense = _map_all_vertices(vertex, pair, anchors, size, last_width, weight)
    return dense, functional_map_by(dense, source, target, (size, size))


def _map_all_vertices(
    vertex: Integers,  # (s,) the source vertex of each of the target's samples
    pair: SampledPair,
    anchors: Anchors | None,  # at all vertices
    size: int,  # of the functional map
    width: float,  # see `align`
    weight: float,  # of positions in space, beside eigenfunctions
) -> SurfaceMap:
    """One round on all vertices: the precise map in spectral and spatial coordinates, from a map of samples."""
    source, target, sampled = pair.source, pair.target, pair.sampled
    eigenvectors = source.basis.eigenvectors
    functional_map = sampled.fit(eigenvectors[vertex, :size], size)
    size_of_images = min(RIGID_ALIGNMENT.image_functions, _available(source, target))
    images = sampled.fit(source.mesh.vertices[vertex], size_of_images)
    normals = sampled.fit(source.mesh.vertex_normals[vertex], size_of_images)
    aligned = align(images, target, width, pair.mirrored)
    aligned = aligned.facing(target.basis.eigenvectors[:, :size_of_images] @ normals, source, target)
    coordinates_of_both = coordinates(target.basis.eigenvectors, eigenvectors, functional_map, anchors)
    queries, embedded = beside_places(*coordinates_of_both, aligned, source, size, weight)
    near = _nearest_near_samples(queries, embedded, source)
    advance(0.85)
    return SurfaceMap(*project_to_embedding(queries, embedded, source.neighbourhoods, near), source.mesh.triangles)


def final_size(source: ShapeAnalysis, target: ShapeAnalysis, k_final: int) -> int:
    """Size of the functional map of a refined map: `k_final`, or less on coarse meshes."""
    resolved = min(len(source.mesh.vertices), len(target.mesh.vertices)) // REFINEMENT.vertices_per_function
    return min(k_final, _available(source, target), max(RANKING.screening_size, resolved))


def _available(source: ShapeAnalysis, target: ShapeAnalysis) -> int:
    """Number of eigenfunctions that both shapes have."""
    return min(len(source.basis.eigenvalues), target.sampled.rows.shape[1])


def functional_map_by(
    surface_map: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis, size: tuple[int, ...]
) -> Floats:
    """(k_target, k_source) functional map of a map between the meshes of two shapes."""
    images = surface_map.interpolate(source.basis.eigenvectors[:, : size[1]])
    return target.basis.coefficients(images)[: size[0]]


def _weight_factor(
    vertex: Integers, aligned: Alignment, source: ShapeAnalysis, target: ShapeAnalysis, size: int
) -> float:
    """Factor of the weights of positions in space, from the errors of a map (s,) in space and along the surface."""
    images = source.basis.eigenvectors[vertex, :size]
    mapped = images @ target.sampled.fit(images, size).T
    along = spectral_distance(target.sampled.rows[:, :size], mapped, target.basis.eigenvalues[:size])
    across = np.linalg.norm(aligned.positions - source.mesh.vertices[vertex], axis=1)
    ratio = (along.mean() / max(across.mean(), 1e-9)) ** 2
    return float(np.clip((ratio / REFINEMENT.usual_ratio) ** 2, REFINEMENT.min_factor, REFINEMENT.max_factor))


def _nearest_near_samples(queries: Floats, embedded: Floats, source: ShapeAnalysis) -> Integers:
    """(n_t,) the source vertex nearest to each query, among those around the nearest sample."""
    vertices, samples = source.mesh.vertices, source.sampled.samples
    around = np.asarray(cKDTree(vertices).query(vertices[samples], min(REFINEMENT.around_sample, len(vertices)))[1])
    return nearest_among(queries, embedded, around[nearest(queries, embedded[samples])])
