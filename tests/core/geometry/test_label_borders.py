# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels of vertices with short borders: flecks disappear, zigzags become straight, and thin bands remain."""

from __future__ import annotations

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.geometry.label_borders import border_lengths, shorten_borders
from zoomout_core.mesh.triangles import edge_graph, vertex_areas

SIDE = 31


def sheet() -> tuple[zo.Surface, np.ndarray]:
    """A unit square of equal steps, and the lengths of border between its vertices."""
    x, y = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE), indexing="ij")
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    faces = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    surface = zo.Surface(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1), faces)
    graph = edge_graph(surface.vertices, surface.triangles)
    graph.data[:] = 1
    areas = vertex_areas(surface.vertices, surface.triangles)
    return surface, border_lengths(surface.vertices, areas, graph)


def choose(cost: np.ndarray, length: np.ndarray) -> np.ndarray:
    """The chosen labels of vertices that may have each of the labels, at costs (n, l)."""
    n, labels = cost.shape
    chosen = shorten_borders(np.repeat(np.arange(n), labels), np.tile(np.arange(labels), n), cost.ravel(), length)
    return chosen % labels


@pytest.mark.parametrize("degrees", [0, 20, 45, 70])
def test_border_length_hardly_depends_on_its_direction(degrees: int) -> None:
    surface, length = sheet()
    angle = np.radians(degrees)
    off = surface.vertices[:, :2] - 0.5
    side = off @ [np.cos(angle), np.sin(angle)] > 1e-3
    inside = np.abs(off @ [-np.sin(angle), np.cos(angle)]) < 0.35  # without the square's own border
    cut = length.tocoo()
    found = cut.data[(side[cut.row] != side[cut.col]) & inside[cut.row]].sum() / 2
    assert found == pytest.approx(0.7, rel=0.15)


def test_flecks_disappear_and_a_jagged_border_becomes_straight() -> None:
    surface, length = sheet()
    x = surface.vertices[:, 0]
    noise = np.random.default_rng(0).normal(0, 0.15, len(x))
    right = (x + noise > 0.5).astype(int)
    cost = 0.02 * np.column_stack([right, 1 - right])
    labels = choose(cost, length)
    assert (right != (x > 0.5)).sum() > 100
    assert (labels != (x > 0.5)).mean() < 0.05


def test_thin_band_with_clear_costs_remains() -> None:
    surface, length = sheet()
    band = np.abs(surface.vertices[:, 1] - 0.5) < 0.04  # three rows
    labels = choose(0.05 * np.column_stack([band, ~band]), length)
    assert (labels == band).all()


def test_three_labels_meet_and_vertices_keep_to_their_candidates() -> None:
    surface, length = sheet()
    angle = np.arctan2(*(surface.vertices[:, :2] - 0.5).T)
    right = ((angle + np.pi) / (2 * np.pi) * 3).astype(int) % 3
    seen = np.where(np.random.default_rng(1).random(len(right)) < 0.2, (right + 1) % 3, right)
    labels = choose(0.02 * (seen[:, None] != np.arange(3)), length)
    assert (labels != right).mean() < 0.02
    assert (shorten_borders(np.arange(len(seen)), seen, 0.0 * seen, length) == np.arange(len(seen))).all()


def test_huge_costs_do_not_affect_distant_labels() -> None:
    surface, length = sheet()
    x = surface.vertices[:, 0]
    noise = np.random.default_rng(0).normal(0, 0.15, len(x))
    right = (x + noise > 0.5).astype(int)
    cost = 0.02 * np.column_stack([right, 1 - right])
    expected = choose(cost, length)
    fixed = x < 0.1  # far from the border
    cost[fixed] = 1e9 * np.column_stack([right[fixed], 1 - right[fixed]])
    assert (choose(cost, length) == expected)[~fixed].all()
