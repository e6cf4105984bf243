# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge lines transfer as connected lines of the same length in the right place."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from creatures import Creature, creature
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree
from transfer_meshes import identity, sheet, split_at_faces, torus, true_map, tube

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths
from zoomout_core.transfer import Attribute, Domain, Kind, transfer

BEND = 0.6
TIPS = [[1, 0.1, 0.35], [-1, 0.1, 0.35], [0.45, 0, -1], [-0.45, 0, -1], [0, 0.05, 1], [0, 1, -0.25]]


@dataclass(frozen=True)
class Match:
    surface_map: SurfaceMap
    confidence: np.ndarray
    has_partner: None = None


def map_of(source: Creature, target: Creature) -> SurfaceMap:
    triangles = source.surface.triangles
    return SurfaceMap(*closest_points(target.directions, source.directions, triangles), triangles)


def route(surface: Surface, places: list[int]) -> list[int]:
    """Vertices of the shortest edge paths between successive places."""
    ends = surface.edges
    lengths = edge_lengths(surface.vertices, ends)
    graph = csr_array((lengths, (ends[:, 0], ends[:, 1])), shape=(len(surface.vertices),) * 2)
    way = [places[0]]
    for begin, end in pairwise(places):
        _, before = dijkstra(graph, directed=False, indices=end, return_predecessors=True)
        assert way[-1] == begin
        while way[-1] != end:
            way.append(int(before[way[-1]]))
    return way


def marks(surface: Surface, ways: list[list[int]]) -> np.ndarray:
    steps = np.sort(np.concatenate([np.stack([way[:-1], way[1:]], axis=1) for way in ways]), axis=1)
    count = len(surface.vertices)
    return np.isin(np.sort(surface.edges, axis=1) @ [count, 1], steps @ [count, 1])


def nearest(made: Creature, direction: np.ndarray) -> int:
    return int(np.argmax(made.directions @ (direction / np.linalg.norm(direction))))


def ring(made: Creature, axis: list[float], cosine: float) -> list[int]:
    """A closed edge path around an axis."""
    along = np.array(axis) / np.linalg.norm(axis)
    across = np.cross(along, [0.3, 0.5, 0.7])
    across /= np.linalg.norm(across)
    angles = np.linspace(0, 2 * np.pi, 9)[:, None]
    circle = np.cos(angles) * across + np.sin(angles) * np.cross(along, across)
    stations = [nearest(made, cosine * along + np.sqrt(1 - cosine**2) * place) for place in circle]
    return route(made.surface, stations)


def seams(made: Creature) -> np.ndarray:
    """Lines from a hand to a foot and the other hand, up the other leg, around neck and tail, and a separate line."""
    tips = [nearest(made, np.array(tip)) for tip in TIPS]
    ways = [
        *(route(made.surface, [tips[a], tips[b]]) for a, b in ((0, 2), (0, 1), (3, 4))),
        ring(made, TIPS[4], 0.93),
        ring(made, TIPS[5], 0.97),
        route(made.surface, [nearest(made, np.array(place)) for place in ([0.0, 1, 0.6], [0.5, 0.8, 0.3])]),
    ]
    return marks(made.surface, ways)


def shape_of(surface: Surface, marked: np.ndarray) -> tuple[int, int, int]:
    """Numbers of connected parts, loops and loose ends of marked edges."""
    vertices, number = np.unique(surface.edges[marked], return_inverse=True)
    number = number.reshape(-1, 2)
    graph = coo_array((np.ones(len(number)), tuple(number.T)), shape=(len(vertices),) * 2)
    parts = connected_components(graph, directed=False)[0]
    return parts, len(number) - len(vertices) + parts, int((np.bincount(number.ravel()) == 1).sum())


def points_on(vertices: np.ndarray, ends: np.ndarray, spacing: float) -> np.ndarray:
    a, b = vertices[ends[:, 0]], vertices[ends[:, 1]]
    parts = int(np.ceil(edge_lengths(vertices, ends).max() / spacing)) + 1
    share = np.linspace(0, 1, parts)[:, None, None]
    return (a * (1 - share) + b * share).reshape(-1, 3)


@dataclass(frozen=True)
class Figures:
    """Errors of transferred lines: length ratio, and distances in mean edge lengths of the target."""

    ratio: float
    mean: float
    hausdorff: float


def figures(truth: np.ndarray, lines: np.ndarray, target: Surface, marked: np.ndarray) -> Figures:
    """Compare marked edges with true lines, edges (k, 2) between points (n, 3)."""
    edge = edge_lengths(target.vertices, target.edges).mean()
    drawn = target.edges[marked]
    true_points, points = points_on(truth, lines, edge / 8), points_on(target.vertices, drawn, edge / 8)
    there, back = cKDTree(true_points).query(points)[0], cKDTree(points).query(true_points)[0]
    length = edge_lengths(target.vertices, drawn).sum() / edge_lengths(truth, lines).sum()
    return Figures(float(length), float(there.mean() / edge), float(max(there.max(), back.max()) / edge))


def transfer_line(values: np.ndarray, match: Match | SurfaceMap, source: Surface, target: Surface) -> Attribute:
    kind = {"b": Kind.BOOLEAN, "f": Kind.SCALAR}.get(values.dtype.kind, Kind.LABEL)
    return transfer(Attribute("line", Domain.EDGE, kind, values), match, source, target)


@pytest.mark.parametrize(("source_count", "target_count"), [(4000, 4000), (8000, 1500), (2500, 12000)])
def test_lines_stay_connected_and_in_place_in_another_pose(source_count: int, target_count: int) -> None:
    source, target = creature(source_count), creature(target_count, seed=5, bend=BEND)
    marked = seams(source)
    result = transfer_line(marked, map_of(source, target), source.surface, target.surface)
    assert result.notes == ()
    assert shape_of(target.surface, result.values) == shape_of(source.surface, marked)
    posed = creature(source_count, bend=BEND).surface.vertices
    found = figures(posed, source.surface.edges[marked], target.surface, result.values)
    assert 0.97 < found.ratio < 1.1
    assert found.mean < 0.35
    assert found.hausdorff < 4  # edges at the tips of limbs are several times longer than elsewhere


def test_traced_lines_are_connected_unlike_nearest_edges() -> None:
    source, target = creature(4000), creature(4000, seed=5, bend=BEND)
    marked = seams(source)
    surface_map = map_of(source, target)
    laid = surface_map.interpolate(source.surface.vertices)
    middles = source.surface.vertices[source.surface.edges].mean(axis=1)
    _, edge = cKDTree(middles).query(laid[target.surface.edges].mean(axis=1))
    parts, loops, ends = shape_of(source.surface, marked)
    dashes = shape_of(target.surface, marked[edge])
    assert dashes[0] > 20 * parts
    assert dashes[2] > 20 * ends
    traced = transfer_line(marked, surface_map, source.surface, target.surface).values
    assert shape_of(target.surface, traced) == (parts, loops, ends)


def test_map_errors_of_an_edge_length_do_not_break_lines() -> None:
    source, target = creature(4000), creature(4000, seed=5, bend=BEND)
    shaken = target.directions + np.random.default_rng(0).normal(scale=0.012, size=target.directions.shape)
    triangles = source.surface.triangles
    surface_map = SurfaceMap(*closest_points(shaken, source.directions, triangles), triangles)
    marked = seams(source)
    result = transfer_line(marked, surface_map, source.surface, target.surface)
    assert shape_of(target.surface, result.values) == shape_of(source.surface, marked)
    posed = creature(4000, bend=BEND).surface.vertices
    found = figures(posed, source.surface.edges[marked], target.surface, result.values)
    assert 0.97 < found.ratio < 1.25
    assert found.mean < 0.6


def test_the_identity_keeps_every_line() -> None:
    source = creature(4000)
    marked = seams(source)
    same = transfer_line(marked, identity(source.surface), source.surface, source.surface)
    assert (same.values == marked).all()


def test_split_edges_count_once_and_are_marked_on_both_sides() -> None:
    source = creature(1500)
    marked = seams(source)
    torn, vertex = split_at_faces(source.surface)
    count = len(source.surface.vertices)
    known = np.sort(source.surface.edges, axis=1) @ [count, 1]
    torn_marked = marked[np.searchsorted(known, np.sort(vertex[torn.edges], axis=1) @ [count, 1])]
    onto_torn = SurfaceMap.from_vertices(vertex, source.surface)
    assert (transfer_line(marked, onto_torn, source.surface, torn).values == torn_marked).all()
    first = np.unique(vertex, return_index=True)[1]
    from_torn = SurfaceMap.from_vertices(first, torn)
    assert (transfer_line(torn_marked, from_torn, torn, source.surface).values == marked).all()


def test_values_are_interpolated_along_the_line() -> None:
    source, target = sheet(torus, 120, 80), sheet(torus, 97, 61, jitter=0.2, sides=3, seed=1)
    surface_map = true_map(source, 120, 80, target.parameters)
    ends = source.parameters[source.surface.edges]
    middle = ends[:, 0] + ((ends[:, 1] - ends[:, 0] + 0.5) % 1 - 0.5) / 2
    ring_edges = (np.ptp(ends[:, :, 1], axis=1) == 0) & (ends[:, 0, 1] == 0.25)
    crease = np.where(ring_edges, 0.5 + 0.4 * np.cos(2 * np.pi * middle[:, 0]), 0).astype(np.float32)
    result = transfer_line(crease, surface_map, source.surface, target.surface)
    assert result.values.dtype == np.float32
    on = result.values > 0
    assert shape_of(target.surface, on) == (1, 1, 0)
    places = target.parameters[target.surface.edges[on]]
    places = places[:, 0] + ((places[:, 1] - places[:, 0] + 0.5) % 1 - 0.5) / 2
    assert np.abs(result.values[on] - 0.5 - 0.4 * np.cos(2 * np.pi * places[:, 0])).max() < 0.08

    name = np.where(ring_edges, np.where(middle[:, 0] % 1 < 0.5, "inner", "outer"), "")
    result = transfer_line(name, surface_map, source.surface, target.surface)
    assert ((result.values != "") == on).all()
    clear = np.abs(places[:, 0] % 0.5 - 0.25) < 0.22
    assert (result.values[on][clear] == np.where(places[:, 0] % 1 < 0.5, "inner", "outer")[clear]).all()


def test_lines_end_at_missing_parts_and_the_loss_is_reported() -> None:
    source, target = creature(4000), creature(4000, seed=5, without=1)
    marked = seams(source)
    surface_map = map_of(source, target)
    without = creature(4000, without=1).surface.vertices
    gone = np.linalg.norm(without - source.surface.vertices, axis=1) > 0.3
    there = np.linalg.norm(creature(4000, seed=5).surface.vertices - target.surface.vertices, axis=1) > 0.3
    match = Match(surface_map, np.where(there, 0.0, 1.0))
    result = transfer_line(marked, match, source.surface, target.surface)
    (note,) = result.notes
    missing = edge_lengths(
        source.surface.vertices, source.surface.edges[marked & gone[source.surface.edges].all(axis=1)]
    )
    total = edge_lengths(source.surface.vertices, source.surface.edges[marked])
    assert float(note.split("line: ")[1].split("%")[0]) / 100 == pytest.approx(missing.sum() / total.sum(), abs=0.03)
    assert not (result.values & there[target.surface.edges].all(axis=1)).any()
    assert shape_of(target.surface, result.values) == shape_of(
        source.surface, marked & ~gone[source.surface.edges].any(axis=1)
    )


def test_hairpin_lines_are_not_short_cut() -> None:
    # A hairpin, 3 target edges wide and 40 long.
    source, target = sheet(torus, 240, 160), sheet(torus, 120, 80, jitter=0.2, sides=3, seed=2)
    surface_map = true_map(source, 240, 160, target.parameters)
    number = np.arange(240 * 160).reshape(240, 160)
    way = [*number[40:121, 50], *number[120, 51:56], *number[40:121, 56][::-1]]
    marked = marks(source.surface, [way])
    result = transfer_line(marked, surface_map, source.surface, target.surface)
    assert shape_of(target.surface, result.values) == (1, 0, 2)
    found = figures(source.surface.vertices, source.surface.edges[marked], target.surface, result.values)
    assert found.hausdorff < 1
    assert 0.97 < found.ratio < 1.2


def test_marks_of_a_coarse_source_are_lines_and_of_a_fine_one_a_field() -> None:
    coarse, fine = sheet(torus, 24, 16), sheet(torus, 120, 80, sides=3)
    onto_coarse = true_map(coarse, 24, 16, fine.parameters)
    everywhere = np.ones(len(coarse.surface.edges), dtype=bool)
    result = transfer_line(everywhere, onto_coarse, coarse.surface, fine.surface)
    on_lines = np.isclose((fine.parameters * [24, 16]) % 1, 0, atol=1e-6) | np.isclose(
        (fine.parameters * [24, 16]) % 1, 1, atol=1e-6
    )
    along = on_lines[fine.surface.edges].all(axis=1).any(axis=1)
    assert (result.values <= along).all()
    assert result.values.sum() == 2 * 24 * 16 * 5

    source = sheet(torus, 120, 80)
    onto_source = true_map(source, 120, 80, fine.parameters)
    everywhere = np.ones(len(source.surface.edges), dtype=bool)
    assert transfer_line(everywhere, onto_source, source.surface, fine.surface).values.all()
    height = source.surface.vertices[source.surface.edges].mean(axis=1)[:, 2]
    mixed = transfer_line(height, onto_source, source.surface, fine.surface).values
    assert np.abs(mixed - fine.surface.vertices[fine.surface.edges].mean(axis=1)[:, 2]).max() < 0.02
    number = 1 + (source.surface.vertices[source.surface.edges].mean(axis=1)[:, 0] > 0).astype(np.int32)
    voted = transfer_line(number, onto_source, source.surface, fine.surface).values
    middle = fine.surface.vertices[fine.surface.edges].mean(axis=1)[:, 0]
    clear = np.abs(middle) > 0.1
    assert (voted[clear] == 1 + (middle[clear] > 0)).all()


def test_empty_marks_stay_empty_and_loose_edges_are_left_out() -> None:
    mesh = sheet(torus, 60, 40).surface
    loose = Surface.from_corners(
        np.vstack([mesh.vertices, [[0, 0, 5]]]),
        mesh.corner_vertex,
        mesh.face_start,
        edges=np.vstack([[[2400, 0]], mesh.edges]),
    )
    surface_map = SurfaceMap.from_vertices(np.append(np.arange(2400), 0), loose)
    nothing = np.zeros(len(loose.edges), dtype=bool)
    assert not transfer_line(nothing, surface_map, loose, loose).values.any()
    marked = nothing.copy()
    marked[:2] = True
    result = transfer_line(marked, surface_map, loose, loose)
    assert np.flatnonzero(result.values).tolist() == [1]
    assert "1 edge of the source belongs to no face" in result.notes[0]


def test_target_without_edges_receives_none() -> None:
    mesh = sheet(torus, 60, 40).surface
    bare = Surface.from_corners(mesh.vertices, mesh.corner_vertex, mesh.face_start, edges=np.zeros((0, 2), dtype=int))
    marked = np.arange(len(mesh.edges)) % 7 == 0
    assert transfer_line(marked, identity(mesh), mesh, bare).values.shape == (0,)


def test_vertex_marks_move_only_to_the_nearest_vertex() -> None:
    source, target = sheet(torus, 120, 80), sheet(torus, 97, 61, jitter=0.2, sides=3, seed=1)
    surface_map = true_map(source, 120, 80, target.parameters)
    crease = np.zeros(len(source.surface.vertices), dtype=np.float32)
    chosen = np.arange(0, len(crease), 397)
    crease[chosen] = 0.1 + 0.9 * np.random.default_rng(0).random(len(chosen))
    attribute = Attribute("crease_vert", Domain.POINT, Kind.MARK, crease)
    result = transfer(attribute, surface_map, source.surface, target.surface)
    assert result.notes == ()
    marked = np.flatnonzero(result.values)
    assert len(marked) == len(chosen)
    distance, nearest = cKDTree(target.surface.vertices).query(source.surface.vertices[chosen])
    assert (np.isin(marked, nearest)).mean() > 0.9
    assert {round(float(value), 6) for value in result.values[marked]} == {round(float(v), 6) for v in crease[chosen]}
    there, _ = cKDTree(source.surface.vertices[chosen]).query(target.surface.vertices[marked])
    assert there.max() < 1.5 * distance.max()


def test_largest_of_colliding_marks_is_kept() -> None:
    source, target = sheet(torus, 120, 80), sheet(torus, 30, 20)
    surface_map = true_map(source, 120, 80, target.parameters)
    crease = np.where(np.linalg.norm(source.surface.vertices - [3, 0, 0], axis=1) < 0.1, 0.3, 0)
    crease[0] = 0.8
    attribute = Attribute("crease_vert", Domain.POINT, Kind.MARK, crease)
    values = transfer(attribute, surface_map, source.surface, target.surface).values
    assert values[values > 0].tolist() == [0.8]


def test_areas_filled_by_edges_stay_filled() -> None:
    source, target = sheet(torus, 120, 80), sheet(torus, 131, 89, jitter=0.2, sides=3, seed=1)
    surface_map = true_map(source, 120, 80, target.parameters)
    ends = source.parameters[source.surface.edges]
    patch = ((ends > 0.2) & (ends < 0.5)).all(axis=(1, 2))
    line = (np.ptp(ends[:, :, 1], axis=1) == 0) & (ends[:, 0, 1] == 0.75)
    crease = np.where(patch, 0.5, np.where(line, 1.0, 0.0))
    result = transfer_line(crease, surface_map, source.surface, target.surface).values
    places = target.parameters[target.surface.edges]
    inside = ((places > 0.215) & (places < 0.485)).all(axis=(1, 2))
    outside = ((places < 0.195) | (places > 0.505)).any(axis=(1, 2))
    assert (result[inside] == 0.5).all()
    assert not (result == 0.5)[outside].any()
    assert shape_of(target.surface, result == 1) == (1, 1, 0)


def test_outline_of_a_triangle_is_a_line() -> None:
    mesh = creature(2000).surface
    outline = np.sort(mesh.triangles[7][[[0, 1], [1, 2], [2, 0]]], axis=1) @ [2000, 1]
    marked = np.isin(np.sort(mesh.edges, axis=1) @ [2000, 1], outline)
    assert (transfer_line(marked, identity(mesh), mesh, mesh).values == marked).all()


def test_empty_vertex_marks_stay_empty() -> None:
    mesh = creature(1000).surface
    attribute = Attribute("crease_vert", Domain.POINT, Kind.MARK, np.zeros(1000))
    assert not transfer(attribute, identity(mesh), mesh, mesh).values.any()


def test_lines_that_end_at_a_border_end_at_the_target_border() -> None:
    source, target = sheet(tube, 120, 40), sheet(tube, 97, 31, jitter=0.2, sides=3, seed=1)
    # The map also sends the second-last vertices to the border.
    stretched = np.clip((target.parameters - [0, 0.5]) * [1, 1.08] + [0, 0.5], 0, 1)
    surface_map = true_map(source, 120, 40, stretched)
    ends = source.parameters[source.surface.edges]
    columns = np.round(ends[:, :, 0] * 120)
    marked = (columns[:, 0] == columns[:, 1]) & (columns[:, 0] % 10 == 0)
    result = transfer_line(marked, surface_map, source.surface, target.surface)
    assert shape_of(target.surface, result.values) == (12, 0, 24)
    vertices, count = np.unique(target.surface.edges[result.values], return_counts=True)
    assert np.isin(target.parameters[vertices[count == 1], 1], [0, 1]).all()
    assert np.isin(target.parameters[vertices[count == 2], 1], [0, 1]).sum() == 0

    rims = (ends[:, :, 1] % 1 == 0).all(axis=1)
    result = transfer_line(rims, true_map(source, 120, 40, target.parameters), source.surface, target.surface)
    at_rim = np.isin(target.parameters[target.surface.edges][:, :, 1], [0, 1]).all(axis=1)
    assert (result.values == at_rim).all()
