# SPDX-License-Identifier: GPL-3.0-or-later
"""Pair the loose parts of two surfaces: eyes, teeth, buttons, clothes, hair.

The spectrum of a part does not distinguish a left eye from a right one. The map of the body does: it moves the parts of
the target to the source, where partners have the same position and size. Parts at the same position, such as a coat
and a shirt, differ in shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.matching.components.hulls import orient_outwards
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, triangle_areas, vertex_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.spectral.sampling import farthest_points

# Parts of each surface that are paired one to one, the largest first. A mesh with more has debris or strands of hair.
MAX_PAIRED_PARTS = 300
# Number of sample vertices that compare parts.
SAMPLES_PER_PART = 32
# Candidate partners of a part, by distance and size; only these are compared sample by sample.
CANDIDATE_PARTNERS = 6
# Expected error of the body's map at a part, at unit area.
BODY_MAP_ERROR = 0.045
# Largest misfit of partners in position, size and shape, in sizes of the part.
MAX_MISFIT = 0.5
# Weight of the difference in shape, that of the quantiles below, in the misfit.
SHAPE_WEIGHT = 2.0
# Quantiles that represent the distribution of geodesic distances in a part, measured from this many of its samples.
DISTANCE_QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
DISTANCE_SOURCES = 8
# Fraction by which the misfit shrinks if both parts belong to exactly the same regions.
SAME_REGION_DISCOUNT = 0.5


@dataclass(frozen=True, eq=False)
class Part:
    """A component of a mesh."""

    mesh: WorkingMesh  # that it is a component of
    vertices: Integers  # (n,) its vertices in the mesh
    triangles: Integers  # (m,) its triangles in the mesh
    points: Floats  # (n, 3) the vertices in the frame in which parts are compared, the source's
    weights: Floats  # (n,) the vertices' shares of its area, which sum to one

    @cached_property
    def corners(self) -> Integers:
        """(m, 3) its triangles by the places of the corners in `vertices`, which ascend."""
        return np.searchsorted(self.vertices, self.mesh.triangles[self.triangles])

    @property
    def rest(self) -> Floats:
        """(n, 3) the vertices where the mesh has them."""
        return self.mesh.vertices[self.vertices]

    @cached_property
    def centre(self) -> Floats:
        """(3,) centroid of its area."""
        return np.asarray(self.weights @ self.points)

    @cached_property
    def size(self) -> float:
        """Root mean square distance from the centre."""
        return float(np.sqrt(self.weights @ ((self.points - self.centre) ** 2).sum(axis=1)))

    @cached_property
    def reach(self) -> float:
        """Largest distance from the centre."""
        return float(np.sqrt(((self.points - self.centre) ** 2).sum(axis=1).max()))

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.points)

    @cached_property
    def samples(self) -> Integers:
        """(s,) some vertices, evenly spread, by their place in `vertices`."""
        return farthest_points(self.rest, SAMPLES_PER_PART)

    def distance_to(self, other: Part) -> float:
        """Root mean square distance from its samples to the nearest vertex of another part."""
        return float(np.sqrt(np.mean(np.square(other.tree.query(self.points[self.samples])[0]))))

    @cached_property
    def distances(self) -> Floats:
        """(5,) quantiles of the geodesic distances between samples, at unit area: the same in every pose."""
        area = triangle_areas(self.rest, self.corners).sum()
        distance = dijkstra(edge_graph(self.rest, self.corners), indices=self.samples[:DISTANCE_SOURCES])[
            :, self.samples
        ]
        return np.asarray(np.quantile(distance, DISTANCE_QUANTILES) / np.sqrt(max(area, 1e-300)))


@dataclass(frozen=True, eq=False)
class Side:
    """A surface in the frame in which its loose parts are compared."""

    mesh: WorkingMesh  # its working copy
    points: Floats  # (n, 3) the mesh's vertices in a frame in which the body's area is one
    areas: Floats  # (n,) of the vertices, positive
    body_vertices: Integers  # (b,) the mesh's vertex for each of the body's; empty for a hull

    @classmethod
    def of(cls, surface: Surface, body: WorkingMesh) -> Side:
        """A surface and its body: one of its parts, or the hull around it. The frame is that of the body."""
        mesh = surface.working
        areas = vertex_areas(mesh.vertices, mesh.triangles)
        areas = np.maximum(areas, 1e-9 * areas.mean())
        if body.is_hull:
            points = body.from_surface(mesh.to_surface(mesh.vertices))
            return cls(orient_outwards(mesh, body), points, areas, np.zeros(0, dtype=np.int64))
        return cls(mesh, mesh.vertices * (mesh.scale / body.scale), areas, mesh.vertex_of[body.surface_vertex])

    @property
    def body(self) -> int:
        """The number of the component that is the body, or -1 for a hull."""
        return int(self.mesh.component[self.body_vertices[0]]) if len(self.body_vertices) else -1

    @cached_property
    def loose(self) -> Booleans:
        """(n,) which vertices belong to loose parts."""
        return self.mesh.component != self.body

    def parts(self, points: Floats) -> list[Part]:
        """The loose parts, the largest first, their vertices moved to the points (n, 3)."""
        mesh = self.mesh
        triangles = _group(mesh.component[mesh.triangles[:, 0]])
        return [
            Part(mesh, inside, triangles[number], points[inside], self.areas[inside] / self.areas[inside].sum())
            for number, inside in enumerate(_group(mesh.component))
            if number != self.body
        ]

    def members(self, regions: Sequence[Integers]) -> Booleans:
        """(p, r) which loose parts are mostly in which regions, given by the surface's vertices."""
        count = np.bincount(self.mesh.component)
        inside = np.zeros((len(count), len(regions)), dtype=bool)
        for number, region in enumerate(regions):
            vertices = np.unique(self.mesh.vertex_of[region])
            component = self.mesh.component[vertices[vertices >= 0]]
            inside[:, number] = np.bincount(component, minlength=len(count)) > count / 2
        return inside if self.body < 0 else np.delete(inside, self.body, axis=0)


def pair_parts(
    target: Sequence[Part], source: Sequence[Part], of_target: Booleans, of_source: Booleans
) -> tuple[dict[int, int], Floats]:
    """Pair parts of the target, moved to the source with the body, and parts of the source one to one.

    `of_target` (p, r) and `of_source` (q, r) are masks of the regions that contain each part. Returns the number of the
    source's part by that of the target's, and (p, q) misfits, infinite if regions exclude a pair.
    """
    place, size = _apart(target, source)
    rough = np.minimum(place, 2 * MAX_MISFIT) + size
    relation = relation_of(of_target, of_source)
    misfit = np.where(np.isinf(relation), np.inf, 10 * MAX_MISFIT)
    possible = (rough <= 2 * MAX_MISFIT) & np.isfinite(relation)
    possible &= rough <= np.sort(rough, axis=1)[:, :CANDIDATE_PARTNERS][:, -1:]
    close = possible & (rough <= MAX_MISFIT)
    contested = (close.sum(axis=1) > 1)[:, None] | (close.sum(axis=0) > 1)
    for i, j in np.argwhere(possible):
        ours, theirs = target[i], source[j]
        size_and_error = max(ours.size, theirs.size) + BODY_MAP_ERROR
        apart = max(ours.distance_to(theirs), theirs.distance_to(ours)) / size_and_error
        shape = float(np.mean(np.abs(ours.distances - theirs.distances))) if contested[i, j] else 0.0
        misfit[i, j] = relation[i, j] * (apart + size[i, j] + SHAPE_WEIGHT * shape)
    rows, columns = scipy.optimize.linear_sum_assignment(np.minimum(misfit, 10 * MAX_MISFIT))
    return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if misfit[i, j] <= MAX_MISFIT}, misfit


def _apart(target: Sequence[Part], source: Sequence[Part]) -> tuple[Floats, Floats]:
    """(p, q) distances of the centres relative to the sizes and the error of the map, and ratios of the sizes."""
    centres = [np.array([part.centre for part in parts]) for parts in (target, source)]
    sizes = [np.maximum([part.size for part in parts], 1e-12) for parts in (target, source)]
    distance = np.linalg.norm(centres[0][:, None] - centres[1], axis=2)
    ratio = np.abs(np.log(sizes[0][:, None] / sizes[1]))
    return distance / (np.maximum(sizes[0][:, None], sizes[1]) + BODY_MAP_ERROR), ratio


def relation_of(of_target: Booleans, of_source: Booleans) -> Floats:
    """(p, q) factors of a misfit: smaller for shared regions, infinite if both parts are in regions, but share none."""
    common = of_target.astype(float) @ of_source.T
    union = of_target.sum(axis=1)[:, None] + of_source.sum(axis=1) - common
    factor = 1 - SAME_REGION_DISCOUNT * common / np.maximum(union, 1)
    strangers = of_target.any(axis=1)[:, None] & of_source.any(axis=1) & (common == 0)
    return np.where(strangers, np.inf, factor)


def _group(label: Integers) -> list[Integers]:
    """The elements of each label, ascending."""
    order = np.argsort(label, kind="stable")
    return np.split(order, np.cumsum(np.bincount(label))[:-1])
