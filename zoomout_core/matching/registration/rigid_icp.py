# SPDX-License-Identifier: GPL-3.0-or-later
"""Register unmoved parts of a target exactly to the source, by a single motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import Moments, procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.proxy import Proxy
from zoomout_core.matching.registration.correspondences import GeodesicLimit, QueryPoints, Surroundings, residuals
from zoomout_core.matching.registration.deformation_graph import crossing
from zoomout_core.mesh.triangles import triangle_normals

# Iterations that fit a motion. On proxies it is fitted to the query points of a deformation graph of this many nodes.
MOTION_ITERATIONS = 5
QUERY_NODES = 40
# Weight of a residual along the surface against one across it.
SLIDING_WEIGHT = 0.02
# A vertex within this distance of the source, or of its goal, coincides with it, at unit area.
COINCIDENCE_DISTANCE = 0.006
# A vertex needs no bending if this share of its neighbourhood coincides, within a diffusion length at unit area.
MIN_COINCIDING_SHARE = 0.8
NEIGHBOURHOOD_WIDTH = 0.03
# Refinement on full meshes: iterations, fewest reliable vertices, how many of them are used, and the share of these
# that must coincide with their goals.
SETTLING_ITERATIONS = 4
MIN_SETTLING_VERTICES = 400
MAX_SETTLING_POINTS = 1000
MIN_SETTLED_SHARE = 0.2
# Two meshes of one surface are at most this far apart, at unit area.
SAME_SURFACE_DISTANCE = 5e-4
# Meshes of one surface keep their placement if its residual is at most this factor of the best motion's. Up to
# `FADE_FACTOR` times this limit, and `SAME_SURFACE_DISTANCE`, placement and motion are blended.
MAX_RESIDUAL_RATIO = 2.0
FADE_FACTOR = 1.5
# If a motion takes this share of all vertices to their goals, the surfaces differ in their meshes only. The remaining
# vertices follow it if they land on the source, because their goals were wrong.
SAME_SURFACE_SHARE = 0.9


def rigid_vertices(
    first: SurfaceMap, rest: Floats, normals: Floats, around: Surroundings, limit: GeodesicLimit, target: ShapeAnalysis
) -> tuple[Booleans, Floats]:
    """(n,) whether a single rigid motion registers the target there, and (n, 3) the target's vertices after it."""
    mesh = around.source.mesh
    here, there = QueryPoints.on(target, QUERY_NODES), QueryPoints.on(around.source, QUERY_NODES)
    at = here.vertex
    images = first.interpolate(mesh.vertices)[at]
    moments = Moments.between(rest[at], images, here.areas)
    centre, image_centre, turn = moments.place, moments.image, moments.rotations()
    for _ in range(MOTION_ITERATIONS):
        placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
        vertex, residual, weight = residuals(placed, turned, here, there, around, limit, SLIDING_WEIGHT)
        jacobian = np.concatenate([weight @ crossing(placed[vertex] - image_centre), weight], axis=2).reshape(-1, 6)
        change = np.linalg.lstsq(jacobian, np.einsum("qij,qj->qi", weight, residual).ravel(), rcond=None)[0]
        turn = Rotation.from_rotvec(change[:3]).as_matrix() @ turn
        image_centre = image_centre + change[3:]
    placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
    found = around.closest(placed, turned)
    apart = np.linalg.norm(found.interpolate(mesh.vertices) - placed, axis=1)
    close = (apart < COINCIDENCE_DISTANCE) & ~limit.exceeds_geodesic_limit(np.arange(len(rest)), found.vertex)
    pooled = target.basis.smoothed(close[:, None].astype(float), NEIGHBOURHOOD_WIDTH**2)[:, 0]
    return pooled > MIN_COINCIDING_SHARE, placed


def settle(goal: Floats, fits: Booleans, points: Floats, in_space: Floats, source: Proxy) -> tuple[Floats, float]:
    """Refine the goals (n, 3) of points (n, 3), where they fit (n,), if a single similarity takes the points close.

    A proxy differs from its mesh by more than two meshes of one surface do. If most of a body did not move, only the
    full meshes therefore determine its position exactly. The points' positions `in_space` (n, 3) are kept if they fit
    about as well without a motion, because they are exact, unlike a motion that is fitted to two meshes. The transition
    is gradual, so that results do not jump if one of the two is moved away.

    Goals and results are in the frame of the source's part, points in that of the target's. Returns (n, 3) positions,
    and the maximum distance of the refined ones from the source, at unit area.
    """
    reliable = np.flatnonzero(fits)
    if len(reliable) < MIN_SETTLING_VERTICES:
        return goal, SAME_SURFACE_DISTANCE
    at = reliable[np.linspace(0, len(reliable) - 1, min(len(reliable), MAX_SETTLING_POINTS)).astype(int)]
    motion = _fit_to_surface(points[at], goal[at], source)
    if motion is None or motion.residual > SAME_SURFACE_DISTANCE:
        return goal, SAME_SURFACE_DISTANCE
    placed = points @ motion.linear.T + motion.shift
    placed = _blend_with_space(placed, in_space, at[motion.near], motion.residual, source)
    settled = fits & (np.linalg.norm(placed - goal, axis=1) < COINCIDENCE_DISTANCE)
    if settled.mean() < SAME_SURFACE_SHARE:
        return np.where(settled[:, None], placed, goal), SAME_SURFACE_DISTANCE
    rest = np.flatnonzero(~settled)
    found = source.closest(placed[rest]).interpolate(source.full.vertices)
    settled[rest] = np.linalg.norm(found - placed[rest], axis=1) < SAME_SURFACE_DISTANCE
    return np.where(settled[:, None], placed, goal), COINCIDENCE_DISTANCE


class _SurfaceFit(NamedTuple):
    """A similarity x -> linear x + shift that takes points to a surface."""

    linear: Floats  # (3, 3)
    shift: Floats  # (3,)
    near: Integers  # (q,) numbers of the points that it takes close to their goals
    residual: float  # median distance of these from the surface


def _fit_to_surface(points: Floats, goal: Floats, source: Proxy) -> _SurfaceFit | None:
    """The similarity that takes points (p, 3) to the source's part near their goals (p, 3).

    It is fitted to the goals with robust weights, then to the planes of the closest triangles: Chen and Medioni, Object
    modelling by registration of multiple range images (1992). None if it takes too few points to their goals.
    """
    trust = np.ones(len(points))
    for _ in range(MOTION_ITERATIONS):
        aligned = procrustes(points, goal, trust)
        miss = np.linalg.norm(aligned(points) - goal, axis=1)
        trust = 1 / (1 + (miss / COINCIDENCE_DISTANCE) ** 2) ** 2
    linear, shift = aligned.linear, aligned.translation
    for _ in range(SETTLING_ITERATIONS):
        placed = points @ linear.T + shift
        near = np.flatnonzero(np.linalg.norm(placed - goal, axis=1) < COINCIDENCE_DISTANCE)
        if len(near) < MIN_SETTLED_SHARE * len(points):
            return None
        residual, normals = _residuals(placed[near], source)
        away = placed[near] - placed[near].mean(axis=0)
        columns = [np.cross(away, normals), np.einsum("nx,nx->n", normals, away)[:, None], normals]
        change = np.linalg.lstsq(np.hstack(columns), residual, rcond=None)[0]
        grown = (1 + change[3]) * Rotation.from_rotvec(change[:3]).as_matrix()
        middle = placed[near].mean(axis=0)
        linear, shift = grown @ linear, grown @ (shift - middle) + middle + change[4:]
    return _SurfaceFit(linear, shift, near, float(np.median(np.abs(residual))))


def _blend_with_space(placed: Floats, in_space: Floats, near: Integers, residual: float, source: Proxy) -> Floats:
    """(n, 3) positions after a motion (n, 3), blended with those in space (n, 3) if these are close and fit as well.

    Points `near` (q,) are on the source after the motion, up to the median distance `residual`.
    """
    elsewhere = np.median(np.linalg.norm((in_space - placed)[near], axis=1)) / SAME_SURFACE_DISTANCE
    if elsewhere >= FADE_FACTOR:
        return placed
    unmoved, _ = _residuals(in_space[near], source)
    worse = np.median(np.abs(unmoved)) / (MAX_RESIDUAL_RATIO * residual)
    stays = np.clip((FADE_FACTOR - max(elsewhere, worse)) / (FADE_FACTOR - 1), 0, 1)
    return np.asarray((1 - stays) * placed + stays * in_space)


def _residuals(points: Floats, source: Proxy) -> tuple[Floats, Floats]:
    """(n,) heights of a mesh above points (n, 3), and (n, 3) the normals along which these are measured."""
    mesh = source.full
    found = SurfaceMap(*source.search.closest(points), mesh.triangles)
    normals = triangle_normals(mesh.vertices, mesh.triangles[found.triangle])
    return np.einsum("nx,nx->n", normals, found.interpolate(mesh.vertices) - points), normals
