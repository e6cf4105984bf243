"""Parts of a target that have not moved against the source: a single motion registers them exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.procrustes import Moments, procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.proxy import Proxy
from zoomout_core.matching.registration.correspondences import GeodesicLimit, QueryPoints, Surroundings, residuals
from zoomout_core.matching.registration.deformation_graph import crossing
from zoomout_core.mesh.triangles import triangle_normals
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class RigidTuning(Tuning, set_by="judgement"):
    """Where a single motion registers the target with the source, on stand-ins and on full meshes.

    Attributes:
        rounds: of the search for a motion.
        sliding: weight of a residual along the surface against one across it.
        coinciding: a vertex nearer to the source, or to its goal, coincides with it.
        mostly: the part of a vertex's surroundings that must coincide.
        pooling: diffusion length of these surroundings.
        nodes: a motion is found from as many query points as a deformation graph of this number of nodes has.
        settling_rounds: of the refinement on the full meshes.
        fewest_settled: the part of the vertices that must be near their goals for it.
        settling_points: vertices that it looks at.
        fewest_vertices: of a mesh that is refined.
        flush: two meshes of one surface are no farther apart.
        as_well: factor of the best motion's miss up to which meshes of one surface stand as they should.
        fading: factor of that, and of `flush`, up to which where they stand counts, the less the nearer to it.
        throughout: where a motion takes this part of all vertices to their goals, surfaces differ by their meshes only,
            and the other vertices go along if they come to lie on the source: their goals were wrong.
    """

    rounds: int = tuned(5, "rounds", 1, 100)
    sliding: float = tuned(0.02, "1", 0, 1)
    coinciding: float = tuned(0.006, "at unit area", 1e-6, 1)
    mostly: float = tuned(0.8, "1", 0, 1)
    pooling: float = tuned(0.03, "at unit area", 0, 1)
    nodes: int = tuned(40, "nodes", 1, 1000)
    settling_rounds: int = tuned(4, "rounds", 1, 100)
    fewest_settled: float = tuned(0.2, "1", 0, 1)
    settling_points: int = tuned(1000, "vertices", 10, 1_000_000)
    fewest_vertices: int = tuned(400, "vertices", 10, 1_000_000)
    flush: float = tuned(5e-4, "at unit area", 0, 1)
    as_well: float = tuned(2.0, "1", 1, 100)
    fading: float = tuned(1.5, "1", 1.001, 100)
    throughout: float = tuned(0.9, "1", 0, 1)


RIGID = RigidTuning()


def unmoved(
    first: SurfaceMap,
    rest: Floats,
    normals: Floats,
    around: Surroundings,
    limit: GeodesicLimit,
    target: ShapeAnalysis,
) -> tuple[Booleans, Floats]:
    """Where a single rigid motion already registers the target with the source, as where only its mesh is another.

    Returns:
        (n,) where that is so, and (n, 3) where the motion takes the target's vertices.
    """
    mesh = around.source.mesh
    here, there = QueryPoints.on(target, RIGID.nodes), QueryPoints.on(around.source, RIGID.nodes)
    at = here.vertex
    images = first.interpolate(mesh.vertices)[at]
    moments = Moments.between(rest[at], images, here.areas)
    centre, image_centre, turn = moments.place, moments.image, moments.rotations()
    for _ in range(RIGID.rounds):
        placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
        vertex, residual, weight = residuals(placed, turned, here, there, around, limit, RIGID.sliding)
        jacobian = np.concatenate([weight @ crossing(placed[vertex] - image_centre), weight], axis=2).reshape(-1, 6)
        change = np.linalg.lstsq(jacobian, np.einsum("qij,qj->qi", weight, residual).ravel(), rcond=None)[0]
        turn = Rotation.from_rotvec(change[:3]).as_matrix() @ turn
        image_centre = image_centre + change[3:]
    placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
    found = around.closest(placed, turned)
    apart = np.linalg.norm(found.interpolate(mesh.vertices) - placed, axis=1)
    close = (apart < RIGID.coinciding) & ~limit.exceeds_geodesic_limit(np.arange(len(rest)), found.vertex)
    pooled = target.basis.smoothed(close[:, None].astype(float), RIGID.pooling**2)[:, 0]
    return pooled > RIGID.mostly, placed


def settle(goal: Floats, fits: Booleans, points: Floats, standing: Floats, source: Proxy) -> tuple[Floats, float]:
    """Where points are to go, made exact for those that a single similarity takes there.

    A stand-in lies off its mesh by more than two meshes of one surface differ, so where most of a body has not moved
    against the rest, only the full meshes determine its position exactly.

    Args:
        goal: (n, 3) in the frame of the source's part.
        fits: (n,) which goals are reliable.
        points: (n, 3) in that of the target's.
        standing: (n, 3) where they are if both surfaces stay where they stand; they do if that fits about as well,
            for then it is exact, which no motion between two meshes is. It fades, so that nothing jumps when one of the
            two is moved away.
        source: the mesh to lie on.

    Returns:
        (n, 3) positions, and how near to the source, at unit area, those made exact are to lie.
    """
    reliable = np.flatnonzero(fits)
    if len(reliable) < RIGID.fewest_vertices:
        return goal, RIGID.flush
    at = reliable[np.linspace(0, len(reliable) - 1, min(len(reliable), RIGID.settling_points)).astype(int)]
    trust = np.ones(len(at))
    for _ in range(RIGID.rounds):
        aligned = procrustes(points[at], goal[at], trust)
        miss = np.linalg.norm(aligned(points[at]) - goal[at], axis=1)
        trust = 1 / (1 + (miss / RIGID.coinciding) ** 2) ** 2
    motion, shift = aligned.linear, aligned.translation
    for _ in range(RIGID.settling_rounds):
        placed = points[at] @ motion.T + shift
        near = np.flatnonzero(np.linalg.norm(placed - goal[at], axis=1) < RIGID.coinciding)
        if len(near) < RIGID.fewest_settled * len(at):
            return goal, RIGID.flush
        residual, normals = _residuals(placed[near], source)
        away = placed[near] - placed[near].mean(axis=0)
        columns = [np.cross(away, normals), np.einsum("nx,nx->n", normals, away)[:, None], normals]
        change = np.linalg.lstsq(np.hstack(columns), residual, rcond=None)[0]
        grown = (1 + change[3]) * Rotation.from_rotvec(change[:3]).as_matrix()
        middle = placed[near].mean(axis=0)
        motion, shift = grown @ motion, grown @ (shift - middle) + middle + change[4:]
    left = np.median(np.abs(residual))
    if left > RIGID.flush:
        return goal, RIGID.flush
    placed = points @ motion.T + shift
    elsewhere = np.median(np.linalg.norm((standing - placed)[at[near]], axis=1)) / RIGID.flush
    if elsewhere < RIGID.fading:
        as_they_stand, _ = _residuals(standing[at[near]], source)
        worse = np.median(np.abs(as_they_stand)) / (RIGID.as_well * left)
        stays = np.clip((RIGID.fading - max(elsewhere, worse)) / (RIGID.fading - 1), 0, 1)
        placed = (1 - stays) * placed + stays * standing
    settled = fits & (np.linalg.norm(placed - goal, axis=1) < RIGID.coinciding)
    if settled.mean() < RIGID.throughout:
        return np.where(settled[:, None], placed, goal), RIGID.flush
    rest = np.flatnonzero(~settled)
    found = source.closest(placed[rest]).interpolate(source.full.vertices)
    settled[rest] = np.linalg.norm(found - placed[rest], axis=1) < RIGID.flush
    return np.where(settled[:, None], placed, goal), RIGID.coinciding


def _residuals(points: Floats, source: Proxy) -> tuple[Floats, Floats]:
    """(n,) heights of a mesh above points (n, 3), and (n, 3) the normals along which these are measured."""
    mesh = source.full
    found = SurfaceMap(*source.search.closest(points), mesh.triangles)
    normals = triangle_normals(mesh.vertices, mesh.triangles[found.triangle])
    return np.einsum("nx,nx->n", normals, found.interpolate(mesh.vertices) - points), normals
