# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting a mesh along the seams of a UV map that it will receive."""

from __future__ import annotations

import bmesh
import numpy as np
from bmesh.types import BMesh, BMFace, BMVert
from bpy.types import Mesh

from zoomout_core.runtime.progress import advance
from zoomout_core.transfer.uv.seam_cut import SeamCut

from ...jobs import pause
from ..surfaces.surfaces import read_positions

# Edges or faces to divide between two pauses for the window: about 10 ms.
PIECE = 2000


async def divide(mesh: Mesh, cut: SeamCut) -> BMesh:
    """A copy of a mesh with the new vertices of a cut and divided faces; its data is interpolated.

    New vertices and faces follow the mesh's own, in the order of the cut.

    Args:
        mesh: the mesh; it is read at once, and may be freed meanwhile.
        cut: where to divide it.

    Returns:
        The copy, for `write_divided`; the caller frees it.
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
    """Overwrite a mesh with its divided copy."""
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
    copy.verts.sort()  # Blender reuses the places of deleted vertices


async def _pause_at(fraction: float) -> None:
    advance(fraction)
    await pause()


def _points(mesh: Mesh, cut: SeamCut) -> list[list[float]]:
    """The points where seams meet within faces, in the mesh's own space."""
    points: list[list[float]] = np.einsum("hc,hcx->hx", cut.weights, read_positions(mesh)[cut.corners]).tolist()
    return points


def _divide_from(face: BMFace, spokes: list[BMVert], point: list[float]) -> BMVert:
    """Add a vertex within a face, and edges from there to some of its vertices, of which the first is on an edge.

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
