# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators in other modes than Object Mode leave the mode before reading, and return to it at the end."""

from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest
from scenes import activate, ellipsoid, link, positions, set_weights
from test_landmarks import select_vertices
from test_modal_operator import ESCAPE, TICK, Window, Work

import zoomout_core as zo
from blender_addon.operators.base import modes, running_operators
from blender_addon.services import preflight
from blender_addon.storage import stored_match

MODES = ("EDIT", "SCULPT", "WEIGHT_PAINT", "VERTEX_PAINT", "TEXTURE_PAINT")
NEAREST = {"initial": "NEAREST"}


def enter(mode):
    bpy.ops.object.mode_set(mode=mode)


def tool():
    used = bpy.context.workspace.tools.from_space_view3d_mode(bpy.context.mode)
    return used and used.idname


def state():
    context = bpy.context
    selected, edited = (
        {obj.name for obj in objects} for objects in (context.selected_objects, context.objects_in_mode)
    )
    return context.mode, context.active_object.name, selected, edited, tool()


@pytest.mark.parametrize("mode", MODES)
def test_match_and_transfer_restore_the_mode(source, target, mode):
    set_weights(source, "Bone", np.ones(len(source.data.vertices)))
    enter(mode)
    before = state()
    assert before[0] != "OBJECT"
    assert [finding for finding in preflight.findings(bpy.context) if finding.blocks] == []
    assert bpy.ops.zoomout.match(**NEAREST) == {"FINISHED"}
    assert state() == before
    assert stored_match.description(target.data)["source"] == "Source"
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    assert state() == before
    assert bpy.ops.zoomout.preview(kind="CONFIDENCE") == {"FINISHED"}
    assert state() == before
    enter("OBJECT")
    assert target.vertex_groups.keys() == ["Bone"]
    assert preflight.stale(bpy.context, target) == ""


@pytest.mark.parametrize("mode", MODES)
def test_failed_match_restores_the_mode(source, target, mode):
    source.data.clear_geometry()
    enter(mode)
    before = state()
    with pytest.raises(RuntimeError, match="'Source'"):
        bpy.ops.zoomout.match(**NEAREST)
    assert state() == before
    assert stored_match.description(target.data) is None


@pytest.mark.parametrize("mode", MODES)
def test_operation_in_a_mode_is_one_undo_step(source, target, mode):
    set_weights(source, "Bone", np.ones(len(source.data.vertices)))
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.object.mode_set("EXEC_DEFAULT", True, mode=mode)
    # In Blender's window an operator pushes its step itself, see `restore_after`.
    called = () if mode in modes.OWN_UNDO else ("EXEC_DEFAULT", True)
    bpy.ops.zoomout.transfer(*called, **NEAREST)
    assert len(bpy.data.objects["Target"].vertex_groups) == 1
    bpy.ops.ed.undo()
    undone = bpy.data.objects["Target"]
    assert undone.vertex_groups.keys() == []
    assert stored_match.PROPERTY not in undone.data
    assert undone.mode == mode
    bpy.ops.ed.redo()
    assert bpy.data.objects["Target"].vertex_groups.keys() == ["Bone"]
    assert stored_match.description(bpy.data.objects["Target"].data) is not None


def test_unsaved_edit_mode_changes_are_matched(source, target):
    enter("EDIT")
    editable = bmesh.from_edit_mesh(target.data)
    editable.verts.ensure_lookup_table()
    bmesh.ops.delete(editable, geom=[editable.verts[7]], context="VERTS")
    bmesh.update_edit_mesh(target.data)
    assert bpy.ops.zoomout.match(**NEAREST) == {"FINISHED"}
    described = stored_match.description(target.data)
    assert described["vertices"] == len(positions(ellipsoid("Other", 4).data)) - 1
    enter("OBJECT")
    assert described["vertices"] == len(target.data.vertices)
    assert preflight.stale(bpy.context, target) == ""


def test_the_selection_in_edit_mode_stays(source, target):
    enter("EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    select_vertices(target, 5, 9)
    bpy.ops.zoomout.match(**NEAREST)
    editable = bmesh.from_edit_mesh(target.data)
    assert [vertex.index for vertex in editable.verts if vertex.select] == [5, 9]
    assert [vertex.index for vertex in editable.select_history] == [5, 9]


def test_dyntopo_sculpt_is_matched_as_it_is(source, target):
    """Dyntopo triangulates quads at once; the mesh has the triangles after leaving Sculpt Mode."""
    round_mesh = bmesh.new()
    bmesh.ops.create_uvsphere(round_mesh, u_segments=16, v_segments=12, radius=1)
    round_mesh.to_mesh(target.data)
    round_mesh.free()
    enter("SCULPT")
    faces = len(target.data.polygons)
    bpy.ops.sculpt.dynamic_topology_toggle()
    assert bpy.ops.zoomout.match(**NEAREST) == {"FINISHED"}
    assert bpy.context.mode == "SCULPT"
    enter("OBJECT")
    size = stored_match.description(target.data)["size"]["target"]
    assert size[1] == len(target.data.polygons) > 1.5 * faces


@pytest.mark.parametrize("with_source", [True, False])
def test_multi_object_editing_is_restored(source, target, with_source):
    bystander = ellipsoid("Bystander", 2)
    activate(target, *([source] if with_source else []))
    bpy.context.scene.zoomout.source = source
    enter("EDIT")
    bystander.select_set(True)
    bpy.context.scene.zoomout.initial = "NEAREST"
    before = state()
    assert before[3] == ({"Source", "Target"} if with_source else {"Target"})
    assert [finding for finding in preflight.findings(bpy.context) if finding.blocks] == []
    modes.restore(bpy.context, modes.leave(bpy.context, Work()))
    assert state() == before


def test_mode_is_not_restored_if_another_object_became_active(source, target):
    enter("SCULPT")
    left = modes.leave(bpy.context, Work())
    bpy.context.view_layer.objects.active = source
    modes.restore(bpy.context, left)
    assert bpy.context.mode == "OBJECT"


class InBlender(Window):
    """Blender's context without a window."""

    def __getattr__(self, name):
        return getattr(bpy.context, name)


@pytest.fixture
def window(monkeypatch):
    modal_operator = "blender_addon.operators.base.modal_operator."
    monkeypatch.setattr(modal_operator + "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
    monkeypatch.setattr(modal_operator + "redraw_sidebars", lambda: None)
    monkeypatch.setattr(modal_operator + "SLICE", 0.0)  # one pause a tick
    monkeypatch.setattr(running_operators, "_running", [])
    found = InBlender()
    del found.active_object
    return found


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("end", ["finished", "failed", "escape"])
def test_sliced_work_runs_in_object_mode_and_restores_the_mode(target, window, mode, end):
    enter(mode)
    before = state()
    work = Work(count=1, error=zo.MeshError("No.") if end == "failed" else None)
    assert work.invoke(window, None) == {"RUNNING_MODAL"}
    assert bpy.context.mode == "OBJECT"
    assert work.modal(window, TICK) == {"RUNNING_MODAL"}
    assert bpy.context.mode == "OBJECT"
    result = work.modal(window, ESCAPE if end == "escape" else TICK)
    assert result == ({"FINISHED"} if end == "finished" else {"CANCELLED"})
    assert state() == before


@pytest.fixture
def timers(monkeypatch):
    """The registered timers, which Blender calls only if it has a window."""
    found = []
    in_window = SimpleNamespace(
        background=False, timers=SimpleNamespace(register=lambda f, first_interval: found.append(f))
    )
    monkeypatch.setattr(modes, "bpy", SimpleNamespace(app=in_window, context=bpy.context, ops=bpy.ops))
    return found


@pytest.mark.parametrize("mode", MODES)
def test_modes_with_own_undo_return_after_the_operators_step(target, timers, mode):
    enter(mode)
    before = state()
    assert Work().execute(bpy.context) == {"FINISHED"}
    if mode in modes.OWN_UNDO:
        assert bpy.context.mode == "OBJECT"
        timers.pop()()
    assert not timers
    assert state() == before


def test_work_ended_by_blender_restores_the_mode_when_idle(target, timers, window):
    enter("SCULPT")
    work = Work()
    work.invoke(window, None)
    window.window = bpy.context.window
    work.cancel(window)
    assert bpy.context.mode == "OBJECT"
    timers.pop()()
    assert bpy.context.mode == "SCULPT"


def test_mode_of_a_closed_window_is_not_restored(target, timers):
    enter("SCULPT")
    left = modes.leave(bpy.context, Work())
    modes.restore_later(SimpleNamespace(window=None), left)
    timers.pop()()
    assert bpy.context.mode == "OBJECT"


@pytest.mark.parametrize("mode", MODES)
def test_symmetry_and_landmark_operators_work_in_other_modes(body, mode):
    set_weights(body, "Arm.L", np.linspace(0, 1, len(body.data.vertices)))
    bpy.context.scene.zoomout.source = link("Other", body.data.copy())
    enter(mode)
    before = state()
    assert bpy.ops.zoomout.symmetrise_weights() == {"FINISHED"}
    assert bpy.ops.zoomout.select_symmetry_line() == {"FINISHED"}
    assert bpy.ops.zoomout.clear_landmarks() == {"FINISHED"}
    assert state() == before
    if mode == "EDIT":
        assert any(vertex.select for vertex in bmesh.from_edit_mesh(body.data).verts)
    enter("OBJECT")
    assert set(body.vertex_groups.keys()) == {"Arm.L", "Arm.R"}
