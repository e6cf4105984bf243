# SPDX-License-Identifier: GPL-3.0-or-later
"""Boundary loops are found and attracted to similar loops nearby; the rest follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loose_parts import part_of, sheet

from zoomout_core.matching.components.boundary_loops import boundary_loops, loops_on_loops
from zoomout_core.matching.components.parts import Part
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.grids import ring_faces
from zoomout_core.samples.spheres import ball

AROUND, ALONG = 24, 30


def tube(radius: float = 0.1, length: float = 1.0) -> Surface:
    """A tube along z, open at both ends, with the lower end at zero."""
    turn, along = (axis.ravel() for axis in np.meshgrid(np.arange(AROUND) * 2 * np.pi / AROUND, np.arange(ALONG)))
    points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), length * along / (ALONG - 1)])
    return Surface(points, ring_faces(ALONG, AROUND))


TUBE = part_of(tube())
AT = TUBE.points[:, 2]


def stretch_upper_end(part: Part, at_end: float) -> Part:
    """A part that a map has stretched along z, by `at_end` at its upper end."""
    return replace(part, points=part.points * (1, 1, 1 + at_end))


def test_a_tube_has_a_loop_at_either_end() -> None:
    low, high = sorted(boundary_loops(TUBE), key=lambda loop: loop.centre[2])
    for loop, z in ((low, 0.0), (high, 1.0)):
        np.testing.assert_array_equal(np.sort(loop.vertices), np.flatnonzero(np.isclose(AT, z)))
        np.testing.assert_allclose(loop.centre, [0, 0, z], atol=1e-12)
        assert loop.size == pytest.approx(0.1, rel=0.02)


def test_the_points_of_a_loop_cover_its_edges() -> None:
    (loop,) = boundary_loops(part_of(sheet(1.0, count=4)))
    np.testing.assert_allclose(np.abs(loop.along[:, :2]).max(axis=1), 0.5, atol=1e-12)
    step, one = np.linspace(-0.5, 0.5, 33), np.full(33, 0.5)
    border = np.vstack([np.column_stack(side) for side in ((step, one), (step, -one), (one, step), (-one, step))])
    gap = np.linalg.norm(border[:, None] - loop.along[:, :2], axis=2).min(axis=1)
    # Points are a quarter of an edge apart, so that none is off by more than an eighth.
    assert gap.max() < 0.126 * 0.25
    assert gap.mean() < 0.1 * 0.25


def test_centre_and_size_of_a_loop_are_weighted_by_length() -> None:
    # A square with one side of many edges.
    x = np.linspace(0, 1, 30)
    points = np.vstack([[[0.5, 1, 0]], np.column_stack([x, 0 * x, 0 * x]), [[1, 1, 0], [0, 1, 0]]])
    corners = [[0, i, i + 1] for i in range(1, 31)] + [[0, 32, 1]]
    (loop,) = boundary_loops(part_of(Surface(points, corners)))
    np.testing.assert_allclose(loop.centre, [0.5, 0.5, 0], atol=1e-9)
    assert loop.size == pytest.approx(np.sqrt((0.5**2 + 3 * 0.25 * 1 / 12 + 0.0) * 1.0), rel=0.12)


def test_closed_part_has_no_loops_and_stays() -> None:
    closed = part_of(ball(0.1))
    assert boundary_loops(closed) == []
    for part, partner in ((TUBE, closed), (closed, TUBE)):
        np.testing.assert_array_equal(loops_on_loops(part, partner), part.points)


@pytest.mark.parametrize(("off", "drawn"), [(0.05, True), (-0.12, True), (0.2, False), (-0.3, False)])
def test_loop_is_attracted_only_to_a_near_loop(off: float, drawn: bool) -> None:
    found = loops_on_loops(stretch_upper_end(TUBE, off), TUBE)
    goal = 1.0 if drawn else 1 + off
    np.testing.assert_allclose(found[np.isclose(AT, 1)][:, 2], goal, atol=1e-3)
    np.testing.assert_allclose(found[np.isclose(AT, 0)], TUBE.points[np.isclose(AT, 0)], atol=0.01)


@pytest.mark.parametrize(("radius", "drawn"), [(0.13, True), (0.08, True), (0.17, False), (0.06, False)])
def test_loop_is_attracted_only_to_a_loop_of_similar_size(radius: float, drawn: bool) -> None:
    found = loops_on_loops(TUBE, part_of(tube(radius)))
    ends = np.isclose(AT, 1) | np.isclose(AT, 0)
    np.testing.assert_allclose(np.linalg.norm(found[ends, :2], axis=1), radius if drawn else 0.1, rtol=0.02)


def test_displacement_decays_away_from_the_loops() -> None:
    moved = (loops_on_loops(replace(TUBE, points=TUBE.points - [0.03, 0, 0]), TUBE) - TUBE.points)[:, 0] + 0.03
    order = np.argsort(AT)
    ends, middle = moved[np.isclose(AT, 1)].mean(), moved[np.abs(AT - 0.5) < 0.05].mean()
    assert ends == pytest.approx(0.03, abs=0.003)
    assert 0.1 < middle / ends < 0.9
    below = moved[order][: len(order) // 2].reshape(-1, AROUND).mean(axis=1)
    assert (np.diff(below) < 0).all()


def test_only_the_nearest_of_two_loops_is_attracted() -> None:
    # A short tube with both ends near the lower end of the other tube.
    short = part_of(tube(length=0.1))
    z = short.points[:, 2]
    found = loops_on_loops(replace(short, points=short.points + np.array([0, 0, 0.02])), TUBE)[:, 2]
    np.testing.assert_allclose(found[np.isclose(z, 0)], 0, atol=2e-3)
    assert found[np.isclose(z, 0.1)].min() > 0.09


def test_tube_on_its_partner_stays() -> None:
    np.testing.assert_allclose(loops_on_loops(TUBE, TUBE), TUBE.points, atol=1e-9)
