# SPDX-License-Identifier: GPL-3.0-or-later
"""Finished maps decide between candidates of similar scores; if one is far ahead, it alone is finished."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import Creature, creature, mirrored_vertex, true_vertex
from scipy.spatial import cKDTree

from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.finished_maps import FINISHED_MAPS, rank_finished, refine_candidate
from zoomout_core.matching.ranking.rank import rank
from zoomout_core.matching.ranking.scores import ENERGY
from zoomout_core.matching.refinement.confidence import local_distortion
from zoomout_core.matching.refinement.dense_map import dense_map


@pytest.fixture(scope="module")
def creatures() -> tuple[Creature, Creature]:
    return creature(700, seed=0), creature(680, seed=1, bend=0.3)


@pytest.fixture(scope="module")
def shapes(creatures: tuple[Creature, Creature]) -> tuple[ShapeAnalysis, ShapeAnalysis]:
    source, target = (analyse(one.surface.working.part(0)[0], 90, 300, 0) for one in creatures)
    return source, target


@pytest.fixture(scope="module")
def candidates(creatures, shapes) -> dict[str, Candidate]:
    about = np.asarray(cKDTree(creatures[0].directions).query(creatures[1].directions * [-1, -1, 1])[1])
    maps = {"true": true_vertex(*creatures), "mirrored": mirrored_vertex(*creatures), "about": about}
    bases = [shape.basis for shape in shapes]
    hypotheses = [Hypothesis(name, functional_map_of(vertex, *bases, 8, 8)) for name, vertex in maps.items()]
    return {one.origin: one for one in rank(hypotheses, *shapes)}


def with_total(candidate: Candidate, total: float) -> Candidate:
    return replace(candidate, scores=candidate.scores | {"total": total})


def ranked(candidates: dict[str, Candidate], shapes, lag: float) -> list[Candidate]:
    """Rank candidates whose samples prefer the wrong one to the true one, by a lead in score."""
    given = with_total(candidates["about"], -15.0), with_total(candidates["true"], -15.0 + lag)
    return rank_finished([*given, candidates["mirrored"]], *shapes, 20)


def test_finished_map_overrules_a_small_lead_of_samples(candidates, shapes) -> None:
    first, second, mirrored = ranked(candidates, shapes, 0.5)
    assert (first.origin, second.origin, mirrored.origin) == ("true", "about", "mirrored")
    assert first.scores[ENERGY] < 0.8 * second.scores[ENERGY]
    assert first.certainty > 0.9 > 0.1 > second.certainty
    # The finished map is beside the candidate, which itself stays.
    assert first.functional_map is candidates["true"].functional_map
    # Mirror images rival only each other, so a single one is not refined.
    assert ENERGY not in mirrored.scores


def test_only_the_first_map_is_finished_if_far_ahead(candidates, shapes) -> None:
    assert ranked(candidates, shapes, FINISHED_MAPS.margin - 0.01)[0].origin == "true"
    first, *others = ranked(candidates, shapes, FINISHED_MAPS.margin + 0.01)
    assert first.origin == "about"
    assert ENERGY in first.scores
    assert not any(ENERGY in other.scores for other in others)


def test_only_the_first_few_are_refined(candidates, shapes) -> None:
    given = [with_total(candidates["true"], -15.0 + 0.01 * number) for number in range(FINISHED_MAPS.max_refined + 2)]
    found = rank_finished(given, *shapes, 20)
    assert sum(ENERGY in one.scores for one in found) == FINISHED_MAPS.max_refined


def test_finished_map_of_the_ranking_is_reused(creatures, candidates, shapes, monkeypatch) -> None:
    found = ranked(candidates, shapes, 0.5)
    kept = refine_candidate(found[0], *shapes, FINISHED_MAPS.size, 20)
    assert kept is found[0].refined
    for known, computed in zip(
        kept, refine_candidate(candidates["true"], *shapes, FINISHED_MAPS.size, 20), strict=True
    ):
        arrays = (vars(one).values() if isinstance(one, SurfaceMap) else (one,) for one in (known, computed))
        assert all(np.array_equal(a, b) for a, b in zip(*arrays, strict=True))
    assert refine_candidate(found[0], *shapes, 34, 20)[1].shape == (34, 34)
    monkeypatch.setattr(
        "zoomout_core.matching.ranking.finished_maps.refine", lambda *_: pytest.fail("a map was refined again")
    )
    again = rank_finished(found, *shapes, 20)
    assert [(one.origin, one.certainty) for one in again] == [(one.origin, one.certainty) for one in found]
    pair = Pair(*(one.surface for one in creatures), *shapes, FINISHED_MAPS.size, 20)
    assert dense_map(pair, again[0]).functional_map.shape == kept[1].shape


def test_local_distortion_accounts_for_mirrored_maps(creatures, shapes) -> None:
    source, target = shapes
    images = creatures[0].surface.working.part(0)[0].vertices
    order = np.asarray(cKDTree(images).query(source.mesh.vertices)[1])
    assert (order == np.arange(len(images))).all()
    corner = np.zeros(len(images), dtype=np.int64)
    corner[source.mesh.triangles.ravel()] = np.arange(source.mesh.triangles.size)
    energies = []
    for vertex, mirrored in ((true_vertex(*creatures), False), (mirrored_vertex(*creatures), True)):
        found = SurfaceMap(corner[vertex] // 3, np.eye(3)[corner[vertex] % 3], source.mesh.triangles)
        energies.append([local_distortion(found, source, target, sense).mean() for sense in (mirrored, not mirrored)])
    for right, wrong in energies:
        assert 2 * right < wrong
    assert energies[0][0] == pytest.approx(energies[1][0], rel=0.3)
