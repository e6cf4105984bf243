# SPDX-License-Identifier: GPL-3.0-or-later
"""The selected source and target are analysed while Blender is idle, as the preferences say."""

from types import SimpleNamespace

import bpy
import pytest
from scenes import activate, delete_vertex, ellipsoid

import zoomout_core as zo
from blender_addon import watch
from blender_addon.jobs import run
from blender_addon.operators.base import activity, prepare_ahead
from blender_addon.operators.matching.match import ZOOMOUT_OT_match
from blender_addon.properties.preferences import EXTENSION, prepares_ahead
from blender_addon.services.matching import prepare_ahead as service
from blender_addon.services.matching.match import match_objects
from zoomout_core.matching.preparation import memory_cache
from zoomout_core.runtime.progress import Progress


@pytest.fixture
def prepared(monkeypatch):
    """The pairs of surfaces that were prepared, in place of their analyses."""
    pairs = []
    monkeypatch.setattr(service, "prepare", lambda source, target, options: pairs.append((source, target, options)))
    return pairs


def advance():
    """Prepare what is selected to the end."""
    while prepare_ahead.advance(bpy.context):
        pass


def sizes(prepared):
    return [tuple(len(surface.vertices) for surface in pair[:2]) for pair in prepared]


def test_match_reuses_prepared_analyses(source, target, monkeypatch):
    zo.forget_shapes()
    run(service.prepare_ahead(bpy.context, "Source", "Target", detail="fast"))
    monkeypatch.setattr(memory_cache, "analyse", None)
    assert match_objects(bpy.context, source, target, detail="fast", names=False).certainty > 0


def test_each_selected_pair_is_prepared_once(source, target, prepared):
    advance()
    advance()
    assert len(prepared) == 1
    other = ellipsoid("Other", 3)
    activate(other, source)
    advance()
    assert sizes(prepared) == [(len(source.data.vertices), len(each.data.vertices)) for each in (target, other)]


def test_preparation_uses_the_chosen_detail(source, target, prepared):
    bpy.context.scene.zoomout.detail = "FAST"
    advance()
    bpy.context.scene.zoomout.detail = "FINE"
    advance()
    assert [options.k_final for *_, options in prepared] == [60, 200]


def test_an_edited_mesh_is_prepared_again(source, target, prepared):
    advance()
    delete_vertex(target)
    bpy.context.view_layer.update()
    advance()
    (_, before), (_, after) = sizes(prepared)
    assert after == before - 1


@pytest.mark.parametrize("reason", ["alone", "edit mode", "at work", "same order", "large", "shared", "copied"])
def test_unusable_pairs_are_not_prepared(source, target, prepared, monkeypatch, reason):
    if reason == "alone":
        activate(target)
    elif reason == "edit mode":
        bpy.ops.object.mode_set(mode="EDIT")
    elif reason == "at work":
        monkeypatch.setattr(activity, "running", Progress(0.5, "Matching"))
    elif reason == "same order":
        bpy.context.scene.zoomout.initial = "SAME_ORDER"
    elif reason == "large":
        monkeypatch.setattr(prepare_ahead, "MAX_VERTICES", 100)
    elif reason == "shared":
        target.data = source.data
    else:
        target.modifiers.new("Mirror", "MIRROR")
    advance()
    assert not prepared
    if reason == "edit mode":
        bpy.ops.object.mode_set(mode="OBJECT")


def test_unreadable_mesh_is_tried_once(source, target, monkeypatch):
    tried = []

    def refuse(*_):
        tried.append(True)
        raise zo.MeshError("It has no faces.")

    monkeypatch.setattr(service, "prepare", refuse)
    advance()
    advance()
    assert tried == [True]


def test_operators_and_loaded_files_stop_preparation(source, target, prepared, monkeypatch):
    assert prepare_ahead.advance(bpy.context)
    watch.forget_everything()
    assert prepare_ahead._job is None
    assert prepare_ahead.advance(bpy.context)
    monkeypatch.setattr(ZOOMOUT_OT_match, "_left", None, raising=False)
    bpy.ops.zoomout.match(detail="FAST")
    assert prepare_ahead._job is None


def test_preferences_control_preparation(monkeypatch):
    registered = []
    timers = SimpleNamespace(is_registered=lambda tick: False, register=lambda tick, **_: registered.append(tick))
    monkeypatch.setattr(
        prepare_ahead, "bpy", SimpleNamespace(context=None, app=SimpleNamespace(background=False, timers=timers))
    )
    for wanted in (False, True):
        monkeypatch.setattr(prepare_ahead, "prepares_ahead", lambda context, wanted=wanted: wanted)
        prepare_ahead.consider()
    assert registered == [prepare_ahead._tick]
    for addons, expected in (({}, False), *(({EXTENSION: said}, said) for said in (False, True))):
        entries = {name: SimpleNamespace(preferences=SimpleNamespace(prepare_ahead=on)) for name, on in addons.items()}
        context = SimpleNamespace(preferences=SimpleNamespace(addons=entries))
        assert prepares_ahead(context) == expected
