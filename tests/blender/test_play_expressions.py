# SPDX-License-Identifier: GPL-3.0-or-later
"""Expressions are played on source and target, and everything is as before at the end."""

import bpy
import numpy as np
import pytest
from mathutils import Vector
from playing import playing
from scenes import activate, ellipsoid, positions, snapshot_file
from test_faces import add_expressions

from blender_addon.colors import stretched_colors
from blender_addon.mesh_data import HeldKeys
from blender_addon.operators.base import play_operator as play
from blender_addon.operators.base import running_operators
from blender_addon.operators.play_expressions import ZOOMOUT_OT_play_expressions
from blender_addon.services import expressions
from blender_addon.services.matching.match import match_objects
from blender_addon.viewport import overlay


@pytest.fixture
def pair(empty_scene):
    """A source and a target with the same keys, matched."""
    source, target = add_expressions(ellipsoid("Source", 4)), add_expressions(ellipsoid("Target", 4))
    match_objects(bpy.context, source, target, detail="fast")
    activate(target)
    return source, target


@pytest.fixture
def operator():
    made = playing(ZOOMOUT_OT_play_expressions)
    yield made
    running_operators.end(made)
    overlay.clear()


def values(obj):
    return {block.name: round(block.value, 3) for block in obj.data.shape_keys.key_blocks if block.value}


def test_keys_are_played_at_half_and_full_strength_on_both(pair, operator, monkeypatch):
    source, target = pair
    target.data.shape_keys.key_blocks["cheekPuff"].value = 0.3
    target.show_only_shape_key = True
    before, now = snapshot_file(), [100.0]
    monkeypatch.setattr(play, "monotonic", lambda: now[0])
    assert operator.invoke(operator.window, None) == {"RUNNING_MODAL"}
    assert operator.window.status.startswith("jawOpen, 1 of 4, 0%")
    assert values(target) == {}
    assert not target.show_only_shape_key
    for seconds, strength in ((0.5, 0.5), (0.9, 1.0)):
        now[0] += seconds
        assert operator.event("TIMER") == {"PASS_THROUGH"}
        assert values(source) == values(target) == {"jawOpen": strength}
    assert operator.event("RIGHT_ARROW") == {"RUNNING_MODAL"}
    assert operator.window.status.startswith("browInnerUp_L, 2 of 4, 0%")
    operator.event("LEFT_ARROW")
    operator.event("LEFT_ARROW")
    now[0] += 0.5
    operator.event("TIMER")
    assert values(source) == values(target) == {"cheekPuff": 0.5}
    assert operator.event("ESC") == {"CANCELLED"}
    assert snapshot_file() == before
    assert (values(target), values(source)) == ({"cheekPuff": 0.3}, {})
    assert target.show_only_shape_key
    assert (operator.window.timers, operator.window.status) == (0, None)


def test_stretched_vertices_are_red_for_the_key_that_stretches_them(pair, operator, monkeypatch):
    _, target = pair
    target.data.shape_keys.key_blocks["browInnerUp_L"].points[40].co.z += 1
    now = [0.0]
    monkeypatch.setattr(play, "monotonic", lambda: now[0])
    operator.invoke(operator.window, None)
    assert overlay.overlays() == ()
    operator.event("RIGHT_ARROW")
    (shown,) = overlay.overlays()
    assert shown.object_uid == target.session_uid
    red = (shown.values == shown.values[40]).all(axis=1)
    assert 1 <= red.sum() < 20
    assert not overlay.is_outdated()
    operator.event("RIGHT_ARROW")
    assert overlay.overlays() == ()
    operator.event("LEFT_ARROW")
    operator.cancel(operator.window)
    assert overlay.overlays() == ()


def test_intersecting_faces_of_the_played_key_are_red(pair, operator, monkeypatch):
    _, target = pair
    monkeypatch.setattr(expressions, "find_stretched", lambda *_: {})
    for point in target.data.shape_keys.key_blocks["jawOpen"].points:
        point.co.y += 2 * np.exp(-20 * ((point.co - Vector((0.0, -0.7, 0.0))).length_squared))
    operator.invoke(operator.window, None)
    (shown,) = overlay.overlays()
    red = (shown.values == stretched_colors(np.ones(1, dtype=bool))).all(axis=1)
    assert positions(target.data)[red, 1].max() > 0.5  # at the back, which the front goes through
    assert red.mean() < 0.5
    operator.event("RIGHT_ARROW")
    assert overlay.overlays() == ()


def test_without_a_match_only_the_active_mesh_plays(empty_scene, operator):
    alone = add_expressions(ellipsoid("Alone", 3))
    other = add_expressions(ellipsoid("Other", 3))
    activate(alone)
    operator.invoke(operator.window, None)
    operator.event("RIGHT_ARROW")
    assert values(other) == {}
    bpy.data.objects.remove(alone)
    operator.event("TIMER")
    operator.cancel(operator.window)


def test_driven_muted_and_animated_keys_are_played_and_restored(empty_scene):
    obj = add_expressions(ellipsoid("Face", 3))
    blocks = obj.data.shape_keys.key_blocks
    driver = blocks["jawOpen"].driver_add("value")
    driver.driver.expression = "0.7"
    blocks["cheekPuff"].mute = True
    blocks["browInnerUp_L"].value = 0.2
    blocks["browInnerUp_L"].keyframe_insert("value", frame=1)
    bpy.context.view_layer.update()
    held = HeldKeys(obj)
    for name in ("jawOpen", "cheekPuff", "browInnerUp_L"):
        held.play(obj, name, 0.5)
        bpy.context.view_layer.update()
        evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.shape_keys or obj.data.shape_keys
        assert {block.name for block in evaluated.key_blocks if block.value} == {name}
        assert not blocks[name].mute
        held.restore(obj)
    assert not driver.mute
    bpy.context.view_layer.update()
    assert values(obj) == {"jawOpen": 0.7, "browInnerUp_L": 0.2}
    assert [block.name for block in blocks if block.mute] == ["cheekPuff"]


def test_playing_requires_relative_keys(empty_scene):
    plain = ellipsoid("Plain", 2)
    activate(plain)
    assert not bpy.ops.zoomout.play_expressions.poll()
    add_expressions(plain)
    assert bpy.ops.zoomout.play_expressions.poll()
    plain.data.shape_keys.use_relative = False
    assert not bpy.ops.zoomout.play_expressions.poll()
    np.testing.assert_raises(RuntimeError, bpy.ops.zoomout.play_expressions)
