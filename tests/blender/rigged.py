# SPDX-License-Identifier: GPL-3.0-or-later
"""A tube bent by three bones, and copies of it in other poses: the expected results of binding."""

from functools import partial

import bpy
import numpy as np
from bent_tube import LENGTH, tube, weights_of
from mathutils import Euler, Matrix
from scenes import activate, from_pydata, link, positions, set_weights
from true_match import keep_true_match

BONES = ("Lower", "Middle", "Upper")
POSE = {"Middle": (0.7, 0.0, 0.3), "Upper": (0.2, 0.4, 0.0)}
OTHER = {"Lower": (0.1, 0.0, 0.2), "Middle": (-0.5, 0.2, 0.0), "Upper": (0.0, 0.3, -0.4)}
# Another build: longer and thinner.
BUILD = np.array([0.8, 0.8, 1.5])


def mesh_object(name, surface):
    faces = np.split(surface.corner_vertex, surface.face_start[1:-1])
    return from_pydata(name, surface.vertices.tolist(), [face.tolist() for face in faces])


def rig(name="Rig", bones=BONES):
    """An armature along the tube, linked to the scene."""
    armature = link(name, bpy.data.armatures.new(name))
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    for i, bone in enumerate(bones):
        made = armature.data.edit_bones.new(bone)
        made.head, made.tail = (0, 0, 2 * i), (0, 0, 2 * i + 2)
        made.parent = armature.data.edit_bones[bones[i - 1]] if i else None
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def source_and_rig(matrix=None, place_of_rig=None, around=20, along=61):
    """A tube with weights, bound to a rig, with any transforms."""
    armature = rig()
    surface = tube(around, along)
    source = mesh_object("Source", surface)
    for name, column in zip(BONES, weights_of(surface.vertices).toarray().T, strict=True):
        set_weights(source, name, column)
    source.parent = armature
    source.modifiers.new("Skeleton", "ARMATURE").object = armature
    armature.matrix_world = place_of_rig or Matrix()
    if matrix is not None:  # the mesh stays where it is on the rig
        bpy.context.view_layer.update()
        source.data.transform(matrix.inverted())
        source.matrix_basis = matrix
    bpy.context.view_layer.update()
    return source, armature


def set_pose(armature, pose):
    """Turn bones by Euler angles; all others are at rest."""
    for bone in armature.pose.bones:
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = pose.get(bone.name, (0, 0, 0))
    bpy.context.view_layer.update()


def visible_positions(obj):
    """(n, 3) evaluated positions of an object's vertices."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    mesh = evaluated.to_mesh()
    points = positions(mesh) @ np.array(obj.matrix_world)[:3, :3].T + np.array(obj.matrix_world.translation)
    evaluated.to_mesh_clear()
    return points


def pose_target(source, armature, pose=None, name="Target", matrix=None, around=15, along=47):
    """A mesh of another topology in a pose of the source, without data; and its vertices at rest.

    Its true match is stored.
    """
    still = tube(around, along, turned=0.4)
    twin = mesh_object("Twin", still)
    for bone, column in zip(BONES, weights_of(still.vertices).toarray().T, strict=True):
        set_weights(twin, bone, column)
    twin.parent = armature
    twin.modifiers.new("Armature", "ARMATURE").object = armature
    set_pose(armature, POSE if pose is None else pose)
    points = visible_positions(twin)
    set_pose(armature, {})
    at_rest = visible_positions(twin)
    bpy.data.meshes.remove(twin.data)
    target = mesh_object(name, still.with_vertices(points.astype(np.float64)))
    if matrix is not None:
        target.matrix_world = matrix
        target.data.transform(matrix.inverted())
    bpy.context.view_layer.update()
    keep_true_match(target, at_rest)
    return target, at_rest


# Coarser tubes bind faster; their flat faces are near enough to the round tube for all but the tightest bounds.
coarse_source_and_rig = partial(source_and_rig, around=14, along=43)
coarse_pose_target = partial(pose_target, around=11, along=33)


def truth(armature, pose, at_rest):
    """(n, 3) posed positions, in world space, of vertices at rest."""
    to_rig = np.array(armature.matrix_world.inverted())
    own = at_rest @ to_rig[:3, :3].T + to_rig[:3, 3]
    weights = weights_of(own)
    set_pose(armature, pose)
    world = armature.matrix_world
    bones = np.array(
        [world @ armature.pose.bones[n].matrix @ armature.data.bones[n].matrix_local.inverted() for n in BONES]
    )
    moved = np.einsum("nb,bxy,ny->nx", weights.toarray(), bones, np.column_stack([own, np.ones(len(own))]))
    return moved[:, :3]


def shear():
    """A matrix of a rotation, a translation and non-uniform scales."""
    return Matrix.LocRotScale((1, 2, 3), Euler((0.4, 0.2, 1.0)), (1.5, 0.7, 2.0))


__all__ = ["LENGTH"]


def other_build(place=None):
    """A tube of another build and topology, somewhere, with its true match; and its vertices in its own space."""
    still = tube(around=11, along=33, turned=0.4)
    target = mesh_object("Target", still.with_vertices(still.vertices * BUILD))
    target.matrix_world = place or Matrix()
    bpy.context.view_layer.update()
    keep_true_match(target, still.vertices)
    return target, still.vertices * BUILD


def in_target(target, points):
    """Points of the target's own space, in world space."""
    matrix = np.array(target.matrix_world)
    return points @ matrix[:3, :3].T + matrix[:3, 3]
