# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingers that a map sends to the wrong finger are found by the distances among their tips, and rematched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import analyse
from zoomout_core.matching.refinement import image_features
from zoomout_core.matching.refinement import repair as repair_module
from zoomout_core.matching.refinement.branches import BRANCHES, branches_of, exchange_branches
from zoomout_core.matching.refinement.repair import REPAIR, repair
from zoomout_core.samples.implicit import Ellipsoid, Limb, bounds, surface_net
from zoomout_core.tuning import retune

# Degrees of the fingers about the middle one, where they are spread and where they touch, and their lengths.
SPREAD, CLOSED = (62, 22, 0, -20, -40), (52, 8, 0, -7, -14)
LENGTHS = 0.42, 0.62, 0.7, 0.66, 0.5
# Accepted mean error of the images of a finger, in its own lengths.
NEAR = 0.1


@cache
def hand(angles: tuple[int, ...], lengths: tuple[float, ...] = LENGTHS) -> tuple[zo.Surface, np.ndarray, np.ndarray]:
    """A hand on an arm, (n,) the finger of each vertex, 0 for none, and (n,) the share of its length from its base."""
    solids: list[Limb | Ellipsoid] = [
        Ellipsoid((0.0, 0.0, 0.0), (0.42, 0.16, 0.45)),
        Limb(((0.0, 0.0, -0.3, 0.16), (0.0, 0.0, -1.6, 0.2))),
        Limb(((0.0, 0.0, -1.6, 0.2), (1.2, 0.0, -2.4, 0.25))),
    ]
    fingers = []
    for number, (angle, length) in enumerate(zip(angles, lengths, strict=True)):
        thumb = number == 0 and len(angles) == 5
        base = [-0.34, 0.0, -0.05] if thumb else [0.21 * (number + 2.5 - len(angles)), 0.0, 0.36]
        along = np.array([-np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
        fingers.append((np.array(base), base + length * along))
        solids.append(Limb(((*base, 0.085), (*fingers[-1][1], 0.075)), blend=0.01))
    vertices, faces = surface_net(0.035, solids, bounds(solids, 0.1))
    finger, share = np.zeros(len(vertices), dtype=int), np.zeros(len(vertices))
    for number, (base, end) in enumerate(fingers, start=1):
        along = (vertices - base) @ (end - base) / ((end - base) @ (end - base))
        off = np.linalg.norm(vertices - base - np.clip(along, 0, 1)[:, None] * (end - base), axis=1)
        here = (off < 0.1) & (along > 0.2)
        finger[here], share[here] = number, along[here]
    return zo.Surface(vertices, faces), finger, share


@pytest.fixture(autouse=True)
def _without_a_body() -> Iterator[None]:
    """Fingers are long for a surface that is only a hand and an arm."""
    with retune(BRANCHES, max_length=0.5):
        yield


@pytest.fixture(scope="module")
def pair() -> Pair:
    surfaces = hand(CLOSED)[0], hand(SPREAD)[0]
    return Pair(*surfaces, *(analyse(surface.working, 60, 300, 0) for surface in surfaces), 60, 5)


def send(permutation: dict[int, int]) -> zo.SurfaceMap:
    """A map from the spread hand to the closed one that is right but for some fingers, which are on another one."""
    (source, finger, share), (target, of_target, along) = hand(CLOSED), hand(SPREAD)
    vertex = cKDTree(source.vertices).query(target.vertices)[1]
    for number in range(1, 6):
        here = np.flatnonzero(of_target == number)
        there = np.flatnonzero(finger == permutation.get(number, number))
        of_source = np.column_stack([share[there], 0.2 * _normals(source, there)])
        of_target_finger = np.column_stack([along[here], 0.2 * _normals(target, here)])
        vertex[here] = there[cKDTree(of_source).query(of_target_finger)[1]]
    return zo.SurfaceMap.from_vertices(vertex, source)


def _normals(surface: zo.Surface, vertices: np.ndarray) -> np.ndarray:
    """(q, 3) normals of the working mesh, which tell the sides of a finger apart."""
    return np.asarray(surface.working.vertex_normals[surface.working.vertex_of[vertices]])


def wrong_fingers(found: zo.SurfaceMap) -> float:
    """The share of vertices of fingers whose images are on another one."""
    finger, image = hand(SPREAD)[1], hand(CLOSED)[1][found.vertex]
    both = (finger > 0) & (image > 0)
    return float((finger != image)[both].mean())


def error_along(found: zo.SurfaceMap, number: int) -> float:
    """Mean difference of the shares of a finger's length at its vertices and at their images."""
    (_, _, share), (_, finger, along) = hand(CLOSED), hand(SPREAD)
    here = (finger == number) & (along < 0.95)
    return float(np.abs(share[found.vertex[here]] - along[here]).mean())


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("permutation", [{4: 5}, {3: 2, 4: 3, 5: 4}, {2: 3, 3: 2}])
def test_swapped_fingers_are_rematched(pair: Pair, permutation: dict[int, int]) -> None:
    torn = send(permutation)
    assert wrong_fingers(torn) > 0.15
    found = repair(pair, torn)
    assert wrong_fingers(found.surface_map) < 0.01
    for number in permutation:
        assert error_along(found.surface_map, number) < NEAR
    assert found.filled.any()


def test_repair_rounds_share_their_mesh_computations(pair: Pair, monkeypatch) -> None:
    computed = []
    for module, name in (
        (image_features, "surface_samples"),
        (repair_module, "branches_of"),
        (image_features, "unique_edges"),
    ):
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given, f=function, name=name: (computed.append(name), f(*given))[1])
    assert repair(pair, send({4: 5})).filled.any()
    assert sorted(computed) == ["branches_of", "surface_samples", "unique_edges"]


def test_rematched_fingers_are_not_filled_in_from_their_bases(pair: Pair) -> None:
    wrong = send({2: 3, 3: 2})
    exchanged, bases = exchange_branches(pair, wrong, branches_of(pair))
    matched = (exchanged.triangle != wrong.triangle) & ~bases
    assert matched.mean() > 0.02
    with retune(REPAIR, small_patch=0.1, max_stretch=2.0):  # fingers count as patches, and are torn at their bases
        found = repair(pair, wrong)
    np.testing.assert_array_equal(found.surface_map.triangle[matched], exchanged.triangle[matched])


@pytest.mark.slow
def test_split_vertices_do_not_affect_rematching(pair: Pair) -> None:
    torn = send({4: 5})
    corners = [surface.triangles.ravel() for surface in (pair.source, pair.target)]
    source, target = (
        zo.Surface(surface.vertices[corner][::-1], np.arange(len(corner))[::-1].reshape(-1, 3))
        for surface, corner in zip((pair.source, pair.target), corners, strict=True)
    )
    first = np.zeros(len(pair.source.vertices), dtype=int)
    first[corners[0]] = len(corners[0]) - 1 - np.arange(len(corners[0]))
    split = Pair(source, target, *(analyse(each.working, 60, 300, 0) for each in (source, target)), 60, 5)
    given = zo.SurfaceMap.from_vertices(first[torn.vertex[corners[1][::-1]]], source)
    found = repair(split, given).surface_map.vertex
    finger, image = hand(SPREAD)[1][corners[1][::-1]], hand(CLOSED)[1][corners[0][::-1]][found]
    assert (finger != image)[(finger > 0) & (image > 0)].mean() < 0.01


def test_finger_with_a_misplaced_patch_is_rematched(pair: Pair) -> None:
    _, finger, along = hand(SPREAD)
    right, wrong = send({}), send({4: 5})
    patch = (finger == 4) & (np.abs(along - 0.7) < 0.06)
    given = zo.SurfaceMap.from_vertices(np.where(patch, wrong.vertex, right.vertex), pair.source)
    assert wrong_fingers(given) > 0.02
    found = repair(pair, given).surface_map
    assert wrong_fingers(found) < 0.005
    assert error_along(found, 4) < NEAR


def test_right_map_is_unchanged(pair: Pair) -> None:
    right = send({})
    found, unsettled = exchange_branches(pair, right, branches_of(pair))
    assert unsettled.mean() < 0.005
    assert (found.triangle == right.triangle).all()


def test_long_or_unclear_branches_and_exact_landmarks_are_kept(pair: Pair) -> None:
    given = send({4: 5})
    for change in ({"max_length": 0.01}, {"max_difference": 0.0}, {"max_siblings": 3}):
        with retune(BRANCHES, **change):
            assert not exchange_branches(pair, given, branches_of(pair))[1].any(), change
    exact = np.arange(4), np.arange(4)
    assert branches_of(replace(pair, exact_landmarks=exact)) is None


def test_pairing_is_kept_unless_another_fits_clearly_better() -> None:
    surface, finger, along = hand((15, 5, -5, -15), (0.6,) * 4)  # which looks the same from its other side
    shape = analyse(surface.working, 60, 300, 0)
    pair = Pair(surface, surface, shape, shape, 60, 5)
    mirrored = cKDTree(surface.vertices).query(surface.vertices * [-1, 1, 1])[1]
    given = zo.SurfaceMap.from_vertices(mirrored, surface)

    def fingers_of_images() -> list[int]:
        image = finger[exchange_branches(pair, given, branches_of(pair))[0].vertex]

        return [int(np.median(image[(finger == number) & (along > 0.5)])) for number in range(1, 5)]

    assert fingers_of_images() == [4, 3, 2, 1]
    with retune(BRANCHES, margin=0.0):  # the identity fits exactly
        assert fingers_of_images() == [1, 2, 3, 4]
