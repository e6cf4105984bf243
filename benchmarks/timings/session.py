# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole session, press by press: from a new scene to a target that follows the source's animation.

Each workflow calls the operators of its buttons and menus, with the selection that they need. A press is a click,
a key (with its modifiers), or a drag.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any, NamedTuple

import bpy
import numpy as np
from bpy.types import Object

import zoomout_core as zo
from benchmarks.binding.cases import positions
from blender_addon import mesh_data, registered
from blender_addon.demo.character import build_character, select_only
from blender_addon.demo.target import POSE, clear_pose, posed_copy, remeshed, set_pose
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points

# Edge length of the character and voxel size of the scan, in metres, and number of the scan's vertices.
CELL, VOXEL, VERTICES = 0.0134, 0.0125, 14000
# Distance of the scan from the character in metres, and of keyframes in frames.
ASIDE, APART = 1.6, 10
OTHER_POSE = {name: (-0.7 * x, -0.7 * y, -0.7 * z) for name, (x, y, z) in POSE.items()}
# Frames in which the target is compared with the source, on and between keyframes.
FRAMES = (1, 1 + APART // 2, 1 + APART, 1 + APART + APART // 2, 1 + 2 * APART)

Row = dict[str, Any]


class Scene(NamedTuple):
    """A rigged and animated character, and beside it a scan of it in a pose, without any data."""

    source: Object
    rig: Object
    target: Object


class Press(NamedTuple):
    """A press, and the operator that it calls, if that takes time or changes anything."""

    what: str
    effect: Callable[[], Any] | None = None


def bind(scene: Scene) -> list[Press]:
    """With *Bind to Rig*."""
    settings = bpy.context.scene.zoomout
    return [
        *_begin(scene),
        Press("Check mark Bind to Rig", lambda: setattr(settings, "bind", True)),
        Press("Match and Transfer", bpy.ops.zoomout.transfer),
    ]


def parent(scene: Scene) -> list[Press]:
    """Without *Bind to Rig*: weights are transferred, and the target is parented by hand."""
    return [*_begin(scene), Press("Match and Transfer", bpy.ops.zoomout.transfer), *_parent(scene)]


def parent_in_its_shape(scene: Scene) -> list[Press]:
    """Without *Bind to Rig*, in the source's shape: the target's own proportions and detail are lost."""
    settings = bpy.context.scene.zoomout
    return [
        *_begin(scene),
        Press("Check mark Shape as Key", lambda: setattr(settings, "shape", True)),
        Press("Match and Transfer", bpy.ops.zoomout.transfer),
        Press("Tab Object Data of the properties"),
        Press("The key in the list"),
        Press("Its value, to 1", lambda: setattr(scene.target.data.shape_keys.key_blocks[-1], "value", 1.0)),
        *_parent(scene),
    ]


WAYS: dict[str, Callable[[Scene], list[Press]]] = {
    "Bind to Rig": bind,
    "weights, parented by hand": parent,
    "weights and shape, parented by hand": parent_in_its_shape,
}


def run() -> dict[str, list[Row]]:
    """Go through the session in each workflow.

    Returns:
        `rows`: for each workflow presses, seconds of work, and the distance of target and source surface while
        the animation runs, in percent of its height; `presses`: each press.
    """
    rows: list[Row] = []
    presses: list[Row] = []
    with registered():
        _press(bind(make_scene()), "")  # the first operation of a process takes longer
    for name, way in WAYS.items():
        with registered():
            zo.forget_shapes()
            scene = make_scene()
            pressed = _press(way(scene), name)
            off = distances(scene)
        total = sum(row["s"] for row in pressed)
        median, high = np.median(off), np.percentile(off, 95)
        rows.append({"way": name, "presses": len(pressed), "s": total, "off %": float(median), "p95 %": float(high)})
        presses += pressed
    return {"rows": rows, "presses": presses}


def make_scene() -> Scene:
    """Build a file in which nothing is selected."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    source, rig = build_character(CELL)
    set_pose(rig)
    posed = posed_copy(source)
    target = remeshed(posed, VOXEL, VERTICES)
    bpy.data.meshes.remove(posed.data)
    clear_pose(rig)
    for number, pose in enumerate(({}, POSE, OTHER_POSE)):
        clear_pose(rig)
        set_pose(rig, pose)
        for bone in rig.pose.bones:
            bone.keyframe_insert("rotation_quaternion", frame=1 + number * APART)
    bpy.context.scene.frame_set(1)
    target.location.x = ASIDE
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = None
    return Scene(source, rig, target)


def distances(scene: Scene) -> Floats:
    """(n,) distances of the target's vertices from the source's surface, of all frames, in percent of its height."""
    found = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        source = mesh_data.read_source_surface(scene.source, bpy.context.evaluated_depsgraph_get())
        points = positions(scene.target)
        triangle, barycentric = closest_points(points, source.vertices, source.triangles)
        nearest = np.einsum("nc,ncx->nx", barycentric, source.vertices[source.triangles[triangle]])
        found.append(100 * np.linalg.norm(points - nearest, axis=1) / np.ptp(source.vertices[:, 2]))
    return np.concatenate(found)


def _press(presses: list[Press], way: str) -> list[Row]:
    """Execute the presses, and time each of them."""
    rows = []
    for what, effect in presses:
        begin = perf_counter()
        if effect is not None:
            effect()
        rows.append({"way": way, "press": what, "s": perf_counter() - begin})
    return rows


def _begin(scene: Scene) -> list[Press]:
    return [
        Press("Click on the source", lambda: select_only(scene.source)),
        Press("Shift-click on the target", lambda: select_only(scene.target, scene.source)),
        Press("N, the sidebar"),
        Press("Tab ZoomOut"),
    ]


def _parent(scene: Scene) -> list[Press]:
    """Parent by hand, as Blender's manual describes it."""
    return [
        Press("Click on the target", lambda: select_only(scene.target)),
        Press("Alt G, to where the rig is", bpy.ops.object.location_clear),
        Press("Shift-click on the rig", lambda: select_only(scene.rig, scene.target)),
        Press("Ctrl P"),
        Press("Armature Deform", lambda: bpy.ops.object.parent_set(type="ARMATURE")),
    ]
