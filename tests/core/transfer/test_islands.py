"""Small islands of labels survive a transfer, and specks that the source does not have vanish."""

from __future__ import annotations

import numpy as np
import pytest
from transfer_meshes import Sheet, sheet, torus, true_map

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.islands import islands_of, without_specks

GRID = (120, 80)


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(torus, *GRID)


@pytest.fixture(scope="module")
def target() -> Sheet:
    return sheet(torus, 131, 89, jitter=0.2, twist=0.05, seed=1)


def rough_map(source: Sheet, target: Sheet, amount: float) -> SurfaceMap:
    """Off by a part of an edge, each vertex in its own direction."""
    points = target.surface.vertices + np.random.default_rng(0).normal(scale=amount, size=target.surface.vertices.shape)
    triangles = source.surface.triangles
    return SurfaceMap(*closest_points(points, source.surface.vertices, triangles), triangles)


def labelled(values: np.ndarray, surface_map: SurfaceMap, source: Sheet, target: Sheet) -> np.ndarray:
    attribute = Attribute("x", Domain.FACE, Kind.LABEL, values)
    return transfer(attribute, surface_map, source.surface, target.surface).values


def test_faces_are_of_one_island_where_they_share_a_vertex_and_a_label() -> None:
    mesh = sheet(torus, 8, 6).surface
    label = np.zeros(48, dtype=int)
    label[[0, 7, 20]] = 1  # the first two touch at a corner
    island = islands_of(mesh, label)
    assert island[0] == island[7] != island[20]
    assert len(np.unique(island)) == 3


def test_islands_of_single_faces_survive(source: Sheet, target: Sheet) -> None:
    stripe = np.floor(source.middles[:, 0] * 4).astype(int) % 4
    alone = np.random.default_rng(0).choice(len(stripe), 20, replace=False)
    values = stripe.copy()
    values[alone] = 10 + np.arange(20)
    for surface_map in (true_map(source, *GRID, target.parameters), rough_map(source, target, 0.02)):
        result = labelled(values, surface_map, source, target)
        assert set(result) == set(values)
        middles = target.surface.vertices[target.surface.corner_vertex].reshape(-1, 4, 3).mean(axis=1)
        for face, name in zip(alone, values[alone], strict=True):
            place = source.surface.vertices[source.surface.corner_vertex].reshape(-1, 4, 3)[face].mean(axis=0)
            assert np.linalg.norm(middles[result == name] - place, axis=1).max() < 0.2


def test_islands_far_below_a_face_s_size_do_not_grow_to_one(source: Sheet) -> None:
    coarse = sheet(torus, 30, 20)
    values = np.zeros(len(source.surface.face_start) - 1, dtype=int)
    values[5::997] = 1
    assert not labelled(values, true_map(source, *GRID, coarse.parameters), source, coarse).any()


def test_single_faces_beyond_a_border_take_the_label_around_them_but_islands_of_their_own_stay() -> None:
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


def test_a_rough_map_leaves_no_single_faces_beyond_borders(source: Sheet, target: Sheet) -> None:
    stripe = np.floor(source.middles[:, 0] * 4).astype(int) % 4
    result = labelled(stripe, rough_map(source, target, 0.12), source, target)
    assert (np.bincount(islands_of(target.surface, result)) > 1).all()
