# SPDX-License-Identifier: GPL-3.0-or-later
"""All symmetries are found in any pose, and asymmetric shapes have none."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from creatures import Creature, creature, mirrored_vertex
from reports import reports_of
from shapes import TABLE, VASE, Figure, Shaped, limb, shape

import zoomout_core as zo
from zoomout_core.mesh.surface import Surface
from zoomout_core.symmetry.hypotheses import _there_and_back

# A letter S has a half-turn symmetry but no mirror symmetry.
S_SHAPE = Figure(
    (
        [(-1.5, -0.6, 0, 0.2), (-0.7, -0.6, 0, 0.25)],
        [(-0.7, -0.6, 0, 0.25), (0.7, 0.6, 0, 0.25)],
        [(0.7, 0.6, 0, 0.25), (1.5, 0.6, 0, 0.2)],
        [(0, 0, 0.2, 0.3)] * 2,
    )
)
STARFISH = Figure(
    ([(0, 0, 0, 0.45), (0, 0, 0.9, 0.3)],),
    tuple(
        (limb((0.2 * x, 0.2 * y, 0), (1.6 * x, 1.6 * y, 0), 0.25, 0.15),)
        for x, y in ((np.cos(turn), np.sin(turn)) for turn in np.arange(5) * 2 * np.pi / 5)
    ),
)


def rigid_part(symmetry: zo.Symmetry, made: Shaped) -> tuple[np.ndarray, float]:
    """Best orthogonal fit (3, 3) to a symmetry's map of places, and its mean error at unit area."""
    here = made.places - made.places.mean(axis=0)
    there = symmetry.surface_map.interpolate(made.places) - made.places.mean(axis=0)
    U, _, Vt = np.linalg.svd(there.T @ here)
    off = np.linalg.norm(here @ (U @ Vt).T - there, axis=1).mean() / np.sqrt(made.surface.area)
    return U @ Vt, float(off)


def test_reflection_of_a_posed_creature_is_exact(reflection: zo.Symmetry, bent: Creature) -> None:
    assert reflection.reverses_orientation
    assert reflection.order == 2
    assert reflection.certainty > 0.9
    error = zo.geodesic_error(
        reflection.surface_map, bent.surface, np.arange(len(bent.directions)), mirrored_vertex(bent, bent)
    )
    assert error.mean() < 0.03


def test_reflection_is_an_involution(reflection: zo.Symmetry, bent: Creature) -> None:
    places = bent.surface.vertices
    there = reflection.surface_map
    missed = np.linalg.norm(there.interpolate(there.interpolate(places)) - places, axis=1) / np.sqrt(bent.surface.area)
    assert missed.mean() == pytest.approx(reflection.return_error)
    assert missed.mean() < 0.005
    for name in ("commutativity", "orthonormality"):
        assert 0 < reflection.scores[f"low {name}"] < reflection.scores[name]
    assert reflection.scores["low commutativity"] < 0.5


def test_sides_are_the_true_left_and_right(reflection: zo.Symmetry, bent: Creature) -> None:
    x = bent.directions[:, 0]
    clear = np.abs(x) > 0.1
    np.testing.assert_array_equal(reflection.sides()[clear], np.sign(x[clear]))
    other = zo.detect_symmetry(bent.surface, left=(-1, 0, 0))[0]
    np.testing.assert_array_equal(other.sides()[clear], -np.sign(x[clear]))
    middle = reflection.sides(width=0.05) == 0
    assert np.abs(x[middle]).max() < 0.2


def test_symmetry_line_is_a_closed_loop_between_the_sides(reflection: zo.Symmetry, bent: Creature) -> None:
    line = reflection.line
    directions = bent.directions[line.edges].mean(axis=1)
    assert np.abs(directions[:, 0]).max() < 0.1
    curves = line.polylines
    longest = max(curves, key=len)
    assert longest[0] == longest[-1]
    assert len(longest) > 0.9 * len(line.points)
    step = np.linalg.norm(np.diff(line.points[longest], axis=0), axis=1)
    assert step.max() < 0.5


def test_detection_does_not_depend_on_unit_place_or_order(reflection: zo.Symmetry, bent: Creature) -> None:
    order = np.random.default_rng(0).permutation(len(bent.directions))
    number = np.argsort(order)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = Surface(1000 * bent.surface.vertices[order] @ turn.T + [5, 6, 7], number[bent.surface.triangles])
    again = zo.detect_symmetry(moved, left=turn @ [1, 0, 0])[0]
    assert again.certainty == pytest.approx(reflection.certainty, abs=0.05)
    clear = np.abs(bent.directions[:, 0]) > 0.1
    np.testing.assert_array_equal(again.sides()[number][clear], reflection.sides()[clear])


@pytest.mark.slow
def test_three_symmetries_of_a_vase_rank_first() -> None:
    vase = shape(VASE, 2500, seed=1)
    found = zo.detect_symmetry(vase.surface)
    diagonals = set()
    for symmetry in found[:3]:
        rigid, off = rigid_part(symmetry, vase)
        assert off < 0.01
        assert symmetry.reverses_orientation == (np.linalg.det(rigid) < 0)
        diagonals.add(tuple(np.rint(np.diag(rigid)).astype(int)))
    assert diagonals == {(-1, 1, 1), (1, -1, 1), (-1, -1, 1)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("figure", "orders"), [(TABLE, [2, 2, 2, 2, 2, 4, 4]), (STARFISH, [2, 2, 2, 2, 2, 5, 5, 5, 5])]
)
def test_all_rotations_and_reflections_are_found(figure: Figure, orders: list[int]) -> None:
    made = shape(figure, 2000, seed=1)
    found = zo.detect_symmetry(made.surface, max_count=20)
    assert sorted(symmetry.order for symmetry in found[: len(orders)]) == orders
    turns = [rigid_part(symmetry, made) for symmetry in found[: len(orders)]]
    assert max(off for _, off in turns) < 0.015
    assert all(np.linalg.norm(a - b) > 0.5 for i, (a, _) in enumerate(turns) for b, _ in turns[:i])


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("seed", [1, 3])
def test_reflection_of_coarse_thin_limbs_has_order_two(seed: int) -> None:
    made = creature(2000, seed, bend=0.7)
    found = zo.detect_symmetry(made.surface)[0]
    error = zo.geodesic_error(
        found.surface_map, made.surface, np.arange(len(made.directions)), mirrored_vertex(made, made)
    )
    assert error.mean() < 0.01
    assert found.order == 2
    assert found.has_sides


def test_a_half_turn_alone_has_no_sides() -> None:
    found = zo.detect_symmetry(shape(S_SHAPE, 2000, seed=1).surface)
    assert not found[0].reverses_orientation
    assert found[0].order == 2
    assert not found[0].has_sides
    assert (found[0].sides() == 0).all()
    assert all(symmetry.certainty < found[0].certainty for symmetry in found[1:])


def test_reflections_rank_before_equally_certain_rotations() -> None:
    box = trimesh.creation.box(extents=(1.0, 0.7, 0.4)).subdivide().subdivide().subdivide()
    found = zo.detect_symmetry(Surface(box.vertices, box.faces))
    assert min(symmetry.certainty for symmetry in found[:7]) > 0.98
    reverse = [symmetry.reverses_orientation for symmetry in found[:7]]
    assert reverse == [True] * 4 + [False] * 3


@pytest.mark.slow
def test_eyes_are_swapped_and_the_nose_maps_to_itself(bent: Creature) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    at = np.array([[0.45, -0.75, 0.35], [-0.45, -0.75, 0.35], [0, -0.85, 0.1]])
    points = [bent.surface.vertices, *(0.12 * ball.vertices + centre for centre in at)]
    starts = np.cumsum([0, *(len(part) for part in points)])
    faces = [bent.surface.triangles, *(ball.faces + start for start in starts[1:-1])]
    whole = Surface(np.concatenate(points), np.concatenate(faces))
    symmetry = zo.detect_symmetry(whole)[0]
    assert symmetry.notes == ("3 loose parts mapped to their partners, or to themselves, by position, size and shape.",)
    part = np.searchsorted(starts, symmetry.surface_map.vertex, side="right") - 1
    for own, other, side in ((1, 2, 1), (2, 1, -1), (3, 3, None)):
        rows = slice(starts[own], starts[own + 1])
        assert (part[rows] == other).mean() > 0.95
        if side is None:
            outer = np.abs(ball.vertices[:, 0]) > 0.5
            assert (symmetry.sides()[rows][outer] == np.sign(ball.vertices[outer, 0])).mean() > 0.9
        else:
            assert (symmetry.sides()[rows] == side).all()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("axis", [0, 1])
def test_symmetries_that_pair_loose_parts_rank_first(axis: int) -> None:
    body = trimesh.creation.box(extents=(1.0, 0.7, 0.4)).subdivide().subdivide().subdivide()
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.15)
    at = np.array([[0.3, 0.2, 0.4], [0.3, 0.2, 0.4]])
    at[1, axis] *= -1
    parts = [body.vertices, *(ball.vertices + centre for centre in at)]
    starts = np.cumsum([0, *(len(part) for part in parts)])
    faces = [body.faces, *(ball.faces + start for start in starts[1:-1])]
    found = zo.detect_symmetry(Surface(np.concatenate(parts), np.concatenate(faces)))
    mirrored = found[0].surface.vertices * np.where(np.arange(3) == axis, -1, 1)
    off = found[0].surface_map.interpolate(found[0].surface.vertices) - mirrored
    assert np.linalg.norm(off, axis=1).mean() < 0.02


def test_detection_reports_progress_and_can_be_cancelled(bent: Creature) -> None:
    _, reports = reports_of(lambda: zo.detect_symmetry(bent.surface))
    fractions = [report.fraction for report in reports]
    assert all(a <= b for a, b in pairwise(fractions))
    assert fractions[0] >= 0
    assert fractions[-1] <= 1
    stages = {report.stage for report in reports}
    assert {"Reading the mesh", "Analyzing the shape", "Comparing candidates", "Refining"} <= stages

    def cancel(_: zo.Progress) -> None:
        raise zo.Cancelled

    with pytest.raises(zo.Cancelled):
        zo.detect_symmetry(creature(1000, seed=2).surface, progress=cancel)


@pytest.mark.parametrize("wrong", [{"max_count": 0}, {"left": (0, 0, 0)}, {"left": (1, 0)}, {"k_final": 1}])
def test_invalid_options_are_refused(bent: Creature, wrong: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        zo.detect_symmetry(bent.surface, **wrong)


@pytest.mark.slow
def test_reflections_of_people_and_animals_are_found(benchmark_data) -> None:
    for folder, name in (("faust_r", "tr_reg_004"), ("tosca_r", "horse6")):
        with np.load(benchmark_data / folder / "correspondence.npz") as file:
            known = file[name], file[f"{name}.sym"]
        surface = zo.read_surface(benchmark_data / folder / f"{name}.off")
        assert 1000 * zo.geodesic_error(zo.detect_symmetry(surface)[0].surface_map, surface, *known).mean() < 60


def test_pairing_of_tips_must_be_mutual() -> None:
    tips = np.arange(4)
    assert _there_and_back(tips, np.array([1, 0, 2, 3]))
    assert not _there_and_back(tips, np.array([1, 2, 0, 3]))
    assert not _there_and_back(tips[:2], np.array([0, 3]))
