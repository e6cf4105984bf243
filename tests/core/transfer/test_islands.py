# SPDX-License-Identifier: GPL-3.0-or-later
"""Small islands of labels survive a transfer, and specks that are not on the source vanish."""

from __future__ import annotations

import numpy as np
import pytest
from transfer_meshes import Sheet, plate, sheet, torus, true_map

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.islands import islands_of, with_lost_islands, without_specks
from zoomout_core.transfer.potts import Candidates

GRID = (60, 40)


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(torus, *GRID)


@pytest.fixture(scope="module")
def target() -> Sheet:
    return sheet(torus, 66, 45, jitter=0.2, twist=0.05, seed=1)


def rough_map(source: Sheet, target: Sheet, amount: float) -> SurfaceMap:
    """The nearest-point map with random errors of a fraction of an edge."""
    points = target.surface.vertices + np.random.default_rng(0).normal(scale=amount, size=target.surface.vertices.shape)
    triangles = source.surface.triangles
    return SurfaceMap(*closest_points(points, source.surface.vertices, triangles), triangles)


def transfer_labels(values: np.ndarray, surface_map: SurfaceMap, source: Sheet, target: Sheet) -> np.ndarray:
    attribute = Attribute("x", Domain.FACE, Kind.LABEL, values)
    return transfer(attribute, surface_map, source.surface, target.surface).values


def test_islands_join_faces_that_share_a_vertex_and_a_label() -> None:
    mesh = sheet(torus, 8, 6).surface
    label = np.zeros(48, dtype=int)
    label[[0, 7, 20]] = 1  # the first two faces touch at a corner
    island = islands_of(mesh, label)
    assert island[0] == island[7] != island[20]
    assert len(np.unique(island)) == 3


def test_islands_of_single_faces_survive(source: Sheet, target: Sheet) -> None:
    stripe = np.floor(source.middles[:, 0] * 4).astype(int) % 4
    alone = np.random.default_rng(0).choice(len(stripe), 20, replace=False)
    values = stripe.copy()
    values[alone] = 10 + np.arange(20)
    for surface_map in (true_map(source, *GRID, target.parameters), rough_map(source, target, 0.02)):
        result = transfer_labels(values, surface_map, source, target)
        assert set(result) == set(values)
        middles = target.surface.vertices[target.surface.corner_vertex].reshape(-1, 4, 3).mean(axis=1)
        for face, name in zip(alone, values[alone], strict=True):
            place = source.surface.vertices[source.surface.corner_vertex].reshape(-1, 4, 3)[face].mean(axis=0)
            assert np.linalg.norm(middles[result == name] - place, axis=1).max() < 0.2


def test_islands_far_smaller_than_a_face_vanish(source: Sheet) -> None:
    coarse = sheet(torus, 30, 20)
    values = np.zeros(len(source.surface.face_start) - 1, dtype=int)
    values[5::997] = 1
    assert not transfer_labels(values, true_map(source, *GRID, coarse.parameters), source, coarse).any()


@pytest.mark.parametrize(("own", "given"), [(1, False), (2, True)])
def test_lost_island_takes_its_best_face_but_no_island_s_last(own: int, given: bool) -> None:
    mesh = plate(3, 1)
    # Island 1 wins the first `own` faces, island 0 the others; island 2 has minor shares of the first two faces.
    candidates = Candidates(np.array([0, 0, 1, 1, 2]), np.array([0.6, 0.4, 0.7, 0.3, 1.0]))
    island = np.array([1, 2, 1 if own == 2 else 0, 2, 0])
    for numbered in (island, 2 - island):
        chosen = with_lost_islands(np.array([0, 2, 4]), candidates, numbered, mesh)
        assert chosen.tolist() == ([1, 2, 4] if given else [0, 2, 4])


@pytest.mark.parametrize("face", range(4))
def test_specks_are_removed_anywhere(face: int) -> None:
    label = np.where(np.arange(4) == face, 1, 0)
    assert not without_specks(label, np.zeros(4, dtype=int), plate(4, 1)).any()


def test_faces_joined_at_one_vertex_form_islands() -> None:
    # Two faces share only the first vertex.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], dtype=float)
    fins = Surface(vertices, [[0, 1, 2], [0, 3, 4]])
    assert islands_of(fins, np.array([5, 5])).tolist() == [0, 0]
    assert islands_of(fins, np.array([5, 6])).tolist() == [0, 1]


def test_specks_take_the_surrounding_label_but_islands_stay() -> None:
    mesh = sheet(torus, 30, 20)
    stripe = np.floor(mesh.middles[:, 0] * 3).astype(int) % 3
    island = stripe.copy()
    label = stripe.copy()
    column, row = np.divmod(np.arange(600), 20)
    inside = np.flatnonzero((column % 10 == 5) & (row % 3 == 0) & (row < 18))
    label[inside] = island[inside] = (label[inside] + 1) % 3
    assert (without_specks(label, island, mesh.surface) == stripe).all()
    island[inside] = 3 + np.arange(len(inside))
    assert (without_specks(label, island, mesh.surface) == label).all()


def test_rough_maps_leave_no_specks(source: Sheet, target: Sheet) -> None:
    stripe = np.floor(source.middles[:, 0] * 4).astype(int) % 4
    result = transfer_labels(stripe, rough_map(source, target, 0.12), source, target)
    assert (np.bincount(islands_of(target.surface, result)) > 1).all()
