# SPDX-License-Identifier: GPL-3.0-or-later
"""Find fingers and other branches that a finished map sends to the wrong branch, and rematch them.

If fingers touch on one shape and are spread on the other, the finger that is nearest in space is often the wrong one.
The map then tears no edge, but two fingers map to the same one, and another finger receives nothing. The tips of
branches are maxima of the average geodesic distance. The tips of a hand are paired with those of the other hand by
their mutual geodesic distances. A branch with images on a wrong branch is registered to its own partner.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats, Integers, SingleFloats, all_in_row, any_in_row
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.hypotheses.extremities import maxima
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import at_all, edge_graph
from zoomout_core.tuning import Tuning, tuned

# Maximum number of samples of a branch to which another one is registered, and their average number on a triangle.
SAMPLES, SAMPLES_OF_TRIANGLE = 20_000, 20
# Iterations of closest points and alignment, and the vertices that are aligned; more of either change nothing.
ROUNDS, ALIGNED_VERTICES = 3, 2000
# Relative distance from the tip up to which a triangle belongs to the branch that another one is registered to.
MARGIN = 1.1
# Two tips have only one distance, which cannot distinguish them.
MIN_TIPS = 3


@dataclass(frozen=True)
class BranchTuning(Tuning, set_by="everywhere"):
    """The conditions for tips to have branches, and for branches to be siblings."""

    persistence: float = tuned(0.02, "at unit area", 0, 2)  # minimum rise of the average distance to a tip
    max_count: int = tuned(24, "tips", 2, 100)  # maximum number of tips of a shape
    max_length: float = tuned(0.12, "at unit area", 0, 10)  # of a branch; the search pairs limbs
    claimed: float = tuned(0.5, "1", 0, 1)  # fraction, from the tip, whose images decide about the map's pairing
    sibling: float = tuned(1.4, "1", 1, 100)  # largest distance of siblings' tips, in their total length
    max_siblings: int = tuned(6, "tips", 3, 8)  # maximum number of siblings; all pairings of them are compared
    max_difference: float = tuned(0.06, "1", 0, 10)  # of relative distances among siblings, on average
    margin: float = tuned(0.02, "1", 0, 10)  # in the difference, by which the map's own pairing may exceed the smallest
    checked: float = tuned(0.9, "1", 0, 1)  # fraction, from the tip, whose images must be on the partner's branch


BRANCHES = BranchTuning()


@dataclass(frozen=True, eq=False)
class Branches:
    """The branches of a shape."""

    distances: SingleFloats  # (n, m) geodesic distances of the surface's vertices to the tips, infinite off the body
    between: Floats  # (m, m) distances between tips
    length: Floats  # (m,) of each branch: half the distance to the nearest other tip, at which the two branches meet
    group: Integers  # (m,) number of the group of siblings that each belongs to, such as the fingers of a hand


def branches_of(pair: Pair) -> tuple[Branches, Branches] | None:
    """The branches of the source and of the target; None if there are none, or if maps keep exact landmarks."""
    shapes = pair.source_shape, pair.target_shape
    if pair.exact_landmarks is not None or any(shape.proxy.full.is_hull for shape in shapes):
        return None
    source, target = _branches(pair.source, shapes[0]), _branches(pair.target, shapes[1])
    return (source, target) if len(source.length) and len(target.length) else None


def exchange_branches(
    pair: Pair, surface_map: SurfaceMap, branches: tuple[Branches, Branches] | None
) -> tuple[SurfaceMap, Booleans]:
    """Rematch branches that a map sends to the wrong branch.

    Returns the map, and (n_t,) the vertices at the bases of these branches, whose images must be filled in.
    """
    unsettled = np.zeros(len(pair.target.vertices), dtype=bool)
    if branches is None:
        return surface_map, unsettled
    source, target = branches
    vertices, distances = _images(surface_map, source, target)
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    nearest = np.argmin(distances, axis=1)
    on_branch = distances.min(axis=1) < source.length[nearest]
    for tip, other in _partners(source, target, vertices, distances).items():
        away = target.distances[:, tip] / target.length[tip]
        wrong = (away[vertices] < BRANCHES.checked) & on_branch & (nearest != other)
        found = _register(pair, surface_map, source, target, tip, other) if wrong.any() else None
        if found is not None:
            branch, triangle[branch], barycentric[branch] = found
            unsettled |= np.abs(away - 1) < 1 - BRANCHES.checked
    return SurfaceMap(triangle, barycentric, surface_map.source_triangles), unsettled


def _branches(surface: Surface, shape: ShapeAnalysis) -> Branches:
    """The branches of a shape that have siblings."""
    vertices, persistence = maxima(shape)
    tips = vertices[persistence > BRANCHES.persistence][: BRANCHES.max_count]
    on_proxy = np.asarray(dijkstra(edge_graph(shape.mesh.vertices, shape.mesh.triangles), indices=tips))
    between = on_proxy[:, tips]
    length = (between + np.diag(np.full(len(tips), np.inf))).min(axis=1, initial=np.inf) / 2
    short = length < BRANCHES.max_length  # long branches have no siblings
    related = (between < BRANCHES.sibling * (length[:, None] + length)) & short & short[:, None]
    group = np.asarray(connected_components(related, directed=False)[1], dtype=np.int64)
    kept = np.flatnonzero(np.bincount(group, minlength=1)[group] >= MIN_TIPS)
    distances = np.full((len(surface.vertices), len(kept)), np.inf, dtype=np.float32)
    if len(kept):
        of_body = shape.proxy.full.vertex_of
        on = np.flatnonzero(of_body >= 0)
        place, at = shape.proxy.place, of_body[on]
        of_surface = SurfaceMap(place.triangle[at], place.barycentric[at], place.source_triangles)
        distances[on] = of_surface.interpolate(on_proxy[kept].T)
    return Branches(distances, between[np.ix_(kept, kept)], length[kept], group[kept])


def _images(surface_map: SurfaceMap, source: Branches, target: Branches) -> tuple[Integers, SingleFloats]:
    """(q,) the vertices on the target's branches, and (q, m) distances of their images to the source's tips."""
    vertices = np.flatnonzero(any_in_row(target.distances < target.length))
    corners = surface_map.source_triangles[surface_map.triangle[vertices]]
    barycentric = surface_map.barycentric[vertices].astype(np.float32)
    distances = np.zeros((len(vertices), len(source.length)), dtype=np.float32)
    for number in range(3):  # a corner off the body makes the distance infinite
        distances += np.maximum(barycentric[:, number, None], 1e-9) * source.distances[corners[:, number]]
    return vertices, distances


def _partners(source: Branches, target: Branches, vertices: Integers, distances: SingleFloats) -> dict[int, int]:
    """The source's tip of each of the target's tips, for tips with siblings, such as fingers.

    Siblings, whose branches begin at one place, are paired with siblings by the distances among them, unless the map
    already pairs the tips about as well.
    """
    nearest = np.full(len(target.length), -1)
    for tip, length in enumerate(target.length):
        outer = target.distances[vertices, tip] < BRANCHES.claimed * length
        if outer.any():
            nearest[tip] = np.argmin(np.median(distances[outer], axis=0) / source.length)
    partner: dict[int, int] = {}
    for group in np.unique(target.group[nearest >= 0]).tolist():
        tips = np.flatnonzero((target.group == group) & (nearest >= 0))
        others = np.flatnonzero(source.group == np.argmax(np.bincount(source.group[nearest[tips]])))
        if MIN_TIPS <= len(tips) == len(others) <= BRANCHES.max_siblings:
            partner |= _pair_siblings(source, target, tips, others, nearest[tips])
    return partner


def _pair_siblings(
    source: Branches, target: Branches, tips: Integers, others: Integers, nearest: Integers
) -> dict[int, int]:
    """Pair siblings (k,) of the target with k of the source by the distances among them; empty if these differ.

    The map sends each of the target's tips near the source's tip `nearest` (k,).
    """
    i, j = np.triu_indices(len(tips), k=1)
    choices = others[np.array(list(permutations(range(len(others)))))]
    of_target, of_source = target.between[tips[i], tips[j]], source.between[choices[:, i], choices[:, j]]
    differences = np.abs(of_target / of_target.mean() - of_source / of_source.mean(axis=1, keepdims=True)).mean(axis=1)
    best = int(np.argmin(differences))
    if differences[best] > BRANCHES.max_difference:
        return {}
    as_it_is = np.flatnonzero((choices == nearest).all(axis=1))
    if len(as_it_is) and differences[as_it_is[0]] < differences[best] + BRANCHES.margin:
        best = int(as_it_is[0])
    return dict(zip(tips.tolist(), choices[best].tolist(), strict=True))


def _register(
    pair: Pair, surface_map: SurfaceMap, source: Branches, target: Branches, tip: int, other: int
) -> tuple[Integers, Integers, Floats] | None:
    """Register a branch of the target to one of the source alone, by rigid ICP (Besl and McKay 1992).

    It starts with both tips at the same point, first rotated like the map around the base, then along the other branch.
    Returns (q,) the branch's vertices, (q,) triangles of the source, and (q, 3) barycentric coordinates; None if the
    meshes are too coarse to determine the rotation.
    """
    away, away_source = target.distances[:, tip] / target.length[tip], source.distances[:, other] / source.length[other]
    places, rest = pair.target.vertices / pair.target.working.scale, pair.source.vertices / pair.source.working.scale
    corners = pair.source.triangles
    branch, inside = np.flatnonzero(away < 1), np.flatnonzero(at_all(away_source < MARGIN, corners))
    around = np.flatnonzero((away > 1) & (away < 2))
    around = around[all_in_row(target.distances[around] > target.length)]
    bases = [x[(share > 0.8) & (share < 1)] for x, share in ((places, away), (rest, away_source))]
    if len(around) < MIN_TIPS or not len(inside) or not all(map(len, bases)):
        return None
    base, base_source = (each.mean(axis=0) for each in bases)
    end, end_source = places[np.argmin(away)], rest[np.argmin(away_source)]
    images = SurfaceMap(surface_map.triangle[around], surface_map.barycentric[around], corners).interpolate(rest)
    turn = procrustes(places[around], images, handedness=None).rotation
    along, _ = Rotation.align_vectors([end_source - base_source], [turn @ (end - base)])
    scale = source.length[other] / target.length[tip]
    moved = scale * along.apply((places[branch] - end) @ turn.T) + end_source
    count = max(len(inside), min(SAMPLES, SAMPLES_OF_TRIANGLE * len(inside)))
    points, on = surface_samples(rest, corners[inside], count)
    tree = cKDTree(points)
    some = np.linspace(0, len(moved) - 1, min(len(moved), ALIGNED_VERTICES)).astype(int)
    for _ in range(ROUNDS):
        aligned = moved[some]
        moved = procrustes(aligned, points[tree.query(aligned)[1]], scales=(1.0, 1.0))(moved)
    triangle = inside[on[tree.query(moved)[1]]]
    a, b, c = (rest[corners[triangle, i]] for i in range(3))
    return branch, triangle, closest_on_triangles(moved, a, b, c)[0]
