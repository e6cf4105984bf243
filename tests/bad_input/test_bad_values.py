# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinates and attributes that are NaN, infinite or far too large are refused, or filled in and reported."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from creatures import creature
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.transfer.finite import places_of, with_finite_values

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


def values_of(kind: zo.Kind) -> Any:
    """Valid values of a kind at the vertices, all of one row."""
    rows = {zo.Kind.QUATERNION: [1.0, 0, 0, 0], zo.Kind.MATRIX: np.eye(4).ravel(), zo.Kind.WEIGHT: [0.25, 0.75]}
    if kind is zo.Kind.OFFSET:
        return np.tile([[0.0, 0, 0.1], [0, 0, 0.2]], (COUNT, 1, 1))
    if kind is zo.Kind.MARK:
        return np.ones(COUNT)
    return np.tile(rows[kind], (COUNT, 1))


@pytest.mark.parametrize("value", [np.nan, np.inf], ids=str)
@pytest.mark.parametrize(
    "kind",
    [zo.Kind.QUATERNION, zo.Kind.MATRIX, zo.Kind.MARK, zo.Kind.OFFSET, zo.Kind.WEIGHT],
    ids=lambda kind: kind.name,
)
def test_one_broken_value_of_any_kind_is_filled_in(kind: zo.Kind, value: float) -> None:
    right = values_of(kind)
    wrong = right.copy()
    wrong.reshape(COUNT, -1)[5, 0] = value
    given = csr_array(wrong) if kind is zo.Kind.WEIGHT else wrong
    moved = zo.transfer(zo.Attribute("it", zo.Domain.POINT, kind, given, ("a", "b")), IDENTITY, SOURCE, SOURCE)
    found = moved.values.toarray() if kind is zo.Kind.WEIGHT else moved.values
    np.testing.assert_allclose(found, right, atol=1e-6)
    assert " values of 'it' are not finite, and were replaced" in moved.notes[0]


def test_broken_offset_keeps_other_keys() -> None:
    offsets = np.random.default_rng(0).random((COUNT, 2, 3))
    offsets[7, 1, 2] = np.nan
    attribute = zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, offsets)
    filled = with_finite_values(attribute, SOURCE)
    np.testing.assert_array_equal(filled.values[:, 0], offsets[:, 0])
    assert any((filled.values[7, 1] == offsets[other, 1]).all() for other in range(COUNT) if other != 7)


@pytest.mark.parametrize(
    "kind", [zo.Kind.SCALAR, zo.Kind.COLOR, zo.Kind.DIRECTION, zo.Kind.NORMAL], ids=lambda k: k.name
)
def test_values_that_overflow_are_refused(kind: zo.Kind) -> None:
    values = np.full(COUNT if kind is zo.Kind.SCALAR else (COUNT, 3), 1e300)
    with pytest.raises(zo.MeshError, match=r"'it' has [0-9]+ values that are far too large: correct them"):
        zo.transfer(zo.Attribute("it", zo.Domain.POINT, kind, values), IDENTITY, SOURCE, SOURCE)


PADDED = zo.Surface(np.vstack([SOURCE.vertices, np.full((1, 3), np.nan)]), SOURCE.triangles)
# Computations along a match of the surface to itself.
ALONG: dict[str, Callable[[zo.MatchResult, zo.Surface], Any]] = {
    "wrap": lambda match, surface: zo.wrap(match, surface, surface).vertices,
    "conform": lambda match, surface: zo.conform(match, surface, surface),
    "move_rig": lambda match, surface: zo.move_rig(match, surface, surface, [[0, 0, 0]], [-1]).positions,
    "dress": lambda match, surface: zo.dress(match, surface, surface, [surface]).vertices[0],
    "follow_keys": lambda match, surface: zo.follow_keys(surface, np.ones((len(surface.vertices), 1, 3)), [surface])[0],
    "offsets": lambda match, surface: carried(match, surface, zo.Kind.OFFSET, (1, 3)),
    "normals": lambda match, surface: carried(match, surface, zo.Kind.NORMAL, (3,)),
}


def carried(match: zo.MatchResult, surface: zo.Surface, kind: zo.Kind, columns: tuple[int, ...]) -> Any:
    """Ones at the vertices of a surface, transferred to itself."""
    values = np.ones((len(surface.vertices), *columns))
    return zo.transfer(zo.Attribute("it", zo.Domain.POINT, kind, values), match, surface, surface).values


@pytest.mark.parametrize("name", ALONG)
def test_broken_vertex_of_no_face_does_not_disturb_a_transfer(name: str, known: zo.MatchResult) -> None:
    right = ALONG[name](known, SOURCE)
    found = ALONG[name](zo.match(PADDED, PADDED, **OPTIONS), PADDED)
    assert np.isfinite(found).all()
    # Clothes fit a little otherwise, because their vertices without faces take part in the fit.
    np.testing.assert_allclose(found[: len(right)], right, atol=0.005 if name == "dress" else 1e-6)
