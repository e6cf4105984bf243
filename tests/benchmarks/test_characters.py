# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of characters: limbs from skeletons, figures from weights, and the reader of files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from creatures import LIMBS, Creature, creature
from mathutils import Vector

import zoomout_core as zo
from benchmarks.characters import pictures, table
from benchmarks.characters.cases import Case, cases
from benchmarks.characters.figures import figures, nearest_in_space, wrong
from benchmarks.characters.game import one_skin, read_character
from benchmarks.characters.skeleton import Skeleton, limbs_of
from benchmarks.characters.truth import Bones, Rest
from blender_addon.demo.character import select_only
from blender_addon.mesh_data import read_weights

# Bones of the boy that is made here: name, parent, head. The left foot hangs from the root, as for an animator.
BONES = (
    ("Root", None, (0, 0, 0)),
    ("Hips", "Root", (0, 0, 1)),
    ("Chest", "Hips", (0, 0, 1.3)),
    ("Neck", "Chest", (0, 0, 1.6)),
    ("Ear.L", "Neck", (0.1, 0, 1.8)),
    ("Arm.L", "Chest", (0.2, 0, 1.5)),
    ("Hand.L", "Arm.L", (0.8, 0, 1.5)),
    ("Arm.R", "Chest", (-0.2, 0, 1.5)),
    ("Leg.L", "Hips", (0.2, 0, 0.9)),
    ("Shin.L", "Leg.L", (0.2, 0, 0.5)),
    ("Leg.L.001", "Hips", (-0.2, 0, 0.9)),
    ("Shin.R", "Leg.L.001", (-0.2, 0, 0.5)),
    ("Tail1", "Hips", (0, 0.2, 1)),
    ("Foot.L", "Root", (0.2, 0, 0.1)),
)


# --- limbs --------------------------------------------------------------------------------------------------


def test_limbs_follow_from_the_tree_and_the_names() -> None:
    names = tuple(name for name, *_ in BONES)
    parent = np.array([-1 if above is None else names.index(above) for _, above, _ in BONES])
    limbs = limbs_of(Skeleton(names, parent, np.array([head for *_, head in BONES], dtype=float)))
    limb, side = dict(zip(names, limbs.limb, strict=True)), dict(zip(names, limbs.side.tolist(), strict=True))
    assert {limb[name] for name in ("Root", "Hips", "Chest")} == {"torso"}
    assert {limb[name] for name in ("Neck", "Ear.L")} == {"head"}
    assert limb["Tail1"] == "tail"
    assert limb["Hand.L"] == limb["Arm.L"] != limb["Arm.R"]
    assert limb["Shin.L"] == limb["Leg.L"] == limb["Foot.L"]
    assert limb["Shin.R"] == limb["Leg.L.001"] != limb["Leg.L"]
    assert [side[name] for name in ("Hips", "Tail1", "Ear.L", "Hand.L", "Arm.R")] == [0, 0, 1, 1, -1]
    assert side["Leg.L.001"] == side["Shin.R"] == -1


def test_foot_joins_the_leg_with_a_similar_name() -> None:
    names = ("Body", "FrontLeg.L", "BackLeg.L", "BackFoot.L")
    head = np.array([[0, 0, 1], [0, 0, 0.5], [0, 3, 0.5], [0, 0, 0]], dtype=float)
    limbs = limbs_of(Skeleton(names, np.array([-1, 0, 0, -1]), head))
    assert limbs.limb == ("torso", "FrontLeg.L", "BackLeg.L", "BackLeg.L")


# --- figures ------------------------------------------------------------------------------------------------


@pytest.fixture
def fan() -> Case:
    """A fan of four triangles, of itself: the middle is the torso, the ends arms of two bones a side, one unknown."""
    surface = zo.Surface(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [-1, 1, 0], [-2, 1, 0], [0, 2, 0]], [[0, 1, 2], [0, 3, 4], [0, 1, 5]]
    )
    weights = np.eye(6, 5, dtype=np.float32)
    bones = ("torso", "upper.L", "lower.L", "upper.R", "lower.R")
    truth = Bones(bones, np.array([0, 1, 1, 2, 2]), ("torso", "L", "R"), np.array([0, 1, 1, -1, -1]), weights, weights)
    return Case("pose", "fan", surface, surface, truth)


def test_bones_limbs_and_sides_are_counted(fan: Case) -> None:
    # The torso is right; one arm is on its other bone, the other on both bones of the wrong side.
    found = figures(fan, zo.SurfaceMap.from_vertices([0, 2, 1, 1, 2, 0], fan.source))
    assert found[:4] == pytest.approx((1 / 5, 3 / 5, 2 / 4, 8 / 5))
    assert not found.right
    right = figures(fan, zo.SurfaceMap.from_vertices(np.arange(6), fan.source))
    assert right[:4] == (1, 1, 0, 0)
    assert right.right
    assert wrong(fan, zo.SurfaceMap.from_vertices([0, 2, 1, 1, 2, 0], fan.source)).tolist() == [0, 0, 0, 1, 1, 0]


def test_limb_missing_from_source_is_not_counted(fan: Case) -> None:
    assert isinstance(fan.truth, Bones)
    armless = fan.truth.source * [1, 1, 1, 0, 0]
    case = replace(fan, truth=replace(fan.truth, source=armless))
    found = figures(case, zo.SurfaceMap.from_vertices([0, 1, 2, 3, 4, 0], fan.source))
    assert found[:3] == (1, 1, 0)


def test_errors_at_rest_are_in_centimetres(fan: Case) -> None:
    none = np.zeros(6, dtype=np.int64)
    rest = fan.source.vertices
    case = replace(fan, truth=Rest(rest, rest + np.array([0, 0, 3]), 0.5, none, none))
    found = figures(case, zo.SurfaceMap.from_vertices(np.arange(6), fan.source))
    assert (found.error, found.median) == pytest.approx((6, 6))
    assert found.right


def test_nearest_in_space_equals_data_transfer_of_blender() -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    one, other = creature(300, 0), creature(200, 1, bend=0.4)
    weights = np.clip(np.random.default_rng(0).random((300, 3)), 0.1, 1)
    source, target = _mesh_object(one.surface), _mesh_object(other.surface)
    for column in range(3):
        group = source.vertex_groups.new(name=str(column))
        for vertex, weight in enumerate(weights[:, column].tolist()):
            group.add((vertex,), weight, "REPLACE")
    select_only(source, target)
    bpy.ops.object.data_transfer(
        data_type="VGROUP_WEIGHTS",
        vert_mapping="POLYINTERP_NEAREST",
        layers_select_src="ALL",
        layers_select_dst="NAME",
    )
    ours = nearest_in_space(_case(one, other)).interpolate(weights)
    np.testing.assert_allclose(read_weights(target, target.data).values.toarray(), ours, atol=1e-4)


# --- the table ----------------------------------------------------------------------------------------------


def test_cases_become_rows_and_a_summary(tmp_path: Path) -> None:
    bent = creature(700, 1, bend=0.9)
    turned = bent.surface.with_vertices(bent.surface.vertices[:, [1, 2, 0]])
    case = _case(creature(900, 0), replace(bent, surface=turned))
    row, result = table.measure(case)
    assert row["limb"] > 0.95
    assert row["DT limb"] < 0.5
    assert row["right"]
    assert not row["behind"]
    assert row["parts"] == "1 1"
    failed = row | {"kind": "other", "limb": 0.4, "certainty": 0.95, "right": False, "behind": True}
    of_pose, of_other, of_all = table.summary([row, failed])
    assert (of_pose["cases"], of_other["cases"], of_all["cases"]) == (1, 1, 2)
    assert (of_all["right"], of_all["behind DT"]) == (1, 1)
    assert of_other["certain and wrong"] == 1
    assert of_all["worst limb"] == 0.4
    pictures.draw(tmp_path / "worst.png", [pictures.Picture(row, case, result)])
    assert (tmp_path / "worst.png").stat().st_size > 10_000


# --- files --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pack of two boys made of boxes, one for each bone, whose action lifts an arm."""
    folder = tmp_path_factory.mktemp("characters")
    pack = folder / "game" / "boys_pack"
    pack.mkdir(parents=True)
    for name, width in (("Thick", 0.1), ("Thin", 0.08)):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        _boy(width)
        bpy.ops.export_scene.gltf(filepath=str(pack / f"{name}.glb"), export_format="GLB")
    return folder


def test_a_file_gives_the_rest_and_the_frame_that_differs_most(folder: Path) -> None:
    boy = read_character(folder / "game" / "boys_pack" / "Thick.glb")
    assert (boy.pack, boy.name) == ("boys", "Thick")
    assert "20" in boy.pose
    assert len(boy.thinned.triangles) < len(boy.rest.triangles) == len(boy.posed.triangles)
    moved = np.linalg.norm(boy.posed.vertices - boy.rest.vertices, axis=1)
    arm = boy.rest.weights[:, [boy.skeleton.names.index(name) for name in ("Arm.L", "Hand.L")]].sum(axis=1) > 0.5
    assert moved[arm].mean() > 0.2
    assert moved[~arm].max() < 1e-4
    np.testing.assert_allclose(boy.thinned.weights.sum(axis=1), 1, atol=1e-5)


def test_one_skin_keeps_weights(folder: Path) -> None:
    boy = read_character(folder / "game" / "boys_pack" / "Thick.glb")
    skin = one_skin(boy.posed)
    assert zo.Surface(skin.vertices, skin.triangles).components.max() == 0
    np.testing.assert_allclose(skin.weights.sum(axis=1), 1, atol=1e-5)


def test_each_kind_of_case_is_made(folder: Path) -> None:
    made = list(cases(folder, None))
    assert [case.kind for case in made] == ["pose"] * 2 + ["skin"] * 2 + ["other"] * 4
    assert made[4].name == "boys Thick to Thin, rest"
    for case in made:
        assert isinstance(case.truth, Bones)
        assert case.truth.source.shape == (len(case.source.vertices), len(case.truth.names))
        assert case.truth.target.shape == (len(case.target.vertices), len(case.truth.names))
        assert {"torso", "head", "tail"} < set(case.truth.limb_names)
    # Another boy at rest covers the first.
    assert figures(made[4], nearest_in_space(made[4])).limb == pytest.approx(1, abs=0.1)
    assert len(list(cases(folder, 1))) == 3


# --- what is made here --------------------------------------------------------------------------------------


def _case(source: Creature, target: Creature) -> Case:
    """A pair of creatures with a bone for each limb."""
    names = ("arm.L", "arm.R", "leg.L", "leg.R", "head", "tail")
    side = np.array([1, -1, 1, -1, 0, 0])
    bones = Bones(names, np.arange(6), names, side, _weights_of(source), _weights_of(target))
    return Case("pose", "creature", source.surface, target.surface, bones)


def _weights_of(one: Creature) -> np.ndarray:
    axes = LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True)
    return np.eye(len(axes))[np.argmax(one.directions @ axes.T, axis=1)]


def _mesh_object(surface: zo.Surface) -> bpy.types.Object:
    mesh = bpy.data.meshes.new("creature")
    mesh.from_pydata(surface.vertices, [], surface.triangles)
    obj = bpy.data.objects.new("creature", mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _boy(width: float) -> None:
    """An armature with an action, and one object with a skinned ball for each bone."""
    armature = bpy.data.objects.new("Armature", bpy.data.armatures.new("Armature"))
    bpy.context.scene.collection.objects.link(armature)
    select_only(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    for name, parent, head in BONES:
        bone = armature.data.edit_bones.new(name)
        bone.head, bone.tail = head, Vector(head) + Vector((0, 0, 0.2))
        bone.parent = None if parent is None else armature.data.edit_bones[parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    balls = []
    for name, _, head in BONES:
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3, radius=width, location=head)
        ball = bpy.context.object
        group = ball.vertex_groups.new(name=name)
        group.add(list(range(len(ball.data.vertices))), 1, "REPLACE")
        balls.append(ball)
    select_only(*balls)
    bpy.context.view_layer.objects.active = balls[0]
    bpy.ops.object.join()
    balls[0].parent = armature
    balls[0].modifiers.new("Armature", "ARMATURE").object = armature
    arm = armature.pose.bones["Arm.L"]
    arm.rotation_mode = "XYZ"
    for frame, angle in ((0, 0.0), (20, 1.2)):
        arm.rotation_euler = (0, 0, angle)
        arm.keyframe_insert("rotation_euler", frame=frame)
