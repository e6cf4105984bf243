# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters that are assembled from loose shells are matched as one body."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from creatures import directions
from mannequins import PARTS, STEP, Mannequin, as_one_skin, mannequin
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.matching.attempt import ATTEMPTS
from zoomout_core.matching.components.bodies import BODIES, find_bodies
from zoomout_core.matching.components.hulls import HULLS, hull_of, main_part_coverage, orient_outwards
from zoomout_core.matching.ranking.rank import RANKING
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.voxel_remesh import voxel_remesh
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("few_candidates")


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """Use coarser hulls and fewer candidates, which give the same results for these parts in half the time."""
    with (
        retune(HULLS, resolution=96, tight_resolution=128),
        retune(RANKING, direct=(2, 4), mirrored=(1, 2)),
    ):
        yield


@pytest.fixture(scope="module")
def at_rest(coarse: None) -> Mannequin:
    return mannequin(None, 80, 1)


@pytest.fixture(scope="module")
def stepping() -> Mannequin:
    return mannequin(STEP, 60, 2)


@pytest.fixture(scope="module")
def stepped(at_rest: Mannequin, stepping: Mannequin) -> zo.MatchResult:
    return zo.match(at_rest.surface, stepping.surface)


def right_parts(result: zo.MatchResult, source: Mannequin, target: Mannequin) -> float:
    """Share of target vertices that map to the part of the same name."""
    return float((source.part[result.surface_map.vertex] == target.part).mean())


def place_errors(result: zo.MatchResult, source: Mannequin, target: Mannequin) -> np.ndarray:
    """(n_t,) distances of images from the true places on the parts; a mannequin is 1.9 high."""
    return np.linalg.norm(result.surface_map.interpolate(source.keys) - target.keys, axis=1)


def test_shells_match_their_partners_in_another_pose(stepped, at_rest: Mannequin, stepping: Mannequin) -> None:
    assert right_parts(stepped, at_rest, stepping) > 0.99
    assert place_errors(stepped, at_rest, stepping).mean() < 0.015
    assert stepped.certainty > 0.9
    assert stepped.confidence.mean() > 0.7
    assert any("14 of 14 parts matched to their partners" in note for note in stepped.notes)


@pytest.mark.slow
def test_different_build_is_matched(at_rest: Mannequin) -> None:
    target = mannequin(STEP, 60, 2, build=(1.15, 1.25, 0.9))
    result = zo.match(at_rest.surface, target.surface)
    assert right_parts(result, at_rest, target) > 0.97
    assert place_errors(result, at_rest, target).mean() < 0.03


@pytest.mark.slow
def test_one_skin_and_many_shells_are_matched_both_ways(at_rest: Mannequin) -> None:
    hull = as_one_skin(STEP)
    assert right_parts(zo.match(at_rest.surface, hull.surface), at_rest, hull) > 0.95
    assert right_parts(zo.match(hull.surface, at_rest.surface), hull, at_rest) > 0.9


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("eye", [False, True])
def test_welded_shell_maps_to_all_pieces_of_the_source(eye: bool) -> None:
    sphere, leg = directions(300, 1), [0.2, 0.2, 1.1] * directions(150, 2) + [0.9, -0.2, -1.4]
    pieces = [Surface(points, ConvexHull(points).simplices) for points in (sphere, leg)]
    both = Surface.joined(pieces)
    welded = Surface(*voxel_remesh(both.vertices, both.triangles, 60))
    around = 0.15 * directions(60, 3) + [-0.9, 0.4, 0.5]
    beside = [Surface(around, ConvexHull(around).simplices)] if eye else []
    source, target = Surface.joined([*pieces, *beside]), Surface.joined([welded, *beside])
    result = zo.match(source, target)
    image = result.surface_map.vertex
    # A body of one shell is not mapped to a piece of the other.
    assert any("matched to their partners" in note for note in result.notes) is eye
    clear_of_the_sphere = np.linalg.norm(target.vertices, axis=1) > 1 + 0.22 * np.sqrt(welded.area)
    assert (image[clear_of_the_sphere] >= len(sphere)).mean() > 0.95


@pytest.mark.slow
def test_missing_shells_do_not_affect_the_others(at_rest: Mannequin) -> None:
    less = mannequin(STEP, 60, 3, without=("head", "hand.L"))
    assert right_parts(zo.match(at_rest.surface, less.surface), at_rest, less) > 0.98
    more = mannequin(STEP, 60, 3)
    source = mannequin(None, 80, 1, without=("head", "hand.L"))
    result = zo.match(source.surface, more.surface)
    there = ~np.isin(more.part, ("head", "hand.L"))
    assert (source.part[result.surface_map.vertex] == more.part)[there].mean() > 0.98
    assert result.confidence[~there].mean() < 0.6 * result.confidence[there].mean()


@pytest.mark.slow
def test_hopeless_match_is_reported_with_advice() -> None:
    heap = [0.3 * directions(40, i) * [1, 0.5, 0.2 + 0.1 * i] + 4 * directions(12, 5)[i] for i in range(12)]
    faces = [ConvexHull(points).simplices + 40 * i for i, points in enumerate(heap)]
    with retune(HULLS, resolution=64, tight_resolution=80):
        result = zo.match(mannequin(None, 50).surface, Surface(np.vstack(heap), np.vstack(faces)), samples=400)
    assert result.certainty < 0.1
    assert "No reliable match" in result.notes[0]
    assert "landmarks" in result.notes[0]


@pytest.mark.slow
def test_inside_out_shells_are_matched_as_accurately(stepped, at_rest: Mannequin, stepping: Mannequin) -> None:
    turned = Surface(stepping.surface.vertices, stepping.surface.triangles[:, ::-1])
    result = zo.match(at_rest.surface, turned)
    assert right_parts(result, at_rest, stepping) > 0.99
    assert place_errors(result, at_rest, stepping).mean() == pytest.approx(
        place_errors(stepped, at_rest, stepping).mean(), rel=0.2
    )


@pytest.mark.slow
def test_unit_and_placement_do_not_affect_the_match(stepped, at_rest: Mannequin, stepping: Mannequin) -> None:
    turn = Rotation.from_euler("xyz", (40, 20, 110), degrees=True).as_matrix()
    moved = Surface(1000 * stepping.surface.vertices @ turn.T + 300, stepping.surface.triangles)
    result = zo.match(at_rest.surface, moved)
    assert right_parts(result, at_rest, stepping) > 0.99
    assert place_errors(result, at_rest, stepping).mean() == pytest.approx(
        place_errors(stepped, at_rest, stepping).mean(), abs=0.004
    )


@pytest.mark.slow
def test_overlapping_shells_stay_in_place(at_rest: Mannequin) -> None:
    target = mannequin(None, 60, 4)
    result = zo.match(at_rest.surface, target.surface)
    assert any("overlap in place" in note for note in result.notes)
    assert place_errors(result, at_rest, target).mean() < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("posed", [False, True])
def test_head_welded_to_the_torso_maps_to_the_head(at_rest: Mannequin, posed: bool) -> None:
    pose = STEP if posed else None
    upper = mannequin(pose, 400, 4, without=tuple(set(PARTS) - {"torso", "head"}))
    limbs = mannequin(pose, 60, 4, without=("torso", "head"))
    welded = Surface(*voxel_remesh(upper.surface.vertices, upper.surface.triangles, 40))
    target = Surface.joined([welded, limbs.surface])
    result = zo.match(at_rest.surface, target)
    image = at_rest.part[result.surface_map.vertex[: len(welded.vertices)]]
    distance, _ = cKDTree(upper.surface.vertices[upper.part == "torso"]).query(welded.vertices)
    assert (image[distance > 0.1] == "head").mean() > 0.95


@pytest.mark.slow
def test_head_that_turns_is_not_taken_as_in_place(at_rest: Mannequin) -> None:
    target = mannequin({"head": (-30, 0, 0), "foot.L": (0, 0, 40), "foot.R": (0, 0, -40)}, 60, 4)
    result = zo.match(at_rest.surface, target.surface)
    assert not any("overlap in place" in note for note in result.notes)
    assert place_errors(result, at_rest, target)[target.part == "head"].mean() < 0.03


@pytest.mark.slow
def test_target_that_faces_the_other_way_is_matched(at_rest: Mannequin) -> None:
    target = mannequin(None, 60, 4)
    about = Surface(target.surface.vertices * [-1, -1, 1], target.surface.triangles)
    result = zo.match(at_rest.surface, about)
    assert right_parts(result, at_rest, target) > 0.98
    assert not any("overlap in place" in note for note in result.notes)


@pytest.mark.slow
def test_regions_constrain_shells(at_rest: Mannequin, stepping: Mannequin) -> None:
    # Left and right names are swapped, as if an artist used another convention.
    regions = [
        (np.flatnonzero(at_rest.part == f"hand.{theirs}"), np.flatnonzero(stepping.part == f"hand.{ours}"))
        for ours, theirs in (("L", "R"), ("R", "L"))
    ]
    result = zo.match(at_rest.surface, stepping.surface, regions=regions)
    images = at_rest.part[result.surface_map.vertex]
    assert not any("14 of 14" in note for note in result.notes)
    assert (images[stepping.part == "thigh.L"] == "thigh.L").mean() > 0.95


@pytest.mark.slow
def test_a_region_of_both_feet_does_not_exchange_them(at_rest: Mannequin, stepping: Mannequin) -> None:
    feet = [np.flatnonzero(np.char.startswith(one.part, "foot")) for one in (at_rest, stepping)]
    assert (
        right_parts(zo.match(at_rest.surface, stepping.surface, regions=[(feet[0], feet[1])]), at_rest, stepping) > 0.98
    )


@pytest.mark.slow
def test_second_candidate_swaps_the_sides(stepped, at_rest: Mannequin, stepping: Mannequin) -> None:
    side = np.char.rpartition(stepping.part, ".")[:, 2]
    sided = np.isin(side, ("L", "R"))
    image = np.char.rpartition(at_rest.part[stepped.use(1).surface_map.vertex], ".")[:, 2]
    assert (image[sided] != side[sided]).mean() > 0.9


def test_outline_maps_between_partner_shells(stepped, at_rest: Mannequin, stepping: Mannequin) -> None:
    vertices, images = stepped.outline(0)
    assert (at_rest.part[images] == stepping.part[vertices]).mean() > 0.8


@pytest.mark.slow
def test_landmarks_on_shells_are_used(at_rest: Mannequin, stepping: Mannequin) -> None:
    places = [[int(np.flatnonzero(one.part == name)[5]) for name in ("head", "hand.L")] for one in (at_rest, stepping)]
    result = zo.match(at_rest.surface, stepping.surface, landmarks=(places[0], places[1]))
    assert right_parts(result, at_rest, stepping) > 0.98


@pytest.mark.slow
def test_landmark_outside_the_main_part_does_not_stop_the_match(at_rest, stepping: Mannequin) -> None:
    # Settings that also try the torsos, which have no foot.
    foot = [[int(np.flatnonzero(one.part == "foot.R")[5])] for one in (at_rest, stepping)]
    with retune(ATTEMPTS, certain=1.0), retune(BODIES, much_of_body=0.0):
        result = zo.match(at_rest.surface, stepping.surface, landmarks=(foot[0], foot[1]))
    assert right_parts(result, at_rest, stepping) > 0.98


@pytest.mark.slow
def test_exact_landmarks_on_shells_are_hit(at_rest: Mannequin, stepping: Mannequin) -> None:
    places = [[int(np.flatnonzero(one.part == name)[5]) for name in ("head", "hand.L")] for one in (at_rest, stepping)]
    result = zo.match(at_rest.surface, stepping.surface, landmarks=(places[0], places[1]), exact_landmarks=True)
    images = result.surface_map.interpolate(at_rest.surface.vertices)[places[1]]
    assert np.abs(images - at_rest.surface.vertices[places[0]]).max() < 1e-6
    assert right_parts(result, at_rest, stepping) > 0.95


@pytest.mark.slow
def test_earlier_map_of_shells_is_used(stepped, at_rest: Mannequin, stepping: Mannequin) -> None:
    again = zo.match(at_rest.surface, stepping.surface, initial="given", initial_map=stepped.surface_map)
    assert right_parts(again, at_rest, stepping) > 0.99
    by_place = zo.match(at_rest.surface, stepping.surface, initial="proximity")
    assert len(by_place.candidates) == 1


@pytest.mark.slow
def test_two_runs_give_identical_results(stepped, at_rest: Mannequin, stepping: Mannequin) -> None:
    again = zo.match(at_rest.surface, stepping.surface)
    assert (again.surface_map.triangle == stepped.surface_map.triangle).all()
    assert (again.confidence == stepped.confidence).all()


def test_body_that_covers_the_hull_is_matched_itself() -> None:
    hull = as_one_skin().surface
    eye = 0.03 * directions(60, 1) + [0.04, -0.16, 1.72]
    both = Surface.joined([hull, Surface(eye, ConvexHull(eye).simplices)])
    assert main_part_coverage(both, hull_of(both)) > 0.95
    first, *others = find_bodies(both, both, 0)
    assert not first.source.is_hull
    assert not others


def test_a_torso_is_not_taken_for_the_body(at_rest: Mannequin) -> None:
    assert main_part_coverage(at_rest.surface, hull_of(at_rest.surface)) < 0.5
    first, *others = find_bodies(at_rest.surface, at_rest.surface, 0)
    assert first.source.is_hull
    assert not others


@pytest.mark.slow
def test_nearly_touching_limbs_are_separated_by_tight_hulls() -> None:
    # The knees touch.
    knees = STEP | {"thigh.L": (-25, 9, 0), "shin.L": (25, -9, 0), "thigh.R": (-25, -9, 0), "shin.R": (25, 9, 0)}
    at_rest, target = mannequin(None, 70, 1), mannequin(knees, 70, 2, (0.8, 1.0, 1.0))
    with retune(ATTEMPTS, certain=1.0), retune(HULLS, resolution=80, tight_resolution=120):
        result = zo.match(at_rest.surface, target.surface, k_final=60, samples=400)
    assert right_parts(result, at_rest, target) > 0.9


def test_hull_gives_its_nearest_vertex_and_position(at_rest: Mannequin) -> None:
    hull = hull_of(at_rest.surface)
    on_hull = hull.to_surface(hull.vertices)[hull.vertex_of]
    assert np.linalg.norm(on_hull - at_rest.surface.vertices, axis=1).mean() < 0.03


def test_open_shells_are_wound_like_the_hull_around_them() -> None:
    hull = as_one_skin().surface
    plate = np.array([[x, -0.15, z] for x in (-0.1, 0.1) for z in (1.2, 1.4)])
    for corners in ([[0, 2, 3], [0, 3, 1]], [[0, 3, 2], [0, 1, 3]]):
        both = Surface.joined([hull, Surface(plate, corners)])
        mesh = orient_outwards(both.working, hull_of(both))
        on_plate = mesh.component[mesh.triangles[:, 0]] == 1
        a, b, c = mesh.vertices[mesh.oriented_triangles[on_plate]].transpose(1, 0, 2)
        assert (np.cross(b - a, c - a)[:, 1] < 0).all()
