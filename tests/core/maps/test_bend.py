# SPDX-License-Identifier: GPL-3.0-or-later
"""Bent maps interpolate few or many places and stay smooth between them."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.maps import bend
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.samples.grids import grid, grid_faces, triangles_of

MADE = creature(1500)
SURFACE = MADE.surface
OWN = SurfaceMap.from_vertices(np.arange(1500), SURFACE)
UNIT = float(np.sqrt(SURFACE.area))


def displacements_of(places: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """(n, 3) displacements of the images of the identity map."""
    meshes = SURFACE.vertices, SURFACE.vertices, SURFACE.triangles
    return bend.bend(OWN, *meshes, places, moves, 0.1 * UNIT).interpolate(SURFACE.vertices) - SURFACE.vertices


def along_surface(places: np.ndarray, seed: int = 0) -> np.ndarray:
    """(l, 3) displacements to nearby vertices, like those of imprecisely placed landmarks."""
    near = np.linalg.norm(SURFACE.vertices[places][:, None] - SURFACE.vertices, axis=2).argsort(axis=1)
    other = near[np.arange(len(places)), np.random.default_rng(seed).integers(0, 5, len(places))]
    return SURFACE.vertices[other] - SURFACE.vertices[places]


@pytest.mark.parametrize("count", [1, 5, 100, 600])
def test_bent_map_interpolates_places_without_overshoot(count: int) -> None:
    places = np.random.default_rng(1).choice(1500, count, replace=False)
    moves = along_surface(places)
    moved = displacements_of(places, moves)
    assert np.linalg.norm(moved[places] - moves, axis=1).mean() < 1e-3 * UNIT
    most = np.linalg.norm(moves, axis=1).max()
    assert np.linalg.norm(moved, axis=1).max() < 1.5 * most + 1e-9


def test_block_size_does_not_change_results(monkeypatch: pytest.MonkeyPatch) -> None:
    places = np.arange(0, 1500, 20)
    moves = along_surface(places)
    whole = displacements_of(places, moves)
    monkeypatch.setattr(bend, "BLOCK", 10 * 1500)
    np.testing.assert_allclose(displacements_of(places, moves), whole, atol=1e-9)


def test_moved_images_do_not_jump_across_a_gap() -> None:
    """Two sheets that face each other, joined at one end: the displacement of a place leads from one to the other."""
    flat = grid(np.linspace(-1, 1, 41), np.linspace(0, 1, 21)).vertices
    faces = triangles_of(grid_faces(40, 20))
    side = np.sign(flat[:, 0])
    folded = np.column_stack([np.abs(flat[:, 0]), flat[:, 1], 0.01 * side])
    surface = SurfaceMap.from_vertices(np.arange(len(flat)), zo.Surface(folded, faces))
    place = np.flatnonzero(np.isclose(flat, [0.5, 0.5, 0]).all(axis=1))
    found = bend.bend(surface, folded, folded, faces, place, np.array([[0.1, 0, -0.03]]), 0.2)
    others = np.arange(len(flat)) != place
    moved = found.interpolate(folded)[others]
    before, clear = folded[others], np.abs(flat[others, 0]) > 0.1
    assert (np.sign(moved[:, 2]) == np.sign(before[:, 2]))[clear].all()
    assert moved[:, 0].max() <= 1
    assert (moved - before)[:, 0].max() > 0.08
