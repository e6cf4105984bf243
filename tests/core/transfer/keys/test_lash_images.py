# SPDX-License-Identifier: GPL-3.0-or-later
"""Lashes are mapped by the skin beside them."""

from __future__ import annotations

from functools import cache

import numpy as np
from transfer_meshes import nearest_map

import zoomout_core as zo
from zoomout_core.samples.grids import grid, grid_faces, triangles_of
from zoomout_core.transfer.keys.lash_images import attach_lashes
from zoomout_core.transfer.mapped_target import MappedTarget

SKIN, STRIP = grid(np.linspace(0, 1, 21), np.linspace(0, 1, 21)), grid(np.linspace(0, 1, 21), np.linspace(0, 0.1, 3))
COUNT = len(SKIN.vertices)
PLACES = np.vstack([SKIN.vertices, STRIP.vertices + np.array([0, 0.5, 0.05])])
SOURCE = zo.Surface(PLACES, np.vstack([triangles_of(grid_faces(20, 20)), COUNT + triangles_of(grid_faces(20, 2))]))
BLINKS = np.arange(len(PLACES)) >= COUNT


def slid_map(turn: np.ndarray) -> MappedTarget:
    """A turned copy, whose lashes are mapped off along themselves."""
    off = np.where(BLINKS[:, None], (0.08, 0, 0), 0)
    target = SOURCE.with_vertices(PLACES @ turn.T)
    return MappedTarget(SOURCE, target, nearest_map(PLACES + off, SOURCE), np.ones(len(PLACES)))


def test_lashes_that_slid_are_moved_back() -> None:
    quarter = 2.0 * np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for turn in (np.eye(3), quarter):
        mapped = slid_map(turn)
        assert np.abs(mapped.points - PLACES)[BLINKS].max() > 0.07
        found = attach_lashes(BLINKS[SOURCE.working.vertex_of], 0, mapped)
        np.testing.assert_allclose(found.points, PLACES, atol=1e-9)


def test_parts_that_blinks_leave_keep_their_map() -> None:
    mapped = slid_map(np.eye(3))
    assert attach_lashes(np.zeros(len(PLACES), dtype=bool), 0, mapped) is mapped


def test_lashes_without_a_skin_keep_their_map() -> None:
    mapped = slid_map(np.eye(3))
    on_lashes = nearest_map(PLACES[BLINKS][np.zeros(len(PLACES), dtype=int)], SOURCE)
    alone = MappedTarget(SOURCE, mapped.target, on_lashes, mapped.confidence)
    assert attach_lashes(BLINKS[SOURCE.working.vertex_of], 0, alone) is alone


@cache
def lashes_of_both_lids(is_welded: bool) -> tuple[np.ndarray, np.ndarray]:
    """Which vertices of the source, and images of slid lashes, are on the lower lid, of those of both lids (p,).

    The lower lashes approach the upper ones at both ends, and share a corner. In the target it may be welded, which
    makes them one piece.
    """
    across = 2 * np.abs(STRIP.vertices[:, 0] - 0.5)
    upper = STRIP.vertices + np.array([0, 0.5, 0.05])
    lower = STRIP.vertices * (1, -1, 1) + np.column_stack([0 * across, 0.3 + 0.18 * across, 0.05 + 0 * across])
    shared, count = np.flatnonzero(STRIP.vertices[:, 0] == 0), len(STRIP.vertices)
    lower[shared] = upper[shared]
    strip = COUNT + triangles_of(grid_faces(20, 2))
    triangles = np.vstack([triangles_of(grid_faces(20, 20)), strip, strip + count])
    places = np.vstack([SKIN.vertices, upper, lower])
    source, is_lash = zo.Surface(places, triangles), np.arange(len(places)) >= COUNT
    number = np.arange(len(places))
    if is_welded:
        number[COUNT + count + shared] = COUNT + shared
    target = zo.Surface(places - np.where(is_lash[:, None], (0, 0.02, 0), 0), number[triangles])
    mapped = MappedTarget(source, target, nearest_map(target.vertices, source), np.ones(len(places)))
    working = source.working
    closing = np.isin(np.arange(len(working.vertices)), working.vertex_of[is_lash])
    found = attach_lashes(closing, int(working.component[working.vertex_of[0]]), mapped).surface_map
    is_lower = np.arange(len(places)) >= COUNT + count
    return is_lower[is_lash], is_lower[source.triangles[found.triangle, 0]][is_lash]


def test_lashes_of_one_lid_stay_together_where_those_of_the_other_are_nearer() -> None:
    is_lower, found = lashes_of_both_lids(is_welded=False)
    np.testing.assert_array_equal(found, is_lower)


def test_lashes_of_both_lids_in_one_piece_are_not_mapped_to_one_lid() -> None:
    is_lower, found = lashes_of_both_lids(is_welded=True)
    assert (found == is_lower).mean() > 0.8
