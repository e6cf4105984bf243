# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial maps from the user, in each accepted form, and from the nearest points in space."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.matching.hypotheses.given import given_hypothesis, proximity_hypothesis
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import analyse
from zoomout_core.mesh.surface import Surface

SOURCE, TARGET = creature(300), creature(260, seed=1)
TRUTH = true_vertex(SOURCE, TARGET)


@pytest.fixture(scope="module")
def pair() -> Pair:
    """A pair whose source ends with a loose part beside a hand."""
    body, eye = SOURCE.surface, creature(30, seed=5).surface
    hand = body.vertices[np.argmax(body.vertices[:, 0])]
    source = Surface(
        100 * np.vstack([body.vertices, 0.02 * eye.vertices + hand + [0.1, 0, 0]]),
        np.vstack([body.triangles, eye.triangles + 300]),
    )
    target = Surface(100 * TARGET.surface.vertices, TARGET.surface.triangles)
    shapes = (analyse(each.working.part(0)[0], 40, 100, 0) for each in (source, target))
    return Pair(source, target, *shapes, 40, 20)


def test_a_map_of_vertices_becomes_a_functional_map(pair: Pair) -> None:
    C = given_hypothesis(pair, TRUTH).functional_map
    assert 10 <= len(C) <= 40
    expected = functional_map_of(TRUTH, pair.source_shape.basis, pair.target_shape.basis, *C.shape)
    np.testing.assert_allclose(C, expected, atol=1e-9)
    again = given_hypothesis(pair, zo.SurfaceMap.from_vertices(TRUTH, pair.source))
    np.testing.assert_array_equal(again.functional_map, C)


def test_functional_map_is_equivalent_to_its_vertex_map(pair: Pair) -> None:
    bases = zo.eigenbasis(pair.source, 30), zo.eigenbasis(pair.target, 35)
    given = functional_map_of(TRUTH, bases[0], bases[1], 30, 35)
    vertex = cKDTree(bases[0].eigenvectors @ given.T).query(bases[1].eigenvectors)[1]
    np.testing.assert_allclose(
        given_hypothesis(pair, given).functional_map, given_hypothesis(pair, vertex).functional_map
    )


@pytest.mark.parametrize("shape", [(260, 20), (20, 330)])
def test_functional_map_too_large_for_a_mesh_is_refused(pair: Pair, shape: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="larger than the meshes allow"):
        given_hypothesis(pair, np.ones(shape))


def test_images_on_a_loose_part_move_to_the_nearest_vertex_of_the_body(pair: Pair) -> None:
    astray = TRUTH.copy()
    hand = np.argsort(TARGET.surface.vertices[:, 0])[-9:]
    astray[hand] = 305
    nearest = cKDTree(pair.source.vertices[:300]).query(pair.source.vertices[305])[1]
    moved = TRUTH.copy()
    moved[hand] = nearest
    np.testing.assert_array_equal(
        given_hypothesis(pair, astray).functional_map, given_hypothesis(pair, moved).functional_map
    )


def test_proximity_is_measured_in_the_common_frame(pair: Pair) -> None:
    found = proximity_hypothesis(pair).functional_map
    np.testing.assert_allclose(found, given_hypothesis(pair, TRUTH).functional_map, atol=0.5)
    # A target far to one side maps to the hand on that side, even though it does not fit there.
    aside = Surface(pair.target.vertices + np.array([9000, 0, 0]), pair.target.triangles)
    shape = analyse(aside.working.part(0)[0], 40, 100, 0)
    away = proximity_hypothesis(Pair(pair.source, aside, pair.source_shape, shape, 40, 20)).functional_map
    hand = np.full(260, np.argmax(pair.source.vertices[:300, 0]))
    np.testing.assert_allclose(
        away, functional_map_of(hand, pair.source_shape.basis, shape.basis, *away.shape), atol=1e-6
    )
