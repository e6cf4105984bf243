# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's target: the character in another pose, as another mesh, without its data."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians

import bpy
from mathutils import Matrix

from .character import select_only

# Rotations in degrees about x, y and z (left, back, up), in this order, relative to the parent bone.
POSE: dict[str, tuple[float, float, float]] = {
    "hips": (6, -12, -16),
    "spine": (6, -10, -10),
    "chest": (6, -8, -10),
    "neck": (-6, 4, 8),
    "head": (-6, 12, 22),
    "ear.L": (0, 10, 0),
    "ear.R": (-10, -14, 0),
    "shoulder.L": (0, -12, 0),
    "upper_arm.L": (0, -12, 22),
    "forearm.L": (0, -30, 12),
    "hand.L": (0, 8, 0),
    "index.L": (0, -10, 0),
    "ring.L": (0, 10, 0),
    "upper_arm.R": (0, -18, 10),
    "forearm.R": (0, 30, 30),
    "hand.R": (0, 10, 0),
    "thigh.L": (-50, -16, 10),
    "shin.L": (62, 0, 0),
    "foot.L": (-12, 0, 0),
    "thigh.R": (-12, 11, 12),
    "shin.R": (16, 0, 0),
    "foot.R": (-10, 2, 0),
    "tail_1": (0, 0, -20),
    "tail_2": (8, 0, -28),
    "tail_3": (10, 0, -28),
    "tail_4": (6, 0, -24),
    "tail_5": (0, 0, -20),
}


def set_pose(armature: bpy.types.Object, pose: Mapping[str, tuple[float, float, float]] = POSE) -> None:
    """Pose the armature, by a table such as `POSE`."""
    for name, degrees in pose.items():
        bone = armature.pose.bones[name]
        turn = Matrix.Identity(3)
        for axis, angle in zip("XYZ", degrees, strict=True):
            turn = Matrix.Rotation(radians(angle), 3, axis) @ turn
        rest = bone.bone.matrix_local.to_3x3()
        bone.rotation_quaternion = (rest.inverted() @ turn @ rest).to_quaternion()
    bpy.context.view_layer.update()


def clear_pose(armature: bpy.types.Object) -> None:
    """Return the armature to its rest pose."""
    for bone in armature.pose.bones:
        bone.rotation_quaternion = (1, 0, 0, 0)
    bpy.context.view_layer.update()


def posed_copy(character: bpy.types.Object) -> bpy.types.Object:
    """A copy of the character as its armature deforms it now."""
    return _evaluated_copy(character, "Posed")


def remeshed(posed: bpy.types.Object, voxel: float, vertices: int) -> bpy.types.Object:
    """The same surface as another mesh: rebuilt from voxels, then decimated.

    Args:
        posed: the object to rebuild; it is not changed.
        voxel: size of the voxels, in metres.
        vertices: approximate number of vertices to keep.
    """
    dense = rebuilt(posed, voxel)
    decimate = dense.modifiers.new("Decimate", "DECIMATE")
    decimate.ratio = vertices / len(dense.data.vertices)
    target = _evaluated_copy(dense, "Target")
    bpy.data.meshes.remove(dense.data)
    target.vertex_groups.clear()
    target.data.shade_smooth()
    return target


def rebuilt(posed: bpy.types.Object, voxel: float) -> bpy.types.Object:
    """The same surface rebuilt from voxels of a size in metres, without anything inside."""
    remesh = posed.modifiers.new("Remesh", "REMESH")
    remesh.mode, remesh.voxel_size = "VOXEL", voxel
    dense = _evaluated_copy(posed, "Dense")
    posed.modifiers.remove(remesh)
    return dense


def bind(target: bpy.types.Object, armature: bpy.types.Object) -> bpy.types.Object:
    """Give the target its own armature, a copy whose rest pose is the target's pose."""
    rig = armature.copy()
    rig.data = armature.data.copy()
    rig.name = f"{target.name} Armature"
    bpy.context.scene.collection.objects.link(rig)
    set_pose(rig)
    select_only(rig)
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.pose.armature_apply()
    bpy.ops.object.mode_set(mode="OBJECT")
    target.parent = rig
    target.modifiers.new("Armature", "ARMATURE").object = rig
    return rig


def _evaluated_copy(source: bpy.types.Object, name: str) -> bpy.types.Object:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = bpy.data.meshes.new_from_object(source.evaluated_get(depsgraph))
    mesh.name = name
    copy = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(copy)
    return copy
