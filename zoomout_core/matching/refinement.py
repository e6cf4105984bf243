"""From a candidate on samples to a dense, precise map."""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import project_to_embedding
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.nearest import nearest, nearest_among
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.confidence import spectral_distance
from zoomout_core.matching.local_rigid_alignment import (
    IMAGE_FUNCTIONS,
    Alignment,
    align,
    align_and_match,
    beside_places,
)
from zoomout_core.matching.ranking import SCREENING_SIZE

# The weight of places in space is lower once the map has settled: along the surface, shapes that are nearly isometric
# agree better than any target can be laid. Below the usual ratio (see below) it falls off with this power more.
SETTLING_WEIGHT, STEEPNESS = 0.2, 4
# On all vertices eigenfunctions decide; places in space, at this weight, keep triangles from turning over. Places are
# known no better where there are more functions than so many, so that the weight falls as the functions' own grows.
FINISHING_WEIGHT, FINISHING_SIZE = 0.05, 120
# These weights are for shapes whose images miss, squared, by so much more along the surface than in space. The less
# alike shapes are, the larger is that ratio, and the weights grow with its square, within limits.
USUAL_RATIO, LEAST_REGARD, MOST_REGARD = 2.5, 0.2, 4.0
# The image of a vertex is sought among so many vertices around the nearest sample of the source.
AROUND_SAMPLE = 48
# Coarser meshes than this do not resolve the functions alike, and a larger map is a worse one.
VERTICES_PER_FUNCTION = 16


class Schedule(NamedTuple):
    """Rounds on samples.

    Attributes:
        laying: size of the functional map, and diffusion length over which images are smoothed: the target is laid
            over the source, which settles the sense of its limbs.
        settling: sizes of the functional map, which grows once more, with less regard to space.
    """

    laying: tuple[tuple[int, float], ...]
    settling: tuple[int, ...]


BETWEEN_SHAPES = Schedule(((30, 0.08), (60, 0.06), (120, 0.04), (120, 0.04)), (30, 50, 70, 90, 120))
# Nothing is as nearly isometric to a shape as the shape itself, and few rounds lead as far.
ONTO_ITSELF = Schedule(((30, 0.08), (60, 0.06)), (90, 120))


def dense_steps(
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    functional_map: Floats,
    anchors: Anchors | None,
    mirrored: bool,
    k_final: int,
    step: int,
    schedule: Schedule = BETWEEN_SHAPES,
) -> Generator[float, None, tuple[SurfaceMap, Floats]]:
    """From a candidate's functional map to a precise point for every vertex of the target's mesh.

    Args:
        source: the shape that the map lands on.
        target: the shape that the map starts from.
        functional_map: (k_target, k_source) of the candidate.
        anchors: what holds it in place, at all vertices.
        mirrored: it maps the target's mirror image.
        k_final: size of the final functional map; less on coarse meshes.
        step: its growth in an iteration, once the target is laid over the source.
        schedule: of the rounds on samples; a single one on all vertices follows.

    Yields:
        The fraction done.

    Returns:
        The map between the shapes' meshes, and its functional map.
    """
    available = min(len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    resolved = min(len(source.mesh.vertices), len(target.mesh.vertices)) // VERTICES_PER_FUNCTION
    size = min(k_final, available, max(SCREENING_SIZE, resolved))
    at_samples = None if anchors is None else Anchors(anchors.source, anchors.target[target.sampled.samples])
    eigenvectors = source.basis.eigenvectors
    yield 0.0
    vertex = nearest(*coordinates(target.sampled.rows, eigenvectors, functional_map, at_samples))
    how = target.sampled, at_samples
    for i, (k, width) in enumerate(schedule.laying):
        yield 0.3 * i / len(schedule.laying)
        # While the map is still to grow, the source's samples are close enough.
        among = source.sampled.samples if k < size else slice(None)
        vertex, laid = align_and_match(vertex, source, target, *how, min(k, size), width, mirrored, among)
    regard = _regard_for_space(vertex, laid, source, target, size)
    settling = [*(min(k, size) for k in schedule.settling), *range(schedule.settling[-1] + step, size, step)]
    for i, k in enumerate(settling):
        yield 0.3 + 0.4 * i / len(settling)
        weight = SETTLING_WEIGHT * regard * min(1.0, regard) ** STEEPNESS
        vertex, _ = align_and_match(vertex, source, target, *how, k, width, mirrored, weight=weight)
    functional_map = target.sampled.fit(eigenvectors[vertex, :size], size)
    size_of_images = min(IMAGE_FUNCTIONS, available)
    images = target.sampled.fit(source.mesh.vertices[vertex], size_of_images)
    normals = target.sampled.fit(source.mesh.vertex_normals[vertex], size_of_images)
    weight = FINISHING_WEIGHT * regard * min(1.0, FINISHING_SIZE / size) ** 2
    yield 0.7
    laid = align(images, target, width, mirrored)
    laid = laid.facing(target.basis.eigenvectors[:, :size_of_images] @ normals, source, target)
    pair = embeddings(source, target, functional_map, anchors)
    queries, embedded = beside_places(*pair, laid, source, size, weight)
    near = _nearest_near_samples(queries, embedded, source)
    yield 0.85
    dense = SurfaceMap(*project_to_embedding(queries, embedded, source.neighbourhoods, near), source.mesh.triangles)
    functional_map = target.basis.coefficients(dense.interpolate(eigenvectors[:, :size]))[:size]
    return dense, functional_map


def _regard_for_space(
    vertex: Integers, laid: Alignment, source: ShapeAnalysis, target: ShapeAnalysis, size: int
) -> float:
    """What to multiply the weight of places in space by, from how far a map misses in space and along the surface.

    Args:
        vertex: (s,) the source vertex of each of the target's samples.
        laid: the samples, laid over the source.
        source: the shape that the map lands on.
        target: the shape that the map starts from.
        size: of the functional map.
    """
    images = source.basis.eigenvectors[vertex, :size]
    mapped = images @ target.sampled.fit(images, size).T
    along = spectral_distance(target.sampled.rows[:, :size], mapped, target.basis.eigenvalues[:size])
    across = np.linalg.norm(laid.positions - source.mesh.vertices[vertex], axis=1)
    ratio = (along.mean() / max(across.mean(), 1e-9)) ** 2
    return float(np.clip((ratio / USUAL_RATIO) ** 2, LEAST_REGARD, MOST_REGARD))


def _nearest_near_samples(queries: Floats, embedded: Floats, source: ShapeAnalysis) -> Integers:
    """(n_t,) the source vertex nearest to each query, among those around the nearest sample."""
    vertices, samples = source.mesh.vertices, source.sampled.samples
    around = np.asarray(cKDTree(vertices).query(vertices[samples], min(AROUND_SAMPLE, len(vertices)))[1])
    return nearest_among(queries, embedded, around[nearest(queries, embedded[samples])])


def embeddings(
    source: ShapeAnalysis, target: ShapeAnalysis, functional_map: Floats, anchors: Anchors | None
) -> tuple[Floats, Floats]:
    """Coordinates (n_t, d) of the target's vertices and (n_s, d) of the source's, near where they correspond."""
    return coordinates(target.basis.eigenvectors, source.basis.eigenvectors, functional_map, anchors)
