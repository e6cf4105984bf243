# SPDX-License-Identifier: GPL-3.0-or-later
"""Matching again replaces the match in a painted vertex group, and keeps it elsewhere."""

import bpy
import numpy as np
import pytest
from scenes import positions, set_weights, values
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.match import match_objects
from blender_addon.storage import stored_candidates, stored_match

NEAREST = {"initial": "proximity", "k_final": 30}


def images(target):
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    return stored_match.read(target.data, pair).surface_map.interpolate(pair.source.vertices)


def stored(target):
    return [values(target.data, name).copy() for name in ("zoomout_triangle", "zoomout_barycentric")]


@pytest.fixture
def wrong(source, target):
    """A match that maps everything to one point, and a group with half of the target."""
    keep_true_match(target, still=np.tile([1.0, 0, 0], (len(target.data.vertices), 1)), doubtful=9999)
    set_weights(target, "Half", positions(target.data)[:, 0] < 0)
    return target


@pytest.mark.parametrize("keeps", [False, True])
def test_only_the_chosen_region_is_matched_again(source, wrong, keeps):
    before, (triangle, weights) = images(wrong), stored(wrong)
    redo = (positions(wrong.data)[:, 0] < 0) != keeps
    match_objects(bpy.context, source, wrong, redo_group="Half", redo_keeps=keeps, **NEAREST)
    np.testing.assert_array_equal(stored(wrong)[0][~redo], triangle[~redo])
    np.testing.assert_allclose(stored(wrong)[1][~redo], weights[~redo], atol=1e-6)
    confidence = values(wrong.data, "zoomout_confidence")
    np.testing.assert_allclose(confidence[~redo], 0.1, atol=1e-6)
    deep = redo & (np.abs(positions(wrong.data)[:, 0]) > 0.4)
    assert np.linalg.norm(images(wrong) - positions(wrong.data), axis=1)[deep].max() < 0.1
    assert np.linalg.norm(before - positions(wrong.data), axis=1)[deep].mean() > 0.3
    assert confidence[deep].min() > 0.3
    assert "of the area was matched again, and the rest was kept." in stored_match.description(wrong.data)["notes"][0]
    assert stored_candidates.read(wrong.data) is None  # these are of whole maps


def test_partners_are_known_for_both_regions(source, wrong):
    match_objects(bpy.context, source, wrong, redo_group="Half", **NEAREST)
    assert stored_match.description(wrong.data)["without_partner"] is None  # the old match did not know
    match_objects(bpy.context, source, wrong, **NEAREST)
    match_objects(bpy.context, source, wrong, redo_group="Half", **NEAREST)
    assert stored_match.description(wrong.data)["without_partner"] == [0, 0]


def test_the_operator_takes_the_group_of_the_sidebar(source, wrong):
    triangle, _ = stored(wrong)
    bpy.context.scene.zoomout.redo_group = "Half"
    assert bpy.ops.zoomout.match(initial="PROXIMITY", k_final=30) == {"FINISHED"}
    kept = positions(wrong.data)[:, 0] >= 0
    np.testing.assert_array_equal(stored(wrong)[0][kept], triangle[kept])
    assert (stored(wrong)[0] != triangle).any()


def test_everything_is_matched_without_an_earlier_match(source, target):
    set_weights(target, "Half", positions(target.data)[:, 0] < 0)
    result = match_objects(bpy.context, source, target, redo_group="Half", **NEAREST)
    assert isinstance(result, zo.MatchResult)
    assert result.notes[0].startswith("There was no match to keep")
    assert not any("no match to keep" in note for note in match_objects(bpy.context, source, target, **NEAREST).notes)


@pytest.mark.parametrize(
    ("group", "keeps", "sentence"),
    [
        ("Gone", False, "has no vertex group 'Gone'"),
        ("Empty", False, "is empty"),
        ("All", True, "covers the whole mesh"),
    ],
)
def test_useless_group_is_refused_in_one_sentence(source, wrong, group, keeps, sentence):
    wrong.vertex_groups.new(name="Empty")
    set_weights(wrong, "All", np.ones(len(wrong.data.vertices)))
    before = stored(wrong)
    with pytest.raises(zo.MeshError, match=sentence):
        match_objects(bpy.context, source, wrong, redo_group=group, redo_keeps=keeps, **NEAREST)
    np.testing.assert_array_equal(stored(wrong)[0], before[0])
