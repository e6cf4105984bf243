"""Cutting a mesh open along the seams of a UV map that it is to receive."""

from __future__ import annotations

import bmesh
import numpy as np
from bmesh.types import BMFace, BMVert
from bpy.types import Mesh

from zoomout_core.transfer.seam_cut import SeamCut

from .surfaces import read_positions


def cut_mesh(mesh: Mesh, cut: SeamCut) -> None:
    """Give a mesh the new vertices of a cut, and divide its faces between them; what it carries is interpolated.

    New vertices come after those that the mesh has, in the order of the cut, and so do further parts of faces.
    """
    editable = bmesh.new()
    editable.from_mesh(mesh)
    editable.verts.ensure_lookup_table()
    editable.faces.ensure_lookup_table()
    vertices = list(editable.verts)
    faces = [editable.faces[number] for number in cut.face.tolist()]
    meeting = [editable.faces[number] for number in cut.meeting.tolist()]
    for (first, second), fraction in zip(cut.edge.tolist(), cut.fraction.tolist(), strict=True):
        edge = editable.edges.get((vertices[first], vertices[second]))
        _, new = bmesh.utils.edge_split(edge, vertices[first], fraction)
        vertices.append(new)
    for face, (one, other) in zip(faces, cut.ends.tolist(), strict=True):
        bmesh.utils.face_split(face, vertices[one], vertices[other])
    for face, spokes, point in zip(meeting, cut.spokes, _points(mesh, cut), strict=True):
        vertices.append(_divide_from(face, [vertices[place] for place in sorted(spokes.tolist(), reverse=True)], point))
    for number, vertex in enumerate(vertices):
        vertex.index = number
    editable.verts.sort()  # Blender puts new vertices where it has deleted others
    editable.to_mesh(mesh)
    editable.free()
    mesh.update()


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
