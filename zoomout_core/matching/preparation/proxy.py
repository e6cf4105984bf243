# SPDX-License-Identifier: GPL-3.0-or-later
"""Proxies: meshes of a few thousand vertices, on which maps are computed whatever the size of the mesh.

Large meshes are decimated: with 200 eigenfunctions, a proxy of 5,000 vertices gives as exact a map as the full mesh, in
much less time. Coarse ones are subdivided, in their shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import SurfaceSearch, query_tree, search_tree
from zoomout_core.geometry.embedded_surface import Neighbourhoods, project_to_embedding
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ProxyTuning(Tuning, set_by="speed"):
    """The default size of proxies, and the projection back to the full mesh."""

    # Ratio of the mesh's vertices to the proxy's, within limits. Finer meshes share finer features, to which the target
    # is registered.
    reduction: int = tuned(8, "1", 1, 1000)
    min_vertices: int = tuned(4000, "vertices", 4, 10**6)  # minimum size of a proxy
    max_vertices: int = tuned(6000, "vertices", 4, 10**6)  # larger ones take longer and gain little
    # Meshes of fewer vertices are subdivided. Non-rigid registration needs two vertices for each node, and three rings
    # around a vertex of a coarser mesh span whole limbs.
    fewest: int = tuned(400, "vertices", 4, 10**6)
    worthwhile: float = tuned(1.25, "1", 1, 10)  # meshes larger by less than this factor are not decimated
    near_enough: float = tuned(2e-3, "at unit area", 0, 0.1)  # images move to any point of the full mesh this near


PROXY = ProxyTuning()

# Number of vertices of a proxy, as in `MatchOptions`.
ProxyVertices: TypeAlias = int | Literal["auto"] | None


@dataclass(frozen=True, eq=False)
class Proxy:
    """A mesh part and its proxy, a decimated or subdivided mesh; the part itself if its size is right."""

    full: WorkingMesh  # the part
    mesh: WorkingMesh  # the proxy, of unit area
    vertices: Floats  # (n, 3) the proxy's vertices in the frame of the part
    merged: Integers  # (n_full,) the proxy's vertex that each vertex of the part was merged into

    @cached_property
    def place(self) -> SurfaceMap:
        """For every vertex of the part the closest point of the proxy, near the vertex that it was merged into.

        So if two limbs touch, each vertex stays on its own limb.
        """
        if self.mesh is self.full:
            corner = np.empty(len(self.vertices), dtype=np.int64)
            corner[self.mesh.triangles.ravel()] = np.arange(self.mesh.triangles.size)
            return SurfaceMap(corner // 3, np.eye(3)[corner % 3], self.mesh.triangles)
        triangles, n = self.mesh.triangles, len(self.vertices)
        around = Neighbourhoods(triangles, n, edges=0)
        triangle, barycentric = project_to_embedding(self.full.vertices, self.vertices, around, self.merged)
        # If the closest point is on the boundary of the vertex's triangles, a closer one may be beyond it.
        weight = np.where(triangles[triangle] == self.merged[:, None], barycentric, 0).sum(axis=1)
        rim = np.flatnonzero(weight <= 0)
        beyond = project_to_embedding(
            self.full.vertices[rim], self.vertices, Neighbourhoods(triangles, n), self.merged[rim]
        )
        triangle[rim], barycentric[rim] = beyond
        return SurfaceMap(triangle, barycentric, triangles)

    @cached_property
    def frame(self) -> tuple[Floats, float]:
        """(3,) origin and size of the mesh's frame in the frame of the part."""
        centre, mesh_centre = self.vertices.mean(axis=0), self.mesh.vertices.mean(axis=0)
        size = float(np.linalg.norm(self.vertices - centre) / np.linalg.norm(self.mesh.vertices - mesh_centre))
        return centre - size * mesh_centre, size

    def to_surface(self, points: Floats) -> Floats:
        """(q, 3) points given in the frame of the mesh, in the frame and unit of the surface that the part is of."""
        origin, size = self.frame
        return self.full.to_surface(origin + size * points)

    def from_surface(self, points: Floats) -> Floats:
        """(q, 3) points given in the surface's frame and unit, in the frame of the mesh."""
        origin, size = self.frame
        return np.asarray((self.full.from_surface(points) - origin) / size)

    def closest(self, images: Floats) -> SurfaceMap:
        """The points of the part that are closest to points (q, 3) on or near the proxy."""
        return SurfaceMap(*self.search.closest(images, PROXY.near_enough), self.full.triangles)

    @cached_property
    def search(self) -> SurfaceSearch:
        """Search structure for closest points of the part."""
        return SurfaceSearch(self.full.vertices, self.full.triangles)

    @cached_property
    def full_vertex(self) -> Integers:
        """(n,) the part's vertex nearest to each vertex of the proxy."""
        return query_tree(search_tree(self.full.vertices), self.vertices, 1)[1]


def proxy_size(vertices: int, proxy_vertices: ProxyVertices) -> int | None:
    """Number of vertices of the proxy for a mesh of some vertices; None for the mesh itself."""
    if proxy_vertices != "auto":
        return proxy_vertices
    return int(np.clip(vertices // PROXY.reduction, PROXY.min_vertices, PROXY.max_vertices))


def make_proxy(part: WorkingMesh, count: int | None) -> Proxy:
    """A proxy of a connected mesh: subdivided if it is coarse, decimated to about `count` vertices if that is given."""
    if len(part.vertices) < PROXY.fewest:
        mesh = part.subdivide(PROXY.fewest)
        return Proxy(part, mesh, mesh.vertices, np.arange(len(part.vertices)))
    if count is None or len(part.vertices) <= PROXY.worthwhile * count:
        return Proxy(part, part, part.vertices, np.arange(len(part.vertices)))
    points, triangles, merged = decimate(part.vertices, part.oriented_triangles, count)
    mesh, _ = Surface(points, triangles).working.part(0)
    vertices = points[mesh.surface_vertex]
    merged = mesh.vertex_of[merged]
    astray = merged < 0  # merged into a small component that is not in the proxy
    merged[astray] = cKDTree(vertices).query(part.vertices[astray])[1]
    return Proxy(part, mesh, vertices, merged)


def full_images(between: SurfaceMap, source: Proxy, target: Proxy) -> Floats:
    """(n_full, 3) images of the target part's vertices by a map between proxies, on the source's proxy."""
    return target.place.interpolate(between.interpolate(source.vertices))
