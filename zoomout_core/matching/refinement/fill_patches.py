# SPDX-License-Identifier: GPL-3.0-or-later
"""Fill in the images of patches from their surroundings, like inpainted weights (Abdrashitov et al. 2023).

Images solve Poisson's equation, or are harmonic. They are then projected to points of the source that are also nearby
along its surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from zoomout_core.arrays import Booleans, Floats, Integers, all_in_row, any_in_row, row_norms, take_rows
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.geometry.procrustes import SMALLEST, Moments, products
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.matching.refinement.image_features import IMAGES, Images, PairMeshes, image_lengths
from zoomout_core.matching.registration.correspondences import MAX_GEODESIC_DISTANCE
from zoomout_core.mesh.triangles import components
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned

# Number of goals times candidates in a block of comparisons, which fits into the processor's cache.
PLACES = 1 << 16
# Share of the variance that keeps the linear fit around flat patches stable, and number of neighbourhoods that show
# whether a map preserves orientation.
RIDGE, NEIGHBOURHOODS = 0.03, 1000
# Nearest samples to compare first: for nine goals in ten they decide.
FIRST_CANDIDATES = 12
# Multiple by which a geodesic distance beyond the limit counts: only if all candidates are beyond it one is taken.
BEYOND = 1e3


@dataclass(frozen=True)
class FillingTuning(Tuning, set_by="everywhere"):
    """How filled images move with their surroundings, and how they are projected to the source."""

    candidates: int = tuned(48, "points", 2, 1000)  # nearest samples that are compared
    geodesic_weight: float = tuned(0.3, "1", 0, 10)  # the distance that counts as much as a unit of geodesic distance
    rings: int = tuned(4, "edges", 1, 100)  # distance around a patch that its motion is fitted to
    max_scale: float = tuned(2.0, "1", 1, 100)  # of a patch


FILLING = FillingTuning()


def fill_patches(
    images: Images, filled: Booleans, meshes: PairMeshes, beside: Booleans, usual: Floats, max_stretch: float
) -> None:
    """Replace images of vertices by the filling that distorts their patch least, in place.

    Patches that are distorted least as they are keep their images, and are removed from the filled vertices.

    Args:
        images: of the target's vertices (n,).
        filled: (n,) vertices to fill in; the patches are the connected ones.
        meshes: the meshes of the map.
        beside: (e,) edges with a filled vertex.
        usual: (b,) the lengths of the images of these edges if the map is not distorted.
        max_stretch: ratio to the usual length beyond which an edge is distorted.
    """
    vertices, ends = np.unique(meshes.edges[beside], return_inverse=True)
    fills = [images.at(vertices)]
    for some, by in _fills(images, filled, meshes):
        fills.append(images.at(vertices))
        fills[-1].replace_at(np.searchsorted(vertices, some), by)
    best = choose_images(fills, filled[vertices], ends.reshape(-1, 2), usual, max_stretch)
    for choice, by in enumerate(fills):
        chosen = np.flatnonzero(best == choice)
        images.replace_at(vertices[chosen], by.at(chosen))
    filled[vertices[best == 0]] = False


def choose_images(
    tried: Sequence[Images], filled: Booleans, edges: Integers, usual: Floats, max_stretch: float
) -> Integers:
    """(n,) for each vertex the number of the images that stretch and shrink the edges of its patch least.

    Args:
        tried: images of the vertices (n,) to choose from.
        filled: (n,) vertices of the patches.
        edges: (e, 2) vertex numbers.
        usual: (e,) the lengths of the edges' images if the map is not distorted.
        max_stretch: ratio to the usual length beyond which an edge counts.
    """
    among = filled[edges]
    patch = components(edges[all_in_row(among)], len(filled))
    touched = any_in_row(among)
    of_edge, usual = patch[np.where(among[:, 0], edges[:, 0], edges[:, 1])][touched], usual[touched]
    distortion = []
    for images in tried:
        length = image_lengths(images.features, edges[touched])
        is_off = (length > max_stretch * usual) | (max_stretch * length < usual)
        distortion.append(np.bincount(of_edge, is_off * np.abs(length - usual), minlength=len(filled)))
    return np.argmin(distortion, axis=0)[patch]


def _fills(images: Images, filled: Booleans, meshes: PairMeshes) -> list[tuple[Integers, Images]]:
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
    images: Images, filled: Booleans, graph: csr_array, laplacian: csr_array, target: WorkingMesh
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
    # Products with the few rows of patches take a fraction of the time of those with the rows of all vertices.
    near = csr_array((np.ones(len(vertices)), (patch, vertices)), shape=(count, len(filled)))
    for _ in range(FILLING.rings):
        near = near + near @ graph
    near.sort_indices()
    of_patch, rows = near.nonzero()
    rows, of_patch = rows[~filled[rows]], of_patch[~filled[rows]]
    share = 1 / np.bincount(of_patch, minlength=count)[of_patch]
    mean = csr_array((share, (of_patch, np.arange(len(rows)))), shape=(count, len(rows)))
    around, features = target.vertices[rows], images.features[rows].astype(np.float64)
    moments = Moments.of_products(np.asarray(mean @ products(around, features[:, :3])))
    handedness = _handedness(images, filled, graph, target)
    fitted = moments.similarities(handedness, (1 / FILLING.max_scale, FILLING.max_scale))
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


def _handedness(images: Images, filled: Booleans, graph: csr_array, target: WorkingMesh) -> float:
    """1 if the map preserves the orientation of trusted neighbourhoods, -1 if it reverses it."""
    trusted = np.flatnonzero(~filled)
    some = trusted[:: max(1, len(trusted) // NEIGHBOURHOODS)]
    rings = csr_array(graph[some] @ graph + graph[some])
    near = np.unique(rings.indices)
    means = diags_array(1 / rings.sum(axis=1)) @ rings[:, near]
    both = products(target.vertices[near], images.features[near, :3].astype(np.float64))
    return Moments.of_products(np.asarray(means @ both)).handedness


def _project(goals: Floats, meshes: PairMeshes, allowed: Integers, first_key: Integers) -> tuple[Integers, Floats]:
    """The points of the source closest to goals (q, 6 + d), in space, in direction and along the surface.

    A goal lands on a component of the source if `allowed` (a,), sorted, has the sum of its `first_key` (q,) and of the
    component's number. Returns (q,) triangle numbers, -1 where no point near a goal is allowed, and (q, 3) barycentric
    coordinates.
    """
    source, (tree, on) = meshes.source, meshes.samples
    rows = np.hstack([goals[:, :3], IMAGES.normal_weight * goals[:, 3:6]])
    triangle = np.empty(len(goals), dtype=np.int64)

    def compare(some: Integers, count: int) -> Integers:
        """Choose among the nearest samples of some goals; returns the goals for which a farther one may be closer."""
        apart, near = map(np.asarray, tree.query(rows[some], count))
        candidate = on[near]
        corner = source.triangles[candidate, 0]
        marks = take_rows(meshes.features, corner)[..., 6:]
        along = np.abs(marks - goals[some, None, 6:].astype(np.float32)).max(axis=2)
        key = first_key[some, None] + source.component[corner]
        elsewhere = allowed[np.minimum(np.searchsorted(allowed, key), len(allowed) - 1)] != key
        beyond = np.where(along > MAX_GEODESIC_DISTANCE, along, 0) + elsewhere
        cost = apart + FILLING.geodesic_weight * along + BEYOND * beyond
        best = np.arange(len(some)), np.argmin(cost, axis=1)
        triangle[some] = np.where(elsewhere[best], -1, candidate[best])
        return np.asarray(some[apart[:, -1] < cost[best]])

    left = np.arange(len(goals))
    for count in (min(count, len(on)) for count in (FIRST_CANDIDATES, FILLING.candidates)):
        blocks = np.array_split(left, 1 + len(left) * count // PLACES)
        left = np.concatenate(for_each(partial(compare, count=count), blocks))
    a, b, c = (source.vertices[source.triangles[triangle, i]] for i in range(3))
    return triangle, closest_on_triangles(goals[:, :3], a, b, c)[0]
