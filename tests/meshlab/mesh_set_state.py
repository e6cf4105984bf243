# SPDX-License-Identifier: GPL-3.0-or-later
"""The observable state of a MeshSet, so that a test can assert that nothing has changed."""

from __future__ import annotations

from typing import Any

import pymeshlab

from meshlab_filter.mesh_data import COMPONENTS, custom_attributes, custom_names


def everything(ms: pymeshlab.MeshSet) -> list[Any]:
    state = [ms.mesh_number()]
    if ms.mesh_number() > 0:
        state.append(ms.current_mesh_id())
    for mesh in ms:
        state += [mesh.id(), mesh.label(), mesh.vertex_number(), mesh.face_number(), *mesh.textures()]
        if mesh.vertex_number() == 0:
            continue  # pymeshlab has no arrays of it
        state += [mesh.vertex_matrix().tobytes(), mesh.transform_matrix().tobytes()]
        state += [mesh.face_matrix().tobytes(), mesh.vertex_normal_matrix().tobytes()]
        state += [getattr(mesh, c.getter)().tobytes() for c in COMPONENTS if c.is_in(mesh)]
        if mesh.has_wedge_tex_coord():
            state.append(mesh.wedge_tex_coord_matrix().tobytes())
        for name in custom_names(ms, mesh.id()):
            state += [(a.name, a.domain, a.kind, a.values.tobytes()) for a in custom_attributes(mesh, name)]
    return state
