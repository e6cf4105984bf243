# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged specimens lack, cover or displace the landmarks that they say they do."""

from __future__ import annotations

import numpy as np
import pytest
from specimens import hollow

from benchmarks.specimens import damage as damaged_specimens
from benchmarks.specimens.damage import DAMAGES, HEIGHT, HOLE, intact, mirror_image
from benchmarks.specimens.table import rigid_errors
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.surface import Surface

BODY = hollow(900, 0)
LANDMARKS = BODY.vertices[:900:60]


def distances(surface: Surface, points: Floats) -> Floats:
    """(q,) distances of points (q, 3) from a surface, relative to the square root of the body's area."""
    triangle, weights = closest_points(points, surface.vertices, surface.triangles)
    feet = np.einsum("qc,qcx->qx", weights, surface.vertices[surface.triangles[triangle]])
    return np.asarray(np.linalg.norm(feet - points, axis=1) / np.sqrt(BODY.area))


@pytest.mark.parametrize("damage", ["broken", "worn", "holes"])
def test_missing_landmarks_are_off_the_surface_and_all_others_on_it(damage: str) -> None:
    specimen = DAMAGES[damage](BODY, LANDMARKS)
    assert 0 < (~specimen.present).sum() < len(LANDMARKS) / 2
    off = distances(specimen.surface, specimen.landmarks)
    assert off[specimen.present].max() < 1e-9
    assert off[~specimen.present].min() > 0
    assert specimen.surface.area < BODY.area


def test_holes_have_their_radius_and_breaks_their_size() -> None:
    holes = DAMAGES["holes"](BODY, LANDMARKS)
    assert distances(holes.surface, holes.landmarks)[~holes.present].max() >= HOLE
    broken = DAMAGES["broken"](BODY, LANDMARKS)
    used = np.unique(broken.surface.triangles)
    assert len(used) / len(BODY.vertices) == pytest.approx(1 - damaged_specimens.BROKEN, abs=0.02)


def test_growths_cover_some_landmarks_and_leave_the_others() -> None:
    grown = DAMAGES["growths"](BODY, LANDMARKS)
    assert grown.landmarks.tolist() == LANDMARKS.tolist()
    moved = np.linalg.norm(grown.surface.vertices - BODY.vertices, axis=1)[:900:60] / np.sqrt(BODY.area)
    assert (moved > 0.9 * HEIGHT).sum() == damaged_specimens.PLACES
    assert (moved < 0.1 * HEIGHT).sum() > len(LANDMARKS) / 2


def test_landmarks_of_other_species_stay_on_its_surface() -> None:
    other = DAMAGES["other species"](BODY, LANDMARKS)
    assert rigid_errors(LANDMARKS, other.landmarks).mean() > 0.02 * np.sqrt(BODY.area)
    assert other.present.all()
    assert other.landmarks == pytest.approx(other.surface.vertices[:900:60])


def test_mirror_image_stays_oriented_outwards() -> None:
    mirrored = mirror_image(BODY, LANDMARKS)
    assert distances(Surface(mirrored.surface.vertices * [-1, 1, 1], BODY.triangles), LANDMARKS).max() < 1e-9
    corners = mirrored.surface.vertices[mirrored.surface.triangles]
    assert np.linalg.det(corners).sum() == pytest.approx(np.linalg.det(BODY.vertices[BODY.triangles]).sum())
    assert intact(BODY, LANDMARKS).surface is BODY
