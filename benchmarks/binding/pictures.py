# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of bound targets, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Euler

from benchmarks.binding.cases import positions

# Size of an object's square in pixels, and its width relative to the largest object's diagonal.
SQUARE, MARGIN = 480, 0.8
# The camera looks from the front and a little from above and the side, in radians about the axes.
VIEW = (1.35, 0.0, 0.35)
SUN, SKY, SAMPLES = (0.7, 0.2, 0.9), (0.5, 0.5, 0.5), 8


def draw(file: Path, objects: Sequence[Object]) -> None:
    """Draw objects side by side, as they are evaluated now.

    Args:
        file: image to write.
        objects: from left to right; they may overlap in space.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    shapes = [positions(obj) for obj in objects]
    size = MARGIN * max(float(np.linalg.norm(np.ptp(shape, axis=0))) for shape in shapes)
    turn = Euler(VIEW).to_matrix()
    right = np.array(turn.col[0])
    scene = bpy.data.scenes.new("Picture")
    try:
        for number, (obj, shape) in enumerate(zip(objects, shapes, strict=True)):
            mesh = bpy.data.meshes.new("Shown")
            middle = (shape.max(axis=0) + shape.min(axis=0)) / 2
            faces = [list(polygon.vertices) for polygon in obj.data.polygons]
            mesh.from_pydata(shape - middle + number * size * right, [], faces)
            for material in obj.data.materials:
                mesh.materials.append(material)
            mesh.polygons.foreach_set("material_index", [polygon.material_index for polygon in obj.data.polygons])
            mesh.shade_smooth()
            scene.collection.objects.link(bpy.data.objects.new("Shown", mesh))
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        camera.data.type, camera.data.ortho_scale = "ORTHO", size * len(objects)
        camera.data.clip_end = 10 * size * len(objects)
        camera.rotation_euler = VIEW
        camera.location = (len(objects) - 1) / 2 * size * right + np.array(turn.col[2]) * 3 * size
        scene.camera = camera
        sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
        sun.data.energy, sun.rotation_euler = 2, SUN
        scene.collection.objects.link(sun)
        scene.world = bpy.data.worlds.new("Sky")
        scene.world.color = SKY
        scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", SAMPLES
        scene.cycles.use_denoising = True
        scene.view_settings.view_transform = "Standard"
        scene.render.resolution_x, scene.render.resolution_y = SQUARE * len(objects), SQUARE
        scene.render.filepath = str(file.resolve())
        bpy.ops.render.render(write_still=True, scene=scene.name)
    finally:
        for obj in list(scene.collection.objects):
            bpy.data.objects.remove(obj)
        bpy.data.scenes.remove(scene)
