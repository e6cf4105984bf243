# SPDX-License-Identifier: GPL-3.0-or-later
"""Text as triangles, in Blender's own font, which needs neither a window nor a graphics card."""

from __future__ import annotations

import bpy
import numpy as np

from zoomout_core.arrays import Floats, Integers

from ..arrays import read_array
from ..surfaces.surfaces import read_positions


def text_triangles(text: str) -> tuple[Floats, Integers]:
    """Vertices (n, 2) and triangles (m, 3) of a line of text, from its left end on the base line; a line is 1 high."""
    curve = bpy.data.curves.new("Text", "FONT")
    curve.body = text
    obj = bpy.data.objects.new("Text", curve)
    try:
        mesh = obj.to_mesh()
        mesh.calc_loop_triangles()
        triangles = read_array(mesh.loop_triangles, "vertices", np.int32, 3)
        return read_positions(mesh)[:, :2].astype(np.float64), triangles.astype(np.int64)
    finally:
        obj.to_mesh_clear()
        bpy.data.objects.remove(obj)
        bpy.data.curves.remove(curve)
