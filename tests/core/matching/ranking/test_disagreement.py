# SPDX-License-Identifier: GPL-3.0-or-later
"""Disagreement of a map with each kind of evidence from the user."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.transform import Rotation
from shapes import sheet

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.constraints import Constraints, bend_to_points, check_axes, check_regions
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import analyse
from zoomout_core.matching.ranking.scores import IN_SPACE, MAX_IN_SPACE, UPRIGHT, evidence_score
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph

MADE = creature(500, seed=0)
NOTHING = Constraints(None, np.zeros((0, 3)), [])
LEG, TAIL = MADE.directions[:, 2] < -0.7, MADE.directions[:, 1] > 0.8


@pytest.fixture(scope="module")
def pair() -> Pair:
    shape = analyse(MADE.surface.working.part(0)[0], 60, 500, 0)
    return Pair(MADE.surface, MADE.surface, shape, shape, 60, 20)


def disagreement(pair: Pair, evidence: Constraints, vertex: np.ndarray) -> dict[str, float]:
    """Disagreement of a map of all vertices, evaluated at the samples."""
    shape = pair.source_shape
    samples = shape.search.samples
    image = vertex[samples]
    sample_map = np.linalg.norm(shape.mesh.vertices[image][:, None] - shape.mesh.vertices[samples], axis=2).argmin(
        axis=1
    )
    C = shape.basis.coefficients(shape.basis.eigenvectors[vertex, :40])[:40]
    return evidence.disagreement(pair)(C, sample_map, None)


def by_directions(factors: list[float]) -> np.ndarray:
    """The map that sends each vertex to the one nearest to its direction scaled by factors."""
    return np.linalg.norm((MADE.directions * factors)[:, None] - MADE.directions, axis=2).argmin(axis=1)


SAME, UPSIDE_DOWN, MIRRORED = (by_directions(factors) for factors in ([1, 1, 1], [1, -1, -1], [-1, 1, 1]))


def test_no_evidence_gives_no_disagreement(pair: Pair) -> None:
    assert disagreement(pair, NOTHING, SAME) == {}


def test_common_axis_penalises_only_upside_down_maps(pair: Pair) -> None:
    up = replace(NOTHING, common_axes=np.array([[0.0, 0, 1]]))
    same, turned, mirrored = (disagreement(pair, up, vertex)["axes"] for vertex in (SAME, UPSIDE_DOWN, MIRRORED))
    assert same < 0.05
    assert mirrored < 0.2
    assert turned > 1


@pytest.mark.parametrize("turn", [0, -90], ids=["z up", "y up"])
def test_upright_slightly_penalises_upside_down_maps(pair: Pair, turn: float) -> None:
    by = Rotation.from_euler("x", turn, degrees=True)
    surface = Surface(by.apply(pair.source.vertices), pair.source.triangles)
    shape = analyse(surface.working.part(0)[0], 60, 500, 0)
    standing = Pair(surface, surface, shape, shape, 60, 20)
    same, turned, mirrored = (
        disagreement(standing, replace(NOTHING, upright=True), vertex)[UPRIGHT]
        for vertex in (SAME, UPSIDE_DOWN, MIRRORED)
    )
    assert same < 0.05
    assert mirrored < 0.2
    assert turned > 0.95
    assert evidence_score(UPRIGHT, 1.0) <= MAX_IN_SPACE


def test_upright_is_ignored_beside_an_axis_or_a_common_place(pair: Pair) -> None:
    upright = replace(NOTHING, upright=True)
    places = pair.target_shape.proxy.vertices[pair.target_shape.search.samples]
    assert set(disagreement(pair, replace(upright, common_axes=np.array([[0.0, 0, 1]])), SAME)) == {"axes"}
    assert set(disagreement(pair, replace(upright, in_space=places), SAME)) == {IN_SPACE}


def test_regions_penalise_maps_that_leave_them(pair: Pair) -> None:
    both = replace(
        NOTHING, regions=[(np.flatnonzero(LEG), np.flatnonzero(LEG)), (np.flatnonzero(TAIL), np.flatnonzero(TAIL))]
    )
    assert 0 <= disagreement(pair, both, SAME)["regions"] < 0.05
    assert disagreement(pair, both, MIRRORED)["regions"] < 0.4
    assert disagreement(pair, both, UPSIDE_DOWN)["regions"] > 0.8
    # Regions that cover everything or nothing are uninformative.
    all_of_it = np.arange(len(LEG))
    assert disagreement(pair, replace(NOTHING, regions=[(all_of_it, np.flatnonzero(LEG))]), UPSIDE_DOWN) == {}


def test_earlier_map_penalises_by_distance_along_the_surface(pair: Pair) -> None:
    samples = pair.target_shape.search.samples
    earlier = replace(NOTHING, earlier=SAME[samples])
    assert disagreement(pair, earlier, SAME)["earlier map"] < 0.1
    assert disagreement(pair, earlier, UPSIDE_DOWN)["earlier map"] > 0.3


def test_placement_penalises_by_distance_in_space(pair: Pair) -> None:
    standing = replace(NOTHING, in_space=pair.source_shape.proxy.vertices[pair.target_shape.search.samples])
    found = [disagreement(pair, standing, vertex)["place in space"] for vertex in (SAME, MIRRORED)]
    assert found[0] < 0.01
    off = np.linalg.norm(MADE.surface.working.vertices[MIRRORED] - MADE.surface.working.vertices, axis=1)
    assert found[1] == pytest.approx(pair.target_shape.basis.areas @ off, rel=0.1)


def test_landmarks_penalise_by_the_sum_of_their_distances(pair: Pair) -> None:
    tips = np.array([np.argmax(MADE.directions @ axis) for axis in ([0, 0, -1], [0, 1, 0], [0, 0, 1])])
    one, all_three = (replace(NOTHING, landmarks=(tips[:n], tips[:n])) for n in (1, 3))
    assert disagreement(pair, all_three, SAME)["landmarks"] < 0.3
    assert disagreement(pair, one, UPSIDE_DOWN)["landmarks"] > 0.5
    assert (
        disagreement(pair, all_three, UPSIDE_DOWN)["landmarks"]
        > 1.5 * disagreement(pair, one, UPSIDE_DOWN)["landmarks"]
    )


def test_anchors_of_regions_have_unit_scale_and_fade_outside(pair: Pair) -> None:
    anchors = replace(NOTHING, regions=[(np.flatnonzero(TAIL), np.flatnonzero(TAIL))]).anchors(pair)
    assert anchors is not None
    np.testing.assert_array_equal(anchors.source, anchors.target)
    values = anchors.source[:, 0]
    distance = np.linalg.norm(pair.source_shape.mesh.vertices[:, None] - pair.source_shape.mesh.vertices[TAIL], axis=2)
    far = distance.min(axis=1) > 0.3
    assert values[TAIL].mean() > 1
    assert np.abs(values[far]).mean() < 0.1
    beside = (distance.min(axis=1) > 0.02) & (distance.min(axis=1) < 0.07)
    assert 0.1 < values[beside].mean() < values[TAIL].mean()
    assert NOTHING.anchors(pair) is None


def test_exact_landmark_moves_only_its_surroundings() -> None:
    surface = MADE.surface
    target = int(np.argmax(MADE.directions[:, 1]))
    distance = np.linalg.norm(surface.vertices - surface.vertices[target], axis=1) / np.sqrt(surface.area)
    source = int(np.abs(distance - 0.08).argmin())
    moved = np.linalg.norm(bend_identity(surface, source, target) - surface.vertices, axis=1)
    assert moved[target] == pytest.approx(np.linalg.norm(surface.vertices[source] - surface.vertices[target]))
    near = np.argsort(distance)[1:5]
    assert moved[near].mean() > 0.2 * moved[target]
    assert moved[distance > 0.4].max() < 1e-6


def test_anchors_of_regions_are_smoothed_beyond_the_basis(pair: Pair) -> None:
    anchors = replace(NOTHING, regions=[(np.flatnonzero(TAIL), np.flatnonzero(TAIL))]).anchors(pair)
    assert anchors is not None
    basis = pair.source_shape.basis
    left = basis.coefficients(anchors.source)[:, 0] / basis.coefficients(TAIL[:, None].astype(float))[:, 0]
    assert 0.01 < left[-1] / left[1] < 0.5


def test_displacement_around_an_exact_landmark_is_gaussian() -> None:
    flat = sheet(400).surface
    places, unit = flat.vertices, np.sqrt(flat.area)
    inner = int(np.linalg.norm(places - places.mean(axis=0), axis=1).argmin())
    distance = dijkstra(edge_graph(places, flat.triangles), indices=inner) / unit
    partner = int(np.argsort(distance)[1])
    moved = np.linalg.norm(bend_identity(flat, partner, inner) - places, axis=1)
    assert moved[inner] == pytest.approx(np.linalg.norm(places[partner] - places[inner]))
    # Points that would leave the sheet stay at its border, up to rounding.
    near = (distance > 0.02) & (distance < 0.15) & (moved > 1e-9 * moved[inner])
    rates = np.log(moved[near] / moved[inner]) / distance[near] ** 2
    assert near.sum() > 5
    np.testing.assert_allclose(rates, rates[0], rtol=1e-3)


def bend_identity(surface: Surface, source: int, target: int) -> np.ndarray:
    """(n, 3) images of the map of a surface to itself that takes one vertex to another one."""
    identity = SurfaceMap.from_vertices(np.arange(len(surface.vertices)), surface)
    bent = bend_to_points(identity, surface, surface, *(surface.vertices[[vertex]] for vertex in (source, target)))
    return bent.interpolate(surface.vertices)


@pytest.fixture(scope="module")
def two() -> tuple[Pair, np.ndarray]:
    """Two meshes of one surface in different frames, with unused vertices, and the map between them."""
    source, target = creature(300, seed=1), creature(260, seed=2)
    stood = source.surface.vertices[:, [1, 2, 0]]
    surfaces = (
        Surface(np.vstack([stood, [[0, 0, 0]]]), source.surface.triangles),
        Surface(np.vstack([[[0, 0, 0]], target.surface.vertices]), target.surface.triangles + 1),
    )
    shapes = (analyse(each.working.part(0)[0], 60, 120, 0) for each in surfaces)
    return Pair(*surfaces, *shapes, 60, 20), true_vertex(source, target)


def known(two: tuple[Pair, np.ndarray], evidence: Constraints) -> dict[str, float]:
    """Disagreement of the true map with the evidence."""
    pair, truth = two
    source, target = pair.source_shape, pair.target_shape
    places = source.mesh.vertices
    image = places[truth[target.search.samples]]
    sample_map = np.linalg.norm(image[:, None] - places[source.search.samples], axis=2).argmin(axis=1)
    C = target.basis.coefficients(source.basis.eigenvectors[truth, :40])[:40]
    return evidence.disagreement(pair)(C, sample_map, None)


def test_axes_refer_to_the_frame_of_each_surface(two) -> None:
    # The frames differ by an unknown rotation: the target's z axis is the source's y axis.
    z = known(two, replace(NOTHING, common_axes=np.array([[0.0, 0, 1]])))["axes"]
    pair, truth = two
    rows = pair.target_shape.search.samples
    heights = pair.target.vertices[1:][rows, 2], pair.source.vertices[truth[rows], 2]
    assert z == pytest.approx(1 - np.corrcoef(*heights)[0, 1], abs=0.15)
    assert z > 0.5


def test_unused_vertices_belong_to_no_region(two) -> None:
    pair, truth = two
    target = np.flatnonzero(np.isin(truth, np.flatnonzero(pair.source.vertices[:-1, 1] < -1)))
    legs = np.flatnonzero(pair.source.vertices[:-1, 1] < -1)
    clean, with_strays = (
        known(two, replace(NOTHING, regions=[(source, of_target)]))["regions"]
        for source, of_target in ((legs, target + 1), (np.append(legs, 300), np.append(0, target + 1)))
    )
    assert with_strays == clean < 0.5


def test_regions_without_samples_penalise_all_maps_equally(two) -> None:
    pair, _ = two
    alone = [
        np.setdiff1d(np.arange(50, 150), shape.search.samples)[:1] for shape in (pair.source_shape, pair.target_shape)
    ]
    assert known(two, replace(NOTHING, regions=[(alone[0], alone[1] + 1)]))["regions"] == 1


def test_axes_are_normalised_or_refused() -> None:
    np.testing.assert_allclose(check_axes((0, 0, 2)), [[0, 0, 1]])
    np.testing.assert_allclose(check_axes([(3, 0, 4), (0, -2, 0)]), [[0.6, 0, 0.8], [0, -1, 0]])
    assert check_axes(None).shape == (0, 3)
    for axes in ((0, 1), np.ones((1, 3, 3)), (np.nan, 0, 1), [(0, 0, 1), (0, 0, 0)]):
        with pytest.raises(ValueError, match="common_axes must be directions"):
            check_axes(axes)


def test_regions_are_checked_against_each_surface(two) -> None:
    pair, _ = two
    ((of_source, of_target),) = check_regions([([1, 300], (5,))], pair.source, pair.target)
    np.testing.assert_array_equal(of_source, [1, 300])
    np.testing.assert_array_equal(of_target, [5])
    with pytest.raises(ValueError, match="Region 1 of the target"):
        check_regions([([1], [5]), ([300], [300])], pair.source, pair.target)
