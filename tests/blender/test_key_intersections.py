# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that a key pushes through others are found, unless the source or the mesh at rest has them, too."""

import numpy as np
import pytest

import zoomout_core as zo
from blender_addon.mesh_data import intersecting_triangles
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.keys import intersections as intersections_of_keys
from zoomout_core.transfer.keys.intersections import Intersections

RADIUS = 0.2
UP = np.array([0.0, 0.0, 1.0])


def plate(cells=20):
    """A square of cells by cells at height 0."""
    across = np.linspace(-1, 1, cells + 1)
    x, y = (each.ravel() for each in np.meshgrid(across, across))
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    squares = np.column_stack([corner, corner + 1, corner + cells + 2, corner + cells + 1])
    return zo.Surface(np.column_stack([x, y, 0 * x]), np.vstack([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]]))


def plate_and_ball(height=-1.0, sheet=None, count=300):
    """A plate and a ball below it, both not aligned with each other."""
    sphere = ball(RADIUS, count=count)
    return zo.Surface.joined([sheet or plate(), sphere.with_vertices(sphere.vertices + np.array([0.03, 0.02, height]))])


def raised(surface, by, count=300):
    """The offsets of a key that moves the ball up."""
    return np.where(np.arange(len(surface.vertices))[:, None] < len(surface.vertices) - count, 0, by * UP)


def find(target, by, source=None, on_source=0.0):
    source = source or target
    images = np.repeat(np.arange(len(target.vertices))[:, None], 3, axis=1)
    return Intersections(source, target, images, intersecting_triangles).find(
        raised(source, on_source), raised(target, by)
    )


def test_intersection_at_half_strength_is_found():
    target = plate_and_ball()
    found = find(target, 2.0)
    places = target.vertices[found]
    on_plate = found[:441]
    assert on_plate.sum() > 10
    assert (np.linalg.norm(places[: on_plate.sum()], axis=1) < RADIUS + 0.2).all()
    assert found[441:].any()
    assert not find(target, 0.5).any()


def test_touching_faces_are_not_reported():
    target = plate_and_ball()
    assert not find(target, 0.805).any()
    assert find(target, 0.85).any()


def test_intersections_of_source_or_rest_are_not_reported():
    target = plate_and_ball()
    assert not find(target, 2.0, on_source=2.0).any()
    assert find(target, 2.0, on_source=0.5).any()
    assert not find(plate_and_ball(0.0), 0.02).any()


def test_faces_at_seams_do_not_count_as_intersecting_at_rest():
    whole = plate()
    apart = zo.Surface(whole.vertices[whole.triangles.ravel()], np.arange(3 * len(whole.triangles)).reshape(-1, 3))
    found = find(plate_and_ball(sheet=apart), 2.0)
    assert found[: len(apart.vertices)].sum() > 10


def test_hardly_moving_pairs_are_ignored():
    target = plate_and_ball(-0.23, count=40)
    far = target.vertices[0] - 9
    with_another = zo.Surface.joined([ball(RADIUS, count=300), target])
    with_another = with_another.with_vertices(np.vstack([with_another.vertices[:300] + far, target.vertices]))
    images = np.repeat(np.arange(len(with_another.vertices))[:, None], 3, axis=1)
    intersections = Intersections(with_another, with_another, images, intersecting_triangles)
    for largest, count in ((1.9, 1), (2.1, 0)):  # the ball below the plate moves by 0.1
        offsets = np.vstack([np.repeat(largest * UP[None], 300, axis=0), raised(target, 0.1, 40)])
        assert intersections.find(0 * offsets, offsets).any() == count


def test_the_source_may_be_finer():
    fine, coarse = plate_and_ball(), plate_and_ball(sheet=plate(5), count=60)
    nearest = np.linalg.norm(coarse.vertices[:, None] - fine.vertices, axis=2).argmin(axis=1)
    images = np.repeat(nearest[:, None], 3, axis=1)
    intersections = Intersections(fine, coarse, images, intersecting_triangles)
    assert intersections.find(0 * fine.vertices, raised(coarse, 2.0, 60)).any()
    assert not intersections.find(raised(fine, 2.0), raised(coarse, 2.0, 60)).any()


def test_grid_cells_miss_no_pair(monkeypatch):
    random = np.random.default_rng(0)
    corners = random.random((2000, 1, 3)) + 0.05 * random.standard_normal((2000, 3, 3))
    soup = zo.Surface(corners.reshape(-1, 3), np.arange(6000).reshape(-1, 3))
    offsets = np.where(np.arange(6000)[:, None] < 60, 0.3 * UP, 0.0)
    images = np.repeat(np.arange(6000)[:, None], 3, axis=1)

    def found():
        return Intersections(soup, soup, images, intersecting_triangles).find(0 * offsets, offsets)

    with_cells = found()
    monkeypatch.setattr(intersections_of_keys, "CELLS", 1)
    np.testing.assert_array_equal(with_cells, found())


def test_unmapped_vertices_and_still_keys_are_ignored():
    target = plate_and_ball()
    intersections = Intersections(target, target, np.full((len(target.vertices), 3), -1), intersecting_triangles)
    assert not intersections.find(0 * target.vertices, raised(target, 2.0)).any()
    assert not find(target, 0.0).any()


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_intersections_do_not_depend_on_units(size):
    target = plate_and_ball()
    scaled = target.with_vertices(size * target.vertices)
    np.testing.assert_array_equal(find(scaled, 2.0 * size), find(target, 2.0))


def test_few_large_and_many_small_triangles_are_compared():
    square = np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]])
    target = plate_and_ball(sheet=zo.Surface(square, np.array([[0, 1, 2], [0, 2, 3]])))
    assert find(target, 2.0)[:4].any()
