# SPDX-License-Identifier: GPL-3.0-or-later
"""The right map is among a few initial hypotheses; round shapes get more hypotheses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import trimesh
from butterfly import MIRROR
from creatures import creature, directions
from scipy.spatial import ConvexHull

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.grids import ring_faces, triangles_of
from zoomout_core.symmetry.hypotheses import (
    _choices,
    blocks_of_eigenfunctions,
    mirroring_descriptors,
    mirroring_pairings,
    turning_pairings,
)

COUNT = 6


def analyse_surface(surface: Surface) -> ShapeAnalysis:
    return analyse(surface.working, 130, 400, 0)


def mirror_of(shape: ShapeAnalysis, places: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Functional map of the mirror of a shape whose vertices correspond to places (n, 3) on the sphere."""
    triangle, weights = closest_points(places * MIRROR, places, triangles)
    images = np.einsum("nc,nck->nk", weights, shape.basis.eigenvectors[triangles[triangle]])
    return shape.basis.coefficients(images)


@pytest.fixture(scope="module")
def animal() -> tuple[ShapeAnalysis, np.ndarray]:
    """A creature, and the functional map of its mirror."""
    made = creature(500)
    shape = analyse_surface(made.surface)
    return shape, mirror_of(shape, made.directions, made.surface.triangles)


@pytest.fixture(scope="module")
def stone() -> tuple[ShapeAnalysis, np.ndarray]:
    """A stone without limbs, with left-right symmetry only, and the functional map of its mirror."""
    places = directions(400, seed=2)
    _, y, z = places.T
    radius = 1 + 0.25 * z + 0.2 * y * z + 0.15 * y
    surface = Surface(places * radius[:, None] * [1, 0.75, 0.55], ConvexHull(places).simplices)
    shape = analyse_surface(surface)
    return shape, mirror_of(shape, places, surface.triangles)


def column(sides: int) -> Surface:
    """A tapering, fluted, upright column."""
    turn = np.linspace(0, 2 * np.pi, 8 * sides, endpoint=False)
    rim = 1 + 0.3 * np.cos(sides * turn)
    rings = [np.column_stack([r * rim * np.cos(turn), r * rim * np.sin(turn), 0 * turn + z]) for z, r in PROFILE]
    vertices = np.concatenate([*rings, [[0, 0, PROFILE[0][0]], [0, 0, PROFILE[-1][0]]]])
    n, m = len(turn), len(PROFILE)
    k, bottom, top = np.arange(n), np.full(n, n * m), np.full(n, n * m + 1)
    caps = [
        np.stack([bottom, (k + 1) % n, k], axis=1),
        np.stack([top, (m - 1) * n + k, (m - 1) * n + (k + 1) % n], axis=1),
    ]
    return Surface(vertices, np.concatenate([triangles_of(ring_faces(m, n)), *caps]))


PROFILE = [(z, 1.0 - 0.25 * z + 0.1 * np.sin(4 * z)) for z in np.linspace(0, 2.6, 12)]


def closeness(hypotheses: list[Hypothesis], truth: np.ndarray) -> list[float]:
    """Relative distance of each hypothesis from the true map of the first functions."""
    k = COUNT
    return [
        float(np.linalg.norm(hypothesis.functional_map[:k, :k] - truth[:k, :k]) / np.linalg.norm(truth[:k, :k]))
        for hypothesis in hypotheses
    ]


def test_pairings_of_tips_include_the_mirror_of_an_animal(animal: tuple[ShapeAnalysis, np.ndarray]) -> None:
    shape, truth = animal
    assert min(closeness(mirroring_pairings(shape), truth)) < 0.35


def test_blocks_include_the_mirror_of_a_stone(stone: tuple[ShapeAnalysis, np.ndarray]) -> None:
    shape, truth = stone
    assert min(closeness(blocks_of_eigenfunctions(shape), truth)) < 0.35


def test_mirroring_pairings_are_nearly_involutions(animal: tuple[ShapeAnalysis, np.ndarray]) -> None:
    shape, _ = animal
    for hypothesis in mirroring_pairings(shape):
        block = hypothesis.functional_map
        assert np.linalg.norm(block @ block - np.eye(len(block))) < np.linalg.norm(np.eye(len(block)))


def test_blocks_are_orthogonal_distinct_and_few(animal: tuple[ShapeAnalysis, np.ndarray]) -> None:
    shape, _ = animal
    maps = [hypothesis.functional_map for hypothesis in blocks_of_eigenfunctions(shape)]
    assert 2 <= len(maps) <= 8
    for i, one in enumerate(maps):
        assert len(one) == COUNT + 1  # including the constant function
        np.testing.assert_allclose(one @ one.T, np.eye(len(one)), atol=1e-9)
        assert all(np.linalg.norm(one - other) > 0.5 * np.linalg.norm(other) for other in maps[:i])


def rotation_map(shape: ShapeAnalysis, angle: float, mirrored: bool = False) -> np.ndarray:
    """Functional map of a rotation about z, or of a mirror through the z axis."""
    vertices = shape.mesh.vertices
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]) @ np.diag([1, -1 if mirrored else 1, 1])
    image = np.linalg.norm((vertices @ turn.T)[:, None] - vertices, axis=2).argmin(axis=1)
    return shape.basis.coefficients(shape.basis.eigenvectors[image])


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("sides", [4, 5])
def test_blocks_include_rotations_and_mirrors_of_round_shapes(sides: int) -> None:
    shape = analyse_surface(column(sides))
    maps = blocks_of_eigenfunctions(shape)
    assert 8 < len(maps) <= 12
    for mirrored in (False, True):
        assert min(closeness(maps, rotation_map(shape, 2 * np.pi / sides, mirrored))) < 0.5


def test_blocks_of_a_cube_permute_its_axes() -> None:
    box = trimesh.creation.box().subdivide().subdivide().subdivide()
    shape = analyse_surface(Surface(box.vertices, box.faces))
    maps = [hypothesis.functional_map[1:4, 1:4] for hypothesis in blocks_of_eigenfunctions(shape)]
    # In each three-dimensional eigenspace a symmetry of the cube is a signed permutation of the axes.
    axes = np.linalg.lstsq(shape.basis.eigenvectors[:, 1:4], shape.mesh.vertices, rcond=None)[0]
    axes /= np.linalg.norm(axes, axis=0)
    orders = set()
    for block in maps:
        permuted = axes.T @ block @ axes
        nearest = np.rint(permuted)
        if np.linalg.norm(permuted - nearest) < 0.5:
            np.testing.assert_array_equal(np.abs(nearest).sum(axis=0), 1)
            orders.add(tuple(np.abs(nearest).argmax(axis=0)))
    assert len(orders) > 1


@pytest.mark.parametrize(("size", "count"), [(1, 2), (2, 16), (3, 48)])
def test_choices_for_an_eigenspace_are_distinct_and_half_mirror(size: int, count: int) -> None:
    choices = np.stack(_choices(size))
    assert choices.shape == (count, size, size)
    np.testing.assert_allclose(choices @ choices.transpose(0, 2, 1), np.tile(np.eye(size), (count, 1, 1)), atol=1e-12)
    assert np.linalg.det(choices).round().sum() == 0
    apart = np.linalg.norm(choices[:, None] - choices, axis=(2, 3))
    assert apart[~np.eye(count, dtype=bool)].min() > 0.1


def test_descriptor_fits_are_closer_to_the_mirror(stone: tuple[ShapeAnalysis, np.ndarray]) -> None:
    shape, truth = stone
    found = mirroring_descriptors(shape)
    identity = np.eye(len(truth))
    assert found
    assert min(closeness(found, truth)) < min(closeness(found, identity))


def test_a_mesh_with_few_functions_has_smaller_blocks(stone: tuple[ShapeAnalysis, np.ndarray]) -> None:
    shape = stone[0]
    few = analyse(shape.proxy.full, 10, 200, 0)
    maps = [hypothesis.functional_map for hypothesis in blocks_of_eigenfunctions(few)]
    assert len(maps) > 1
    assert all(2 <= len(block) <= 5 for block in maps)


def test_rotations_are_searched_only_if_eigenvalues_repeat(
    animal: tuple[ShapeAnalysis, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    shape, _ = animal
    assert turning_pairings(shape) == []
    apart, pair = np.arange(13.0) ** 1.5, [3.0, 3.001]

    def asked(eigenvalues: np.ndarray) -> bool:
        found: list[object] = []
        monkeypatch.setattr(
            "zoomout_core.symmetry.hypotheses.extremity_hypotheses", lambda *_, **__: found.append(True) or []
        )
        turning_pairings(cast(ShapeAnalysis, SimpleNamespace(basis=SimpleNamespace(eigenvalues=eigenvalues))))
        return bool(found)

    assert not asked(apart)
    assert not asked(np.sort(np.concatenate([apart[:12], pair[:1]])))
    one_pair, two_pairs = apart.copy(), apart.copy()
    one_pair[4] = 1.001 * one_pair[3]
    two_pairs[[4, 7]] = 1.001 * two_pairs[[3, 6]]
    assert not asked(one_pair)
    assert asked(two_pairs)
    far_up = np.arange(30.0) ** 1.5
    far_up[[20, 25]] = 1.001 * far_up[[19, 24]]
    assert not asked(far_up)
    for last, within in ((12, True), (13, False)):
        up_to = np.arange(30.0) ** 1.5
        up_to[[4, last]] = 1.001 * up_to[[3, last - 1]]
        assert asked(up_to) == within
    # Four nearly equal eigenvalues are more than a rotation explains.
    four = apart.copy()
    four[3:7] = four[3] * np.array([1, 1.001, 1.002, 1.003])
    assert asked(four)
