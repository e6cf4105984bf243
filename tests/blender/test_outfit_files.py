# SPDX-License-Identifier: GPL-3.0-or-later
"""Avatars in .blend and FBX files, dressed in outfits of other avatars."""

import json

import bpy
import numpy as np
import pytest
from blend_files import save
from rigged import source_and_rig
from scenes import activate, set_weights
from test_dress_by_joints import bone_of, cloth_around, rigged_mannequin
from test_dress_objects import sleeve
from test_outfit_bones import OTHER_NAMES, own_target, tail_and_chain

import zoomout_core as zo
from blender_addon import cli, mesh_data
from blender_addon.scene.files import open_scene, shown_meshes
from blender_addon.services import outfits
from blender_addon.services.dressing.read import Dressing
from blender_addon.services.outfits import BlenderFiles
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.outfits.check import REST, SPREAD, SWING, check_rigged


def write(path, objects):
    """Write the objects of the scene to a .blend or FBX file."""
    activate(*objects)
    if path.suffix == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path), use_selection=True, add_leaf_bones=False)
    else:
        save(path)


@pytest.fixture
def avatars(tmp_path):
    """A function that writes a dressed body, and one with another rig, with an extension; returns their paths."""

    def make(ending):
        outfit, avatar = tmp_path / f"dressed{ending}", tmp_path / f"naked{ending}"
        body, armature = source_and_rig()
        body.name = "Body"
        cloth, tail = sleeve(armature), tail_and_chain(armature)
        set_weights(cloth, "Patch", np.arange(len(cloth.data.vertices)) < 40)
        write(outfit, [body, cloth, tail, armature])
        body.name = "Source"
        target, other = own_target(body, armature)
        stored_match.remove(target.data)
        for obj in (body, cloth, tail, armature):
            bpy.data.objects.remove(obj)
        target.name = "Body"
        bpy.data.orphans_purge(do_recursive=True)
        write(avatar, [target, other])
        return outfit, avatar

    return make


@pytest.mark.parametrize("ending", [".blend", ".fbx"])
def test_an_avatar_in_a_file_is_dressed(avatars, tmp_path, ending):
    outfit, avatar = avatars(ending)
    files = BlenderFiles(bpy.context, Dressing(keep="Patch"))
    assert files.ending(avatar) == ending
    source, target = files.read_body(outfit, True), files.read_body(avatar, False)
    zo.SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles).save(
        tmp_path / "map.npz", confidence=np.ones(len(target.vertices))
    )
    output = tmp_path / f"out{ending}"
    made = files.dress(outfit, avatar, tmp_path / "map.npz", output)
    assert made.joints == 2
    assert [name for name, _ in made.objects] == ["Sleeve on Body", "Tail on Body"]
    assert list(made.checked.inside) == [REST, SWING, SPREAD]
    assert made.checked.inside[REST] == 0
    assert np.ptp(made.checked.bodies[REST], axis=0).argmax() == 1  # y is up
    open_scene(bpy.context, output)
    assert shown_meshes(bpy.context.view_layer.objects) == ["Body", "Sleeve on Body", "Tail on Body"]
    (armature,) = (obj for obj in bpy.data.objects if obj.type == "ARMATURE")
    assert set(armature.data.bones.keys()) == {*OTHER_NAMES, "Tail.0", "Tail.1"}
    copy = bpy.data.objects["Sleeve on Body"]
    assert [modifier.object for modifier in copy.modifiers] == [armature]
    assert not stored_match.description(bpy.data.objects["Body"].data)
    assert len(bpy.data.meshes) == 3


def test_clothes_without_skin_below_them_are_checked_as_skin(tmp_path, monkeypatch):
    """Socks of avatars without shins stand in for these on both sides."""
    shins, paths = ("shin.L", "shin.R"), (tmp_path / "dressed.blend", tmp_path / "other.blend")
    for path in paths:
        body, armature, _ = rigged_mannequin("Body", np.ones(3), without=shins)
        socks = [cloth_around(f"Sock {shin[-1]}", shin, armature) for shin in shins]
        write(path, [body, *socks, armature])
        for obj in (body, *socks, armature):
            bpy.data.objects.remove(obj)
        bpy.data.orphans_purge(do_recursive=True)
    files = BlenderFiles(bpy.context, Dressing())
    source, target = files.read_body(paths[0], True), files.read_body(paths[1], False)
    zo.SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles).save(
        tmp_path / "map.npz", confidence=np.ones(len(target.vertices))
    )
    areas = []

    def check(before, worn, cloth, body, heads):
        areas.append((before.area - source.area, worn.area, body.surface.area - target.area))
        return check_rigged(before, worn, cloth, body, heads)

    monkeypatch.setattr(outfits, "check_rigged", check)
    made = files.dress(*paths, tmp_path / "map.npz", tmp_path / "out.blend")
    ((of_source, worn, of_target),) = areas
    assert 0.5 * worn < of_source < worn
    assert 0.5 * worn < of_target < worn
    for pose in (REST, SWING, SPREAD):
        assert len(made.checked.bodies[pose]) > len(target.vertices)
    assert made.triangles[0].max() < len(made.checked.bodies[REST])
    for (name, _), shin in zip(made.objects, shins, strict=True):  # no skin there that they could follow
        copy = bpy.data.objects[name]
        weights = mesh_data.read_weights(copy, copy.data)
        assert weights.values[:, [weights.labels.index(bone_of(shin))]].toarray().min() > 0.9


def test_bodies_are_read_with_their_bones(avatars):
    outfit, avatar = avatars(".blend")
    files = BlenderFiles(bpy.context, Dressing())
    rigged = files.read_rigged(avatar, False)
    assert list(rigged.bones.names) == list(OTHER_NAMES)
    assert np.array_equal(rigged.surface.triangles, files.read_body(avatar, False).triangles)
    np.testing.assert_allclose(rigged.weights.sum(axis=1), 1)
    low, high = rigged.surface.vertices.min(axis=0), rigged.surface.vertices.max(axis=0)
    inside = ((rigged.bones.heads > low - 0.1) & (rigged.bones.heads < high + 0.1)).all(axis=1)
    assert inside.all()
    assert files.read_rigged(outfit, True).bones.names


@pytest.mark.slow
@pytest.mark.usefixtures("quick_search")
def test_the_command_resumes_and_writes_the_report(avatars, tmp_path, capsys):
    outfit, avatar = avatars(".blend")
    output = tmp_path / "out"
    line = ["outfits", str(outfit), str(avatar), "-o", str(output), "--detail", "fast", "--force"]
    assert cli.main(line) == 0
    assert "outfits of 'dressed on naked' done" in capsys.readouterr().out
    report = json.loads((output / "report.json").read_text())
    (row,) = report["outfits"]
    assert (report["matched_now"], report["dressed_now"], row["output"]) == (1, 1, "dressed/naked/dressed.blend")
    assert (output / "report.html").read_text().count("data:image/png;base64,") == 1
    assert cli.main(line) == 0
    again = json.loads((output / "report.json").read_text())
    assert (again["matched_now"], again["dressed_now"]) == (0, 0)
    assert cli.main([*line, "--dress-gap", "0.1", "--format", "fbx"]) == 0
    changed = json.loads((output / "report.json").read_text())
    assert (changed["matched_now"], changed["dressed_now"]) == (0, 1)
    assert (output / "dressed" / "naked" / "dressed.fbx").is_file()


def test_unwearable_inputs_give_one_sentence(tmp_path, capsys):
    body, armature = source_and_rig()
    body.name = "Body"
    for name in ("one.blend", "two.blend"):
        write(tmp_path / name, [body, armature])
    (tmp_path / "scan.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    one, two, scan = (str(tmp_path / name) for name in ("one.blend", "two.blend", "scan.obj"))
    for arguments, sentence in (
        ((one, two), "name those of the body with --body"),
        ((scan, two), "scan.obj is not an avatar that Blender can read"),
        ((str(tmp_path / "missing"), two), "There is no file or folder"),
    ):
        assert cli.main(["outfits", *arguments, "-o", str(tmp_path / "out")]) == 1
        assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out" / "dressed").exists()
