# SPDX-License-Identifier: GPL-3.0-or-later
"""Certainty of candidates from rivals and spatial fit, and selection and order of the compared maps."""

from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from creatures import Creature, creature, mirrored_vertex, true_vertex
from reports import fractions_of
from scipy.spatial import cKDTree
from shapes import sheet

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import CERTAINTY, sort_by_certainty
from zoomout_core.matching.ranking.rank import _align, _leading, rank, with_others
from zoomout_core.matching.ranking.scores import ENERGY, IN_SPACE, TORN, evidence_score
from zoomout_core.matching.report.verdict import VERDICT

COUNT = 40


TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])


def line(sides_are_known: bool = True, triangles: Integers = TETRAHEDRON, is_hull: bool = False) -> Any:
    """Stand-in for a shape, with samples on a line of unit length."""
    at, areas = np.linspace(0, 1, COUNT), np.full(COUNT, 1 / COUNT)
    return SimpleNamespace(
        min_distances=lambda vertices, others: np.abs(at[vertices] - at[others]),
        search=SimpleNamespace(samples=np.arange(COUNT)),
        weights=areas,
        basis=SimpleNamespace(areas=areas),
        coordinates=at[:, None],
        mesh=SimpleNamespace(sides_are_known=sides_are_known, triangles=triangles),
        proxy=SimpleNamespace(full=SimpleNamespace(is_hull=is_hull)),
    )


def candidate(
    total: float, shift: float = 0.0, place: float = 0.005, mirrored: bool = False, in_space: float = 0.0
) -> Candidate:
    """A map that shifts all samples along the line."""
    sample_map = np.clip(np.arange(COUNT) + round(shift * (COUNT - 1)), 0, COUNT - 1)
    scores = {"total": total, "place": place, IN_SPACE: in_space}
    nothing = np.zeros((0, 0))
    return Candidate(f"{total} {shift}", mirrored, mirrored, nothing, nothing, sample_map, None, None, 0.0, scores)


def certainties(*candidates: Candidate, sides_are_known: bool = True) -> list[float]:
    """Certainties in the order of the given candidates."""
    ranked = sort_by_certainty(list(candidates), line(sides_are_known), line())
    found = {one.origin + str(one.mirrored): one.certainty for one in ranked}
    return [found[one.origin + str(one.mirrored)] for one in candidates]


def test_certainty_without_rivals_follows_the_fit_in_space() -> None:
    fitting, doubtful, misfit = (certainties(candidate(0.0, place=place))[0] for place in (0.005, 0.04, 0.3))
    assert fitting > 0.99
    assert 0.1 < doubtful < 0.95
    assert misfit < 0.01


def test_tears_of_a_finished_map_reduce_its_certainty() -> None:
    fair = candidate(0.0, place=0.025)
    whole, scratched, torn = (
        certainties(replace(fair, scores=fair.scores | {TORN: count}))[0] for count in (0, 2, 100)
    )
    assert whole > scratched > 0.9 > torn
    assert certainties(replace(fair, scores=fair.scores | {TORN: 1000})) == [torn]  # not refused for tears alone
    assert certainties(fair) == [whole]
    # Limbs that touch are joined in a hull, from which a right map has to tear them.
    hulls = [
        sort_by_certainty([replace(fair, scores=fair.scores | {TORN: count})], line(is_hull=True), line())[0]
        for count in (0, 100)
    ]
    assert hulls[0].certainty == hulls[1].certainty


def test_borders_and_hulls_reduce_certainty() -> None:
    fair = candidate(0.0, place=0.03)
    closed, opened, hull = (
        sort_by_certainty([fair], line(), shape)[0].certainty
        for shape in (line(), line(triangles=TETRAHEDRON[:3]), line(is_hull=True))
    )
    assert opened == hull < 0.8 < 0.9 < closed


def test_equal_rivals_share_certainty_and_a_lead_excludes_them() -> None:
    assert certainties(candidate(0.0), candidate(0.0, 0.5)) == pytest.approx([0.5, 0.5], abs=0.01)
    ahead, behind = certainties(candidate(0.0), candidate(1.3, 0.5))
    assert ahead > 0.95
    assert behind < 0.05
    three = certainties(candidate(0.0), candidate(0.0, 0.4), candidate(0.0, 0.8))
    assert three == pytest.approx([1 / 3] * 3, abs=0.01)


def exchange(one: Candidate, count: int) -> Candidate:
    """A candidate with the first and last samples exchanged, as if they were two limbs."""
    sample_map = one.sample_map.copy()
    sample_map[:count], sample_map[-count:] = one.sample_map[-count:], one.sample_map[:count]
    return replace(one, origin=f"{one.origin} exchanged", sample_map=sample_map)


def finish(one: Candidate, distortion: Floats) -> Candidate:
    """A candidate whose finished map is that of its samples."""
    energy = float(distortion.mean())
    refined: Any = (SimpleNamespace(vertex=one.sample_map), np.zeros((0, 0)))
    return replace(one, refined=refined, distortion=distortion, scores=one.scores | {ENERGY: energy})


def test_maps_to_nearly_the_same_places_are_no_rivals() -> None:
    assert certainties(candidate(0.0), candidate(0.0, 0.15))[0] > 0.99
    assert certainties(candidate(0.0), candidate(0.0, 0.3))[0] < 0.6


def test_a_map_that_exchanges_two_small_limbs_is_a_rival() -> None:
    # A sample at either end: the maps differ by 0.05 on average, less than those that are only shifted.
    assert certainties(candidate(0.0), exchange(candidate(0.0), 1))[0] == pytest.approx(0.5, abs=0.01)


def test_equal_finished_maps_are_no_rivals_despite_their_samples() -> None:
    one, other = candidate(0.0), candidate(0.0, 0.3)
    smooth = np.full(COUNT, 0.1)
    both = finish(one, smooth), replace(finish(other, smooth), refined=finish(one, smooth).refined)
    assert certainties(*both)[0] > 0.99


def test_energies_count_only_where_finished_maps_differ() -> None:
    here = np.full(COUNT, 0.2)
    torn = here.copy()
    torn[[0, 1, -2, -1]] *= 2.0
    right, wrong = finish(candidate(0.0), here), finish(exchange(candidate(0.0), 2), torn)
    assert wrong.scores[ENERGY] < 1.11 * right.scores[ENERGY]
    assert certainties(right, wrong)[0] > 0.99
    # A distortion elsewhere, which is due to the mesh, changes the order, but makes no map certain.
    elsewhere = here.copy()
    elsewhere[10:20] *= 2.0
    first, second = certainties(right, finish(exchange(candidate(0.0), 2), elsewhere))
    assert first == pytest.approx(0.5, abs=0.01)
    assert second == pytest.approx(0.5, abs=0.01)


def test_extreme_lead_gives_a_certainty_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first, last = certainties(candidate(0.0), candidate(1e4, 0.5))
    assert first > 0.99
    assert 0 <= last < 1e-6


def test_placement_makes_a_map_likely_but_not_certain() -> None:
    off = 0.5
    standing = candidate(0.0)
    turned = candidate(evidence_score(IN_SPACE, off), 0.5, in_space=off)
    ranked = sort_by_certainty([turned, standing], line(), line())
    assert ranked[0].origin == standing.origin
    assert 0.8 < ranked[0].certainty < 0.9


def test_finished_map_of_lower_energy_ranks_first() -> None:
    ahead, behind, rest = candidate(0.0), candidate(0.6, 0.5), candidate(0.5, 0.9)
    assert sort_by_certainty([ahead, behind, rest], line(), line())[0].origin == ahead.origin
    energies = np.full((2, COUNT), [[0.11], [0.085]])
    ranked = sort_by_certainty([*map(finish, (ahead, behind), energies), rest], line(), line())
    # The map that is not finished is taken to be as bad as the worst one that is.
    assert [one.origin for one in ranked] == [behind.origin, ahead.origin, rest.origin]
    assert ranked[0].certainty > 0.7 > 0.3 > ranked[1].certainty > ranked[2].certainty


def test_less_torn_finished_map_of_closed_shapes_ranks_first() -> None:
    energies = np.full(COUNT, 0.1)
    ahead, behind = finish(candidate(0.0), energies), finish(candidate(0.5, 0.5), energies)
    ahead, behind = (replace(one, scores=one.scores | {TORN: count}) for one, count in ((ahead, 30.0), (behind, 0.5)))
    rest = candidate(0.4, 0.9)  # not finished, so taken to be as torn as the most torn one
    ranked = sort_by_certainty([ahead, behind, rest], line(), line())
    assert [one.origin for one in ranked] == [behind.origin, ahead.origin, rest.origin]
    assert ranked[0].certainty > 0.7
    # A border or touching limbs explain the tears.
    for other in (line(triangles=TETRAHEDRON[:3]), line(is_hull=True)):
        assert sort_by_certainty([ahead, behind, rest], line(), other)[0].origin == ahead.origin


def test_certainty_never_rises_down_the_ranking() -> None:
    # The second fits better in space, but all else contradicts it.
    first, second = candidate(0.0, place=0.05), candidate(0.1, 0.05, place=0.01)
    ranked = sort_by_certainty([second, first], line(), line())
    assert ranked[0].origin == first.origin
    assert ranked[1].certainty == ranked[0].certainty


def test_mirror_images_rank_last_and_rival_only_each_other() -> None:
    direct, mirrored, other = candidate(1.0), candidate(0.0, 0.5, mirrored=True), candidate(0.0, 0.9, mirrored=True)
    ranked = sort_by_certainty([mirrored, direct, other], line(), line())
    assert [one.mirrored for one in ranked] == [False, True, True]
    assert certainties(direct, mirrored, other) == pytest.approx([0.99, 0.5, 0.5], abs=0.02)


def test_no_map_is_certain_if_a_much_better_mirror_image_is_nearer_to_it_than_to_a_rival() -> None:
    # Bodies in opposite poses: a map that exchanges only the arms shares them with the mirror image.
    image = candidate(0.0, 0.5, mirrored=True)
    farther, nearer = -0.5, 0.4  # shifts of rivals

    def first_of(total: float, shift: float, lag: float = 2.0) -> float:
        return sort_by_certainty([candidate(total), candidate(total + lag, shift), image], line(), line())[0].certainty

    level, near, far, very_far = (first_of(total, farther) for total in (0.0, CERTAINTY.image_lead - 0.8, 4.0, 1e3))
    assert level > near > 0.98
    assert 0.75 < far < VERDICT.certain
    assert far == pytest.approx(very_far, abs=0.01)
    # The map that is farthest from the mirror image is right, unless it has a much worse score than the first one.
    assert first_of(4.0, nearer) > 0.98
    assert first_of(4.0, farther, lag=CERTAINTY.image_rival + 0.1) > 0.98
    # Certainties still fall, and the mirror image itself keeps its own.
    first, *others, mirrored = sort_by_certainty([candidate(4.0), candidate(5.5, farther), image], line(), line())
    assert far >= first.certainty > 0.1 > others[0].certainty
    assert mirrored.certainty == certainties(image)[0]


def test_the_map_farthest_from_a_much_better_mirror_image_comes_first() -> None:
    image, nearest = candidate(0.0, 0.5, mirrored=True), candidate(4.5, 0.4)

    def first_of(total: float, shift: float, lag: float = 2.0) -> str:
        rival = candidate(total + lag, shift)
        ranked = sort_by_certainty([candidate(total), replace(rival, origin="rival"), nearest, image], line(), line())
        return ranked[0].origin

    assert first_of(4.0, -0.5) == "rival"
    for total, shift, lag in (
        (CERTAINTY.image_lead - 0.1, -0.5, 2.0),  # the mirror image does not lead clearly
        (4.0, -0.5, CERTAINTY.image_rival + 0.1),  # the rival has a much worse score
        (4.0, -0.02, 2.0),  # the rival is hardly farther
    ):
        assert first_of(total, shift, lag) != "rival"


@pytest.mark.parametrize(("ratio", "comes_first"), [(0.9, True), (1.1, True), (1.2, False)])
def test_the_farthest_map_comes_first_unless_its_finished_map_fits_worse(ratio: float, comes_first: bool) -> None:
    image, first, rival = candidate(0.0, 0.5, mirrored=True), candidate(4.0), candidate(5.5, -0.5)
    energies = 0.05, 0.05 * ratio * CERTAINTY.image_energy / 1.15
    first, rival = (
        replace(one, scores=one.scores | {ENERGY: energy}) for one, energy in zip((first, rival), energies, strict=True)
    )
    ranked = sort_by_certainty([first, replace(rival, origin="rival"), image], line(), line())
    assert (ranked[0].origin == "rival") == comes_first


def test_mirror_images_of_cloth_are_rivals() -> None:
    direct, mirrored = candidate(5.0), candidate(0.0, 0.5, mirrored=True)
    ranked = sort_by_certainty([direct, mirrored], line(sides_are_known=False), line())
    assert ranked[0].mirrored
    assert certainties(direct, mirrored, sides_are_known=False)[0] < 0.01


def test_plane_is_preferred_to_its_mirror_image() -> None:
    shape = analyse(sheet(300).surface.working.part(0)[0], 40, 120, 0)
    identity = np.arange(len(shape.search.samples))
    scores = {"commutativity": 0.1, "frequency": 0.1, "distance": 0.1, "curvature": 0.0, "handedness": 0.0}
    mirrored = replace(candidate(0.0, mirrored=True), sample_map=identity, scores=scores)
    assert not _align(mirrored, shape, shape).mirrored
    assert not _align(replace(mirrored, mirrored=False), shape, shape).mirrored


def leading(scores: list[float], quotas: tuple[tuple[int, int], tuple[int, int]], **others: Any) -> list[float]:
    """Scores of the maps that are kept; each has other images unless `shifts` sets them."""
    count = len(scores)
    shifts = others.get("shifts", np.linspace(0, 0.9, count))
    reverses = others.get("reverses", [False] * count)
    maps = [replace(candidate(t, s), reverses_orientation=r) for t, s, r in zip(scores, shifts, reverses, strict=True)]
    return [one.scores["total"] for one in _leading(maps, scores, line(), quotas)]


def test_quota_keeps_a_minimum_and_maps_of_similar_score() -> None:
    scores = [3.0, 0.0, 1.2, 0.5, 2.0, 0.9]
    assert leading(scores, ((2, 4), (1, 1))) == [0.0, 0.5, 0.9, 1.2]
    assert leading(scores, ((2, 6), (1, 1))) == [0.0, 0.5, 0.9, 1.2]
    assert leading(scores, ((5, 6), (1, 1))) == [0.0, 0.5, 0.9, 1.2, 2.0]
    assert leading(scores, ((0, 2), (1, 1))) == [0.0, 0.5]


def test_mirror_images_are_compared_with_the_best_of_them() -> None:
    scores, reverses = [0.0, 0.1, 8.0, 8.2, 9.9], [False, False, True, True, True]
    assert leading(scores, ((1, 9), (1, 2)), reverses=reverses) == [0.0, 0.1, 8.0, 8.2]
    assert leading(scores, ((1, 9), (3, 3)), reverses=reverses) == scores


def test_duplicate_maps_are_kept_once() -> None:
    assert leading([0.3, 0.1, 0.2], ((3, 9), (1, 1)), shifts=[0.0, 0.0, 0.5]) == [0.1, 0.2]


@pytest.fixture(scope="module")
def creatures() -> tuple[Creature, Creature]:
    return creature(500, seed=0), creature(480, seed=1, bend=0.3)


@pytest.fixture(scope="module")
def ranked(creatures: tuple[Creature, Creature]) -> tuple[list[Candidate], ShapeAnalysis, ShapeAnalysis]:
    """Ranked candidates of the true map, its mirror image and a half turn, given by few functions, and the shapes."""
    source, target = (analyse(one.surface.working.part(0)[0], 90, 300, 0) for one in creatures)
    about = np.asarray(cKDTree(creatures[0].directions).query(creatures[1].directions * [-1, -1, 1])[1])
    maps = {"true": true_vertex(*creatures), "mirrored": mirrored_vertex(*creatures), "about": about}
    hypotheses = [
        Hypothesis(name, functional_map_of(vertex, source.basis, target.basis, 8, 8)) for name, vertex in maps.items()
    ]
    return rank(hypotheses, source, target), source, target


def test_true_map_ranks_first_and_its_mirror_image_is_kept(ranked) -> None:
    candidates, *_ = ranked
    assert candidates[0].origin == "true"
    assert (candidates[-1].origin, candidates[-1].reverses_orientation) == ("mirrored", True)
    assert not candidates[0].reverses_orientation
    assert candidates[0].certainty == max(one.certainty for one in candidates if not one.reverses_orientation)


def test_candidates_are_refined_both_ways(ranked, creatures) -> None:
    (first, *_), source, target = ranked

    def missed(images: np.ndarray, there: Creature, vertices: np.ndarray, here: Creature) -> float:
        return float(np.linalg.norm(there.directions[images] - here.directions[vertices], axis=1).mean())

    samples = source.search.samples, target.search.samples
    assert missed(samples[0][first.sample_map], creatures[0], samples[1], creatures[1]) < 0.2
    rows, k = source.search.rows, len(first.reverse_functional_map)
    embedded = target.search.rows[:, : first.reverse_functional_map.shape[1]] @ first.reverse_functional_map.T
    back = cKDTree(embedded).query(rows[:, :k])[1]
    assert missed(samples[1][back], creatures[1], samples[0], creatures[0]) < 0.2
    assert min(first.functional_map.shape) == min(first.reverse_functional_map.shape) > 50


@pytest.mark.parametrize(("agreement", "reverses"), [(-0.6, True), (-0.1, False), (0.1, False)])
def test_map_with_mixed_normals_is_no_mirror_image(ranked, monkeypatch, agreement, reverses) -> None:
    # It mirrors only some limbs, and the alignment undoes that.
    (first, *_), *shapes = ranked
    monkeypatch.setattr("zoomout_core.matching.ranking.rank.orientation_agreement", lambda *_: agreement)
    (found,) = rank([Hypothesis("known", first.functional_map[:8, :8])], *shapes)
    assert found.reverses_orientation is reverses


def test_mirrored_candidate_of_a_closed_shape_stays_mirrored(ranked) -> None:
    candidates, *shapes = ranked
    assert _align(replace(candidates[0], mirrored=True), *shapes).mirrored


@pytest.mark.parametrize("sides_are_known", [True, False])
def test_mirror_images_share_the_quota_if_sides_are_unknown(ranked, monkeypatch, sides_are_known) -> None:
    candidates, *shapes = ranked
    monkeypatch.setattr("zoomout_core.matching.ranking.rank.sides_are_known", lambda *_: sides_are_known)
    hypotheses = [Hypothesis(one.origin, one.functional_map[:8, :8]) for one in candidates]
    found = rank(hypotheses, *shapes, quotas=((1, 1), (0, 0)))
    assert [one.reverses_orientation for one in found].count(True) == (not sides_are_known)
    assert [one.reverses_orientation for one in found].count(False) == 1


def test_progress_of_ranking_rises_through_all_stages(ranked) -> None:
    candidates, *shapes = ranked
    hypotheses = [Hypothesis(one.origin, one.functional_map[:8, :8]) for one in candidates]
    fractions = [0.0, *fractions_of(lambda: rank(hypotheses, *shapes)), 1.0]
    assert fractions == sorted(fractions)
    for start, end in ((0.0, 0.6), (0.6, 0.8), (0.8, 1.0)):
        assert sum(start < fraction <= end for fraction in fractions) >= 2


def test_candidates_are_as_large_as_both_bases_allow(creatures) -> None:
    few, many = (analyse(one.surface.working.part(0)[0], k, 100, 0) for one, k in zip(creatures, (20, 40), strict=True))
    for shapes in ((few, many), (many, few)):
        (found,) = rank([Hypothesis("identity", np.eye(4))], *shapes)
        assert found.functional_map.shape == found.reverse_functional_map.shape == (20, 20)


def test_only_distinct_maps_join_the_candidates() -> None:
    first = sort_by_certainty([candidate(0.0), candidate(0.2, 0.6)], line(), line())
    same, new = candidate(-5.0, 0.001), candidate(-1.3, 0.3)
    joined = with_others(first, [same, new], line(), line())
    assert [one.origin for one in joined] == [new.origin, *(one.origin for one in first)]
    assert joined[0].certainty > 0.9 > 0.5 > joined[1].certainty
    assert first[0].certainty > 0.5
