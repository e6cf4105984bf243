# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground truth on the target, and the errors of a transfer.

The target was made from the character's posed surface, so each vertex and corner of the target belongs to the closest
point of that surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.triangles import triangle_areas, triangle_normals, vertex_normals

from .. import mesh_data
from .character import PAINT, UV_MAP

# To stay on its side of a seam, a corner takes the place of a point this far towards the middle of its face.
INWARD = 0.01
# A face is torn if an edge is this many times as long in the atlas as at the source's scale.
TORN = 5.0


@dataclass(frozen=True, eq=False)
class Truth:
    """The correct values at each vertex and corner of the target.

    Attributes:
        surface_map: the point of the character that each vertex of the target comes from.
        known: (n,) where that is certain; in folds, surfaces that face different ways meet.
        known_corner: (c,) the same for corners.
        uv: (c, 2) coordinates in the atlas.
        group_names: the character's vertex groups.
        weights: (n, groups) skin weights.
        color: (n, 3) paint, scene-linear.
        uv_scale: length in the atlas per unit of length on the character.
    """

    surface_map: zo.SurfaceMap
    known: Booleans
    known_corner: Booleans
    uv: Floats
    group_names: tuple[str, ...]
    weights: Floats
    color: Floats
    uv_scale: float


def find_truth(character: bpy.types.Object, source: zo.Surface, posed: Floats, target: zo.Surface) -> Truth:
    """The truth for a target that was made from the posed character.

    Args:
        character: the object with the data.
        source: its surface at rest.
        posed: (n_s, 3) its vertices in the pose.
        target: the surface that was rebuilt from the posed one.
    """
    triangles = source.triangles
    surface_map = zo.SurfaceMap(*closest_points(target.vertices, posed, triangles), triangles)
    normals = vertex_normals(target.vertices, target.triangles)
    known = np.einsum("nx,nx->n", normals, triangle_normals(posed, triangles)[surface_map.triangle]) > 0

    at_corner = target.vertices[target.corner_vertex]
    middle = np.add.reduceat(at_corner, target.face_start[:-1]) / np.diff(target.face_start)[:, None]
    inner = at_corner + INWARD * (middle[target.corner_face] - at_corner)
    triangle, barycentric = closest_points(inner, posed, triangles)
    source_uv = mesh_data.read_layer(character.data, UV_MAP).attribute.values[source.triangle_corners]

    weights = mesh_data.read_weights(character, character.data)
    paint = mesh_data.read_layer(character.data, PAINT).attribute.values[:, :3]
    return Truth(
        surface_map,
        known,
        known[target.corner_vertex],
        np.einsum("qc,qcx->qx", barycentric, source_uv[triangle]),
        weights.labels,
        surface_map.interpolate(weights.values.toarray()),
        surface_map.interpolate(paint),
        _uv_scale(source, source_uv),
    )


def _uv_scale(source: zo.Surface, triangle_uv: Floats) -> float:
    flat = np.pad(triangle_uv.reshape(-1, 2), ((0, 0), (0, 1)))
    covered = triangle_areas(flat, np.arange(len(flat)).reshape(-1, 3)).sum()
    return float(np.sqrt(covered / source.area))


def uv_error(result: bpy.types.Object, truth: Truth) -> Floats:
    """Distance from the correct place in the atlas, for each corner; the atlas has a width of 1."""
    uv = mesh_data.read_layer(result.data, UV_MAP).attribute.values
    return np.linalg.norm(uv - truth.uv, axis=1)[truth.known_corner]


def weight_error(result: bpy.types.Object, truth: Truth) -> Floats:
    """Sum of the weights' absolute differences, for each vertex: 2 if all weight is on the wrong bones."""
    weights = mesh_data.read_weights(result, result.data)
    column = [truth.group_names.index(name) for name in weights.labels]
    aligned = np.zeros_like(truth.weights)
    aligned[:, column] = weights.values.toarray()
    return np.abs(aligned - truth.weights).sum(axis=1)[truth.known]


def color_error(result: bpy.types.Object, truth: Truth) -> Floats:
    """Distance between scene-linear RGB colours, for each vertex."""
    color = mesh_data.read_layer(result.data, PAINT).attribute.values[:, :3]
    return np.linalg.norm(color - truth.color, axis=1)[truth.known]


def correspondence_error(surface_map: zo.SurfaceMap, truth: Truth, source: zo.Surface) -> Floats:
    """Euclidean distance on the character at rest, over the square root of its area, for each vertex."""
    offset = surface_map.interpolate(source.vertices) - truth.surface_map.interpolate(source.vertices)
    return np.linalg.norm(offset, axis=1)[truth.known] / np.sqrt(source.area)


def torn_faces(result: bpy.types.Object, target: zo.Surface, truth: Truth) -> int:
    """Number of faces that are torn across the atlas, because their corners are in different islands."""
    uv = mesh_data.read_layer(result.data, UV_MAP).attribute.values[target.triangle_corners]
    points = target.vertices[target.triangles]
    in_atlas, in_space = (np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2) for p in (uv, points))
    torn = (in_atlas > TORN * truth.uv_scale * in_space).any(axis=1)
    return len(np.unique(target.triangle_face[torn]))


def unweighted_vertices(result: bpy.types.Object) -> int:
    """Number of vertices that no bone moves."""
    return int((mesh_data.read_weights(result, result.data).values.sum(axis=1) == 0).sum())
