# SPDX-License-Identifier: GPL-3.0-or-later
"""Non-rigid ICP: deform the target onto the source until the two surfaces coincide.

Eigenfunctions locate points to a few hundredths of a shape's size. Positions in space are far more exact if both shapes
are the same body in two poses: its parts move nearly rigidly, so a registered part coincides with the other surface. A
deformation graph carries rotations and translations, which neighbouring nodes share (Sumner, Schmid and Pauly, Embedded
deformation for shape manipulation, 2007). It is fitted by the Gauss-Newton method to closest points with compatible
normals. Mainly distances across the surface count, so that parts may slide into place (Li, Adams, Guibas and Pauly,
Robust single-view geometry and motion reconstruction, 2009).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers, any_in_row
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.proxy import Proxy, full_images
from zoomout_core.matching.refinement.confidence import spectral_distance
from zoomout_core.matching.refinement.local_rigid_alignment import RIGID_ALIGNMENT, align
from zoomout_core.matching.registration.correspondences import (
    MIN_WEIGHT,
    ROBUST_SCALE,
    GeodesicLimit,
    QueryPoints,
    Surroundings,
    residuals,
)
from zoomout_core.matching.registration.deformation_graph import DeformationGraph, Nodes
from zoomout_core.matching.registration.rigid_icp import rigid_vertices, settle
from zoomout_core.mesh.affine_maps import mirror_factors
from zoomout_core.mesh.triangles import at_all
from zoomout_core.runtime.progress import advance, portion

# The fraction of the progress of a fit that the rounds take.
BENDING = 0.9


class Level(NamedTuple):
    """Consecutive rounds of the fit with the same settings."""

    nodes: int  # number of nodes that move the target
    sliding: float  # weight of a residual along the surface against one across it; 1 if goals are points, not surfaces
    stiffness: float  # weight of the difference of neighbouring nodes
    rounds: int  # maximum number of Gauss-Newton steps
    robust_scale: float = ROBUST_SCALE  # residual, at unit area, from which a correspondence hardly counts
    min_weight: float = MIN_WEIGHT  # smallest weight of a correspondence, also of a rejected one
    stretches: bool = False  # whether the rest shape adapts to the stretch so far, before the rounds


class Pins(NamedTuple):
    """Vertices of the target that a fit attracts to points on the source."""

    vertex: Integers  # (p,) their numbers
    goal: Floats  # (p, 3) these points


# Weight of the squared distance of each pin from its goal: that of a few dozen query points, whose weights sum to one.
PIN_WEIGHT = 0.02
# Diffusion length, at unit area, that smooths the images to which the target is aligned first.
ALIGNMENT_WIDTH = 0.06
# The first levels have few nodes, so that a trunk rotates about its axis together with its limbs. Nothing else
# determines the rotation of a round part about its axis. The last levels adapt to other proportions: the mean distance
# from the true images falls by 7 % on 13 pairs of FAUST, and by 3.5 % on 20 of SMAL.
NONRIGID_SCHEDULE = (
    Level(40, 1.0, 0.3, 1),
    Level(40, 0.01, 0.3, 5),
    Level(100, 1.0, 0.3, 1),
    Level(100, 0.02, 0.3, 2),
    Level(200, 1.0, 0.3, 1),
    Level(200, 0.01, 0.3, 2, stretches=True),
    Level(200, 0.01, 0.1, 3, stretches=True),
)
# A level ends once its nodes move by less than this on average, at unit area.
CONVERGED_MOTION = 6e-4
# A fit is rejected where the eigenfunctions disagree with it by more than an allowance, at unit area, plus this factor
# times their disagreement with the first map. Both are averaged over a diffusion length, at unit area.
MAX_DISAGREEMENT_RATIO = 2.0
DISAGREEMENT_ALLOWANCE = 0.02
DISAGREEMENT_WIDTH = 0.03
# Largest distance, at unit area, between a vertex's images on the proxy and on the full mesh. Anything farther is on
# another part that touches this one.
MAX_LIFT_DISTANCE = 0.03


@dataclass(frozen=True, eq=False)
class Fit:
    """A target registered to its source."""

    surface_map: SurfaceMap  # from the target's mesh to the source's; the first map where the fit is rejected
    positions: Floats  # (n_t, 3) the target's vertices in the source's frame, at unit area
    rotations: Floats  # (n_t, 3, 3) rotations of the surroundings of each vertex, mirrored if the map mirrors
    fits: Booleans  # (n_t,) whether the fit is accepted

    @classmethod
    def of_map(cls, surface_map: SurfaceMap) -> Fit:
        """A fit that consists of a map only."""
        n = len(surface_map.triangle)
        return cls(surface_map, np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros(n, dtype=bool))


def fit_nonrigid(
    first: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis, mirrored: bool, pins: Pins | None = None
) -> Fit:
    """Register a target to its source, starting from a map between their meshes."""
    sense = mirror_factors(mirrored)
    rest, normals = target.mesh.vertices * sense, target.mesh.vertex_normals * sense
    images, image_normals = (first.interpolate(v) for v in (source.mesh.vertices, source.mesh.vertex_normals))
    coefficients = target.basis.coefficients(images)[: RIGID_ALIGNMENT.image_functions]
    aligned = align(coefficients, target, ALIGNMENT_WIDTH, mirrored)
    if aligned.facing(image_normals, source, target) is not aligned:
        normals = -normals
    around, limit = Surroundings.of(source), GeodesicLimit(first.vertex, source)
    still, placed = rigid_vertices(first, rest, normals, around, limit, target)
    positions = np.where(still[:, None], placed, aligned.positions)
    with portion(0.0, BENDING):
        graph = bend(rest, normals, positions, around, limit, target, NONRIGID_SCHEDULE, pins=pins)
    advance(BENDING)
    positions, turned, blends = graph.deform()
    found = around.closest(positions, turned)
    facing = np.einsum("nx,nx->n", turned, found.interpolate(source.mesh.vertex_normals)) > 0
    fits = (
        facing
        & ~limit.exceeds_geodesic_limit(np.arange(len(rest)), found.vertex)
        & ~_astray(found, first, source, target)
    )
    fitting = SurfaceMap(found.triangle[fits], found.barycentric[fits], found.source_triangles)
    surface_map = replace_images(first, fits, fitting)
    return Fit(surface_map, positions, nearest_rotations(blends) * sense, fits)


def bend(
    rest: Floats,  # (n_t, 3) the target's vertices, mirrored if the map mirrors
    normals: Floats,  # (n_t, 3) its normals, likewise
    positions: Floats,  # (n_t, 3) initial positions
    around: Surroundings,
    limit: GeodesicLimit,  # on correspondences
    target: ShapeAnalysis,  # the shape that is deformed
    levels: Sequence[Level],  # the schedule; not empty
    # Whether the source may have places without a partner, which then do not attract the target.
    is_part: bool = False,
    pins: Pins | None = None,
) -> DeformationGraph:
    """Fit the deformation graph that registers a target to a source."""
    graph = None
    for i, (count, sliding, stiffness, rounds, robust_scale, min_weight, stretches) in enumerate(levels):
        count = min(count, len(target.distances))
        if graph is None or len(graph.nodes.vertex) != count:
            nodes = Nodes.on(target, count)
            here = QueryPoints.on(target, count)
            there = QueryPoints(here.vertex[:0], here.areas[:0]) if is_part else QueryPoints.on(around.source, count)
            graph = DeformationGraph.from_images(nodes, rest, normals, positions, target.basis.areas)
            goal = positions
        if stretches:
            graph.adapt_stretch()
        for j in range(rounds):
            advance((i + j / rounds) / len(levels))
            positions, turned, _ = graph.deform()
            if sliding == 1:
                vertex, residual = here.vertex, (goal - positions)[here.vertex]
                root_weight = np.sqrt(here.areas)[:, None, None] * np.eye(3)
            else:
                rule = sliding, robust_scale, min_weight
                vertex, residual, root_weight = residuals(positions, turned, here, there, around, limit, *rule)
            if pins is not None:
                weight = np.broadcast_to(np.sqrt(PIN_WEIGHT) * np.eye(3), (len(pins.vertex), 3, 3))
                vertex = np.concatenate([vertex, pins.vertex])
                residual = np.concatenate([residual, pins.goal - positions[pins.vertex]])
                root_weight = np.concatenate([root_weight, weight])
            motion = graph.step(vertex, residual, root_weight, stiffness, approaching=sliding != 1)
            if motion < CONVERGED_MOTION:
                break
    assert graph is not None
    return graph


def lift_fit(fit: Fit, source: Proxy, target: Proxy, in_space: Floats) -> SurfaceMap:
    """Lift a fit between proxies to a map between the parts that these were decimated from.

    Each vertex of the target's part moves with its place on the proxy, and maps to the closest point of the source's
    part. If that point is far from the image by the proxies' map, on another part that touches, the image is used.
    `in_space` (n_t, 3) is the undeformed target's part in the frame of the source's part.
    """
    if source.mesh is source.full and target.mesh is target.full and not fit.fits.any():
        return fit.surface_map
    place, images = target.place, full_images(fit.surface_map, source, target)
    fits = at_all(fit.fits, target.mesh.triangles)[place.triangle]
    on = SurfaceMap(place.triangle[fits], place.barycentric[fits], place.source_triangles)
    (centre, size), (image_centre, image_size) = target.frame, source.frame
    off = (target.full.vertices[fits] - centre) / size - on.interpolate(target.mesh.vertices)
    bent = on.interpolate(fit.positions) + np.einsum("nij,nj->ni", on.interpolate(fit.rotations), off)
    goal = images.copy()
    goal[fits] = image_centre + image_size * bent
    settled, nearness = settle(goal, fits, target.full.vertices, in_space, source)
    found = source.closest(settled)
    at_rest = any_in_row(settled != goal)
    loose = at_rest & (np.linalg.norm(found.interpolate(source.full.vertices) - settled, axis=1) > nearness)
    found = replace_images(found, loose, source.closest(goal[loose]))
    elsewhere = np.linalg.norm(found.interpolate(source.full.vertices) - images, axis=1) > MAX_LIFT_DISTANCE
    elsewhere &= loose | ~at_rest
    return replace_images(found, elsewhere, source.closest(images[elsewhere]))


def replace_images(surface_map: SurfaceMap, at: Booleans | Integers, by: SurfaceMap) -> SurfaceMap:
    """Replace the images of some vertices, given by a mask (n,) or numbers (q,), by those of the map `by`."""
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    triangle[at], barycentric[at] = by.triangle, by.barycentric
    return SurfaceMap(triangle, barycentric, surface_map.source_triangles)


def _astray(found: SurfaceMap, first: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis) -> Booleans:
    """(n_t,) the vertices where eigenfunctions disagree with a map more than with its initial map."""
    k = min(RIGID_ALIGNMENT.image_functions, len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    values, eigenvalues = target.basis.eigenvectors[:, :k], target.basis.eigenvalues[:k]
    pulled = [surface_map.interpolate(source.basis.eigenvectors[:, :k]) for surface_map in (found, first)]
    off = [spectral_distance(values, rows @ target.basis.coefficients(rows)[:k].T, eigenvalues) for rows in pulled]
    pooled = np.maximum(target.basis.smoothed(np.column_stack(off), DISAGREEMENT_WIDTH**2), 0)
    return np.asarray(pooled[:, 0] > MAX_DISAGREEMENT_RATIO * pooled[:, 1] + DISAGREEMENT_ALLOWANCE)
