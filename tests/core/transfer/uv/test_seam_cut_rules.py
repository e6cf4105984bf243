# SPDX-License-Identifier: GPL-3.0-or-later
"""Cuts avoid places beside vertices, and slivers around points where seams meet."""

from __future__ import annotations

import numpy as np
import pytest
from transfer_meshes import nearest_map, plate

from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.transfer import Attribute, Domain, Kind
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.uv.seam_cut import SeamCut, seam_cut

SOURCE = plate(20, 20)


def quarters(surface: Surface) -> np.ndarray:
    """(c, 2) UVs of four islands that meet in the middle."""
    middle = surface.vertices[surface.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, :2].repeat(4, axis=0)
    return surface.vertices[surface.corner_vertex, :2] + 3 * (middle > 0.5)


def pair(column: float) -> Surface:
    """Two adjacent faces that meet at x = `column`."""
    x = np.array([0, column, 1])
    vertices = np.array([[a, b, 0] for a in x for b in (0.0, 1.0)])
    return Surface(vertices, [[0, 2, 3, 1], [2, 4, 5, 3]])


def cut_of(target: Surface) -> SeamCut:
    mapped = MappedTarget(SOURCE, target, nearest_map(target.vertices, SOURCE), np.ones(len(target.vertices)))
    return seam_cut(Attribute("UVMap", Domain.CORNER, Kind.UV, quarters(SOURCE)), mapped)


def test_face_around_the_meeting_point_is_divided_in_four() -> None:
    target = plate(1, 1)
    found = cut_of(target)
    assert len(found.edge) == 4
    np.testing.assert_allclose(found.fraction, 0.5, atol=1e-3)
    assert [len(spokes) for spokes in found.spokes] == [4]
    opened = found.apply(target)
    np.testing.assert_allclose(opened.vertices[-1], [0.5, 0.5, 0], atol=1e-3)
    area = np.bincount(opened.triangle_face, triangle_areas(opened.vertices, opened.triangles))
    np.testing.assert_allclose(area, 0.25, atol=1e-3)
    assert found.left == 0


@pytest.mark.parametrize(("column", "snapped"), [(0.4, False), (0.43, False), (0.46, True), (0.49, True)])
def test_crossings_near_a_vertex_snap_to_it(column: float, snapped: bool) -> None:
    found = cut_of(pair(column))
    along = np.ptp(pair(column).vertices[found.edge][:, :, 1], axis=1) == 0
    assert along.sum() == (0 if snapped else 2)
    # Vertices snapped to the seam also map to it on the source.
    images = found.surface_map.interpolate(SOURCE.vertices)[[2, 3], 0]
    np.testing.assert_allclose(images, 0.5 if snapped else column, atol=1e-3)


@pytest.mark.parametrize(("column", "divided", "left"), [(0.4, 1, 0), (0.46, 1, 1), (0.49, 0, 2)])
def test_meeting_point_next_to_an_edge_divides_no_face(column: float, divided: int, left: int) -> None:
    found = cut_of(pair(column))
    assert len(found.meeting) == divided
    assert found.left == left
    opened = found.apply(pair(column))
    area = np.bincount(opened.triangle_face, triangle_areas(opened.vertices, opened.triangles))
    assert area.sum() == pytest.approx(1)
    assert area.min() > 0.005


def test_meeting_point_is_found_in_a_polygon_of_many_triangles() -> None:
    # An octagon around the middle, triangulated as a fan from a corner.
    turn = np.arange(8) * np.pi / 4 + 0.3
    ring = np.column_stack([0.5 + 0.4 * np.cos(turn), 0.55 + 0.4 * np.sin(turn), 0 * turn])
    target = Surface(ring, [list(range(8))])
    found = cut_of(target)
    assert len(found.meeting) == 1
    point = np.einsum("c,cx->x", found.weights[0], target.vertices[found.corners[0]])
    np.testing.assert_allclose(point, [0.5, 0.5, 0], atol=1e-6)
