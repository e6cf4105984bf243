# SPDX-License-Identifier: GPL-3.0-or-later
"""A noisy mirror becomes an involution, without jumping across thin parts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from butterfly import MIRROR, grid, mirrored_vertex
from creatures import directions
from scipy.spatial import cKDTree

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.embedded_surface import Neighbourhoods
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import outward_hull
from zoomout_core.symmetry.involution import involution, return_error


def lens(thickness: float, count: int = 400) -> Surface:
    """A flattened sphere."""
    points = directions(count, seed=3)
    triangles = outward_hull(points)
    return Surface(points * [1, 1, thickness], triangles)


def shape_of(surface: Surface) -> ShapeAnalysis:
    mesh = surface.working
    return cast(
        ShapeAnalysis, SimpleNamespace(mesh=mesh, neighbourhoods=Neighbourhoods(mesh.triangles, len(mesh.vertices)))
    )


def noisy_mirror(surface: Surface, noise: float) -> SurfaceMap:
    """The mirror with random displacements in x and y."""
    random = np.random.default_rng(0)
    off = noise * random.normal(size=surface.vertices.shape) * [1, 1, 0]
    return SurfaceMap(
        *closest_points(surface.vertices * MIRROR + off, surface.vertices, surface.triangles), surface.triangles
    )


@pytest.mark.parametrize("thickness", [1.0, 0.05])
def test_noisy_mirror_becomes_an_involution_on_the_same_side(thickness: float) -> None:
    surface = lens(thickness)
    noisy = noisy_mirror(surface, 0.1)
    found = involution(noisy, shape_of(surface))
    before, after = return_error(noisy, 2, surface), return_error(found, 2, surface)
    assert after < 0.35 * before
    truth = surface.vertices * MIRROR
    off = [np.linalg.norm(m.interpolate(surface.vertices) - truth, axis=1).mean() for m in (noisy, found)]
    assert off[1] < off[0]
    upper = np.abs(surface.vertices[:, 2]) > 0.3 * thickness
    image = found.interpolate(surface.vertices)[:, 2]
    assert (np.sign(image) == np.sign(surface.vertices[:, 2]))[upper].all()


def test_exact_mirror_is_unchanged() -> None:
    surface = grid()
    mirror = SurfaceMap.from_vertices(mirrored_vertex(surface), surface)
    found = involution(mirror, shape_of(surface))
    np.testing.assert_allclose(found.interpolate(surface.vertices), surface.vertices * MIRROR, atol=1e-9)


def test_return_error_is_the_relative_miss_of_the_last_round() -> None:
    surface = grid(12, 12, width=1.0)
    centred = surface.vertices - [0, 0.5, 0]
    quarter = cKDTree(centred).query(centred @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]))[1]
    for scale in (1.0, 1000.0):
        scaled = Surface(scale * surface.vertices, surface.corner_vertex.reshape(-1, 4))
        turn = SurfaceMap.from_vertices(quarter, scaled)
        assert return_error(turn, 4, scaled) == pytest.approx(0, abs=1e-9)
        once, twice = (return_error(turn, order, scaled) for order in (1, 2))
        assert twice == pytest.approx(2 * np.linalg.norm(centred, axis=1).mean())
        assert once == pytest.approx(twice / np.sqrt(2))
        assert return_error(turn, 0, scaled) == 0


def test_return_error_ignores_nan_vertices() -> None:
    surface = grid()
    faces = surface.corner_vertex.reshape(-1, 4)
    more = Surface(np.vstack([surface.vertices, [[np.nan] * 3]]), faces)
    mirror = SurfaceMap.from_vertices(np.append(mirrored_vertex(surface), 0), more)
    assert return_error(mirror, 2, more) == pytest.approx(0, abs=1e-9)
