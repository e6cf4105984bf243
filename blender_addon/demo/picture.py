# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's scene and its picture: the source, our target and Data Transfer's, once for each kind of data."""

from __future__ import annotations

from colorsys import hsv_to_rgb
from math import radians
from pathlib import Path
from typing import Any

import bmesh
import bpy
import numpy as np
from mathutils import Vector

from zoomout_core.arrays import Floats
from zoomout_core.transfer import Attribute, Domain, Kind

from .. import mesh_data
from .character import BONES, PAINT
from .target import bind

WEIGHT_COLORS = "Weights"
# Distances between the figures, and their angle to the viewer in degrees, which shows a side.
ACROSS, DOWN, TURN = 1.95, 1.98, 14
# Hues of the bones on the left, on the right and in between: first hue and range.
HUES = {".L": (0.97, 0.20), ".R": (0.50, 0.26), "": (0.22, 0.20)}
INK = (0.035, 0.04, 0.05)
FAINT = (0.22, 0.23, 0.25)


def arrange(
    character: bpy.types.Object,
    armature: bpy.types.Object,
    target: bpy.types.Object,
    baseline: bpy.types.Object,
    report: dict[str, Any],
) -> None:
    """Set up the scene: a column for each object, a row for each kind of data.

    Args:
        character: the source.
        armature: its armature.
        target: the object with our transfer.
        baseline: the object with Data Transfer's.
        report: the report that `run` returns, for the captions.
    """
    columns = [
        (character, armature, "Source", f"{report['vertices']['source']:,} vertices"),
        (target, bind(target, armature), "ZoomOut", f"another pose, {report['vertices']['target']:,} vertices"),
        (baseline, bind(baseline, armature), "Blender’s Data Transfer", "the same target, nearest surface"),
    ]
    rows = [
        ("Paint", "color", _attribute_material(PAINT)),
        ("UV map", "uv", checker_material()),
        ("Skin weights", "weights", _attribute_material(WEIGHT_COLORS)),
    ]
    podium = podium_mesh()
    for column, (figure, rig, title, subtitle) in enumerate(columns):
        x = (column - 1) * ACROSS
        sole = mesh_data.read_positions(figure.data)[:, 2].min()
        color_weights(figure)
        figure.data.materials.clear()
        figure.data.materials.append(rows[0][2])
        write(title, (x, 0, 1.98), 0.17, INK)
        write(subtitle, (x, 0, 1.82), 0.085, FAINT)
        for row, (_, kind, material) in enumerate(rows):
            place = Vector((x, 0, -row * DOWN))
            standing = place - Vector((0, 0, sole))
            if row == 0:
                rig.location, rig.rotation_euler = standing, (0, 0, radians(TURN))
                rig.data.display_type = "STICK"
            else:
                _duplicate(figure, material, standing)
            link("Podium", podium, place)
            if column:
                verdict = _verdict(report, kind, ours=column == 1)
                write(verdict, place + Vector((0, -0.6, -0.19)), 0.085, FAINT)
    for row, (name, _, _) in enumerate(rows):
        label = write(name, (-1.5 * ACROSS - 0.12, 0, 0.85 - row * DOWN), 0.13, INK)
        label.rotation_euler.rotate_axis("Z", radians(90))
    light()
    _aim_camera(len(columns), len(rows))


def render(path: Path, width: int, samples: int) -> None:
    """Render the scene to a PNG file.

    Args:
        path: path of the file.
        width: width in pixels; the height follows from the arrangement.
        samples: light paths per pixel.
    """
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = True
    scene.cycles.adaptive_threshold = 0.03
    scene.cycles.max_bounces = 2
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_percentage = round(100 * width / scene.render.resolution_x)
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.compression = 90
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def _verdict(report: dict[str, Any], kind: str, ours: bool) -> str:
    whose = "zoomout" if ours else "data_transfer"
    error = report["errors"][kind]
    better = f", {error['times_better_on_average']:.1f} times less" if ours else ""
    bare = "; black: no weights" if kind == "weights" and report["unweighted_vertices"][whose] else ""
    return f"mean error {error[whose]['mean']:.3f}{better}{bare}"


# --- figures ------------------------------------------------------------------------------------------------


def link(name: str, data: bpy.types.ID, place: Vector) -> bpy.types.Object:
    obj = bpy.data.objects.new(name, data)
    obj.location = place
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _duplicate(figure: bpy.types.Object, material: bpy.types.Material, place: Vector) -> None:
    """Add another object of the same mesh, in another material."""
    copy = link(f"{figure.name} {material.name}", figure.data, place)
    copy.rotation_euler = (0, 0, radians(TURN))
    copy.material_slots[0].link = "OBJECT"
    copy.material_slots[0].material = material


def podium_mesh() -> bpy.types.Mesh:
    shape = bmesh.new()
    bmesh.ops.create_cone(shape, cap_ends=True, segments=128, radius1=0.62, radius2=0.6, depth=0.06)
    bmesh.ops.translate(shape, verts=shape.verts, vec=(0, -0.02, -0.035))
    mesh = bpy.data.meshes.new("Podium")
    shape.to_mesh(mesh)
    shape.free()
    material, shader = _material("Podium")
    shader.inputs["Base Color"].default_value = (0.62, 0.64, 0.67, 1)
    mesh.materials.append(material)
    return mesh


def color_weights(figure: bpy.types.Object) -> None:
    """Add a colour attribute that shows all weights: a colour for each bone, warm on the left; black for no weight."""
    weights = mesh_data.read_weights(figure, figure.data)
    palette = _bone_colors()
    color = np.clip(weights.values @ np.array([palette[name] for name in weights.labels]), 0, 1)
    values = np.column_stack([color, np.ones(len(color))])
    attribute = Attribute(WEIGHT_COLORS, Domain.POINT, Kind.COLOR, values)
    mesh_data.write_layer(figure.data, mesh_data.Layer(attribute, mesh_data.Role.COLOR, "FLOAT_COLOR"))


def _bone_colors() -> dict[str, Floats]:
    """A scene-linear colour for each bone; neighbours along a limb differ in hue and in lightness."""
    colors = {}
    for suffix, (first, reach) in HUES.items():
        names = [row.name for row in BONES if row.name[-2:] == suffix or (not suffix and "." not in row.name)]
        for i, name in enumerate(names):
            hue = (first + reach * (i * 0.382 % 1)) % 1
            colors[name] = np.array(hsv_to_rgb(hue, (0.75, 0.5)[i % 2], (0.95, 0.75)[i // 2 % 2])) ** 2.2
    return colors


# --- materials ----------------------------------------------------------------------------------------------


def _material(name: str) -> tuple[bpy.types.Material, bpy.types.ShaderNode]:
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # before Blender 5.0, nodes are off by default
        material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = 0.55
    return material, shader


def _attribute_material(attribute: str) -> bpy.types.Material:
    material, shader = _material(attribute)
    node = material.node_tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = attribute
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return material


def checker_material() -> bpy.types.Material:
    """Blender's own colour grid: letters and numbers identify places in the atlas and mirrored islands."""
    image = bpy.data.images.new("Color Grid", 1536, 1536)
    image.generated_type = "COLOR_GRID"
    material, shader = _material("UV")
    texture, lighten = (material.node_tree.nodes.new(f"ShaderNode{name}") for name in ("TexImage", "Gamma"))
    texture.image = image
    lighten.inputs["Gamma"].default_value = 0.6
    material.node_tree.links.new(texture.outputs["Color"], lighten.inputs["Color"])
    material.node_tree.links.new(lighten.outputs["Color"], shader.inputs["Base Color"])
    return material


# --- around them --------------------------------------------------------------------------------------------


def write(text: str, place: Any, size: float, color: tuple[float, float, float]) -> bpy.types.Object:
    """Add a line of text, centred at a place and facing the camera."""
    curve = bpy.data.curves.new("Label", "FONT")
    curve.body, curve.size = text, size
    curve.align_x = "CENTER"
    curve.materials.append(ink(color))
    label = link("Label", curve, Vector(place))
    label.rotation_euler = (radians(90), 0, 0)
    return label


def ink(color: tuple[float, float, float]) -> bpy.types.Material:
    name = f"Ink {color}"
    if name not in bpy.data.materials:
        _, shader = _material(name)
        shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
        shader.inputs["Emission Color"].default_value = (*color, 1)
        shader.inputs["Emission Strength"].default_value = 1
        shader.inputs["Specular IOR Level"].default_value = 0
    return bpy.data.materials[name]


def light() -> None:
    for name, towards, strength, softness in (
        ("Key", (0.7, 1.0, -1.1), 2.6, 12),
        ("Fill", (-1.0, 0.9, -0.3), 0.7, 40),
    ):
        sun = bpy.data.lights.new(name, "SUN")
        sun.energy, sun.angle = strength, radians(softness)
        lamp = link(name, sun, Vector((0, -4, 3)))
        lamp.rotation_euler = Vector(towards).to_track_quat("-Z", "Y").to_euler()
    world = bpy.data.worlds.new("World")
    if world.node_tree is None:
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.80, 0.84, 0.90, 1)
    background.inputs["Strength"].default_value = 0.75
    bpy.context.scene.world = world


def _aim_camera(columns: int, rows: int) -> None:
    """Add an orthographic camera that shows the whole arrangement from the front and slightly above."""
    scene = bpy.context.scene
    width, height = columns * ACROSS + 0.4, rows * DOWN + 0.56
    scene.render.resolution_x, scene.render.resolution_y = 1600, round(1600 * height / width)
    lens = bpy.data.cameras.new("Camera")
    lens.type, lens.ortho_scale = "ORTHO", max(width, height)
    camera = link("Camera", lens, Vector((-0.17, -12, 0)))
    tilt = radians(7)
    camera.location.z = 2.22 - height / 2 + 12 * np.tan(tilt)
    camera.rotation_euler = (radians(90) - tilt, 0, 0)
    scene.camera = camera
