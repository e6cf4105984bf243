# SPDX-License-Identifier: GPL-3.0-or-later
"""A generated character: a skeleton of edges with the Skin modifier, bones and automatic weights; and a posed copy."""

import bpy
import numpy as np
from scenes import activate, link

# Name: joint that it hangs from, place, radius. Limbs exist on both sides, the left one is +x.
JOINTS = {
    "hips": (None, (0, 0.1, 1.0), 0.22),
    "chest": ("hips", (0, -0.25, 1.35), 0.24),
    "neck": ("chest", (0, -0.5, 1.7), 0.12),
    "head": ("neck", (0, -0.65, 2.0), 0.2),
    "snout": ("head", (0, -1.05, 1.9), 0.09),
    "tail1": ("hips", (0, 0.5, 0.8), 0.14),
    "tail2": ("tail1", (0, 0.95, 0.65), 0.09),
    "tail3": ("tail2", (0, 1.45, 0.7), 0.04),
    "thigh": ("hips", (0.3, 0.05, 0.85), 0.16),
    "knee": ("thigh", (0.36, -0.05, 0.45), 0.1),
    "ankle": ("knee", (0.36, 0.05, 0.1), 0.08),
    "toes": ("ankle", (0.38, -0.3, 0.05), 0.06),
    "shoulder": ("chest", (0.3, -0.35, 1.4), 0.11),
    "elbow": ("shoulder", (0.62, -0.35, 1.2), 0.07),
    "wrist": ("elbow", (0.9, -0.5, 1.1), 0.055),
    "finger": ("wrist", (1.08, -0.62, 1.06), 0.035),
}
SIDED = ("thigh", "knee", "ankle", "toes", "shoulder", "elbow", "wrist", "finger")
# Radians about the axes of each bone, by the joint at its end.
POSE = {
    "neck": (0.4, 0, 0.5),
    "tail2": (0.9, 0, 0.3),
    "knee.L": (0.9, 0, 0),
    "knee.R": (-0.5, 0, 0),
    "ankle.R": (0.8, 0, 0),
    "elbow.L": (0.3, 0.2, 1.0),
    "elbow.R": (-0.9, 0, 0.2),
    "wrist.R": (-0.9, 0, 0),
}


def character(levels=3):
    """The character in its rest pose, and its armature.

    It has 14,000 vertices, a quarter of that for each level less, a vertex group for every bone, a UV map of several
    islands, and an attribute `rest`.
    """
    mesh = bpy.data.meshes.new("Character")
    joints = _sided_joints()
    names = list(joints)
    edges = [(names.index(parent), names.index(name)) for name, (parent, _, _) in joints.items() if parent]
    mesh.from_pydata([place for _, place, _ in joints.values()], edges, [])
    obj = link("Character", mesh)
    activate(obj)
    obj.modifiers.new("Skin", "SKIN")
    for vertex, (_, _, radius) in zip(mesh.skin_vertices[0].data, joints.values(), strict=True):
        vertex.radius = (radius, radius)
    obj.modifiers.new("Subdivision", "SUBSURF").levels = levels
    for modifier in ("Skin", "Subdivision"):
        bpy.ops.object.modifier_apply(modifier=modifier)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project()
    bpy.ops.object.mode_set(mode="OBJECT")
    _remember_rest_positions(mesh)
    return obj, _rig(obj, joints)


def pose_copy(obj, armature, voxel_size=0.045):
    """A mesh of the posed character with another topology, and its posed original."""
    for name, angles in POSE.items():
        bone = armature.pose.bones[name]
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = angles
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    posed = link("Posed", bpy.data.meshes.new_from_object(evaluated))
    remeshed = link("Target", posed.data.copy())
    remeshed.data.remesh_voxel_size = voxel_size
    activate(remeshed)
    bpy.ops.object.voxel_remesh()
    remeshed.data = _bare(remeshed.data)  # remeshing carries attributes over
    for bone in armature.pose.bones:
        bone.rotation_euler = (0, 0, 0)
    bpy.context.view_layer.update()
    return remeshed, posed


def _bare(mesh):
    """A mesh of the same shape without data."""
    bare = bpy.data.meshes.new("Target")
    bare.from_pydata([vertex.co for vertex in mesh.vertices], [], [list(polygon.vertices) for polygon in mesh.polygons])
    return bare


def _sided_joints():
    joints = {name: row for name, row in JOINTS.items() if name not in SIDED}
    for side, sign in ((".L", 1), (".R", -1)):
        for name in SIDED:
            parent, (x, y, z), radius = JOINTS[name]
            joints[name + side] = (parent + side if parent in SIDED else parent, (sign * x, y, z), radius)
    return joints


def _remember_rest_positions(mesh):
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    mesh.attributes.new("rest", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", points)


def _rig(obj, joints):
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(armature)
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    for name, (parent, place, _) in joints.items():
        if parent is None:
            continue
        bone = bones.new(name)
        bone.head, bone.tail = joints[parent][1], place
        bone.parent = bones.get(parent)
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(armature, obj)
    bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    return armature
