# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that would tear a bound target when bones move are smoothed, and what still stretches is shown."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from rigged import BONES
from rigged import coarse_pose_target as pose_target
from rigged import coarse_source_and_rig as source_and_rig
from scenes import activate, snapshot_file, weight_array
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import api, jobs, mesh_data
from blender_addon.scene.faults import stretched_vertices
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching import previews
from blender_addon.services.matching.select_faults import select_stretched
from blender_addon.storage import stored_match, stored_report
from blender_addon.viewport import preview
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.transfer.rigging import poses, stretch, weights


def bind(source, target):
    return api.bind_to_rig(bpy.context, source, target, api.Binding(shape="keep_shape"))


def wrong_at(target, at_rest, reach):
    """Store a match that maps a patch of the lowest bone to the topmost one."""
    keep_true_match(target, at_rest)
    pair = jobs.run(read_pair(bpy.context, "Source", target.name))
    kept = stored_match.read(target.data, pair)
    patch = np.linalg.norm(at_rest - [0.6, 0, 1.0], axis=1) < reach
    moved = np.where(patch[:, None], at_rest + np.array([0, 0, 4.5]), at_rest)
    found = closest_points(moved, pair.source.vertices, pair.source.triangles)
    wrong = replace(kept, surface_map=zo.SurfaceMap(*found, pair.source.triangles))
    stored_match.write(target.data, wrong, pair, {})
    return patch


def test_tearing_weights_are_smoothed_before_writing(monkeypatch):
    monkeypatch.setattr(weights, "MIN_ISLAND", np.inf)  # otherwise the patch is filled in before
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature, {})
    patch = wrong_at(target, at_rest, 0.4)
    report = bind(source, target)
    assert any("would have torn the mesh when bones rotate, and were smoothed" in note for note in report["notes"])
    assert weight_array(target, "Lower")[patch].min() > 0.9
    sums = sum(weight_array(target, bone) for bone in BONES)
    np.testing.assert_allclose(sums, 1, atol=1e-3)
    assert select_stretched(bpy.context, target).startswith("Stretched: no vertices of 'Target'")
    assert previews.of_binding(target).legend == "No vertex stretches far more than on the source"


def animate(armature, **places):
    """Key the location of bones at frames 1 and 11, and leave the current frame in between."""
    for name, place in places.items():
        bone = armature.pose.bones[name]
        for frame, factor in ((1, 0), (11, 1)):
            bone.location = [factor * x for x in place]
            bone.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(3)


@pytest.mark.parametrize("animated", [False, True])
def test_weights_tearing_in_an_animation_are_smoothed(monkeypatch, animated):
    monkeypatch.setattr(poses, "POSES", poses.PoseTuning(angle=0))  # only the animation moves bones
    monkeypatch.setattr(weights, "MIN_ISLAND", np.inf)
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature, {})
    wrong_at(target, at_rest, 0.4)
    if animated:
        animate(armature, Upper=(2, 0, 0))
    report = bind(source, target)
    assert any("were smoothed" in note for note in report["notes"]) == animated


def test_read_animation_changes_nothing_and_includes_constraints():
    source, armature = source_and_rig()
    assert mesh_data.read_animation(source).shape == (0, 3, 3, 4)
    follow = armature.pose.bones["Upper"].constraints.new("COPY_LOCATION")
    follow.target, follow.subtarget = armature, "Lower"
    animate(armature, Lower=(2, 0, 0))
    before, pose = snapshot_file(), [bone.matrix.copy() for bone in armature.pose.bones]
    poses = mesh_data.read_animation(source)
    assert snapshot_file() == before
    assert [bone.matrix for bone in armature.pose.bones] == pose
    assert bpy.context.scene.frame_current == 3
    assert len(bpy.data.scenes) == 1
    assert len(poses) == 11
    np.testing.assert_allclose(poses[0, :2], [np.eye(3, 4)] * 2, atol=1e-6)
    np.testing.assert_allclose(poses[-1, :, :, 3], [[2, 0, 0], [2, 0, 0], [2, 0, -4]], atol=1e-6)
    action = armature.animation_data.action
    track = armature.animation_data.nla_tracks.new()
    track.strips.new("Strip", 21, action)
    armature.animation_data.action = None
    assert len(mesh_data.read_animation(source)) == 11


def test_remaining_stretched_vertices_are_reported_and_selected(monkeypatch):
    monkeypatch.setattr(stretch, "STRETCH", stretch.StretchTuning(rounds=0))
    monkeypatch.setattr(weights, "MIN_ISLAND", np.inf)
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature, {})
    patch = wrong_at(target, at_rest, 0.4)
    report = bind(source, target)
    assert any("Select Stretched shows them" in note for note in report["notes"])
    activate(target)
    assert bpy.ops.zoomout.select_stretched() == {"FINISHED"}
    chosen = np.zeros(len(target.data.vertices), dtype=bool)
    target.data.vertices.foreach_get("select", chosen)
    assert chosen[patch].any()
    assert not chosen[at_rest[:, 2] > 3].any()


def test_stretched_vertices_are_coloured_and_follow_undo(monkeypatch):
    monkeypatch.setattr(stretch, "STRETCH", stretch.StretchTuning(rounds=0))
    monkeypatch.setattr(weights, "MIN_ISLAND", np.inf)
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature, {})
    wrong_at(target, at_rest, 0.4)
    bind(source, target)
    activate(target)
    assert bpy.ops.zoomout.preview(kind="STRETCHED") == {"FINISHED"}
    assert preview.current().legend == "Red: stretches far more than on the source"
    (shown,) = preview.current().overlays
    red = shown.values[:, 0] > shown.values[:, 1] + 0.3
    np.testing.assert_array_equal(red, stretched_vertices(target))
    stored_report.remove(target.data)
    previews.follow_undo(bpy.context, preview.current())
    assert preview.current() is None


def test_selecting_stretched_vertices_requires_a_binding(source, target):
    activate(target)
    assert not bpy.ops.zoomout.select_stretched.poll()
    with pytest.raises(zo.MeshError, match="was not bound yet"):
        select_stretched(bpy.context, target)
