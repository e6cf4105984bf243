# SPDX-License-Identifier: GPL-3.0-or-later
"""The copy of a surface that geometry is computed on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Indices, Integers, segment_sum, take_rows
from zoomout_core.mesh.triangles import (
    Sides,
    area_normals,
    components,
    have_three_corners,
    sides_by_edge,
    triangle_areas,
    vertex_normals,
)
from zoomout_core.mesh.welding import repeated_triangles, weld

# The volume of a closed surface, relative to a sphere's of the same area, is exact up to this rounding.
NO_VOLUME = 1e-9
# Signed volume of an open surface, relative to a sphere of the same area, below which its sign is not trusted.
MIN_OPEN_VOLUME = 0.02
# The same ratio, divided by the length of the mean normal, above which the volume defines the outside of a surface.
# Shallower open surfaces, such as cloth, may bend the other way in another pose.
MIN_VOLUME_PER_NORMAL = 2.0


@dataclass(frozen=True, eq=False)
class WorkingMesh:
    """The welded, consistently wound triangle mesh of unit area that geometry is computed on.

    Attributes:
        vertices: (n, 3) positions, centred, divided by the square root of the surface's area.
        triangles: (m, 3) vertex numbers, corners in the order of the surface's own triangle.
        flipped: (m,) whether a triangle winds against the consistent, outward orientation.
        vertex_of: (n_surface,) the working vertex of each vertex of the surface, -1 for a vertex without a face.
        triangle_of: (m,) the surface's triangle that each triangle comes from.
        component: (n,) number of the connected component of each vertex, the largest area first.
        scale: square root of the surface's area, in the surface's units.
        origin: (3,) the origin of this mesh in the surface's frame and unit.
        is_hull: whether it is a voxel hull around the surface: then its triangles do not come from the surface, and
            `vertex_of` is the nearest vertex.
    """

    vertices: Floats
    triangles: Integers
    flipped: Booleans
    vertex_of: Integers
    triangle_of: Integers
    component: Integers
    scale: float
    origin: Floats
    is_hull: bool = False

    @cached_property
    def oriented_triangles(self) -> Integers:
        """(m, 3) the triangles, all wound so that their normals point outwards."""
        if not self.flipped.any():  # as usual
            return self.triangles
        return np.where(self.flipped[:, None], self.triangles[:, [0, 2, 1]], self.triangles)

    @cached_property
    def vertex_normals(self) -> Floats:
        """(n, 3) outward unit normals, weighted by area."""
        return vertex_normals(self.vertices, self.oriented_triangles)

    @cached_property
    def surface_vertex(self) -> Integers:
        """(n,) a vertex of the surface for each vertex, the last of several that were welded.

        Vertices of a hull, and those that a subdivision adds, have none.
        """
        used = np.flatnonzero(self.vertex_of >= 0)
        numbers = np.empty(len(self.vertices), dtype=np.int64)
        numbers[self.vertex_of[used]] = used
        return numbers

    @cached_property
    def sides_are_known(self) -> bool:
        """Whether the enclosed volume defines the outside; it does not for a cloth, which may bend either way.

        The mean normal of a closed surface is zero, that of a flat one has unit length.
        """
        return bool(self._sides_are_known(np.zeros(len(self.triangles), dtype=int))[0])

    @cached_property
    def component_sides_are_known(self) -> Booleans:
        """(components,) the same of each component."""
        return self._sides_are_known(self.component[self.triangles[:, 0]])

    def _sides_are_known(self, patch: Integers) -> Booleans:
        """(p,) whether the enclosed volume defines the outside of patches, by the patch of each triangle (m,)."""
        area, volume = _area_and_volume(self.vertices, self.oriented_triangles, patch)
        normals = segment_sum(area_normals(self.vertices, self.oriented_triangles), patch)
        mean_normal = np.linalg.norm(normals, axis=1) / 2 / area
        return np.asarray(volume / _sphere(area) > MIN_VOLUME_PER_NORMAL * mean_normal + NO_VOLUME)

    def part(self, component: int) -> tuple[WorkingMesh, Integers]:
        """One connected component as a mesh of its own, rescaled to unit area.

        Returns:
            The component, and (n_part,) the vertices of this mesh that it consists of.
        """
        inside = self.component == component
        vertices = np.flatnonzero(inside)
        if len(vertices) == len(inside):
            return self, vertices
        number = np.full(len(inside) + 1, -1)  # the extra last entry maps vertex_of = -1
        number[vertices] = np.arange(len(vertices))
        kept = inside[self.triangles].all(axis=1)
        triangles = number[self.triangles[kept]]
        area = triangle_areas(self.vertices[vertices], triangles).sum()
        centre = self.vertices[vertices].mean(axis=0)
        return WorkingMesh(
            vertices=(self.vertices[vertices] - centre) / np.sqrt(area),
            triangles=triangles,
            flipped=self.flipped[kept],
            vertex_of=number[self.vertex_of],
            triangle_of=self.triangle_of[kept],
            component=np.zeros(len(vertices), dtype=int),
            scale=self.scale * float(np.sqrt(area)),
            origin=self.origin + self.scale * centre,
        ), vertices

    def piece(self, inside: Booleans) -> tuple[WorkingMesh, Integers]:
        """The largest connected piece on some vertices (n,), as from `part`; they must span a triangle."""
        kept = inside[self.triangles].all(axis=1)
        return replace(self, component=_component(self.vertices, self.triangles[kept])).part(0)

    def subdivide(self, min_vertices: int) -> WorkingMesh:
        """Subdivide at the middles of edges until there are enough vertices; those of this mesh come first."""
        mesh = self
        while len(mesh.vertices) < min_vertices:
            sides = np.sort(np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2), axis=2)
            edges, edge = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
            a, b, c = mesh.triangles.T
            ab, bc, ca = edge.reshape(-1, 3).T + len(mesh.vertices)
            corners = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
            mesh = replace(
                mesh,
                vertices=np.concatenate([mesh.vertices, mesh.vertices[edges].mean(axis=1)]),
                triangles=np.concatenate([np.stack(each, axis=1) for each in corners]),
                flipped=np.tile(mesh.flipped, 4),
                triangle_of=np.tile(mesh.triangle_of, 4),
                component=np.concatenate([mesh.component, mesh.component[edges[:, 0]]]),
            )
        return mesh

    def from_surface(self, points: Floats) -> Floats:
        """(q, 3) points in this mesh's frame, from the surface's frame and unit."""
        return np.asarray((points - self.origin) / self.scale)

    def to_surface(self, points: Floats) -> Floats:
        """(q, 3) points in the surface's frame and unit, from this mesh's frame."""
        return np.asarray(self.origin + self.scale * points)


def working_mesh(vertices: Floats, triangles: Integers, area: float, referenced: Integers) -> WorkingMesh:
    """The working copy of triangles (m, 3), of a total area above zero, on vertices (n, 3).

    A face uses the referenced vertices, even if all of its triangles are degenerate.
    """
    given = triangles
    sides = sides_by_edge(triangles)
    stands_for = weld(vertices, triangles, sides)
    triangles = stands_for[triangles]
    kept = np.flatnonzero(have_three_corners(triangles))
    if not (len(kept) == len(triangles) and (triangles == given).all()):
        triangles = triangles[kept]
        sides = sides_by_edge(triangles)
    again = repeated_triangles(triangles, sides)
    if again.any():
        kept, triangles = kept[~again], triangles[~again]
        sides = sides_by_edge(triangles)
        area = float(triangle_areas(vertices, triangles).sum())
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    number = np.where(used, np.cumsum(used) - 1, -1)
    triangles = number[triangles]

    scale = float(np.sqrt(area))
    origin = vertices[used].mean(axis=0)
    points = (vertices[used] - origin) / scale
    of_a_face = np.zeros(len(vertices), dtype=bool)
    of_a_face[referenced] = True
    return WorkingMesh(
        vertices=points,
        triangles=triangles,
        flipped=_flipped_triangles(points, triangles, sides),
        vertex_of=np.where(of_a_face, number[stands_for], -1),
        triangle_of=kept,
        component=_component(points, triangles),
        scale=scale,
        origin=origin,
    )


def _component(vertices: Floats, triangles: Integers) -> Integers:
    """(n,) connected components, numbered by decreasing area."""
    label = components(np.concatenate([triangles[:, :2], triangles[:, 1:]]), len(vertices))
    count = int(label.max()) + 1
    if count == 1:
        return label.astype(np.int64)
    area = np.bincount(label[triangles[:, 0]], triangle_areas(vertices, triangles), minlength=count)
    rank = np.empty(count, dtype=int)
    rank[np.argsort(-area, kind="stable")] = np.arange(count)
    return rank[label]


def _flipped_triangles(vertices: Floats, triangles: Integers, sides: Sides) -> Booleans:
    """(m,) which triangles to flip so that neighbours agree and normals point outwards."""
    side, first = sides
    m, count = len(triangles), np.diff(first)
    pair = first[:-1][count == 2]  # only manifold edges propagate an orientation
    left, right = side[pair], side[pair + 1]
    forward = (triangles < np.roll(triangles, -1, axis=1)).ravel()
    agree = forward[left] != forward[right]
    left, right = left // 3, right // 3
    turned, patch = _wind_alike(m, left, right, agree)
    oriented = np.where(turned[:, None], triangles[:, ::-1], triangles) if turned.any() else triangles
    area, volume = _area_and_volume(vertices, oriented, patch)
    has_border = np.zeros(len(area), dtype=bool)
    has_border[patch[side[np.repeat(count != 2, count)] // 3]] = True
    inward = volume < -np.where(has_border, MIN_OPEN_VOLUME, NO_VOLUME) * _sphere(area)
    return turned ^ inward[patch]


def _wind_alike(m: int, left: Indices, right: Indices, agree: Booleans) -> tuple[Booleans, Indices]:
    """(m,) which of m triangles to flip so that neighbours have the same winding, and (m,) their patch numbers.

    The triangles `left` and `right` (e,) are neighbours, which may already have the same winding (e,). Triangles that
    do form pieces. The orientation double cover has each piece twice, kept and flipped. Neighbours that disagree are
    joined crosswise. A sheet that contains one copy of each piece is a consistent winding.
    """
    piece = components(np.stack([left[agree], right[agree]], axis=1), m)
    size = np.bincount(piece)
    count, one, other = len(size), piece[left[~agree]], piece[right[~agree]]
    rows, columns = np.concatenate([one, one + count]), np.concatenate([other + count, other])
    sheet = components(np.stack([rows, columns], axis=1), 2 * count)
    # Take the sheet over a patch that keeps more triangles (a Moebius band has only one sheet: keep all).
    kept = np.bincount(sheet[:count], size, minlength=2 * count)
    turned = kept[sheet[count:]] > kept[sheet[:count]]
    tie = kept[sheet[count:]] == kept[sheet[:count]]
    turned[tie] = sheet[count:][tie] < sheet[:count][tie]
    return turned[piece], np.minimum(sheet[:count], sheet[count:])[piece]


def _area_and_volume(vertices: Floats, triangles: Integers, patch: Indices) -> tuple[Floats, Floats]:
    """The area (p,) of patches of triangles (m, 3), and the signed volume between each and its centroid."""
    area_normal = area_normals(vertices, triangles)
    a, b, c = (take_rows(vertices, corner) for corner in triangles.T)
    centre = (a + b + c) / 3
    size = np.sqrt(np.einsum("mx,mx->m", area_normal, area_normal)) / 2
    area = segment_sum(size, patch)
    middle = segment_sum(size[:, None] * centre, patch)
    middle = middle / np.where(area > 0, area, 1)[:, None]
    volume = segment_sum(np.einsum("ij,ij->i", centre - take_rows(middle, patch), area_normal) / 6, patch)
    return area, volume


def _sphere(area: Floats) -> Floats:
    """The volume of spheres of the given areas."""
    return area**1.5 / (6 * np.sqrt(np.pi))
