# SPDX-License-Identifier: GPL-3.0-or-later
"""Limit surfaces are invariant under subdivision of the cage, and cages are fitted to a given limit."""

from __future__ import annotations

import numpy as np
import pytest
from transfer_meshes import globe, nearest_map, plate, sheet, torus

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import wrap
from zoomout_core.transfer.wrapping.subdivision import _subdivide, limit_points

CAGES = {
    "triangles": ball(1, count=40),
    "border": plate(3, 4, jitter=0.2),
    "closed quads": sheet(torus, 8, 6, jitter=0.2).surface,
    "fans at poles": globe(7, 5)[0],
    "hexagons": sheet(torus, 8, 6, sides=6).surface,
    "a loose vertex": Surface([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.3], [5, 5, 5]], [[0, 1, 2, 3]]),
}


@pytest.mark.parametrize("cage", CAGES.values(), ids=CAGES)
def test_limit_equals_that_of_the_subdivided_cage(cage: Surface) -> None:
    points = limit_points(cage)
    _, subdivided, quads = _subdivide(cage)
    finer = Surface(subdivided @ cage.vertices, quads)
    again = limit_points(finer).limit[: len(finer.vertices)] @ finer.vertices
    np.testing.assert_allclose(points.limit @ cage.vertices, again, atol=1e-12)
    np.testing.assert_allclose(points.limit.sum(axis=1), 1)
    assert (points.flat.toarray()[np.arange(len(points.near)), points.near] > 0).all()


def test_a_flat_cage_has_a_flat_limit_and_a_cube_a_round_one() -> None:
    flat = limit_points(CAGES["border"]).limit @ CAGES["border"].vertices
    assert np.abs(flat[:, 2]).max() < 1e-12
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    cube = limit_points(Surface(corners, faces)).limit @ corners
    np.testing.assert_allclose(cube[:8], corners / 2)  # (9 v + 12 e' / 3 ...), limit masks of valence 3
    np.testing.assert_allclose(np.linalg.norm(cube[20:], axis=1), np.linalg.norm(cube[20]))


def bumpy(points: np.ndarray) -> np.ndarray:
    return points * (1.5 + 0.4 * np.maximum(0, points @ [0.6, 0, 0.8]) ** 6)[:, None]


def off(points: np.ndarray, source: Surface) -> np.ndarray:
    triangle, barycentric = closest_points(points, source.vertices, source.triangles)
    feet = np.einsum("nc,ncx->nx", barycentric, source.vertices[source.triangles[triangle]])
    return np.linalg.norm(points - feet, axis=1) / np.sqrt(source.area)


def test_the_limit_of_a_wrapped_cage_lies_on_the_source() -> None:
    fine, cage = ball(1, count=3000, seed=4), ball(1, count=150, seed=5)
    source = fine.with_vertices(bumpy(fine.vertices))
    match = nearest_map(bumpy(cage.vertices), source)
    limit = limit_points(cage).limit
    plain, found = (wrap(match, source, cage, subdivided=each).vertices for each in (False, True))
    assert off(plain, source).max() < 1e-6
    before, after = off(limit @ plain, source), off(limit @ found, source)
    assert after.mean() < 0.1 * before.mean()
    assert after.max() < 0.2 * before.max()
    assert off(found, source).mean() > 10 * after.mean()
    # Without detail the limit follows the surface that the unsubdivided cage would have.
    coarse, flat = (wrap(match, source, cage, subdivided=each, detail=0).vertices for each in (True, False))
    missed = [np.linalg.norm(limit[:150] @ each - flat, axis=1).mean() for each in (coarse, flat)]
    assert missed[0] < 0.6 * missed[1]


def test_landmarks_apply_to_the_limit_and_masked_parts_stay() -> None:
    fine, cage = ball(1, count=3000, seed=4), ball(1, count=150, seed=5)
    source = fine.with_vertices(bumpy(fine.vertices))
    match = nearest_map(bumpy(cage.vertices), source)
    found = wrap(match, source, cage, subdivided=True, landmarks=([7, 100], [3, 90])).vertices
    limit = limit_points(cage).limit[:150] @ found
    assert np.abs(limit[[3, 90]] - source.vertices[[7, 100]]).max() < 1e-9
    mask = (cage.vertices[:, 2] > 0).astype(float)
    plain, masked = (wrap(match, source, cage, subdivided=each, mask=mask).vertices for each in (False, True))
    below = cage.vertices[:, 2] < -0.6
    moved = np.linalg.norm(masked - plain, axis=1)
    assert moved[below].max() < 0.5 * moved[mask > 0].mean()
