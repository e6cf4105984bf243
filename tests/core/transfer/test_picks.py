# SPDX-License-Identifier: GPL-3.0-or-later
"""Picks give the transferred values, and follow edits of the source's values as another transfer would."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from transfer_meshes import globe, nearest_map

from zoomout_core.transfer import Attribute, Domain, Kind, map_target, transfer_along
from zoomout_core.transfer.live_link import are_mixed, pick
from zoomout_core.transfer.mapped_target import MappedTarget

SOURCE, UV = globe(24, 16)
# Rotated, so that faces cross the seam.
ANGLE = 0.13
ROTATION = np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1]])
TARGET = globe(31, 21)[0].with_vertices(globe(31, 21)[0].vertices @ ROTATION.T)
MAPPED = map_target(nearest_map(TARGET.vertices, SOURCE), SOURCE, TARGET)
RANDOM = np.random.default_rng(0)
COUNT = {
    Domain.POINT: len(SOURCE.vertices),
    Domain.CORNER: len(SOURCE.corner_vertex),
    Domain.FACE: len(SOURCE.face_start) - 1,
}
HEMISPHERE = (SOURCE.vertices[:, 0] > 0.1).astype(np.int64)
OF_FACE = HEMISPHERE[SOURCE.corner_vertex[SOURCE.face_start[:-1]]]


def find_mixtures(attribute: Attribute, mapped: MappedTarget = MAPPED) -> np.ndarray:
    picks = pick(attribute, mapped)
    assert picks is not None
    return are_mixed(picks, attribute, transfer_along(attribute, mapped))


@pytest.mark.parametrize(
    "attribute",
    [
        Attribute("height", Domain.POINT, Kind.SCALAR, RANDOM.random(COUNT[Domain.POINT])),
        Attribute("vector", Domain.POINT, Kind.VECTOR, RANDOM.random((COUNT[Domain.POINT], 3))),
        Attribute("smooth", Domain.CORNER, Kind.COLOR, RANDOM.random((COUNT[Domain.POINT], 4))[SOURCE.corner_vertex]),
        Attribute("hard", Domain.CORNER, Kind.COLOR, np.repeat(RANDOM.random((4, 4)), COUNT[Domain.CORNER], 0)[::4]),
        Attribute("faces", Domain.CORNER, Kind.SCALAR, RANDOM.random(COUNT[Domain.FACE])[SOURCE.corner_face]),
        Attribute("UVMap", Domain.CORNER, Kind.UV, UV / 2 + 0.2),
        Attribute("half", Domain.POINT, Kind.LABEL, HEMISPHERE),
        Attribute("half", Domain.CORNER, Kind.BOOLEAN, OF_FACE[SOURCE.corner_face] > 0),
        Attribute("half", Domain.FACE, Kind.LABEL, OF_FACE.astype(str)),
    ],
    ids=lambda attribute: f"{attribute.domain.name}-{attribute.kind.name}-{attribute.name}",
)
def test_picks_read_the_transferred_values(attribute: Attribute) -> None:
    assert find_mixtures(attribute).all()


def test_uv_picks_stay_on_their_side_of_the_seam_when_islands_move() -> None:
    """After the UVs are rotated and moved, picks agree with another transfer, beyond the seam as well."""
    atlas = Attribute("UVMap", Domain.CORNER, Kind.UV, UV / 2 + 0.2)
    picks = pick(atlas, MAPPED)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = replace(atlas, values=UV @ turn.T * 0.3 + 0.4)
    assert picks is not None
    assert (picks.weights < -1e-6).any(axis=1).sum() > 10  # continued beyond the seam
    np.testing.assert_allclose(picks.mix(moved.values), transfer_along(moved, MAPPED).values, atol=1e-9)


def test_filled_in_values_are_not_mixtures() -> None:
    doubtful = np.arange(len(TARGET.vertices)) < 40
    filled = replace(MAPPED, confidence=np.where(doubtful, 0.0, 1.0), fill_below=0.5)
    height = Attribute("height", Domain.POINT, Kind.SCALAR, RANDOM.random(COUNT[Domain.POINT]))
    np.testing.assert_array_equal(find_mixtures(height, filled), ~doubtful)


def test_kinds_with_other_rules_have_no_picks() -> None:
    normals = Attribute("normals", Domain.POINT, Kind.NORMAL, SOURCE.vertices)
    assert pick(normals, MAPPED) is None
    assert pick(Attribute("mean", Domain.FACE, Kind.SCALAR, OF_FACE.astype(float)), MAPPED) is None


def test_uvs_clipped_at_a_tile_are_not_mixtures() -> None:
    found = find_mixtures(Attribute("UVMap", Domain.CORNER, Kind.UV, UV))
    assert 0.9 < found.mean() < 1


def test_picks_of_a_corner_with_an_unknown_uv_are_not_mixtures() -> None:
    values = UV / 2 + 0.2
    values[100] = np.nan
    mixed = find_mixtures(Attribute("UVMap", Domain.CORNER, Kind.UV, values))
    assert 0.9 < mixed.mean() < 1
