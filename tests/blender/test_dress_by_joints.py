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


def rigged_mannequin(name, build, seed=0, without=()):
    """A mannequin of a build with its own armature, and the part of each vertex."""
    made = mannequin(seed=seed, build=tuple(build), without=without)
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


def cloth_around(name, part, armature):
    """Cloth around a part of a mannequin at rest, bound to its bone."""
    whole = mannequin()
    chosen = whole.part == part
    middle = whole.surface.vertices[chosen].mean(axis=0)
    triangles = whole.surface.triangles[chosen[whole.surface.triangles].all(axis=1)]
    places = middle + 1.1 * (whole.surface.vertices[chosen] - middle)
    cloth = mesh_object(name, zo.Surface(places, (np.cumsum(chosen) - 1)[triangles]))
    set_weights(cloth, bone_of(part), np.ones(chosen.sum()))
    bind(cloth, armature)
    return cloth


@pytest.fixture
def bodies():
    """A body with a garter on the left thigh, another one, and a match that exchanges its sides."""
    source, armature, _ = rigged_mannequin("Source", np.ones(3))
    garter = cloth_around("Garter", "thigh.L", armature)
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


def test_bones_place_clothes_without_skin_below_them():
    """Legs of trousers follow the target's legs, though the source has none."""
    legs = "thigh.L", "thigh.R", "shin.L", "shin.R"
    source, armature, _ = rigged_mannequin("Source", np.ones(3), without=legs)
    clothes = [cloth_around(f"Cloth {part}", part, armature) for part in legs]
    target, _, of_target = rigged_mannequin("Target", BUILD, seed=3)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    nearest = closest_points(pair.target.vertices / BUILD, pair.source.vertices, pair.source.triangles)
    stored_match.write(target.data, wrong_match(zo.SurfaceMap(*nearest, pair.source.triangles), AMBER), pair, {})
    report = api.dress(bpy.context, source, target, clothes)
    assert report["verdict"]["level"] == AMBER
    assert any("of the clothes have no skin below them" in note for note in report["notes"])
    for part in legs:
        copy = bpy.data.objects[report["objects"][f"Cloth {part}"]]
        off = positions(copy.data).mean(axis=0) - positions(target.data)[of_target == part].mean(axis=0)
        assert np.linalg.norm(off) < 0.05
        bound = [copy.vertex_groups[group.group].name for vertex in copy.data.vertices for group in vertex.groups]
        assert bone_of(part) in bound
