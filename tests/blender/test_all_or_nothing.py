# SPDX-License-Identifier: GPL-3.0-or-later
"""If writing fails at any step, or work is cancelled at any point, everything is restored."""

import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from rigged import pose_target, source_and_rig
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    decimate,
    ellipsoid,
    link,
    new_material,
    positions,
    set_weights,
    snapshot_file,
)
from symmetric import LEFT, RIGHT, add_key, bumps
from true_match import keep_true_match
from turns import turns

import blender_addon
import zoomout_core as zo
from blender_addon import api, jobs, watch
from blender_addon.adapters import DATA
from blender_addon.mesh_data import writing as room
from blender_addon.mesh_data.surfaces.surface_points import surface_point_of_vertex
from blender_addon.scene.landmarks import set_landmark
from blender_addon.services.dressing.dress import prepare_dress
from blender_addon.services.dressing.read import Dressing
from blender_addon.services.matching.bend_match import bend_match_async
from blender_addon.services.matching.seam_cut import cut_seams_async
from blender_addon.services.symmetry.layers import mirror_attributes_async
from blender_addon.services.symmetry.sculpt import mirror_sculpt_async
from blender_addon.services.symmetry.shape_keys import mirror_shape_key_async
from blender_addon.services.symmetry.sides import name_sides
from blender_addon.services.symmetry.weights import symmetrise_weights_async
from blender_addon.services.targets import each_target
from blender_addon.services.transfer import prepare_transfer
from blender_addon.services.wrap import Wrapping, prepare_wrap

ADDON = str(Path(blender_addon.__file__).parent)
# Functions that undo changes, and must not fail themselves.
UNDOING = room.__file__
ERRORS = (RuntimeError, zo.MeshError, KeyboardInterrupt, MemoryError)
NEAREST = {"initial": "nearest"}


def plain(value):
    """A copy of a Blender value that stays valid after its owner is freed."""
    if isinstance(value, bpy.types.ID):
        return value.name
    return value if isinstance(value, (str, int, float, type(None))) else [plain(each) for each in value]


def state():
    """All data of the file that writing could change."""
    placed = {
        obj.name: [
            plain(getattr(obj, name))
            for name in (
                "parent", "parent_type", "parent_bone", "matrix_parent_inverse", "location", "scale", "rotation_euler",
                "active_shape_key_index", "data", "users_collection",
            )
        ]
        + [
            {option: str(getattr(one, option)) for option in set(one.bl_rna.properties.keys()) - {"rna_type"}}
            for one in obj.modifiers
        ]
        for obj in bpy.data.objects
    }  # fmt: skip
    marked = []
    for mesh in bpy.data.meshes:
        for name in ("select", "use_seam", "use_edge_sharp"):
            marked.append(np.empty(len(mesh.edges), bool))
            mesh.edges.foreach_get(name, marked[-1])
    drivers = [
        [
            (curve.data_path, [plain(end.id) for v in curve.driver.variables for end in v.targets])
            for curve in own.drivers
        ]
        for keys in bpy.data.shape_keys
        if (own := keys.animation_data)
    ]
    return snapshot_file(), placed, [each.tobytes() for each in marked], drivers


def differences(one, other, at=""):
    """The differences between two states."""
    if one == other:
        return []
    if isinstance(one, dict) and isinstance(other, dict):
        keys = [(key, one.get(key), other.get(key)) for key in {**one, **other}]
    elif isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)) and len(one) == len(other):
        keys = [(key, *pair) for key, pair in enumerate(zip(one, other, strict=True))]
    else:
        return [f"{at}: {one!r:.200} {other!r:.200}"]
    return [found for key, *pair in keys for found in differences(*pair, f"{at}/{key}")]


class FailAt:
    """Fails at the n-th distinct line of the add-on that is executed while something is written."""

    def __init__(self, number, error):
        self.number, self.error, self.seen, self.failed = number, error, set(), False

    def __enter__(self):
        sys.settrace(self._of_frame)

    def __exit__(self, *_):
        sys.settrace(None)

    def _of_frame(self, frame, event, _):
        name = frame.f_code.co_filename
        return self._of_line if room._enclosing and name.startswith(ADDON) and name != UNDOING else None

    def _of_line(self, frame, event, _):
        where = frame.f_code.co_filename, frame.f_lineno
        if event == "line" and room._enclosing and where not in self.seen:
            self.seen.add(where)
            if len(self.seen) == self.number:
                self.failed = True
                sys.settrace(None)
                raise self.error("on purpose")
        return self._of_line


def assert_atomic(work, least, every=1):
    """Check that work is complete or has no effect wherever it fails, and that it can fail in a minimum of places.

    It fails at every line in turn, or at every few lines if the work takes longer.
    """
    before = state()
    for number in range(1, 1000, every):
        fail = FailAt(number, ERRORS[number % len(ERRORS)])
        try:
            with fail:
                work()
        except ERRORS:
            assert fail.failed
            assert not differences(before, state()), f"line {number}"
            assert not room._enclosing
        else:
            assert not fail.failed
            break
    assert number > least
    assert state() != before


def run_and_assert_cancellable(coroutine):
    """Check that a coroutine has no visible effect before it returns, so that it can be cancelled anywhere."""
    job, before = jobs.Job(coroutine), state()
    for _ in turns(job):
        assert not differences(before, state())
    assert not differences(before, state())
    return job.result


@pytest.fixture(autouse=True)
def without_handlers():
    """Blender prints errors of handlers and goes on."""
    watch.unregister()
    yield
    watch.register()


@pytest.fixture
def rich():
    """A source with all kinds of data, and a target with other data of the same names, without a match."""
    source, target = ellipsoid("Source", 3), decimate(subdivisions=3)
    for obj in (source, target):
        count = len(obj.data.vertices)
        add_uv_map(obj.data, "UV")
        add_attribute(obj.data, "Color", "FLOAT_COLOR", "POINT", np.random.default_rng(count).random((count, 4)))
        add_attribute(obj.data, "Number", "FLOAT" if obj == source else "INT", "POINT", np.arange(count))
        set_weights(obj, "Both", positions(obj.data)[:, 0].clip(0, 1))
        obj.shape_key_add(name="Basis")
        obj.shape_key_add(name="Key").points[0].co.x += 1
        obj.data.materials.append(new_material(f"Of {obj.name}"))
        for number, edge in enumerate(obj.data.edges):
            edge.use_seam, edge.use_edge_sharp = number % 7 == 0, number % 11 == 0
    add_uv_map(source.data, "Other")
    set_weights(source, "Other", np.ones(len(source.data.vertices)))
    source.shape_key_add(name="Other").points[3].co.z += 1
    driver = source.data.shape_keys.key_blocks["Other"].driver_add("value").driver
    end = driver.variables.new().targets[0]
    end.id_type, end.id, end.data_path = "KEY", source.data.shape_keys, "eval_time"
    source.data.normals_split_custom_set(np.tile([0.6, 0, 0.8], (len(source.data.loops), 1)).tolist())
    add_key(target, "Basis 2", 0)
    user = link("User", None)  # of a key of the target
    end = user.driver_add("location", 0).driver.variables.new().targets[0]
    end.id_type, end.id, end.data_path = "KEY", target.data.shape_keys, 'key_blocks["Key"].value'
    target["own"], target.data["own"] = 3, "text"
    link("Sharing", target.data)
    activate(target, source)
    bpy.context.view_layer.update()
    return source, target


def test_failed_or_cancelled_transfer_restores_everything(rich):
    _, target = rich
    write = run_and_assert_cancellable(prepare_transfer(bpy.context, "Source", "Target", DATA, **NEAREST))
    assert_atomic(write, 100)
    assert target.data.name == "Target"
    assert (
        bpy.data.objects["User"].animation_data.drivers[0].driver.variables[0].targets[0].id == target.data.shape_keys
    )


@pytest.mark.slow
def test_failed_binding_with_worn_objects_restores_everything():
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    child = link("Child", None)
    child.parent, target.location.x = target, 0
    other = link("Rig before", bpy.data.armatures.new("Rig before"))
    target.modifiers.new("Before", "WARP")
    target.modifiers.new("Skeleton", "ARMATURE").object = other
    target.modifiers.new("Behind", "SMOOTH").show_viewport = False
    hat = ellipsoid("Hat", 1)
    hat.location.z = 6
    bpy.context.view_layer.update()
    api.dress(bpy.context, source, target, [hat])
    binding = api.Binding(replace=True)
    prepared = prepare_transfer(bpy.context, "Source", "Target", (), binding=binding)
    assert_atomic(jobs.run(prepared), 100)
    assert target.parent == armature


@pytest.mark.parametrize("result", ["shape_key", "mesh", "object"])
def test_failed_or_cancelled_wrapping_restores_everything(result):
    ellipsoid("Source", 3)
    target = ellipsoid("Target", 3)
    target.data.transform(Matrix.Scale(1.1, 4))
    bpy.context.view_layer.update()
    prepared = prepare_wrap(bpy.context, "Source", "Target", Wrapping(result=result), **NEAREST)
    assert_atomic(run_and_assert_cancellable(prepared), 40)


@pytest.mark.slow
def test_failed_or_cancelled_dressing_restores_everything():
    ellipsoid("Source", 3), ellipsoid("Target", 3)
    hats = [ellipsoid(name, 1) for name in ("Hat", "Cap")]
    for hat in hats:
        hat.location.z = 1
    bpy.context.view_layer.update()

    def prepared():
        return prepare_dress(bpy.context, "Source", "Target", ("Hat", "Cap"), Dressing(), **NEAREST)

    assert_atomic(run_and_assert_cancellable(prepared()), 30)
    names = sorted(bpy.data.objects.keys()), sorted(bpy.data.meshes.keys())
    bpy.data.objects["Hat on Target"].location.x = 7  # so that a new copy differs
    bpy.context.view_layer.update()
    assert_atomic(run_and_assert_cancellable(prepared()), 30)
    assert names == (sorted(bpy.data.objects.keys()), sorted(bpy.data.meshes.keys()))


def test_failed_symmetry_operation_restores_everything(body):
    count = len(body.data.vertices)
    add_uv_map(body.data, "UV")
    add_attribute(body.data, "Number", "FLOAT", "POINT", np.arange(count))
    body.data.materials.append(new_material("M"))
    body.data.edges[3].use_seam = True
    for name, side in (("Arm.L", LEFT), ("Arm.R", RIGHT)):
        set_weights(body, name, side * 0.7)
    add_key(body, "Smile", bumps(LEFT * np.linspace(0, 1, count)))
    for work, least in (
        (lambda: symmetrise_weights_async(bpy.context, "Creature", "left_to_right"), 12),
        (lambda: mirror_shape_key_async(bpy.context, "Creature", "Smile", "split", "left_to_right", 0.05), 20),
    ):
        assert_atomic(lambda work=work: jobs.run(work()), least, every=2)
    assert_atomic(
        lambda: jobs.run(
            mirror_attributes_async(bpy.context, "Creature", ("attributes", "edges"), "left_to_right", "own")
        ),
        12,
    )
    assert_atomic(lambda: name_sides(body, 0.01), 8)


@pytest.mark.slow
def test_failed_sculpt_mirroring_restores_everything(body):
    moved = positions(body.data) + bumps(LEFT * 1.0)
    body.data.vertices.foreach_set("co", moved.ravel().astype(np.float32))
    body.data.update()
    assert_atomic(lambda: jobs.run(mirror_sculpt_async(bpy.context, "Creature", "left_to_right")), 8)


def test_failed_cut_or_bend_restores_everything():
    source, target = ellipsoid("Source", 3), decimate(subdivisions=3)
    add_uv_map(source.data, "UV")
    layer = source.data.uv_layers["UV"].data
    for polygon in source.data.polygons:  # two islands
        for corner in polygon.loop_indices:
            layer[corner].uv.x += 2 * (polygon.center.x > 0.1)
    keep_true_match(target)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    near = int(np.linalg.norm(positions(target.data) - positions(source.data)[10], axis=1).argmin())
    nearer = next(vertex for edge in target.data.edges for vertex in edge.vertices if near in edge.vertices)
    for obj, vertex in ((source, 10), (target, nearer)):
        set_landmark(bpy.context.scene, obj, surface_point_of_vertex(obj, vertex, depsgraph), 1)
    assert_atomic(lambda: jobs.run(bend_match_async(bpy.context, "Target")), 15, every=7)
    assert_atomic(lambda: jobs.run(cut_seams_async(bpy.context, "Source", "Target")), 15, every=7)


def test_errors_concern_one_target_but_faults_undo_all(source, target):
    second, third = ellipsoid("Second", 3), ellipsoid("Third", 3)
    for obj in (target, second, third):
        keep_true_match(obj)
    set_weights(source, "Group", np.ones(len(source.data.vertices)))
    before = state()

    def outcome(error):
        async def work(name):
            write = await prepare_transfer(bpy.context, "Source", name, ("vertex_groups",))

            def written():
                report = write()
                if name == "Second":
                    raise error
                return report

            return written

        return jobs.run(each_target(["Target", "Second", "Third"], work))

    with pytest.raises(RuntimeError):
        outcome(RuntimeError())
    assert state() == before
    assert list(outcome(zo.MeshError("So.")).failed) == ["Second"]
    # "Second" was written before its own error, and is undone only by the enclosing step.
    assert target.vertex_groups.keys() == third.vertex_groups.keys() == ["Group"]


def test_success_leaves_no_backup_data(rich):
    _, target = rich
    before = {kind: len(getattr(bpy.data, kind)) for kind in room.ADDED_TO}
    with room.all_or_nothing(target):
        target.data["own"] = "other"
    assert before == {kind: len(getattr(bpy.data, kind)) for kind in room.ADDED_TO}
    assert target.data["own"] == "other"
