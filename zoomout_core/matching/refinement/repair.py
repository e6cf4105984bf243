# SPDX-License-Identifier: GPL-3.0-or-later
"""Repair a finished map: rematch wrong branches, find where it tears the target apart, and fill these places in.

A map that is right as a whole may still send a patch of the target to another limb, finger or lip, where the source's
surfaces face each other. Closest points cannot distinguish the two sides, but geodesic distances can: the images of two
neighbours are close in space and far apart along the surface. Such patches, and edges whose images are far too long,
are filled in from the rest, by Poisson's equation or harmonically, like inpainted weights (Abdrashitov et al. 2023).
They are then projected to points of the source that are also nearby along its surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, SingleFloats, row_norms, take_rows
from zoomout_core.geometry.closest_points import closest_on_triangles, search_tree
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import SMALLEST, Moments, products
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.maps.surface_map import SurfaceMap, interpolation_matrix
from zoomout_core.matching.pair import Pair, landmark_points
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.refinement.branches import branches_of, exchange_branches
from zoomout_core.matching.registration.correspondences import BOUND_SAMPLES, MAX_GEODESIC_DISTANCE
from zoomout_core.matching.registration.nonrigid_icp import replace_images
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import components, edge_lengths, triangle_normals, unique_edges, vertex_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned

# Edges that are compared at once, and places to project times candidates: so few that they stay in the processor's
# cache.
EDGES, PLACES = 1 << 12, 1 << 16
# Samples of each triangle, on average, that are enough on coarse sources.
SAMPLES_OF_TRIANGLE = 20
# Share of the variance that keeps the linear fit around flat patches stable, and number of neighbourhoods that show
# whether a map preserves orientation.
RIDGE, NEIGHBOURHOODS = 0.03, 1000
# Share of the target's area below which a component is too small, as a strand of hair is, to have parts cut off.
SMALL_COMPONENT = 0.05
# Nearest samples to compare first: for nine goals in ten they decide.
FIRST_CANDIDATES = 12
# Multiple by which a geodesic distance beyond the limit counts: only if all candidates are beyond it one is taken.
BEYOND = 1e3


@dataclass(frozen=True)
class RepairTuning(Tuning, set_by="everywhere"):
    """Which edges are torn, and how their surroundings are projected to the source."""

    max_stretch: float = tuned(4.0, "1", 1, 100)  # torn edges are longer than this multiple of the median ratio,
    min_length: float = tuned(0.02, "at unit area", 0, 1)  # and longer than this
    # Edges from this multiple on may cut a part off. On 60 pairs, some of them damaged, 65 % of the area that they cut
    # off is off by more than 0.1. With `max_stretch` it is 60 % of an area that is a fifth smaller.
    seam: float = tuned(3.0, "1", 1, 100)
    small_patch: float = tuned(0.02, "1", 0, 1)  # patches below this part of their component are filled in
    min_trusted: float = tuned(0.5, "1", 0, 1)  # a component is repaired only if this fraction of its area is not torn
    samples: int = tuned(120_000, "points", 1, 10_000_000)  # of the source to project to, or all its triangles
    candidates: int = tuned(48, "points", 2, 1000)  # nearest samples that are compared
    normal_weight: float = tuned(0.02, "at unit area", 0, 10)  # distance that equals a unit difference of normals
    # Rounds of filling, as long as something is torn. Between a knight and a heavy man, .60 % of the edges are torn
    # after one, .27 % after two, .24 % after three, and .22 % after five.
    rounds: int = tuned(3, "rounds", 1, 100)
    # Longest edge to a vertex that is filled in along with torn ones: on coarse meshes the next vertex is far away.
    around: float = tuned(0.05, "at unit area", 0, 10)
    rings: int = tuned(4, "edges", 1, 100)  # distance around a patch that its motion is fitted to
    max_scale: float = tuned(2.0, "1", 1, 100)  # of a patch
    geodesic_weight: float = tuned(0.3, "1", 0, 10)  # the distance that counts as much as a unit of geodesic distance


REPAIR = RepairTuning()


class Repair(NamedTuple):
    """A repaired map."""

    surface_map: SurfaceMap  # from the target to the source
    filled: Booleans  # (n_t,) vertices whose images were filled in from their surroundings
    torn: Booleans  # (n_t,) vertices at edges that are torn still
    # (n_t,) share of its component's area, in [0, 1], that a vertex can reach without crossing a tear. Small on a limb
    # that is mapped to another limb. Filled places and small components count as connected with everything.
    connected: Floats


class _Images(NamedTuple):
    """The images of the working vertices of a target."""

    triangle: Integers  # (n,) of the source's working mesh
    barycentric: Floats  # (n, 3)
    features: SingleFloats  # (n, 6 + d) positions, normals, and geodesic distances to some samples, at unit area

    def at(self, vertices: Integers) -> _Images:
        """The images of some vertices (q,)."""
        return _Images(self.triangle[vertices], self.barycentric[vertices], take_rows(self.features, vertices))

    def replace_at(self, vertices: Integers, by: _Images) -> None:
        """Replace the images of some vertices (q,), in place."""
        self.triangle[vertices], self.barycentric[vertices], self.features[vertices] = by


class _Meshes:
    """The working meshes of a pair, prepared once to fill in any of its maps."""

    def __init__(self, pair: Pair, has_partner: Booleans | None = None) -> None:
        self.source, self.target = pair.source.working, pair.target.working
        # (n_s, 6 + d) the features of the source's vertices, see `_Images`.
        places = self.source.vertices, self.source.vertex_normals, _marks(pair.source, pair.source_shape)
        self.features: SingleFloats = np.hstack([each.astype(np.float32) for each in places])
        # (m_surface,) the working triangle of each triangle of the source's surface.
        self.triangle_number = np.zeros(len(pair.source.triangles), dtype=np.int64)
        self.triangle_number[self.source.triangle_of] = np.arange(len(self.source.triangles))
        known = np.ones(len(self.target.vertices), dtype=bool)
        if has_partner is not None:
            known[self.target.vertex_of[self.target.vertex_of >= 0]] = has_partner[self.target.vertex_of >= 0]
        self.edges, _ = unique_edges(self.target.triangles)  # (e, 2) of the target
        self.known = known[self.edges].all(axis=1)  # (e,) which of them join vertices with a partner, and can be torn
        self.length = edge_lengths(self.target.vertices, self.edges)  # (e,)
        self.areas = vertex_areas(self.target.vertices, self.target.triangles) * known  # (n,) of vertices with one
        self.fixed = np.zeros(len(self.areas), dtype=bool)  # (n,) vertices at exact landmarks
        if pair.exact_landmarks is not None:
            used = np.flatnonzero(self.target.vertex_of >= 0)
            points = landmark_points(pair, pair.exact_landmarks)[1]
            near = cKDTree(pair.target.vertices[used]).query(points)[1]
            self.fixed[self.target.vertex_of[used[near]]] = True

    def images_by(self, surface_map: SurfaceMap, vertices: Integers | slice = slice(None)) -> _Images:
        """The images of some working vertices of the target by a map of its surface."""
        member = self.target.surface_vertex[vertices]
        return self.images(self.triangle_number[surface_map.triangle[member]], surface_map.barycentric[member])

    def images(self, triangle: Integers, barycentric: Floats) -> _Images:
        """Images by their triangles (q,) and barycentric coordinates (q, 3), with their features."""
        weights = interpolation_matrix(
            take_rows(self.source.triangles, triangle), barycentric.astype(np.float32), len(self.features)
        )
        return _Images(triangle, barycentric, np.asarray(weights @ self.features))

    @cached_property
    def graph(self) -> csr_array:
        """(n, n) adjacency of the target's vertices."""
        ends = np.concatenate([self.edges, self.edges[:, ::-1]])
        return csr_array((np.ones(len(ends)), ends.T), shape=(len(self.areas), len(self.areas)))

    @cached_property
    def samples(self) -> tuple[cKDTree, Integers]:
        """A search tree of samples of the source with their normals, and (c,) the triangle of each."""
        source = self.source
        count = len(source.triangles) * SAMPLES_OF_TRIANGLE
        count = max(min(count, REPAIR.samples), len(source.triangles))
        points, on = surface_samples(source.vertices, source.triangles, count)
        normals = triangle_normals(source.vertices, source.oriented_triangles)[on]
        places = np.hstack([points, REPAIR.normal_weight * normals])
        return search_tree(places), on


def repair(pair: Pair, surface_map: SurfaceMap, has_partner: Booleans | None = None) -> Repair:
    """Rematch branches that are on the wrong branch, and fill in torn places; exact landmarks keep their images.

    Of a part, only vertices that have a partner (n_t,) can be torn apart: others have their images anywhere.

    Bases of rematched branches may show further wrong branches, and what a filling leaves torn is filled in again, from
    surroundings that have become smoother.
    """
    meshes, of_both = _Meshes(pair, has_partner), branches_of(pair)
    branches = filled = np.zeros(len(pair.target.vertices), dtype=bool)
    connected = np.ones(len(branches))
    images = meshes.images_by(surface_map)
    length = _lengths(images.features, meshes.edges)
    for _ in range(REPAIR.rounds):
        exchanged, bases = exchange_branches(pair, surface_map, of_both)
        moved = exchanged.triangle != surface_map.triangle
        branches = branches | moved
        moved = (moved | (exchanged.barycentric != surface_map.barycentric).any(axis=1))[meshes.target.surface_vertex]
        at, beside = np.flatnonzero(moved), moved[meshes.edges].any(axis=1)  # all else is known from the last round
        images.replace_at(at, meshes.images_by(exchanged, at))
        length[beside] = _lengths(images.features, meshes.edges[beside])
        found = _fill_torn(meshes, exchanged, images, length, bases, branches)
        surface_map, filled = found.surface_map, filled | found.filled
        connected = np.minimum(connected, found.connected)
        if not (bases.any() or found.torn.any()):
            break
    return Repair(surface_map, filled, found.torn, connected)


def _fill_torn(
    meshes: _Meshes,
    surface_map: SurfaceMap,
    images: _Images,
    length: Floats,
    bases: Booleans,
    branches: Booleans,
) -> Repair:
    """Fill in the places at which a map is torn, and the bases (n_t,) of branches (n_t,) that were rematched.

    The images of the working vertices, and the lengths (e,) of the images of their edges, are updated in place.
    """
    source, target, edges = meshes.source, meshes.target, meshes.edges
    member = target.surface_vertex
    known = meshes.known if meshes.known.any() else np.ones(len(edges), dtype=bool)
    limit = REPAIR.max_stretch * float(np.median((length / np.maximum(meshes.length, SMALLEST))[known]))
    torn = _torn(length, meshes.length, limit) & meshes.known
    seams = _torn(length, meshes.length, limit * REPAIR.seam / REPAIR.max_stretch) & meshes.known
    connected = _connected_share(meshes, seams)
    filled = ((_to_fill(meshes, torn) & ~branches[member]) | bases[member]) & ~meshes.fixed
    if filled.any():
        beside = filled[edges].any(axis=1)  # edges that the filling changes
        _fill(images, filled, meshes, beside, limit / REPAIR.max_stretch * meshes.length[beside])
        length[beside] = _lengths(images.features, edges[beside])
        torn = _torn(length, meshes.length, limit) & meshes.known
    at_torn = np.zeros(len(filled), dtype=bool)
    at_torn[edges[torn]] = True
    vertex_of = target.vertex_of
    changed = np.flatnonzero(_on_surface(filled, vertex_of))
    new_triangle = source.triangle_of[images.triangle[vertex_of[changed]]]
    new = SurfaceMap(new_triangle, images.barycentric[vertex_of[changed]], surface_map.source_triangles)
    repaired = replace_images(surface_map, changed, new)
    area = np.bincount(target.component, meshes.areas)
    connected[filled | meshes.fixed | (area < SMALL_COMPONENT * area.sum())[target.component]] = 1
    return Repair(
        repaired,
        _on_surface(filled, vertex_of),
        _on_surface(at_torn & ~meshes.fixed, vertex_of),
        np.where(vertex_of >= 0, connected[vertex_of], 1.0),
    )


def _fill(images: _Images, filled: Booleans, meshes: _Meshes, beside: Booleans, usual: Floats) -> None:
    """Replace images of vertices (n,) by the filling that distorts their patch least, in place.

    The lengths `usual` (b,) are those of the images of edges `beside` (e,) these vertices if the map is not distorted.
    Patches that are distorted least as they are keep their images, and are no longer among the filled vertices.
    """
    vertices, ends = np.unique(meshes.edges[beside], return_inverse=True)
    fills = [images.at(vertices)]
    for some, fill in _fills(images, filled, meshes):
        fills.append(images.at(vertices))
        fills[-1].replace_at(np.searchsorted(vertices, some), fill)
    best = _choose_images(fills, filled[vertices], ends.reshape(-1, 2), usual)
    for choice, fill in enumerate(fills):
        chosen = np.flatnonzero(best == choice)
        images.replace_at(vertices[chosen], fill.at(chosen))
    filled[vertices[best == 0]] = False


def _marks(source: Surface, shape: ShapeAnalysis) -> Floats:
    """(n, d) geodesic distances from some samples of a shape to the working vertices of its surface.

    The largest difference of two rows bounds the geodesic distance from below. Distances on a hull distinguish neither
    the two sides of a wing nor touching parts. On a hull all are zero, and edges are judged by their lengths in space.
    """
    working, body = source.working, shape.proxy.full
    if body.is_hull:
        return np.zeros((len(working.vertices), 1))
    of_body = np.full(len(working.vertices), -1)
    used = working.vertex_of >= 0
    of_body[working.vertex_of[used]] = body.vertex_of[used]
    beside = np.flatnonzero(of_body < 0)
    if len(beside):  # loose parts are where the body is next to them
        places = body.from_surface(working.to_surface(working.vertices[beside]))
        of_body[beside] = cKDTree(body.vertices).query(places)[1]
    place = shape.proxy.place
    at_vertices = SurfaceMap(place.triangle[of_body], place.barycentric[of_body], place.source_triangles)
    return at_vertices.interpolate(shape.distances[:BOUND_SAMPLES].T)


def _choose_images(tried: Sequence[_Images], filled: Booleans, edges: Integers, usual: Floats) -> Integers:
    """(n,) for each vertex the number of the images that stretch and shrink the edges (e, 2) of its patch least.

    `usual` (e,) are the lengths that the edges' images have if the map is not distorted.
    """
    among = filled[edges]
    patch = components(edges[among.all(axis=1)], len(filled))
    touched = among.any(axis=1)
    of_edge, usual = patch[np.where(among[:, 0], edges[:, 0], edges[:, 1])][touched], usual[touched]
    distortion = []
    for images in tried:
        length = _lengths(images.features, edges[touched])
        is_off = (length > REPAIR.max_stretch * usual) | (REPAIR.max_stretch * length < usual)
        distortion.append(np.bincount(of_edge, is_off * np.abs(length - usual), minlength=len(filled)))
    return np.argmin(distortion, axis=0)[patch]


def _lengths(features: SingleFloats, edges: Integers) -> Floats:
    """(e,) lengths of the images of edges (e, 2), in space or along the surface, from their features (n, 6 + d)."""
    length = np.empty(len(edges))
    for first in range(0, len(edges), EDGES):
        some = edges[first : first + EDGES]
        apart = take_rows(features, some[:, 0]) - take_rows(features, some[:, 1])
        space = row_norms(apart[:, :3])
        length[first : first + EDGES] = np.maximum(space, np.abs(apart[:, 6:]).max(axis=1))
    return length


def _torn(length: Floats, own: Floats, limit: float) -> Booleans:
    """(e,) which edges have images that are far too long.

    The lengths (e,) are those of the images, in space or along the surface, and `own` (e,) are those on the target. The
    limit is the ratio above which they are torn.
    """
    return np.asarray((length / np.maximum(own, SMALLEST) > limit) & (length > REPAIR.min_length))


def _connected_share(meshes: _Meshes, torn: Booleans) -> Floats:
    """(n,) the part of its component's area that each vertex is connected with along edges that are not torn (e,).

    It is 1 on pieces of a component without a tear, even if they only touch the others.
    """
    edges, areas, component = meshes.edges, meshes.areas, meshes.target.component
    patch = components(edges[meshes.known & ~torn], len(areas))
    component_area = np.bincount(component, areas)[component]
    share = np.bincount(patch, areas)[patch] / np.maximum(component_area, SMALLEST)
    is_torn = np.zeros(len(areas), dtype=bool)  # by patch
    is_torn[patch[edges[torn]]] = True
    return np.where(is_torn[patch], share, 1.0)


def _to_fill(meshes: _Meshes, torn: Booleans) -> Booleans:
    """(n,) vertices near torn edges (e,) and on small patches that these cut off, on components mostly whole."""
    edges, areas, component = meshes.edges, meshes.areas, meshes.target.component
    chosen = _connected_share(meshes, torn) < REPAIR.small_patch
    chosen[edges[torn]] = True
    chosen[edges[chosen[edges].any(axis=1) & (meshes.length < REPAIR.around)]] = True
    whole = np.bincount(component, areas * ~chosen)[component]
    component_area = np.bincount(component, areas)[component]
    return np.asarray(chosen & (whole > REPAIR.min_trusted * component_area))


def _fills(images: _Images, filled: Booleans, meshes: _Meshes) -> list[tuple[Integers, _Images]]:
    """Two ways to fill in some images from the others, on the source: for each the vertices (q,), and their images.

    The features of the images solve Poisson's equation (Yu et al. 2004). Their differences in a patch are those of the
    target, rotated and scaled like the patch's surroundings, so that a fingertip does not shrink to the base of the
    finger. The second solution is harmonic. A part of the target stays on the parts of the source that its trusted
    images are on: a shirt does not land on the body below it.
    """
    source, component = meshes.source, meshes.target.component
    graph, vertices = meshes.graph, np.flatnonzero(filled)
    adjacent = graph[vertices]
    degree = csr_array((adjacent.sum(axis=1), (np.arange(len(vertices)), vertices)), shape=adjacent.shape)
    laplacian = csr_array(degree - adjacent)
    beside = np.unique(adjacent.indices)
    beside = beside[~filled[beside]]
    known = laplacian[:, beside] @ images.features[beside].astype(np.float64)
    factors = factorise(laplacian[:, vertices].tocsc())
    source_component = source.component[source.triangles[:, 0]]
    stride = int(source_component.max()) + 1
    allowed = np.unique(component[~filled] * stride + source_component[images.triangle[~filled]])
    divergences = _divergence(images, filled, graph, laplacian, meshes.target), 0
    goals = np.concatenate([factors.solve(np.asfortranarray(each - known)) for each in divergences])
    goals[:, 3:6] /= np.maximum(row_norms(goals[:, 3:6])[:, None], SMALLEST)
    triangle, barycentric = _project(goals, meshes, allowed, np.tile(component[vertices] * stride, len(divergences)))
    fillings = zip(np.split(triangle, len(divergences)), np.split(barycentric, len(divergences)), strict=True)
    return [(vertices[on >= 0], meshes.images(on[on >= 0], weights[on >= 0])) for on, weights in fillings]


def _divergence(
    images: _Images, filled: Booleans, graph: csr_array, laplacian: csr_array, target: WorkingMesh
) -> Floats:
    """(q, 6 + d) the Laplacian of the features that filled vertices have if their patch moves like its surroundings.

    Positions and normals follow a similarity that is fitted to the trusted vertices around the patch. Geodesic
    distances are extrapolated by the best linear function of the target's positions.

    Args:
        images: of the target's vertices (n,).
        filled: (n,) vertices to fill in; the patches are the connected ones.
        graph: (n, n) adjacency of the vertices.
        laplacian: (q, n) rows of the filled vertices.
        target: the target's mesh.
    """
    vertices = np.flatnonzero(filled)
    count, patch = connected_components(graph[vertices][:, vertices], directed=False)
    near = csr_array((np.ones(len(vertices)), (vertices, patch)), shape=(len(filled), count))
    for _ in range(REPAIR.rings):
        near = near + graph @ near
    rows, of_patch = near.nonzero()
    rows, of_patch = rows[~filled[rows]], of_patch[~filled[rows]]
    share = 1 / np.bincount(of_patch, minlength=count)[of_patch]
    mean = csr_array((share, (of_patch, np.arange(len(rows)))), shape=(count, len(rows)))
    around, features = target.vertices[rows], images.features[rows].astype(np.float64)
    moments = Moments.of_products(np.asarray(mean @ products(around, features[:, :3])))
    handedness = _handedness(images, filled, graph, target)
    fitted = moments.similarities(handedness, (1 / REPAIR.max_scale, REPAIR.max_scale))
    offset = around - moments.place[of_patch]
    second = np.stack([np.asarray(mean @ (offset[:, i, None] * offset)) for i in range(3)], axis=1)
    second += (RIDGE * np.trace(second, axis1=1, axis2=2)[:, None, None] + SMALLEST) * np.eye(3)
    distance = features[:, 6:] - np.asarray(mean @ features[:, 6:])[of_patch]
    cross = np.stack([np.asarray(mean @ (offset[:, i, None] * distance)) for i in range(3)], axis=1)
    slopes = np.linalg.solve(second, cross)
    places, normals = laplacian @ target.vertices, laplacian @ target.vertex_normals
    return np.hstack(
        [
            np.einsum("qij,qj->qi", fitted.linear[patch], places),
            np.einsum("qij,qj->qi", fitted.rotation[patch], normals),
            np.einsum("qid,qi->qd", slopes[patch], places),
        ]
    )


def _handedness(images: _Images, filled: Booleans, graph: csr_array, target: WorkingMesh) -> float:
    """1 if the map preserves the orientation of trusted neighbourhoods, -1 if it reverses it."""
    trusted = np.flatnonzero(~filled)
    some = trusted[:: max(1, len(trusted) // NEIGHBOURHOODS)]
    rings = csr_array(graph[some] @ graph + graph[some])
    near = np.unique(rings.indices)
    means = diags_array(1 / rings.sum(axis=1)) @ rings[:, near]
    both = products(target.vertices[near], images.features[near, :3].astype(np.float64))
    return Moments.of_products(np.asarray(means @ both)).handedness


def _project(goals: Floats, meshes: _Meshes, allowed: Integers, first_key: Integers) -> tuple[Integers, Floats]:
    """The points of the source closest to goals (q, 6 + d), in space, in direction and along the surface.

    A goal lands on a component of the source if `allowed` (a,), sorted, has the sum of its `first_key` (q,) and of the
    component's number. Returns (q,) triangle numbers, -1 where no point near a goal is allowed, and (q, 3) barycentric
    coordinates.
    """
    source, (tree, on) = meshes.source, meshes.samples
    corner, marks = source.triangles[:, 0].copy(), meshes.features[:, 6:].copy()
    component = source.component[corner]
    rows = np.hstack([goals[:, :3], REPAIR.normal_weight * goals[:, 3:6]])
    triangle = np.empty(len(goals), dtype=np.int64)

    def compare(some: Integers, count: int) -> Integers:
        """Choose among the nearest samples of some goals; returns the goals for which a farther one may be closer."""
        apart, near = map(np.asarray, tree.query(rows[some], count))
        candidate = on[near]
        along = np.abs(take_rows(marks, corner[candidate]) - goals[some, None, 6:].astype(np.float32)).max(axis=2)
        key = first_key[some, None] + component[candidate]
        elsewhere = allowed[np.minimum(np.searchsorted(allowed, key), len(allowed) - 1)] != key
        beyond = np.where(along > MAX_GEODESIC_DISTANCE, along, 0) + elsewhere
        cost = apart + REPAIR.geodesic_weight * along + BEYOND * beyond
        best = np.arange(len(some)), np.argmin(cost, axis=1)
        triangle[some] = np.where(elsewhere[best], -1, candidate[best])
        return np.asarray(some[apart[:, -1] < cost[best]])

    left = np.arange(len(goals))
    for count in (min(count, len(on)) for count in (FIRST_CANDIDATES, REPAIR.candidates)):
        blocks = np.array_split(left, 1 + len(left) * count // PLACES)
        left = np.concatenate(for_each(partial(compare, count=count), blocks))
    a, b, c = (source.vertices[source.triangles[triangle, i]] for i in range(3))
    return triangle, closest_on_triangles(goals[:, :3], a, b, c)[0]


def _on_surface(chosen: Booleans, vertex_of: Integers) -> Booleans:
    """(n_surface,) which vertices of a surface belong to some vertices (n,) of its working mesh."""
    return np.asarray((vertex_of >= 0) & chosen[vertex_of])
