# SPDX-License-Identifier: GPL-3.0-or-later
"""Find loose parts of the source that the target shows fused with its body, such as the horns of a remeshed cow.

The body's map sends them to the body around the part. The target is registered there to the source's outside by
iterated closest points in both directions: Besl and McKay, A method for registration of 3-D shapes (1992). The target
has the part if its shape fits the part closely, the part fits it, and the body beside the part does not.

Lengths are at unit area of the source's body.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.label_borders import border_lengths, shorten_borders
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.matching.components.part_borders import PART_BORDERS, adjacency
from zoomout_core.matching.components.part_motions import robust_weights
from zoomout_core.matching.components.parts import BODY_MAP_ERROR, Part, Side
from zoomout_core.matching.components.similarity_field import SimilarityField
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.memory_cache import cached_hull
from zoomout_core.mesh.triangles import area_normals, triangle_areas, unique_edges, unit_vectors
from zoomout_core.tuning import Tuning, tuned

# Samples of the target around a part, and of the source's outside for a unit of area. One in `SPARSE` is registered.
SAMPLES, OUTSIDE_DENSITY, SPARSE = 1200, 45_000, 3
# A part with fewer visible samples has no shape to look for.
MIN_SAMPLES = 12
# Rounds of the registration by the body's map, by closest points of the body, and by those of the part as well.
MAP_ROUNDS, BODY_ROUNDS, ROUNDS = 6, 5, 5
# Tolerance of the points of the source that are closest to its hull, which is a voxel away.
TOLERANCE = 0.001
# Radius around a part in which the body places it, in sizes of its visible area.
SURROUNDINGS = 2.0
# Weight of normals against positions, in sizes of the part, or in `BODY_MAP_ERROR` where that is smaller.
NORMAL_WEIGHT = 0.5
# Maximum ratio of the map's scale beside a part to that on the body.
MAX_SCALE = 1.35


@dataclass(frozen=True)
class FusedPartTuning(Tuning, set_by="everywhere"):
    """When a target has a part of the source fused with its body."""

    # Root mean square distance between part and target, both ways. Horns and eyes of remeshed animals of the same or
    # another species have at most .21, a very small one .26. Animals that have ears there instead have .36 and more.
    residual: float = tuned(0.28, "sizes of the part", 0, 1)
    # Ratio of the distance of the target's patch from the body to that from the part: flush parts have about 1, horns
    # and eyes 3.7 and more.
    gain: float = tuned(2.0, "1", 0, 100)


FUSED_PARTS = FusedPartTuning()


class FusedPart(NamedTuple):
    """A loose part of the source that is fused with the target's body."""

    vertices: Integers  # (n,) of the target's working mesh, that show it
    points: Floats  # (n, 3) where they are on the source
    normals: Floats  # (n, 3) theirs there
    residual: float  # of the registration, in sizes of the part


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Points on a surface with normals, prepared for searches."""

    points: Floats  # (n, 3)
    normals: Floats  # (n, 3)
    weight: float  # of normals

    @cached_property
    def rows(self) -> Floats:
        """(n, 6) coordinates in which closest points also have similar normals."""
        return np.hstack([self.points, self.weight * self.normals])

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.rows)

    def __getitem__(self, chosen: Integers | Booleans | slice) -> _Cloud:
        return _Cloud(self.points[chosen], self.normals[chosen], self.weight)

    def move(self, motion: Similarities) -> _Cloud:
        return _Cloud(motion(self.points), self.normals @ motion.rotation.T, self.weight)

    def distances(self, other: _Cloud) -> Floats:
        """(n,) from its points to those of another cloud that are closest."""
        near = other.tree.query(self.rows)[1]
        return np.asarray(np.linalg.norm(self.points - other.points[near], axis=1))


def find_fused(
    pair: Pair, images: Floats, motion: SimilarityField, source: Side, target: Side, parts: Mapping[int, Part]
) -> dict[int, FusedPart]:
    """Find the parts of the source, by number, that are fused with the target's body.

    The images (b, 3) of the body's vertices are on the source's body, and determine its motion.
    """
    if not parts:
        return {}
    points, normals, component = _outside(pair, source, list(parts.values()))
    outside = _Cloud(points, normals, 1.0)
    found = {
        number: _find_part(part, outside, component, images, motion.handedness, source, target)
        for number, part in parts.items()
    }
    return {number: each for number, each in found.items() if each is not None}


def _outside(pair: Pair, source: Side, parts: Sequence[Part]) -> tuple[Floats, Floats, Integers]:
    """(s, 3) points on the source's outside near its parts, (s, 3) normals, and (s,) the components that have them."""
    mesh, hull = source.mesh, cached_hull(pair.source)
    ratio = mesh.scale / pair.source_shape.proxy.full.scale
    vertices = mesh.from_surface(hull.to_surface(hull.vertices)) * ratio
    reach = SURROUNDINGS * max(part.size for part in parts) + BODY_MAP_ERROR
    tree = cKDTree(np.concatenate([part.points for part in parts]))
    around = hull.triangles[_within(reach, tree, vertices)[hull.triangles].all(axis=1)]
    on_hull, _ = _samples(vertices, around)
    on, weights = closest_points(on_hull, source.points, mesh.triangles, TOLERANCE)
    points = np.einsum("nc,ncx->nx", weights, source.points[mesh.triangles[on]])
    normals = unit_vectors(area_normals(source.points, mesh.oriented_triangles[on]))
    return points, normals, mesh.component[mesh.triangles[on, 0]]


def _within(reach: float, tree: cKDTree, points: Floats) -> Booleans:
    """(n,) which points (n, 3) are nearer to those of a tree than some distance."""
    return np.asarray(tree.query(points, distance_upper_bound=reach)[0]) < reach


def _samples(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers]:
    """(s, 3) even points on triangles (m, 3), and (s,) which they are on."""
    count = int(OUTSIDE_DENSITY * triangle_areas(vertices, triangles).sum())
    return surface_samples(vertices, triangles, count) if count else (np.zeros((0, 3)), np.zeros(0, dtype=np.int64))


def _find_part(
    part: Part,  # of the source
    outside: _Cloud,  # (s,) points on the source's outside
    component: Integers,  # (s,) the source's component that has each of them
    images: Floats,  # (b, 3) of the target's body on the source's
    handedness: float,  # of the body's motion
    source: Side,
    target: Side,
) -> FusedPart | None:
    """A part as the target shows it, or None if the target lacks it."""
    is_part = component == source.mesh.component[part.vertices[0]]
    if is_part.sum() < MIN_SAMPLES:
        return None
    visible = outside.points[is_part]
    size = float(np.sqrt(np.var(visible, axis=0).sum()))
    reach, weight = SURROUNDINGS * size + BODY_MAP_ERROR, NORMAL_WEIGHT * min(size, BODY_MAP_ERROR)
    tree = cKDTree(visible)
    near = _within(reach, tree, outside.points)
    theirs, is_part = _Cloud(outside.points[near], outside.normals[near], weight), is_part[near]
    around = np.zeros(len(target.points), dtype=bool)
    around[target.body_vertices] = _within(reach, tree, images)
    triangles = target.mesh.oriented_triangles[around[target.mesh.triangles].all(axis=1)]
    if is_part.all() or not len(triangles):
        return None
    points, on = surface_samples(target.points, triangles, SAMPLES)
    ours = _Cloud(points, unit_vectors(area_normals(target.points, triangles[on])), weight)
    on_body = np.zeros_like(target.points)
    on_body[target.body_vertices] = images
    some = slice(None, None, SPARSE)
    motion = _register(
        ours[some], theirs[some], theirs[is_part][some], on_body[triangles[on[some]]].mean(axis=1), handedness
    )
    moved = ours.move(motion)
    patch = moved[is_part[theirs.tree.query(moved.rows)[1]]]
    if not len(patch.points):
        return None
    off, back = _rms_distance(patch, theirs[is_part]), _rms_distance(theirs[is_part], moved)
    residual = max(off, back) / size
    if residual > FUSED_PARTS.residual or _lies_on_body(patch, off, source, SURROUNDINGS * size, tree):
        return None
    vertices = np.flatnonzero(around)
    vertices = vertices[_within(size, tree, motion(target.points[vertices]))]
    placed = _Cloud(target.points[vertices], target.mesh.vertex_normals[vertices], weight).move(motion)
    shown = _is_shown(placed, theirs[is_part], theirs[~is_part], vertices, target)
    return FusedPart(vertices[shown], placed.points[shown], placed.normals[shown], residual) if shown.any() else None


def _register(ours: _Cloud, theirs: _Cloud, part: _Cloud, images: Floats, handedness: float) -> Similarities:
    """Move points of the target, whose images (n, 3) are on the source's body, onto its body and its part."""
    weights = np.ones(len(images))
    for _ in range(MAP_ROUNDS):
        motion = procrustes(ours.points, images, weights, handedness)
        distances = np.linalg.norm(motion(ours.points) - images, axis=1)
        weights = robust_weights(distances, float(np.median(distances)))
    scales = motion.scale / MAX_SCALE, motion.scale * MAX_SCALE
    for number in range(BODY_ROUNDS + ROUNDS):
        moved = ours.move(motion)
        points, goals = ours.points, theirs.points[theirs.tree.query(moved.rows)[1]]
        if number >= BODY_ROUNDS:  # before, the part would pull ears or the like to itself
            back = moved.tree.query(part.rows)[1]
            points, goals = np.concatenate([points, points[back]]), np.concatenate([goals, part.points])
        distances = np.linalg.norm(motion(points) - goals, axis=1)
        motion = procrustes(points, goals, robust_weights(distances, float(np.median(distances))), handedness, scales)
    return motion


def _rms_distance(some: _Cloud, others: _Cloud) -> float:
    """Root mean square distance from points to the closest ones of others."""
    return float(np.sqrt(np.mean(np.square(some.distances(others)))))


def _lies_on_body(patch: _Cloud, off: float, source: Side, reach: float, tree: cKDTree) -> bool:
    """Whether the source's body fits a patch as well as the part does, whose distances to it are `off`.

    The body continues below the part. Everything near the points of the tree, the part's visible ones, counts.
    """
    triangles = source.mesh.oriented_triangles[~source.loose[source.mesh.triangles[:, 0]]]
    triangles = triangles[_within(reach, tree, source.points)[triangles].any(axis=1)]
    points, on = _samples(source.points, triangles)
    normals = unit_vectors(area_normals(source.points, triangles[on]))
    return len(points) > 0 and _rms_distance(patch, _Cloud(points, normals, patch.weight)) < FUSED_PARTS.gain * off


def _is_shown(placed: _Cloud, part: _Cloud, body: _Cloud, vertices: Integers, target: Side) -> Booleans:
    """(n,) which of the target's vertices (n,), placed on the source, show a part rather than its body."""
    number = np.full(len(target.points), -1)
    number[vertices] = np.arange(len(vertices))
    corners = number[target.mesh.triangles]
    edges, _ = unique_edges(corners[(corners >= 0).all(axis=1)])
    graph = adjacency(edges, len(vertices))
    areas = target.areas[vertices]
    cost = np.column_stack([placed.distances(body), placed.distances(part)]) * areas[:, None]
    chosen = shorten_borders(
        np.repeat(np.arange(len(vertices)), 2),
        np.tile([0, 1], len(vertices)),
        cost.ravel() / PART_BORDERS.straightening**2,
        border_lengths(placed.points, areas, graph),
    )
    return np.asarray(chosen % 2 == 1)
