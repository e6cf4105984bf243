# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting a mesh open along the seams of a UV map that it is to receive."""

from __future__ import annotations

import bmesh
import numpy as np
from bmesh.types import BMesh, BMFace, BMVert
from bpy.types import Mesh

from zoomout_core.runtime.progress import advance
from zoomout_core.transfer.uv.seam_cut import SeamCut

from ..jobs import pause
from .surfaces import read_positions

# Edges or faces to divide before the window gets its turn: some ten milliseconds' work.
PIECE = 2000


async def divide(mesh: Mesh, cut: SeamCut) -> BMesh:
    """A copy of a mesh with the new vertices of a cut, and its faces divided between them; what it carries is mixed.

    New vertices come after those that the mesh has, in the order of the cut, and so do further parts of faces.

    Args:
        mesh: read at once; it may be freed meanwhile.
        cut: where to divide it.

    Returns:
        The copy, for `write_divided`, which the caller frees.
    """
    copy = bmesh.new()
    try:
        copy.from_mesh(mesh)
        points = _points(mesh, cut)
        await _divide(copy, cut, points)
    except BaseException:
        copy.free()
        raise
    return copy


def write_divided(mesh: Mesh, divided: BMesh) -> None:
    """Put the divided copy of a mesh in its place."""
    divided.to_mesh(mesh)
    mesh.update()


async def _divide(copy: BMesh, cut: SeamCut, points: list[list[float]]) -> None:
    copy.verts.ensure_lookup_table()
    copy.faces.ensure_lookup_table()
    vertices = list(copy.verts)
    faces = [copy.faces[number] for number in cut.face.tolist()]
    meeting = [copy.faces[number] for number in cut.meeting.tolist()]
    await _pause_at(0.4)
    for number, (ends, fraction) in enumerate(zip(cut.edge.tolist(), cut.fraction.tolist(), strict=True)):
        first, second = (vertices[end] for end in ends)
        _, new = bmesh.utils.edge_split(copy.edges.get((first, second)), first, fraction)
        vertices.append(new)
        if number % PIECE == 0:
            await _pause_at(0.4 + 0.3 * number / len(cut.edge))
    for number, (face, (one, other)) in enumerate(zip(faces, cut.ends.tolist(), strict=True)):
        bmesh.utils.face_split(face, vertices[one], vertices[other])
        if number % PIECE == 0:
            await _pause_at(0.7 + 0.2 * number / len(faces))
    for face, spokes, point in zip(meeting, cut.spokes, points, strict=True):
        vertices.append(_divide_from(face, [vertices[place] for place in sorted(spokes.tolist(), reverse=True)], point))
    await _pause_at(0.9)
    for number, vertex in enumerate(vertices):
        vertex.index = number
    copy.verts.sort()  # Blender puts new vertices where it has deleted others


async def _pause_at(fraction: float) -> None:
    advance(fraction)
    await pause()


def _points(mesh: Mesh, cut: SeamCut) -> list[list[float]]:
    """Where seams meet within faces, in the mesh's own space."""
    points: list[list[float]] = np.einsum("hc,hcx->hx", cut.weights, read_positions(mesh)[cut.corners]).tolist()
    return points


def _divide_from(face: BMFace, spokes: list[BMVert], point: list[float]) -> BMVert:
    """Give a face a vertex at a point within it, and edges from there to some of its vertices; the first is on an edge.

    Returns:
        The new vertex.
    """
    first, second, *others = spokes
    part, _ = bmesh.utils.face_split(face, first, second, coords=(point,))
    (hub,) = {*face.verts} & {*part.verts} - {first, second}
    for other in others:
        (part,) = {*hub.link_faces} & {*other.link_faces}
        bmesh.utils.face_split(part, hub, other)
    return hub
