# SPDX-License-Identifier: GPL-3.0-or-later
"""Repair a finished map: match wrong branches anew, find where it tears the target apart, and fill these places in.

A map that is right as a whole may still send a patch of the target to another limb, finger or lip, where the source's
surfaces face each other. Closest points cannot tell the two sides apart, but geodesic distances can: the images of two
neighbours are close in space and far apart along the surface. Such patches, and edges whose images are far too long,
are filled in from the rest, by Poisson's equation or harmonically, as weights are inpainted (Abdrashitov et al. 2023),
and projected to points of the source that are nearby along its surface as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, SingleFloats
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import SMALLEST, Moments, products
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.branches import exchange_branches
from zoomout_core.matching.pair import Pair, landmark_points
from zoomout_core.matching.registration.correspondences import BOUND_SAMPLES, MAX_GEODESIC_DISTANCE
from zoomout_core.matching.registration.nonrigid_icp import replace_images
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unique_edges, vertex_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.tuning import Tuning, tuned

# Edges, and places to project, that are compared at once; bounds the memory.
BLOCK = 1 << 16
# Samples of each triangle, on average, that are enough on coarse sources.
SAMPLES_OF_TRIANGLE = 20
# Share of the variance that keeps the linear fit around flat patches stable, and number of neighbourhoods that show
# whether a map preserves orientation.
RIDGE, NEIGHBOURHOODS = 0.03, 1000
# Share of the target's area below which a component is too small, as a strand of hair is, to have parts cut off.
SMALL_COMPONENT = 0.05
# Multiple by which a geodesic distance beyond the limit counts: only if all candidates are beyond it one is taken.
BEYOND = 1e3


@dataclass(frozen=True)
class RepairTuning(Tuning, set_by="everywhere"):
    """Which edges are torn, and how their surroundings are projected to the source."""

    max_stretch: float = tuned(4.0, "1", 1, 100)  # torn edges are longer than this multiple of the median ratio,
    min_length: float = tuned(0.02, "at unit area", 0, 1)  # and longer than this
    # Edges from this multiple on may cut a part off. On 60 damaged and other pairs, 65 % of the area that they cut off
    # is off by more than 0.1; with `max_stretch`, 60 % of an area that is a fifth smaller.
    seam: float = tuned(3.0, "1", 1, 100)
    small_patch: float = tuned(0.02, "1", 0, 1)  # patches below this part of their component are filled in
    min_trusted: float = tuned(0.5, "1", 0, 1)  # a component is repaired only if this fraction of its area is not torn
    samples: int = tuned(120_000, "points", 1, 10_000_000)  # of the source to project to, or all its triangles
    candidates: int = tuned(48, "points", 2, 1000)  # nearest samples that are compared
    normal_weight: float = tuned(0.02, "at unit area", 0, 10)  # distance that equals a unit difference of normals
    rings: int = tuned(4, "edges", 1, 100)  # distance around a patch that its motion is fitted to
    max_scale: float = tuned(2.0, "1", 1, 100)  # of a patch
    geodesic_weight: float = tuned(0.3, "1", 0, 10)  # the distance that counts as much as a unit of geodesic distance


REPAIR = RepairTuning()


class Repair(NamedTuple):
    """A repaired map."""

    surface_map: SurfaceMap  # from the target to the source
    filled: Booleans  # (n_t,) vertices whose images were filled in from their surroundings
    torn: Booleans  # (n_t,) vertices at edges that are torn still
    # (n_t,) part of its component's area, in [0, 1], that a vertex is connected with across no tear: small on a limb
    # that is mapped to another one. Filled places and small components count as connected with everything.
    connected: Floats


class _Images(NamedTuple):
    """The images of the working vertices of a target."""

    triangle: Integers  # (n,) of the source's working mesh
    barycentric: Floats  # (n, 3)
    features: SingleFloats  # (n, 6 + d) positions, normals, and geodesic distances to some samples, at unit area

    def replace_at(self, other: _Images, chosen: Booleans) -> _Images:
        """These, with others at chosen vertices (n,)."""
        triangle = np.where(chosen, other.triangle, self.triangle)
        barycentric, features = (
            np.where(chosen[:, None], new, own)
            for own, new in ((self.barycentric, other.barycentric), (self.features, other.features))
        )
        return _Images(triangle, barycentric, features)


def repair(pair: Pair, surface_map: SurfaceMap) -> Repair:
    """Match branches anew that are on the wrong branch, and fill in torn places; exact landmarks keep their images."""
    exchanged, bases = exchange_branches(pair, surface_map)
    branches = exchanged.triangle != surface_map.triangle
    first = _fill_torn(pair, exchanged, bases, branches)
    if not bases.any():
        return first
    exchanged, bases = exchange_branches(pair, first.surface_map)  # at new bases, branches may be wrong still
    branches |= exchanged.triangle != first.surface_map.triangle
    second = _fill_torn(pair, exchanged, bases, branches)
    connected = np.minimum(first.connected, second.connected)
    return second._replace(filled=first.filled | second.filled, connected=connected)


def _fill_torn(pair: Pair, surface_map: SurfaceMap, bases: Booleans, branches: Booleans) -> Repair:
    """Fill in the places at which a map is torn, and the bases (n_t,) of branches (n_t,) that were matched anew."""
    source, target = pair.source, pair.target
    mesh, vertex_of = target.working, target.working.vertex_of
    used = np.flatnonzero(vertex_of >= 0)
    member = np.empty(len(mesh.vertices), dtype=np.int64)
    member[vertex_of[used]] = used
    corners = np.concatenate(
        [source.working.vertices, source.working.vertex_normals, _marks(source, pair.source_shape)], 1
    )
    number = np.zeros(len(source.triangles), dtype=np.int64)
    number[source.working.triangle_of] = np.arange(len(source.working.triangles))
    triangle, barycentric = number[surface_map.triangle[member]], surface_map.barycentric[member]
    images = _Images(triangle, barycentric, _interpolate(corners, source.working.triangles[triangle], barycentric))
    fixed = np.zeros(len(member), dtype=bool)
    if pair.exact_landmarks is not None:
        points = landmark_points(pair, pair.exact_landmarks)[1]
        fixed[vertex_of[used[cKDTree(target.vertices[used]).query(points)[1]]]] = True

    edges, _ = unique_edges(mesh.triangles)
    own = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    torn, limit = _torn(images.features, edges, own)
    seams, _ = _torn(images.features, edges, own, limit * REPAIR.seam / REPAIR.max_stretch)
    connected = _connected_share(mesh, edges, seams)
    filled = ((_to_fill(mesh, edges, torn) & ~branches[member]) | bases[member]) & ~fixed
    if filled.any():
        tried = [images, *_fills(images, filled, edges, mesh, source.working, corners)]
        best = _choose_images(tried, filled, edges, limit / REPAIR.max_stretch * own)
        for choice, filling in enumerate(tried[1:], start=1):
            images = images.replace_at(filling, best == choice)
        filled &= best > 0
        torn, _ = _torn(images.features, edges, own, limit)
    at_torn = np.zeros(len(filled), dtype=bool)
    at_torn[edges[torn]] = True
    changed = used[filled[vertex_of[used]]]
    new_triangle = source.working.triangle_of[images.triangle[vertex_of[changed]]]
    new = SurfaceMap(new_triangle, images.barycentric[vertex_of[changed]], surface_map.source_triangles)
    repaired = replace_images(surface_map, changed, new)
    area = np.bincount(mesh.component, vertex_areas(mesh.vertices, mesh.triangles))
    connected[filled | fixed | (area < SMALL_COMPONENT * area.sum())[mesh.component]] = 1
    return Repair(
        repaired,
        _on_surface(filled, vertex_of),
        _on_surface(at_torn & ~fixed, vertex_of),
        np.where(vertex_of >= 0, connected[vertex_of], 1.0),
    )


def _marks(source: Surface, shape: ShapeAnalysis) -> Floats:
    """(n, d) geodesic distances from some samples of a shape to the working vertices of its surface.

    The largest difference of two rows bounds the geodesic distance from below. Distances on a hull do not tell the two
    sides of a wing apart, nor parts that touch: then all are zero, and edges are judged by their lengths in space.
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
    return np.asarray(shape.proxy.place.interpolate(shape.distances[:BOUND_SAMPLES].T)[of_body])


def _choose_images(tried: Sequence[_Images], filled: Booleans, edges: Integers, usual: Floats) -> Integers:
    """(n,) for each vertex the number of the images that stretch and shrink the edges (e, 2) of its patch least.

    `usual` (e,) are the lengths that the edges' images have if the map is not distorted.
    """
    among = filled[edges]
    patch = connected_components(_graph(edges[among.all(axis=1)], len(filled)), directed=False)[1]
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
    for first in range(0, len(edges), BLOCK):
        some = edges[first : first + BLOCK]
        apart = features[some[:, 0]] - features[some[:, 1]]
        space = np.linalg.norm(apart[:, :3], axis=1)
        length[first : first + BLOCK] = np.maximum(space, np.abs(apart[:, 6:]).max(axis=1))
    return length


def _torn(features: SingleFloats, edges: Integers, own: Floats, limit: float | None = None) -> tuple[Booleans, float]:
    """Which edges (e, 2) have images that are far too long in space or along the surface, and the ratio from which on.

    The features (n, 6 + d) are those of the images, and `own` (e,) are the lengths on the target.
    """
    length = _lengths(features, edges)
    ratio = length / np.maximum(own, 1e-300)
    if limit is None:
        limit = REPAIR.max_stretch * float(np.median(ratio))
    return (ratio > limit) & (length > REPAIR.min_length), limit


def _connected_share(mesh: WorkingMesh, edges: Integers, torn: Booleans) -> Floats:
    """(n,) the part of its component's area that each vertex is connected with along edges that are not torn.

    It is 1 on pieces of a component without a tear, even if they only touch the others.
    """
    n, areas = len(mesh.vertices), vertex_areas(mesh.vertices, mesh.triangles)
    patch = connected_components(_graph(edges[~torn], n), directed=False)[1]
    component_area = np.bincount(mesh.component, areas)[mesh.component]
    share = np.bincount(patch, areas)[patch] / np.maximum(component_area, 1e-300)
    return np.where(np.isin(patch, patch[edges[torn]]), share, 1.0)


def _to_fill(mesh: WorkingMesh, edges: Integers, torn: Booleans) -> Booleans:
    """(n,) vertices near torn edges and on small patches that these cut off, on components that are mostly whole."""
    areas = vertex_areas(mesh.vertices, mesh.triangles)
    chosen = _connected_share(mesh, edges, torn) < REPAIR.small_patch
    chosen[edges[torn]] = True
    chosen[edges[chosen[edges].any(axis=1)]] = True
    whole = np.bincount(mesh.component, areas * ~chosen)[mesh.component]
    component_area = np.bincount(mesh.component, areas)[mesh.component]
    return np.asarray(chosen & (whole > REPAIR.min_trusted * component_area))


def _fills(
    images: _Images, filled: Booleans, edges: Integers, target: WorkingMesh, source: WorkingMesh, corners: Floats
) -> Iterator[_Images]:
    """Fill in some images from the others, and project them to the source.

    The features of the images solve Poisson's equation: their differences in a patch are those of the target, turned
    and scaled like the patch's surroundings (Yu et al. 2004), so that the tip of a finger does not shrink to its base.
    The second solution is harmonic. A part of the target stays on the parts of the source that its trusted images are
    on: a shirt does not land on the body below it. `edges` (e, 2) are those of the target, and `corners` (n_s, 6 + d)
    the features of the source's vertices.
    """
    graph, component = csr_array(_graph(edges, len(filled))), target.component
    vertices = np.flatnonzero(filled)
    laplacian = csr_array(diags_array(graph.sum(axis=1)) - graph)[vertices]
    known = images.features.astype(np.float64)
    known[vertices] = 0
    factors = factorise(laplacian[:, vertices].tocsc())
    source_component = source.component[source.triangles[:, 0]]
    stride = int(source_component.max()) + 1
    allowed = np.unique(component[~filled] * stride + source_component[images.triangle[~filled]])
    divergences = _divergence(images, filled, graph, laplacian, target), 0
    goals = np.concatenate([factors.solve(np.asfortranarray(each - laplacian @ known)) for each in divergences])
    goals[:, 3:6] /= np.maximum(np.linalg.norm(goals[:, 3:6], axis=1, keepdims=True), 1e-300)
    projected = _project(goals, source, corners, allowed, np.tile(component[vertices] * stride, len(divergences)))
    for on, barycentric in zip(*(np.split(each, len(divergences)) for each in projected), strict=True):
        found = _Images(images.triangle.copy(), images.barycentric.copy(), images.features.copy())
        some, on, barycentric = vertices[on >= 0], on[on >= 0], barycentric[on >= 0]
        found.triangle[some], found.barycentric[some] = on, barycentric
        found.features[some] = _interpolate(corners, source.triangles[on], barycentric)
        yield found


def _divergence(
    images: _Images, filled: Booleans, graph: csr_array, laplacian: csr_array, target: WorkingMesh
) -> Floats:
    """(q, 6 + d) the Laplacian of the features that filled vertices have if their patch moves like its surroundings.

    Positions and normals are turned and scaled by a similarity fitted to the trusted vertices around the patch, and
    geodesic distances extrapolated by the linear function of the target's positions that fits them best.

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
    rings = graph[some] @ (graph + diags_array(np.ones(len(filled))))
    means = csr_array(diags_array(1 / rings.sum(axis=1)) @ rings)
    both = products(target.vertices, images.features[:, :3].astype(np.float64))
    return Moments.of_products(np.asarray(means @ both)).handedness


def _project(
    goals: Floats, source: WorkingMesh, corners: Floats, allowed: Integers, first_key: Integers
) -> tuple[Integers, Floats]:
    """The points of a source closest to goals (q, 6 + d), in space, in direction and along the surface.

    A goal lands on a component of the source if `allowed` (a,), sorted, has the sum of its `first_key` (q,) and of the
    component's number. Returns (q,) triangle numbers, -1 where no point near a goal is allowed, and (q, 3) barycentric
    coordinates.
    """
    count = len(source.triangles) * SAMPLES_OF_TRIANGLE
    count = max(min(count, REPAIR.samples), len(source.triangles))
    points, on = surface_samples(source.vertices, source.triangles, count)
    normals = triangle_normals(source.vertices, source.oriented_triangles)[on]
    tree = cKDTree(np.hstack([points, REPAIR.normal_weight * normals]), balanced_tree=False, compact_nodes=False)
    marks, component = corners[:, 6:].astype(np.float32), source.component[source.triangles[:, 0]]
    triangle = np.empty(len(goals), dtype=np.int64)
    block = max(1, BLOCK // REPAIR.candidates)
    for first in range(0, len(goals), block):
        some, keys = goals[first : first + block], first_key[first : first + block]
        rows = np.hstack([some[:, :3], REPAIR.normal_weight * some[:, 3:6]])
        apart, near = map(np.asarray, tree.query(rows, min(REPAIR.candidates, count)))
        candidate = on[near]
        along = np.abs(marks[source.triangles[candidate, 0]] - some[:, None, 6:].astype(np.float32)).max(axis=2)
        key = keys[:, None] + component[candidate]
        elsewhere = allowed[np.minimum(np.searchsorted(allowed, key), len(allowed) - 1)] != key
        beyond = np.where(along > MAX_GEODESIC_DISTANCE, along, 0) + elsewhere
        best = np.argmin(apart + REPAIR.geodesic_weight * along + BEYOND * beyond, axis=1)
        row = np.arange(len(some))
        triangle[first : first + block] = np.where(elsewhere[row, best], -1, candidate[row, best])
    a, b, c = (source.vertices[source.triangles[triangle, i]] for i in range(3))
    return triangle, closest_on_triangles(goals[:, :3], a, b, c)[0]


def _graph(edges: Integers, n: int) -> coo_array:
    """(n, n) adjacency of vertices."""
    ends = np.concatenate([edges, edges[:, ::-1]])
    return coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))


def _interpolate(values: Floats, corners: Integers, barycentric: Floats) -> SingleFloats:
    """(q, d) values (n, d) at points given by their corners (q, 3) and barycentric coordinates (q, 3)."""
    found = sum(barycentric[:, i, None].astype(np.float32) * values[corners[:, i]].astype(np.float32) for i in range(3))
    return np.asarray(found, dtype=np.float32)


def _on_surface(chosen: Booleans, vertex_of: Integers) -> Booleans:
    """(n_surface,) which vertices of a surface belong to some vertices (n,) of its working mesh."""
    return np.asarray((vertex_of >= 0) & chosen[vertex_of])
