# SPDX-License-Identifier: GPL-3.0-or-later
"""The drawn sidebar: its content for states of the scene, and what drawing reads."""

import json
import tracemalloc
from functools import partial
from itertools import pairwise
from types import SimpleNamespace

import blf
import bpy
import drawing
import numpy as np
import pytest
from drawing import Context, Layout
from scenes import activate, add_attribute, add_uv_map, ellipsoid, link, new_material, set_weights

from blender_addon import jobs
from blender_addon.api import set_landmark
from blender_addon.mesh_data import Role, read_layers
from blender_addon.operators.base import activity
from blender_addon.scene import mesh_facts
from blender_addon.services.matching.match import match_objects
from blender_addon.services.matching.use_candidate import use_candidate_async
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_candidates, stored_link, stored_match, stored_report, stored_symmetry
from blender_addon.storage.stored_report import transfer_report
from blender_addon.ui import panels
from blender_addon.ui.panels import result, sidebar
from blender_addon.ui.panels.sidebar import VERDICT_ICONS
from blender_addon.viewport import preview
from zoomout_core.matching.report.verdict import UNCERTAIN_MAP, judge
from zoomout_core.messages import message, to_json, warning
from zoomout_core.runtime.progress import Progress

# Width of the sidebar in pixels, before a user changes it.
DEFAULT_WIDTH = 283


def drawn():
    """All drawn elements of the visible panels: type, name or text, and whether they are enabled."""
    everything, context = [], Context()
    for panel in (each for each in panels.CLASSES if issubclass(each, bpy.types.Panel)):
        if not hasattr(panel, "poll") or panel.poll(context):
            everything.append(("panel", panel.bl_label, lambda: True))
            options = partial(panel.draw_options, None) if hasattr(panel, "draw_options") else None
            panel.draw(SimpleNamespace(layout=Layout(everything), draw_options=options), context)
    return [(kind, text, usable()) for kind, text, usable in everything]


def texts():
    return " ".join(text for kind, text, _ in drawn() if kind == "label")


def buttons():
    """Whether each button is enabled."""
    return {text: usable for kind, text, usable in drawn() if kind == "operator"}


@pytest.fixture
def source():
    obj = ellipsoid("Source", 4)
    add_uv_map(obj.data, "UVMap")
    add_uv_map(obj.data, "Second")
    set_weights(obj, "Bone", np.ones(len(obj.data.vertices)))
    add_attribute(obj.data, "side", "FLOAT", "POINT", np.ones(len(obj.data.vertices)))
    obj.data.materials.append(new_material("Skin"))
    obj.data.edges[0].use_seam = True
    return obj


@pytest.fixture
def open_notes(monkeypatch):
    monkeypatch.setattr(drawing, "OPENED", {result.NOTES})


def test_fresh_scene_shows_objects_and_one_button(target):
    rows = [text for kind, text, _ in drawn() if kind == "label"][:4]
    assert rows == ["Selected", "Source", "Target", "Target"]
    assert buttons()["Match"]
    assert buttons()["Match and Transfer"]
    names = [text for kind, text, _ in drawn() if kind == "panel"]
    of_match = "Landmarks", "Hints", "Advanced"
    of_transfer = "Levels of Detail", "Blending", "Groups and Attributes", "Topology"
    below = "Bind to Rig", "Check Binding", "Wrap", "Dress", "Collections", "Libraries", "Symmetry"
    assert names == ["Match", *of_match, "Transfer", *of_transfer, *below]


def place_of_button():
    """The number of elements that are drawn above the button of the match."""
    return next(place for place, (kind, text, _) in enumerate(drawn()) if (kind, text) == ("operator", "Match"))


def test_late_warnings_do_not_move_the_button(source, target):
    before = place_of_button()
    bpy.ops.mesh.primitive_ico_sphere_add(location=(0, 0, 3))
    activate(source, bpy.context.active_object)
    bpy.ops.object.join()
    activate(target, source)
    bpy.context.view_layer.update()
    drawn()
    mesh_facts.inspect_now()
    assert "Loose parts" in texts()
    assert place_of_button() == before


def test_after_a_match_its_verdict_replaces_the_doubt_about_loose_parts(source, target):
    bpy.ops.mesh.primitive_ico_sphere_add(location=(0, 0, 3))
    activate(source, bpy.context.active_object)
    bpy.ops.object.join()
    match_objects(bpy.context, source, target, k_final=30)
    activate(target, source)
    drawn()
    mesh_facts.inspect_now()
    assert "Loose parts" not in texts()


def test_text_is_wrapped_by_its_drawn_width():
    text = "The match is right as a whole (over 99% certain). " + "対応は全体として正しいです。" * 4
    blf.size(sidebar.FONT, 11)
    lines = sidebar._wrap(text, 200)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    widths = [blf.dimensions(sidebar.FONT, line)[0] for line in lines]
    assert max(widths) <= 200
    assert min(widths[:-1]) > 140
    assert sidebar._wrap("", 200) == []


def test_long_names_differ_when_they_are_shortened(source, target):
    target.name = "Character_Body_LOD0_sculpted_and_retopologized_v012"
    width = Context.region.width - sidebar.MARGIN
    shown = [text for kind, text, _ in drawn() if kind == "label"][3]
    blf.size(sidebar.FONT, 11)
    assert shown.startswith("Char")
    assert shown.endswith("_v012")
    assert 0.4 * width < blf.dimensions(sidebar.FONT, shown)[0] + sidebar.ICON <= 0.6 * width
    assert sidebar.elide(Context(), "Hero", 0.6) == "Hero"


def test_names_of_settings_fit_a_sidebar_of_the_default_width():
    blf.size(sidebar.FONT, 11)
    panel = DEFAULT_WIDTH - sidebar.MARGIN
    for setting in bpy.context.scene.zoomout.bl_rna.properties:
        beside_check_box = setting.type == "BOOLEAN"
        width = 0.6 * panel - 26 if beside_check_box else 0.4 * panel - 8
        if setting.identifier not in ("rna_type", "name", "active_landmark"):  # these are not drawn
            assert blf.dimensions(sidebar.FONT, setting.name)[0] <= width, setting.name


def test_check_marks_show_source_counts_and_empty_ones_are_grey(target):
    drawn()
    mesh_facts.inspect_now()
    everything = drawn()
    counts = {
        name: everything[place + 1][1]
        for place, (kind, name, _) in enumerate(everything[:-1])
        if kind == "prop" and everything[place + 1][0] == "label"
    }
    assert counts["uv_maps"] == "2"
    assert counts["vertex_groups"] == counts["materials"] == counts["edges"] == "1"
    layers, _ = read_layers(bpy.data.objects["Source"].data)
    assert counts["attributes"] == str(sum(layer.role is Role.GENERIC for layer in layers))
    assert counts["shape_keys"] == counts["color_attributes"] == counts["custom_normals"] == "0"
    grey = {name for kind, name, usable in everything if kind == "prop" and not usable}
    assert grey == {"shape_keys", "color_attributes", "custom_normals"}


def test_candidates_are_named_and_a_mirror_image_has_no_check_mark(source, target, open_notes):
    match_objects(bpy.context, source, target, k_final=30)
    assert "Candidates" in texts()
    assert "Most Likely" not in buttons()  # folded up while the match is certain

    assert "Matched with" not in texts()  # the row of the source says it
    assert ("mark", "CHECKMARK", True) in drawn()
    listing = stored_candidates.read(target.data)
    mirrored = next(i for i, one in enumerate(listing.candidates) if one.mirrored)
    jobs.run(use_candidate_async(bpy.context, target.name, mirrored))
    assert {"Most Likely", "Mirror Image"} <= buttons().keys()
    elements = [(kind, text) for kind, text, _ in drawn()]
    assert elements[elements.index(("operator", "Mirror Image")) + 1] != ("label", "")  # no empty line below it
    assert "Certain" in texts()
    assert ("mark", "CHECKMARK", True) not in drawn()


def test_candidate_likelihoods_do_not_exceed_the_remainder():
    def words(*certainties):
        candidates = [SimpleNamespace(certainty=certainty) for certainty in certainties]
        listing = SimpleNamespace(candidates=candidates)
        return [result._likelihood(listing, place) for place in range(len(candidates))]

    assert words(0.99, 0.6, 0.0) == ["Certain", "Unlikely", "Unlikely"]
    assert words(0.55, 0.4, 0.05) == ["Likely", "Possible", "Unlikely"]
    assert words(0.02, 0.01) == ["Unlikely", "Unlikely"]


def test_a_report_lists_what_was_skipped_then_warnings_then_notes(source, target):
    transfer_objects(bpy.context, source, target, ["uv_maps"], k_final=30)
    notes = [message("A note"), warning("A warning"), "Plain text"]
    stored_report.write(target, transfer_report(target) | {"notes": notes, "skipped": {"Mask": "it is locked"}})
    everything = drawn()
    marks = {text: mark for (_, text, _), (kind, mark, _) in pairwise(everything) if kind == "mark"}
    listed = "Mask: skipped, it is locked", "A warning", "A note", "Plain text"
    assert [text for _, text, _ in everything if text in listed] == list(listed)
    assert [marks[text] for text in listed] == ["CANCEL", "ERROR", "DOT", "DOT"]


def test_report_shows_the_icon_of_its_verdict(source, target):
    transfer_objects(bpy.context, source, target, ["uv_maps"], k_final=30)
    marks = [text for kind, text, _ in drawn() if kind == "mark"]
    assert marks.count("CHECKMARK") == 2
    kept = transfer_report(target)
    stored_report.write(target, kept | {"verdict": judge(0.6)._asdict()})
    assert [text for kind, text, _ in drawn() if kind == "mark"].count("CHECKMARK") == 1
    assert "choose another candidate or add landmarks" in texts()


def test_a_note_on_the_certainty_does_not_repeat_the_verdict(source, target):
    transfer_objects(bpy.context, source, target, ["uv_maps"], k_final=30)
    kept = transfer_report(target) | {"notes": [warning(UNCERTAIN_MAP, certainty="60%")]}
    stored_report.write(target, kept | {"verdict": judge(0.6)._asdict()})
    assert "probability of only 60%" not in texts()
    stored_report.write(target, kept | {"verdict": None})
    assert "probability of only 60%" in texts()


def test_candidate_names_are_unique():
    candidates = [SimpleNamespace(difference=name) for name in ("BEST", "LEGS", "SIDES", "LEGS", "LEGS")]
    names = result._names(SimpleNamespace(candidates=candidates))
    assert names == ["Most Likely", "Legs Swapped", "Sides Swapped", "Legs Swapped 2", "Legs Swapped 3"]


def test_candidate_thumbnail_is_at_most_two_buttons_high(source, target, monkeypatch):
    match_objects(bpy.context, source, target, k_final=30)
    monkeypatch.setattr(drawing, "OPENED", {result.CERTAIN, result.UNCERTAIN})
    listing = stored_candidates.read(target.data)
    heights = [size for kind, _, size in drawn() if kind == "icon"]
    assert len(heights) == 1 + len(listing.candidates)
    assert max(heights) <= 2
    everything = []
    result._draw_candidates(Layout(everything), listing, enabled=True)
    (column,) = [usable.__self__ for kind, text, usable in everything if (kind, text) == ("label", "Source")]
    assert column.scale_y == max(heights)  # its text is in the middle of the thumbnail


def test_match_notes_are_collapsed_with_a_warning_icon(source, target):
    match_objects(bpy.context, source, target, k_final=30)
    kept = stored_match.description(target.data)
    for note, icon in ((message("A note"), "NONE"), (warning("A warning"), "ERROR")):
        target.data[stored_match.PROPERTY] = json.dumps(kept | {"notes": to_json([note])})
        everything = drawn()
        assert (("label", "Notes", True), ("mark", icon, True)) in pairwise(everything)
        assert note not in texts()
    target.data[stored_match.PROPERTY] = json.dumps(
        kept | {"notes": to_json([warning(UNCERTAIN_MAP, certainty="60%")])}
    )
    assert "Notes" not in texts()  # the verdict says it


def test_buttons_do_not_move_when_previews_change(source, target):
    match_objects(bpy.context, source, target, k_final=30)
    labels = [text for kind, text, _ in drawn() if kind == "label"]
    for kind in preview.OF_MATCH:
        bpy.ops.zoomout.preview(kind=kind)
        assert preview.caption()[1] == preview.OF_MATCH[kind].legend
        assert [text for kind, text, _ in drawn() if kind == "label"] == labels


def test_layers_that_follow_the_source_are_counted(source, target, monkeypatch):
    """A rig has many vertex groups: a line for each would push the other panels off the screen."""
    match_objects(bpy.context, source, target, k_final=30)
    shares = {"UVMap": 0.9, **{f"bone {number}": 1.0 for number in range(40)}}
    entries = stored_match.description(target.data)["entries"]
    monkeypatch.setattr(stored_link, "link_of", lambda _: {"source": "Source", "layers": shares, "entries": entries})
    lines = [text for kind, text, _ in drawn() if kind == "label" and "follows" in text]
    assert lines == ["40 layers: 100% follows 'Source'", "UVMap: 90% follows 'Source'"]


def test_all_check_marks_are_set_or_cleared_at_once(target):
    settings = bpy.context.scene.zoomout
    assert bpy.ops.zoomout.choose_data(every=False) == {"FINISHED"}
    assert settings.data() == []
    assert bpy.ops.zoomout.choose_data() == {"FINISHED"}
    assert "uv_maps" in settings.data()
    assert "shape" not in settings.data()


def test_blocked_button_is_disabled_with_a_reason(target):
    target.data.clear_geometry()
    bpy.context.view_layer.update()
    assert "'Target' has no faces: choose a mesh with a surface." in texts()
    assert buttons()["Match"] is False
    assert buttons()["Match and Transfer"] is False


def test_match_result_is_shown_until_edited(source, target, open_notes):
    match_objects(bpy.context, source, target, k_final=30)
    shown = buttons()
    for name in (
        "Match Again",
        "Transfer",
        "Confidence",
        "Matching Colors",
        "UV Checker",
        "Doubtful",
        "Flipped",
        "No Partner",
        "Swap Sides",
        "Next",
    ):
        assert shown[name], name
    assert "Without a partner" not in texts()
    kept = stored_match.description(target.data)
    target.data[stored_match.PROPERTY] = json.dumps(kept | {"without_partner": [0.0, 0.58]})
    assert "Without a partner: 0% of the target, 58% of the source" in texts()
    bpy.ops.zoomout.preview(kind="PLACES")
    assert preview.OUTDATED not in texts()
    target.data.vertices[3].co.x += 0.1
    bpy.context.view_layer.update()
    drawn()
    mesh_facts.inspect_now()
    assert "The target 'Target' was edited after the match: match again." in texts()
    assert preview.OUTDATED in texts()
    assert preview.caption() == ()
    shown = buttons()
    assert shown["Match Again"]
    assert [shown[name] for name in ("Transfer", "Confidence", "Swap Sides")] == [False] * 3


def test_verdict_and_advice_are_shown_below_the_button(source, target):
    match_objects(bpy.context, source, target, k_final=30)
    assert ("mark", "CHECKMARK", True) in drawn()
    kept = stored_match.description(target.data)
    for verdict, icon in ((judge(0.6), "ERROR"), (judge(0.1), "CANCEL"), (None, "")):
        stored = None if verdict is None else list(verdict)
        target.data[stored_match.PROPERTY] = json.dumps(kept | {"verdict": stored})
        everything = drawn()
        marks = {name for kind, name, _ in everything if kind == "mark"}
        assert marks.intersection(VERDICT_ICONS.values()) == {icon} - {""}
        for text in () if verdict is None else (verdict.sentence, verdict.advice):
            assert text.split()[-1] in texts()


@pytest.mark.slow
def test_changed_landmarks_or_source_are_shown_after_a_match(source, target, open_notes):
    def changed():
        return "Landmarks have changed since the match" in texts()

    for obj in (source, target):
        set_landmark(bpy.context, obj, number=1, vertex=12)
    match_objects(bpy.context, source, target, k_final=30)
    set_landmark(bpy.context, target, number=2, vertex=40)  # on one of the two alone it has no note
    assert not changed()
    set_landmark(bpy.context, source, number=2, vertex=40)
    assert changed()
    assert buttons()["Transfer"]  # the match holds all the same
    match_objects(bpy.context, source, target, k_final=30)
    assert not changed()
    jobs.run(use_candidate_async(bpy.context, target.name, 1))  # of the same match
    assert not changed()
    set_landmark(bpy.context, target, number=2, vertex=41)
    assert changed()
    match_objects(bpy.context, source, target, k_final=30, use_landmarks=False)
    assert not changed()
    bpy.context.scene.zoomout.source = ellipsoid("Other", 3)
    activate(target)
    bpy.context.view_layer.update()
    assert "The source is now 'Other': match again to use it." in texts()
    assert "Matched with 'Source'" in texts()
    assert buttons()["Match and Transfer"]


def test_the_rows_of_objects_do_not_depend_on_the_selection(source, target):
    def rows():
        everything = drawn()
        names = [text for kind, text, _ in everything if kind == "prop"]
        start = next(i for i, each in enumerate(everything) if each[:2] == ("prop", "source"))
        return next(i for i, each in enumerate(everything) if each[:2] == ("prop", "initial")) - start, names[:2]

    third = ellipsoid("Third", 4)
    found = []
    for chosen in ((target, source), (target, third, source), (target,), (source, target)):
        activate(*chosen)
        bpy.context.view_layer.update()
        found.append(rows())
    assert all(each == found[0] for each in found)


def test_buttons_show_the_number_of_targets(source, target):
    bpy.context.scene.zoomout.source = source
    third = ellipsoid("Third", 4)
    activate(target, third, source)
    bpy.context.view_layer.update()
    assert "Target and 1 more" in texts()
    assert buttons()["Match 2 Targets"]
    assert buttons()["Match and Transfer to 2 Targets"]
    fourth = ellipsoid("Fourth", 4)
    activate(target, third, fourth, source)
    bpy.context.view_layer.update()
    assert "Target and 2 more" in texts()
    assert buttons()["Match 3 Targets"]
    third.data.clear_geometry()
    bpy.context.view_layer.update()
    assert "'Third' has no faces: choose a mesh with a surface." in texts()
    assert "Until then, 'Third' is skipped." in texts()
    assert buttons()["Match 3 Targets"]
    bpy.context.scene.zoomout.source = None
    assert buttons()["Match"] is False


def test_outdated_colours_can_be_removed(source, target):
    match_objects(bpy.context, source, target, k_final=30)
    bpy.ops.zoomout.preview(kind="PLACES")
    target.data.vertices.add(1)
    assert (buttons()["Matching Colors"], buttons()[""]) == (False, True)


def test_symmetry_panel_warns_of_few_vertices(target):
    assert "The mesh has few vertices: " not in texts()
    activate(ellipsoid("Ball", 1))
    assert "The mesh has few vertices: " in texts()


def test_symmetry_panel_warns_of_mirror_modifier(target):
    modifier = target.modifiers.new("Mirror", "MIRROR")
    assert "The modifier 'Mirror' creates the other half of the mesh: apply it first" in texts()
    modifier.show_viewport = False
    assert "other half" not in texts()


def test_symmetry_panel_shows_candidates_and_previews(body):
    assert "Detect Again" in buttons()
    chosen = stored_symmetry.description(body.data)["candidates"][0]
    for name in (f"Reflection, {chosen['certainty']:.0%}", "Swap Sides", "Pairs", "Sides", "Asymmetry"):
        assert buttons()[name], name
    assert sum(kind == "icon" for kind, *_ in drawn()) == len(stored_symmetry.description(body.data)["candidates"])
    bpy.ops.zoomout.preview(kind="SIDES")
    assert preview.caption()[1].startswith("Blue is left")
    body.data.vertices[0].co.x += 0.1
    bpy.context.view_layer.update()
    drawn()
    mesh_facts.inspect_now()
    assert "The mesh was reshaped after detection: use Mirror Sculpt" in texts()
    assert preview.OUTDATED in texts()
    assert "Blue is left" not in texts()
    body.data.vertices.add(1)
    assert "The mesh was edited after detection: detect its symmetry again" in texts()
    assert "Pairs" not in buttons()


def test_a_transfer_shows_its_report(source, target):
    transfer_objects(bpy.context, source, target, ["vertex_groups"], k_final=30)
    assert ("panel", "Report", True) in drawn()
    assert "Transferred 1 vertex group" in texts()


def test_running_work_replaces_the_buttons(target, monkeypatch):
    monkeypatch.setattr(activity, "running", Progress(0.3, "Guessing"))
    assert ("progress", "Guessing", 0.3) in drawn()
    assert "Match" not in buttons()
    assert not bpy.ops.zoomout.match.poll()


def test_nearest_start_has_its_own_options(target):
    bpy.context.scene.zoomout.initial = "NEAREST"
    names = {name for kind, name, _ in drawn() if kind == "prop"}
    assert names >= {"max_distance", "max_angle", "either_side"}
    assert not names & {"k_final", "detail", "names"}


@pytest.mark.parametrize("state", ["nothing", "a light", "edit mode"])
def test_panels_are_drawn_whatever_is_active(state):
    if state == "a light":
        bpy.ops.object.light_add()
    elif state == "edit mode":
        activate(ellipsoid("Mesh", 2))
        bpy.ops.object.mode_set(mode="EDIT")
    assert buttons()["Match"] is False


def grid(name, side):
    """A mesh of side * side vertices."""
    mesh = bpy.data.meshes.new(name)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.stack([corner, corner + 1, corner + side + 1, corner + side], axis=1)
    mesh.vertices.add(side * side)
    mesh.vertices.foreach_set("co", np.stack([x, y, 0 * x], axis=1).ravel().astype(np.float32))
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel().astype(np.int32))
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    return link(name, mesh)


def test_drawing_reads_no_positions():
    source, target = grid("Source", 300), grid("Target", 300)
    activate(target, source)
    bpy.context.view_layer.update()
    drawn()
    tracemalloc.start()
    try:
        drawn()
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 2 * len(target.data.vertices)  # the positions alone take 12 bytes a vertex
