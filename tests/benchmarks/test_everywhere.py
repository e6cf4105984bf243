# SPDX-License-Identifier: GPL-3.0-or-later
"""The local figures of maps, on a strip with a known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

import zoomout_core as zo
from benchmarks.everywhere.cases import SKIN, TOUCH, Case, Rig, case_of_bodies
from benchmarks.everywhere.measures import WRONG_PLACE, is_wrong, measure, measure_binding, torn_edges, wrong_limb
from zoomout_core.samples import grids

ROWS, COLUMNS = 9, 41


@pytest.fixture
def case() -> Case:
    """A strip matched to itself: its left third is one part, its halves are two limbs."""
    grid = grids.grid(np.linspace(0, 2, COLUMNS), np.linspace(0, 0.4, ROWS))
    vertices, strip = grid.vertices, zo.Surface(grid.vertices, grid.triangles)
    part = (vertices[:, 0] > 0.66).astype(np.int64)
    limb = np.sign(vertices[:, 0] - 1).astype(np.int64)
    return Case(SKIN, "strip", strip, strip, part, part, limb, limb)


def image(case: Case, vertex: np.ndarray) -> zo.SurfaceMap:
    return zo.SurfaceMap.from_vertices(vertex, case.source)


def test_true_map_has_no_faults(case: Case) -> None:
    figures = measure(case, image(case, np.arange(ROWS * COLUMNS)))
    assert figures == {"part": 1.0, "lost": 0, "visible": 2, "limb": 0.0, "torn": 0.0, "off": None}
    assert not is_wrong(figures)


def test_a_map_that_is_far_off_is_wrong_as_a_whole(case: Case) -> None:
    places = np.arange(ROWS * COLUMNS)
    known = replace(case, image=np.where(places % 2 == 0, places, -1))
    right, reversed_map = (measure(known, image(known, vertex)) for vertex in (places, places[::-1]))
    assert right["off"] == 0
    assert not is_wrong(right)
    assert reversed_map["off"] > WRONG_PLACE
    assert is_wrong(reversed_map | {"part": None, "limb": None})


def test_vertices_beside_another_limb_have_no_true_limb(case: Case) -> None:
    column = np.rint(case.source.vertices[:, 0] * (COLUMNS - 1) / 2).astype(int)
    limb = np.select([column < 10, column < 20], [1, 2], 0)
    of_bodies = case_of_bodies(TOUCH, "strip", case.source, case.target, limb, limb, None)
    np.testing.assert_array_equal(of_bodies.source_limb, limb)
    np.testing.assert_array_equal(of_bodies.target_limb, np.where((column == 9) | (column == 10), 0, limb))


def test_a_part_that_lands_elsewhere_is_lost(case: Case) -> None:
    vertex = np.arange(ROWS * COLUMNS)
    vertex[case.target_part == 0] = np.flatnonzero(case.source_part == 1)[0]
    figures = measure(case, image(case, vertex))
    assert (figures["lost"], figures["visible"]) == (1, 2)
    assert 0.6 < figures["part"] < 0.7
    assert is_wrong(figures)


def test_a_binding_is_played_and_checked(case: Case) -> None:
    assert measure_binding(case, image(case, np.arange(ROWS * COLUMNS))) == dict.fromkeys(
        ("stretched", "unchecked", "islands")
    )
    along = np.clip(case.source.vertices[:, :1] - 0.5, 0, 1)
    heads = np.array([[0, 0, 0], [1, 0.2, 0.0]])
    rig = Rig(case.source.vertices, csr_array(np.hstack([1 - along, along])), heads, np.array([-1, 0]))
    rigged = replace(case, rig=rig)
    right = np.arange(ROWS * COLUMNS)
    assert measure_binding(rigged, image(rigged, right)) == {"stretched": 0, "unchecked": 0, "islands": 0}
    patch = case.target.vertices[:, 0] < 0.35  # too large to be filled in as an island
    wrong = np.where(patch, np.argmax(case.source.vertices[:, 0]), right)
    found = measure_binding(rigged, image(rigged, wrong))
    assert 0 < found["unchecked"] < 0.1
    assert found["stretched"] <= found["unchecked"]


def test_wrong_limb_vertices_and_torn_edges_are_counted(case: Case) -> None:
    vertex = np.arange(ROWS * COLUMNS)
    moved = 5 * ROWS + ROWS // 2
    vertex[moved] = 35 * ROWS + ROWS // 2
    surface_map = image(case, vertex)
    np.testing.assert_array_equal(np.flatnonzero(wrong_limb(case, surface_map)), [moved])
    assert torn_edges(case, surface_map).sum() == 6  # all edges of a vertex of a grid
    figures = measure(case, surface_map)
    assert figures["limb"] == pytest.approx(1 / np.count_nonzero(case.target_limb))
    assert is_wrong({**figures, "torn": 0.02})
