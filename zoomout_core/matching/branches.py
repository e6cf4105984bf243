# SPDX-License-Identifier: GPL-3.0-or-later
"""Find branches of the target, such as fingers, that a finished map sends to the wrong branch, and match them anew.

Fingers that touch, or are closed on one shape and spread on the other, are nearest to the wrong finger of the other
shape. The map is then smooth all the same, so that no edge is torn, but two fingers share one and another is left out.
Tips of branches are maxima of the average geodesic distance. A tip that shares its partner is paired by its geodesic
distances to the other tips, and its branch is registered to the new partner alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, SingleFloats
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.hypotheses.extremities import maxima
from zoomout_core.matching.pair import Pair
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, triangle_normals
from zoomout_core.tuning import Tuning, tuned

# Samples of a branch's surface, and of each of its triangles on average, that places are registered to.
SAMPLES, SAMPLES_OF_TRIANGLE = 20_000, 20
# Fewer tips tell nothing of each other.
MIN_TIPS = 3


@dataclass(frozen=True)
class BranchTuning(Tuning, set_by="everywhere"):
    """Which tips have branches, and how these are registered.

    Attributes:
        persistence: minimum rise of the average distance from the base of a branch to its tip; fingers have 0.024.
        max_count: maximum number of tips of a shape.
        max_length: maximum length of a branch; limbs are told apart by the search for the map.
        claimed: a tip's partner is the one whose branch has most images of the branch's outer part, up to this fraction
            of its length.
        sibling: branches are siblings if their tips are closer than this multiple of their lengths together.
        max_siblings: maximum number of siblings; all their pairings are compared.
        max_difference: maximum mean difference of relative distances among siblings, of a pairing.
        clearly: the map's own pairing is kept unless its difference is more than this multiple of the smallest one.
        checked: fraction of the length of a branch, from the tip, in which images must be on the partner's branch.
        max_wrong: a branch is registered anew if more of its images are on another branch; fewer are filled in.
        rounds: number of alternations of closest points and alignment.
        normal_weight: the distance that counts as much as a unit difference of normals.
        along_weight: the distance that counts as much as a unit of distance from the tip.
    """

    persistence: float = tuned(0.02, "at unit area", 0, 2)
    max_count: int = tuned(24, "tips", 2, 100)
    max_length: float = tuned(0.12, "at unit area", 0, 10)
    claimed: float = tuned(0.5, "1", 0, 1)
    sibling: float = tuned(1.4, "1", 1, 100)
    max_siblings: int = tuned(6, "tips", 3, 8)
    max_difference: float = tuned(0.15, "1", 0, 10)
    clearly: float = tuned(1.3, "1", 1, 100)
    checked: float = tuned(0.9, "1", 0, 1)
    max_wrong: float = tuned(0.3, "1", 0, 1)
    rounds: int = tuned(8, "rounds", 1, 100)
    normal_weight: float = tuned(0.01, "at unit area", 0, 10)
    along_weight: float = tuned(1.0, "1", 0, 10)


BRANCHES = BranchTuning()


class Exchanged(NamedTuple):
    """A map with branches matched anew.

    Attributes:
        surface_map: from the target to the source.
        unsettled: (n_t,) vertices at the bases of these branches, and on wrong branches, to be filled in.
    """

    surface_map: SurfaceMap
    unsettled: Booleans


@dataclass(frozen=True, eq=False)
class _Branches:
    """The branches of a shape.

    Attributes:
        distances: (n, m) geodesic distances of the surface's vertices to the tips, infinite off the body.
        between: (m, m) distances between tips.
        length: (m,) of each branch: half the distance to the nearest other tip, at which the two branches meet.
        group: (m,) number of the group of siblings that each belongs to, such as the fingers of a hand.
    """

    distances: SingleFloats
    between: Floats
    length: Floats
    group: Integers


@dataclass(frozen=True, eq=False)
class _Images:
    """The images of the vertices on the target's branches.

    Attributes:
        vertices: (q,) of the target.
        distances: (q, m) geodesic distances of their images to the source's tips.
    """

    vertices: Integers
    distances: SingleFloats


def exchange_branches(pair: Pair, surface_map: SurfaceMap) -> Exchanged:
    """Match branches anew that a map sends to the wrong branch; nothing is changed where landmarks are exact.

    Args:
        pair: the surfaces.
        surface_map: from the target to the source.
    """
    unsettled = np.zeros(len(pair.target.vertices), dtype=bool)
    shapes = pair.source_shape, pair.target_shape
    if pair.exact_landmarks is not None or any(shape.proxy.full.is_hull for shape in shapes):
        return Exchanged(surface_map, unsettled)
    source, target = _branches(pair.source, shapes[0]), _branches(pair.target, shapes[1])
    if not (len(source.length) and len(target.length)):
        return Exchanged(surface_map, unsettled)
    images = _images(surface_map, source, target)
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    nearest = np.argmin(images.distances, axis=1)
    on_branch = images.distances.min(axis=1) < source.length[nearest]
    for tip, other in _partners(source, target, images).items():
        away = target.distances[:, tip]
        checked = away[images.vertices] < BRANCHES.checked * target.length[tip]
        wrong = checked & on_branch & (nearest != other)
        if wrong.sum() <= BRANCHES.max_wrong * checked.sum():
            unsettled[images.vertices[wrong]] = True
            continue
        found = _register(pair, surface_map, source, target, tip, other)
        if found is not None:
            branch, triangle[branch], barycentric[branch] = found
            unsettled |= np.abs(away / target.length[tip] - 1) < 1 - BRANCHES.checked
    return Exchanged(SurfaceMap(triangle, barycentric, surface_map.source_triangles), unsettled)


def _branches(surface: Surface, shape: ShapeAnalysis) -> _Branches:
    """The branches of a shape that have siblings."""
    vertices, persistence = maxima(shape)
    tips = vertices[persistence > BRANCHES.persistence][: BRANCHES.max_count]
    on_proxy = np.asarray(dijkstra(edge_graph(shape.mesh.vertices, shape.mesh.triangles), indices=tips))
    between = on_proxy[:, tips]
    length = (between + np.diag(np.full(len(tips), np.inf))).min(axis=1, initial=np.inf) / 2
    group = _siblings(between, length)
    kept = np.flatnonzero(np.bincount(group, minlength=1)[group] >= MIN_TIPS)
    distances = np.full((len(surface.vertices), len(kept)), np.inf, dtype=np.float32)
    if len(kept):
        of_body = np.full(len(surface.vertices), -1)
        used = surface.working.vertex_of >= 0
        of_body[used] = shape.proxy.full.vertex_of[surface.working.vertex_of[used]]
        on = np.flatnonzero(of_body >= 0)
        distances[on] = shape.proxy.place.interpolate(on_proxy[kept].T)[of_body[on]]
    return _Branches(distances, between[np.ix_(kept, kept)], length[kept], group[kept])


def _images(surface_map: SurfaceMap, source: _Branches, target: _Branches) -> _Images:
    """Geodesic distances of images to the source's tips, where the target has branches."""
    vertices = np.flatnonzero((target.distances < target.length).any(axis=1))
    corners = surface_map.source_triangles[surface_map.triangle[vertices]]
    barycentric = surface_map.barycentric[vertices].astype(np.float32)
    distances = np.zeros((len(vertices), len(source.length)), dtype=np.float32)
    for number in range(3):  # a corner off the body makes the distance infinite
        distances += np.maximum(barycentric[:, number, None], 1e-9) * source.distances[corners[:, number]]
    return _Images(vertices, distances)


def _partners(source: _Branches, target: _Branches, images: _Images) -> dict[int, int]:
    """The source's tip of each of the target's tips, for tips with siblings, such as fingers.

    Siblings, whose branches grow from one place, are paired with siblings by the distances among them. These decide
    unless the map already pairs the tips about as well.
    """
    nearest = np.full(len(target.length), -1)
    for tip, length in enumerate(target.length):
        outer = target.distances[images.vertices, tip] < BRANCHES.claimed * length
        if outer.any():
            nearest[tip] = np.argmin(np.median(images.distances[outer], axis=0) / source.length)
    partner: dict[int, int] = {}
    for group in np.unique(target.group[nearest >= 0]).tolist():
        tips = np.flatnonzero((target.group == group) & (nearest >= 0))
        others = np.flatnonzero(source.group == np.argmax(np.bincount(source.group[nearest[tips]])))
        if MIN_TIPS <= len(tips) == len(others) <= BRANCHES.max_siblings:
            partner |= _pair_siblings(source, target, tips, others, nearest[tips])
    return partner


def _siblings(between: Floats, length: Floats) -> Integers:
    """(m,) the number of the group of siblings that each tip belongs to; long branches have none.

    Args:
        between: (m, m) distances between tips.
        length: (m,) of the branches.
    """
    short = length < BRANCHES.max_length
    related = (between < BRANCHES.sibling * (length[:, None] + length)) & short & short[:, None]
    return np.asarray(connected_components(related, directed=False)[1])


def _pair_siblings(
    source: _Branches, target: _Branches, tips: Integers, others: Integers, nearest: Integers
) -> dict[int, int]:
    """Pair siblings of the target with as many of the source by the distances among them; empty if these differ.

    Args:
        source: the source's branches.
        target: the target's branches.
        tips: (k,) siblings of the target.
        others: (k,) siblings of the source.
        nearest: (k,) the tip of the source near which the map has each of the target's.
    """
    i, j = np.triu_indices(len(tips), k=1)
    choices = others[np.array(list(permutations(range(len(others)))))]
    of_target, of_source = target.between[tips[i], tips[j]], source.between[choices[:, i], choices[:, j]]
    differences = np.abs(of_target / of_target.mean() - of_source / of_source.mean(axis=1, keepdims=True)).mean(axis=1)
    best = int(np.argmin(differences))
    if differences[best] > BRANCHES.max_difference:
        return {}
    as_it_is = np.flatnonzero((choices == nearest).all(axis=1))
    if len(as_it_is) and differences[as_it_is[0]] < BRANCHES.clearly * differences[best]:
        best = int(as_it_is[0])
    return dict(zip(tips.tolist(), choices[best].tolist(), strict=True))


def _register(
    pair: Pair, surface_map: SurfaceMap, source: _Branches, target: _Branches, tip: int, other: int
) -> tuple[Integers, Integers, Floats] | None:
    """Register a branch of the target to one of the source alone: its vertices, and their triangles and coordinates.

    It begins with the rotation of the map around the base, and the tips on each other. None if the base is unknown.
    """
    length, length_source = target.length[tip], source.length[other]
    away, away_source = target.distances[:, tip], source.distances[:, other]
    branch = np.flatnonzero(away < length)
    around = (away > length) & (away < 2 * length) & (target.distances / target.length > 1).all(axis=1)
    corners = pair.source.triangles
    inside = np.flatnonzero((away_source[corners] < 1.1 * length_source).all(axis=1))
    if around.sum() < 3 or not len(inside):
        return None
    places, rest = pair.target.vertices / pair.target.working.scale, pair.source.vertices / pair.source.working.scale
    images = surface_map.interpolate(rest)
    rotation = procrustes(places[around], images[around], handedness=None).rotation
    base = [
        np.mean(x[(d > 0.8 * full) & (d < full)], axis=0)
        for x, d, full in ((places, away, length), (rest, away_source, length_source))
    ]
    ends = places[np.argmin(away)], rest[np.argmin(away_source)]
    rotation = _rotation_onto(rotation @ (ends[0] - base[0]), ends[1] - base[1]) @ rotation
    scale = length_source / length
    moved = scale * (places[branch] - ends[0]) @ rotation.T + ends[1]
    turned = pair.target.working.vertex_normals[pair.target.working.vertex_of[branch]] @ rotation.T
    count = min(max(SAMPLES_OF_TRIANGLE * len(inside), len(inside)), max(SAMPLES, len(inside)))
    points, on = surface_samples(rest, corners[inside], count)
    on = inside[on]
    normals = _outward_normals(pair.source, on)
    along = away_source[corners[on]].mean(axis=1)
    weights = BRANCHES.normal_weight, BRANCHES.along_weight
    tree = cKDTree(np.column_stack([points, weights[0] * normals, weights[1] * along]))
    goal = scale * away[branch]
    for number in range(BRANCHES.rounds):
        near = tree.query(np.column_stack([moved, weights[0] * turned, weights[1] * goal]))[1]
        if number < BRANCHES.rounds - 1:
            motion = procrustes(moved, points[near], scales=(1.0, 1.0))
            moved, turned = motion(moved), turned @ motion.rotation.T
    triangle = on[near]
    a, b, c = (rest[corners[triangle, i]] for i in range(3))
    return branch, triangle, closest_on_triangles(moved, a, b, c)[0]


def _outward_normals(surface: Surface, triangle: Integers) -> Floats:
    """(q, 3) outward unit normals of triangles of a surface."""
    working = surface.working
    number = np.zeros(len(surface.triangles), dtype=np.int64)
    number[working.triangle_of] = np.arange(len(working.triangles))
    return np.asarray(triangle_normals(working.vertices, working.oriented_triangles)[number[triangle]])


def _rotation_onto(one: Floats, other: Floats) -> Floats:
    """(3, 3) the rotation that takes one direction to another the short way (Rodrigues)."""
    a, b = one / np.linalg.norm(one), other / np.linalg.norm(other)
    axis, cosine = np.cross(a, b), float(a @ b)
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + cross + cross @ cross / (1 + max(cosine, -0.999))
