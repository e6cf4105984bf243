# SPDX-License-Identifier: GPL-3.0-or-later
"""Clothes of a humanoid body are dressed along its joints where the match of the shapes confuses limbs."""

import bpy
import numpy as np
import pytest
from mannequins import PARTS, mannequin
from rigged import mesh_object
from scenes import activate, link, positions, set_weights

import zoomout_core as zo
from blender_addon import api, jobs
from blender_addon.scene.pair import read_pair
from blender_addon.services.dressing import dress
from blender_addon.services.matching.made_match import FoundMatch
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.report.verdict import AMBER, GREEN, RED, RefusedMatchError

BUILD = np.array((0.8, 1.1, 1.3))
SIDES = {"L": "left", "R": "right", "": ""}
BONES = {
    "torso": "Hips",
    "head": "Head",
    "upper arm": "UpperArm",
    "forearm": "LowerArm",
    "hand": "Hand",
    "thigh": "UpperLeg",
    "shin": "LowerLeg",
    "foot": "Foot",
}


def bone_of(part):
    """The name of a part's bone."""
    limb, _, side = part.partition(".")
    return SIDES[side] + BONES[limb]


def rigged_mannequin(name, build, seed=0):
    """A mannequin of a build with its own armature, and the part of each vertex."""
    made = mannequin(seed=seed, build=tuple(build))
    body, armature = mesh_object(name, made.surface), link(f"{name} Rig", bpy.data.armatures.new(name))
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    for part, (above, joint, centre, _) in PARTS.items():
        bone = armature.data.edit_bones.new(bone_of(part))
        bone.head, bone.tail = build * joint, build * centre + [0, 0, 0.01]
        bone.parent = armature.data.edit_bones[bone_of(above)] if above else None
    bpy.ops.object.mode_set(mode="OBJECT")
    for part in PARTS:
        set_weights(body, bone_of(part), (made.part == part).astype(float))
    bind(body, armature)
    return body, armature, made.part


def bind(obj, armature):
    obj.parent = armature
    obj.modifiers.new("Skeleton", "ARMATURE").object = armature
    bpy.context.view_layer.update()


@pytest.fixture
def bodies():
    """A body with a garter on the left thigh, another one, and a match that exchanges its sides."""
    source, armature, part = rigged_mannequin("Source", np.ones(3))
    surface = mannequin().surface
    chosen = part == "thigh.L"
    middle = surface.vertices[chosen].mean(axis=0)
    triangles = surface.triangles[chosen[surface.triangles].all(axis=1)]
    number = np.cumsum(chosen) - 1
    garter = mesh_object("Garter", zo.Surface(middle + 1.1 * (surface.vertices[chosen] - middle), number[triangles]))
    set_weights(garter, bone_of("thigh.L"), np.ones(chosen.sum()))
    bind(garter, armature)
    target, _, _ = rigged_mannequin("Target", BUILD, seed=3)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    mirrored = pair.target.vertices / BUILD * [-1, 1, 1]
    found = zo.SurfaceMap(*closest_points(mirrored, pair.source.vertices, pair.source.triangles), pair.source.triangles)
    return source, target, garter, pair, found


def wrong_match(found, level):
    return stored_match.StoredMatch(
        found, np.ones(len(found.triangle)), (), verdict=zo.Verdict(level, "By shape.", "Look.")
    )


def middle_of_copy(report):
    return positions(bpy.data.objects[report["objects"]["Garter"]].data).mean(axis=0)


@pytest.mark.parametrize("level", [RED, AMBER, GREEN])
def test_joints_replace_an_uncertain_match_that_confuses_limbs(bodies, level):
    source, target, garter, pair, found = bodies
    stored_match.write(target.data, wrong_match(found, level), pair, {})
    report = api.dress(bpy.context, source, target, [garter])
    by_joints = [note for note in report["notes"] if note.startswith("The bodies were matched by their joints")]
    if level == GREEN:
        assert report["verdict"]["level"] == GREEN
        assert not by_joints
        return
    assert report["verdict"]["level"] == AMBER
    assert len(by_joints) == 1
    assert any("slid along limbs" in note for note in report["notes"])
    off = middle_of_copy(report) - BUILD * positions(garter.data).mean(axis=0)
    assert np.linalg.norm(off) < 0.05
    # The match of the shapes is still the stored one.
    assert stored_match.read(target.data, pair).verdict.level == level


@pytest.mark.parametrize("is_humanoid", [True, False])
def test_only_joints_save_a_new_match_that_is_probably_wrong(bodies, is_humanoid, monkeypatch):
    source, target, garter, _, found = bodies
    match = wrong_match(found, RED)

    async def find(*_):
        return FoundMatch(match, {}, 0.0, is_new=False, refused=match)

    def refuse(*_):
        raise RefusedMatchError("Refused.")

    monkeypatch.setattr(dress, "find_match", find)
    monkeypatch.setattr(dress, "store_and_stop", refuse)
    if is_humanoid:
        assert api.dress(bpy.context, source, target, [garter])["verdict"]["level"] == AMBER
        return
    for number, bone in enumerate(target.parent.data.bones):
        bone.name = f"Limb {number}"
    with pytest.raises(RefusedMatchError):
        api.dress(bpy.context, source, target, [garter])
    assert "Garter" in bpy.data.objects
    assert len([obj for obj in bpy.data.objects if obj.type == "MESH"]) == 3
