"""Where to cut the target open, so that its UV islands end exactly where the source's do.

A face of the target that lies across a seam of the source belongs to one island only, so borders between islands
are ragged by the size of a face. Where a target's edge crosses a seam, a new vertex on it makes the border exact;
faces are divided between two such places. Nothing else of the target changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.surface import Surface
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.cut import CutSurface, cut_open, ragged
from zoomout_core.transfer.draped import Draped

# A crossing nearer to an edge's end than this part of the edge is at that end: no slivers.
SNAP = 0.1
# An edge is halved so many times to find where it crosses a seam.
HALVINGS = 14


@dataclass(frozen=True, eq=False)
class SeamCut:
    """New vertices on edges of the target, and cuts through its faces from one place to another.

    Places are numbered: first the target's n vertices, then the new ones.

    Attributes:
        edge: (e, 2) vertices of the edges that receive a new vertex.
        fraction: (e,) where on the edge, from its first vertex.
        face: (f,) faces that are divided.
        ends: (f, 2) the places that a face is divided between.
        surface_map: (n + e) places on the source, also of vertices that were moved onto a seam by rounding.
        left: how many faces are crossed in ways that one straight cut does not describe; they stay whole.
    """

    edge: Integers
    fraction: Floats
    face: Integers
    ends: Integers
    surface_map: SurfaceMap
    left: int

    def applied(self, target: Surface) -> Surface:
        """The target, cut open: new vertices after its own, second parts of divided faces after its faces."""
        first, second = (target.vertices[self.edge[:, i]] for i in range(2))
        added = first + self.fraction[:, None] * (second - first)
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
        return Surface(np.concatenate([target.vertices, added]), faces)


def _with_places(face: list[int], place: dict[tuple[int, int], int]) -> list[int]:
    """The vertices around a face, with the new ones on its edges."""
    around = []
    for vertex, following in zip(face, face[1:] + face[:1], strict=True):
        new = place.get((min(vertex, following), max(vertex, following)))
        around += [vertex] if new is None else [vertex, new]
    return around


def seam_cut(uv: Attribute, draped: Draped) -> SeamCut:
    """Where to cut the target along the seams of a UV map of the source.

    Args:
        uv: of the source, with values (c, 2) at its corners.
        draped: the target on the source.
    """
    cut = cut_open(draped.source, np.asarray(uv.values, dtype=np.float64))
    edge = _edges_of(np.flatnonzero(draped.near_border(cut)), draped)
    crossing = _leaves_sheet(cut, draped, edge, np.ones(len(edge)))[0]
    edge = edge[crossing]
    fraction, place = _crossings(cut, draped, edge)
    n = len(draped.target.vertices)

    # A vertex next to a seam counts as on it, and so do all crossings of the edges around it.
    nearer = np.where(fraction < 0.5, edge[:, 0], edge[:, 1])
    snapped = np.flatnonzero(np.minimum(fraction, 1 - fraction) < SNAP)
    snapped = snapped[np.argsort(-np.minimum(fraction, 1 - fraction)[snapped], kind="stable")]  # the nearest come last
    on_seam = np.zeros(n, dtype=bool)
    on_seam[nearer[snapped]] = True
    triangle, barycentric = draped.surface_map.triangle.copy(), draped.surface_map.barycentric.copy()
    triangle[nearer[snapped]], barycentric[nearer[snapped]] = place.triangle[snapped], place.barycentric[snapped]
    kept = ~on_seam[edge].any(axis=1)
    edge, fraction = edge[kept], fraction[kept]
    surface_map = SurfaceMap(
        np.concatenate([triangle, place.triangle[kept]]),
        np.concatenate([barycentric, place.barycentric[kept]]),
        draped.surface_map.source_triangles,
    )
    face, ends, left = _divided(draped, edge, on_seam)
    return SeamCut(edge, fraction, face, ends, surface_map, left)


def _edges_of(faces: Integers, draped: Draped) -> Integers:
    """(e, 2) the vertices of the edges of some faces of the target, each edge once, the smaller number first."""
    target = draped.target
    start, end = target.face_start[faces], target.face_start[faces + 1]
    _, corner = ragged(faces, start, end, np.arange(len(target.corner_vertex)))
    ends = np.sort(target.corner_vertex[np.stack([corner, _next_corner(corner, draped)], axis=1)], axis=1)
    ends = np.unique(ends, axis=0)
    return np.asarray(ends[ends[:, 0] != ends[:, 1]])


def _next_corner(corner: Integers, draped: Draped) -> Integers:
    target = draped.target
    face = target.corner_face[corner]
    return np.where(corner + 1 < target.face_start[face + 1], corner + 1, target.face_start[face])


def _leaves_sheet(cut: CutSurface, draped: Draped, edge: Integers, fraction: Floats) -> tuple[Booleans, SurfaceMap]:
    """Whether the way from an edge's first vertex to a place on it crosses a cut, and that place on the source."""
    begin, end = draped.points[edge[:, 0]], draped.points[edge[:, 1]]
    points = begin + fraction[:, None] * (end - begin)
    nearer = np.where(fraction < 0.5, edge[:, 0], edge[:, 1])
    triangle, barycentric, _ = draped.whole.walk(draped.surface_map.triangle[nearer], points)
    place = SurfaceMap(triangle, barycentric, draped.surface_map.source_triangles)
    _, _, gap = cut.walk(draped.surface_map.triangle[edge[:, 0]], place.interpolate(draped.source.vertices))
    return gap > 0, place


def _crossings(cut: CutSurface, draped: Draped, edge: Integers) -> tuple[Floats, SurfaceMap]:
    """(e,) where edges whose ends lie on two sheets cross from one to the other, and these places on the source."""
    low, high = np.zeros(len(edge)), np.ones(len(edge))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        beyond, _ = _leaves_sheet(cut, draped, edge, middle)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    _, place = _leaves_sheet(cut, draped, edge, low)
    return low, place


def _divided(draped: Draped, edge: Integers, on_seam: Booleans) -> tuple[Integers, Integers, int]:
    """The faces that the seam divides, the two places that each is divided between, and how many stay whole."""
    target = draped.target
    n = len(target.vertices)
    corner = np.arange(len(target.corner_vertex))
    vertex, following = target.corner_vertex, target.corner_vertex[_next_corner(corner, draped)]
    key = np.minimum(vertex, following) * n + np.maximum(vertex, following)
    order = np.argsort(edge[:, 0] * n + edge[:, 1], kind="stable")
    known = (edge[:, 0] * n + edge[:, 1])[order]
    at = np.minimum(np.searchsorted(known, key), max(0, len(known) - 1))
    crosses = known[at] == key if len(known) else np.zeros(len(key), dtype=bool)
    # Around each face: its vertices that are on a seam, at even steps, and the crossings of its edges, at odd ones.
    face = np.concatenate([target.corner_face[on_seam[vertex]], target.corner_face[crosses]])
    step = 2 * (corner - target.face_start[target.corner_face])
    steps = np.concatenate([step[on_seam[vertex]], step[crosses] + 1])
    place = np.concatenate([vertex[on_seam[vertex]], n + order[at[crosses]] if len(known) else np.empty(0, np.int64)])
    order = np.lexsort((steps, face))
    face, steps, place = face[order], steps[order], place[order]
    first = np.flatnonzero(np.diff(face, prepend=-1))
    count = np.diff(first, append=len(face))
    pair = first[count == 2]
    around = 2 * np.diff(target.face_start)[face[pair]]
    gap = steps[pair + 1] - steps[pair]
    # Two vertices at the ends of one edge are joined by that edge.
    corners = (steps[pair] % 2 == 0) & (steps[pair + 1] % 2 == 0)
    apart = ~corners | (np.minimum(gap, around - gap) > 2)
    whole = int((count > 2).sum())
    return face[pair[apart]], np.stack([place[pair[apart]], place[pair[apart] + 1]], axis=1), whole
