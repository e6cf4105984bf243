# SPDX-License-Identifier: GPL-3.0-or-later
"""Custom normals of face corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bpy.types import Mesh, Object

from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.transfer import Attribute, Domain, Kind

from ..arrays import read_array

CUSTOM_NORMAL = "custom_normal"
# The type of encoded custom normals; since Blender 4.5 they may also be stored as plain vectors.
ENCODED = "INT16_2D"


def read_normals(obj: Object, mesh: Mesh) -> Attribute:
    """The corner normals of a mesh in world space, as displayed."""
    own = read_own_normals(mesh)
    # Normals transform by the inverse transpose; on mirrored objects they point outwards as well.
    normals = unit_vectors(own.values @ np.linalg.inv(np.array(obj.matrix_world)[:3, :3]))
    return replace(own, values=normals)


def read_own_normals(mesh: Mesh) -> Attribute:
    """The corner normals of a mesh in its own space."""
    normals = read_array(mesh.corner_normals, "vector", np.float32, 3).astype(np.float64)
    return Attribute(CUSTOM_NORMAL, Domain.CORNER, Kind.NORMAL, normals)


def write_custom_normals(mesh: Mesh, normals: Attribute) -> None:
    """Write corner normals, in the mesh's own space; Blender marks edges as sharp where these differ."""
    present = mesh.attributes.get(CUSTOM_NORMAL)
    if present is not None and present.data_type != ENCODED:
        mesh.attributes.remove(present)  # Blender would write to another attribute, and display this one
    mesh.normals_split_custom_set(normals.values.astype(np.float32))
