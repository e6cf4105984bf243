# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of the extension's page: podiums, camera, colours and wires, rendered with Workbench."""

from __future__ import annotations

from math import radians
from pathlib import Path

import bpy
import numpy as np
from bpy.types import Mesh, Object
from mathutils import Vector
from numpy.typing import ArrayLike

from blender_addon import mesh_data
from blender_addon.demo import picture
from zoomout_core.arrays import Floats
from zoomout_core.transfer import Attribute, Domain, Kind

# The animation's size in pixels, frames per second, and seconds.
SIZE, FPS, SECONDS = (1280, 720), 12, 30
# Distance of the two from the middle, their rotation, and the thickness of their wires.
ASIDE, TURN, WIRE = 1.0, radians(14), 0.0016
# Scene-linear colours of a mesh without data, wires and podiums; colours of background and captions.
CLAY, INK, PLINTH = (0.55, 0.56, 0.58), (0.02, 0.03, 0.05), (0.16, 0.17, 0.19)
BACKGROUND, TEXT = (0.055, 0.06, 0.07), (0.95, 0.95, 0.93, 1.0)
BARE, PLACES = "Bare", "Places"


def stage() -> None:
    """Add podiums and a camera, and choose Workbench."""
    scene = bpy.context.scene
    for side in (-1, 1):
        podium(side * ASIDE)
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = BACKGROUND
    scene.camera = picture.link("Camera", bpy.data.cameras.new("Camera"), Vector((0, -9, 1.35)))
    scene.camera.data.lens = 78
    look_at(Vector((0, 0, 0.68)))
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.view_settings.view_transform = "Standard"
    shading = scene.display.shading
    shading.light, shading.studio_light, shading.color_type = "STUDIO", "paint.sl", "VERTEX"
    shading.show_cavity, shading.cavity_type = True, "BOTH"
    scene.display.render_aa = "5"  # more take longer without a visible difference


def podium(x: float) -> Object:
    """Add a podium."""
    mesh = picture.podium_mesh()
    add_colors(mesh, BARE, PLINTH)
    mesh.materials[0].diffuse_color = (*PLINTH, 1)
    return picture.link("Podium", mesh, Vector((x, 0, 0)))


def look_at(point: Vector) -> None:
    camera = bpy.context.scene.camera
    camera.rotation_euler = (point - camera.location).to_track_quat("-Z", "Y").to_euler()


def show(mesh: Mesh, attribute: str) -> None:
    """Show a mesh in the colours of one of its attributes."""
    mesh.color_attributes.active_color = mesh.color_attributes[attribute]
    mesh.color_attributes.render_color_index = mesh.color_attributes.find(attribute)


def add_colors(mesh: Mesh, name: str, colors: ArrayLike) -> None:
    """Add a colour attribute of linear colours of the vertices, (n, 3) or one (3,) for all."""
    values = np.ones((len(mesh.vertices), 4))
    values[:, :3] = colors
    attribute = Attribute(name, Domain.POINT, Kind.COLOR, values)
    mesh_data.write_layer(mesh, mesh_data.Layer(attribute, mesh_data.Role.COLOR, "FLOAT_COLOR"))


def wireframe(obj: Object, thickness: float = WIRE) -> Object:
    """Dark wires along the edges of an object."""
    wire = obj.copy()
    wire.data = obj.data.copy()
    bpy.context.scene.collection.objects.link(wire)
    add_colors(wire.data, BARE, INK)
    show(wire.data, BARE)
    wire.modifiers.new("Wire", "WIREFRAME").thickness = thickness
    return wire


def draw(path: Path, size: tuple[int, int] = SIZE) -> Path:
    """Render the scene to a file, in the format of its extension."""
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = size
    render.image_settings.file_format = {".png": "PNG", ".jpg": "JPEG"}[path.suffix]
    render.image_settings.color_mode = "RGBA" if render.film_transparent else "RGB"
    render.image_settings.quality = 90
    render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return path


def render_only(objects: list[Object]) -> None:
    for obj in bpy.context.scene.objects:
        obj.hide_render = obj not in objects


def aim(position: Vector, point: Vector, width: float) -> None:
    """Aim an orthographic camera of a given width at a point."""
    camera = bpy.context.scene.camera
    camera.location = position
    camera.data.type, camera.data.ortho_scale = "ORTHO", width
    look_at(point)


def read_colors(mesh: Mesh, name: str) -> Floats:
    """The linear colours (n, 3) of the vertices in an attribute."""
    colors = np.empty(4 * len(mesh.vertices), np.float32)
    mesh.color_attributes[name].data.foreach_get("color", colors)
    return colors.reshape(-1, 4)[:, :3].astype(float)
