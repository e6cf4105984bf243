# SPDX-License-Identifier: GPL-3.0-or-later
"""The vertices of a level are fitted to their own side of the mesh."""

from __future__ import annotations

import numpy as np

from zoomout_core.assets.fit_level import Places, fit_level
from zoomout_core.mesh.triangles import vertex_normals

THICKNESS = 0.02


def plate(count: int) -> tuple[np.ndarray, np.ndarray]:
    """The two sides of a plate on the unit square, of count x count vertices each, and their triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count), indexing="ij")
    top = np.column_stack([x.ravel(), y.ravel(), np.full(count**2, THICKNESS / 2)])
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    upper = np.concatenate(
        [
            np.column_stack([corner, corner + count, corner + 1]),
            np.column_stack([corner + 1, corner + count, corner + count + 1]),
        ]
    )
    return np.concatenate([top, top * [1, 1, -1]]), np.concatenate([upper, upper[:, ::-1] + count**2])


def test_the_sides_of_a_thin_sheet_are_not_exchanged() -> None:
    """The upper side of the level begins below the lower one, to which the upper side of the mesh is closer."""
    points, faces = plate(20)
    vertices, triangles = plate(5)
    vertices[:25, 2] -= 1.2 * THICKNESS
    places = Places(points, vertex_normals(points, faces), np.zeros(len(points), dtype=int), [])
    fitted = fit_level(vertices, triangles, np.zeros(len(vertices), dtype=int), [], places, 4)
    np.testing.assert_allclose(fitted[:25, 2], THICKNESS / 2, atol=0.1 * THICKNESS)
    np.testing.assert_allclose(fitted[25:, 2], -THICKNESS / 2, atol=0.1 * THICKNESS)
