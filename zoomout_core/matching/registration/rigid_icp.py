"""Parts of a target that have not moved against the source: a single motion lays them exactly."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.proxy import Proxy
from zoomout_core.matching.registration.correspondences import GeodesicLimit, QueryPoints, Surroundings, residuals
from zoomout_core.matching.registration.deformation_graph import crossing
from zoomout_core.mesh.triangles import triangle_normals

# A rigid motion is sought in so many rounds; it lays a part into the source where that is nearer than this, at unit
# area, for at least this part of the surroundings, which reach as far as this diffusion length.
RIGID_ROUNDS, SLIDING, COINCIDING, MOSTLY, POOLING = 5, 0.02, 0.006, 0.8, 0.03
# It is found from as many places as so many nodes take.
NODES = 40
# On the full meshes so many rounds make it exact, if it takes at least this part of the vertices where they are to go.
SETTLING_ROUNDS, FEWEST_SETTLED = 4, 0.2
# They look at so many vertices, and at no mesh with fewer than that.
SETTLING_POINTS, FEWEST_VERTICES = 1000, 400
# Two meshes of one surface are no farther apart than this, at unit area.
FLUSH = 5e-4
# Meshes of one surface that stand as they should miss each other by less than so many times the best motion's miss.
AS_WELL = 2.0
# Where a motion takes this part of all vertices where they are to go, they differ by their meshes only, and the others
# go along if they come to lie on the source: their goals were wrong.
THROUGHOUT = 0.9


def unmoved(
    first: SurfaceMap,
    rest: Floats,
    normals: Floats,
    around: Surroundings,
    limit: GeodesicLimit,
    target: ShapeAnalysis,
) -> tuple[Booleans, Floats]:
    """Where a single rigid motion already lays the target into the source, as where only its mesh is another.

    Returns:
        (n,) where that is so, and (n, 3) where the motion takes the target's vertices.
    """
    mesh = around.source.mesh
    here, there = QueryPoints.on(target, NODES), QueryPoints.on(around.source, NODES)
    at = here.vertex
    images = first.interpolate(mesh.vertices)[at]
    share = here.areas / here.areas.sum()
    centre, image_centre = share @ rest[at], share @ images
    turn = nearest_rotations((images - image_centre).T @ (share[:, None] * (rest[at] - centre)))
    for _ in range(RIGID_ROUNDS):
        placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
        vertex, residual, weight = residuals(placed, turned, here, there, around, limit, SLIDING)
        jacobian = np.concatenate([weight @ crossing(placed[vertex] - image_centre), weight], axis=2).reshape(-1, 6)
        change = np.linalg.lstsq(jacobian, np.einsum("qij,qj->qi", weight, residual).ravel(), rcond=None)[0]
        turn = Rotation.from_rotvec(change[:3]).as_matrix() @ turn
        image_centre = image_centre + change[3:]
    placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
    found = around.closest(placed, turned)
    apart = np.linalg.norm(found.interpolate(mesh.vertices) - placed, axis=1)
    close = (apart < COINCIDING) & ~limit.exceeds_geodesic_limit(np.arange(len(rest)), found.vertex)
    pooled = target.basis.smoothed(close[:, None].astype(float), POOLING**2)[:, 0]
    return pooled > MOSTLY, placed


def settle(goal: Floats, fits: Booleans, points: Floats, standing: Floats, source: Proxy) -> tuple[Floats, float]:
    """Where points are to go, made exact for those that a single similarity takes there.

    A stand-in lies off its mesh by more than two meshes of one surface differ, so where most of a body has not moved
    against the rest, only the full meshes tell exactly how it lies.

    Args:
        goal: (n, 3) in the frame of the source's part.
        fits: (n,) which goals tell of the motion.
        points: (n, 3) in that of the target's.
        standing: (n, 3) where they are if both surfaces stay where they stand; they do if that fits about as well.
        source: the mesh to lie on.

    Returns:
        (n, 3) positions, and how near to the source, at unit area, those made exact are to lie.
    """
    reliable = np.flatnonzero(fits)
    if len(reliable) < FEWEST_VERTICES:
        return goal, FLUSH
    at = reliable[np.linspace(0, len(reliable) - 1, min(len(reliable), SETTLING_POINTS)).astype(int)]
    motion, shift = np.eye(3), np.zeros(3)
    trust = np.ones(len(at))
    for _ in range(RIGID_ROUNDS):
        share = trust / trust.sum()
        centre, goal_centre = share @ points[at], share @ goal[at]
        offsets, goals = points[at] - centre, goal[at] - goal_centre
        turn = nearest_rotations(goals.T @ (share[:, None] * offsets))
        size = (share @ np.einsum("nx,nx->n", goals, offsets @ turn.T)) / (share @ (offsets**2).sum(axis=1))
        motion, shift = size * turn, goal_centre - size * turn @ centre
        trust = 1 / (1 + (np.linalg.norm(points[at] @ motion.T + shift - goal[at], axis=1) / COINCIDING) ** 2) ** 2
    for _ in range(SETTLING_ROUNDS):
        placed = points[at] @ motion.T + shift
        near = np.flatnonzero(np.linalg.norm(placed - goal[at], axis=1) < COINCIDING)
        if len(near) < FEWEST_SETTLED * len(at):
            return goal, FLUSH
        residual, normals = _residuals(placed[near], source)
        away = placed[near] - placed[near].mean(axis=0)
        columns = [np.cross(away, normals), np.einsum("nx,nx->n", normals, away)[:, None], normals]
        change = np.linalg.lstsq(np.hstack(columns), residual, rcond=None)[0]
        grown = (1 + change[3]) * Rotation.from_rotvec(change[:3]).as_matrix()
        middle = placed[near].mean(axis=0)
        motion, shift = grown @ motion, grown @ (shift - middle) + middle + change[4:]
    miss = np.median(np.abs(residual))
    if miss > FLUSH:
        return goal, FLUSH
    placed = points @ motion.T + shift
    if np.median(np.linalg.norm((standing - placed)[at[near]], axis=1)) < FLUSH:
        as_they_stand, _ = _residuals(standing[at[near]], source)
        if np.median(np.abs(as_they_stand)) < AS_WELL * miss:
            placed = standing
    settled = fits & (np.linalg.norm(placed - goal, axis=1) < COINCIDING)
    if settled.mean() < THROUGHOUT:
        return np.where(settled[:, None], placed, goal), FLUSH
    rest = np.flatnonzero(~settled)
    found = source.closest(placed[rest]).interpolate(source.full.vertices)
    settled[rest] = np.linalg.norm(found - placed[rest], axis=1) < FLUSH
    return np.where(settled[:, None], placed, goal), COINCIDING


def _residuals(points: Floats, source: Proxy) -> tuple[Floats, Floats]:
    """(n,) how far a mesh lies above points (n, 3), and (n, 3) along which normals."""
    mesh = source.full
    found = SurfaceMap(*source.search.closest(points), mesh.triangles)
    normals = triangle_normals(mesh.vertices, mesh.triangles[found.triangle])
    return np.einsum("nx,nx->n", normals, found.interpolate(mesh.vertices) - points), normals
