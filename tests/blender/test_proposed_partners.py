# SPDX-License-Identifier: GPL-3.0-or-later
"""A match proposes partners of landmarks, which count once they are moved or confirmed."""

from dataclasses import replace

import bmesh
import bpy
import numpy as np
import pytest
from scenes import activate, decimate, ellipsoid, positions
from test_landmarks import Placing, Screen, add, numbers, world
from true_match import keep_true_match

from blender_addon import jobs
from blender_addon.operators.base import running_operators
from blender_addon.scene.landmarks import landmark_pairs, landmarks_fingerprint, surface_points_on, world_positions
from blender_addon.scene.pair import read_pair
from blender_addon.services.clear_data import clear_match_data
from blender_addon.services.matching.propose_partners import propose_partners
from blender_addon.storage import stored_match
from blender_addon.viewport import landmark_dots


def proposed(obj):
    scene = bpy.context.scene
    return sorted(surface_points_on(scene, obj, proposed=True).keys() - surface_points_on(scene, obj).keys())


def where(obj, number):
    """The position of a landmark on an object, proposed or not."""
    places = surface_points_on(bpy.context.scene, obj, proposed=True)
    return world_positions(obj, {number: places[number]}, bpy.context.evaluated_depsgraph_get())[number]


@pytest.fixture
def matched(source):
    """A target of another topology that was matched, then moved and scaled down."""
    obj = decimate("Target", 4)
    keep_true_match(obj)
    obj.location.x, obj.scale = 3, (0.5,) * 3
    bpy.context.view_layer.update()
    activate(obj, source)
    return obj


@pytest.mark.parametrize("finer", [False, True])
def test_proposed_partners_follow_the_map_both_ways(source, matched, finer):
    if finer:
        for obj in (source, matched):
            obj.modifiers.new("Finer", "SUBSURF").subdivision_type = "SIMPLE"
        bpy.context.view_layer.update()
        matched.location.x, matched.scale = 0, (1,) * 3
        bpy.context.view_layer.update()
        keep_true_match(matched)
        matched.location.x, matched.scale = 3, (0.5,) * 3
        bpy.context.view_layer.update()
    add(source, 1, 0.9, 0.2, 0.1)
    add(matched, 2, -0.3, 0.6, 0.1)
    assert propose_partners(bpy.context, [source, matched], [1, 2]) == 2
    assert (proposed(source), proposed(matched)) == ([2], [1])
    for number in (1, 2):
        apart = where(matched, number) - (where(source, number) * 0.5 + [3, 0, 0])
        assert np.linalg.norm(apart) < 0.02


def test_proposals_are_no_evidence_before_they_are_confirmed(source, matched):
    before = landmarks_fingerprint(bpy.context.scene, source, matched)
    add(source, 1, 0.9, 0.2, 0.1)
    propose_partners(bpy.context, [source, matched], [1])
    found = landmark_pairs(bpy.context, source, matched)
    assert found.numbers == ()
    assert "1 (only proposed on 'Target')" in found.notes[0]
    assert landmarks_fingerprint(bpy.context.scene, source, matched) == before
    assert bpy.ops.zoomout.confirm_landmarks() == {"FINISHED"}
    assert landmark_pairs(bpy.context, source, matched).numbers == (1,)
    assert landmarks_fingerprint(bpy.context.scene, source, matched) != before


def test_nothing_is_proposed_without_a_partner_a_match_or_after_an_edit(source, matched):
    objects = [source, matched]
    add(source, 1, 0.9, 0.2, 0.1)
    add(matched, 2, 0.9, 0.2, 0.1)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    kept = stored_match.read(matched.data, pair)
    none = {
        "has_partner": np.zeros(len(pair.target.vertices), bool),
        "source_has_partner": np.zeros(len(pair.source.vertices), bool),
    }
    stored_match.write(matched.data, replace(kept, **none), pair, {})
    assert propose_partners(bpy.context, objects, [1, 2]) == 0
    stored_match.write(matched.data, kept, pair, {})
    other = ellipsoid("Other", 3)
    assert propose_partners(bpy.context, [other, matched], [1, 2]) == 0
    source.data.vertices[0].co.z += 1
    assert propose_partners(bpy.context, objects, [1, 2]) == 0
    source.data.vertices[0].co.z -= 1
    assert propose_partners(bpy.context, objects, [1, 2]) == 2
    clear_match_data(bpy.context, [matched])
    assert numbers(source) == [1]
    assert proposed(source) == []  # of a landmark that only the target had


@pytest.fixture
def placing(source, matched):
    """Both objects side by side in one view, and a click on the source."""
    source.location.x, matched.location.x = -1.0, 1.0
    source.scale = (0.5,) * 3
    bpy.context.view_layer.update()
    operator = Placing(Screen())
    operator.event("LEFTMOUSE", -1.2, 0.05)
    yield operator
    running_operators.end(operator)


def test_clicking_a_proposal_confirms_it(source, matched, placing):
    assert (numbers(source), numbers(matched), proposed(matched)) == ([1], [], [1])
    np.testing.assert_allclose(where(matched, 1)[[0, 2]], [0.8, 0.05], atol=0.02)
    assert "drag or click its pale dot" in placing.screen.status
    placing.event("LEFTMOUSE", 0.8, 0.05)
    placing.event("LEFTMOUSE", 0.8, 0.05, "RELEASE")
    assert (numbers(matched), proposed(matched)) == ([1], [])
    assert "click on 'Source', 'Target'" in placing.screen.status


def test_a_proposal_is_dragged_or_set_by_a_click_elsewhere(source, matched, placing):
    placing.event("LEFTMOUSE", 0.8, 0.05)
    placing.event("MOUSEMOVE", 0.9, 0.1)
    placing.event("LEFTMOUSE", 0.9, 0.1, "RELEASE")
    assert (numbers(matched), proposed(matched)) == ([1], [])
    np.testing.assert_allclose(world(matched)[1][[0, 2]], [0.9, 0.1], atol=1e-5)
    placing.event("LEFTMOUSE", -0.9, 0.05)  # the next one on the source
    assert proposed(matched) == [2]
    placing.event("LEFTMOUSE", 1.3, 0.0)  # far from its dot: there the landmark belongs
    assert (numbers(source), numbers(matched), proposed(matched)) == ([1, 2], [1, 2], [])


def test_proposal_follows_its_landmark_and_is_removed_with_it(source, matched, placing):
    before = where(matched, 1)
    placing.event("LEFTMOUSE", -1.2, 0.05)
    placing.event("MOUSEMOVE", -1.0, 0.1)
    placing.event("LEFTMOUSE", -1.0, 0.1, "RELEASE")
    assert proposed(matched) == [1]
    np.testing.assert_allclose(where(matched, 1) - before, [0.2, 0, 0.05], atol=0.1)
    assert np.linalg.norm(where(matched, 1) - before) > 0.1
    placing.event("BACK_SPACE")
    assert not bpy.context.scene.zoomout.landmarks


def test_proposed_dots_are_marked_as_proposed(source, matched, placing):
    screen = placing.screen
    shown = landmark_dots.dots(screen, screen.region, screen.space.region_3d, screen.space)
    assert {(dot.obj.name, dot.proposed, dot.paired) for dot in shown} == {
        ("Source", False, True),
        ("Target", True, True),
    }


def test_vertices_that_are_selected_on_one_get_partners_on_the_other(source, matched):
    bpy.ops.object.mode_set(mode="EDIT")
    editable = bmesh.from_edit_mesh(source.data)
    editable.verts.ensure_lookup_table()
    for obj in (source, matched):
        for vert in bmesh.from_edit_mesh(obj.data).verts:
            vert.select_set(False)
    for vertex in (30, 7):
        editable.verts[vertex].select_set(True)
    assert bpy.ops.zoomout.landmarks_from_selected() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    assert (numbers(source), proposed(matched)) == ([1, 2], [1, 2])
    found = np.sort([where(matched, number)[0] for number in (1, 2)])
    np.testing.assert_allclose(found, np.sort(positions(source.data)[[7, 30], 0]) * 0.5 + 3, atol=0.03)
