# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotationally symmetric shapes are reported, and none of their maps is called certain."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from creatures import creature
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from shapes import LOPSIDED_TORUS, STONE, TORUS, VASE, shape
from solids import CUBE, ICOSAHEDRON, OCTAHEDRON, TETRAHEDRON, prism, pyramid, solid

import zoomout_core as zo
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.ranking.certainty import certainty_but_for_turns
from zoomout_core.matching.ranking.rotational_symmetry import (
    MAX_ROTATIONS,
    _promising,
    likely_turns,
    self_maps,
    with_turned,
)
from zoomout_core.matching.ranking.scores import no_disagreement
from zoomout_core.mesh.surface import Surface

# Functions and samples that suffice.
FEW = {"k_final": 60, "samples": 400}
BOX = CUBE * [1.0, 1.4, 2.1]
# The rotations of a cube: signed permutations of the axes with determinant 1.
OF_CUBE = np.array(
    [
        matrix
        for order in permutations(range(3))
        for signs in product((-1.0, 1.0), repeat=3)
        if np.linalg.det(matrix := np.eye(3)[list(order)] * signs) > 0
    ]
)


def analyse_coarsely(surface: Surface) -> ShapeAnalysis:
    """Analyse a surface with few functions and samples."""
    return analyse(surface.working.part(0)[0], 60, 400, 0)


@pytest.mark.slow(but=3)
@pytest.mark.parametrize(
    ("corners", "turns"),
    [
        (CUBE, 23),
        (prism(3), 5),
        (pyramid(4), 3),
        (TETRAHEDRON, 11),
        (OCTAHEDRON, 23),
        (ICOSAHEDRON, 59),
        (prism(5, 2.0), 9),
        (prism(6, 0.5), 11),
        (pyramid(3), 2),
        (BOX, 3),
    ],
    ids=[
        "cube",
        "prism3",
        "pyramid4",
        "tetrahedron",
        "octahedron",
        "icosahedron",
        "prism5",
        "prism6",
        "pyramid3",
        "box",
    ],
)
def test_all_rotations_of_a_solid_are_found(corners: np.ndarray, turns: int) -> None:
    assert len(self_maps(analyse_coarsely(solid(corners).surface))) == turns


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("corners", [prism(24, 1.5), pyramid(24)], ids=["cylinder", "cone"])
def test_some_of_infinitely_many_rotations_are_found(corners: np.ndarray) -> None:
    assert 8 <= len(self_maps(analyse_coarsely(solid(corners).surface))) <= MAX_ROTATIONS


def test_vase_torus_and_square_have_rotations() -> None:
    assert len(self_maps(analyse_coarsely(shape(VASE, 1500).surface))) == 1
    assert len(self_maps(analyse_coarsely(shape(TORUS, 1500).surface))) > 8
    corners = np.array([[x, y, 0.0] for x in range(9) for y in range(9)])
    faces = [[9 * x + y, 9 * x + y + 1, 9 * x + y + 10, 9 * x + y + 9] for x in range(8) for y in range(8)]
    assert len(self_maps(analyse_coarsely(Surface(corners, faces)))) >= 6  # a square may also be flipped


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    "surface",
    [
        creature(1500).surface,
        creature(1500, 1, bend=0.5).surface,
        shape(STONE, 1500).surface,
        shape(LOPSIDED_TORUS, 1500).surface,
        solid(CUBE, nose=0.2).surface,
        solid(prism(24), nose=0.2).surface,
    ],
    ids=["creature", "bent creature", "stone", "lopsided torus", "cube with a nose", "disc with a nose"],
)
def test_nearly_symmetric_shapes_have_no_rotations(surface: Surface) -> None:
    assert not len(self_maps(analyse_coarsely(surface)))


def test_starts_that_converge_to_one_rotation_are_refined_once() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    angles = [0.0, 0.01, 1.0, 1.01, 2.0]
    rotations = Rotation.from_rotvec([[0, 0, angle] for angle in angles]).as_matrix()
    distance = np.array([0.01, 0.002, 0.003, 0.004, 1.0])  # the last is far from the shape
    assert _promising(rotations, distance, points / np.linalg.norm(points)).tolist() == [1, 2]


def test_self_map_rotates_functions_with_the_shape() -> None:
    shape_of_box = analyse_coarsely(solid(BOX).surface)
    positions = shape_of_box.basis.coefficients(shape_of_box.mesh.vertices)[:60]
    signs = []
    for turned in self_maps(shape_of_box):
        places = shape_of_box.basis.eigenvectors[:, :60] @ (turned @ positions)
        assert np.median(cKDTree(shape_of_box.mesh.vertices).query(places)[0]) < 0.02
        signs.append(np.round(np.corrcoef(places.T, shape_of_box.mesh.vertices.T)[:3, 3:].trace()))
    assert signs == [-1.0] * 3  # two axes are reversed


@pytest.fixture(scope="module")
def cubes() -> tuple[zo.MatchResult, Surface, Surface]:
    source, target = (solid(CUBE, 900, seed).surface for seed in (1, 2))
    return zo.match(source, target, **FEW, upright=False), source, target


@pytest.mark.slow
def test_match_of_cubes_reports_equally_good_rotations(cubes: tuple[zo.MatchResult, Surface, Surface]) -> None:
    result, _, _ = cubes
    assert result.certainty == pytest.approx(1 / 24, rel=0.05)
    assert "at least 24 maps fit as well" in result.notes[0]
    assert not any("No reliable match" in note for note in result.notes)


def test_rotated_maps_do_not_share_the_finished_map(cubes) -> None:
    result = cubes[0]
    best = replace(result.candidates[0], refined=(result.surface_map, result.functional_map))
    found = with_turned([best], result.pair.source_shape, result.pair.target_shape, no_disagreement)
    assert len(found) == 24
    assert [one.refined for one in found if one.refined is not None] == [best.refined]


@pytest.mark.slow
def test_every_rotated_map_can_be_chosen(cubes: tuple[zo.MatchResult, Surface, Surface]) -> None:
    result, source, target = cubes
    turned = [number for number, one in enumerate(result.candidates) if one.turns == 24]
    assert len(turned) == 24
    at = source.vertices - source.vertices.mean(axis=0)
    here = target.vertices - target.vertices.mean(axis=0)
    turns = []
    for number in turned[::9]:
        images = result.use(number).surface_map.interpolate(at)
        rotation = np.linalg.lstsq(here, images, rcond=None)[0]
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 0.05
        assert np.median(np.linalg.norm(here @ rotation - images, axis=1)) < 0.05
        turns.append(rotation)
    assert min(np.abs(a - b).max() for i, a in enumerate(turns) for b in turns[:i]) > 0.5


def test_landmarks_choose_among_rotated_maps(cubes: tuple[zo.MatchResult, Surface, Surface]) -> None:
    _, source, target = cubes
    known = [solid(CUBE, 900, seed).directions for seed in (1, 2)]
    wanted = OF_CUBE[7]
    places = np.array([[1.0, 1, 1], [1, 1, -1], [1, -1, 1], [0, 0, 1]])
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    on_source = cKDTree(known[0]).query(places @ wanted)[1]
    on_target = cKDTree(known[1]).query(places)[1]
    result = zo.match(source, target, initial="landmarks", landmarks=(on_source, on_target), **FEW)
    truth = cKDTree(known[0]).query(known[1] @ wanted)[1]
    assert np.median(np.linalg.norm(source.vertices[result.surface_map.vertex] - source.vertices[truth], axis=1)) < 0.1
    assert result.certainty > 0.9
    assert not result.notes


def test_symmetry_of_the_target_alone_reduces_certainty() -> None:
    result = zo.match(solid(BOX, 900, 1, nose=0.15).surface, solid(BOX, 900, 2).surface, **FEW, upright=False)
    assert result.certainty < 0.3
    assert "at least 4 maps" in result.notes[0]


def test_upright_option_prefers_maps_that_stay_upright() -> None:
    source, target = (
        box.surface.with_vertices(box.directions * np.linalg.norm(box.surface.vertices, axis=1, keepdims=True))
        for box in (solid(BOX, 900, seed) for seed in (1, 2))
    )
    aside = target.with_vertices(target.vertices[:, [1, 0, 2]] * [-1, 1, 1])  # rotated by 90° about z
    result = zo.match(source, aside, **FEW)
    heights = aside.vertices[:, 2], result.surface_map.interpolate(source.vertices)[:, 2]
    assert np.corrcoef(*heights)[0, 1] > 0.9
    assert 0.3 < result.certainty < 0.5  # z stays up in two of the four maps
    assert zo.match(source, aside, **FEW, upright=False).certainty == pytest.approx(0.25, abs=0.01)


@pytest.mark.parametrize("initial", ["proximity", "given"])
def test_map_given_by_the_user_is_not_rotated(initial: str) -> None:
    cube = solid(CUBE, 900, 1).surface
    given = np.arange(len(cube.vertices)) if initial == "given" else None
    result = zo.match(cube, cube, initial=initial, initial_map=given)
    assert [one.turns for one in result.candidates] == [1]
    assert result.certainty > 0.9


def listed(*certainties: float, turns: int) -> list[Any]:
    """Candidates; the first `turns` of them differ by rotations."""
    return [SimpleNamespace(certainty=one, turns=turns if i < turns else 1) for i, one in enumerate(certainties)]


def test_certainty_but_for_turns_adds_up_all_rotations() -> None:
    assert certainty_but_for_turns(listed(0.3, 0.3, 0.3, 0.1, turns=3)) == pytest.approx(0.9)
    assert certainty_but_for_turns(listed(0.3, 0.3, turns=1)) == 0.3


def test_rotated_maps_that_landmarks_exclude_are_not_counted() -> None:
    assert likely_turns(listed(0.45, 0.45, 0.05, 0.05, turns=4), 0) == 2
    assert likely_turns(listed(0.5, 0.5, turns=1), 0) == 1
