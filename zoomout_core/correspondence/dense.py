"""From a candidate on samples to a dense, precise map, and from the parts' stand-ins to the surfaces."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from zoomout_core.correspondence.anchors import Anchors, beside
from zoomout_core.correspondence.nearest import nearest
from zoomout_core.correspondence.pair import Pair
from zoomout_core.correspondence.parts import map_parts
from zoomout_core.correspondence.proxy import lifted
from zoomout_core.correspondence.ranking import SCREENING_SIZE
from zoomout_core.correspondence.shape import Shape
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.correspondence.zoomout import upsample
from zoomout_core.projection import closest_points, project_to_embedding
from zoomout_core.surface import Booleans, Floats

# Rounds on all vertices, each near the last one's images: they take back most of what sampling has cost.
FINISHING = 3
# Coarser meshes than this do not resolve the functions alike, and a larger map is a worse one.
VERTICES_PER_FUNCTION = 16


def dense_steps(
    source: Shape, target: Shape, functional_map: Floats, anchors: Anchors | None, pair: Pair
) -> Generator[float, None, tuple[SurfaceMap, Floats]]:
    """ZoomOut to the final size on all samples, then a precise point for every vertex of the target's mesh."""
    available = min(len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    resolved = min(len(source.mesh.vertices), len(target.mesh.vertices)) // VERTICES_PER_FUNCTION
    size = min(pair.k_final, available, max(SCREENING_SIZE, resolved))
    start = min(SCREENING_SIZE, size, *functional_map.shape)
    at_samples = None if anchors is None else anchors.at(source.sampled.samples, target.sampled.samples)
    yield 0.0
    functional_map, _ = upsample(
        source.sampled, target.sampled, functional_map[:start, :start], size, pair.step, at_samples
    )
    k_target, k_source = functional_map.shape
    yield 0.4
    vertex = nearest(*embeddings(source, target, functional_map, anchors))
    for i in range(FINISHING):
        yield 0.7 + 0.3 * i / FINISHING
        queries, embedded = embeddings(source, target, functional_map, anchors)
        dense = SurfaceMap(
            *project_to_embedding(queries, embedded, source.mesh.triangles, vertex), source.mesh.triangles
        )
        vertex = dense.vertex
        pulled_back = dense.interpolate(source.basis.eigenvectors[:, :k_source])
        functional_map = target.basis.coefficients(pulled_back)[:k_target]
    return dense, functional_map


def embeddings(source: Shape, target: Shape, functional_map: Floats, anchors: Anchors | None) -> tuple[Floats, Floats]:
    """Coordinates (n_t, d) of the target's vertices and (n_s, d) of the source's, near where they correspond."""
    k_target, k_source = functional_map.shape
    embedded = source.basis.eigenvectors[:, :k_source] @ functional_map.T
    if anchors is None:
        return target.basis.eigenvectors[:, :k_target], embedded
    return beside(target.basis.eigenvectors[:, :k_target], anchors.target), beside(embedded, anchors.source)


def on_surfaces(pair: Pair, between: SurfaceMap, confidence: Floats) -> tuple[SurfaceMap, Floats, tuple[str, ...]]:
    """The map between the shapes' meshes as a map between the surfaces, in their own numbers.

    Args:
        pair: the surfaces and their shapes.
        between: from the target shape's mesh to the source shape's.
        confidence: (n,) of the target shape's vertices.

    Returns:
        The map, (n_t,) confidence, and what a user should know about loose parts.
    """
    source, target = pair.source_shape.proxy, pair.target_shape.proxy
    between_parts = lifted(between, source, target)
    confidence = target.place.interpolate(confidence)
    vertex_of = target.full.vertex_of
    inside = vertex_of >= 0
    n = len(pair.target.vertices)
    triangle, barycentric, trust = np.zeros(n, dtype=np.int64), np.tile([1.0, 0, 0], (n, 1)), np.zeros(n)
    triangle[inside] = source.full.triangle_of[between_parts.triangle[vertex_of[inside]]]
    barycentric[inside] = between_parts.barycentric[vertex_of[inside]]
    trust[inside] = confidence[vertex_of[inside]]
    body = SurfaceMap(triangle, barycentric, pair.source.triangles)
    return _with_loose_parts(pair, body, trust, inside)


def _with_loose_parts(
    pair: Pair, body: SurfaceMap, trust: Floats, on_body: Booleans
) -> tuple[SurfaceMap, Floats, tuple[str, ...]]:
    """The map of the largest part, extended to the others: to their partners, or along with the body."""
    source, target = pair.source, pair.target
    triangle, barycentric = body.triangle.copy(), body.barycentric.copy()
    outside = ~on_body & np.isfinite(target.vertices).all(axis=1)
    if outside.any():
        main = np.flatnonzero(on_body[target.triangles[:, 0]])
        place, weights = closest_points(target.vertices[outside], target.vertices, target.triangles[main])
        carried = body.at(source, target, main[place], weights)
        triangle[outside], barycentric[outside] = carried.triangle, carried.barycentric
    mapped, alone_target, alone_source = map_parts(source, target, body, np.flatnonzero(on_body))
    for part, onto, confidence in mapped:
        triangle[part.vertices], barycentric[part.vertices] = onto.triangle, onto.barycentric
        trust[part.vertices] = confidence
    notes = (
        (len(mapped), "{} paired with parts of the source by place and size."),
        (len(alone_target), "{} of the target without a partner: the nearest place of the body, with no confidence."),
        (len(alone_source), "{} of the source without a partner: nothing was matched to them."),
    )
    worded = tuple(text.format(f"{count} loose part" + "s" * (count != 1)) for count, text in notes if count)
    return SurfaceMap(triangle, barycentric, source.triangles), trust, worded
