# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of a match's candidates: swapped sides are corrected by one click, also in a reopened file."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from creatures import creature, mirrored_vertex, true_vertex
from scenes import activate, from_pydata, positions, snapshot_file, values

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching import cached_results, candidates
from blender_addon.services.matching.match import match_objects
from blender_addon.services.matching.seam_cut import cut_seams
from blender_addon.services.matching.use_candidate import use_candidate_async
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_candidates, stored_match
from blender_addon.ui import thumbnails

RESTING, BENT = creature(2500), creature(2000, seed=1, bend=0.5)


@pytest.fixture
def source():
    return from_pydata("Source", RESTING.surface.vertices.tolist(), RESTING.surface.triangles.tolist())


@pytest.fixture
def target(source):
    """The same creature in another pose and topology, whose sides only the orientation distinguishes."""
    obj = from_pydata("Target", BENT.surface.vertices.tolist(), BENT.surface.triangles.tolist())
    bpy.context.view_layer.update()
    activate(obj, source)
    return obj


def error(target, truth):
    """Mean error of the stored match on the source."""
    rest = positions(bpy.data.objects["Source"].data)
    kept = stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))
    images, wanted = kept.surface_map.interpolate(rest), rest[truth(RESTING, BENT)]
    return np.linalg.norm(images[: len(wanted)] - wanted, axis=1).mean()  # a cut adds vertices at the end


def test_swapping_sides_is_reversible(source, target):
    assert bpy.ops.zoomout.match(k_final=60) == {"FINISHED"}
    listing = stored_candidates.read(target.data)
    assert listing.chosen == 0
    assert {candidate.mirrored for candidate in listing.candidates} == {False, True}
    assert error(target, true_vertex) < 0.1 < error(target, mirrored_vertex)
    for truth, mirrored in ((mirrored_vertex, True), (true_vertex, False)):
        assert bpy.ops.zoomout.swap_match_sides() == {"FINISHED"}
        assert error(target, truth) < 0.1
        listing = stored_candidates.read(target.data)
        assert listing.candidates[listing.chosen].mirrored == mirrored
        note = f"Candidate {listing.chosen + 1} of {len(listing.candidates)} was chosen."
        assert stored_match.description(target.data)["notes"][0] == note


@pytest.mark.slow
def test_candidates_are_cycled_in_order_and_numbered(source, target):
    match_objects(bpy.context, source, target, k_final=60)
    count = len(stored_candidates.read(target.data).candidates)
    seen = []
    for _ in range(count):
        assert bpy.ops.zoomout.use_candidate() == {"FINISHED"}
        seen.append(stored_candidates.read(target.data).chosen)
    assert seen == [*range(1, count), 0]
    assert bpy.ops.zoomout.use_candidate(candidate=count) == {"FINISHED"}
    assert stored_candidates.read(target.data).chosen == count - 1
    before = snapshot_file()
    with pytest.raises(RuntimeError, match=f"There is no candidate {count + 1}"):
        bpy.ops.zoomout.use_candidate(candidate=count + 1)
    assert snapshot_file() == before


@pytest.mark.slow
def test_unlikely_candidates_are_hidden_except_first_and_mirrored(source, target):
    result, pair = (
        match_objects(bpy.context, source, target, k_final=60),
        jobs.run(read_pair(bpy.context, "Source", "Target")),
    )

    def listing(certainty, reverses_orientation):
        changed = {"certainty": certainty}
        if reverses_orientation is not None:
            changed["reverses_orientation"] = reverses_orientation
        found = tuple(replace(candidate, **changed) for candidate in result.candidates)
        return candidates.list_candidates(replace(result, candidates=found), pair)

    flips = [candidate.reverses_orientation for candidate in result.candidates]
    assert flips.count(False) > 1
    wanted = listing(1.0, None)
    partner = wanted.candidates[candidates.side_swapped_candidate(wanted)].number
    assert flips[partner]
    assert [one.number for one in listing(0.0, None).candidates if not one.mirrored] == [0]
    # Where both sides are alike whichever way round, the map that swaps them need not be a mirror image.
    unlikely = listing(0.0, False)
    assert [one.number for one in unlikely.candidates] == [0, partner]
    assert candidates.side_swapped_candidate(unlikely) == 1


def test_computed_candidates_are_reused(source, target, monkeypatch):
    match_objects(bpy.context, source, target, k_final=60)
    first = target.data[stored_match.PROPERTY], values(target.data, "zoomout_triangle").tolist()
    jobs.run(use_candidate_async(bpy.context, target.name, 1))
    monkeypatch.setattr(zo.MatchResult, "use", None)
    jobs.run(use_candidate_async(bpy.context, target.name, 0))
    assert values(target.data, "zoomout_triangle").tolist() == first[1]


def test_reopened_file_still_offers_swapped_sides(source, target, tmp_path):
    match_objects(bpy.context, source, target, k_final=60)
    listed = stored_candidates.read(target.data)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kept.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "kept.blend"))
    target = bpy.data.objects["Target"]
    again = stored_candidates.read(target.data)
    assert not cached_results.is_cached(again)
    np.testing.assert_array_equal(again.candidates[0].colors, listed.candidates[0].colors)
    assert bpy.ops.zoomout.swap_match_sides() == {"FINISHED"}
    assert error(target, mirrored_vertex) < 0.1
    assert cached_results.is_cached(stored_candidates.read(target.data))


def match_and_cut(source, target):
    """Match, and cut the target between two UV islands of the source; returns the list of candidates before the cut."""
    upper = positions(source.data)[RESTING.surface.triangles, 2].mean(axis=1) > 0
    source.data.uv_layers.new(name="Atlas").data.foreach_set("uv", np.repeat(upper, 6).astype(np.float32))
    match_objects(bpy.context, source, target, k_final=60)
    listing = stored_candidates.read(target.data)
    cut_seams(bpy.context, source, target)
    assert len(target.data.vertices) > len(BENT.surface.vertices)
    return listing


def test_cutting_seams_keeps_the_list_but_not_cached_results(source, target):
    before = match_and_cut(source, target)
    after = stored_candidates.read(target.data)
    assert cached_results.is_cached(before)
    assert not cached_results.is_cached(after)
    for one, other in zip(after.candidates, before.candidates, strict=True):
        np.testing.assert_array_equal(one.colors, other.colors)


@pytest.mark.slow
def test_sides_can_be_swapped_after_cutting_seams(source, target):
    match_and_cut(source, target)
    assert bpy.ops.zoomout.swap_match_sides() == {"FINISHED"}
    assert error(target, mirrored_vertex) < 0.1


@pytest.mark.slow
def test_match_without_alternatives_has_no_list(source, target):
    match_objects(bpy.context, source, target, k_final=60)
    match_objects(bpy.context, source, target, initial="proximity", k_final=60)
    assert stored_candidates.read(target.data) is None
    with pytest.raises(RuntimeError, match="no candidates"):
        bpy.ops.zoomout.swap_match_sides()


def test_a_transfer_that_matches_first_lists_candidates_too(source, target):
    source.vertex_groups.new(name="All").add(list(range(len(source.data.vertices))), 1, "REPLACE")
    transfer_objects(bpy.context, source, target, ["vertex_groups"], k_final=60)
    assert len(stored_candidates.read(target.data).candidates) > 1


def test_edited_target_refuses_another_candidate(source, target):
    match_objects(bpy.context, source, target, k_final=60)
    target.data.vertices[3].co.x += 0.1
    bpy.context.view_layer.update()
    before = snapshot_file()
    with pytest.raises(RuntimeError, match="'Target' was edited since it was matched: match again"):
        bpy.ops.zoomout.swap_match_sides()
    assert snapshot_file() == before


def test_the_list_takes_a_few_kilobytes_whatever_the_size_of_the_mesh(source, target):
    match_objects(bpy.context, source, target, k_final=60)
    assert len(target.data[stored_candidates.PROPERTY]) < 30_000


@pytest.mark.slow
def test_results_of_the_last_matches_only_are_cached(source, target):
    for k_final in (40, 50, 60):
        match_objects(bpy.context, source, target, k_final=k_final)
    assert len(cached_results._cache) <= cached_results.MAX_CACHED


def test_thumbnails_distinguish_the_sides(source, target):
    match_objects(bpy.context, source, target, k_final=60)
    listing = stored_candidates.read(target.data)
    pictures = [
        thumbnails.picture(listing.points, listing.candidates[place].colors / 255)
        for place in (listing.chosen, candidates.side_swapped_candidate(listing))
    ]
    shape = pictures[0][..., 3] > 0
    assert 0.05 < shape.mean() < 0.6
    np.testing.assert_array_equal(shape, pictures[1][..., 3] > 0)
    assert np.abs(pictures[0] - pictures[1])[shape, 0].mean() > 0.2  # red varies across
    assert np.abs(pictures[0] - pictures[1])[shape, 2].mean() < 0.1  # and blue up
    assert all(picture.min() >= 0 and picture.max() <= 1 for picture in pictures)
