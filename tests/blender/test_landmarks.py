# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks: placing, storing, finding and matching with them."""

from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector
from scenes import activate, ellipsoid, positions, set_weights, values

import zoomout_core as zo
from blender_addon.mesh_data import nearest_surface_point
from blender_addon.operators.base import running_operators
from blender_addon.operators.matching.place_landmarks import ZOOMOUT_OT_place_landmarks
from blender_addon.scene import landmarks
from blender_addon.scene.landmarks import (
    landmark_pairs,
    next_number,
    set_landmark,
    surface_points_on,
    world_positions,
)
from blender_addon.services.matching.match import match_objects
from blender_addon.storage import stored_match
from blender_addon.viewport import landmark_dots

# A view along Y onto a square of four units, of as many pixels as the region has.
PIXELS = 400
VIEW = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
PROJECTION = Matrix.Diagonal((0.5, 0.5, -0.01, 1))


def place(obj, *point):
    return nearest_surface_point(obj, Vector(point), 10.0, bpy.context.evaluated_depsgraph_get())


def add(obj, number, *point, name=""):
    set_landmark(bpy.context.scene, obj, place(obj, *point), number, name)


def world(obj):
    bpy.context.view_layer.update()
    return world_positions(obj, surface_points_on(bpy.context.scene, obj), bpy.context.evaluated_depsgraph_get())


def numbers(obj):
    return sorted(surface_points_on(bpy.context.scene, obj))


def delete_vertices(obj, chosen):
    editable = bmesh.new()
    editable.from_mesh(obj.data)
    editable.verts.ensure_lookup_table()
    bmesh.ops.delete(editable, geom=[editable.verts[i] for i in np.flatnonzero(chosen)], context="VERTS")
    editable.to_mesh(obj.data)
    editable.free()
    obj.data.update()


def test_a_landmark_outlives_renaming_saving_and_reopening(source, target, tmp_path):
    add(source, 1, 1, 0, 0)
    add(target, 1, 1, 0.1, 0, name="Nose")
    before = world(source)[1]
    source.name = "Hero"
    path = str(tmp_path / "marked.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    source, target = bpy.data.objects["Hero"], bpy.data.objects["Target"]
    np.testing.assert_allclose(world(source)[1], before)
    assert bpy.context.scene.zoomout.landmarks[0].name == "Nose"
    assert landmark_pairs(bpy.context, source, target).numbers == (1,)


def test_a_landmark_moves_with_the_face_that_it_was_set_on(source):
    add(source, 1, 0, 0, 1)
    start = world(source)[1]
    moved_by = np.array([3, 0, 2])
    source.location.x = 3
    source.shape_key_add(name="Basis")
    key = source.shape_key_add(name="Up")
    for point in key.data:
        point.co.z += 2
    key.value = 1
    np.testing.assert_allclose(world(source)[1], start + moved_by, atol=1e-6)
    source.modifiers.new("Bend", "CAST").factor = 0.3
    moved = world(source)[1]
    evaluated = source.evaluated_get(bpy.context.evaluated_depsgraph_get())
    distance = np.linalg.norm(positions(evaluated.data) - (moved - moved_by * [1, 0, 0]), axis=1).min()
    assert np.linalg.norm(moved - start - moved_by) > 0.01
    assert distance < 0.1


def test_landmark_is_found_after_renumbering_edits(source):
    add(source, 1, 0, 0, 1)
    before = world(source)[1]
    far_off = positions(source.data)[:, 2] < -0.3
    delete_vertices(source, far_off)
    assert far_off[: len(source.data.vertices)].any()  # the remaining vertices have other numbers
    np.testing.assert_allclose(world(source)[1], before, atol=1e-5)
    subdivision = source.modifiers.new("Finer", "SUBSURF")
    subdivision.levels, subdivision.subdivision_type = 1, "SIMPLE"
    np.testing.assert_allclose(world(source)[1], before, atol=1e-5)


def test_landmark_on_deleted_surface_is_reported(source, target):
    for obj in (source, target):
        add(obj, 1, 0, 0, 1)
        add(obj, 2, 1, 0, 0)
    delete_vertices(source, positions(source.data)[:, 2] > 0.2)
    found = landmark_pairs(bpy.context, source, target)
    assert found.numbers == (2,)
    assert found.notes == (
        "Landmarks on deleted geometry were not used: 1 (on 'Source'); place them again, or remove them.",
    )


def test_the_next_number_completes_a_pair_where_one_is_open(source, target):
    scene, both = bpy.context.scene, [source, target]
    assert next_number(scene, source, both) == 1
    add(source, 1, 1, 0, 0)
    add(source, 2, 0, 0, 1)
    assert next_number(scene, source, both) == 3
    assert next_number(scene, target, both) == 1
    add(target, 1, 1, 0, 0)
    assert next_number(scene, target, both) == 2
    third = ellipsoid("Third", 3)
    assert next_number(scene, third, [source, third]) == 1


def test_landmarks_of_removed_objects_are_removed(source, target):
    add(source, 1, 1, 0, 0)
    add(target, 2, 1, 0, 0)
    bpy.data.objects.remove(target)
    add(source, 3, 0, 0, 1)
    assert [landmark.number for landmark in bpy.context.scene.zoomout.landmarks] == [1, 3]


class Screen:
    """A replacement of the context of a window with one 3D view, which looks along Y."""

    def __init__(self):
        self.region = SimpleNamespace(type="WINDOW", x=0, y=0, width=PIXELS, height=PIXELS)
        view = SimpleNamespace(
            perspective_matrix=PROJECTION @ VIEW, view_matrix=VIEW, is_perspective=False, view_perspective="ORTHO"
        )
        self.space = SimpleNamespace(region_3d=view, local_view=None)
        spaces = SimpleNamespace(active=self.space)
        self.area = SimpleNamespace(
            type="VIEW_3D", x=0, y=0, width=PIXELS, height=PIXELS, regions=[self.region], spaces=spaces
        )
        self.area.tag_redraw = lambda: None
        self.preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))
        self.window = self.window_manager = self.workspace = self
        self.screen = SimpleNamespace(areas=[self.area])
        self.status, self.cursor, self.handlers, self.modal_operators = None, None, 0, []

    def __getattr__(self, name):
        return getattr(bpy.context, name)

    def cursor_modal_set(self, name):
        self.cursor = name

    def cursor_modal_restore(self):
        self.cursor = None

    def modal_handler_add(self, operator):
        self.handlers += 1

    def status_text_set(self, text):
        self.status = text


class Placing:
    """The operator with simulated events, since the `bpy` module has no window."""

    for _name in ("invoke", "modal", "cancel", "_end", "_press", "_drag", "_drop", "_take_back", "_present", "_show"):
        locals()[_name] = getattr(ZOOMOUT_OT_place_landmarks, _name)

    bl_options = ZOOMOUT_OT_place_landmarks.bl_options

    def __init__(self, screen):
        self.screen, self.reports = screen, []
        assert self.invoke(screen, None) == {"RUNNING_MODAL"}

    def report(self, level, text):
        self.reports.append(text)

    def event(self, kind, x=0.0, z=0.0, value="PRESS"):
        """An event at a point of the view's plane."""
        pixels = {"mouse_x": PIXELS * (x / 4 + 0.5), "mouse_y": PIXELS * (z / 4 + 0.5)}
        return self.modal(self.screen, SimpleNamespace(type=kind, value=value, alt=False, **pixels))


@pytest.fixture
def placing(source, target):
    source.location.x, target.location.x = -1.0, 1.0
    for obj in (source, target):
        obj.scale = (0.5,) * 3
    bpy.context.view_layer.update()
    operator = Placing(Screen())
    yield operator
    running_operators.end(operator)


def test_placing_leaves_and_restores_other_modes(source, target):
    bpy.ops.object.mode_set(mode="WEIGHT_PAINT")
    for obj, x in ((source, -1.0), (target, 1.0)):
        obj.location.x, obj.scale = x, (0.5,) * 3
    bpy.context.view_layer.update()
    operator = Placing(Screen())
    assert bpy.context.mode == "OBJECT"
    operator.event("LEFTMOUSE", 0.8, 0.05)
    assert operator.event("ESC") == {"FINISHED"}
    assert (bpy.context.mode, numbers(target)) == ("PAINT_WEIGHT", [1])


def test_clicks_place_pairs_and_status_bar_shows_next_step(source, target, placing):
    screen = placing.screen
    assert screen.cursor == "CROSSHAIR"
    for x, status in (
        (-1.2, "Landmark 1: click on 'Target'"),
        (0.8, "Landmark 2: click on 'Source', 'Target'"),
        (1.1, "Landmark 2: click on 'Sou"),
    ):
        assert placing.event("LEFTMOUSE", x, 0.05) == {"RUNNING_MODAL"}
        assert screen.status.startswith(status)
    assert placing.event("LEFTMOUSE", -0.9, 0.05) == {"RUNNING_MODAL"}
    assert (numbers(source), numbers(target)) == ([1, 2], [1, 2])
    for obj, places in ((source, (-1.2, -0.9)), (target, (0.8, 1.1))):
        found = world(obj)
        np.testing.assert_allclose([found[n][0] for n in (1, 2)], places, atol=1e-5)
        np.testing.assert_allclose([found[n][2] for n in (1, 2)], 0.05, atol=1e-5)
        assert all(found[n][1] < 0 for n in (1, 2))  # on the side that is seen
    assert placing.event("LEFTMOUSE", 0.0, 1.5) == {"RUNNING_MODAL"}
    assert placing.reports == ["There is no surface here: click on 'Source', 'Target'"]
    assert placing.event("ESC") == {"FINISHED"}
    assert (screen.cursor, screen.status) == (None, None)


def test_placing_is_refused_while_a_removed_operator_remains(placing, monkeypatch):
    monkeypatch.setattr(running_operators, "can_begin", lambda window: False)  # to add another one would crash it
    handlers = placing.screen.handlers
    assert placing.invoke(placing.screen, None) == {"CANCELLED"}
    assert placing.screen.handlers == handlers
    assert "move it over a 3D viewport, and try again" in placing.reports[-1]


def test_landmarks_can_be_dragged_and_the_last_removed(source, target, placing):
    placing.event("LEFTMOUSE", -1.2, 0.0)
    placing.event("LEFTMOUSE", 0.8, 0.0)
    placing.event("LEFTMOUSE", -1.2, 0.0)  # grabs it
    placing.event("MOUSEMOVE", -1.1, 0.1)
    placing.event("MOUSEMOVE", 0.8, 0.1)  # over the other object: it stays
    assert placing.event("LEFTMOUSE", -1.1, 0.1, "RELEASE") == {"RUNNING_MODAL"}
    assert (numbers(source), numbers(target)) == ([1], [1])
    np.testing.assert_allclose(world(source)[1][[0, 2]], [-1.1, 0.1], atol=1e-5)
    placing.event("BACK_SPACE")
    assert (numbers(source), numbers(target)) == ([1], [])
    for kind in ("MIDDLEMOUSE", "WHEELUPMOUSE", "MOUSEMOVE", "NUMPAD_1"):
        assert placing.event(kind) == {"PASS_THROUGH"}


def test_cancelled_placing_changes_nothing(source, target, placing):
    assert placing.event("RIGHTMOUSE") == {"CANCELLED"}
    assert not bpy.context.scene.zoomout.landmarks


def test_each_click_is_an_undo_step(source, target, placing):
    bpy.ops.ed.undo_push(message="before")
    placing.event("LEFTMOUSE", -1.2, 0.0)
    placing.event("LEFTMOUSE", 0.8, 0.0)
    for left in (1, 0):
        bpy.ops.ed.undo()
        assert sum(len(landmark.places) for landmark in bpy.context.scene.zoomout.landmarks) == left
    bpy.ops.ed.redo()
    assert numbers(bpy.data.objects["Source"]) == [1]


def test_dots_show_places_and_missing_partners(source, target, placing):
    screen = placing.screen
    for x in (-1.2, 0.8, -0.9):
        placing.event("LEFTMOUSE", x, 0.0)
    shown = landmark_dots.dots(screen, screen.region, screen.space.region_3d, screen.space)
    seen = {(dot.number, dot.obj.name): (round(dot.place.x), dot.paired, dot.active) for dot in shown}
    assert seen == {
        (1, "Source"): (80, True, False),
        (2, "Source"): (110, False, True),
        (1, "Target"): (280, True, False),
    }
    target.hide_set(True)
    activate(target, source)
    shown = landmark_dots.dots(screen, screen.region, screen.space.region_3d, screen.space)
    assert {dot.obj for dot in shown} == {source}
    hues = [landmark_dots.color_of(number) for number in range(1, 9)]
    assert min(np.abs(np.subtract(a, b)).max() for i, a in enumerate(hues) for b in hues[:i]) > 0.1


def select_vertices(obj, *vertices):
    """Select vertices one after another, in Edit Mode."""
    editable = bmesh.from_edit_mesh(obj.data)
    editable.verts.ensure_lookup_table()
    for vert in editable.verts:
        vert.select_set(False)
    editable.select_history.clear()
    for vertex in vertices:
        editable.verts[vertex].select_set(True)
        editable.select_history.add(editable.verts[vertex])
    bmesh.update_edit_mesh(obj.data)


def test_selected_vertices_become_pairs_in_order(source, target):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.object.mode_set("EXEC_DEFAULT", True, mode="EDIT")
    select_vertices(source, 30, 7)
    select_vertices(target, 31, 8)
    bpy.ops.ed.undo_push(message="selected")
    assert bpy.ops.zoomout.landmarks_from_selected() == {"FINISHED"}
    assert bpy.context.mode == "EDIT_MESH"
    bpy.ops.object.mode_set(mode="OBJECT")
    found = landmark_pairs(bpy.context, source, target)
    np.testing.assert_allclose(found.source, positions(source.data)[[30, 7]], atol=1e-6)
    np.testing.assert_allclose(found.target, positions(target.data)[[31, 8]], atol=1e-6)


def test_landmarks_from_selection_are_one_undo_step(source, target):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.object.mode_set("EXEC_DEFAULT", True, mode="EDIT")
    select_vertices(source, 30)
    bpy.ops.ed.undo_push(message="selected")
    bpy.ops.zoomout.landmarks_from_selected()
    assert len(bpy.context.scene.zoomout.landmarks) == 1
    bpy.ops.ed.undo()
    assert (len(bpy.context.scene.zoomout.landmarks), bpy.context.mode) == (0, "EDIT_MESH")
    bpy.ops.ed.redo()
    assert len(bpy.context.scene.zoomout.landmarks) == 1


@pytest.mark.parametrize(("count", "sentence"), [(0, "No vertex"), (65, "65 vertices are selected")])
def test_too_few_or_many_selected_vertices_are_refused(source, target, count, sentence):
    bpy.ops.object.mode_set(mode="EDIT")
    for obj in (source, target):
        select_vertices(obj, *range(count if obj == source else 0))
    with pytest.raises(RuntimeError, match=sentence):
        bpy.ops.zoomout.landmarks_from_selected()
    assert not bpy.context.scene.zoomout.landmarks


def test_small_vertex_groups_of_the_same_name_are_imported(source, target):
    rest = positions(source.data)
    for obj in (source, target):
        set_weights(obj, "Nose", np.linalg.norm(rest - [1, 0, 0], axis=1) < 0.15)
        set_weights(obj, "Everything", np.ones(len(rest)))
    set_weights(source, "Ear", np.linalg.norm(rest - [0, 0, 0.5], axis=1) < 0.15)
    assert bpy.ops.zoomout.import_landmarks(what="GROUPS") == {"FINISHED"}
    assert [landmark.name for landmark in bpy.context.scene.zoomout.landmarks] == ["Nose"]
    found = landmark_pairs(bpy.context, source, target)
    for point in (*found.source, *found.target):
        assert np.linalg.norm(point - [1, 0, 0]) < 0.1
    bpy.ops.zoomout.import_landmarks(what="GROUPS")
    assert len(bpy.context.scene.zoomout.landmarks) == 1  # the same again


def test_empties_that_are_children_or_lie_near_are_imported(source, target):
    target.location.x = 5
    bpy.context.view_layer.update()
    for name, parent, where in (
        ("Nose", source, (1.3, 0, 0)),
        ("Nose", target, (1.3, 0, 0)),
        ("Top", None, (0, 0, 0.51)),
        ("Top", None, (5, 0, 0.51)),
        ("Nowhere", None, (0, 0, 9)),
        ("Nowhere", None, (5, 0, 9)),
    ):
        empty = bpy.data.objects.new(name, None)
        empty.parent, empty.location = parent, where
        bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert bpy.ops.zoomout.import_landmarks(what="EMPTIES") == {"FINISHED"}
    assert {landmark.name for landmark in bpy.context.scene.zoomout.landmarks} == {"Nose", "Top"}
    found = landmark_pairs(bpy.context, source, target)
    np.testing.assert_allclose(found.target - found.source, [[5, 0, 0]] * 2, atol=0.1)
    with pytest.raises(RuntimeError, match="no small vertex groups with matching names"):
        bpy.ops.zoomout.import_landmarks(what="GROUPS")


def test_landmarks_are_removed_one_by_one_or_all(source, target):
    other = ellipsoid("Other", 3)
    for number in (1, 2, 3):
        for obj in (source, target, other):
            add(obj, number, 1, 0, 0.1 * number)
    bpy.context.scene.zoomout.active_landmark = 1
    assert bpy.ops.zoomout.remove_landmark() == {"FINISHED"}
    assert (numbers(source), numbers(target), numbers(other)) == ([1, 3], [1, 3], [1, 2, 3])
    assert bpy.ops.zoomout.clear_landmarks() == {"FINISHED"}
    assert (numbers(source), numbers(target), numbers(other)) == ([], [], [1, 2, 3])
    bpy.data.objects.remove(other)
    landmarks.forget_removed_objects(bpy.context.scene)
    assert not bpy.context.scene.zoomout.landmarks


@pytest.fixture
def alike(source, target):
    """Ellipsoids without a bump, which are symmetric under half turns."""
    for obj in (source, target):
        points = positions(obj.data)
        points *= (np.array([1, 0.7, 0.5]) / np.linalg.norm(points / [1, 0.7, 0.5], axis=1)[:, None]) / [1, 0.7, 0.5]
        obj.data.vertices.foreach_set("co", points.ravel())
        obj.data.update()
    target.location.x = 4
    bpy.context.view_layer.update()
    return source, target


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("initial", ["auto", "landmarks"])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, -1, 1), (1, -1, -1)])
def test_single_pair_resolves_an_ambiguous_match(alike, initial, signs):
    source, target = alike
    where = np.array([0.6, 0.4, 0.28])
    add(source, 1, *where)
    add(target, 1, *(where * signs))
    result = match_objects(bpy.context, source, target, initial=initial)
    truth = positions(target.data) * signs
    image = result.surface_map.interpolate(positions(source.data))
    assert np.linalg.norm(image - truth, axis=1).mean() < 0.1
    if initial == "auto":
        assert result.notes[0] == "Hints used: 1 landmark."


def test_exact_landmarks_are_hit(source, target):
    add(source, 1, 1, 0, 0.1)
    add(target, 1, 1, 0.3, 0)
    near, exact = (
        match_objects(bpy.context, source, target, initial="landmarks", exact_landmarks=exactly).surface_map
        for exactly in (False, True)
    )
    at = np.linalg.norm(positions(target.data) - world(target)[1], axis=1).argmin()
    missed = [np.linalg.norm(m.interpolate(positions(source.data))[at] - world(source)[1]) for m in (near, exact)]
    assert missed[1] < 0.1 < missed[0]


def test_landmark_start_without_pairs_is_refused(source, target):
    add(source, 1, 1, 0, 0)
    with pytest.raises(zo.MeshError) as error:
        match_objects(bpy.context, source, target, initial="landmarks")
    assert str(error.value) == (
        "Matching from landmarks needs at least one landmark on both 'Source' and 'Target': place some, or choose "
        "another method. "
        "Landmarks that are on only one of the two objects were not used: 1 (missing on 'Target')."
    )
    result = match_objects(bpy.context, source, target)
    assert "Landmarks that are on only one of the two objects were not used: 1 (missing on 'Target')." in result.notes
    assert "initial" not in stored_match.description(target.data)["settings"]


def test_landmark_off_the_main_part_is_named_by_its_number(source, target):
    editable = bmesh.new()
    editable.from_mesh(source.data)
    bmesh.ops.create_icosphere(editable, subdivisions=2, radius=0.1, matrix=Matrix.Translation((0, 0, 2)))
    editable.to_mesh(source.data)
    editable.free()
    add(source, 4, 1, 0, 0)
    add(target, 4, 1, 0, 0)
    add(source, 7, 0, 0, 2.1)
    add(target, 7, 0, 0, 1)
    with pytest.raises(
        zo.MeshError, match=r"^Landmark 7 on 'Source', at vertex \d+, is not on its main part: move it\.$"
    ):
        match_objects(bpy.context, source, target, initial="landmarks")


def test_use_of_landmarks_can_be_disabled(source, target):
    for obj in (source, target):
        add(obj, 1, 1, 0, 0)
    activate(target, source)
    assert bpy.ops.zoomout.match(k_final=30, use_landmarks=False) == {"FINISHED"}
    assert not any("landmark" in note for note in stored_match.description(target.data)["notes"])
    assert bpy.ops.zoomout.match(k_final=30, initial="LANDMARKS") == {"FINISHED"}
    assert values(target.data, "zoomout_confidence").mean() > 0.8
