# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinates and attributes that are NaN, infinite or far too large are refused, or filled in and reported."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.transfer.finite import places_of

SOURCE = creature(300).surface
COUNT = len(SOURCE.vertices)
IDENTITY = zo.SurfaceMap.from_vertices(np.arange(COUNT), SOURCE)
OPTIONS: dict[str, Any] = {"k_final": 20, "samples": 60, "initial": "proximity"}


@pytest.mark.parametrize("value", [3.4e38, 1e9, -1e20, 1e308, np.nan, np.inf], ids=str)
@pytest.mark.parametrize("role", ["source", "target"])
def test_distant_or_nan_vertex_of_a_face_is_named(value: float, role: str) -> None:
    vertices = SOURCE.vertices.copy()
    vertices[7, 1] = value
    pair = [(vertices, SOURCE.triangles), SOURCE]
    with pytest.raises(zo.MeshError, match=r"[Vv]ertex 7\b"):
        zo.match(*(pair if role == "source" else pair[::-1]), **OPTIONS)


@pytest.fixture(scope="module")
def known() -> zo.MatchResult:
    return zo.match(SOURCE, SOURCE, **OPTIONS)


@pytest.mark.parametrize("value", [3.4e38, 1e308, np.nan, np.inf], ids=str)
@pytest.mark.parametrize("role", ["source", "target"])
def test_a_vertex_of_no_face_may_be_anywhere(value: float, role: str, known: zo.MatchResult) -> None:
    padded = zo.Surface(np.vstack([SOURCE.vertices, np.full((1, 3), value)]), SOURCE.triangles)
    pair = [padded, SOURCE]
    result = zo.match(*(pair if role == "source" else pair[::-1]), **OPTIONS)
    np.testing.assert_array_equal(result.surface_map.vertex[:COUNT], known.surface_map.vertex)
    assert np.isfinite(result.surface_map.barycentric).all()


def test_distant_part_does_not_disturb_the_match_of_the_rest() -> None:
    far = zo.Surface(
        np.vstack([SOURCE.vertices, 1e9 + np.eye(3)]), np.vstack([SOURCE.triangles, [[COUNT, COUNT + 1, COUNT + 2]]])
    )
    for pair in (SOURCE, far), (far, SOURCE):
        result = zo.match(*pair, **OPTIONS)
        assert (result.surface_map.vertex[:COUNT] == np.arange(COUNT)).mean() > 0.95


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_shape_destroyed_by_rounding_is_refused(kind: type) -> None:
    distance = 1e16 if kind == np.float64 else 1e7
    far = (SOURCE.vertices + distance * np.array([1, 0.7, 0.3])).astype(kind)
    for pair in ((far, SOURCE.triangles), SOURCE), (SOURCE, zo.PointCloud(far)):
        with pytest.raises(zo.MeshError, match="rounded by more than an edge length: move it to the origin"):
            zo.match(*pair, **OPTIONS)


def test_shape_changed_by_rounding_is_matched_with_a_note() -> None:
    far = SOURCE.vertices + 4e14
    (note,) = (str(note) for note in zo.match(SOURCE, (far, SOURCE.triangles), **OPTIONS).notes if "rounded" in note)
    assert note.startswith("The target is so far from its origin that its coordinates are rounded by ")


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("distance", [0, 1e3, 1e5])
def test_shape_unchanged_by_rounding_has_no_note(kind: type, distance: float) -> None:
    surface = zo.Surface((SOURCE.vertices + distance).astype(kind), SOURCE.triangles)
    assert not any("rounded" in note for note in zo.match(SOURCE, surface, **OPTIONS).notes)


def test_the_integers_of_a_grid_far_away_are_exact() -> None:
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(81).reshape(9, 9)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    assert zo.Surface(grid + 2**23 - 20, quads).area == 64


@pytest.mark.parametrize("domain", list(zo.Domain), ids=lambda domain: domain.name.lower())
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf], ids=str)
def test_values_that_are_not_finite_are_filled_in_and_counted(domain: zo.Domain, value: float) -> None:
    places = places_of(domain, SOURCE)
    values = places[:, 2].copy()
    wrong = np.arange(0, len(values), 50)
    values[wrong] = value
    moved = zo.transfer(zo.Attribute("heat", domain, zo.Kind.SCALAR, values), IDENTITY, SOURCE, SOURCE)
    assert np.isfinite(moved.values).all()
    assert moved.notes[0].startswith(f"{len(wrong)} of {len(values):,} values of 'heat' are not finite")
    assert np.abs(moved.values - places[:, 2]).max() < 1.5
    assert np.abs(moved.values - places[:, 2]).mean() < 0.1


@pytest.mark.parametrize(
    ("kind", "columns"), [(zo.Kind.VECTOR, 5), (zo.Kind.COLOR, 4), (zo.Kind.DIRECTION, 3), (zo.Kind.NORMAL, 3)]
)
def test_rows_with_one_nan_are_filled_in_and_counted(kind: zo.Kind, columns: int) -> None:
    values = np.full((COUNT, columns), 0.25)
    values[11, 1] = np.nan
    moved = zo.transfer(zo.Attribute("rows", zo.Domain.POINT, kind, values), IDENTITY, SOURCE, SOURCE)
    assert np.isfinite(moved.values).all()
    assert moved.notes[0].startswith(f"1 of {COUNT} values of 'rows'")


def test_attribute_without_finite_values_is_refused() -> None:
    nothing = zo.Attribute("heat", zo.Domain.POINT, zo.Kind.SCALAR, np.full(COUNT, np.nan))
    with pytest.raises(zo.MeshError, match="'heat' has no finite values"):
        zo.transfer(nothing, IDENTITY, SOURCE, SOURCE)


def test_nan_quaternions_are_refused_with_their_count() -> None:
    quaternions = np.tile([1.0, 0, 0, 0], (COUNT, 1))
    quaternions[[3, 5]] = np.nan
    with pytest.raises(zo.MeshError, match="'turn' has 8 values that are not finite"):
        zo.transfer(zo.Attribute("turn", zo.Domain.POINT, zo.Kind.QUATERNION, quaternions), IDENTITY, SOURCE, SOURCE)
