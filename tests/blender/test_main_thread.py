# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's data is accessed only on the main thread, while operators compute in other threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import sleep
from types import FrameType, ModuleType
from typing import Any

import bmesh
import bpy
import numpy as np
import pytest
from rigged import pose_target, source_and_rig
from scenes import activate, add_attribute, add_uv_map, ellipsoid, new_material, positions, set_weights
from symmetric import LEFT, RIGHT, add_key, bumps, new_object
from true_match import keep_true_match

import blender_addon
from blender_addon import api, mesh_data
from blender_addon.jobs import Job, Work, compute
from blender_addon.operators.base import modal_operator
from blender_addon.scene import mesh_facts

ADDON = str(Path(blender_addon.__file__).parent)
LOOKED_AT = (ADDON, __file__)
BLENDER_TYPES = (
    bpy.types.bpy_struct,
    bpy.types.bpy_prop_collection,
    bpy.types.bpy_prop_array,
    *(kind for kind in vars(bmesh.types).values() if isinstance(kind, type)),
)
BLENDER_MODULES = ("bpy", "bmesh", "_bpy", "_bmesh")
# Depth of the search for Blender's data within what a function is given, and in how much of it.
DEPTH, WIDTH = 4, 20


class Watch:
    """Records accesses of Blender's data by other threads than the main one.

    Attributes:
        offences: places that access Blender's data or have references to it.
        frames: number of calls of the add-on's functions.
    """

    def __init__(self) -> None:
        self.offences: list[str] = []
        self.frames = 0

    def __call__(self, frame: FrameType, event: str, called: Any) -> None:
        looked_at = frame.f_code.co_filename.startswith(LOOKED_AT)
        if event == "c_call" and is_blenders(getattr(called, "__self__", None)):
            self._note(frame, f"calls {called.__qualname__}")
        elif event == "call" and looked_at:
            self.frames += 1
            for name in {*frame.f_code.co_names} & frame.f_globals.keys():
                if is_blenders(frame.f_globals[name]):
                    self._note(frame, f"uses {name}")
            self._look_at(frame)
        elif event == "return" and looked_at:
            self._look_at(frame)

    def _look_at(self, frame: FrameType) -> None:
        for name, value in list(frame.f_locals.items()):
            if holds_blenders(value, DEPTH):
                self._note(frame, f"holds {name}")

    def _note(self, frame: FrameType, what: str) -> None:
        self.offences.append(f"{frame.f_code.co_qualname} {what}")


def is_blenders(value: Any) -> bool:
    if isinstance(value, ModuleType):
        return value.__name__.split(".")[0] in BLENDER_MODULES
    return isinstance(value, BLENDER_TYPES)


def holds_blenders(value: Any, depth: int) -> bool:
    """Whether a value is Blender's, or refers to one that is."""
    if is_blenders(value):
        return True
    if depth == 0:
        return False
    if isinstance(value, dict):
        inner = list(value.values())
    elif isinstance(value, (list, tuple, set, frozenset)):
        inner = list(value)
    elif type(value).__module__.startswith("blender_addon"):
        inner = list(vars(value).values()) if hasattr(value, "__dict__") else []
    else:
        return False
    return any(holds_blenders(one, depth - 1) for one in inner[:WIDTH])


@contextmanager
def watched_threads() -> Iterator[Watch]:
    watch = Watch()
    threading.setprofile(watch)
    try:
        yield watch
    finally:
        threading.setprofile(None)


def as_in_a_window(coroutine: Work[Any]) -> Any:
    """Run a coroutine in slices, like ticks of a window's timer."""
    job = Job(coroutine)
    while not job.advance(modal_operator.SLICE):
        sleep(0.001)
    return job.result


@pytest.fixture
def scene(monkeypatch):
    """A matched source and target with all kinds of data, each in its own collection."""
    monkeypatch.setattr(modal_operator, "run", as_in_a_window)
    source, target = ellipsoid("Source", 3), ellipsoid("Target", 3)
    for obj in (source, target):
        x, count = positions(obj.data)[:, 0], len(obj.data.vertices)
        set_weights(obj, "Arm.L", (x > 0.3).astype(float))
        set_weights(obj, "Arm.R", (x < -0.3).astype(float))
        add_uv_map(obj.data, "Atlas")
        add_attribute(obj.data, "Number", "FLOAT", "POINT", np.arange(count))
        obj.data.materials.append(new_material("Skin"))
        obj.data.materials.append(new_material("Cloth"))
        obj.data.polygons.foreach_set("material_index", np.arange(len(obj.data.polygons)) % 2)
        obj.data.edges[3].use_edge_sharp = True
        obj.shape_key_add(name="Basis")
        obj.shape_key_add(name="Smile").points[7].co.z += 0.1
        collection = bpy.data.collections.new(f"{obj.name}s")
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(obj)
    layer = source.data.uv_layers["Atlas"].data
    for polygon in source.data.polygons:  # two islands
        for corner in polygon.loop_indices:
            layer[corner].uv.x += 2 * (polygon.center.x > 0.1)
    source.data.normals_split_custom_set(np.tile([0.6, 0, 0.8], (len(source.data.loops), 1)).tolist())
    bpy.context.view_layer.update()
    keep_true_match(target, doubtful=5)
    settings = bpy.context.scene.zoomout
    settings.source, settings.k_final = source, 30
    settings.source_collection = bpy.data.collections["Sources"]
    settings.target_collection = bpy.data.collections["Targets"]
    activate(target)
    return source, target


def match_again() -> None:
    bpy.ops.zoomout.match()
    bpy.ops.zoomout.match(redo_group="Arm.L")


def match_several() -> None:
    activate(bpy.data.objects["Target"], ellipsoid("Other", 3))
    bpy.ops.zoomout.match()


def swap_candidates() -> None:
    bpy.ops.zoomout.match()
    bpy.ops.zoomout.preview(kind="PLACES")
    bpy.ops.zoomout.use_candidate()


def previews() -> None:
    for kind in ("PLACES", "CONFIDENCE", "CHECKER"):
        bpy.ops.zoomout.preview(kind=kind)


def select() -> None:
    bpy.ops.zoomout.select_doubtful()
    bpy.ops.zoomout.select_flipped()


def bend() -> None:
    for name, vertex in (("Source", 12), ("Target", 13)):
        api.set_landmark(bpy.context, bpy.data.objects[name], 1, vertex)
    bpy.ops.zoomout.bend_match()


def wrap() -> None:
    bpy.ops.zoomout.wrap(wrap_result="OBJECT")
    bpy.ops.zoomout.wrap(wrap_reverse=True)


def dress() -> None:
    hat = ellipsoid("Hat", 1)
    hat.location.z = 1
    bpy.context.view_layer.update()
    activate(bpy.data.objects["Target"], hat)
    bpy.ops.zoomout.dress()


def bind() -> None:
    source, armature = source_and_rig(around=8, along=25)
    source.name = "Rigged"
    target, _ = pose_target(source, armature, around=7, along=20)
    bpy.context.scene.zoomout.source = source
    activate(target)
    bpy.ops.zoomout.bind_to_rig(initial="NEAREST")


def look_at_meshes() -> None:
    mesh_facts.facts(bpy.data.objects["Target"])
    as_in_a_window(mesh_facts._inspections())


def symmetries() -> None:
    body = new_object()
    activate(body)
    bpy.ops.zoomout.detect_symmetry()
    add_uv_map(body.data, "Atlas")
    set_weights(body, "Arm.L", LEFT * 0.7)
    set_weights(body, "Arm.R", RIGHT * 0.3)
    add_key(body, "Smile", bumps(LEFT * 1.0))
    for kind in ("PAIRS", "SIDES"):
        bpy.ops.zoomout.preview(kind=kind)
    bpy.ops.zoomout.symmetrise_weights()
    bpy.ops.zoomout.mirror_shape_key(key="Smile", key_mode="SPLIT")
    bpy.ops.zoomout.mirror_attributes()
    for check in ("SHAPE", "WEIGHTS", "KEY"):
        bpy.ops.zoomout.check_symmetry(check=check)
    mesh_data.move_vertices(body.data, bumps(LEFT * 1.0))
    bpy.ops.zoomout.mirror_sculpt()


# Operations, and the minimum number of the add-on's functions that they call in threads.
OPERATIONS: dict[str, tuple[Callable[[], object], int]] = {
    "match": (match_again, 1),
    "match several": (match_several, 0),
    "match by nearest points": (lambda: bpy.ops.zoomout.match(initial="NEAREST"), 0),
    "match by the same order": (lambda: bpy.ops.zoomout.match(initial="SAME_ORDER"), 1),
    "candidates": (swap_candidates, 0),
    "previews": (previews, 1),
    "transfer": (lambda: bpy.ops.zoomout.transfer(shape=True), 20),
    "cut seams": (lambda: bpy.ops.zoomout.cut_seams(), 0),
    "select": (select, 2),
    "bend": (bend, 1),
    "wrap": (wrap, 2),
    "dress": (dress, 1),
    "bind": (bind, 2),
    "collections": (lambda: bpy.ops.zoomout.match_collections(), 1),
    "facts": (look_at_meshes, 1),
    "symmetries": (symmetries, 5),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_threads_do_not_access_blender_data(scene, name):
    work, least = OPERATIONS[name]
    with watched_threads() as watch:
        work()
    assert watch.offences == []
    assert watch.frames >= least


def update(mesh):
    mesh.update()


def names_of_meshes():
    return [mesh.name for mesh in bpy.data.meshes]


def first_name(things):
    return things[0][0].name


@pytest.mark.parametrize(
    ("offender", "offence"),
    [
        (lambda obj: mesh_data.read_positions(obj.data), "read_positions holds mesh"),
        (lambda obj: names_of_meshes(), "names_of_meshes uses bpy"),
        (lambda obj: update(obj.data), "update holds mesh"),
        (lambda obj: len(np.fromiter(obj.keys(), object)), "calls Object.keys"),
        (lambda obj: first_name([(obj,)]), "first_name holds things"),
    ],
)
def test_access_from_threads_would_be_noticed(scene, offender, offence):
    source, _ = scene
    with watched_threads() as watch:
        as_in_a_window(compute(lambda: offender(source)))
    assert any(one.endswith(offence) for one in watch.offences), watch.offences
