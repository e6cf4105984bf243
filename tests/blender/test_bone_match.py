# SPDX-License-Identifier: GPL-3.0-or-later
"""The bones of a source correct the match of its own body in another pose, without binding it."""

import bpy
import numpy as np
import pytest
from character import character, pose_copy
from scenes import positions

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.services.matching import bone_match
from blender_addon.services.matching.match import match_objects
from blender_addon.services.matching.use_candidate import use_candidate_async
from blender_addon.storage import stored_candidates
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.report.verdict import RED, Verdict


@pytest.fixture
def pair():
    """A rigged source at rest, a target of another topology in another pose, and the target's vertices at rest."""
    source, rig = character(levels=2)
    target, posed = pose_copy(source, rig)
    source.data.calc_loop_triangles()
    triangles = np.array([triangle.vertices for triangle in source.data.loop_triangles])
    found = closest_points(positions(target.data), positions(posed.data), triangles)
    return source, target, SurfaceMap(*found, triangles).interpolate(positions(source.data))


def errors(match, source, truth):
    """(n_t,) distances of the images of a match from the truth."""
    return np.linalg.norm(match.surface_map.interpolate(positions(source.data)) - truth, axis=1)


def test_bones_correct_the_match(pair, monkeypatch):
    source, target, truth = pair
    corrected = match_objects(bpy.context, source, target, detail="fast")
    with monkeypatch.context() as patch:
        patch.setattr(bone_match, "correct_by_bones", lambda mapped, *_: mapped)
        match = match_objects(bpy.context, source, target, detail="fast")
    assert np.median(errors(corrected, source, truth)) < 0.6 * np.median(errors(match, source, truth))
    assert (corrected.confidence >= match.confidence).all()


def test_bones_do_not_correct_a_match_that_is_probably_wrong(pair, monkeypatch):
    source, target, _ = pair
    corrected = []
    monkeypatch.setattr(bone_match, "correct_by_bones", lambda mapped, *_: corrected.append(mapped) or mapped)
    monkeypatch.setattr(zo.MatchResult, "verdict", property(lambda _: Verdict(RED, "It is probably wrong.", "")))
    match_objects(bpy.context, source, target, detail="fast")
    assert not corrected


def test_exact_landmarks_are_met_after_the_correction(pair):
    source, target, truth = pair
    place = int(np.argmax(np.abs(positions(target.data)[:, 0])))
    vertex = int(np.argmin(np.linalg.norm(positions(source.data) - truth[place] - [0, 0.05, 0.05], axis=1)))
    match = match_objects(
        bpy.context, source, target, detail="fast", landmarks=([vertex], [place]), exact_landmarks=True
    )
    there = match.surface_map.interpolate(positions(source.data))[place]
    np.testing.assert_allclose(there, positions(source.data)[vertex], atol=1e-4)


def test_bones_correct_used_candidates_but_no_match_of_an_unrigged_source(pair, monkeypatch):
    source, target, _ = pair
    corrected = []
    monkeypatch.setattr(bone_match, "correct_by_bones", lambda mapped, *_: corrected.append(mapped) or mapped)
    match_objects(bpy.context, source, target, detail="fast")
    assert len(corrected) == 1
    listing = stored_candidates.read(target.data)
    other = next(place for place in range(len(listing.candidates)) if place != listing.chosen)
    used = jobs.run(use_candidate_async(bpy.context, target.name, other))
    assert len(corrected) == 1 + (used.verdict.level != RED)
    source.modifiers.clear()
    source.parent = None
    count = len(corrected)
    match_objects(bpy.context, source, target, detail="fast")
    assert len(corrected) == count
