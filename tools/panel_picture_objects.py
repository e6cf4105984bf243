# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects in the pictures of panels: the character, its scan, garments, and changes to them."""

import bmesh
import bpy
import numpy as np
from bpy.types import Object
from mathutils import Vector

from blender_addon.demo.character import build_character, select_only
from blender_addon.demo.target import clear_pose, posed_copy, remeshed, set_pose
from blender_addon.mesh_data import nearest_surface_point
from blender_addon.scene.landmarks import set_landmark

# Resolution of the character in metres, and of its scan in vertices.
EDGE, VERTICES = 0.024, 6000
# Landmarks: their bones and names. The last is on one side only.
LANDMARKS = {
    "hand.L": "Left hand",
    "ear.R": "Right ear",
    "foot.L": "Left foot",
    "ear.L": "Left ear",
    "hand.R": "Right hand",
}


def pair(with_landmarks: bool = False, with_rig: bool = False) -> tuple[Object, Object]:
    """The character, and next to it a posed scan of it with another topology and without data.

    Args:
        with_landmarks: whether both have landmarks.
        with_rig: whether the character stays bound to its armature.
    """
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    hero, armature = build_character(EDGE)
    before = tips(armature)
    set_pose(armature)
    posed, after = posed_copy(hero), tips(armature)
    scan = remeshed(posed, EDGE, VERTICES)
    bpy.data.objects.remove(posed)
    clear_pose(armature)
    hero.name, scan.name = "Hero", "Scan"
    if not with_rig:
        hero.modifiers.clear()
        hero.parent = None
        bpy.data.objects.remove(armature)
    collapse_crowded_edges(hero)
    for obj in (hero, scan):
        obj.data.shade_smooth()
    bpy.context.view_layer.update()
    if with_landmarks:
        set_landmarks(hero, before, len(LANDMARKS))
        set_landmarks(scan, after, len(LANDMARKS) - 1)
    (hero.parent or hero).location.x -= 0.8
    scan.location.x += 0.8
    bpy.context.view_layer.update()
    return hero, scan


def tips(armature: Object) -> list[Vector]:
    """Points near the ends of the bones of landmarks, in world space."""
    bones = [armature.pose.bones[name] for name in LANDMARKS]
    return [armature.matrix_world @ bone.head.lerp(bone.tail, 0.7) for bone in bones]


def set_landmarks(obj: Object, points: list[Vector], count: int) -> None:
    """Set the first landmarks of an object at its closest points to some positions."""
    depsgraph, inverse = bpy.context.evaluated_depsgraph_get(), obj.matrix_world.inverted()
    for number, (point, name) in enumerate(zip(points[:count], LANDMARKS.values(), strict=False), start=1):
        place = nearest_surface_point(obj, inverse @ point, 1, depsgraph)
        assert place is not None  # the character has faces
        set_landmark(bpy.context.scene, obj, place, number, name)


def collapse_crowded_edges(obj: Object) -> None:
    """Collapse edges with more than two faces, which the Skin modifier creates."""
    mesh = bmesh.new()
    mesh.from_mesh(obj.data)
    while crowded := [edge for edge in mesh.edges if len(edge.link_faces) > 2]:
        bmesh.ops.collapse(mesh, edges=crowded)
    mesh.to_mesh(obj.data)
    mesh.free()


def garment(body: Object, name: str, low: float, high: float, off: float) -> Object:
    """A garment from the part of a body between two heights, offset from its skin, without hands and tail."""
    worn = body.copy()
    worn.data, worn.name = body.data.copy(), name
    bpy.context.scene.collection.objects.link(worn)
    mesh = bmesh.new()
    mesh.from_mesh(worn.data)
    mesh.normal_update()
    heights = [vertex.co.z for vertex in mesh.verts]
    bottom, height = min(heights), max(heights) - min(heights)
    left = [
        vertex
        for vertex in mesh.verts
        if not low <= (vertex.co.z - bottom) / height <= high
        or abs(vertex.co.x) > 0.25 * height
        or vertex.co.y > 0.07 * height
    ]
    for vertex in mesh.verts:
        vertex.co += off * vertex.normal
    bmesh.ops.delete(mesh, geom=left, context="VERTS")
    mesh.to_mesh(worn.data)
    mesh.free()
    thick = worn.modifiers.new("Solidify", "SOLIDIFY")
    thick.thickness = 0.6 * off
    return worn


def show_color_grid(obj: Object) -> None:
    """Show one of Blender's test images on an object, by its UV map."""
    image = bpy.data.images.new("Color Grid", 1024, 1024)
    image.generated_type = "COLOR_GRID"
    material = bpy.data.materials.new("Grid")
    material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    shader = next(each for each in material.node_tree.nodes if each.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    obj.data.materials.append(material)


def unwrap(obj: Object, name: str) -> None:
    """Give an object a UV map, by *Smart UV Project*."""
    obj.data.uv_layers.new(name=name)
    select_only(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.005)
    bpy.ops.object.mode_set(mode="OBJECT")


def cut_below(obj: Object, height: float) -> None:
    """Delete the vertices of an object below a fraction of its height."""
    mesh = bmesh.new()
    mesh.from_mesh(obj.data)
    heights = [vertex.co.z for vertex in mesh.verts]
    limit = min(heights) + height * (max(heights) - min(heights))
    bmesh.ops.delete(mesh, geom=[vertex for vertex in mesh.verts if vertex.co.z < limit], context="VERTS")
    mesh.to_mesh(obj.data)
    mesh.free()


def bulge(obj: Object) -> None:
    """Sculpt on one side of an upright character: on an arm, and on the tip of an ear."""
    mesh = obj.data
    points, normals = np.empty((2, 3 * len(mesh.vertices)), np.float32)
    mesh.vertices.foreach_get("co", points)
    mesh.vertices.foreach_get("normal", normals)
    points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
    to_front = normals[:, 1] < -0.3
    middle = points[np.argmin(np.abs(points[:, 0] - 0.45 * points[:, 0].max()) + 5 * ~to_front)]
    points += 0.045 * np.exp(-((points - middle) ** 2).sum(axis=1) / 0.006)[:, None] * normals
    height, start = points[:, 2], np.percentile(points[:, 2], 96)
    ear = np.clip((height - start) / (height.max() - start), 0, 1) * (points[:, 0] < 0)
    points[:, 2] += 0.12 * ear**2
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.update()
