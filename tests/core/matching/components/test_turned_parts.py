# SPDX-License-Identifier: GPL-3.0-or-later
"""Loose parts that move by themselves, such as a head, and small parts on them."""

from __future__ import annotations

import numpy as np
import pytest
from loose_parts import RADIUS, egg, map_parts, pair_around_body
from scipy.spatial.transform import Rotation

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

NECK = np.array([0, 0, 1.2 * RADIUS])


def head(angle: float = 0.0, seed: int = 0, eyes: bool = True) -> list[Surface]:
    """A head that is turned about the neck by an angle in degrees, and two small eyes on it."""
    points, triangles = egg((0.14, 0.1, 0.12), seed)
    places = (np.array([0.12, side * 0.07, 0.05]) for side in (-1, 1))
    parts = [Surface(points, triangles), *(ball(0.02, tuple(place), count=40) for place in places if eyes)]
    turn = Rotation.from_euler("z", angle, degrees=True)
    return [Surface(turn.apply(part.vertices + np.array([0, 0, 0.15])) + NECK, part.triangles) for part in parts]


@pytest.mark.parametrize("angle", [0.0, 35.0, 50.0])
def test_head_that_turns_and_the_eyes_on_it_map_to_their_places(angle: float) -> None:
    pair = pair_around_body(head(), head(angle, seed=1))
    found = map_parts(pair)
    assert (found.paired, found.alone, found.left) == (3, 0, 0)
    source, target = (surface.working for surface in (pair.source, pair.target))
    corners = source.to_surface(source.vertices)[source.triangles[found.image.triangle]]
    images = np.einsum("nc,ncx->nx", found.image.barycentric, corners)
    seen = target.to_surface(target.vertices)[found.image.vertices]
    wanted = Rotation.from_euler("z", -angle, degrees=True).apply(seen - NECK) + NECK
    assert np.linalg.norm(images - wanted, axis=1).mean() < 0.01


def test_a_part_without_a_similar_one_follows_the_body() -> None:
    points, triangles = egg((0.3, 0.05, 0.05))
    found = map_parts(pair_around_body(head(eyes=False), [Surface(points + NECK + [0.5, 0, 0.3], triangles)]))
    assert found.paired == 0
