# SPDX-License-Identifier: GPL-3.0-or-later
"""Strands of hair: converting curves objects to points and lines and back, and attaching them to a surface."""

from __future__ import annotations

import numpy as np
from bpy.types import Curves, Depsgraph, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points

from ..arrays import read_array
from ..surfaces.surfaces import check_evaluated, positions_in_world

# The attribute of curves with the place of each first point on their surface's UV map.
ROOT_UV = "surface_uv_coordinate"


def read_strands(obj: Object, depsgraph: Depsgraph | None = None) -> zo.Lines:
    """The strands of a curves object in world space, after its modifiers if these keep the points.

    Args:
        obj: a curves object.
        depsgraph: Blender's; None for strands without modifiers.

    Raises:
        MeshError: there are no strands, or the object is not evaluated.
    """
    points = _positions(obj.data)
    if depsgraph is not None:
        seen = check_evaluated(obj, depsgraph).data
        points = _positions(seen) if len(seen.points) == len(obj.data.points) else points
    if not len(points):
        raise zo.MeshError("'{name}' has no strands: leave it out.", name=obj.name)
    return zo.Lines(positions_in_world(obj, points), _edges(_first_points(obj.data)))


def write_strands(curves: Curves, positions: Floats) -> None:
    """Move the points of curves to positions (n, 3), in their own space."""
    curves.position_data.foreach_set("vector", np.ascontiguousarray(positions, np.float32).ravel())
    curves.update_tag()


def attach_strands(obj: Object, surface: Object, shape: zo.Surface, strands: Floats) -> None:
    """Make a mesh the surface of curves, and attach each curve by its first point.

    Args:
        obj: the curves object.
        surface: the mesh object; the curves use its UV map of the same name, else its active one.
        shape: its surface, with the corners of its mesh.
        strands: (n, 3) points of the curves, in the space of `shape`.
    """
    curves, layers = obj.data, surface.data.uv_layers
    curves.surface = surface
    layer = layers.get(curves.surface_uv_map) or layers.active
    if layer is None:
        return
    curves.surface_uv_map = layer.name
    first = _first_points(curves)[:-1]
    triangle, weights = closest_points(strands[first], shape.vertices, shape.triangles)
    uv = read_array(layer.uv, "vector", np.float32, 2)[shape.triangle_corners[triangle]]
    values = np.einsum("sc,scx->sx", weights, uv)
    attribute = curves.attributes.get(ROOT_UV) or curves.attributes.new(ROOT_UV, "FLOAT2", "CURVE")
    attribute.data.foreach_set("vector", np.ascontiguousarray(values, np.float32).ravel())


def _positions(curves: Curves) -> np.ndarray:
    return read_array(curves.position_data, "vector", np.float32, 3)


def _first_points(curves: Curves) -> Integers:
    """(s + 1,) the first point of each strand, then the number of points."""
    return read_array(curves.curve_offset_data, "value", np.int32).astype(np.int64)


def _edges(first: Integers) -> Integers:
    """(e, 2) pairs of consecutive points on a strand."""
    points = np.arange(first[-1] - 1)
    inside = np.ones(len(points), dtype=bool)
    inside[first[1:-1] - 1] = False
    return np.stack([points[inside], points[inside] + 1], axis=1)
