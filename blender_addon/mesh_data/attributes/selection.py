# SPDX-License-Identifier: GPL-3.0-or-later
"""The selected vertices, edges and faces of Edit Mode.

Selections are written to the attributes in which Blender stores them. Blender 5.0 gives meshes made by `from_pydata` an
attribute of another type under the name of selected edges, and `foreach_set` on edges then writes past its end.
"""

from __future__ import annotations

import numpy as np
from bpy.types import Mesh

from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Domain, Kind

from ..arrays import read_array
from .layers import Layer, Role, write_layer

SELECTED = {Domain.POINT: ".select_vert", Domain.EDGE: ".select_edge", Domain.FACE: ".select_poly"}


def read_selection(mesh: Mesh) -> list[Attribute]:
    """The selection of vertices and of faces; one that is empty is left out."""
    found = (
        Attribute(message("selection"), domain, Kind.BOOLEAN, read_array(elements, "select", np.bool_))
        for domain, elements in ((Domain.POINT, mesh.vertices), (Domain.FACE, mesh.polygons))
    )
    return [attribute for attribute in found if attribute.values.any()]


def write_selection(mesh: Mesh, selected: Attribute) -> None:
    """Select only these vertices, with the edges between them, or only these faces."""
    _write(mesh, selected.domain, selected.values)
    if selected.domain is Domain.POINT:
        ends = read_array(mesh.edges, "vertices", np.int32, 2)
        _write(mesh, Domain.EDGE, selected.values[ends].all(axis=1))


def select_only(mesh: Mesh, selected: Attribute) -> None:
    """Select only these vertices or faces, with their other elements as in Edit Mode.

    Vertices select the edges and faces between them; faces select their edges and vertices.
    """
    corner_vertex = read_array(mesh.loops, "vertex_index", np.int32)
    start = read_array(mesh.polygons, "loop_start", np.int32)
    ends = read_array(mesh.edges, "vertices", np.int32, 2)
    if selected.domain is Domain.POINT:
        vertices = selected.values
        faces = np.logical_and.reduceat(vertices[corner_vertex], start) if len(start) else np.zeros(0, dtype=bool)
        edges = vertices[ends].all(axis=1)
    else:
        faces = selected.values
        of_faces = np.repeat(faces, np.diff(np.append(start, len(corner_vertex))))
        vertices, edges = np.zeros(len(mesh.vertices), dtype=bool), np.zeros(len(ends), dtype=bool)
        vertices[corner_vertex[of_faces]] = True
        edges[read_array(mesh.loops, "edge_index", np.int32)[of_faces]] = True
    for domain, values in ((Domain.POINT, vertices), (Domain.EDGE, edges), (Domain.FACE, faces)):
        _write(mesh, domain, values)
    mesh.update()


def _write(mesh: Mesh, domain: Domain, values: np.ndarray) -> None:
    attribute = Attribute(SELECTED[domain], domain, Kind.BOOLEAN, values)
    write_layer(mesh, Layer(attribute, Role.GENERIC, "BOOLEAN"))
