# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting a target along its source's seams makes island borders exact and changes nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from test_uv import GRID, atlas
from transfer_meshes import Sheet, sheet, torus, true_map

from zoomout_core.arrays import Floats
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.cut_mesh import face_edges
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.uv.seam_cut import SNAP_DISTANCE, SeamCut, seam_cut

LAYOUTS = {"islands": (6, 4), "rings that border themselves": (5, 1)}
# Tolerance for points on a seam, as a fraction of an island; chords deviate less from the source's circles.
ON_SEAM = 0.02


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(torus, *GRID)


@pytest.fixture(scope="module", params=[3, 4])
def target(request: pytest.FixtureRequest) -> Sheet:
    return sheet(torus, 60, 42, jitter=0.2, twist=0.05, sides=request.param, seed=1)


def cut_of(source: Sheet, target: Sheet, layout: tuple[int, int]) -> tuple[Attribute, SeamCut, Surface]:
    uv = Attribute("UVMap", Domain.CORNER, Kind.UV, atlas(source, *layout).uv)
    surface_map = true_map(source, *GRID, target.parameters)
    found = seam_cut(uv, MappedTarget(source.surface, target.surface, surface_map, np.ones(len(target.parameters))))
    return uv, found, found.apply(target.surface)


def in_islands(points: Floats, layout: tuple[int, int]) -> Floats:
    """(q, 2) parameters of points of the torus, in units of islands."""
    x, y, z = points.T
    turns = np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y) - 2)], axis=1) / (2 * np.pi)
    return turns * layout


def straddling(surface: Surface, images: Floats, layout: tuple[int, int]) -> float:
    """Share of the area in faces whose corners are in several islands."""
    at = in_islands(images, layout)[surface.corner_vertex]
    near = np.abs(at - np.round(at)) < ON_SEAM
    cell = np.floor(at) % layout
    start = surface.face_start[:-1]
    low, high = (
        side.reduceat(np.where(near, other, cell), start)
        for side, other in ((np.minimum, np.inf), (np.maximum, -np.inf))
    )
    area = np.bincount(surface.triangle_face, triangle_areas(surface.vertices, surface.triangles))
    return float(area[(low < high).any(axis=1)].sum() / area.sum())


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_new_vertices_lie_on_seams_and_divide_crossed_faces(
    source: Sheet, target: Sheet, layout: tuple[int, int]
) -> None:
    _, found, opened = cut_of(source, target, layout)
    images = found.surface_map.interpolate(source.surface.vertices)
    new = in_islands(images[len(target.parameters) :], layout)
    assert len(new) > 100
    assert np.abs(new - np.round(new)).min(axis=1).max() < ON_SEAM
    before = straddling(target.surface, images[: len(target.parameters)], layout)
    after = straddling(opened, images, layout)
    assert before > 0.03
    assert after < before / 12
    # Faces stay uncut where a seam leaves and re-enters them, or where seams meet on their outline.
    assert found.left < 0.02 * (len(target.surface.face_start) - 1)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_cutting_keeps_the_surface_and_its_topology(source: Sheet, target: Sheet, layout: tuple[int, int]) -> None:
    _, found, opened = cut_of(source, target, layout)
    n = len(target.parameters)
    np.testing.assert_array_equal(opened.vertices[:n], target.surface.vertices)
    parts = len(found.face) + sum(len(spokes) - 1 for spokes in found.spokes)
    assert len(opened.face_start) == len(target.surface.face_start) + parts
    edges, faces_at = np.unique(np.sort(opened.corner_vertex[face_edges(opened)], axis=1), axis=0, return_counts=True)
    assert (faces_at == 2).all()
    assert len(opened.vertices) - len(edges) + len(opened.face_start) - 1 == 0  # still a torus
    assert found.fraction.min() >= SNAP_DISTANCE
    assert found.fraction.max() <= 1 - SNAP_DISTANCE


def test_face_is_divided_from_the_point_where_seams_meet(source: Sheet, target: Sheet) -> None:
    layout = LAYOUTS["islands"]
    _, found, opened = cut_of(source, target, layout)
    assert len(found.meeting) > 1
    count = len(target.parameters) + len(found.edge)
    hubs = in_islands(found.surface_map.interpolate(source.surface.vertices)[count:], layout)
    np.testing.assert_allclose(hubs, np.round(hubs), atol=ON_SEAM)  # on a seam in each direction
    triangle = target.surface.vertices[found.corners]
    np.testing.assert_allclose(opened.vertices[count:], np.einsum("hc,hcx->hx", found.weights, triangle))
    faces_at = np.bincount(opened.corner_vertex, minlength=len(opened.vertices))[count:]
    np.testing.assert_array_equal(faces_at, [len(spokes) for spokes in found.spokes])
    assert (triangle_areas(opened.vertices, opened.triangles) > 0).all()


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_islands_end_exactly_at_the_seams(source: Sheet, target: Sheet, layout: tuple[int, int]) -> None:
    uv, found, opened = cut_of(source, target, layout)
    of = atlas(source, *layout)
    values = transfer(uv, found.surface_map, source.surface, opened).values
    start = opened.face_start
    island = of.island_at(np.add.reduceat(values, start[:-1]) / np.diff(start)[:, None])
    images = found.surface_map.interpolate(source.surface.vertices)[opened.corner_vertex]
    at = in_islands(images, layout) / layout
    lower = np.stack(np.divmod(island, layout[1]), axis=1)[opened.corner_face] / layout
    turns = np.round(lower + 0.5 / np.array(layout) - at)
    expected = of.chart(at + turns, island[opened.corner_face])
    error = np.linalg.norm(values - expected, axis=1)
    assert np.percentile(error, 98) < 2e-3  # chords of the source's grid deviate this much


def test_a_source_without_seams_cuts_nothing(source: Sheet, target: Sheet) -> None:
    uv = Attribute("UVMap", Domain.CORNER, Kind.UV, np.zeros((len(source.surface.corner_vertex), 2)))
    surface_map = true_map(source, *GRID, target.parameters)
    found = seam_cut(uv, MappedTarget(source.surface, target.surface, surface_map, np.ones(len(target.parameters))))
    assert len(found.edge) == len(found.face) == found.left == 0
    np.testing.assert_array_equal(found.apply(target.surface).corner_vertex, target.surface.corner_vertex)
