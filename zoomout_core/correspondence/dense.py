"""From a candidate on samples to a dense, precise map."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.correspondence.anchors import Anchors, coordinates
from zoomout_core.correspondence.laying import IMAGE_FUNCTIONS, beside_places, lay, lay_and_match
from zoomout_core.correspondence.nearest import nearest, nearest_among
from zoomout_core.correspondence.ranking import SCREENING_SIZE
from zoomout_core.correspondence.shape import Shape
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.projection import Neighbourhoods, project_to_embedding
from zoomout_core.surface import Floats, Integers

# Rounds on samples: size of the functional map, diffusion length over which images are smoothed, and weight of places
# in space. The first ones lay the target over the source, which settles the sense of its limbs. Shapes that are nearly
# isometric agree better along the surface than any target can be laid, so then the map grows once more, with less
# regard to space.
ROUNDS = (
    *((30, 0.08, 1.0), (60, 0.06, 1.0), (120, 0.04, 1.0), (120, 0.04, 1.0)),
    *((30, 0.04, 0.2), (50, 0.04, 0.2), (70, 0.04, 0.2), (90, 0.04, 0.2), (120, 0.04, 0.2)),
)
# Rounds on all vertices, each near the last one's images: they take back what sampling has cost. Eigenfunctions
# decide them; places in space, at this weight, keep triangles from turning over.
FINISHING = 6
FINISHING_WEIGHT = 0.05
# The first of these rounds looks among so many vertices around the nearest sample of the source.
AROUND_SAMPLE = 48
# Coarser meshes than this do not resolve the functions alike, and a larger map is a worse one.
VERTICES_PER_FUNCTION = 16


def dense_steps(
    source: Shape,
    target: Shape,
    functional_map: Floats,
    anchors: Anchors | None,
    mirrored: bool,
    k_final: int,
    step: int,
    finishing: int = FINISHING,
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
        finishing: rounds on all vertices, one at least.

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
    rounds = _rounds(size, step)
    for i, (k, width, weight) in enumerate(rounds):
        yield 0.5 * i / len(rounds)
        # While the target is but laid, and the map still to grow, the source's samples are close enough.
        among = source.sampled.samples if weight == 1.0 and k < size else slice(None)
        vertex, _ = lay_and_match(vertex, source, target, target.sampled, at_samples, k, width, mirrored, among, weight)
    functional_map = target.sampled.fit(eigenvectors[vertex, :size], size)
    size_of_images = min(IMAGE_FUNCTIONS, available)
    images = target.sampled.fit(source.mesh.vertices[vertex], size_of_images)
    normals = target.sampled.fit(source.mesh.vertex_normals[vertex], size_of_images)
    neighbourhoods = Neighbourhoods(source.mesh.triangles, len(eigenvectors))
    near = None
    for i in range(finishing):
        yield 0.5 + 0.5 * i / finishing
        laid = lay(images, target, width, mirrored)
        laid = laid.facing(target.basis.eigenvectors[:, :size_of_images] @ normals, source, target)
        pair = embeddings(source, target, functional_map, anchors)
        queries, embedded = beside_places(*pair, laid, source, size, FINISHING_WEIGHT)
        if near is None:
            near = _nearest_near_samples(queries, embedded, source)
            yield 0.5 + 0.25 / finishing
        dense = SurfaceMap(*project_to_embedding(queries, embedded, neighbourhoods, near), source.mesh.triangles)
        near = dense.vertex
        functional_map = target.basis.coefficients(dense.interpolate(eigenvectors[:, :size]))[:size]
        images = target.basis.coefficients(dense.interpolate(source.mesh.vertices))[:size_of_images]
    return dense, functional_map


def _rounds(size: int, step: int) -> list[tuple[int, float, float]]:
    """Those of `ROUNDS`, as far as the final size allows, then growth to it."""
    largest, width, weight = ROUNDS[-1]
    growth = ((k, width, weight) for k in range(largest + step, size, step))
    return [*((min(k, size), width, weight) for k, width, weight in ROUNDS), *growth]


def _nearest_near_samples(queries: Floats, embedded: Floats, source: Shape) -> Integers:
    """(n_t,) the source vertex nearest to each query, among those around the nearest sample."""
    vertices, samples = source.mesh.vertices, source.sampled.samples
    around = np.asarray(cKDTree(vertices).query(vertices[samples], min(AROUND_SAMPLE, len(vertices)))[1])
    return nearest_among(queries, embedded, around[nearest(queries, embedded[samples])])


def embeddings(source: Shape, target: Shape, functional_map: Floats, anchors: Anchors | None) -> tuple[Floats, Floats]:
    """Coordinates (n_t, d) of the target's vertices and (n_s, d) of the source's, near where they correspond."""
    return coordinates(target.basis.eigenvectors, source.basis.eigenvectors, functional_map, anchors)
