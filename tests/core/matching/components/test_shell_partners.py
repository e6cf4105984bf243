# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairing of shells by place, size, shape and rotation, and maps of inner shells."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from creatures import directions
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from zoomout_core.matching.components.parts import Side
from zoomout_core.matching.components.shell_images import Image, find_beneath, find_beyond, find_caps
from zoomout_core.matching.components.shell_pairs import pair_shells
from zoomout_core.mesh.surface import Surface

WHERE = directions(150, 0)
CORNERS = ConvexHull(WHERE).simplices
SIZE = 0.1
NO_TURN = (0.0, 0.0, 0.0)


def egg(
    at: tuple[float, float, float] = (0, 0, 0),
    size: float = 1.0,
    turn: tuple[float, float, float] = NO_TURN,
    radii: tuple[float, float, float] = (1.0, 0.7, 0.45),
) -> np.ndarray:
    """Points of an ellipsoid shell that is blunt on three sides."""
    points = size * SIZE * (WHERE + 0.9 * np.maximum(WHERE, 0) ** 2) * radii
    return Rotation.from_rotvec(turn).apply(points - points.mean(axis=0)) + at


def side(shells: Sequence[np.ndarray], corners: np.ndarray = CORNERS) -> Side:
    mesh = Surface.joined([Surface(points, corners) for points in shells]).working
    points = mesh.to_surface(mesh.vertices)
    return Side(mesh, points, np.ones(len(points)), np.zeros(0, dtype=np.int64))


def pair_numbers(
    target: Sequence[np.ndarray],
    source: Sequence[np.ndarray],
    regions: Sequence[tuple[int, int]] = (),
    corners: np.ndarray = CORNERS,
) -> dict[int, int]:
    """Paired shell numbers, target to source, in the given order, for a body that does not move."""
    motion: Any = SimpleNamespace(
        transform=lambda points, normals: (points, normals, np.ones(len(points))), handedness=1.0, scale=1.0
    )
    sides = side(target), side(source, corners)
    parts = [one.parts(one.points) for one in sides]
    numbers = [
        [
            int(np.argmin([np.linalg.norm(part.points.mean(axis=0) - shell.mean(axis=0)) for shell in shells]))
            for part in of_side
        ]
        for of_side, shells in zip(parts, (target, source), strict=True)
    ]
    n = len(WHERE)
    pair: Any = SimpleNamespace(regions=[(n * j + np.arange(n), n * i + np.arange(n)) for i, j in regions])
    chosen, _ = pair_shells(pair, motion, *parts, sides[1], sides[0])
    return {numbers[0][i]: numbers[1][j] for i, j in chosen}


def test_shell_is_paired_only_with_a_near_partner() -> None:
    assert pair_numbers([egg()], [egg((0.05, 0, 0))]) == {0: 0}
    for far in (0.19, 0.6):
        assert pair_numbers([egg()], [egg((far, 0, 0))]) == {}


def test_shells_of_different_size_or_shape_are_not_paired() -> None:
    assert pair_numbers([egg()], [egg(size=1.2)]) == {0: 0}
    assert pair_numbers([egg()], [egg(size=2.2)]) == {}
    assert pair_numbers([egg()], [egg(size=0.45)]) == {}
    assert pair_numbers([egg()], [egg(radii=(1.6, 0.1, 0.1))]) == {}


def test_another_mesh_of_a_shell_is_its_partner() -> None:
    where = directions(len(WHERE), 5)
    other = SIZE * (where + 0.9 * np.maximum(where, 0) ** 2) * (1.0, 0.7, 0.45)
    mesh = Surface(other - other.mean(axis=0), ConvexHull(where).simplices)
    assert pair_numbers([egg()], [egg()]) == pair_numbers([egg()], [mesh.vertices], corners=mesh.triangles) == {0: 0}


def test_nearer_of_two_equal_shells_is_paired() -> None:
    for places in ((0.02, -0.13), (-0.13, 0.02), (0.13, -0.02), (-0.02, 0.13)):
        source = [egg((0, places[0], 0)), egg((0, places[1], 0))]
        assert pair_numbers([egg()], source) == {0: int(np.argmin(np.abs(places)))}


def test_size_and_shape_decide_between_equally_near_shells() -> None:
    for other in ({"size": 1.3}, {"radii": (0.9, 0.9, 0.3)}, {"turn": (0, 0, 0.9)}):
        for first in (0, 1):
            source = [egg((0, 0.06, 0)), egg((0, -0.06, 0), **other)][:: 1 if first == 0 else -1]  # type: ignore[arg-type]
            assert pair_numbers([egg()], source) == {0: first}, other


def test_each_shell_has_one_partner() -> None:
    both = [egg(), egg((0.2, 0, 0))]
    assert pair_numbers(both, both) == {0: 0, 1: 1}
    assert pair_numbers(both, both[:1]) == {0: 0}


def test_shells_of_different_regions_are_never_paired() -> None:
    both = [egg(), egg((0.25, 0, 0))]
    assert pair_numbers(both, both, [(0, 0), (1, 1)]) == {0: 0, 1: 1}
    assert pair_numbers(both, both, [(0, 1), (1, 0)]) == {}


# --- inner shells --------------------------------------------------------------------------------------------


def beneath(radius: float, outer: bool, inner_radius: float = 0.2, in_place: bool = False) -> np.ndarray:
    """(n,) distances from the centre of the images of a ball of a radius, on two concentric balls."""
    source = side([0.3 * WHERE, inner_radius * WHERE])
    of_source = np.linalg.norm(source.points, axis=1) > 0.25
    image = find_beneath(radius * WHERE, WHERE, source, of_source, np.full(len(WHERE), outer), in_place)
    corners = source.points[source.mesh.triangles[image.triangle]]
    on = np.einsum("nc,ncx->nx", image.barycentric, corners)
    np.testing.assert_allclose(image.distance, np.linalg.norm(on - radius * WHERE, axis=1), atol=1e-9)
    return np.linalg.norm(on, axis=1)


@pytest.mark.parametrize(("radius", "where"), [(0.201, 0.2), (0.22, 0.3)])
def test_outer_vertices_in_place_stay_on_a_touching_inner_shell(radius: float, where: float) -> None:
    assert beneath(radius, outer=True, in_place=True) == pytest.approx(where, rel=0.05)
    assert beneath(radius, outer=True, in_place=False) == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("radius", [0.22, 0.28])
def test_outer_vertices_map_to_the_outside_and_inner_ones_inside(radius: float) -> None:
    assert beneath(radius, outer=True) == pytest.approx(0.3, rel=0.05)
    near = radius - 0.2 < 0.05
    assert beneath(radius, outer=False) == pytest.approx(0.2 if near else 0.3, rel=0.05)


@pytest.mark.parametrize(("onto", "beyond"), [(0.02, False), (0.08, True)])
def test_vertices_nearer_to_another_shell_are_beyond_their_partner(onto: float, beyond: bool) -> None:
    alone = side([egg()])
    part = alone.parts(alone.points)[0]
    count, where = len(part.vertices), np.tile([1.0, 0, 0], (len(part.vertices), 1))
    by_body = Image(np.ones(count, np.int64), where, np.full(count, 0.01))
    on_partner = Image(np.zeros(count, np.int64), where, np.full(count, onto))
    of_triangle = np.array([0, 1])
    assert (find_beyond(by_body, on_partner, part, 0, of_triangle, 0.045) == beyond).all()
    assert not find_beyond(by_body, on_partner, part, 1, of_triangle, 0.045).any()


def test_hull_over_an_opening_is_a_cap() -> None:
    hull = egg(size=4)
    height = hull[:, 2]
    above = CORNERS[(height > np.quantile(height, 0.3))[CORNERS].all(axis=1)]
    is_cap = find_caps(hull, side([hull], above))
    assert not is_cap[height > np.quantile(height, 0.4)].any()
    assert is_cap[height < np.quantile(height, 0.1)].all()
