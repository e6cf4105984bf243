# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigs as artists meet them: one that Rigify generates, posed by its controls, and one as Mixamo's files leave it."""

from math import radians

import addon_utils
import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix
from rigged import BONES, OTHER, pose_target, set_pose, source_and_rig, visible_positions
from scenes import activate, ellipsoid, from_pydata, positions

from blender_addon import api, mesh_data
from blender_addon.demo.target import posed_copy
from zoomout_core.geometry.closest_points import closest_points

MIXAMO = ("mixamorig:Hips", "mixamorig:Spine", "mixamorig:Spine1")
# Of a body around the bones of a basic human, in metres.
THICK = 0.07


def share_off(source, target):
    """(n,) distances of a target's vertices from the source's surface, as both are seen, over the source's height."""
    surface = mesh_data.read_source_surface(source, bpy.context.evaluated_depsgraph_get())
    places, points = visible_positions(source), visible_positions(target)
    triangle, barycentric = closest_points(points, places, surface.triangles)
    nearest = np.einsum("nc,ncx->nx", barycentric, places[surface.triangles[triangle]])
    return np.linalg.norm(points - nearest, axis=1) / np.ptp(places, axis=0).max()


def test_a_rig_in_centimetres_whose_bones_have_a_prefix_poses_the_target():
    place = Matrix.LocRotScale((0, 0, 0), Euler((radians(90), 0, 0)), (0.01, 0.01, 0.01))
    source, armature = source_and_rig(None, place)
    target, _ = pose_target(source, armature)
    for bone, name in zip(BONES, MIXAMO, strict=True):
        armature.data.bones[bone].name = name  # and the source's groups with it
    report = api.bind_to_rig(bpy.context, source, target)
    assert report["written"]["vertex_groups"] == list(MIXAMO)
    np.testing.assert_allclose(target.matrix_world.to_scale(), (0.01, 0.01, 0.01), rtol=1e-5)
    for turn in ({}, dict(zip(MIXAMO, OTHER.values(), strict=True))):
        set_pose(armature, turn)
        assert np.median(share_off(source, target)) < 2e-3
        assert share_off(source, target).max() < 0.04


@pytest.fixture
def rigify_rig():
    """The rig that Rigify generates from its basic human, and the bones that it was generated from."""
    assert addon_utils.enable("rigify", default_set=True) is not None
    bpy.ops.object.armature_basic_human_metarig_add()
    plan = bpy.context.object
    bpy.ops.pose.rigify_generate()
    yield bpy.data.objects["rig"], plan.data.bones
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_utils.disable("rigify", default_set=True)


def body_around(bones):
    """A body of balls along bones, and along what joins each to its parent, as one skin."""
    ball = ellipsoid("Ball", 1, (THICK, THICK, THICK)).data
    vertices, faces = positions(ball), np.array([polygon.vertices[:] for polygon in ball.polygons])
    places = []
    for bone in bones:
        if not bone.name.startswith(("pelvis", "breast")):
            ends = (bone.parent.head_local, bone.parent.tail_local) if bone.parent else (bone.head_local,)
            joint = min(ends, key=lambda end: (end - bone.head_local).length)
            for begin, end in ((joint, bone.head_local), (bone.head_local, bone.tail_local)):
                places += [begin.lerp(end, share) for share in np.linspace(0, 1, 8)]
    balls = (np.array(places)[:, None] + vertices).reshape(-1, 3)
    skins = (np.arange(len(places))[:, None, None] * len(vertices) + faces).reshape(-1, 3)
    source = from_pydata("Source", balls.tolist(), skins.tolist())
    source.modifiers.new("Remesh", "REMESH").voxel_size = THICK / 2
    body = posed_copy(source)
    bpy.data.meshes.remove(source.data)
    body.name = "Source"
    return body


@pytest.mark.slow
def test_a_rig_of_rigify_poses_the_target_by_its_controls(rigify_rig):
    rig, plan = rigify_rig
    source = body_around(plan)
    activate(rig, source)
    bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    controls = rig.pose.bones

    def move(**by):
        for control, offset in by.items():
            bone = controls[f"{control[:-2]}.{control[-1]}"]
            bone.matrix = Matrix.Translation(offset) @ bone.matrix if any(offset) else bone.bone.matrix_local
        bpy.context.view_layer.update()

    move(hand_ik_L=(0.0, -0.3, 0.3), foot_ik_R=(0.0, -0.3, 0.2))
    target = posed_copy(source)
    target.name, target.location = "Target", (1, 0, 0)
    move(hand_ik_L=(0, 0, 0), foot_ik_R=(0, 0, 0))
    api.match_objects(bpy.context, source, target, initial="same_order")
    report = api.bind_to_rig(bpy.context, source, target)
    assert report["bound"] == {"armature": "rig", "shape": "rest_pose"}
    assert np.median(share_off(source, target)) < 2e-3
    move(hand_ik_R=(0.0, -0.3, 0.1), foot_ik_L=(0.0, 0.2, 0.2))
    assert np.ptp(visible_positions(source)[:, 1]) > 0.5  # it has moved
    assert np.median(share_off(source, target)) < 2e-3
