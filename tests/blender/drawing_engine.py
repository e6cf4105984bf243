# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw coats into a buffer in a render engine, which has a GPU even without a window; print the pixels as JSON.

It runs in a child process, because Blender ends the process if there is no GPU driver, not even a software one.
"""

import json

import bpy
import gpu
import numpy as np
from mathutils import Matrix, Vector

from blender_addon.viewport import overlay

SIZE = 32
SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]


def pixels(one):
    """(SIZE, SIZE, 4) the square under a coat, which fills the buffer, seen from above."""
    mesh = bpy.data.meshes.new("Square")
    mesh.from_pydata(SQUARE, [], [(0, 1, 2, 3)])
    batch, buffer = overlay._batch(overlay.surface_of(mesh, one)), gpu.types.GPUOffScreen(SIZE, SIZE)
    with buffer.bind(), gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
        gpu.matrix.load_matrix(Matrix.Identity(4))
        gpu.matrix.load_projection_matrix(Matrix.Identity(4))
        gpu.state.active_framebuffer_get().clear(color=(0, 0, 0, 0), depth=1)
        overlay._draw_batch(batch, one, Vector((0, 0, 1)))
        drawn = gpu.state.active_framebuffer_get().read_color(0, 0, SIZE, SIZE, 4, 0, "FLOAT")
    buffer.free()
    return np.array(drawn.to_list()).reshape(SIZE, SIZE, 4).tolist()


class DrawingEngine(bpy.types.RenderEngine):
    """A render engine that draws coats."""

    bl_idname = "DRAWING"
    bl_label = "Drawing"
    bl_use_gpu_context = True

    def render(self, depsgraph):
        colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float)
        overlays = {
            "colors": overlay.Overlay(1, colors, ""),
            "letters": overlay.Overlay(1, (np.array(SQUARE)[:, :2] + 1) / 32, ""),
            "arrow": overlay.Overlay(1, (np.array(SQUARE)[:, :2] + 1) / 32 + [1 / 16, 0], ""),
            "checker": overlay.Overlay(1, np.array(SQUARE)[:, :2] / 2, ""),
        }
        print("DRAWN", json.dumps({name: pixels(one) for name, one in overlays.items()}))


if __name__ == "__main__":
    bpy.utils.register_class(DrawingEngine)
    bpy.context.scene.render.engine = DrawingEngine.bl_idname
    bpy.ops.render.render()
