# SPDX-License-Identifier: GPL-3.0-or-later
"""Pose-driven shape keys on other bodies, as Blender displays them, compared with the truth: the set `clothes`.

Each key corrects linear blend skinning at a joint that bends, so that the source has the shape of dual quaternion
skinning (Kavan et al. 2008). The same formula with the true weights and joints of the target is the truth. Garments on
the target get keys in *Dress*; for them, the truth has the author's refit and weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.types import Object
from scipy.sparse import csr_array
from tqdm import tqdm

from benchmarks.outfits.clothes import Body, Garment, Wardrobe, move
from benchmarks.pictures import View, draw_views
from benchmarks.tables import NOT_SHOWN, Record, Tables
from blender_addon import api, jobs, mesh_data, registered
from blender_addon.demo.character import select_only
from blender_addon.scene.pair import read_pair
from blender_addon.storage import stored_match
from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.mesh.affine_maps import transform_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain, Kind
from zoomout_core.transfer.dressing.barriers import SidedSurface
from zoomout_core.transfer.rigging.poses import pose_of_turns
from zoomout_core.transfer.rigging.skinning import skinning_matrices

# The corrected joints: the bone that rotates, the direction of its rotation (up, forwards or back), and degrees.
JOINTS = {
    "elbow": ("lowerarm01.L", (0, 0, 1), 100.0),
    "shoulder": ("upperarm01.L", (0, 1, 0), 60.0),
    "hip": ("upperleg01.L", (0, 0, 1), 80.0),
    "knee": ("lowerleg01.L", (0, 0, -1), 100.0),
}
# Source, build and topology of the target; those of the same build are bound while posed.
PAIRS: tuple[tuple[str, str, str | None], ...] = (
    ("woman", "curvy_woman", "female_generic"),
    ("woman", "woman", "female_generic"),
    ("man", "heavy_man", "male1591"),
    ("man", "man", "male1591"),
    ("woman", "child", None),
)
OWN, OTHER_REST, MOVED, BOUND = "own rig", "own rig, T-pose", "moved rig", "bound, posed"
# The pose of a body that is bound, by its number in the set.
POSED = 1
COPIED = "copied vectors"
WITHOUT, OF_BODY, OF_BOTH = "inside without keys", "inside with the body's", "inside with both"
SKIN = np.array([0.72, 0.6, 0.52])
# Centimetres of cloth inside the skin that show.
INSIDE = 0.1
# Radius of the pictures' parts, as a share of the height.
AROUND = 0.12


@dataclass(frozen=True, eq=False)
class _Case:
    """A target in the scene, and its true body.

    Attributes:
        way: the way to get its rig.
        target: the object.
        body: its body at rest, with its true weights and bones.
    """

    way: str
    target: Object
    body: Body


def run(data: Path, pairs: int | None, pictures: Path | None = None) -> Tables:
    """Transfer driven keys to other bodies, bend their joints, and compare the displacements that keys add.

    `bodies`: for each way that the target gets its rig and each joint, the mean over all pairs of the error of the
    added displacement, relative to the true one: 1 without the key. `copied vectors` interpolates offsets along the
    same map, unrotated. `value` is the least value of the key in the pose, to which drivers should set 1.

    `clothes`: the same error for garments on targets with their own rigs, all of a pair together, and the shares of
    their vertices that are inside the bent skin: without keys, with the body's keys alone, and with those of both.

    Args:
        data: a folder with the set `clothes`.
        pairs: largest number of pairs; all when not given.
        pictures: a folder for pictures of the bent joints, without and with keys.
    """
    if not (data / "clothes").is_dir():
        return {"bodies": [], "clothes": []}
    wardrobe, records, of_clothes = Wardrobe(data / "clothes"), list[Record](), list[Record]()
    with registered():
        for names in tqdm(PAIRS[:pairs], leave=False):
            views = list[list[View]]()
            for way in (BOUND,) if names[0] == names[1] else (OWN, OTHER_REST, MOVED):
                bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
                body = wardrobe.body(names[0])
                source = _add_body("Source", body)
                _add_keys(source, body)
                case = _make_target(wardrobe, names, way)
                _transfer(source, case)
                found, shown = _measure(case)
                records += [record | {"pair": ", ".join(filter(None, names))} for record in found]
                views += shown
                if way == OWN:
                    of_clothes += _measure_clothes(case, _dress(source, body, case, wardrobe.garments(*names[:2])))
            if pictures is not None:
                draw_views(pictures / f"{' '.join(filter(None, names))}.png", views)
    shares = "error", WITHOUT, OF_BODY, OF_BOTH
    tables = {
        "bodies": _rows(records, ("rig", "joint"), (COPIED, "error")),
        "clothes": _rows(of_clothes, ("joint",), shares),
    }
    return {**tables, NOT_SHOWN: records}


def _rows(records: list[Record], kinds: Sequence[str], measures: Sequence[str]) -> list[Record]:
    """The means of some measures over all pairs, for each combination of some columns."""
    rows = []
    for kind in dict.fromkeys(tuple(record[name] for name in kinds) for record in records):
        chosen = [record for record in records if tuple(record[name] for name in kinds) == kind]
        row: Record = {**dict(zip(kinds, kind, strict=True)), "pairs": len(chosen)}
        row |= {name: float(np.mean([record[name] for record in chosen])) for name in measures}
        rows.append(row | {"value": min(record["value"] for record in chosen)})
    return rows


def _make_target(wardrobe: Wardrobe, names: tuple[str, str, str | None], way: str) -> _Case:
    """A target without keys; with a rig, unless it gets one in the transfer."""
    body = wardrobe.body(*names[1:])
    if way == BOUND:
        posed = body.surface.with_vertices(body.in_pose(POSED, body.surface.vertices, body.weights))
        return _Case(way, _add_mesh("Target", posed), body)
    raised = wardrobe.t_pose(body) if way == OTHER_REST else None
    if raised is not None:
        body = _at_rest_in(body, raised)
    return _Case(way, (_add_mesh("Target", body.surface) if way == MOVED else _add_body("Target", body)), body)


def _at_rest_in(body: Body, pose: Floats) -> Body:
    """The same body with a pose (b, 3, 4) of its bones as its rest pose."""
    surface = body.surface.with_vertices(move(body.surface.vertices, body.weights, pose))
    heads, tails = (transform_points(pose, each) for each in (body.bones.heads, body.bones.tails))
    return replace(body, surface=surface, bones=replace(body.bones, heads=heads, tails=tails))


def _add_mesh(name: str, surface: Surface) -> Object:
    mesh = bpy.data.meshes.new(name)
    faces = np.split(surface.corner_vertex, surface.face_start[1:-1])
    mesh.from_pydata(surface.vertices.tolist(), [], [face.tolist() for face in faces])
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _add_body(name: str, body: Body) -> Object:
    """A body as an object, bound to an armature of its bones."""
    armature = bpy.data.objects.new(f"{name} Rig", bpy.data.armatures.new(name))
    bpy.context.scene.collection.objects.link(armature)
    select_only(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    bones = body.bones
    made = [armature.data.edit_bones.new(each) for each in bones.names]
    for number, bone in enumerate(made):
        bone.head, bone.tail = bones.heads[number].tolist(), bones.tails[number].tolist()
        bone.parent = made[bones.parents[number]] if bones.parents[number] >= 0 else None
    bpy.ops.object.mode_set(mode="OBJECT")
    return _bind(_add_mesh(name, body.surface), body.weights, bones.names, armature)


def _bind(obj: Object, weights: Floats, bones: tuple[str, ...], armature: Object) -> Object:
    """Bind an object to an armature by weights (n, b) of its bones."""
    mesh_data.write_weights(obj, Attribute("weights", Domain.POINT, Kind.WEIGHT, csr_array(weights), bones))
    obj.parent = armature
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    bpy.context.view_layer.update()
    return obj


def _turn(body: Body, joint: str) -> Floats:
    """(3,) the rotation vector that bends a joint."""
    bone, towards, angle = JOINTS[joint]
    number = body.bones.names.index(bone)
    axis = np.cross(body.bones.tails[number] - body.bones.heads[number], towards)
    return np.asarray(np.radians(angle) * axis / np.linalg.norm(axis))


def _correct(body: Body, joint: str) -> tuple[Floats, Floats]:
    """(n, 3) displacements that a key adds to a body with a bent joint, and (n, 3) its offsets at rest."""
    linear, added = _smoothing(body, joint, body.surface.vertices, body.weights)
    return added, np.einsum("nxy,ny->nx", np.linalg.inv(linear[:, :, :3]), added)


def _smoothing(body: Body, joint: str, points: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Motion of points with weights (n, b) by a bent joint of a body.

    Returns:
        (n, 3, 4) matrices of linear blend skinning, and (n, 3) what dual quaternion skinning adds.
    """
    bones, turns = body.bones, np.zeros((len(body.bones.names), 3))
    turns[bones.names.index(JOINTS[joint][0])] = _turn(body, joint)
    pose = pose_of_turns(turns, bones.heads, bones.parents)
    transforms = Similarities(np.ones(len(pose)), pose[:, :, :3], pose[:, :, 3])
    linear, smooth = (skinning_matrices(transforms, csr_array(weights), preserve_volume=each) for each in (False, True))
    return linear, transform_points(smooth, points) - transform_points(linear, points)


def _add_keys(obj: Object, body: Body) -> None:
    """Add a key for each joint, driven by the rotation of its bone."""
    rest, (armature,) = body.surface.vertices, mesh_data.armatures_of(obj)
    for joint, (bone, _, angle) in JOINTS.items():
        mesh_data.write_shape(obj, joint, rest + _correct(body, joint)[1])
        curve = obj.data.shape_keys.key_blocks[joint].driver_add("value")
        variable = curve.driver.variables.new()
        variable.type, curve.driver.type = "TRANSFORMS", "SUM"
        end = variable.targets[0]
        end.id, end.bone_target, end.transform_type = armature, bone, "ROT_W"
        end.transform_space, end.rotation_mode = "LOCAL_SPACE", "QUATERNION"
        # A quaternion's first number is the cosine of half the angle.
        places = ((np.cos(np.radians(angle) / 2), 1.0), (1.0, 0.0))
        for point, place in zip(curve.keyframe_points, places, strict=True):
            point.co, point.interpolation = place, "LINEAR"


def _transfer(source: Object, case: _Case) -> None:
    bindings = {BOUND: api.Binding(shape="rest_pose"), MOVED: api.Binding(shape="keep_shape", move_rig=True)}
    options: dict[str, Any] = {"binding": bindings.get(case.way), "force": True}
    api.transfer_objects(bpy.context, source, case.target, ["shape_keys"], **options)
    keys = mesh_data.read_own_shape_keys(source.data)
    pair = jobs.run(read_pair(bpy.context, source.name, case.target.name))
    match = stored_match.read(case.target.data, pair)
    assert match is not None
    rest = mesh_data.read_rest_positions(case.target.data)
    for joint, copied in zip(
        keys.offsets.labels, match.surface_map.interpolate(keys.offsets.values).swapaxes(0, 1), strict=True
    ):
        mesh_data.write_shape(case.target, f"{COPIED} {joint}", rest + copied)


def _measure(case: _Case) -> tuple[list[Record], list[list[View]]]:
    """The errors at each joint, and views of it: without key, with copied vectors, with the key, and the truth."""
    records, views, areas = list[Record](), list[list[View]](), case.body.surface.vertex_areas
    (armature,) = mesh_data.armatures_of(case.target)
    for joint, (bone, _, _) in JOINTS.items():
        truth, _ = _correct(case.body, joint)
        mesh_data.turn_bones(armature, {bone: _turn(case.body, joint)})
        with_key = _read_display(case.target)
        value = case.target.data.shape_keys.key_blocks[joint].value
        _mute_drivers(case.target, True)
        copied, without = (_display(case.target, name) for name in (f"{COPIED} {joint}", ""))
        shapes = {"without": without, COPIED: copied, "with": with_key, "truth": without + truth}
        _mute_drivers(case.target, False)
        place = np.array(armature.matrix_world @ armature.pose.bones[bone].head)
        mesh_data.turn_bones(armature, {})
        added = {name: shapes[name] - shapes["without"] - truth for name in (COPIED, "with")}
        of_copied, error = (
            float(np.sqrt(areas @ (off**2).sum(axis=1) / (areas @ (truth**2).sum(axis=1)))) for off in added.values()
        )
        records.append({"rig": case.way, "joint": joint, "value": value, COPIED: of_copied, "error": error})
        surface = case.body.surface
        views.append([_view(f"{joint}: {name}", surface.with_vertices(shape), place) for name, shape in shapes.items()])
    return records, views


def _dress(source: Object, body: Body, case: _Case, garments: dict[str, Garment]) -> list[tuple[Object, Garment]]:
    """Dress a target with garments that its source wears; returns the copies with their truth."""
    (armature,) = mesh_data.armatures_of(source)
    for name, garment in garments.items():
        _bind(_add_mesh(name, garment.surface), garment.weights, body.bones.names, armature)
    things = [bpy.data.objects[name] for name in garments]
    made = api.dress(bpy.context, source, case.target, things, force=True)["objects"]
    return [(bpy.data.objects[made[name]], garment) for name, garment in garments.items()]


def _measure_clothes(case: _Case, worn: list[tuple[Object, Garment]]) -> list[Record]:
    """Errors of garments at each joint, and how many of their vertices are inside the skin."""
    records, (armature,) = list[Record](), mesh_data.armatures_of(case.target)
    for joint, (bone, _, _) in JOINTS.items():
        mesh_data.turn_bones(armature, {bone: _turn(case.body, joint)})
        skin, shapes = _read_display(case.target), [_read_display(copy) for copy, _ in worn]
        keys = [copy.data.shape_keys for copy, _ in worn]
        values = [each.key_blocks[joint].value for each in keys if each is not None and joint in each.key_blocks]
        _mute_drivers(case.target, True)
        skin_without, without = _display(case.target, ""), [_read_display(copy) for copy, _ in worn]
        _mute_drivers(case.target, False)
        mesh_data.turn_bones(armature, {})
        missed = moved = 0.0
        for (_, garment), shape, before in zip(worn, shapes, without, strict=True):
            areas = garment.surface.with_vertices(garment.refitted).vertex_areas
            _, truth = _smoothing(case.body, joint, garment.refitted, garment.weights)
            missed += areas @ ((shape - before - truth) ** 2).sum(axis=1)
            moved += areas @ (truth**2).sum(axis=1)
        record: Record = {"joint": joint, "error": float(np.sqrt(missed / moved)), "value": min(values)}
        for name, body, clothes in (
            (WITHOUT, skin_without, without),
            (OF_BODY, skin, without),
            (OF_BOTH, skin, shapes),
        ):
            height, _, known = SidedSurface(body, case.body.surface.triangles).sides(np.concatenate(clothes))
            record[name] = float((known & (height < -INSIDE)).mean())
        records.append(record)
    return records


def _mute_drivers(obj: Object, is_mute: bool) -> None:
    """Turn the drivers of an object's shape keys off or on."""
    for curve in obj.data.shape_keys.animation_data.drivers:
        curve.mute = is_mute


def _read_display(obj: Object) -> Floats:
    """(n, 3) the vertices of an object as it is displayed."""
    bpy.context.view_layer.update()
    with mesh_data.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as (_, mesh):
        return mesh_data.positions_in_world(obj, mesh_data.read_positions(mesh))


def _display(obj: Object, name: str) -> Floats:
    """(n, 3) its vertices with one key alone, or none; drivers are off."""
    for block in obj.data.shape_keys.key_blocks:
        block.value = float(block.name == name)
    return _read_display(obj)


def _view(caption: str, surface: Surface, place: Floats) -> View:
    """The part of a surface around a joint."""
    near = np.linalg.norm(surface.vertices - place, axis=1) < AROUND * np.ptp(surface.vertices[:, 1])
    triangles = surface.triangles[near[surface.triangles].all(axis=1)]
    used, number = np.unique(triangles, return_inverse=True)
    return View(caption, Surface(surface.vertices[used], number.reshape(-1, 3)), np.tile(SKIN, (len(used), 1)))
