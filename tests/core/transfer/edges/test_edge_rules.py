# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of edge lines: gaps, tears and trust, on flat grids with known lines."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_edges import shape_of
from transfer_meshes import nearest_map, plate

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain, Kind
from zoomout_core.transfer.edges.line_paths import _beside
from zoomout_core.transfer.edges.polylines import polylines_of, runs, sample
from zoomout_core.transfer.edges.transfer_edges import snap_marks, transfer_edges
from zoomout_core.transfer.mapped_target import MappedTarget

SIZE = 20


def band(columns: int = SIZE) -> Surface:
    """Eight rows of squares."""
    return plate(columns, 8, width=columns / SIZE, height=8 / SIZE)


def on_row(surface: Surface, first: float = 0.0, last: float = 9.0, height: float = 0.2) -> np.ndarray:
    """(e,) mask of the edges at a height, between two x coordinates."""
    x, y = surface.vertices[surface.edges][:, :, :2].transpose(2, 0, 1)
    inside = (np.abs(y - height) < 1e-9) & (x > first - 1e-9) & (x < last + 1e-9)
    return np.asarray(inside.all(axis=1))


def transfer_line(
    marked: np.ndarray,
    source: Surface,
    target: Surface,
    surface_map: SurfaceMap | None = None,
    confidence: np.ndarray | float = 1.0,
) -> Attribute:
    surface_map = surface_map or nearest_map(target.vertices, source)
    mapped = MappedTarget(source, target, surface_map, np.broadcast_to(confidence, len(target.vertices)))
    kind = Kind.BOOLEAN if marked.dtype == bool else Kind.SCALAR
    return transfer_edges(Attribute("line", Domain.EDGE, kind, marked), mapped)


def share_left_out(result: Attribute) -> float:
    """The share of the length that the notes report as left out."""
    return float(result.notes[0].split("line: ")[1].split("%")[0]) / 100 if result.notes else 0.0


@pytest.mark.parametrize(("width", "bridged"), [(1, True), (3, True), (7, False), (12, False)])
def test_lines_bridge_short_gaps_of_the_match_but_not_long_ones(width: int, bridged: bool) -> None:
    mesh = band()
    gone = np.abs(mesh.vertices[:, 0] - 0.5) < (width / 2 + 0.01) / SIZE
    result = transfer_line(on_row(mesh), mesh, mesh, confidence=np.where(gone, 0.0, 1.0))
    assert shape_of(mesh, result.values)[0] == (1 if bridged else 2)
    assert share_left_out(result) == pytest.approx(0 if bridged else width / SIZE, abs=1 / SIZE)


def test_short_pieces_between_gaps_are_left_out() -> None:
    mesh = band(60)
    x = mesh.vertices[:, 0]
    gone = (np.abs(x - 1.5) < 0.4) & (np.abs(x - 1.5) > 0.03)
    result = transfer_line(on_row(mesh), mesh, mesh, confidence=np.where(gone, 0.0, 1.0))
    assert shape_of(mesh, result.values)[0] == 2
    gone = (np.abs(x - 1.5) < 0.9) & (np.abs(x - 1.5) > 0.4)
    result = transfer_line(on_row(mesh), mesh, mesh, confidence=np.where(gone, 0.0, 1.0))
    assert shape_of(mesh, result.values)[0] == 3


@pytest.mark.parametrize(("confidence", "drawn"), [(1.0, True), (0.1, True), (0.01, False), (0.0, False)])
def test_lines_need_a_minimum_confidence(confidence: float, drawn: bool) -> None:
    mesh = band()
    for marked in (on_row(mesh), on_row(mesh).astype(float)):
        result = transfer_line(marked, mesh, mesh, confidence=confidence)
        np.testing.assert_array_equal(result.values != 0, (marked != 0) & drawn)
        assert share_left_out(result) == (0 if drawn else 1)


@pytest.mark.parametrize(("confidence", "kept"), [(0.1, True), (0.01, False)])
def test_vertex_marks_need_a_minimum_confidence(confidence: float, kept: bool) -> None:
    mesh = band()
    marks = np.where(np.arange(len(mesh.vertices)) % 50 == 7, 0.5, 0)
    mapped = MappedTarget(mesh, mesh, nearest_map(mesh.vertices, mesh), np.full(len(mesh.vertices), confidence))
    result = snap_marks(Attribute("crease", Domain.POINT, Kind.MARK, marks), mapped)
    np.testing.assert_array_equal(result.values, marks * kept)
    assert len(result.notes) == (0 if kept else 1)


def test_line_ends_at_the_border_of_the_target() -> None:
    source, target = plate(2 * SIZE, 16, height=0.4), band(12)
    result = transfer_line(on_row(source), source, target)
    np.testing.assert_array_equal(result.values, on_row(target))
    assert 0.4 - 3 / SIZE < share_left_out(result) < 0.4 - 1 / SIZE


def test_line_that_ends_near_a_border_is_not_extended_to_it() -> None:
    mesh = band()
    for first, last in ((0.05, 0.95), (0.0, 0.95), (0.05, 0.5)):
        marked = on_row(mesh, first, last)
        np.testing.assert_array_equal(transfer_line(marked, mesh, mesh).values, marked)


def test_filled_area_at_the_last_faces_is_kept() -> None:
    # All edges up to the mesh's last face are marked.
    mesh = band()
    middle = mesh.vertices[mesh.edges].mean(axis=1)
    filled = (middle[:, 0] > 0.69) & (middle[:, 1] > 0.19)
    np.testing.assert_array_equal(transfer_line(filled, mesh, mesh).values, filled)


def slit(depth: int) -> tuple[Surface, np.ndarray]:
    """A grid slit from its lower border, with its lips apart in height, and (n, 3) its vertices before the slit."""
    whole = plate(SIZE, SIZE)
    at, below = whole.vertices[:, 0], whole.vertices[:, 1] < (depth - 0.5) / SIZE
    lip = np.flatnonzero((np.abs(at - 0.5) < 1e-9) & below)
    other = np.arange(len(at))
    other[lip] = len(at) + np.arange(len(lip))
    middles = whole.vertices[whole.corner_vertex].reshape(-1, 4, 3).mean(axis=1)
    faces = whole.corner_vertex.reshape(-1, 4)
    faces = np.where((middles[:, :1] > 0.5), other[faces], faces)
    places = np.concatenate([whole.vertices, whole.vertices[lip]])
    return Surface(places + (np.arange(len(places)) >= len(at))[:, None] * [0, 0, 0.01], faces), places


@pytest.mark.parametrize("depth", [3, 6])
def test_line_goes_around_a_tear(depth: int) -> None:
    source = plate(SIZE, SIZE)
    target, places = slit(depth)
    result = transfer_line(on_row(source, height=0), source, target, nearest_map(places, source))
    assert shape_of(target, result.values) == (1, 0, 2)
    assert result.values.sum() == SIZE + 2 * depth
    assert result.notes == ()


@pytest.mark.parametrize(("length", "depth", "around"), [(2, 7, False), (10, 7, True), (2, 3, True)])
def test_short_line_takes_no_long_detour_around_a_tear(length: int, depth: int, around: bool) -> None:
    source = plate(SIZE, SIZE)
    target, places = slit(depth)
    half = length / 2 / SIZE
    marked = on_row(source, 0.5 - half, 0.5 + half, height=0)
    result = transfer_line(marked, source, target, nearest_map(places, source))
    assert result.values.any() == around
    assert share_left_out(result) == (0 if around else 1)


def test_tear_too_deep_to_go_around_is_reported() -> None:
    source = plate(SIZE, SIZE)
    target, places = slit(15)
    result = transfer_line(on_row(source, height=0), source, target, nearest_map(places, source))
    assert not result.values.any()
    assert share_left_out(result) == 1
    assert "the map is discontinuous" in result.notes[0]


def diagonal(surface: Surface) -> np.ndarray:
    """(n,) distance of vertices from the diagonal."""
    return np.abs(surface.vertices[:, 0] - surface.vertices[:, 1]) / np.sqrt(2)


def test_path_closest_to_the_line_is_chosen_among_equal_lengths() -> None:
    squares = plate(SIZE, SIZE)
    source = Surface(squares.vertices, squares.triangles)
    if not (diagonal(source)[source.edges] < 1e-9).all(axis=1).any():
        source = Surface(squares.vertices, np.roll(squares.corner_vertex.reshape(-1, 4), 1, axis=1)[:, [0, 1, 2]])
    marked = (diagonal(source)[source.edges] < 1e-9).all(axis=1)
    assert marked.sum() == SIZE
    result = transfer_line(marked, source, squares)
    assert shape_of(squares, result.values) == (1, 0, 2)
    assert result.values.sum() == 2 * SIZE
    assert diagonal(squares)[squares.edges[result.values]].max() < 0.8 / SIZE


def test_junctions_are_kept_without_spurs() -> None:
    source, target = plate(SIZE, SIZE), plate(17, 13, jitter=0.2)
    across = np.abs(source.vertices[source.edges][:, :, 0] - 0.5).max(axis=1) < 1e-9
    result = transfer_line(on_row(source, height=0.5) | across, source, target)
    assert shape_of(target, result.values) == (1, 0, 4)
    half = across & (source.vertices[source.edges][:, :, 1].max(axis=1) < 0.5 + 1e-9)
    result = transfer_line(on_row(source, height=0.5) | half, source, target)
    assert shape_of(target, result.values) == (1, 0, 3)


@pytest.mark.parametrize("cells", [2, 3, 10])
def test_closed_lines_of_any_size_stay_closed(cells: int) -> None:
    source, target = plate(SIZE, SIZE), plate(SIZE, SIZE, jitter=0.2)
    ends = source.vertices[source.edges][:, :, :2] * SIZE
    low, high = 5 - 1e-9, 5 + cells + 1e-9
    inside = ((ends > low) & (ends < high)).all(axis=(1, 2))
    rim = (np.abs(ends - 5) < 1e-9).all(axis=1).any(axis=1) | (np.abs(ends - 5 - cells) < 1e-9).all(axis=1).any(axis=1)
    result = transfer_line(inside & rim, source, target)
    assert shape_of(target, result.values) == (1, 1, 0)
    assert result.values.sum() == 4 * cells


# --- chains and their samples -------------------------------------------------------------------------------


def test_polylines_run_in_order_between_junctions() -> None:
    # A fork: 0-1-2, 2-3-4 and 2-5 meet at 2; the triangle 7-8-9 is separate.
    edges = np.array([[1, 0], [2, 1], [2, 3], [4, 3], [5, 2], [8, 7], [8, 9], [7, 9]])
    chains = polylines_of(edges)
    assert sorted(chains.edge.tolist()) == list(range(len(edges)))
    found = set()
    for number in np.unique(chains.chain):
        begin, end = chains.begin[chains.chain == number], chains.end[chains.chain == number]
        assert (begin[1:] == end[:-1]).all()
        way = (*begin.tolist(), int(end[-1]))
        found.add(min(way, way[::-1]) if way[0] != way[-1] else frozenset(way))
        for edge, a, b in zip(chains.edge[chains.chain == number], begin, end, strict=True):
            assert {a, b} == set(edges[edge].tolist())
    assert found == {(0, 1, 2), (2, 3, 4), (2, 5), frozenset({7, 8, 9})}


def test_samples_include_all_vertices_and_keep_the_spacing() -> None:
    edges = np.array([[0, 1], [1, 2], [3, 4]])
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 2.5, 0], [9, 0, 0], [9, 0, 0.2]])
    chains = polylines_of(edges)
    samples = sample(chains, vertices, 0.4)
    for number, ends in ((samples.chain[0], 3.5), (samples.chain[-1], 0.2)):
        of = samples.chain == number
        along, point = samples.along[of], samples.point[of]
        assert (along[0], along[-1]) == pytest.approx((0, ends))
        step = np.diff(along)
        assert step.min() > 0
        assert step.max() <= 0.4
        np.testing.assert_allclose(np.linalg.norm(np.diff(point, axis=0), axis=1), step, atol=1e-12)
    at = samples.vertex >= 0
    assert sorted(samples.vertex[at].tolist()) == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(samples.point[at], vertices[samples.vertex[at]])
    a, b = vertices[edges[samples.edge]].transpose(1, 0, 2)
    np.testing.assert_allclose(
        np.linalg.norm(samples.point - a, axis=1) + np.linalg.norm(samples.point - b, axis=1),
        np.linalg.norm(b - a, axis=1),
    )


@pytest.mark.parametrize("spacing", [1.0, 0.4])
def test_points_are_projected_onto_their_own_line(spacing: float) -> None:
    # Two crossing lines far from the origin; beside each, a point that is nearer to the other line.
    at = np.arange(0, 10, spacing)
    lines = np.stack([at - 5, 0 * at, 0 * at], axis=1), np.stack([0 * at, at - 5, 0 * at], axis=1)
    samples: Any = SimpleNamespace(point=np.concatenate(lines) + 100, along=np.concatenate([at, at]))
    index = np.arange(2 * len(at))
    piece = np.repeat([0, 1], len(at))
    points = np.array([[1.7, 0.3, 0], [-2.9, 0.2, 0.1], [0.1, 1.3, 0], [0.4, -3.75, 0], [-7.0, 0, 0]]) + 100
    owner = np.array([0, 0, 0, 1, 0])
    nearest, along, stray = _beside(owner, points, piece, index, samples)
    np.testing.assert_array_equal(piece[nearest], owner)
    np.testing.assert_allclose(along, [6.7, 2.1, 5.1, 1.25, 0], atol=1e-9)
    np.testing.assert_allclose(stray, [0.3, np.hypot(0.2, 0.1), 1.3, 0.4, 2.0], atol=1e-9)


def test_runs_end_where_the_chain_or_the_state_does() -> None:
    chain = np.array([0, 0, 0, 0, 1, 1, 2])
    state = np.array([True, True, False, False, False, True, True])
    run, first, last = runs(chain, state)
    assert run.tolist() == [0, 0, 1, 1, 2, 3, 4]
    assert first.tolist() == [0, 2, 4, 5, 6]
    assert last.tolist() == [1, 3, 4, 5, 6]
