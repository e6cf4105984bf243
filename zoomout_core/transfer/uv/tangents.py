# SPDX-License-Identifier: GPL-3.0-or-later
"""Tangent spaces of normal maps, by the rules of MikkTSpace, which Blender, glTF, Unity and Unreal share.

Mikkelsen, Simulation of wrinkled surfaces revisited (2008). A corner's tangent is the mean direction of growing u over
the triangles that share its vertex, UV and normal. Directions are projected to the plane of the normal, and weighted by
the triangles' angles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers, segment_sum
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.transfer.uv.chart import signed_areas

# Normals and UVs whose digits agree up to this share are those of one corner.
SAME = 1e-5


@dataclass(frozen=True, eq=False)
class TangentSpace:
    """The tangent space of each corner of m triangles."""

    tangent: Floats  # (m, 3, 3) unit tangents; zero where the UVs do not determine them
    normal: Floats  # (m, 3, 3) unit normals
    side: Floats  # (m,) 1, or -1 where the UVs are mirrored

    def at(self, triangle: Integers, barycentric: Floats) -> Floats:
        """(q, 3, 3) matrices whose columns are tangent, bitangent and normal at points (q, 3) of triangles (q,)."""
        tangent = np.einsum("qc,qcx->qx", barycentric, self.tangent[triangle])
        normal = np.einsum("qc,qcx->qx", barycentric, self.normal[triangle])
        bitangent = self.side[triangle, None] * np.cross(normal, tangent)
        return np.stack([tangent, bitangent, normal], axis=2)


def tangent_space(surface: Surface, uv: Floats, normals: Floats) -> TangentSpace:
    """The tangent space of a surface.

    Args:
        surface: the surface.
        uv: (c, 2) UVs of its corners.
        normals: (c, 3) unit normals of its corners.
    """
    points, flat = surface.vertices[surface.triangles], uv[surface.triangle_corners]
    normal = normals[surface.triangle_corners]
    area = signed_areas(flat)
    side = np.where(area < 0, -1.0, 1.0)
    (first, second), (along, across) = (np.diff(each, axis=1).transpose(1, 0, 2) for each in (points, flat))
    growing = side[:, None] * (across[:, 1, None] * first - along[:, 1, None] * second)  # the direction of growing u
    projected = unit_vectors(_in_plane(np.repeat(growing[:, None], 3, axis=1), normal).reshape(-1, 3))
    ahead, behind = (
        unit_vectors(_in_plane(np.roll(points, step, axis=1) - points, normal).reshape(-1, 3)) for step in (-1, 1)
    )
    angle = np.arccos(np.clip(np.einsum("cx,cx->c", ahead, behind), -1, 1))
    group = _groups(surface, uv, normals, side)
    sums = segment_sum(np.where(area == 0, 0, angle.reshape(-1, 3).T).T.reshape(-1, 1) * projected, group)
    return TangentSpace(unit_vectors(sums)[group].reshape(-1, 3, 3), normal, side)


def _in_plane(vectors: Floats, normals: Floats) -> Floats:
    """Vectors (..., 3) without their parts along unit normals (..., 3)."""
    return np.asarray(vectors - np.einsum("...x,...x->...", vectors, normals)[..., None] * normals)


def _groups(surface: Surface, uv: Floats, normals: Floats, side: Floats) -> Integers:
    """(3m,) for each corner of a triangle the number of those with the same vertex, UV, normal and side."""
    corner = surface.triangle_corners.ravel()
    keys = np.column_stack(
        [
            surface.triangles.ravel(),
            np.repeat(side, 3),
            np.rint(np.column_stack([uv, normals])[corner] / SAME),
        ]
    ).astype(np.int64)
    return np.asarray(np.unique(keys, axis=0, return_inverse=True)[1]).reshape(-1)
