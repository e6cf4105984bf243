# SPDX-License-Identifier: GPL-3.0-or-later
"""A match is corrected at landmarks that it misses, near these only."""

import bpy
import numpy as np
import pytest
from scenes import activate, positions, values
from test_landmarks import add
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.landmarks import landmark_pairs
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.bend_match import bend_match_async
from blender_addon.services.preflight import find_outdated
from blender_addon.storage import stored_match

HERE, THERE = np.array([0.2, 0.6, 0.3]), np.array([0.4, 0.55, 0.3])


def images(target):
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    return stored_match.read(target.data, pair).surface_map.interpolate(pair.source.vertices)


@pytest.fixture
def marked(source, target):
    """A true match of two coincident objects, and a landmark that is elsewhere on the source."""
    keep_true_match(target)
    add(source, 1, *THERE)
    add(target, 1, *HERE)
    return target


def test_bent_match_meets_the_landmark_and_stays_elsewhere(source, marked):
    before, triangle = images(marked), values(marked.data, "zoomout_triangle").copy()
    found = landmark_pairs(bpy.context, source, marked)
    assert bpy.ops.zoomout.bend_match() == {"FINISHED"}
    at = np.linalg.norm(positions(marked.data) - found.target[0], axis=1).argmin()
    moved = images(marked) - before
    wanted = found.source[0] - found.target[0]
    assert np.linalg.norm(moved[at] - wanted) < 0.15 * np.linalg.norm(wanted)
    far = positions(marked.data)[:, 1] < -0.4
    np.testing.assert_array_equal(values(marked.data, "zoomout_triangle")[far], triangle[far])
    assert np.linalg.norm(moved, axis=1).max() < 1.2 * np.linalg.norm(wanted)
    assert stored_match.description(marked.data)["notes"] == ["Bent to 1 landmark."]


def test_bending_flips_nothing_and_updates_the_match(source, marked):
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    stored_match.write(marked.data, stored_match.read(marked.data, pair), pair, {stored_match.LANDMARKS: "other"})
    assert find_outdated(bpy.context, marked)
    said = jobs.run(bend_match_async(bpy.context, marked.name))
    jobs.run(bend_match_async(bpy.context, marked.name))
    assert said.startswith("Bent the match of 'Target' to 1 landmark, which it missed by up to ")
    assert find_outdated(bpy.context, marked) == []
    bent = stored_match.read(marked.data, pair)
    assert zo.evaluation.flipped_share(bent.surface_map, pair.source, pair.target) < 0.01
    assert bent.notes == ("Bent to 1 landmark.",)


def test_distant_landmark_is_met_without_flipping(source, target):
    keep_true_match(target)
    add(source, 1, -0.55, 0.45, 0.3)
    add(target, 1, -0.2, 0.6, 0.3)
    jobs.run(bend_match_async(bpy.context, target.name))
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    bent = stored_match.read(target.data, pair).surface_map
    assert zo.evaluation.flipped_share(bent, pair.source, pair.target) == 0


def test_bending_without_a_usable_landmark_changes_nothing(source, target):
    keep_true_match(target)
    before = values(target.data, "zoomout_triangle").copy()
    add(target, 1, *HERE)
    with pytest.raises(zo.MeshError, match="have no landmark in common: place one on both"):
        jobs.run(bend_match_async(bpy.context, target.name))
    add(source, 1, 0, -0.7, 0)
    with pytest.raises(zo.MeshError, match="too far from landmark 1 to be bent to it: match again"):
        jobs.run(bend_match_async(bpy.context, target.name))
    np.testing.assert_array_equal(values(target.data, "zoomout_triangle"), before)
    activate(source)
    with pytest.raises(RuntimeError, match="Match this mesh first"):
        bpy.ops.zoomout.bend_match()
