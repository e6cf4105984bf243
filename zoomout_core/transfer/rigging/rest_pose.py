# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the pose of a target, and its rest shape, by the map to a rigged source.

The map gives an initial pose. If it takes the target to the source's own body at rest, its vertices are projected to
the source at rest, and bones are fitted along normals. Then errors of the map along the surface, which shift whole
limbs, no longer matter. Free bones also bend and shift another body until it nearly fits, but never as well as the same
body. Bones of another body are coupled, and fitted to the map alone. Where the map is wrong, such as below clothes, it
would bend bones of a target that is at rest. A target is at rest if one similarity fits it to the source at rest as
well as all bones do. Bones rotate as well to fit another build, such as a wider one; but then their axes, which end at
joints inside the body, keep their directions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unique_edges, vertex_normals
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.frames import FULL_CONFIDENCE
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.bone_axes import keep_axes
from zoomout_core.transfer.rigging.bone_fit import Pose, estimate_pose, refine_pose
from zoomout_core.transfer.rigging.bone_problem import BONES
from zoomout_core.transfer.rigging.reached_surface import ReachedSurface
from zoomout_core.transfer.rigging.skinning import skinning_matrices
from zoomout_core.transfer.rigging.unpose import Rest, inverse_skinning
from zoomout_core.transfer.rigging.weights import mixing_matrix
from zoomout_core.tuning import Tuning, tuned

# Nearest vertices among which distances are averaged: enough to divide noise by four.
AVERAGED_NEIGHBOURS = 16
# Share of the target's area within `RestTuning.in_place` of the source above which both have the same pose and place.
# Fingers and hems of a remeshed target are farther away.
MIN_IN_PLACE_SHARE = 0.9


@dataclass(frozen=True)
class RestTuning(Tuning, set_by="binding"):
    """Projection of a target to the source at rest.

    Attributes:
        same_body: median distance from the source at rest up to which the target may be the same body.
        settled: the same after the last round, up to which it is.
        faceted: further distance on account of the source's faces, as a multiple of the height of their arcs. With
            both, characters in other poses end at .1 to .9 times the limit, also after voxel remeshing if their map is
            right. Animals and people of other builds end at .8 to 4 times the limit.
        averaged: radius within which distances are averaged before that, as vectors. The noise of a scan then cancels
            out, and distances of other bodies remain. Of three scans with noise of .14 % of their height, .8 to 1.3
            times the limit becomes .2 to .4 times; of five other bodies, 1.6 to 3.0 times becomes 1.5 to 2.1 times.
        near: maximum distance from the source for projecting a vertex.
        along: maximum distance of the projection from the map's image.
        reach: maximum distance of places of a loose part from images on it, for projecting vertices there.
        facing: minimum cosine between both normals.
        beside: weight of the map at vertices that are not projected.
        rounds: number of rounds of projecting and fitting.
        in_place: a target in the rest pose stays in place if no vertex would move farther.
        aligned: maximum number of vertices that are aligned with the source as a whole.
        iterations: number of rounds of this alignment.
        coarse: number of the target's vertices by which the pose is found when only the map is corrected.
    """

    same_body: float = tuned(0.01, "at unit area", 0, 1)
    settled: float = tuned(0.0006, "at unit area", 0, 1)
    faceted: float = tuned(0.6, "1", 0, 100)
    averaged: float = tuned(0.02, "at unit area", 1e-9, 1)
    near: float = tuned(0.03, "at unit area", 0, 1)
    along: float = tuned(0.1, "at unit area", 0, 10)
    reach: float = tuned(0.03, "at unit area", 0, 10)
    facing: float = tuned(0.5, "1", -1, 1)
    beside: float = tuned(0.1, "1", 0, 1)
    rounds: int = tuned(6, "rounds", 0, 100)
    in_place: float = tuned(0.02, "at unit area", 0, 1)
    aligned: int = tuned(1500, "vertices", 3, 1_000_000)
    iterations: int = tuned(10, "rounds", 1, 100)
    coarse: int = tuned(4000, "vertices", 100, 1_000_000)


REST = RestTuning()


@dataclass(frozen=True, eq=False)
class PosedTarget:
    """A target, mapped over its source at rest, and its pose."""

    mapped: MappedTarget  # the target over the source at rest, projected if it is the same body
    pose: Pose  # the pose of the bones that takes it from the rest pose to the target


def correct_map(mapped: MappedTarget, posed: PosedTarget, weights: csr_array) -> MappedTarget:
    """A mapped target, with the errors of its map along the surface corrected by the pose that was found.

    On the same body, each vertex that the bones take near the source is mapped to the closest point there, also in
    creases, where normals differ: a vertex left out there would tear the surface. Otherwise nothing changes.

    Args:
        mapped: the target over the source, as for `find_pose`.
        posed: its pose.
        weights: (n_s, b) sparse skin weights of the source.
    """
    if posed.mapped.surface_map is mapped.surface_map:
        return mapped
    rest = posed.mapped.source
    search = ReachedSurface(rest, mapped, REST.reach * np.sqrt(rest.area))
    at_rest = replace(mapped, source=rest)
    projection = _project_at_rest(posed.mapped, at_rest, posed.pose, weights, search, REST.along, -np.inf)
    confidence = np.where(projection.trusted, np.maximum(mapped.confidence, FULL_CONFIDENCE), mapped.confidence)
    return replace(mapped, surface_map=projection.surface_map, confidence=confidence)


def correct_by_bones(
    mapped: MappedTarget, rest: Surface, weights: csr_array, parents: ArrayLike | None = None
) -> MappedTarget:
    """A mapped target, with its map corrected if the bones take it to the source's own body, see `correct_map`.

    A target in the pose and place of its source is left alone, and so is one without a trusted vertex that has weights.
    The pose is found on at most `RestTuning.coarse` of the target's vertices, and all are projected twice. Arguments
    are those of `find_pose`.
    """
    coarse, nearby = _coarsen(mapped)
    if is_in_place(coarse.source, coarse.target):
        return mapped
    try:
        posed = find_pose(coarse, rest, weights, parents)
    except MeshError:  # no trusted vertex has weights
        return mapped
    found = posed.mapped.surface_map
    if found is coarse.surface_map:
        return mapped
    surface_map = SurfaceMap(found.triangle[nearby], found.barycentric[nearby], found.source_triangles)
    for _ in range(2):  # first with the weights of the vertex nearby, then with those that this finds
        at_rest = replace(mapped, source=rest, surface_map=surface_map)
        corrected = correct_map(mapped, replace(posed, mapped=at_rest), weights)
        surface_map = corrected.surface_map
    return corrected


def _coarsen(mapped: MappedTarget) -> tuple[MappedTarget, Integers]:
    """A mapped target with fewer of its vertices, and (n_t,) the number of the one near each of its own vertices."""
    mesh = mapped.target.working
    if len(mesh.vertices) <= REST.coarse:
        return mapped, np.arange(len(mapped.target.vertices))
    points, triangles, merged = decimate(mesh.vertices, mesh.oriented_triangles, REST.coarse)
    order = np.argsort(np.linalg.norm(mesh.vertices - points[merged], axis=1), kind="stable")
    group, first = np.unique(merged[order], return_index=True)
    number = np.zeros(len(points), dtype=np.int64)
    number[group] = np.arange(len(group))
    kept, own = mesh.surface_vertex[order[first]], mapped.surface_map
    coarse = replace(
        mapped,
        target=Surface(mapped.target.vertices[kept], number[triangles]),
        surface_map=SurfaceMap(own.triangle[kept], own.barycentric[kept], own.source_triangles),
        confidence=mapped.confidence[kept],
        has_partner=None if mapped.has_partner is None else mapped.has_partner[kept],
    )
    return coarse, number[merged][np.maximum(mesh.vertex_of, 0)]


def is_in_place(source: Surface, target: Surface) -> bool:
    """Whether a target has the pose and place of its source."""
    triangle, barycentric = SurfaceSearch(source.vertices, source.triangles).closest(target.vertices)
    near = SurfaceMap(triangle, barycentric, source.triangles).interpolate(source.vertices)
    off = np.linalg.norm(near - target.vertices, axis=1)
    near_area = target.vertex_areas[off < REST.in_place * np.sqrt(source.area)].sum()
    return bool(near_area > MIN_IN_PLACE_SHARE * target.area)


@on_one_blas_thread
def find_pose(mapped: MappedTarget, rest: Surface, weights: csr_array, parents: ArrayLike | None = None) -> PosedTarget:
    """Find the pose of a target.

    Args:
        mapped: the target over the source, in any pose of the source.
        rest: the source at rest.
        weights: (n_s, b) sparse skin weights of the source.
        parents: (b,) the number of each bone's parent, -1 for none.

    Raises:
        MeshError: no vertex with a trusted map has a weight.
    """
    mapped = replace(mapped, source=rest)
    target = mapped.target
    areas = target.vertex_areas
    confidence = mapped.confidence if mapped.has_partner is None else mapped.confidence * mapped.has_partner
    own = csr_array(mixing_matrix(mapped) @ weights)
    fitted = mapped.points, target.vertices, own, areas * confidence, parents
    pose = estimate_pose(*fitted)
    search = ReachedSurface(rest, mapped, REST.reach * np.sqrt(rest.area))
    normals = vertex_normals(target.vertices, target.triangles)
    found = replace(mapped, confidence=confidence)
    for _ in range(REST.rounds):
        projection = _project_at_rest(found, mapped, pose, weights, search, REST.along)
        if not projection.is_near(REST.same_body):
            break
        found, trusted = _follow(projection, mapped, confidence), projection.trusted
        own = csr_array(mixing_matrix(found) @ weights)
        trust = areas * np.where(trusted, np.maximum(confidence, REST.beside), REST.beside * confidence)
        pose = refine_pose(pose, found.points, target.vertices, normals, own, trust, parents)
    bent = _project_at_rest(found, mapped, pose, weights, search, np.inf)
    if not bent.average(target).is_near(REST.settled + REST.faceted * _height_of_arcs(rest)):
        found, pose = replace(mapped, confidence=confidence), estimate_pose(*fitted, BONES.of_others)
        bent = _project_at_rest(found, mapped, pose, weights, search, np.inf)
    if pose.is_rest:
        return PosedTarget(found, pose)
    counted = areas if mapped.has_partner is None else areas * mapped.has_partner
    unbent = _unbend(pose, target.vertices, counted, rest, search)
    projection = _project_at_rest(mapped, mapped, unbent, weights, search, np.inf)
    if projection.is_near(REST.same_body) and counted @ projection.off <= counted @ bent.off:
        return PosedTarget(_follow(projection, mapped, confidence), unbent)
    if keep_axes(pose.common.rotation, *fitted[:4]):
        is_same_body = found.surface_map is not mapped.surface_map
        coupled = estimate_pose(*fitted, BONES.of_others) if is_same_body else pose
        if coupled.is_rest or not is_same_body:  # the same body is also posed if all its bones rotate a little
            return PosedTarget(replace(mapped, confidence=confidence), replace(coupled, same_axes=True))
    return PosedTarget(found, pose)


def align(target: Surface, pose: Pose) -> Rest:
    """Align a target in the rest pose with the source's place and size; it stays if it is aligned already."""
    placed = pose.common.inverse(target.vertices)
    linear = np.linalg.inv(pose.common.linear)
    if np.linalg.norm(placed - target.vertices, axis=1).max() < REST.in_place * np.sqrt(target.area):
        placed, linear = target.vertices, np.eye(3)
    return Rest(placed, np.broadcast_to(linear, (len(placed), 3, 3)), 0)


@dataclass(frozen=True, eq=False)
class _Projection:
    """A target, taken to the rest pose and projected to the source at rest.

    Attributes:
        surface_map: the projection where it is trusted, the map elsewhere.
        apart: (n_t, 3) vectors to the source.
        trusted: (n_t,) where the projection is trusted.
        unit: the square root of the source's area.
    """

    surface_map: SurfaceMap
    apart: Floats
    trusted: Booleans
    unit: float

    @cached_property
    def off(self) -> Floats:
        """(n_t,) distances from the source."""
        return np.linalg.norm(self.apart, axis=1)

    def is_near(self, distance: float) -> bool:
        """Whether half of the vertices are within some distance of the source, at unit area."""
        return bool(np.median(self.off) <= distance * self.unit)

    def average(self, target: Surface) -> _Projection:
        """The same with the mean vectors of the nearest vertices, in which the noise of a scan cancels out."""
        radius, count = REST.averaged * np.sqrt(target.area), min(AVERAGED_NEIGHBOURS, len(self.apart))
        ranks = np.arange(1, count + 1)
        distance, near = cKDTree(target.vertices).query(target.vertices, ranks, distance_upper_bound=radius)
        found = np.isfinite(distance)
        row, column = np.nonzero(found)[0], np.asarray(near)[found]
        averages = normalise(csr_array((np.ones(len(row)), (row, column)), shape=(len(found), len(found))))
        return replace(self, apart=averages @ self.apart)


def _project_at_rest(
    found: MappedTarget,
    mapped: MappedTarget,
    pose: Pose,
    weights: csr_array,
    search: ReachedSurface,
    along: float,
    min_facing: float | None = None,
) -> _Projection:
    """Project the target, taken to the rest pose, to the source: no vertex farther than `along` from its image.

    The cosine between both normals is above `min_facing`; `REST.facing`, when not given.
    """
    target, rest = mapped.target, mapped.source
    matrices = skinning_matrices(pose.transforms, csr_array(mixing_matrix(found) @ weights))
    at_rest, _, sound = inverse_skinning(target.vertices, matrices, pose.scale)
    triangle, barycentric = search.closest(at_rest)
    places, unit = SurfaceMap(triangle, barycentric, rest.triangles).interpolate(rest.vertices), np.sqrt(rest.area)
    apart = places - at_rest
    outwards = triangle_normals(rest.vertices, rest.triangles)[triangle]
    facing = np.einsum("nx,nx->n", vertex_normals(at_rest, target.triangles), outwards)
    near = np.linalg.norm(places - mapped.points, axis=1) < along * unit
    trusted = sound & near & (np.linalg.norm(apart, axis=1) < REST.near * unit)
    trusted &= facing > (REST.facing if min_facing is None else min_facing)
    if mapped.has_partner is not None:
        trusted &= mapped.has_partner
    kept = mapped.surface_map
    surface_map = SurfaceMap(
        np.where(trusted, triangle, kept.triangle),
        np.where(trusted[:, None], barycentric, kept.barycentric),
        rest.triangles,
    )
    return _Projection(surface_map, apart, trusted, float(unit))


def _height_of_arcs(surface: Surface) -> float:
    """The median height of the arcs over the edges of a surface, at unit area: the error of its facets."""
    mesh = surface.working
    edges, _ = unique_edges(mesh.triangles)
    chords, turns = (each[edges[:, 1]] - each[edges[:, 0]] for each in (mesh.vertices, mesh.vertex_normals))
    return float(np.median(np.abs(np.einsum("ex,ex->e", chords, turns))) / 8)


def _follow(projection: _Projection, mapped: MappedTarget, confidence: Floats) -> MappedTarget:
    """The target along a projection: certain where it is trusted, and with little weight elsewhere."""
    trust = np.where(projection.trusted, FULL_CONFIDENCE, REST.beside * confidence)
    return replace(mapped, surface_map=projection.surface_map, confidence=trust)


def _unbend(pose: Pose, vertices: Floats, areas: Floats, rest: Surface, search: ReachedSurface) -> Pose:
    """The rest pose that brings vertices (n_t, 3) with areas (n_t,) closest to the source at rest.

    The similarity follows from iterated closest points (Besl and McKay, A method for registration of 3-D shapes, 1992).
    Its size is that of the source or that of the given pose, whichever fits better.
    """
    chosen = np.unique(np.linspace(0, len(vertices) - 1, REST.aligned).astype(np.int64))
    images, areas, fits = vertices[chosen], areas[chosen], []
    for scale in sorted({1.0, pose.scale}):
        places = pose.common.inverse(images)
        for _ in range(REST.iterations + 1):
            similarity = procrustes(places, images, areas, scales=(scale, scale))
            aligned = similarity.inverse(images)
            places = SurfaceMap(*search.closest(aligned), rest.triangles).interpolate(rest.vertices)
        fits.append((float(areas @ np.linalg.norm(places - aligned, axis=1)), similarity))
    _, common = min(fits, key=lambda fit: fit[0])
    return Pose(common.repeat(len(pose.transforms.scale)), common, 0.0)
