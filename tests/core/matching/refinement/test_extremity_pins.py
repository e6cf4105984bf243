# SPDX-License-Identifier: GPL-3.0-or-later
"""A map that falls short of several limbs' tips is stretched to them, if the map back reaches them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from creatures import creature, true_vertex

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.refinement.extremity_pins import PINS, _pair, pin_extremities
from zoomout_core.matching.registration.nonrigid_icp import fit_nonrigid
from zoomout_core.samples import BODY, LIMBS
from zoomout_core.samples.spheres import ball
from zoomout_core.tuning import retune

LEGS = 2, 3
# The parts of these legs that the map reaches.
REACHED = 0.5, 0.5


@pytest.fixture(autouse=True)
def _coarse_meshes() -> Iterator[None]:
    """Edges at the tips of the limbs are longer than on animals."""
    with retune(PINS, max_miss=0.12):
        yield


@cache
def shapes() -> tuple[ShapeAnalysis, ShapeAnalysis]:
    """The shapes of two meshes of one creature."""
    source, target = (analyse(creature(2000, seed).surface.working.part(0)[0], 60, 500, 0, None) for seed in (0, 1))
    return source, target


@cache
def true_maps() -> tuple[SurfaceMap, SurfaceMap]:
    """The map of the target's mesh to the source's, and the map back."""
    made = creature(2000, 0), creature(2000, 1)
    vertices = true_vertex(*made), true_vertex(*made[::-1])
    maps = (SurfaceMap.from_vertices(vertex, each.surface) for vertex, each in zip(vertices, made, strict=True))
    there, back = (
        SurfaceMap(each.triangle, each.barycentric, shape.mesh.triangles)
        for each, shape in zip(maps, shapes(), strict=True)
    )
    return there, back


def short_map(reached: tuple[float, ...] = REACHED) -> tuple[SurfaceMap, Booleans]:
    """The map of the target's mesh whose images reach parts of some legs, and (n_t,) the vertices of these."""
    source, target = shapes()
    scale = np.abs(target.mesh.vertices).max() / np.abs(creature(2000, 1).surface.vertices).max()
    there, short = true_maps()[0].vertex.copy(), np.zeros(len(target.mesh.vertices), dtype=bool)
    for leg, part in zip(LEGS, reached, strict=False):
        axis = LIMBS[leg] / np.linalg.norm(LIMBS[leg])
        along = target.mesh.vertices @ axis - BODY * scale
        here = (along > 0) & (np.linalg.norm(np.cross(target.mesh.vertices, axis), axis=1) < 0.6 * scale)
        places = target.mesh.vertices[here] - (1 - part) * along[here, None] * axis
        there[here] = np.linalg.norm(places[:, None] - source.mesh.vertices[None], axis=2).argmin(axis=1)
        short |= here
    found = SurfaceMap.from_vertices(there, creature(2000, 0).surface)
    return SurfaceMap(found.triangle, found.barycentric, source.mesh.triangles), short


def errors(surface_map: SurfaceMap) -> Floats:
    """(n_t,) distances of images from the true ones, at unit area."""
    vertices = shapes()[0].mesh.vertices
    return np.linalg.norm(surface_map.interpolate(vertices) - true_maps()[0].interpolate(vertices), axis=1)


def test_images_of_a_limb_are_stretched_to_its_tip() -> None:
    (source, target), (short, leg), back = shapes(), short_map(), true_maps()[1]
    pinned = pin_extremities(short, back, source, target)
    assert pinned is not None
    stretched, pins = pinned
    assert len(pins.vertex) > len(LEGS)  # the tips that the map reaches stay
    assert errors(stretched)[leg].mean() < 0.6 * errors(short)[leg].mean()
    far = np.linalg.norm(target.mesh.vertices - target.mesh.vertices[leg].mean(axis=0), axis=1) > 1
    np.testing.assert_array_equal(stretched.vertex[far], short.vertex[far])
    np.testing.assert_allclose(pins.goal, true_maps()[0].interpolate(source.mesh.vertices)[pins.vertex], atol=0.08)


def test_map_that_reaches_all_tips_is_kept() -> None:
    assert pin_extremities(*true_maps(), *shapes()) is None


def test_map_of_a_shape_without_extremities_is_kept() -> None:
    surface = ball(1.0, count=400, seed=0)
    shape = analyse(surface.working.part(0)[0], 60, 200, 0, None)
    same = SurfaceMap.from_vertices(np.arange(400), surface)
    assert pin_extremities(same, same, shape, shape) is None


def test_map_that_falls_short_of_a_single_tip_is_kept() -> None:
    assert pin_extremities(short_map(REACHED[:1])[0], true_maps()[1], *shapes()) is None


def test_map_that_falls_far_short_of_one_tip_is_stretched_to_another_that_it_nearly_reaches() -> None:
    assert pin_extremities(short_map((0.5, 0.85))[0], true_maps()[1], *shapes()) is not None


def test_map_that_falls_slightly_short_of_two_tips_is_kept() -> None:
    assert pin_extremities(short_map((0.8, 0.8))[0], true_maps()[1], *shapes()) is None


def test_tip_that_neither_map_reaches_is_not_pinned() -> None:
    # The map back takes all of the source to one vertex of its body.
    body = SurfaceMap.from_vertices(np.zeros(2000, dtype=int), creature(2000, 1).surface)
    back = SurfaceMap(body.triangle, body.barycentric, shapes()[1].mesh.triangles)
    pinned = pin_extremities(short_map()[0], back, *shapes())
    assert pinned is None


@pytest.mark.parametrize(
    ("missed", "missed_back", "paired"),
    [
        ([[0.3, 2.0], [2.0, 0.0]], [[0.0, 2.0], [2.0, 0.0]], [True, True]),
        ([[0.3, 2.0], [2.0, 0.0]], [[0.2, 2.0], [2.0, 0.0]], [False, True]),  # neither map pairs the first ones
        ([[0.7, 2.0], [2.0, 0.0]], [[0.0, 2.0], [2.0, 0.0]], [False, True]),  # the map leads to another limb
        ([[0.0, 0.05], [0.4, 0.4]], [[0.0, 0.3], [0.4, 0.4]], [True, False]),  # two tips near one of the source
    ],
)
def test_extremities_are_partners_if_one_map_pairs_them(
    missed: list[list[float]], missed_back: list[list[float]], paired: list[bool]
) -> None:
    partner, found = _pair(np.array(missed), np.array(missed_back))
    assert found.tolist() == paired
    assert partner[found].tolist() == np.arange(2)[found].tolist()


def test_fit_is_drawn_to_pins() -> None:
    (source, target), (short, _), back = shapes(), short_map(), true_maps()[1]
    pinned = pin_extremities(short, back, source, target)
    assert pinned is not None
    stretched, pins = pinned
    off = [
        np.linalg.norm(fit_nonrigid(stretched, source, target, False, each).positions[pins.vertex] - pins.goal, axis=1)
        for each in (pins, None)
    ]
    assert off[0].mean() < 0.5 * off[1].mean()
