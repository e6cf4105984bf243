# SPDX-License-Identifier: GPL-3.0-or-later
"""A target in another pose is moved to the rest pose and bound, and follows the bones at once."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from drawing import Context, Layout
from mathutils import Euler, Matrix
from rigged import (
    BONES,
    OTHER,
    POSE,
    mesh_object,
    rig,
    set_pose,
    shear,
    truth,
    visible_positions,
)
from rigged import coarse_pose_target as pose_target
from rigged import coarse_source_and_rig as source_and_rig
from rigged import pose_target as fine_pose_target
from rigged import source_and_rig as fine_source_and_rig
from scenes import activate, add_uv_map, from_pydata, key_shape, set_weights, snapshot, weight_array
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import api, cli, jobs, mesh_data
from blender_addon.scene.pair import read_pair
from blender_addon.services.transfer_report import summary
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.report.verdict import AMBER, RED

PLACES = {
    "at the origin": (None, None, None),
    "anywhere": (
        Matrix.LocRotScale((0.3, 0, 1), Euler((0.5, 0, 0.3)), (2, 2, 2)),
        Matrix.LocRotScale((5, -3, 2), Euler((0, 0.6, 2.0)), (0.5, 0.5, 0.5)),
        Matrix.LocRotScale((-4, 1, 0), Euler((1, 1, 0)), (3, 3, 3)),
    ),
    "scaled unevenly": (shear(), Matrix.LocRotScale((0, 1, 0), Euler((0, 0, 1)), (1, 1, 1)), shear()),
    "mirrored": (Matrix.Diagonal((-1, 1, 1, 1)), None, None),
}


def bind(source, target, **binding):
    return api.bind_to_rig(bpy.context, source, target, api.Binding(**binding))


def match_again(target, at_rest):
    """Store the true match of a target that was changed."""
    target.data.update()
    bpy.context.view_layer.update()
    keep_true_match(target, at_rest)


def off(target, armature, at_rest, pose=None):
    """Distances of a bound target's vertices from the truth, relative to the tube's length at the rig's scale."""
    wanted = truth(armature, OTHER if pose is None else pose, at_rest)
    found = np.linalg.norm(visible_positions(target) - wanted, axis=1) / (6 * armature.matrix_world.median_scale)
    set_pose(armature, {})
    return found


@pytest.mark.parametrize("place", PLACES)
def test_bones_pose_the_target_at_once(place):
    of_source, of_rig, of_target = PLACES[place]
    source, armature = source_and_rig(of_source, of_rig)
    target, at_rest = pose_target(source, armature, matrix=of_target)
    stood, before = visible_positions(target), snapshot(source)
    report = bind(source, target)
    assert np.median(off(target, armature, at_rest, {})) < 2e-3
    assert np.median(off(target, armature, at_rest)) < 2e-3
    assert off(target, armature, at_rest).max() < 0.04
    assert report["bound"] == {"armature": "Rig", "shape": "rest_pose"}
    assert report["written"]["vertex_groups"] == list(BONES)
    assert snapshot(source) == before
    target.data.shape_keys.key_blocks["Posed Shape"].value = 1
    np.testing.assert_allclose(visible_positions(target), stood, atol=1e-4)
    assert target.matrix_world.is_negative == (stood is None)


def test_target_gets_modifier_and_transform_of_source():
    source, armature = source_and_rig(shear(), PLACES["anywhere"][1])
    modifier = source.modifiers["Skeleton"]
    set_weights(source, "Mask", np.zeros(len(source.data.vertices)))
    modifier.vertex_group, modifier.invert_vertex_group, modifier.use_multi_modifier = "Mask", True, True
    target, _ = pose_target(source, armature)
    target.modifiers.new("Smooth", "SMOOTH").show_viewport = False
    bind(source, target)
    assert [each.type for each in target.modifiers] == ["ARMATURE", "SMOOTH"]
    made = target.modifiers["Skeleton"]
    assert made.object == armature
    assert (made.vertex_group, made.invert_vertex_group, made.use_multi_modifier) == ("Mask", True, True)
    assert target.parent == armature
    assert target.parent_type == "OBJECT"
    np.testing.assert_allclose(np.array(target.matrix_world), np.array(source.matrix_world), atol=1e-5)


def test_armature_keeps_its_place_among_modifiers():
    source, armature = source_and_rig()
    source.modifiers.new("Smooth", "SMOOTH").factor = 0
    source.modifiers.move(1, 0)
    target, at_rest = pose_target(source, armature)
    for kind in ("SMOOTH", "WAVE"):
        target.modifiers.new(kind, kind).show_viewport = False
    bind(source, target)
    assert [each.type for each in target.modifiers] == ["SMOOTH", "ARMATURE", "WAVE"]
    assert np.median(off(target, armature, at_rest)) < 2e-3


def test_preserve_volume_is_copied_from_source():
    source, armature = source_and_rig()
    source.modifiers["Skeleton"].use_deform_preserve_volume = True
    pose = {"Middle": (0, 0, 1.3)}
    set_pose(armature, pose)
    target = mesh_object(
        "Target", zo.Surface(visible_positions(source).astype(float), [list(p.vertices) for p in source.data.polygons])
    )
    set_pose(armature, {})
    at_rest = visible_positions(source)
    api.match_objects(bpy.context, source, target, initial="same_order")
    bind(source, target)
    assert np.median(np.linalg.norm(visible_positions(target) - at_rest, axis=1)) < 5e-3
    set_pose(armature, OTHER)
    assert np.median(np.linalg.norm(visible_positions(target) - visible_positions(source), axis=1)) < 5e-3
    assert target.modifiers["Skeleton"].use_deform_preserve_volume


def test_rig_may_be_posed_while_binding():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    set_pose(armature, OTHER)
    bind(source, target)
    assert np.median(np.linalg.norm(visible_positions(target) - truth(armature, OTHER, at_rest), axis=1)) < 0.01
    for bone in armature.pose.bones:
        assert tuple(bone.rotation_euler) == pytest.approx(OTHER[bone.name])


def test_a_target_at_rest_keeps_its_shape():
    source, armature = fine_source_and_rig()
    for shift, scale in ((0, 1), (7, 1), (-3, 2)):
        moved = Matrix.LocRotScale((shift, 0, 0), Euler((0, 0, 0)), (scale, scale, scale))
        target, at_rest = fine_pose_target(source, armature, {}, f"Target {shift}")
        target.data.transform(moved)
        match_again(target, at_rest)
        report = bind(source, target)
        assert report["bound"]["shape"] == "keep_shape"
        assert target.data.shape_keys is None
        assert off(target, armature, at_rest, {}).max() < 2e-3
        assert np.median(off(target, armature, at_rest)) < 2e-3


def test_chosen_shape_option_is_respected():
    source, armature = fine_source_and_rig()
    target, at_rest = fine_pose_target(source, armature, {"Middle": (0.4, 0, 0)})
    stood = visible_positions(target)
    assert bind(source, target, shape="keep_shape")["bound"]["shape"] == "keep_shape"
    assert (
        np.abs(
            np.linalg.norm(stood[0] - stood, axis=1)
            - np.linalg.norm(visible_positions(target)[0] - visible_positions(target), axis=1)
        ).max()
        < 1e-4
    )
    assert off(target, armature, at_rest, {}).max() > 0.05
    bent, at_rest = fine_pose_target(source, armature, {"Middle": (0.06, 0, 0)}, "Bent")
    assert bind(source, bent, shape="rest_pose")["bound"]["shape"] == "rest_pose"
    assert np.median(off(bent, armature, at_rest, {})) < 1e-3


def test_target_shape_keys_rotate_to_the_rest_pose():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    target.shape_key_add(name="Basis")
    key = target.shape_key_add(name="Shift")
    key.value = 0
    top = np.flatnonzero(at_rest[:, 2] > 5.5)
    bones = armature.pose.bones
    set_pose(armature, POSE)
    turn = np.array((bones["Upper"].matrix @ armature.data.bones["Upper"].matrix_local.inverted()).to_3x3())
    set_pose(armature, {})
    shape = key_shape(target.data, "Shift").copy()
    shape[top] += turn @ [0.5, 0, 0]
    key.data.foreach_set("co", shape.ravel())
    target.data.update()
    match_again(target, at_rest)
    bind(source, target)
    moved = key_shape(target.data, "Shift") - key_shape(target.data, "Basis")
    np.testing.assert_allclose(moved[top], np.tile([0.5, 0, 0], (len(top), 1)), atol=0.02)
    assert [block.name for block in target.data.shape_keys.key_blocks] == ["Basis", "Shift", "Posed Shape"]
    assert not target.data.shape_keys.key_blocks["Posed Shape"].value


def test_binding_uses_all_armatures_of_source():
    source, armature = source_and_rig()
    face = rig("Face", ("Tip",))
    source.modifiers.new("Face", "ARMATURE").object = face
    set_weights(source, "Tip", np.zeros(len(source.data.vertices)))
    target, at_rest = pose_target(source, armature)
    bind(source, target)
    assert [(each.name, each.object.name) for each in target.modifiers] == [("Skeleton", "Rig"), ("Face", "Face")]
    assert target.parent == armature
    assert np.median(off(target, armature, at_rest)) < 2e-3


def test_source_with_armature_parent_binds_like_a_modifier():
    source, armature = source_and_rig()
    source.modifiers.clear()
    source.parent_type = "ARMATURE"
    target, at_rest = pose_target(source, armature)
    bind(source, target)
    assert np.median(off(target, armature, at_rest)) < 2e-3
    assert [each.object for each in target.modifiers] == [armature]


def test_a_source_with_a_subdivision_is_read_at_rest():
    source, armature = source_and_rig()
    source.modifiers.new("Subdivision", "SUBSURF").levels = 1
    target, at_rest = pose_target(source, armature)
    set_pose(armature, OTHER)
    bind(source, target)
    set_pose(armature, {})
    assert np.median(off(target, armature, at_rest)) < 0.015


def test_target_on_two_objects_is_bound_like_both():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    triangles = np.array([list(p.vertices) for p in source.data.polygons if len(p.vertices) == 4])
    middle = visible_positions(source)[triangles].mean(axis=1)[:, 2]
    parts = []
    for name, chosen in (("Below", middle < 3), ("Above", middle >= 3)):
        used, faces = np.unique(triangles[chosen], return_inverse=True)
        part = from_pydata(name, visible_positions(source)[used].tolist(), faces.reshape(-1, 4).tolist())
        for bone in BONES:
            set_weights(part, bone, weight_array(source, bone)[used])
        part.parent = armature
        part.modifiers.new("Armature", "ARMATURE").object = armature
        parts.append(part)
    bpy.context.view_layer.update()
    pair = jobs.run(read_pair(bpy.context, "Below", "Target", ["Above"]))
    found = zo.SurfaceMap(
        *closest_points(at_rest.astype(float), pair.source.vertices, pair.source.triangles), pair.source.triangles
    )
    kept = stored_match.StoredMatch(found, np.ones(len(at_rest)), (), others=("Above",))
    stored_match.write(target.data, kept, pair, {})
    set_pose(armature, OTHER)
    report = bind(parts[0], target)
    set_pose(armature, {})
    assert report["others"] == ["Above"]
    assert np.median(off(target, armature, at_rest)) < 3e-3


def test_children_stay_in_place_and_bone_children_are_unchanged():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    child, hat = (bpy.data.objects.new(name, None) for name in ("Child", "Hat"))
    for obj in (child, hat):
        bpy.context.scene.collection.objects.link(obj)
    child.parent, child.location = target, (1, 2, 3)
    hat.parent, hat.parent_type, hat.parent_bone = armature, "BONE", "Upper"
    bpy.context.view_layer.update()
    before = [np.array(obj.matrix_world) for obj in (child, hat)]
    bind(source, target)
    for obj, matrix in zip((child, hat), before, strict=True):
        np.testing.assert_allclose(np.array(obj.matrix_world), matrix, atol=1e-4)
    assert (hat.parent_type, hat.parent_bone) == ("BONE", "Upper")


def test_match_is_valid_after_binding():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    bind(source, target)
    report = api.transfer_objects(bpy.context, source, target, ["vertex_groups"])
    assert report["bound"] is None
    assert not any("match again" in note for note in report["notes"])


def test_data_of_a_bound_target_follows_the_match_that_the_bones_correct():
    source, armature = fine_source_and_rig()
    target, at_rest = fine_pose_target(source, armature)
    keep_true_match(target, at_rest + np.array([0, 0, 0.12]))
    source.data.attributes.new("Height", "FLOAT", "POINT").data.foreach_set("value", visible_positions(source)[:, 2])

    def error():
        heights = np.empty(len(at_rest), np.float32)
        target.data.attributes["Height"].data.foreach_get("value", heights)
        return np.median(np.abs(heights - at_rest[:, 2]))

    api.transfer_objects(bpy.context, source, target, ["attributes"])
    before = error()
    api.transfer_objects(bpy.context, source, target, ["attributes"], binding=api.Binding())
    assert error() < 0.7 * before
    api.transfer_objects(bpy.context, source, target, ["attributes"])  # along the match as it is stored then
    assert error() < 0.7 * before


def test_bones_do_not_correct_a_match_that_is_probably_wrong():
    source, armature = source_and_rig()
    images = {}
    for level in (AMBER, RED):
        target, at_rest = pose_target(source, armature, name=level)
        keep_true_match(target, at_rest + np.array([0, 0, 0.12]), verdict=zo.Verdict(level, "Doubtful.", ""))
        before = mesh_data.read_layer(target.data, stored_match.TRIANGLE).attribute.values
        bind(source, target)
        after = mesh_data.read_layer(target.data, stored_match.TRIANGLE).attribute.values
        images[level] = np.mean(before != after)
    assert images[AMBER] > 0.2
    assert images[RED] == 0


def test_weights_are_limited_and_sum_to_one():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    api.bind_to_rig(bpy.context, source, target, settings=api.Settings(limit=1))
    weights = np.stack([weight_array(target, bone) for bone in BONES])
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-5)
    assert (weights > 0).sum(axis=0).max() == 1


def test_vertices_whose_weights_are_filled_in_are_counted_once():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    keep_true_match(target, at_rest, doubtful=40)
    settings = api.Settings(fill_below=0.2)
    notes = api.bind_to_rig(bpy.context, source, target, settings=settings)["notes"]
    assert len([note for note in notes if "usable match" in note]) == 1


def test_locked_bone_group_is_used_unchanged():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    set_weights(target, "Upper", np.clip(at_rest[:, 2] - 3.5, 0, 1)).lock_weight = True
    bind(source, target)
    assert np.median(off(target, armature, at_rest)) < 5e-3


def test_transfer_binds_on_request():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    stood = visible_positions(target)
    activate(target, source)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    np.testing.assert_array_equal(visible_positions(target), stood)
    bpy.context.scene.zoomout.bind = True
    assert bpy.ops.zoomout.transfer(uv_maps=False, shape=True) == {"FINISHED"}
    assert np.median(off(target, armature, at_rest)) < 2e-3
    shape = key_shape(target.data, "Source") @ np.array(target.matrix_world)[:3, :3].T
    assert np.abs(shape - at_rest).max() < 0.25  # where the source is, although the target stood elsewhere
    assert "bound to 'Rig'" in summary(api.transfer_report(target))


def test_the_operator_binds_several_targets_in_one_step():
    source, armature = source_and_rig()
    (one, rest_of_one), (two, rest_of_two) = (pose_target(source, armature, name=name) for name in ("One", "Two"))
    activate(one, two, source)
    bpy.context.scene.zoomout.source = source
    assert bpy.ops.zoomout.bind_to_rig() == {"FINISHED"}
    for target, at_rest in ((one, rest_of_one), (two, rest_of_two)):
        assert np.median(off(target, armature, at_rest)) < 2e-3


def test_unmatched_target_is_matched_before_binding():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    del target.data[stored_match.PROPERTY]
    with pytest.raises(zo.MeshError, match="vertices"):
        api.bind_to_rig(bpy.context, source, target, initial="same_order")
    assert target.parent is None


def test_bound_target_is_rebound_only_on_request():
    source, armature = source_and_rig()
    other = rig("Other")
    target, at_rest = pose_target(source, armature)
    target.parent = other
    target.modifiers.new("Old", "ARMATURE").object = other
    with pytest.raises(zo.MeshError, match="'Target' is already bound to 'Other'"):
        bind(source, target)
    assert [each.name for each in target.modifiers] == ["Old"]
    bind(source, target, replace=True)
    assert [each.name for each in target.modifiers] == ["Skeleton"]
    assert target.parent == armature
    assert np.median(off(target, armature, at_rest)) < 2e-3


def test_target_posed_by_another_armature_is_bound_as_seen():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature, {})
    bind(source, target)
    old = armature.copy()
    bpy.context.scene.collection.objects.link(old)
    target.modifiers["Skeleton"].object = target.parent = old
    set_pose(old, POSE)
    match_again(target, at_rest)
    bind(source, target, replace=True)
    assert np.median(off(target, armature, at_rest)) < 2e-3
    target.modifiers["Skeleton"].object = target.parent = old
    match_again(target, at_rest)
    with pytest.raises(zo.MeshError, match=r"'Target' has shape keys and is posed by 'Rig[.]001'"):
        bind(source, target, replace=True)


def _constrained(source, target, armature):
    post = bpy.data.objects.new("Post", None)
    bpy.context.scene.collection.objects.link(post)
    post.location = (0, 3, 0)
    target.constraints.new("COPY_LOCATION").target = post
    target.data.transform(Matrix.Translation((0, -3, 0)))
    bpy.context.view_layer.update()
    keep_true_match(target, visible_positions(target))


def _shared(source, target, armature):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Twin", target.data))


def _hanging(source, target, armature):
    target.parent, target.parent_type, target.parent_bone = armature, "BONE", "Upper"


def _absolute(source, target, armature):
    target.shape_key_add(name="Basis")
    target.data.shape_keys.use_relative = False


def _flat(source, target, armature):
    source.scale = (1, 0, 1)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda source, *_: source.modifiers.clear(), "'Source' has no Armature modifier"),
        (lambda source, *_: source.vertex_groups.clear(), "No deform bone of 'Rig' is named like"),
        (_constrained, "Constraints, drivers or animation control the transform of 'Target'"),
        (_shared, "The mesh of 'Target' is shared by 2 objects"),
        (_hanging, "'Target' is already parented to a bone"),
        (_absolute, "The shape keys of 'Target' are absolute"),
        (_flat, "'Source' has a scale of zero"),
    ],
)
def test_impossible_binding_is_refused_and_changes_nothing(change, sentence):
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    change(source, target, armature)
    bpy.context.view_layer.update()
    before, stood = snapshot(target), visible_positions(target)
    with pytest.raises(zo.MeshError, match=sentence):
        bind(source, target)
    assert snapshot(target) == before
    np.testing.assert_array_equal(visible_positions(target), stood)


def test_binding_requires_weights_under_bone_names():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    with pytest.raises(zo.MeshError, match="Flip Group Names cannot be used"):
        api.bind_to_rig(bpy.context, source, target, settings=api.Settings(flip_names=True))
    for bone in BONES:
        target.vertex_groups.new(name=bone).lock_weight = True
    with pytest.raises(zo.MeshError, match="None of the data can be transferred"):
        bind(source, target)
    add_uv_map(source.data, "UVMap")
    with pytest.raises(zo.MeshError, match="are locked: unlock them"):
        api.transfer_objects(bpy.context, source, target, ["uv_maps"], binding=api.Binding())
    assert not target.data.uv_layers


@pytest.mark.parametrize("overridden", [False, True])
def test_a_linked_rig_stays_untouched(tmp_path, overridden):
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    bpy.data.libraries.write(str(tmp_path / "rig.blend"), {source, armature})
    mesh, skeleton = source.data, armature.data
    bpy.data.meshes.remove(mesh)
    bpy.data.armatures.remove(skeleton)
    with bpy.data.libraries.load(str(tmp_path / "rig.blend"), link=True) as (_, loaded):
        loaded.objects = ["Source", "Rig"]
    source, armature = loaded.objects
    if overridden:
        armature = armature.override_create(remap_local_usages=True)
        source = source.override_create(remap_local_usages=True)
        source.parent = source.modifiers["Skeleton"].object = armature
    for obj in (source, armature):
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    bind(source, target)
    assert target.parent == target.modifiers["Skeleton"].object == armature
    assert (armature.library is None) == overridden
    assert armature.data.library is not None
    assert np.median(np.linalg.norm(visible_positions(target) - at_rest, axis=1)) < 0.01


def test_the_button_is_grey_where_the_source_has_no_rig():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    activate(target, source)
    assert _usable("Bind to Rig")
    source.modifiers.clear()
    assert not _usable("Bind to Rig")


def _usable(button):
    """Whether a button of the panel is enabled."""
    drawn = []
    bpy.types.ZOOMOUT_PT_binding.draw(SimpleNamespace(layout=Layout(drawn)), Context())
    (usable,) = [usable for kind, text, usable in drawn if (kind, text) == ("operator", button)]
    return usable()


def test_a_subdivision_of_the_target_comes_behind_the_armature():
    source, armature = source_and_rig()
    target, at_rest = pose_target(source, armature)
    target.modifiers.new("Subdivision", "SUBSURF")
    match_again(target, at_rest)
    bind(source, target)
    assert [each.type for each in target.modifiers] == ["ARMATURE", "SUBSURF"]
    target.modifiers["Subdivision"].show_viewport = False
    assert np.median(off(target, armature, at_rest)) < 2e-3


def test_undo_reverts_binding_completely():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    activate(target, source)
    bpy.ops.ed.undo_push(message="before")
    before, stood = snapshot(target), visible_positions(target)
    assert bpy.ops.zoomout.bind_to_rig("EXEC_DEFAULT", True) == {"FINISHED"}
    assert target.parent is not None
    bpy.ops.ed.undo()
    target = bpy.data.objects["Target"]
    assert snapshot(target) == before
    assert target.parent is None
    np.testing.assert_array_equal(visible_positions(target), stood)


@pytest.mark.parametrize("hidden", [True, False])
def test_the_source_is_hidden_after_binding_if_that_is_chosen(hidden):
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    second, _ = pose_target(source, armature, name="Second")
    activate(target, source)
    assert bpy.ops.zoomout.bind_to_rig(source="Source", hide_source=hidden) == {"FINISHED"}
    assert source.hide_get() == hidden
    activate(second)
    assert bpy.ops.zoomout.bind_to_rig(source="Source", hide_source=hidden) == {"FINISHED"}


@pytest.mark.parametrize("hidden", [True, False])
def test_api_and_command_line_hide_the_source_if_chosen(hidden):
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    second, _ = pose_target(source, armature, name="Second")
    api.bind_to_rig(bpy.context, source, target, hide_source=hidden)
    assert source.hide_get() == hidden
    source.hide_set(False)
    arguments = ["transfer", "--source", "Source", "--target", "Second", "--data", "vertex_groups", "--bind"]
    assert cli.main([*arguments, *["--no-hide-source"] * (not hidden)]) == 0
    assert second.parent == armature
    assert source.hide_get() == hidden


@pytest.mark.parametrize("path", ["location", "rotation_euler", "delta_scale"])
def test_a_target_that_is_animated_by_itself_is_refused(path):
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    target.keyframe_insert(path, frame=1)
    before = snapshot(target)
    with pytest.raises(zo.MeshError, match="has an animation of its own"):
        bind(source, target)
    assert snapshot(target) == before


def test_unrelated_animation_does_not_prevent_binding():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    target.keyframe_insert("hide_render", frame=1)
    assert bind(source, target)["bound"]["armature"] == "Rig"


def test_transferred_keys_have_the_directions_of_the_rest_pose():
    source, armature = source_and_rig()

    def sliding(points):  # across the upper joint, where the target bends
        return np.exp(-((points[:, 2:] - 4) ** 2)) * [0.3, 0.2, 0.1]

    source.shape_key_add(name="Basis")
    key = source.shape_key_add(name="Slide")
    key.value = 0
    still = key_shape(source.data, "Basis")
    key.points.foreach_set("co", (still + sliding(still)).astype(np.float32).ravel())
    target, at_rest = pose_target(source, armature, {"Middle": (0.9, 0, 0.3), "Upper": (1.2, 0.4, 0)})
    api.transfer_objects(bpy.context, source, target, ["shape_keys"], binding=api.Binding())
    keys = target.data.shape_keys.key_blocks
    assert keys.keys() == ["Basis", "Slide", "Posed Shape"]
    found = key_shape(target.data, "Slide") - key_shape(target.data, "Basis")
    off = found - sliding(at_rest)
    assert np.linalg.norm(off) < 0.03 * np.linalg.norm(sliding(at_rest))
