# SPDX-License-Identifier: GPL-3.0-or-later
"""`match` finds the right map without hints on any mesh, and reports where it is uncertain."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
import pytest
from creatures import LIMBS, Creature, creature, directions, mirrored_vertex, on_limb, true_vertex
from scipy.spatial import ConvexHull

import zoomout_core as zo
from zoomout_core.matching import pipeline
from zoomout_core.matching.hypotheses import collect
from zoomout_core.matching.ranking import rank as ranking
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.progress import Outlines
from zoomout_core.spectral import lanczos

# Limit of the mean geodesic error over sqrt(area) for a right map of the bent creature; flips exceed it tenfold.
RIGHT = 0.03


def mean_error(result: zo.MatchResult, source: Surface, truth: np.ndarray) -> float:
    return float(zo.geodesic_error(result.surface_map, source, np.arange(len(truth)), truth).mean())


@pytest.fixture(scope="module")
def resting() -> Creature:
    return creature(2000, seed=0)


@pytest.fixture(scope="module")
def bent() -> Creature:
    """The same creature in another pose, with another topology and fewer vertices."""
    return creature(1500, seed=1, bend=0.9)


@pytest.fixture(scope="module")
def watched(resting: Creature, bent: Creature) -> tuple[zo.MatchResult, list[zo.Progress]]:
    seen: list[zo.Progress] = []
    return zo.match(resting.surface, bent.surface, progress=seen.append), seen


@pytest.fixture(scope="module")
def result(watched: tuple[zo.MatchResult, list[zo.Progress]]) -> zo.MatchResult:
    return watched[0]


@pytest.fixture(scope="module")
def coarse() -> tuple[Creature, Creature]:
    """The same two creatures with fewer vertices, which suffice for most tests of map selection."""
    return creature(1400), creature(1000, seed=1, bend=0.9)


def match_coarsely(pair: tuple[Creature, Creature], **given: Any) -> zo.MatchResult:
    return zo.match(pair[0].surface, pair[1].surface, k_final=60, samples=400, **given)


def test_another_pose_and_topology_is_matched_without_a_hint(resting, bent, result) -> None:
    truth = true_vertex(resting, bent)
    assert mean_error(result, resting.surface, truth) < RIGHT
    assert mean_error(result, resting.surface, mirrored_vertex(resting, bent)) > 5 * RIGHT
    assert result.surface_map.barycentric.min() >= 0
    np.testing.assert_allclose(result.surface_map.barycentric.sum(axis=1), 1, atol=1e-9)


def test_first_look_comes_before_refinement(resting, bent, watched) -> None:
    result, seen = watched
    (first, *_) = [progress for progress in seen if progress.outlines]
    assert first.fraction < 0.5
    assert first.stage not in [progress.stage for progress in seen if progress.stage.startswith("Refining")]
    vertices, images = first.outlines[0]
    off = resting.surface.vertices[images] - resting.surface.vertices[true_vertex(resting, bent)[vertices]]
    assert np.linalg.norm(off, axis=1).mean() / np.sqrt(resting.surface.area) < 2 * RIGHT
    assert len(seen[-1].outlines) == len(result.candidates)
    for shown, used in zip(seen[-1].outlines[0], result.outline(0), strict=True):
        np.testing.assert_array_equal(shown, used)


def test_first_look_does_not_wait_for_self_maps(coarse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "self_maps", too_late)
    with pytest.raises(zo.Cancelled):
        match_coarsely(coarse, progress=cancel_at_first_look)
    with pytest.raises(AssertionError):
        match_coarsely(coarse)


def test_a_first_look_does_not_wait_for_candidates_to_be_refined(coarse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ranking, "_candidate", too_late)
    with pytest.raises(zo.Cancelled):
        match_coarsely(coarse, progress=cancel_at_first_look)


@pytest.mark.parametrize(("count", "ended"), [(2, AssertionError), (3, zo.Cancelled)])
def test_three_landmarks_give_a_first_look_before_hypotheses(coarse, monkeypatch, count: int, ended) -> None:
    resting, bent = coarse
    tips = np.array([int(np.argmax(bent.directions @ LIMBS[i])) for i in range(count)])
    landmarks = true_vertex(resting, bent)[tips], tips
    monkeypatch.setattr(collect, "GENERATORS", (too_late,))
    with pytest.raises(ended):
        match_coarsely(coarse, landmarks=landmarks, progress=cancel_at_first_look)


def test_first_look_by_landmarks_is_nearly_the_final_map(coarse: tuple[Creature, Creature]) -> None:
    resting, bent = coarse
    truth = true_vertex(resting, bent)
    tips = np.array([int(np.argmax(bent.directions @ LIMBS[i])) for i in range(3)])
    looks: list[Outlines] = []

    def listen(progress: zo.Progress) -> None:
        looks.append(progress.outlines)
        cancel_at_first_look(progress)

    with pytest.raises(zo.Cancelled):
        match_coarsely(coarse, landmarks=(truth[tips], tips), progress=listen)
    vertices, images = looks[-1][0]
    off = resting.surface.vertices[images] - resting.surface.vertices[truth[vertices]]
    assert np.linalg.norm(off, axis=1).mean() / np.sqrt(resting.surface.area) < 2 * RIGHT


def cancel_at_first_look(progress: zo.Progress) -> None:
    if progress.outlines:
        raise zo.Cancelled


def too_late(*_: object) -> NoReturn:
    raise AssertionError


@pytest.mark.slow
def test_precise_points_beat_their_nearest_vertices(resting: Creature, bent: Creature, result) -> None:
    # In the same pose the true image is the vertex's own position.
    again = creature(2500, seed=1)
    images = zo.match(resting.surface, again.surface).surface_map
    precise = np.linalg.norm(images.interpolate(resting.surface.vertices) - again.surface.vertices, axis=1)
    rounded = np.linalg.norm(resting.surface.vertices[images.vertex] - again.surface.vertices, axis=1)
    assert np.median(precise) < 0.9 * np.median(rounded)


@pytest.mark.slow
def test_the_mirrored_map_is_kept_as_a_candidate_and_can_be_used(resting, bent, result) -> None:
    mirrored = mirrored_vertex(resting, bent)
    flips = [i for i, candidate in enumerate(result.candidates) if candidate.reverses_orientation]
    assert flips
    assert min(mean_error(result.use(i), resting.surface, mirrored) for i in flips) < RIGHT
    assert not result.candidates[0].reverses_orientation
    with pytest.raises(ValueError, match="no candidate 99"):
        result.use(99)


def test_outline_approximates_the_map_of_a_candidate(resting, bent, result) -> None:
    flip = next(i for i, candidate in enumerate(result.candidates) if candidate.reverses_orientation)
    points = resting.surface.vertices
    for number, truth in ((0, true_vertex(resting, bent)), (flip, mirrored_vertex(resting, bent))):
        vertices, images = result.outline(number)
        apart = np.linalg.norm(points[images] - points[truth[vertices]], axis=1)
        assert np.median(apart) < 2 * RIGHT * np.sqrt(resting.surface.area)


@pytest.mark.slow
def test_outline_numbers_vertices_including_unused_ones(resting, bent, result) -> None:
    padded = [
        Surface(np.vstack([[0.0, 0, 0], made.surface.vertices]), made.surface.triangles + 1) for made in (resting, bent)
    ]
    for ours, known in zip(zo.match(*padded).outline(0), result.outline(0), strict=True):
        np.testing.assert_array_equal(ours, known + 1)


def test_certainty_follows_the_lead_over_rivals(resting: Creature) -> None:
    again = creature(1500, seed=1, bend=0.4)
    sure = zo.match(resting.surface, again.surface)
    assert sure.certainty > 0.9
    assert not sure.notes
    rivals = [other.certainty for other in sure.candidates[1:] if not other.reverses_orientation]
    assert rivals
    assert max(rivals) < sure.certainty
    assert sorted(rivals)[0] < 0.1


@pytest.mark.slow
def test_rounding_far_from_the_origin_is_reported(resting: Creature, bent: Creature) -> None:
    rounded = [made.surface.with_vertices((made.surface.vertices + 1e6).astype(np.float32)) for made in (resting, bent)]
    notes = zo.match(resting.surface, rounded[1]).notes
    assert [note for note in notes if note.startswith("The target is so far from its origin that")]
    assert not [note for note in notes if note.startswith("The source is so far")]
    steps = [(made.surface.vertices + 2e7).astype(np.float32) for made in (resting, bent)]
    with pytest.raises(MeshError, match="rounded by more than an edge length"):
        zo.match(*(made.surface.with_vertices(step) for made, step in zip((resting, bent), steps, strict=True)))


@pytest.mark.slow
def test_match_of_round_shapes_is_uncertain() -> None:
    spheres = [Surface(points, ConvexHull(points).simplices) for points in (directions(2000, 3), directions(1500, 4))]
    result = zo.match(*spheres)
    assert result.certainty < 0.5
    assert any("probability" in note for note in result.notes)


def test_confidence_is_lower_where_the_map_is_wrong(resting: Creature) -> None:
    # A target without an arm and a leg, which cannot be matched well at the cuts.
    whole = creature(2000, seed=2, bend=0.4)
    removed = (np.abs(whole.surface.vertices[:, 0]) > 1.5)[whole.surface.triangles].any(axis=1)
    partial = Surface(whole.surface.vertices, whole.surface.triangles[~removed])
    result = zo.match(resting.surface, partial)
    used = np.unique(partial.triangles)
    error = zo.geodesic_error(result.surface_map, resting.surface, used, true_vertex(resting, whole)[used], len(used))
    confidence = result.confidence[used]
    assert (
        error[confidence < np.quantile(confidence, 0.2)].mean() > 1.3 * error[confidence > np.median(confidence)].mean()
    )
    assert (result.confidence >= 0).all()
    assert (result.confidence <= 1).all()


ARM, LEG = 0, 2


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("limb", [ARM, LEG])
def test_limb_missing_in_the_source_has_no_confidence(limb: int) -> None:
    source, target = creature(1800, seed=0, without=limb), creature(1500, seed=1, bend=0.6)
    result = zo.match(source.surface, target.surface)
    alone = on_limb(target, limb)
    common = np.flatnonzero(~alone)
    error = zo.geodesic_error(result.surface_map, source.surface, common, true_vertex(source, target)[common])
    assert error.mean() < 2 * RIGHT
    assert (result.confidence[alone] < 0.5).mean() > 0.9
    assert np.median(result.confidence[common]) > np.median(result.confidence[alone]) + 0.3
    assert any("of the target has no partner" in note for note in result.notes)
    assert (~result.has_partner[alone]).mean() > 0.5
    assert result.has_partner[common].mean() > 0.97
    assert result.source_has_partner.mean() > 0.97


@pytest.mark.slow
@pytest.mark.parametrize("limb", [ARM, LEG])
def test_limb_missing_in_the_target_does_not_affect_the_rest(limb: int) -> None:
    source, target = creature(2500, seed=0), creature(2000, seed=1, bend=0.6, without=limb)
    result = zo.match(source.surface, target.surface)
    common = np.flatnonzero(~on_limb(target, limb))
    error = zo.geodesic_error(result.surface_map, source.surface, common, true_vertex(source, target)[common])
    assert error.mean() < 2 * RIGHT
    assert any("of the source has no partner" in note for note in result.notes)
    missing = on_limb(source, limb)
    assert (~result.source_has_partner[missing]).mean() > 0.5
    assert result.source_has_partner[~missing].mean() > 0.95
    assert result.has_partner.mean() > 0.93


def test_the_result_does_not_depend_on_unit_place_or_vertex_order(resting, bent, result) -> None:
    random = np.random.default_rng(0)
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    order = random.permutation(len(bent.surface.vertices))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    moved = Surface((bent.surface.vertices @ rotation * 0.001 + 5)[order], place[bent.surface.triangles])
    other = zo.match(resting.surface, moved)
    distance = np.linalg.norm(
        other.surface_map.interpolate(resting.surface.vertices)
        - result.surface_map.interpolate(resting.surface.vertices)[order],
        axis=1,
    )
    assert np.median(distance) < 1e-3
    assert (distance < 0.05).mean() > 0.99


@pytest.mark.slow
def test_two_runs_give_identical_results(coarse: tuple[Creature, Creature]) -> None:
    once, again = match_coarsely(coarse), match_coarsely(coarse)
    assert np.array_equal(again.surface_map.triangle, once.surface_map.triangle)
    assert np.array_equal(again.confidence, once.confidence)


def test_progress_never_falls_and_ends_with_the_result(watched: tuple[zo.MatchResult, list[zo.Progress]]) -> None:
    found, seen = watched
    assert isinstance(found, zo.MatchResult)
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert fractions[0] >= 0
    assert 0.9 < fractions[-1] <= 1
    assert len(fractions) > 50
    assert len({progress.stage for progress in seen}) >= 4


def test_cancelled_match_stops_reporting(resting: Creature, bent: Creature) -> None:
    seen: list[zo.Progress] = []

    def listen(progress: zo.Progress) -> None:
        seen.append(progress)
        if len(seen) >= 20:
            raise zo.Cancelled

    with pytest.raises(zo.Cancelled):
        zo.match(resting.surface, bent.surface, progress=listen)
    # Each concurrent computation reports at most one more time before it is cancelled.
    assert 20 <= len(seen) < 20 + 10
    assert seen[-1].fraction < 0.9


# --- other starts -------------------------------------------------------------------------------------------


def test_landmarks_decide_the_side(coarse: tuple[Creature, Creature]) -> None:
    resting, bent = coarse
    truth, mirrored = true_vertex(resting, bent), mirrored_vertex(resting, bent)
    tips = np.array([bent.directions @ axis for axis in ([1, 0.1, 0.35], [-1, 0.1, 0.35], [0, 1, -0.25])]).argmax(
        axis=1
    )
    right = match_coarsely(coarse, initial="landmarks", landmarks=(truth[tips], tips))
    assert mean_error(right, resting.surface, truth) < RIGHT
    assert right.candidates[0].scores["landmarks"] < 3 * 0.15  # three landmarks
    # Landmarks on the wrong side select the map that fits them best, not the right one.
    wrong = match_coarsely(coarse, initial="landmarks", landmarks=(mirrored[tips], tips))
    assert wrong.candidates[0].scores["landmarks"] < 3 * 0.15
    assert mean_error(wrong, resting.surface, truth) > 3 * RIGHT


def test_proximity_starts_from_the_nearest_points(coarse: tuple[Creature, Creature]) -> None:
    resting, same_pose = coarse[0], creature(1000, seed=1)
    result = match_coarsely((resting, same_pose), initial="proximity")
    assert mean_error(result, resting.surface, true_vertex(resting, same_pose)) < RIGHT
    turned = Surface(same_pose.surface.vertices * [-1, 1, 1], same_pose.surface.triangles[:, ::-1])
    flipped = match_coarsely((resting, Creature(turned, same_pose.directions)), initial="proximity")
    assert mean_error(flipped, resting.surface, mirrored_vertex(resting, same_pose)) < RIGHT


def test_a_given_map_is_refined_in_every_form(coarse: tuple[Creature, Creature]) -> None:
    resting, bent = coarse
    truth = true_vertex(resting, bent)
    bases = zo.eigenbasis(resting.surface, 20), zo.eigenbasis(bent.surface, 20)
    functional_map = bases[1].coefficients(bases[0].eigenvectors[truth])
    for given in (truth, zo.SurfaceMap.from_vertices(truth, resting.surface), functional_map):
        result = match_coarsely(coarse, initial="given", initial_map=given)
        assert mean_error(result, resting.surface, truth) < RIGHT


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"initial": "magic"}, "choose one of"),
        ({"initial": "landmarks"}, "needs `landmarks`"),
        ({"initial": "given"}, "needs `initial_map`"),
        ({"landmarks": ([1, 2], [3])}, "give one on each side for every pair"),
        ({"landmarks": ([10**6], [3])}, "vertex numbers from 0 to 1999"),
        ({"initial": "given", "initial_map": [1, 2, 3]}, "for each of 1500"),
    ],
)
def test_invalid_arguments_are_refused(resting: Creature, bent: Creature, arguments, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as refusal:
        zo.match(resting.surface, bent.surface, **arguments)
    assert "\n" not in str(refusal.value)


# --- real meshes --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_split_and_inconsistently_wound_target_is_matched(resting: Creature, bent: Creature) -> None:
    """The target is split at every face, partly wound inwards, and has unused vertices, as importers may produce."""
    triangles = bent.surface.triangles.copy()
    triangles[::3] = triangles[::3, ::-1]
    soup = Surface(
        np.vstack([bent.surface.vertices[triangles].reshape(-1, 3), [[np.nan] * 3], [[9.0, 9, 9]]]),
        np.arange(triangles.size).reshape(-1, 3),
    )
    result = zo.match(resting.surface, soup)
    truth = true_vertex(resting, bent)[triangles.ravel()]
    error = zo.geodesic_error(result.surface_map, resting.surface, np.arange(len(truth)), truth)
    assert error.mean() < RIGHT
    assert result.confidence[-2] == 0
    assert len(result.surface_map.triangle) == len(soup.vertices)


def with_parts(body: Creature, places: np.ndarray, sizes: list[float]) -> tuple[Surface, list[np.ndarray]]:
    """A body with small copies of a creature floating above some of its vertices, and their vertex numbers."""
    eye = creature(80, seed=5).surface
    vertices, triangles, parts = [body.surface.vertices], [body.surface.triangles], []
    for place, size in zip(places, sizes, strict=True):
        count = sum(len(points) for points in vertices)
        normal = body.surface.working.vertex_normals[place]
        vertices.append(eye.vertices * size + body.surface.vertices[place] + 3 * size * normal)
        triangles.append(eye.triangles + count)
        parts.append(np.arange(count, count + len(eye.vertices)))
    return Surface(np.vstack(vertices), np.vstack(triangles)), parts


@pytest.mark.slow
def test_loose_parts_are_paired_by_place_and_size(resting: Creature, bent: Creature) -> None:
    where = np.array([[0.3, -0.5, 1], [-0.3, -0.5, 1], [0, -1, 0.2]])  # two eyes and a button
    places = [(found.directions @ where.T).argmax(axis=0) for found in (resting, bent)]
    source, source_parts = with_parts(resting, places[0], [0.05, 0.05, 0.08])
    target, target_parts = with_parts(bent, places[1], [0.05, 0.05, 0.08])
    result = zo.match(source, target)
    assert mean_error(result, source, true_vertex(resting, bent)) < RIGHT
    for ours, theirs in zip(target_parts, source_parts, strict=True):
        image = result.surface_map.vertex[ours]
        assert set(image) <= set(theirs)
        assert (result.confidence[ours] > 0.3).all()
        distance = np.linalg.norm(source.vertices[image] - source.vertices[theirs], axis=1)
        assert np.median(distance) < 0.05
    assert any(note.startswith("3 loose parts paired") for note in result.notes)


@pytest.mark.slow
def test_loose_parts_without_a_partner_follow_the_body_and_are_reported(resting: Creature, bent: Creature) -> None:
    tip = np.array([int(np.argmax(bent.surface.vertices[:, 2]))])
    target, (loose,) = with_parts(bent, tip, [0.02])
    result = zo.match(resting.surface, target)
    assert mean_error(result, resting.surface, true_vertex(resting, bent)) < RIGHT
    images = result.surface_map.interpolate(resting.surface.vertices)
    assert np.linalg.norm(images[loose] - images[tip], axis=1).max() < 0.6
    assert (result.confidence[loose] == 0).all()
    assert any("1 loose part of the target without a partner" in note for note in result.notes)


def test_coarse_mesh_is_matched_or_refused(resting: Creature) -> None:
    coarse = creature(30, seed=6)
    result = zo.match(resting.surface, coarse.surface)
    assert len(result.confidence) == 30
    cube = Surface(
        np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)]),
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]],
    )
    with pytest.raises(MeshError, match="too few for matching"):
        zo.match(resting.surface, cube)


@pytest.mark.slow
def test_benchmark_humans_are_matched(benchmark_data) -> None:
    from zoomout_core.mesh.formats.files import read_surface

    truth = np.load(benchmark_data / "faust_r" / "correspondence.npz")
    names = ("tr_reg_002", "tr_reg_007")
    target, source = (read_surface(benchmark_data / "faust_r" / f"{name}.off") for name in names)
    result = zo.match(source, target)
    error = zo.geodesic_error(result.surface_map, source, truth[names[0]], truth[names[1]])
    assert error.mean() < 0.04


@pytest.mark.slow
def test_match_by_proxy_is_nearly_as_accurate_as_a_full_one(resting, bent, result) -> None:
    truth = true_vertex(resting, bent)
    by_proxy = zo.match(resting.surface, bent.surface, proxy_vertices=1000)
    assert len(by_proxy.pair.source_shape.mesh.vertices) < len(result.pair.source_shape.mesh.vertices) == 2000
    errors = [mean_error(each, resting.surface, truth) for each in (by_proxy, result)]
    assert errors[0] < 1.5 * errors[1]
    assert len(by_proxy.confidence) == 1500


def test_memory_error_is_reported_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def without_memory(matrix: object) -> None:
        raise MemoryError

    monkeypatch.setattr(lanczos, "factorise", without_memory)
    fine = creature(3000).surface
    zo.forget_shapes()
    with pytest.raises(MeshError, match="not enough memory to analyze a mesh of 3,000 vertices: match a smaller"):
        zo.match(fine, fine, proxy_vertices=None)


@pytest.mark.slow
def test_finer_meshes_have_finer_proxies(resting: Creature) -> None:
    fine = creature(50_000).surface
    result = zo.match(fine, resting.surface, initial="proximity")
    assert len(result.pair.source_shape.mesh.vertices) == pytest.approx(6000, rel=0.02)
    assert result.pair.target_shape.proxy.full is result.pair.target_shape.mesh


def test_options_are_checked_at_creation_and_reusable() -> None:
    with pytest.raises(ValueError, match="k_final is 2"):
        zo.MatchOptions(k_final=2)
    with pytest.raises(ValueError, match="needs `landmarks`"):
        zo.MatchOptions(exact_landmarks=True)
    source, target = creature(300, 0, 0.0).surface, creature(250, 1, 0.9).surface
    given = {"k_final": 30, "samples": 100, "initial": "proximity"}
    options = zo.MatchOptions(**given)
    by_options, by_names = zo.match(source, target, options), zo.match(source, target, **given)
    assert (by_options.surface_map.triangle == by_names.surface_map.triangle).all()
    assert zo.match(source, target, options, k_final=20).functional_map.shape == (20, 20)
    with pytest.raises(TypeError, match="by their names"):
        zo.match(source, target, "proximity")  # type: ignore[arg-type]
