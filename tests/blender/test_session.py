# SPDX-License-Identifier: GPL-3.0-or-later
"""The session of `benchmarks session`: the number of presses, and whether the target follows."""

import numpy as np
import pytest
from drawing import Context, Layout

from benchmarks.timings import session
from blender_addon.ui.panels import ZOOMOUT_PT_binding, ZOOMOUT_PT_transfer


@pytest.fixture
def scene(monkeypatch):
    for name, value in {"CELL": 0.045, "VOXEL": 0.03, "VERTICES": 2500}.items():
        monkeypatch.setattr(session, name, value)
    return session.make_scene()


@pytest.mark.slow
def test_six_presses_bind_a_target_that_follows_the_animation(scene):
    presses = session.bind(scene)
    assert len(presses) == 6
    for _, effect in filter(lambda press: press.effect, presses[:-1]):
        effect()
    drawn = []
    shown = type("Drawn", (), {"layout": Layout(drawn)})()
    ZOOMOUT_PT_binding.draw_header(shown, Context())
    ZOOMOUT_PT_transfer.draw(shown, Context())
    usable = {(kind, name) for kind, name, is_usable in drawn if is_usable()}
    assert {("prop", "bind"), ("prop", "shape"), ("operator", presses[-1].what)} <= usable
    assert "DEFAULT_CLOSED" not in getattr(ZOOMOUT_PT_binding, "bl_options", set())
    presses[-1].effect()
    assert scene.target.parent == scene.rig
    assert np.median(session.distances(scene)) < 0.2


@pytest.mark.slow
def test_manual_binding_takes_more_steps_and_tears_the_target(scene):
    assert [len(way(scene)) for way in (session.parent, session.parent_in_its_shape)] == [10, 14]
    groups = {group.name for group in scene.source.vertex_groups}
    for _, effect in filter(lambda press: press.effect, session.parent(scene)):
        effect()
    assert {group.name for group in scene.target.vertex_groups} == groups
    assert np.median(session.distances(scene)) > 2
