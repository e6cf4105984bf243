# SPDX-License-Identifier: GPL-3.0-or-later
"""A loose part of the source is found where the target's skin has its shape, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from loose_parts import RADIUS, shape_of

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.component_mapping import ComponentMap, map_components
from zoomout_core.matching.components.fused_parts import FUSED_PARTS
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.report.verdict import VERDICT
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball, directions, outward_hull
from zoomout_core.tuning import retune

SIZE = 0.05
TOP = np.array([0.0, 0.0, RADIUS])
BODY, KNOB = ball(RADIUS, count=800), ball(SIZE, (0.0, 0.0, RADIUS), count=200)


def skin(size: float = SIZE, centre: np.ndarray = TOP) -> Surface:
    """One skin around the body and a ball whose centre is on it."""
    where = directions(2000, 1)
    along = where @ centre
    beyond = along + np.sqrt(np.maximum(along**2 - centre @ centre + size**2, 0))
    hits = (along > 0) & (np.linalg.norm(centre - along[:, None] * where, axis=1) < size)
    radius = np.where(hits, np.maximum(beyond, RADIUS), RADIUS)
    return Surface(radius[:, None] * where, outward_hull(where))


def tower(height: float) -> Surface:
    """One skin around the body and a tower on it, as wide as the part."""
    where = directions(2000, 1)
    inside = np.linalg.norm(where[:, :2], axis=1) < SIZE / RADIUS
    inside &= where[:, 2] > 0
    return Surface((RADIUS + height * inside)[:, None] * where, outward_hull(where))


def map_skin(target: Surface, part: Surface = KNOB, share: float = 0.02) -> tuple[Pair, ComponentMap]:
    """Map the parts of a body with one part, given that the map of the body is the nearest point."""
    source = Surface.joined([BODY, part])
    pair = Pair(source, target, shape_of(source), shape_of(target), 20, 10, shares=np.array([1 - share, share]))
    ours, theirs = pair.target_shape.proxy.full, pair.source_shape.proxy.full
    places = theirs.from_surface(ours.to_surface(ours.vertices))
    body = SurfaceMap(*closest_points(places, theirs.vertices, theirs.triangles), theirs.triangles)
    return pair, map_components(pair, body, np.ones(len(pair.target_shape.mesh.vertices)))


def test_skin_with_the_shape_of_a_part_maps_to_it() -> None:
    pair, found = map_skin(skin())
    assert (found.fused, found.left, len(found.left_vertices)) == (1, 0, 0)
    target, source = pair.target.working, pair.source.working
    height = np.linalg.norm(target.to_surface(target.vertices), axis=1) - RADIUS
    shown = np.zeros(len(height), dtype=bool)
    shown[found.image.vertices] = True
    assert shown[height > 0.2 * SIZE].all()
    assert not shown[np.linalg.norm(target.to_surface(target.vertices) - TOP, axis=1) > 1.2 * SIZE].any()
    corners = source.to_surface(source.vertices)[source.triangles[found.image.triangle]]
    images = np.einsum("nc,ncx->nx", found.image.barycentric, corners)
    off = np.linalg.norm(images - target.to_surface(target.vertices[found.image.vertices]), axis=1)
    assert off.max() < 0.2 * SIZE
    assert found.image.confidence.min() > 0.5


@pytest.mark.parametrize(
    "target",
    [
        BODY,
        skin(2.5 * SIZE),
        tower(2 * SIZE),
        skin(SIZE, RADIUS * np.array([0.15, 0, 0.99])),
        skin(SIZE, RADIUS * np.array([0.28, 0, 0.96])),
    ],
    ids=["none", "larger", "another shape", "beside", "elsewhere"],
)
def test_skin_without_the_shape_of_a_part_does_not_map_to_it(target: Surface) -> None:
    _, found = map_skin(target)
    assert (found.fused, found.left, len(found.image.vertices)) == (0, 1, 0)
    assert len(found.left_vertices) == len(KNOB.vertices)


def test_patch_that_fits_the_body_as_well_maps_to_the_body() -> None:
    near = np.linalg.norm(BODY.vertices - TOP, axis=1) < 2 * SIZE
    flush = Surface(1.004 * BODY.vertices, BODY.triangles[near[BODY.triangles].all(axis=1)])
    target = ball(RADIUS, count=1000, seed=1)
    assert map_skin(target, flush)[1].fused == 0
    with retune(FUSED_PARTS, gain=0.0):
        assert map_skin(target, flush)[1].fused == 1


def test_hidden_parts_are_not_searched() -> None:
    assert map_skin(skin(), share=0.9 * VERDICT.visible)[1].fused == 0
