# SPDX-License-Identifier: GPL-3.0-or-later
"""Two fragments are placed rigidly on each other where they overlap, however one of them is rotated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from creatures import creature, true_vertex
from pieces import PartAndWhole, analyse_piece, piece_of
from scipy.spatial.transform import Rotation

from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial import part_match
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale
from zoomout_core.matching.partial.part_candidates import PartCandidate, _by_cost, _placed_candidates
from zoomout_core.matching.partial.part_match import fit_part
from zoomout_core.matching.partial.part_registration import PART_REGISTRATION
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.partial.rigid_placements import (
    RIGID_PLACEMENTS,
    Placement,
    rigid_placements,
    rotations,
    upright_rotations,
)
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.scores import EVIDENCE_WEIGHTS, UP_AXES, UPRIGHT
from zoomout_core.matching.registration.nonrigid_icp import NONRIGID_SCHEDULE, Level
from zoomout_core.tuning import retune

TURN = Rotation.from_euler("zyx", [200, 30, 80], degrees=True).as_matrix()


@pytest.fixture(scope="module")
def fragments() -> PartAndWhole:
    """Two pieces of a creature that share a third of it; the first one is rotated, and its limbs are a little bent."""
    bent, rest = creature(1100, seed=1, bend=0.15, asymmetry=0.3), creature(1000, seed=0, asymmetry=0.3)
    part = piece_of(bent, bent.directions @ [0.16, 0.14, -0.98] > -0.01)
    part = replace(part, surface=part.surface.with_vertices(part.surface.vertices @ TURN.T))
    whole = piece_of(rest, rest.directions @ [0.87, -0.08, -0.49] > -0.24)
    shapes = analyse_piece(part), analyse_piece(whole)
    unit = shapes[0].proxy.full.scale / shapes[1].proxy.full.scale
    return PartAndWhole(part, whole, IncompleteShape(at_scale(shapes[0], unit)), IncompleteShape(shapes[1]))


@pytest.fixture(scope="module")
def placements(fragments: PartAndWhole) -> list[Placement]:
    return rigid_placements(fragments.part, fragments.whole)


def is_shared(fragments: PartAndWhole) -> np.ndarray:
    """(n,) which vertices of the part are on the whole, away from its cut."""
    return fragments.made_part.directions @ [0.87, -0.08, -0.49] > -0.14


def off(fragments: PartAndWhole, positions: np.ndarray) -> float:
    """Median distance of the shared vertices, placed on the whole, from where they belong."""
    shared = is_shared(fragments)
    true = true_vertex(fragments.made_whole, fragments.made_part)[shared]
    return float(np.median(np.linalg.norm(positions[shared] - fragments.whole.shape.mesh.vertices[true], axis=1)))


def test_rotations_are_proper_and_spread_evenly() -> None:
    tried = rotations(RIGID_PLACEMENTS.rotations)
    np.testing.assert_allclose(tried @ np.swapaxes(tried, 1, 2), np.tile(np.eye(3), (len(tried), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(tried), 1)
    drawn = Rotation.random(300, random_state=0).as_matrix()
    cosine = (np.einsum("aij,bij->ab", drawn, tried).max(axis=1) - 1) / 2
    assert np.degrees(np.arccos(cosine.min())) < 25


def test_the_first_placement_is_the_right_one_even_if_the_part_is_turned(
    fragments: PartAndWhole, placements: list[Placement]
) -> None:
    assert off(fragments, placements[0].positions) < 0.1
    assert min(off(fragments, one.positions) for one in placements[1:]) > 0.15


def test_a_placement_is_rigid(fragments: PartAndWhole, placements: list[Placement]) -> None:
    rest = fragments.part.shape.mesh.vertices
    for one in placements[:3]:
        np.testing.assert_allclose(
            np.linalg.norm(one.positions - one.positions[0], axis=1), np.linalg.norm(rest - rest[0], axis=1)
        )
        assert len(one.places) == len(fragments.part.between)


def test_placements_differ_and_the_best_come_first(fragments: PartAndWhole, placements: list[Placement]) -> None:
    assert len(placements) <= RIGID_PLACEMENTS.kept
    assert [one.rank for one in placements] == sorted(one.rank for one in placements)
    at = fragments.part.shape.search.samples[: len(fragments.part.between)]
    for number, one in enumerate(placements):
        for other in placements[:number]:
            apart = np.linalg.norm(one.positions[at] - other.positions[at], axis=1).mean()
            assert apart > RIGID_PLACEMENTS.apart
    with retune(RIGID_PLACEMENTS, apart=0.0, kept=4, refined=20):
        closer = rigid_placements(fragments.part, fragments.whole)
    assert len(closer) == 4
    assert np.linalg.norm(closer[0].positions - closer[1].positions, axis=1).mean() < RIGID_PLACEMENTS.apart


def test_few_votes_suffice_for_the_right_placement_and_few_rotations_do_not(fragments: PartAndWhole) -> None:
    with retune(RIGID_PLACEMENTS, refined=20):
        assert off(fragments, rigid_placements(fragments.part, fragments.whole)[0].positions) < 0.1
    with retune(RIGID_PLACEMENTS, rotations=3):
        assert off(fragments, rigid_placements(fragments.part, fragments.whole)[0].positions) > 0.1


def test_upright_rotations_keep_the_axis_up_within_the_tilt() -> None:
    for axis in range(3):
        tried = upright_rotations(axis)
        np.testing.assert_allclose(tried @ np.swapaxes(tried, 1, 2), np.tile(np.eye(3), (len(tried), 1, 1)), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(tried), 1)
        tilt = np.degrees(np.arccos(np.clip(tried[:, axis, axis], -1, 1)))
        assert set(tilt.round(3)) == {0.0, RIGID_PLACEMENTS.tilt}
        turned = tried[tilt < 1][:, (axis + 1) % 3, (axis + 1) % 3]
        assert len(turned) == 360 / RIGID_PLACEMENTS.upright_step
        np.testing.assert_allclose(np.sort(turned)[[0, -1]], [-1, 1])


@pytest.mark.parametrize("axis", UP_AXES)
def test_upright_rotations_find_what_other_rotations_miss(fragments: PartAndWhole, axis: int) -> None:
    turn = Rotation.from_rotvec(np.radians(100) * np.eye(3)[axis]).as_matrix() @ TURN.T
    part = fragments.part.shape
    moved = replace(part.proxy.mesh, vertices=part.proxy.mesh.vertices @ turn.T)
    standing = IncompleteShape(replace(part, proxy=replace(part.proxy, mesh=moved, full=moved)))
    with retune(RIGID_PLACEMENTS, rotations=3, kept=4):
        first = rigid_placements(standing, fragments.whole)[0]
        upright = rigid_placements(standing, fragments.whole, upright=True)
    assert off(fragments, first.positions) > 0.1
    assert off(fragments, upright[0].positions) < 0.1
    assert len(upright) <= 4


def test_a_fragment_that_lies_is_also_found_if_others_stand(
    fragments: PartAndWhole, placements: list[Placement]
) -> None:
    found = rigid_placements(fragments.part, fragments.whole, upright=True)
    assert off(fragments, found[0].positions) < 0.1
    assert len(found) <= RIGID_PLACEMENTS.kept
    assert [one.rank for one in found] == sorted(one.rank for one in found)


@pytest.fixture(scope="module")
def fitted(fragments: PartAndWhole) -> PartCandidate:
    with retune(RIGID_PLACEMENTS, kept=2):
        return _placed_candidates(fragments.everywhere, upright=False)[0]


def test_registered_placements_keep_where_they_began(
    fragments: PartAndWhole, placements: list[Placement], fitted: PartCandidate
) -> None:
    errors = fragments.errors(fitted.registered.closest.vertex[is_shared(fragments)], is_shared(fragments))
    assert np.median(errors) < 0.06
    np.testing.assert_array_equal(fitted.start, placements[0].positions)
    # The part is rotated back, so that what was up is not.
    assert fitted.scores[UPRIGHT] == pytest.approx(1 - max(np.diag(TURN)[1:]), abs=0.15)


@pytest.mark.parametrize("is_rigid", [True, False])
def test_nothing_pulls_what_only_one_fragment_has(
    fragments: PartAndWhole, fitted: PartCandidate, monkeypatch: pytest.MonkeyPatch, is_rigid: bool
) -> None:
    """Even a small pull draws it onto the other fragment, where it hides the true partners."""
    given = []

    def register(_places: object, _part: object, _whole: object, levels: Sequence[Level], start: Any) -> Any:
        given.append((levels, start))
        return fitted.registered

    monkeypatch.setattr(part_match, "register_part", register)
    nothing: Any = None
    found = fitted if is_rigid else replace(fitted, start=None)
    one = Candidate("", False, False, nothing, nothing, nothing, None, None, 0.0, found.scores, found)
    shapes = fragments.whole.shape, fragments.part.shape
    pair = Pair(fragments.made_whole.surface, fragments.made_part.surface, *shapes, 60, 20)
    fit_part(pair, one)
    monkeypatch.setattr(Region, "is_between_fragments", False)
    fit_part(pair, one)
    (levels, start), of_a_part = given
    assert {level.min_weight for level in levels} == {0.0}
    assert len(levels) == len(NONRIGID_SCHEDULE) + is_rigid * len(PART_REGISTRATION.placed)
    assert start is (fitted.start if is_rigid else fitted.registered.positions)
    assert of_a_part == (NONRIGID_SCHEDULE, None)


def test_up_axis_decides_between_equal_placements() -> None:
    nothing: Any = None

    def candidate(fit: float, upright: float) -> PartCandidate:
        return PartCandidate(nothing, nothing, nothing, {"fit": fit, UPRIGHT: upright})

    weight = EVIDENCE_WEIGHTS[UPRIGHT]
    standing, turned, better = candidate(-3.0, 0.0), candidate(-3.0 - 0.9 * weight, 1.0), candidate(-4.0, 1.0)
    assert _by_cost([standing, turned, better]) == [better, turned, standing]
    assert _by_cost([turned, standing, better], upright=True) == [better, standing, turned]
