# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigged game characters, read by Blender's importer: at rest, in a frame of their animation, and remeshed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
from bpy.types import Action, Object
from mathutils import Matrix

import zoomout_core as zo
from benchmarks.characters.skeleton import Skeleton
from benchmarks.transfer.cases import rigid_motion
from blender_addon import mesh_data
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.triangles import triangle_areas

# The importer's log level.
ERRORS_ALONE = 2
# Number of frames of each action, among which the one that differs most from the rest pose is chosen.
FRAMES = 5
# A frame with a larger growth of the area belongs to an animation that does not fit its character.
SWOLLEN = 1.25
# Ratio of the target's faces to the source's, and welding distance relative to the extent.
THINNED, WELDED = 0.6, 1e-5
# Width of a voxel of the one skin, relative to the extent.
VOXEL = 0.01
# A stride for characters without an action: bones by name, and degrees about the axes to the left and ahead.
STRIDE = (
    (re.compile(r"upper_?arm.?l$", re.IGNORECASE), (-35.0, 40.0)),
    (re.compile(r"upper_?arm.?r$", re.IGNORECASE), (35.0, -40.0)),
    (re.compile(r"lower_?arm.?l$", re.IGNORECASE), (-50.0, 0.0)),
    (re.compile(r"lower_?arm.?r$", re.IGNORECASE), (-50.0, 0.0)),
    (re.compile(r"upper_?leg.?l$", re.IGNORECASE), (35.0, 0.0)),
    (re.compile(r"upper_?leg.?r$", re.IGNORECASE), (-50.0, 0.0)),
    (re.compile(r"lower_?leg.?l$", re.IGNORECASE), (40.0, 0.0)),
    (re.compile(r"lower_?leg.?r$", re.IGNORECASE), (50.0, 0.0)),
)


class Body(NamedTuple):
    """A character in one pose, with all its skinned objects as one mesh in world space.

    Attributes:
        vertices: (n, 3) positions.
        triangles: (m, 3) vertex numbers.
        weights: (n, b) of the bones, single precision; rows sum to one.
    """

    vertices: Floats
    triangles: Integers
    weights: Floats


class Character(NamedTuple):
    """A character read from a file.

    Attributes:
        pack: its folder.
        name: of the character.
        skeleton: its bones.
        rest: in its rest pose.
        posed: the same mesh in a frame of its actions.
        thinned: the same pose, remeshed.
        pose: the action and the frame.
    """

    pack: str
    name: str
    skeleton: Skeleton
    rest: Body
    posed: Body
    thinned: Body
    pose: str


@lru_cache(maxsize=4)
def read_character(path: Path, bend: float = 1.0) -> Character:
    """A character from a glTF file; replaces the open scene.

    Args:
        path: of the file.
        bend: 1 for the pose that differs most from the rest, 0.5 for the median of all frames.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    before, bpy.app.debug_value = bpy.app.debug_value, ERRORS_ALONE
    bpy.ops.import_scene.gltf(filepath=str(path))
    bpy.app.debug_value = before
    armature = next(obj for obj in bpy.data.objects if obj.type == "ARMATURE")
    parts = [obj for obj in bpy.data.objects if any(modifier.type == "ARMATURE" for modifier in obj.modifiers)]
    parts.sort(key=lambda obj: obj.name)
    skeleton = _skeleton(armature)
    armature.data.pose_position = "REST"
    rest = _body(parts, skeleton)
    armature.data.pose_position = "POSE"
    pose = _strike(armature, parts, rest, bend)
    posed = _body(parts, skeleton)
    for part in parts:
        weld, thin = part.modifiers.new("Weld", "WELD"), part.modifiers.new("Thin", "DECIMATE")
        weld.merge_threshold = WELDED * _extent(rest)
        thin.ratio = THINNED
    return Character(
        path.parent.name.removesuffix("_pack"),
        path.stem.split("-")[0],
        skeleton,
        rest,
        posed,
        _body(parts, skeleton),
        pose,
    )


def one_skin(body: Body, voxel: float = VOXEL) -> Body:
    """A character remeshed by voxels, so that its parts become one skin; weights from the closest points.

    Args:
        body: the character.
        voxel: width of a voxel relative to the extent.
    """
    mesh = bpy.data.meshes.new("Skin")
    mesh.from_pydata(body.vertices, [], body.triangles)
    obj = bpy.data.objects.new("Skin", mesh)
    bpy.context.scene.collection.objects.link(obj)
    remesh = obj.modifiers.new("Skin", "REMESH")
    remesh.mode, remesh.voxel_size = "VOXEL", voxel * _extent(body)
    with mesh_data.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as (_, evaluated):
        vertices, triangles = _arrays(evaluated)
    bpy.data.meshes.remove(mesh)
    vertices, triangles = _largest_part(vertices, triangles)
    triangle, barycentric = closest_points(vertices, body.vertices, body.triangles)
    weights = np.einsum("nc,ncb->nb", barycentric, body.weights[body.triangles[triangle]])
    return Body(vertices, triangles, weights.astype(np.float32))


def _largest_part(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers]:
    """The part of the largest area, without the small parts and inner cavities that voxels leave."""
    used = zo.Surface(vertices, triangles).components == 0
    return vertices[used], (np.cumsum(used) - 1)[triangles[used[triangles[:, 0]]]]


def shuffle(body: Body, seed: int = 0) -> Body:
    """The same mesh with its vertices and triangles in random order."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(body.vertices))
    place = np.argsort(order)
    triangles = place[rng.permutation(body.triangles)]
    return Body(body.vertices[order], triangles, body.weights[order])


# --- arrays -------------------------------------------------------------------------------------------------


def _skeleton(armature: Object) -> Skeleton:
    bones = list(armature.data.bones)
    number = {bone.name: i for i, bone in enumerate(bones)}
    parent = np.array([-1 if bone.parent is None else number[bone.parent.name] for bone in bones])
    head = np.array([armature.matrix_world @ bone.head_local for bone in bones])
    return Skeleton(tuple(number), parent, head)


def _body(parts: list[Object], skeleton: Skeleton) -> Body:
    """The parts, evaluated, as one mesh."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    bodies, first = [], 0
    for part in parts:
        with mesh_data.evaluated_mesh(part, depsgraph) as (evaluated, mesh):
            vertices, triangles = _arrays(mesh)
            vertices = mesh_data.positions_in_world(evaluated, vertices)
            bodies.append(Body(vertices, triangles + first, _weights(part, mesh, skeleton.names)))
        first += len(vertices)
    return Body(*(np.concatenate(arrays) for arrays in zip(*bodies, strict=True)))


def _arrays(mesh: bpy.types.Mesh) -> tuple[Floats, Integers]:
    mesh.calc_loop_triangles()
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    return mesh_data.read_positions(mesh).astype(np.float64), triangles.reshape(-1, 3).astype(np.int64)


def _weights(part: Object, mesh: bpy.types.Mesh, bones: tuple[str, ...]) -> Floats:
    """(n, b) weights of the bones, which sum to one."""
    groups = mesh_data.read_weights(part, mesh)
    weights = np.zeros((len(mesh.vertices), len(bones)), np.float32)
    known = [i for i, name in enumerate(groups.labels) if name in bones]
    weights[:, [bones.index(groups.labels[i]) for i in known]] = groups.values.toarray()[:, known]
    return weights / np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)


def _extent(body: Body) -> float:
    """The largest extent along an axis, which is the height of people."""
    return float(np.ptp(body.vertices, axis=0).max())


# --- poses --------------------------------------------------------------------------------------------------


def _strike(armature: Object, parts: list[Object], rest: Body, bend: float) -> str:
    """Put the armature into a frame by its rank, from 0 to 1, in the order of bends; return its action and frame."""
    if armature.animation_data is None or not bpy.data.actions:
        _stride(armature)
        return "stride"
    for track in list(armature.animation_data.nla_tracks):
        armature.animation_data.nla_tracks.remove(track)
    frames = []
    for frame in all_frames():
        set_frame(armature, *frame)
        points = _points(parts)
        swelling = triangle_areas(points, rest.triangles).sum() / triangle_areas(rest.vertices, rest.triangles).sum()
        frames.append((_bend(points, rest.vertices) if swelling < SWOLLEN else 0.0, frame))
    frames.sort(key=lambda entry: -entry[0])
    last = len(frames) - 1
    _, (action, number) = frames[last - round(bend * last)]
    set_frame(armature, action, number)
    return f"{action.name.split('|')[-1]} {number}"


def all_frames() -> Iterator[tuple[Action, int]]:
    """Some frames of each action."""
    for action in sorted(bpy.data.actions, key=lambda action: action.name):
        first, last = action.frame_range
        for frame in np.unique(np.linspace(first, last, FRAMES).round().astype(int)).tolist():
            yield action, frame


def _points(parts: list[Object]) -> Floats:
    """(n, 3) evaluated vertices of the parts in world space."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    points = []
    for part in parts:
        with mesh_data.evaluated_mesh(part, depsgraph) as (evaluated, mesh):
            points.append(mesh_data.positions_in_world(evaluated, mesh_data.read_positions(mesh).astype(np.float64)))
    return np.concatenate(points)


def _bend(points: Floats, rest: Floats) -> float:
    """Mean distance between points (n, 3) and their rest positions (n, 3), after rigid alignment."""
    motion = rigid_motion(points, rest)
    return float(np.linalg.norm(points @ motion[:3, :3].T + motion[:3, 3] - rest, axis=1).mean())


def set_frame(armature: Object, action: Action, frame: int) -> None:
    """Put an armature into a frame of an action."""
    for bone in armature.pose.bones:  # an action leaves the bones that it does not move as they are
        bone.matrix_basis.identity()
    armature.animation_data.action = action
    if action.slots:
        armature.animation_data.action_slot = action.slots[0]
    bpy.context.scene.frame_set(frame)


def _stride(armature: Object) -> None:
    for pattern, (about_x, about_y) in STRIDE:
        for bone in armature.pose.bones:
            if pattern.search(bone.name):
                turn = Matrix.Rotation(np.radians(about_x), 4, "X") @ Matrix.Rotation(np.radians(about_y), 4, "Y")
                to_world = armature.matrix_world
                joint = Matrix.Translation((to_world @ bone.matrix).translation)
                bone.matrix = to_world.inverted() @ joint @ turn @ joint.inverted() @ to_world @ bone.matrix
                bpy.context.view_layer.update()
