# SPDX-License-Identifier: GPL-3.0-or-later
"""UV maps choose the right island and the right side of seams, and are exact wherever an exact value exists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from creatures import directions
from transfer_meshes import (
    Sheet,
    globe,
    identity,
    permute,
    sheet,
    sphere,
    split_at_faces,
    torus,
    true_map,
    tube,
)

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.cut_mesh import adjacent_edges, cut_surface

GRID = (60, 40)


@dataclass(frozen=True)
class Match:
    surface_map: SurfaceMap
    confidence: np.ndarray
    has_partner: None = None


@dataclass(frozen=True)
class Atlas:
    """A UV map of a torus or tube, linear in the parameters on each of its islands.

    Attributes:
        uv: (c, 2) at the source's corners.
        chart: maps parameters (m, ..., 2) and islands (m,) to UVs.
        islands: number of islands.
        island_of: maps parameters (m, 2) to islands.
        island_at: maps UVs (m, 2) to islands.
    """

    uv: np.ndarray
    chart: Callable[[np.ndarray, np.ndarray], np.ndarray]
    islands: int
    island_of: Callable[[np.ndarray], np.ndarray]
    island_at: Callable[[np.ndarray], np.ndarray]


def atlas(source: Sheet, strips: int, bands: int, seed: int = 0) -> Atlas:
    """Rectangles of the parameters, each rotated, scaled and in its own UDIM tile; some are mirrored."""
    random = np.random.default_rng(seed)
    count = strips * bands
    angle, scale = random.uniform(0, 2 * np.pi, count), random.uniform(0.1, 0.2, count) * min(strips, bands)
    mirror = np.where(np.arange(count) % 3, 1, -1)
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    matrix = np.stack([cosine, -sine * mirror, sine, cosine * mirror], axis=1).reshape(count, 2, 2)
    middle = (np.stack(np.divmod(np.arange(count), bands), axis=1) + 0.5) / [strips, bands]
    number = random.permutation(count)
    tile = np.stack(np.divmod(number, 10), axis=1) + 0.5

    def chart(parameters: np.ndarray, k: np.ndarray) -> np.ndarray:
        between = tuple(range(1, parameters.ndim - 1))
        inside = parameters - np.expand_dims(middle[k], between)
        return np.einsum("mij,m...j->m...i", matrix[k], inside) + np.expand_dims(tile[k], between)

    def island_at(uv: np.ndarray) -> np.ndarray:
        column, row = np.floor(uv).astype(int).T
        return np.argsort(number)[10 * column + row]

    def island_of(parameters: np.ndarray) -> np.ndarray:
        column, row = np.floor(parameters % 1 * [strips, bands]).astype(int).T
        return column * bands + row

    face = source.surface.corner_face
    corners = source.corners - np.floor(source.middles)[face]
    return Atlas(chart(corners, island_of(source.middles)[face]), chart, count, island_of, island_at)


def transfer_uvs(uv: np.ndarray, surface_map: SurfaceMap | Match, source: Surface, target: Surface) -> Attribute:
    return transfer(Attribute("UVMap", Domain.CORNER, Kind.UV, uv), surface_map, source, target)


def best_chart(result: np.ndarray, target: Sheet, of: Atlas) -> tuple[np.ndarray, np.ndarray]:
    """The chart of each triangle with the best shift by whole turns, and the largest error of its corners."""
    uv, corners = result.reshape(-1, 3, 2), target.corners.reshape(-1, 3, 2)
    island = of.island_at(uv.mean(axis=1))
    errors = [np.abs(of.chart(corners + np.array(turn) - 1, island) - uv).max(axis=(1, 2)) for turn in np.ndindex(3, 3)]
    return 9 * island + np.argmin(errors, axis=0), np.min(errors, axis=0)


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(torus, *GRID)


TARGETS = {"same density": (49, 31), "coarse": (31, 23), "fine": (150, 100)}
LAYOUTS = {"islands": (6, 4), "rings that border themselves": (5, 1), "one island cut twice": (1, 1)}


@pytest.fixture(scope="module", params=TARGETS)
def target(request: pytest.FixtureRequest) -> Sheet:
    return sheet(torus, *TARGETS[request.param], jitter=0.2, twist=0.05, sides=3, seed=1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_faces_lie_in_one_chart_and_are_exact_away_from_seams(source: Sheet, target: Sheet, layout: str) -> None:
    of = atlas(source, *LAYOUTS[layout])
    result = transfer_uvs(of.uv, true_map(source, *GRID, target.parameters), source.surface, target.surface)
    choice, error = best_chart(result.values, target, of)
    corners = target.corners.reshape(-1, 3, 2) * LAYOUTS[layout]
    inside = (np.floor(corners) == np.floor(corners[:, :1])).all(axis=(1, 2))
    assert inside.mean() > 0.3
    assert error[inside].max() < 1e-9
    # Charts continue linearly beyond a seam; on a curved surface the error is quadratic in the edge length.
    size = np.abs(np.ptp(result.values.reshape(-1, 3, 2), axis=1)).max()
    assert error.max() < 0.1 * size
    # Faces take the island of their centre, except faces across a seam.
    assert (choice[inside] // 9 == of.island_of(target.middles)[inside]).all()
    assert not result.notes


@pytest.mark.parametrize("layout", LAYOUTS)
def test_faces_of_one_chart_share_their_corners_exactly(source: Sheet, target: Sheet, layout: str) -> None:
    of = atlas(source, *LAYOUTS[layout])
    uv = transfer_uvs(of.uv, true_map(source, *GRID, target.parameters), source.surface, target.surface).values
    choice, _ = best_chart(uv, target, of)
    first, second = adjacent_edges(target.surface)
    one, other = target.surface.corner_face[first[:, 0]], target.surface.corner_face[second[:, 0]]
    jump = np.abs(uv[first] - uv[second]).max(axis=(1, 2))
    # Skip edges where the target's parameters wrap: there, faces of one chart differ by whole turns.
    near = np.abs(target.middles[one] - target.middles[other]).max(axis=1) < 0.5
    joined = (choice[one] == choice[other]) & near
    assert joined.mean() > 0.7
    assert (jump[joined] == 0).all()
    assert (jump[near & ~joined] > 0).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_seams_are_not_jagged(source: Sheet, target: Sheet, layout: str) -> None:
    of = atlas(source, *LAYOUTS[layout])
    uv = transfer_uvs(of.uv, true_map(source, *GRID, target.parameters), source.surface, target.surface).values
    first, second = adjacent_edges(target.surface)
    jump = np.abs(uv[first] - uv[second]).max(axis=(1, 2)) > 0
    seams = edge_lengths(target.surface.vertices[target.surface.corner_vertex], first)[jump].sum()
    at_corners = source.surface.vertices[source.surface.corner_vertex]
    true_seams = edge_lengths(at_corners, cut_surface(source.surface, of.uv).border).sum() / 2
    assert seams < 1.3 * true_seams


def test_no_face_spans_the_seam_of_an_unrolled_tube() -> None:
    source, target = sheet(tube, *GRID), sheet(tube, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)
    surface_map = true_map(source, *GRID, target.parameters)
    margin = transfer_uvs(source.corners * 0.8 + 0.1, surface_map, source.surface, target.surface)
    error = margin.values - (target.corners * 0.8 + 0.1)
    turns = np.round(error[:, 0] / 0.8)
    assert (turns.reshape(-1, 3) == turns.reshape(-1, 3)[:, :1]).all()
    error[:, 0] -= 0.8 * turns
    assert np.abs(error).max() < 1e-4
    assert not margin.notes


def test_corners_stay_in_the_tile_of_their_island() -> None:
    source, target = sheet(tube, *GRID), sheet(tube, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)
    tile = np.array([3.0, 1.0])
    surface_map = true_map(source, *GRID, target.parameters)
    uv = transfer_uvs(source.corners + tile, surface_map, source.surface, target.surface).values
    assert uv.min(axis=0) == pytest.approx(tile, abs=1e-9)
    assert uv.max(axis=0) == pytest.approx(tile + 1, abs=1e-9)
    assert np.ptp(uv.reshape(-1, 3, 2), axis=1).max() < 0.05


@pytest.mark.parametrize("count", [300, 5000, 30000])
def test_no_face_spans_the_seam_of_a_globe(count: int) -> None:
    source, uv = globe(160, 100)
    target = sphere(directions(count, seed=2))
    surface_map = SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles)
    result = transfer_uvs(uv, surface_map, source, target).values
    x, y, z = target.vertices[target.corner_vertex].T
    ring, edge = np.hypot(x, y), np.sqrt(4 * np.pi / count)
    off = result - np.stack([np.arctan2(y, x) / (2 * np.pi), 1 - np.arccos(z) / np.pi], axis=1)
    off[:, 0] = (off[:, 0] - np.round(off[:, 0])) * ring
    away = np.repeat(ring.reshape(-1, 3).min(axis=1) > 2 * edge, 3)
    # The island fills its tile, so corners beyond the seam are clamped to it, at most an edge short.
    at_seam = (result[:, 0] < 1e-6) | (result[:, 0] > 1 - 1e-6)
    assert np.abs(off[away & ~at_seam]).max() < 1e-3
    assert np.abs(off).max() < 1.5 * edge / (2 * np.pi) + 0.01
    width = np.ptp(result[:, 0].reshape(-1, 3), axis=1)
    assert (width * ring.reshape(-1, 3).min(axis=1))[away[::3]].max() < 2 * edge / np.pi


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("sides", [3, 4, 6])
@pytest.mark.parametrize("layout", [*LAYOUTS, "an island for each face"])
def test_the_identity_returns_the_uvs(sides: int, layout: str) -> None:
    mesh = sheet(torus, *GRID, sides=sides)
    face = mesh.surface.corner_face
    if layout in LAYOUTS:
        # Hexagons must not straddle islands.
        uv = atlas(mesh, *LAYOUTS[layout]).uv
    else:
        uv = mesh.corners + np.random.default_rng(0).uniform(0, 9, (face.max() + 1, 2))[face]
    assert np.abs(transfer_uvs(uv, identity(mesh.surface), mesh.surface, mesh.surface).values - uv).max() < 1e-12
    alone, _ = split_at_faces(mesh.surface)
    assert np.abs(transfer_uvs(uv, identity(alone), alone, alone).values - uv).max() < 1e-12


@pytest.mark.parametrize("sides", [3, 4, 6])
def test_identity_returns_the_uvs_if_seams_end_at_many_vertices(sides: int) -> None:
    mesh = sheet(torus, *GRID, sides=sides)
    random = np.random.default_rng(0)
    uv = mesh.corners + 0.001 * random.normal(size=mesh.corners.shape) * (random.random((len(mesh.corners), 1)) < 0.2)
    assert np.abs(transfer_uvs(uv, identity(mesh.surface), mesh.surface, mesh.surface).values - uv).max() < 1e-12


def test_face_between_loose_parts_takes_one_of_them() -> None:
    part = sheet(torus, 60, 40)
    count = len(part.surface.vertices)
    vertices = np.concatenate([part.surface.vertices, part.surface.vertices + np.array([10, 0, 0])])
    two = Surface(vertices, np.concatenate([part.surface.triangles, part.surface.triangles + count]))
    uv = vertices[two.corner_vertex, :2]  # seen from above
    target = sheet(torus, 97, 61, sides=3)
    surface_map = true_map(part, 60, 40, target.parameters)
    far = target.parameters[:, 0] > 0.5
    triangle = surface_map.triangle + far * len(part.surface.triangles)
    result = transfer_uvs(uv, SurfaceMap(triangle, surface_map.barycentric, two.triangles), two, target.surface).values
    side = (result[:, 0] > 5).reshape(-1, 3)
    assert (side == side[:, :1]).all()
    assert 0.4 < side.mean() < 0.6


def test_a_target_aligned_with_the_seams_is_exact_on_both_sides(source: Sheet) -> None:
    of = atlas(source, 6, 4)
    fine = sheet(torus, 2 * GRID[0], 2 * GRID[1])
    uv = transfer_uvs(of.uv, true_map(source, *GRID, fine.parameters), source.surface, fine.surface).values
    k = of.island_of(fine.middles)[fine.surface.corner_face]
    assert np.abs(uv - of.chart(fine.corners, k)).max() < 1e-9


def test_vertices_split_by_an_exporter_make_no_seam(source: Sheet) -> None:
    target = sheet(torus, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)
    of = atlas(source, 6, 4)
    surface_map = true_map(source, *GRID, target.parameters)
    whole = transfer_uvs(of.uv, surface_map, source.surface, target.surface).values
    alone, _ = split_at_faces(source.surface)
    there = replace(surface_map, source_triangles=alone.triangles)
    assert cut_surface(alone, of.uv).island.max() + 1 == of.islands
    assert np.abs(transfer_uvs(of.uv, there, alone, target.surface).values - whole).max() < 1e-9


def test_target_vertex_order_does_not_matter(source: Sheet) -> None:
    target = sheet(torus, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)
    of = atlas(source, 6, 4)
    other, _ = permute(target)
    one, two = (
        transfer_uvs(of.uv, true_map(source, *GRID, mesh.parameters), source.surface, mesh.surface).values
        for mesh in (target, other)
    )
    assert np.abs(one - two).max() < 1e-12


def test_noisy_maps_keep_every_face_in_one_chart(source: Sheet) -> None:
    target = sheet(torus, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)
    noise = np.random.default_rng(5).uniform(-0.5, 0.5, target.parameters.shape) / [97, 61]
    for layout in LAYOUTS.values():
        of = atlas(source, *layout)
        surface_map = true_map(source, *GRID, (target.parameters + noise) % 1)
        uv = transfer_uvs(of.uv, surface_map, source.surface, target.surface).values
        _, error = best_chart(uv, target, of)
        # Bound: the steepest chart times an error of half an edge.
        assert error.max() < 1.5 * 0.2 * min(layout) * 0.5 / 61 * np.sqrt(2)


def test_votes_are_weighted_by_confidence(source: Sheet) -> None:
    target = sheet(torus, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)
    of = atlas(source, 2, 1)
    surface_map = true_map(source, *GRID, target.parameters)
    side = of.island_of(target.parameters)
    covered = []
    for confidence in (np.ones(len(side)), np.where(side == 0, 1.0, 0.1), np.where(side == 1, 1.0, 0.1)):
        uv = transfer_uvs(of.uv, Match(surface_map, confidence), source.surface, target.surface).values
        choice, error = best_chart(uv, target, of)
        assert error.max() < 0.01
        covered.append((choice // 9 == 0).sum())
    across = np.ptp(side[target.surface.triangles], axis=1).astype(bool).sum()
    assert covered[1] - covered[0] > 0.05 * across
    assert covered[0] - covered[2] > 0.05 * across


def test_a_left_right_flip_is_reported(source: Sheet) -> None:
    target = sheet(torus, 97, 61, sides=3)
    mirrored = true_map(source, *GRID, target.parameters * [1, -1] % 1)
    result = transfer_uvs(atlas(source, 6, 4).uv, mirrored, source.surface, target.surface)
    (flipped,) = (note for note in result.notes if "flipped" in note)
    assert int(flipped.split()[1].replace(",", "")) > 0.95 * len(target.surface.triangles)
    assert flipped.startswith("UVMap: ")


def test_reversed_winding_is_not_reported_as_a_flip(source: Sheet) -> None:
    target = sheet(torus, 97, 61)
    inverted = Surface(target.surface.vertices, target.surface.triangles[:, ::-1])
    of = atlas(source, 6, 4)
    assert not transfer_uvs(of.uv, true_map(source, *GRID, target.parameters), source.surface, inverted).notes


@pytest.mark.parametrize("sides", [3, 4])
def test_folds_of_the_source_are_not_reported_as_flips(sides: int) -> None:
    mesh = sheet(torus, 97, 61, jitter=0.2, sides=sides)
    projected = mesh.surface.vertices[mesh.surface.corner_vertex, :2]  # the upper and lower half overlap
    notes = transfer_uvs(projected, identity(mesh.surface), mesh.surface, mesh.surface).notes
    assert not [note for note in notes if "flipped" in note]


def test_faces_beside_folds_are_not_reported_as_flips(source: Sheet) -> None:
    seen_from_aside = np.array([[1, 0], [0, 1], [0.5, 0.3]])
    projected = (source.surface.vertices @ seen_from_aside)[source.surface.corner_vertex]
    target = sheet(torus, 97, 61, sides=3)

    def flipped(parameters: np.ndarray) -> int:
        along = true_map(source, *GRID, parameters)
        notes = transfer_uvs(projected, along, source.surface, target.surface).notes
        return sum(int(note.split()[1].replace(",", "")) for note in notes if "flipped" in note)

    assert flipped(target.parameters) == 0
    assert flipped(target.parameters * [1, -1] % 1) > 0.8 * len(target.surface.triangles)


def test_collapsed_and_stretched_faces_and_lost_islands_are_reported(source: Sheet) -> None:
    target = sheet(torus, 97, 61, sides=3)
    patch = target.parameters[:, 0] < 0.4
    pinned = np.where(patch[:, None], [[0.01, 0.01]], target.parameters)
    result = transfer_uvs(atlas(source, 6, 4).uv, true_map(source, *GRID, pinned), source.surface, target.surface)
    report = " ".join(result.notes)
    assert "faces have collapsed UVs." in report
    assert "of 24 UV islands of the source received no face." in report
    random = np.random.default_rng(0)
    scattered = np.where(random.random((len(patch), 1)) < 0.01, random.random((len(patch), 2)), target.parameters)
    flat = transfer_uvs(source.corners, true_map(source, *GRID, scattered), source.surface, target.surface)
    assert "faces have strongly stretched UVs." in " ".join(flat.notes)
