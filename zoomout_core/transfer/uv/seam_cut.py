# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut the target open, so that its UV islands end exactly where the source's do.

A target face that crosses a seam of the source belongs to one island only, so borders between islands are jagged by the
size of a face. Where a target's edge crosses a seam, a new vertex on it makes the border exact. Faces are divided
between two such places, or, where seams meet in a face, from several to a new vertex at the meeting point. Nothing else
of the target changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.cut_mesh import CutSurface, corners_of_faces, cut_surface, face_edges, triangles_of_faces
from zoomout_core.transfer.frames import on_working_mesh
from zoomout_core.transfer.groups import find, first_of_each, group_starts
from zoomout_core.transfer.mapped_target import MappedTarget

# Distance of a crossing from an end of its edge, in edge lengths, below which it snaps to that end to avoid slivers.
SNAP_DISTANCE = 0.1
# Minimum share of a face's area that an edge spans with a meeting point of seams; otherwise the point is not used.
MIN_SPOKE_AREA = 0.02
# Bisections of an edge to find where it crosses a seam.
BISECTIONS = 14


@dataclass(frozen=True, eq=False)
class SeamCut:
    """New vertices on edges of the target and within faces, and cuts through its faces from one place to another.

    Places are numbered: first the target's n vertices, then the new ones on edges, then those within faces.
    """

    edge: Integers  # (e, 2) vertices of the edges that receive a new vertex
    fraction: Floats  # (e,) its position on the edge, from the first vertex
    face: Integers  # (f,) faces that are divided by one straight cut
    ends: Integers  # (f, 2) the places between which each face is divided
    meeting: Integers  # (h,) faces with a meeting point of seams inside, where they receive a new vertex
    corners: Integers  # (h, 3) three vertices of each of these faces
    weights: Floats  # (h, 3) barycentric coordinates of the meeting point between these
    spokes: tuple[Integers, ...]  # h arrays of the places around a face, in order, that are joined to the meeting point
    surface_map: SurfaceMap  # (n + e + h) places on the source, also of vertices that were snapped to a seam
    left: int  # number of faces that are crossed in other ways; they stay whole

    def interpolate(self, values: Floats) -> Floats:
        """(n + e + h, d) values of all places, from values (n, d) of the target's vertices."""
        first, second = values[self.edge[:, 0]], values[self.edge[:, 1]]
        on_edges = first + self.fraction[:, None] * (second - first)
        return np.concatenate([values, on_edges, np.einsum("hc,hcd->hd", self.weights, values[self.corners])])

    def changes(self, confidence: Floats, has_partner: Booleans | None) -> dict[str, Any]:
        """The fields that the cut changes in a match with these values (n,), for `dataclasses.replace`.

        New vertices get the minimum of the values around them.
        """

        def minimum(values: NDArray[Any]) -> NDArray[Any]:
            return np.concatenate([values, *(values[around].min(axis=1) for around in (self.edge, self.corners))])

        return {
            "surface_map": self.surface_map,
            "confidence": minimum(confidence),
            "has_partner": None if has_partner is None else minimum(has_partner),
        }

    def apply(self, target: Surface) -> Surface:
        """Cut the target: new vertices follow its own, further parts of divided faces follow its faces."""
        place = {pair: len(target.vertices) + i for i, pair in enumerate(map(tuple, self.edge.tolist()))}
        faces = [part.tolist() for part in np.split(target.corner_vertex, target.face_start[1:-1])]
        if place:
            on_edge = np.zeros(len(target.vertices), dtype=bool)
            on_edge[self.edge.ravel()] = True
            touched = np.add.reduceat(on_edge[target.corner_vertex].astype(int), target.face_start[:-1]) > 1
            for number in np.flatnonzero(touched).tolist():
                faces[number] = _with_places(faces[number], place)
        for number, (one, other) in zip(self.face.tolist(), self.ends.tolist(), strict=True):
            around = faces[number]
            i, j = sorted((around.index(one), around.index(other)))
            faces[number] = around[i : j + 1]
            faces.append(around[j:] + around[: i + 1])
        hub = len(target.vertices) + len(self.edge)
        for number, spokes in zip(self.meeting.tolist(), self.spokes, strict=True):
            around = faces[number]
            at = sorted(around.index(place) for place in spokes.tolist())
            faces[number] = [*around[at[-1] :], *around[: at[0] + 1], hub]
            faces += [[*around[i : j + 1], hub] for i, j in pairwise(at)]
            hub += 1
        return Surface(self.interpolate(target.vertices), faces)


def _with_places(face: list[int], place: dict[tuple[int, int], int]) -> list[int]:
    """The vertices around a face, with the new ones on its edges."""
    around = []
    for vertex, following in zip(face, face[1:] + face[:1], strict=True):
        new = place.get((min(vertex, following), max(vertex, following)))
        around += [vertex] if new is None else [vertex, new]
    return around


def seam_cut(uv: Attribute, mapped: MappedTarget) -> SeamCut:
    """Find where to cut the target along the seams of a UV map of the source, with values (c, 2) at its corners."""
    cut = cut_surface(mapped.source, np.asarray(uv.values, dtype=np.float64))
    edge = _edges_across(cut, mapped)
    fraction, place = _crossings(cut, mapped, edge)
    snapped, on_seam = _snap(mapped.surface_map, edge, fraction, place)
    kept = ~on_seam[edge].any(axis=1)
    edge, fraction = edge[kept], fraction[kept]
    around = _crossings_around(mapped, edge, on_seam)
    face, ends = _divide_faces(mapped, around)
    meetings = _meetings(cut, mapped, around)
    junctions = SurfaceMap.from_vertices(meetings.vertex, mapped.source)
    surface_map = SurfaceMap(
        np.concatenate([snapped.triangle, place.triangle[kept], junctions.triangle]),
        np.concatenate([snapped.barycentric, place.barycentric[kept], junctions.barycentric]),
        mapped.surface_map.source_triangles,
    )
    return SeamCut(
        edge,
        fraction,
        face,
        ends,
        meeting=meetings.face,
        corners=meetings.corners,
        weights=meetings.weights,
        spokes=meetings.spokes,
        surface_map=surface_map,
        left=int((around.number > 2).sum()) - len(meetings.face),
    )


def _edges_across(cut: CutSurface, mapped: MappedTarget) -> Integers:
    """(e, 2) edges of the target, by vertices, that cross a cut of the source."""
    _, corner = corners_of_faces(mapped.target, np.flatnonzero(mapped.near_border(cut)))
    edge = np.unique(np.sort(mapped.target.corner_vertex[face_edges(mapped.target)[corner]], axis=1), axis=0)
    edge = edge[edge[:, 0] != edge[:, 1]]
    return edge[_leaves_sheet(cut, mapped, edge, np.ones(len(edge)))[0]]


def _snap(there: SurfaceMap, edge: Integers, fraction: Floats, place: SurfaceMap) -> tuple[SurfaceMap, Booleans]:
    """Snap vertices of the target next to a seam to it, with all crossings of the edges around them.

    Args:
        there: the target's map.
        edge: (e, 2) vertices of edges that cross a seam.
        fraction: (e,) where they cross it, in [0, 1].
        place: these places on the source.

    Returns:
        The map with the snapped vertices, and (n_t,) which vertices these are.
    """
    nearer, distance = np.where(fraction < 0.5, edge[:, 0], edge[:, 1]), np.minimum(fraction, 1 - fraction)
    snapped = np.flatnonzero(distance < SNAP_DISTANCE)
    snapped = snapped[np.argsort(-distance[snapped], kind="stable")]  # the closest come last
    triangle, barycentric = there.triangle.copy(), there.barycentric.copy()
    triangle[nearer[snapped]], barycentric[nearer[snapped]] = place.triangle[snapped], place.barycentric[snapped]
    on_seam = np.zeros(len(triangle), dtype=bool)
    on_seam[nearer[snapped]] = True
    return SurfaceMap(triangle, barycentric, there.source_triangles), on_seam


def _leaves_sheet(
    cut: CutSurface, mapped: MappedTarget, edge: Integers, fraction: Floats
) -> tuple[Booleans, SurfaceMap]:
    """Whether the path from an edge's first vertex to a place on it crosses a cut, and that place on the source."""
    begin, end = mapped.points[edge[:, 0]], mapped.points[edge[:, 1]]
    points = begin + fraction[:, None] * (end - begin)
    nearer = np.where(fraction < 0.5, edge[:, 0], edge[:, 1])
    triangle, barycentric, _ = mapped.whole.walk(mapped.surface_map.triangle[nearer], points)
    place = SurfaceMap(triangle, barycentric, mapped.surface_map.source_triangles)
    _, _, gap = cut.walk(mapped.surface_map.triangle[edge[:, 0]], place.interpolate(mapped.source.vertices))
    return gap > 0, place


def _crossings(cut: CutSurface, mapped: MappedTarget, edge: Integers) -> tuple[Floats, SurfaceMap]:
    """(e,) where edges with ends on two sheets cross from one to the other, and these places on the source."""
    low, high = np.zeros(len(edge)), np.ones(len(edge))
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        beyond, _ = _leaves_sheet(cut, mapped, edge, middle)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    _, place = _leaves_sheet(cut, mapped, edge, low)
    return low, place


class _Around(NamedTuple):
    """Places where seams cross the outlines of faces, face by face and around each."""

    face: Integers  # (q,) the face
    step: Integers  # (q,) position around the face: vertices at even steps, edges at odd ones
    place: Integers  # (q,) the number of the place
    first: Integers  # (g,) where the places of each face begin
    number: Integers  # (g,) number of places of each face


def _crossings_around(mapped: MappedTarget, edge: Integers, on_seam: Booleans) -> _Around:
    """The places around all faces: vertices on a seam, and crossings on edges (e, 2)."""
    target, n = mapped.target, len(mapped.target.vertices)
    low, high = np.sort(target.corner_vertex[face_edges(target)], axis=1).T
    crossing = find(edge[:, 0] * n + edge[:, 1], low * n + high)  # edges are in rising order
    crosses, at_seam = crossing >= 0, on_seam[target.corner_vertex]
    face = np.concatenate([target.corner_face[at_seam], target.corner_face[crosses]])
    step = 2 * (np.arange(len(low)) - target.face_start[target.corner_face])
    steps = np.concatenate([step[at_seam], step[crosses] + 1])
    place = np.concatenate([target.corner_vertex[at_seam], n + crossing[crosses]])
    order = np.lexsort((steps, face))
    face = face[order]
    first = group_starts(face)
    return _Around(face, steps[order], place[order], first, np.diff(first, append=len(face)))


def _divide_faces(mapped: MappedTarget, around: _Around) -> tuple[Integers, Integers]:
    """The faces that a seam divides by a straight cut, and the two ends of each cut."""
    pair = around.first[around.number == 2]
    length = 2 * np.diff(mapped.target.face_start)[around.face[pair]]
    gap = around.step[pair + 1] - around.step[pair]
    # Two vertices of one edge are joined already.
    corners = (around.step[pair] % 2 == 0) & (around.step[pair + 1] % 2 == 0)
    pair = pair[~corners | (np.minimum(gap, length - gap) > 2)]
    return around.face[pair], np.stack([around.place[pair], around.place[pair + 1]], axis=1)


class _Meetings(NamedTuple):
    """Points within faces where seams meet."""

    face: Integers  # (h,) the face
    vertex: Integers  # (h,) the source's vertex at each point
    corners: Integers  # (h, 3) the corners of the target's triangle that contains it
    weights: Floats  # (h, 3) its barycentric coordinates
    spokes: tuple[Integers, ...]  # h arrays of the places around the face


def _meetings(cut: CutSurface, mapped: MappedTarget, around: _Around) -> _Meetings:
    """Find where seams meet within faces that they cross at three places or more."""
    target, n = mapped.target, len(mapped.target.vertices)
    crossed = np.logical_or.reduceat(around.place >= n, around.first) if len(around.first) else around.first > 0
    group = np.flatnonzero((around.number > 2) & crossed)
    face = around.face[around.first[group]]
    junction = _junctions(cut)
    if len(junction) == 0 or len(face) == 0:
        none = np.empty(0, dtype=np.int64)
        return _Meetings(none, none, none.reshape(0, 3), np.empty((0, 3)), ())
    middle, radius = (part[face] for part in mapped.balls)
    distance, nearest = cKDTree(mapped.source.vertices[junction]).query(middle)
    vertex = junction[nearest]
    corners, weights = _within(mapped.source.vertices[vertex], face, mapped)
    point = np.einsum("hc,hcx->hx", weights, target.vertices[corners])
    inside = (np.asarray(distance) <= radius) & _sees_all(point, face, mapped)
    spokes = np.split(around.place, around.first[1:])
    return _Meetings(
        face[inside], vertex[inside], corners[inside], weights[inside], tuple(spokes[i] for i in group[inside].tolist())
    )


def _junctions(cut: CutSurface) -> Integers:
    """(j,) vertices of the source where three borders or more meet; one per place."""
    source = cut.surface
    vertices = np.sort(source.working.vertex_of[source.corner_vertex[cut.border]], axis=1)
    vertices = np.unique(vertices[(vertices[:, 0] >= 0) & (vertices[:, 0] < vertices[:, 1])], axis=0)
    meeting = np.bincount(vertices.ravel(), minlength=len(source.working.vertices)) > 2
    return on_working_mesh(source.working, np.arange(len(source.vertices)))[meeting]


def _within(points: Floats, face: Integers, mapped: MappedTarget) -> tuple[Integers, Floats]:
    """For points (h, 3) of the source, the nearest point of each face (h,) of the target, mapped onto the source.

    Returns:
        (h, 3) the corners of a triangle of the face, and (h, 3) the barycentric coordinates in it.
    """
    owner, triangle = triangles_of_faces(mapped.target, face)
    corners = mapped.target.triangles[triangle]
    weights, off = closest_on_triangles(points[owner], *mapped.points[corners].transpose(1, 0, 2))
    best = first_of_each(owner, np.linalg.norm(off, axis=1))
    return corners[best], weights[best]


def _sees_all(point: Floats, face: Integers, mapped: MappedTarget) -> Booleans:
    """(h,) whether straight lines from a point (h, 3) to the outline of its face (h,) stay inside the face."""
    target = mapped.target
    owner, corner = corners_of_faces(target, face)
    ends = target.vertices[target.corner_vertex[face_edges(target)[corner]]]
    here, there = ends[:, 0] - point[owner], ends[:, 1] - point[owner]
    normal = np.cross(here, there)
    sums = segment_sum(normal, owner)
    share = np.einsum("qx,qx->q", normal, sums[owner]) / np.einsum("hx,hx->h", sums, sums)[owner]
    return np.asarray(np.minimum.reduceat(share, group_starts(owner)) > MIN_SPOKE_AREA)
