"""Cutting a mesh open along the seams of a UV map that it is to receive."""

from __future__ import annotations

import bmesh
from bpy.types import Mesh

from zoomout_core.transfer.seam_cut import SeamCut


def cut_mesh(mesh: Mesh, cut: SeamCut) -> None:
    """Give a mesh the new vertices of a cut, and divide its faces between them; what it carries is interpolated.

    New vertices come after those that the mesh has, and so do second parts of faces.
    """
    editable = bmesh.new()
    editable.from_mesh(mesh)
    editable.verts.ensure_lookup_table()
    editable.faces.ensure_lookup_table()
    vertices = list(editable.verts)
    faces = [editable.faces[number] for number in cut.face.tolist()]
    for (first, second), fraction in zip(cut.edge.tolist(), cut.fraction.tolist(), strict=True):
        edge = editable.edges.get((vertices[first], vertices[second]))
        _, new = bmesh.utils.edge_split(edge, vertices[first], fraction)
        vertices.append(new)
    for face, (one, other) in zip(faces, cut.ends.tolist(), strict=True):
        bmesh.utils.face_split(face, vertices[one], vertices[other])
    editable.to_mesh(mesh)
    editable.free()
    mesh.update()
