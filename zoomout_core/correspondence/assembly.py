"""From the map between two shapes' meshes to the map between whole surfaces, loose parts and all."""

from __future__ import annotations

import numpy as np

from zoomout_core.correspondence.pair import Pair
from zoomout_core.correspondence.parts import map_parts
from zoomout_core.correspondence.proxy import lifted
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.projection import closest_points
from zoomout_core.surface import Booleans, Floats


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
