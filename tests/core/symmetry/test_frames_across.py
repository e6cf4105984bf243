# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror displacements, shapes and layouts of a small shape, and measure their asymmetry."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from butterfly import EVEN, MIRROR, grid, mirrored_vertex, self_map
from transfer_meshes import nearest_map

import zoomout_core as zo
from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.preparation.analysis import analyse
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import outward_hull
from zoomout_core.symmetry import detect
from zoomout_core.symmetry.detect import _sort_key, find_candidates, isometry_errors
from zoomout_core.symmetry.offsets import frames, mirror_offsets, shape_asymmetry, symmetrise_offsets
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.symmetry.uv import symmetrise_uv


def egg(scale: float = 1.0) -> SelfMap:
    """A surface with exact mirror symmetry, vertex by vertex."""
    triangles = outward_hull(EVEN)
    surface = Surface(scale * EVEN * [1, 0.8, 1.3], triangles)
    shape = analyse(surface.working, 100, 150, 0)
    return replace(self_map(surface), prepared=shape)


@pytest.fixture(scope="module")
def mirror() -> SelfMap:
    return egg()


def test_frames_of_an_exact_mirror_equal_the_mirror(mirror: SelfMap) -> None:
    found = frames(mirror)
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.broadcast_to(np.eye(3), found.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(found), -1)
    off = np.linalg.norm(found - np.diag(MIRROR), axis=(1, 2))
    assert np.median(off) < 0.05
    assert off.max() < 0.5


def half_turn_symmetry(mirror: SelfMap) -> tuple[SelfMap, np.ndarray]:
    """The half turn of the egg about z to the nearest points, and its diagonal (3,)."""
    half_turn = np.array([-1.0, -1, 1])
    there = nearest_map(mirror.surface.vertices * half_turn, mirror.surface)
    return replace(mirror, surface_map=there, reverses_orientation=False), half_turn


def test_frames_of_a_half_turn_equal_the_half_turn(mirror: SelfMap) -> None:
    symmetry, half_turn = half_turn_symmetry(mirror)
    found = frames(symmetry)
    np.testing.assert_allclose(np.linalg.det(found), 1)
    off = np.linalg.norm(found - np.diag(half_turn), axis=(1, 2))
    assert np.median(off) < 0.1
    assert np.median(shape_asymmetry(symmetry)) < 0.02


def test_candidates_that_reverse_orientation_are_recognised(mirror: SelfMap, monkeypatch: pytest.MonkeyPatch) -> None:
    shape, (symmetry, _) = mirror.shape, half_turn_symmetry(mirror)
    images = mirror.surface_map.vertex, symmetry.surface_map.vertex, np.arange(len(EVEN))
    hypotheses = [Hypothesis("", functional_map_of(image, shape.basis, shape.basis, 20, 20)) for image in images]
    monkeypatch.setattr(detect, "GENERATORS", (lambda _: hypotheses,))
    found = find_candidates(shape)
    reached = []
    for one in found:
        places = shape.mesh.vertices[shape.search.samples]
        linear = np.linalg.lstsq(places, places[one.sample_map], rcond=None)[0]
        reached.append((one.reverses_orientation, tuple(np.sign(np.diag(linear)).astype(int))))
    # The identity, one of the hypotheses, is excluded.
    assert sorted(reached) == [(False, (-1, -1, 1)), (True, (-1, 1, 1))]


def test_unused_vertices_take_the_frame_of_the_nearest_vertex(mirror: SelfMap) -> None:
    near, surface = np.array([3, 70]), mirror.surface
    # Uneven, so that frames differ between vertices.
    uneven = surface.vertices * (1 + 0.3 * EVEN[:, :1] * EVEN[:, 1:2])
    more = Surface(np.vstack([uneven, 1.001 * uneven[near], [[np.nan] * 3]]), surface.triangles)
    shape = analyse(more.working, 100, 150, 0)
    image = np.append(mirrored_vertex(surface), [0, 0, 0])
    loose = replace(
        mirror,
        surface=more,
        surface_map=SurfaceMap.from_vertices(image, more),
        prepared=shape,
        distance=np.append(mirror.distance, [0, 0, 0]),
    )
    found = frames(loose)
    np.testing.assert_allclose(found[len(EVEN) : len(EVEN) + 2], found[near], atol=1e-12)
    assert np.linalg.norm(found[:-3] - found[near[0]], axis=(1, 2)).max() > 0.05


def test_displacements_are_mirrored_in_every_direction(mirror: SelfMap) -> None:
    offsets = np.random.default_rng(0).normal(size=(len(EVEN), 1)) * EVEN + [0.1, 0.2, -0.3]
    truth = (offsets * MIRROR)[mirrored_vertex(mirror.surface)]
    other = mirror_offsets(offsets, mirror)
    assert np.linalg.norm(other - truth, axis=1).mean() < 0.05 * np.linalg.norm(truth, axis=1).mean()
    left, right = EVEN[:, 0] > 1e-9, EVEN[:, 0] < -1e-9
    taken = symmetrise_offsets(offsets, mirror, "left_to_right")
    np.testing.assert_array_equal(taken[left], offsets[left])
    np.testing.assert_allclose(taken[right], other[right])
    np.testing.assert_allclose(symmetrise_offsets(offsets, mirror, "average"), (offsets + other) / 2)
    np.testing.assert_allclose(symmetrise_offsets(offsets, mirror, "exchange"), other)


def test_asymmetry_of_a_dent_is_its_depth_on_both_sides() -> None:
    for scale in (1.0, 100.0):
        even = egg(scale)
        assert shape_asymmetry(even).max() < 1e-3 * scale
        at = np.array([0.8, 0.6, 0])
        near, mirrored = (np.linalg.norm(EVEN - place, axis=1) for place in (at, at * MIRROR))
        dent = 0.15 * np.exp(-((near / 0.3) ** 2))
        dented = even.surface.with_vertices(even.surface.vertices * (1 - dent[:, None]))
        shape = analyse(dented.working, 100, 150, 0)
        heat = shape_asymmetry(replace(even, surface=dented, prepared=shape)) / scale
        for distance in (near, mirrored):
            assert 0.4 * dent.max() < heat[distance < 0.2].max() < 1.3 * dent.max()
        assert np.median(heat[(near > 0.9) & (mirrored > 0.9)]) < 0.1 * dent.max()


def test_isometry_errors_cover_the_whole_map_and_its_low_block() -> None:
    eigenvalues = np.arange(40.0)
    exact = isometry_errors(np.eye(40), eigenvalues)
    assert max(exact.values()) < 1e-9
    assert set(exact) == {f"{low}{name}" for low in ("", "low ") for name in ("commutativity", "orthonormality")}
    high = np.eye(40)
    high[30:35, 30:35] = np.random.default_rng(0).normal(size=(5, 5))
    found = isometry_errors(high, eigenvalues)
    assert min(found["commutativity"], found["orthonormality"]) > 1e-3
    assert max(found["low commutativity"], found["low orthonormality"]) < 1e-9


def test_certain_symmetries_are_ordered_by_the_area_without_a_partner() -> None:
    surface = grid(10, 2)

    def symmetry(certainty: float, alone: float) -> zo.Symmetry:
        confidence = np.where(surface.vertices[:, 0] < alone * 2.4 - 1.2, 0.0, 1.0)
        return cast(zo.Symmetry, SimpleNamespace(surface=surface, confidence=confidence, certainty=certainty))

    expected = [symmetry(*each) for each in ((0.985, 0.2), (0.999, 0.5), (0.9, 0.0), (0.3, 0.0))]
    shuffled = [expected[number] for number in (3, 1, 2, 0)]
    assert sorted(shuffled, key=_sort_key) == expected


# --- layouts ------------------------------------------------------------------------------------------------


SURFACE = grid(12, 4)
SYMMETRY = self_map(SURFACE)
CORNERS = SURFACE.vertices[SURFACE.corner_vertex, :2]
LEFT = (SURFACE.vertices[SURFACE.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, 0] > 0).repeat(4)


def symmetric_uvs(values: np.ndarray, layout: str, direction: str = "left_to_right") -> np.ndarray:
    attribute = zo.Attribute("UVMap", zo.Domain.CORNER, zo.Kind.UV, values)
    return symmetrise_uv(attribute, SYMMETRY, direction, layout).values  # type: ignore[arg-type]


def test_over_layout_places_one_side_over_the_other() -> None:
    own = np.where(LEFT[:, None], CORNERS / 5, CORNERS / 7 + 3)
    np.testing.assert_allclose(symmetric_uvs(own, "over"), CORNERS * np.where(LEFT[:, None], 1, [-1, 1]) / 5, atol=1e-9)
    found = symmetric_uvs(own, "over", "right_to_left")
    np.testing.assert_allclose(found, CORNERS * np.where(LEFT[:, None], [-1, 1], 1) / 7 + 3, atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("flip", [1, -1])
def test_side_with_the_same_layout_elsewhere_stays_there(turn: float, flip: int) -> None:
    # The right layout is the left one, rotated, halved in size, perhaps mirrored, and moved.
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ np.diag([flip, 1])
    there = 0.5 * (CORNERS * [-1, 1]) @ rotation.T + [8, 3]
    own = np.where(LEFT[:, None], CORNERS, there)
    np.testing.assert_allclose(symmetric_uvs(own, "own"), own, atol=1e-9)
    # One corner of the right side was moved by hand.
    moved = own.copy()
    one = np.flatnonzero(~LEFT & (np.abs(CORNERS[:, 0] + 0.8) < 1e-9) & (np.abs(CORNERS[:, 1] - 0.5) < 1e-9))
    moved[one] += 0.05
    found = symmetric_uvs(moved, "own")
    assert np.abs(found - own).max() < 0.015


def test_several_islands_each_keep_their_place() -> None:
    row = SURFACE.vertices[SURFACE.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, 1].repeat(4)
    upper = (row > 0.5)[:, None]
    left = CORNERS + np.where(upper, [3, 1], 0)
    right = CORNERS * [-1, 1] + np.where(upper, [9, 5], [9, 0])
    own = np.where(LEFT[:, None], left, right)
    np.testing.assert_allclose(symmetric_uvs(own, "own"), own, atol=1e-9)


def test_face_torn_off_an_island_is_reattached() -> None:
    own = np.where(LEFT[:, None], CORNERS, CORNERS * [-1, 1] + [9, 0])
    torn = own.copy()
    torn[4 * 9 : 4 * 9 + 4] += 50
    assert not LEFT[4 * 9]
    np.testing.assert_allclose(symmetric_uvs(torn, "own"), own, atol=1e-9)


def test_island_without_extent_is_placed_over_the_other_side() -> None:
    own = np.where(LEFT[:, None], CORNERS, 4.0)
    np.testing.assert_allclose(symmetric_uvs(own, "own"), symmetric_uvs(own, "over"), atol=1e-9)
    small = np.where(LEFT[:, None], CORNERS, 4 + 0.01 * CORNERS * [-1, 1])
    np.testing.assert_allclose(symmetric_uvs(small, "own"), small, atol=1e-9)


def test_corners_shared_with_the_winning_side_stay_in_place() -> None:
    # One island on both sides; the right half is stretched away from the line.
    whole = np.column_stack([np.where(CORNERS[:, 0] < 0, 1.3 * CORNERS[:, 0], CORNERS[:, 0]), CORNERS[:, 1]])
    found = symmetric_uvs(whole, "own")
    on_line = np.abs(CORNERS[:, 0]) < 1e-9
    np.testing.assert_allclose(found[on_line], whole[on_line])
    # Corners next to the line stay near it, although the best fit to the rest would move them away.
    beside = np.abs(CORNERS[:, 0] + 0.2) < 1e-9
    assert np.abs(found[beside] - CORNERS[beside])[:, 0].max() < 0.05
    far = np.abs(CORNERS[:, 0] + 1.2) < 1e-9
    assert (found[far, 0] < -1.25).all()
