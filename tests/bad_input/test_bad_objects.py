# SPDX-License-Identifier: GPL-3.0-or-later
"""Unusable or difficult objects in Blender: either a sentence and nothing written, or a correct transfer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import bpy
import numpy as np
import pytest
from creatures import creature
from mathutils import Matrix

import blender_addon
import zoomout_core as zo
from blender_addon import api

Object = bpy.types.Object
# How objects are matched: by shape, where the place is another one, and by place, which takes less time.
HOW, NEAREST = {"detail": "fast", "partial": "off"}, {"initial": "nearest"}


@pytest.fixture(autouse=True)
def scene() -> Iterator[None]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with blender_addon.registered():
        yield


def added(name: str, vertices: np.ndarray, faces: list[list[int]], edges: tuple[tuple[int, int], ...] = ()) -> Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), list(edges), faces)
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def body(name: str, seed: int) -> Object:
    surface = creature(200, seed=seed).surface
    return added(name, surface.vertices, surface.triangles.tolist())


def in_place(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Object], None]:
    """A function that changes the positions of an object's vertices."""

    def changed(obj: Object) -> None:
        points = np.empty((len(obj.data.vertices), 3), np.float32)
        obj.data.vertices.foreach_get("co", points.ravel())
        obj.data.vertices.foreach_set("co", change(points).astype(np.float32).ravel())
        obj.data.update()

    return changed


def with_values(number: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def changed(points: np.ndarray) -> np.ndarray:
        points[number] = value
        return points

    return changed


def replaced(vertices: list[list[float]], faces: list[list[int]]) -> Callable[[Object], None]:
    """A function that gives an object another mesh."""

    def changed(obj: Object) -> None:
        mesh = bpy.data.meshes.new("Other")
        mesh.from_pydata(vertices, [], faces)
        obj.data = mesh

    return changed


def scaled(*scale: float) -> Callable[[Object], None]:
    return lambda obj: setattr(obj, "scale", scale)


def linked_twice(obj: Object) -> None:
    bpy.context.scene.objects["Source"].data = obj.data


def masked_away(obj: Object) -> None:
    obj.vertex_groups.new(name="None")
    obj.modifiers.new("Mask", "MASK").vertex_group = "None"


def with_nodes(obj: Object) -> None:
    obj.modifiers.new("Nodes", "NODES")  # of no node group


# Changes to the target, and the error that names them; empty if the target is matched as usual.
TARGETS: dict[str, tuple[Callable[[Object], None], str]] = {
    "a vertex that is not a number": (in_place(with_values(7, np.nan)), "not finite"),
    "a vertex at infinity": (in_place(with_values(7, np.inf)), "not finite"),
    "no extent": (in_place(lambda points: points * 0), "no area"),
    "on a line": (in_place(lambda points: points * [1, 0, 0]), "no area"),
    "a scale of zero": (scaled(0, 0, 0), "scale of zero: change that scale"),
    "a scale of zero in two directions": (scaled(1, 0, 0), "scale of zero: change that scale"),
    "a flat scale": (scaled(1, 1, 0), ""),
    "a tiny scale": (scaled(1e-12, 1e-12, 1e-12), ""),
    "a huge scale": (scaled(1e12, 1e12, 1e12), ""),
    "a mirrored scale": (scaled(-1, 1, 1), ""),
    "vertices alone": (replaced([[0, 0, 0], [1, 0, 0]], []), "no faces"),
    "nothing": (replaced([], []), "no faces"),
    "one triangle": (replaced([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), "too few"),
    "the mesh of the source": (linked_twice, "share one mesh"),
    "turned over by a matrix": (lambda obj: setattr(obj, "matrix_world", Matrix.Diagonal((1, 1, -1, 1))), ""),
    "hidden by a mask": (masked_away, ""),
    "nodes without a group": (with_nodes, ""),
    "disabled in the viewport": (lambda obj: setattr(obj, "hide_viewport", True), "disabled in the viewport"),
    "an animated name with quotes": (lambda obj: setattr(obj, "name", 'Target\'s "one"'), ""),
}


# Of these, the place is that of the source.
IN_PLACE = ("hidden by a mask", "nodes without a group", "an animated name with quotes")


def outcome(target: Object, how: dict[str, str]) -> str:
    """The error message of a group's transfer, if it fails."""
    before = len(target.vertex_groups), len(target.data.attributes), len(bpy.data.objects), len(bpy.data.meshes)
    source = bpy.data.objects["Source"]
    try:
        api.transfer_objects(bpy.context, source, target, ["vertex_groups"], force=True, **how)
    except zo.MeshError as error:
        assert before == (
            len(target.vertex_groups),
            len(target.data.attributes),
            len(bpy.data.objects),
            len(bpy.data.meshes),
        )
        return str(error)
    return ""


@pytest.mark.parametrize("name", TARGETS)
def test_odd_target_is_matched_or_refused_in_a_sentence(name: str) -> None:
    source, target = body("Source", 0), body("Target", 1)
    source.vertex_groups.new(name="Bone").add(range(200), 1.0, "REPLACE")
    change, said = TARGETS[name]
    change(target)
    bpy.context.view_layer.update()
    found = outcome(target, NEAREST if name in IN_PLACE else HOW)
    assert said in found if said else not found
    assert not found or (found.endswith(".") and "\n" not in found)
    if not found:
        assert "Bone" in target.vertex_groups
        weights = [target.vertex_groups["Bone"].weight(vertex) for vertex in range(200)]
        np.testing.assert_allclose(weights, 1, atol=1e-3)


# Calls of a script with wrong arguments, and the error messages.
CALLS: dict[str, tuple[Callable[[Object, Object], object], str]] = {
    "no object": (lambda source, _: api.match_objects(bpy.context, source, None), "None is not an object: give one"),
    "a name": (lambda _, target: api.wrap(bpy.context, "Source", target), "'Source' is not an object: give one"),
    "a mesh": (lambda source, _: api.bake_textures(bpy.context, source.data), "is not an object: give one"),
    "no armature": (lambda *pair: api.move_armature(bpy.context, None, *pair), "None is not an object: give one"),
    "data in words": (lambda *pair: api.transfer_objects(bpy.context, *pair, "uv_maps"), "give a list of kinds"),
    "an unknown detail": (lambda *pair: api.match_objects(bpy.context, *pair, detail="huge"), "detail is 'huge'"),
    "a size in words": (lambda *pair: api.match_objects(bpy.context, *pair, k_final="large"), "k_final is 'large'"),
    "an unknown side": (lambda source, _: api.detect_symmetry(bpy.context, source, left="Q"), "left is 'Q'"),
    "half a vertex": (lambda source, _: api.set_landmark(bpy.context, source, 1, 1.5), "has no vertex 1.5"),
    "landmark 0": (lambda source, _: api.set_landmark(bpy.context, source, 0, 1), "number is 0"),
    "a landmark on nothing": (lambda *_: api.set_landmark(bpy.context, None, 1, 1), "None is not an object"),
    "no data": (lambda *pair: api.transfer_objects(bpy.context, *pair, None), "The data is None"),
    "settings of a dictionary": (
        lambda *pair: api.transfer_objects(bpy.context, *pair, settings={"factor": 1}),
        "The settings are {'factor': 1}: give an object",
    ),
    "one object as clothes": (lambda *pair: api.dress(bpy.context, *pair, pair[0]), "is not a list of objects"),
    "no clothes": (lambda *pair: api.dress(bpy.context, *pair, None), "None is not a list of objects"),
    "an unknown way to mirror": (
        lambda source, _: api.mirror_shape_key(bpy.context, source, "Up", mode="odd"),
        "mode is 'odd': choose one of mirror, split, symmetrise",
    ),
    "one folder": (
        lambda source, _: api.find_source(bpy.context, source, "here"),
        "The folders are 'here': give a list",
    ),
    "no file to append": (lambda *_: api.append_source(bpy.context, None), "not as a NoneType"),
    "a huge landmark": (lambda source, _: api.set_landmark(bpy.context, source, 2**31, 1), "has the number 2147483648"),
    "a number as a name": (lambda source, _: api.set_landmark(bpy.context, source, 1, 1, 5), "and the name 5"),
    "a level in words": (
        lambda source, _: api.make_levels(bpy.context, source, api.LevelChoice(("half",))),
        "A level cannot have 'half' of 200 vertices",
    ),
    "no levels": (lambda source, _: api.make_levels(bpy.context, source, api.LevelChoice(())), "No levels are given"),
}


@pytest.mark.parametrize("name", CALLS)
def test_wrong_arguments_of_scripts_raise_one_sentence(name: str) -> None:
    call, said = CALLS[name]
    with pytest.raises((TypeError, ValueError), match=rf"{said}[^\n]*\.$"):
        call(body("Source", 0), body("Target", 1))


CONTEXTLESS: dict[str, Callable[[Any, Object, Object], object]] = {
    "match_objects": lambda context, *pair: api.match_objects(context, *pair),
    "transfer_objects": lambda context, *pair: api.transfer_objects(context, *pair),
    "bind_to_rig": lambda context, *pair: api.bind_to_rig(context, *pair),
    "move_rig": lambda context, *pair: api.move_rig(context, *pair),
    "move_armature": lambda context, *pair: api.move_armature(context, pair[0], *pair),
    "add_bones": lambda context, *pair: api.add_bones(context, *pair, "Bone"),
    "wrap": lambda context, *pair: api.wrap(context, *pair),
    "dress": lambda context, *pair: api.dress(context, *pair, [pair[0]]),
    "bake_textures": lambda context, _, target: api.bake_textures(context, target),
    "keep_linked": lambda context, _, target: api.keep_linked(context, target),
    "make_levels": lambda context, source, _: api.make_levels(context, source),
    "check_motion": lambda context, _, target: api.check_motion(context, target),
    "detect_symmetry": lambda context, source, _: api.detect_symmetry(context, source),
    "check_symmetry": lambda context, source, _: api.check_symmetry(context, source),
    "set_landmark": lambda context, source, _: api.set_landmark(context, source, 1, 1),
    "landmark_pairs": lambda context, *pair: api.landmark_pairs(context, *pair),
    "find_source": lambda context, _, target: api.find_source(context, target, ["."]),
    "append_source": lambda context, *_: api.append_source(context, "a.blend"),
    "match_collections": lambda context, *_: api.match_collections(
        context, bpy.context.scene.collection, bpy.context.scene.collection
    ),
}


@pytest.mark.parametrize("context", [None, "context"])
@pytest.mark.parametrize("name", CONTEXTLESS)
def test_a_context_that_is_not_blenders_is_named(name: str, context: object) -> None:
    with pytest.raises(TypeError, match=rf"The context is {context!r}: give Blender's, bpy.context\."):
        CONTEXTLESS[name](context, body("Source", 0), body("Target", 1))


def test_refused_landmark_adds_nothing() -> None:
    with pytest.raises(ValueError, match="has the number"):
        api.set_landmark(bpy.context, body("Source", 0), 2**31, 1)
    assert not bpy.context.scene.zoomout.landmarks


def test_landmark_in_another_scene_is_named() -> None:
    source = body("Source", 0)
    bpy.data.scenes.new("Other").collection.objects.link(source)
    bpy.context.scene.collection.objects.unlink(source)
    with pytest.raises(zo.MeshError, match="There is no object 'Source' in the scene"):
        api.set_landmark(bpy.context, source, 1, 1)


def test_armature_modifier_without_armature_is_named() -> None:
    source, target = body("Source", 0), body("Target", 0)
    source.modifiers.new("Armature", "ARMATURE")
    with pytest.raises(zo.MeshError, match="Armature modifier of 'Source' has no object"):
        api.bind_to_rig(bpy.context, source, target, **NEAREST)


def test_removed_object_is_named() -> None:
    source, target = body("Source", 0), body("Target", 1)
    bpy.data.objects.remove(target)
    with pytest.raises(zo.MeshError, match="was removed from the file: find it"):
        api.transfer_objects(bpy.context, source, target)


def test_scale_set_by_a_script_is_seen_by_bind_to_rig() -> None:
    source, target = body("Source", 0), body("Target", 0)
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones.new("Bone").tail = 0, 0, 1
    bpy.ops.object.mode_set(mode="OBJECT")
    source.vertex_groups.new(name="Bone").add(range(200), 1.0, "REPLACE")
    source.modifiers.new("Armature", "ARMATURE").object = source.parent = rig
    rig.scale = -1, 2, 1
    api.bind_to_rig(bpy.context, source, target, **NEAREST)
    assert target.parent == rig


def locked_group(source: Object, target: Object) -> None:
    source.vertex_groups.new(name="Bone").add(range(200), 1.0, "REPLACE")
    target.vertex_groups.new(name="Bone").lock_weight = True


def absolute_keys(source: Object, _: Object) -> None:
    source.shape_key_add(name="Basis")
    source.shape_key_add(name="Up")
    source.data.shape_keys.use_relative = False


def locked_key(source: Object, target: Object) -> None:
    for obj in (source, target):
        for name in ("Basis", "Up"):
            obj.shape_key_add(name=name)
    target.data.shape_keys.key_blocks["Up"].lock_shape = True


def test_locked_shape_key_stays_as_it_is() -> None:
    source, target = body("Source", 0), body("Target", 0)
    locked_key(source, target)
    source.shape_key_add(name="Down").data[0].co.z -= 1
    source.data.shape_keys.key_blocks["Up"].data[0].co.z += 1
    report = api.transfer_objects(bpy.context, source, target, ["shape_keys"], **NEAREST)
    assert report["written"]["shape_keys"] == ["Down"]
    assert report["skipped"] == {"Up": "the target's shape key is locked"}
    basis, up, down = target.data.shape_keys.key_blocks
    assert up.data[0].co == basis.data[0].co
    assert down.data[0].co.z < basis.data[0].co.z


@pytest.mark.parametrize(
    ("change", "data", "said"),
    [
        (locked_key, "shape_keys", "Up: skipped, the target's shape key is locked."),
        (locked_group, "vertex_groups", "Bone: skipped, the target's vertex group is locked."),
        (absolute_keys, "shape_keys", "those of 'Source' are absolute: turn on Relative in its shape keys."),
    ],
)
def test_reasons_are_given_if_all_data_is_skipped(
    change: Callable[[Object, Object], None], data: str, said: str
) -> None:
    source, target = body("Source", 0), body("Target", 0)
    change(source, target)
    with pytest.raises(zo.MeshError, match=f"None of the data can be transferred. .*{said}$"):
        api.transfer_objects(bpy.context, source, target, [data], **NEAREST)


def test_modifiers_that_leave_no_faces_are_named() -> None:
    source, target = body("Source", 0), body("Target", 0)
    source.vertex_groups.new(name="Bone")
    masked_away(source)
    with pytest.raises(zo.MeshError, match=r"'Source' cannot be used. Its modifiers leave no faces: turn them off"):
        api.transfer_objects(bpy.context, source, target, ["vertex_groups"], **NEAREST)


def flat_source(obj: Object) -> None:
    obj.scale = 1, 1, 0
    obj.data.normals_split_custom_set(np.tile([0.6, 0, 0.8], (len(obj.data.loops), 1)).tolist())


def with_broken_key(obj: Object) -> None:
    obj.shape_key_add(name="Basis")
    obj.shape_key_add(name="Up").data[3].co = np.nan, 0, 0


def test_target_with_a_broken_loose_vertex_gets_all_data() -> None:
    source, target = body("Source", 0), body("Target", 0)
    source.shape_key_add(name="Basis")
    source.shape_key_add(name="Up").data[3].co.z += 1
    target.data.vertices.add(1)
    target.data.vertices[-1].co = (np.nan,) * 3
    report = api.transfer_objects(bpy.context, source, target, ["shape_keys", "custom_normals"], **NEAREST)
    assert report["written"]["shape_keys"] == ["Up"]
    moved = np.array([key.co[:] for key in target.data.shape_keys.key_blocks["Up"].data])
    assert np.isfinite(moved[:-1]).all()


# Changes to the source, the data to transfer, and the error; without one, the name of what is written.
SOURCES: dict[str, tuple[Callable[[Object], object], str, str, str]] = {
    "custom normals on a flat object": (flat_source, "custom_normals", "custom normals: skipped", ""),
    "weights that are not numbers": (
        lambda obj: obj.vertex_groups.new(name="Bone").add(range(200), float("nan"), "REPLACE"),
        "vertex_groups",
        "has no finite values",
        "",
    ),
    "values that are not numbers": (
        lambda obj: obj.data.attributes.new("Odd", "FLOAT", "POINT").data.foreach_set("value", np.full(200, np.nan)),
        "attributes",
        "'Odd' has no finite values",
        "",
    ),
    "values without end": (
        lambda obj: obj.data.attributes.new("Odd", "FLOAT", "POINT").data.foreach_set("value", np.full(200, np.inf)),
        "attributes",
        "'Odd' has no finite values",
        "",
    ),
    "a shape key that is not finite": (
        with_broken_key,
        "attributes",
        "'Source' cannot be used. Its shape key 'Up' is not finite",
        "",
    ),
    "a location that is not finite": (
        lambda obj: setattr(obj, "location", (np.nan, 0, 0)),
        "attributes",
        "'Source' cannot be used. Its location, rotation or scale is not finite",
        "",
    ),
    "nothing of what is asked for": (lambda obj: None, "uv_maps", "none of the data to transfer", ""),
    "a name of 63 letters": (
        lambda obj: obj.data.attributes.new("n" * 63, "FLOAT", "POINT"),
        "attributes",
        "",
        "n" * 63,
    ),
    "a name in another script": (lambda obj: obj.vertex_groups.new(name="骨🦴"), "vertex_groups", "", "骨🦴"),
}


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("name", SOURCES)
def test_odd_source_data_is_transferred_or_refused(name: str) -> None:
    source, target = body("Source", 0), body("Target", 0)
    change, data, error, written = SOURCES[name]
    change(source)
    bpy.context.view_layer.update()
    if error:
        with pytest.raises(zo.MeshError, match=f"{error}[^\n]*\\.$"):
            api.transfer_objects(bpy.context, source, target, [data], **NEAREST)
        assert not target.vertex_groups
        assert "Odd" not in target.data.attributes
    else:
        report = api.transfer_objects(bpy.context, source, target, [data], **NEAREST)
        assert written in report["written"][data]
        assert written in (target.vertex_groups if data == "vertex_groups" else target.data.attributes)
