# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals at corners that face away from their faces, which are shaded almost black."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Booleans, Floats, segment_sum
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, unit_vectors

# Smallest cosine between the normal at a corner and that of its face; lower ones are shaded almost black.
MIN_FACING = 0.25


def faces_away(normals: Floats, surface: Surface) -> Booleans:
    """(n,) the vertices of a surface with a normal, of those at corners (c, 3), that faces away from its triangle."""
    flat = unit_vectors(area_normals(surface.vertices, surface.triangles))
    off = np.einsum("mcx,mx->mc", normals[surface.triangle_corners], flat) < MIN_FACING
    away = np.zeros(len(surface.vertices), dtype=bool)
    away[surface.triangles[off]] = True
    return away


def turn_to_faces(normals: Floats, surface: Surface, meant: Booleans) -> Floats:
    """Normals at corners (c, 3), with the face's own where they face away from it, but at vertices meant so (n,)."""
    flat = segment_sum(
        area_normals(surface.vertices, surface.triangles), surface.triangle_face, len(surface.face_start) - 1
    )
    facing = unit_vectors(flat)[surface.corner_face]
    away = np.einsum("cx,cx->c", normals, facing) < MIN_FACING
    away &= ~meant[surface.corner_vertex] & facing.any(axis=1)  # faces without area have no normal
    return np.where(away[:, None], facing, normals)
