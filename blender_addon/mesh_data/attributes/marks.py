# SPDX-License-Identifier: GPL-3.0-or-later
"""Marks of single edges and vertices: seams, sharp edges, creases, bevel weights, and Freestyle lines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from bpy.types import Mesh, MeshEdge

from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Domain, Kind

from ..arrays import read_array


class MarkRow(NamedTuple):
    """How Blender stores one kind of mark.

    Attributes:
        attribute: the attribute's name since Blender 5.0.
        label: its name for the user.
        domain: edges or vertices.
        kind: boolean, or a strength.
        element: the edge property that stores it in some or all versions; then the attribute, if there is one, may
            have other names.
    """

    attribute: str
    label: str
    domain: Domain
    kind: Kind
    element: str = ""


SEAMS = message("seams")
MARKS = (
    MarkRow("uv_seam", SEAMS, Domain.EDGE, Kind.BOOLEAN, "use_seam"),
    MarkRow("sharp_edge", message("sharp edges"), Domain.EDGE, Kind.BOOLEAN, "use_edge_sharp"),
    MarkRow("freestyle_edge", message("Freestyle edges"), Domain.EDGE, Kind.BOOLEAN, "use_freestyle_mark"),
    MarkRow("crease_edge", message("creases"), Domain.EDGE, Kind.MARK),
    MarkRow("bevel_weight_edge", message("bevel weights"), Domain.EDGE, Kind.MARK),
    MarkRow("crease_vert", message("vertex creases"), Domain.POINT, Kind.MARK),
    MarkRow("bevel_weight_vert", message("vertex bevel weights"), Domain.POINT, Kind.MARK),
)
# Attributes of marks, by their names in all versions.
MARK_ATTRIBUTES = frozenset({row.attribute for row in MARKS} | {".uv_seam"})


def read_marks(mesh: Mesh) -> list[Attribute]:
    """The marks of a mesh, named by their labels."""
    found = ((row, _read(mesh, row)) for row in MARKS)
    return [Attribute(row.label, row.domain, row.kind, values) for row, values in found if values.any()]


def write_marks(mesh: Mesh, marks: Attribute) -> None:
    """Replace a mesh's marks of one label."""
    (row,) = (row for row in MARKS if row.label == marks.name)
    if _is_property(row):
        mesh.edges.foreach_set(row.element, np.ascontiguousarray(marks.values, dtype=np.bool_))
        return
    data_type, dtype = ("BOOLEAN", np.bool_) if row.kind is Kind.BOOLEAN else ("FLOAT", np.float32)
    present = mesh.attributes.get(row.attribute) or mesh.attributes.new(row.attribute, data_type, row.domain.name)
    present.data.foreach_set("value", np.ascontiguousarray(marks.values, dtype=dtype))


def _read(mesh: Mesh, row: MarkRow) -> np.ndarray:
    dtype = np.bool_ if row.kind is Kind.BOOLEAN else np.float32
    if _is_property(row):
        return read_array(mesh.edges, row.element, dtype)
    attribute = mesh.attributes.get(row.attribute)
    if attribute is None or attribute.domain != row.domain.name:
        return np.zeros(len(mesh.edges if row.domain is Domain.EDGE else mesh.vertices), dtype)
    return read_array(attribute.data, "value", dtype)


def _is_property(row: MarkRow) -> bool:
    return row.element in MeshEdge.bl_rna.properties
