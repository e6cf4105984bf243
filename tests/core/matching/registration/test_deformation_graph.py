# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes move the vertices around them and each other: joints bend, and rotating nodes take neighbours along."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from creatures import creature
from scipy.spatial.transform import Rotation

from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.registration.deformation_graph import DeformationGraph, Nodes

STIFFNESS = 0.3


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    return analyse(creature(500).surface.working.part(0)[0], 60, 300, 0)


def chain(count: int, length: float = 0.1, axis: int = 0) -> DeformationGraph:
    """Nodes in a row along an axis; each alone moves four vertices around it."""
    centres = np.arange(count)[:, None] * [length, 0.0, 0.0]
    around = 0.03 * np.array([[0.0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    places = np.roll(np.concatenate([centres, (centres[:, None] + around).reshape(-1, 3)]), axis, axis=1)
    owner = np.concatenate([np.arange(count), np.repeat(np.arange(count), 4)])
    one, other = np.arange(count - 1), np.arange(1, count)
    first, second = np.concatenate([one, other]), np.concatenate([other, one])
    bond = 1 / np.bincount(first)[first]
    nodes = Nodes(np.arange(count), owner[:, None], np.ones((len(owner), 1)), first, second, bond)
    return DeformationGraph(
        nodes,
        places,
        np.tile([0.0, 0, 1], (len(places), 1)),
        np.tile(np.eye(3), (count, 1, 1)),
        places[:count].copy(),
        np.zeros((count, 6)),
    )


def step(bending: DeformationGraph, vertex: np.ndarray, residual: np.ndarray, approaching: bool = False) -> float:
    return bending.step(vertex, residual, np.tile(np.eye(3), (len(vertex), 1, 1)), STIFFNESS, approaching)


def requested_turn(bending: DeformationGraph, node: int, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """The vertices around a node, and residuals that request a rotation about the row's axis."""
    count = len(bending.nodes.vertex)
    vertex = count + 4 * node + np.arange(4)
    offset = bending.rest[vertex] - bending.rest[node]
    return vertex, Rotation.from_rotvec([angle, 0, 0]).apply(offset) - offset


def test_node_follows_the_consistent_neighbour_not_the_torn_one() -> None:
    bending = chain(3)
    bending.images[2] += [0, 0.2, 0]  # a joint that has bent
    before = bending.images.copy()
    around = 3 + np.arange(4)
    vertex = np.concatenate([[0], around, [2], around + 8])  # fix both ends and their rotations
    step(bending, vertex, np.repeat([[0, 0.01, 0], [0, 0, 0]], 5, axis=0))
    moved = bending.images - before
    assert moved[0, 1] == pytest.approx(0.01, rel=0.2)
    # With equal weights for both neighbours it would move to the middle, 0.1 away.
    assert moved[1, 1] == pytest.approx(0.01, abs=0.01)


def test_the_nodes_of_a_stiff_row_move_together() -> None:
    bending = chain(4)
    step(bending, np.array([0, 1]), np.full((2, 3), 0.01))
    np.testing.assert_allclose(bending.images - chain(4).images, 0.01, atol=1e-3)


def test_node_without_correspondences_stays() -> None:
    places = np.array([[0.0, 0, 0], [1, 0, 0], [9, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [9, 1, 0]])
    nodes = Nodes(
        vertex=np.arange(3),
        near=np.array([[0, 1], [1, 0], [2, 2], [0, 1], [0, 1], [2, 2]]),
        weight=np.array([[1.0, 0], [1, 0], [1, 0], [0.5, 0.5], [0.5, 0.5], [1, 0]]),
        first=np.array([0, 1]),
        second=np.array([1, 0]),
        bond=np.ones(2),
    )
    bending = DeformationGraph(
        nodes, places, np.ones((6, 3)), np.tile(np.eye(3), (3, 1, 1)), places[:3].copy(), np.zeros((3, 6))
    )
    vertex, shift = np.array([0, 1, 3, 4]), np.array([0.1, 0.2, 0.3])
    bending.step(vertex, np.tile(shift, (4, 1)), np.tile(np.eye(3), (4, 1, 1)), 0.3, False)
    positions, _, _ = bending.deform()
    np.testing.assert_allclose(positions[vertex] - places[vertex], np.tile(shift, (4, 1)), atol=1e-3)
    np.testing.assert_allclose(positions[[2, 5]], places[[2, 5]], atol=1e-6)


def test_row_fixed_at_one_end_moves_as_a_whole() -> None:
    # Rotations about the fixed end are free.
    bending = chain(40)
    step(bending, np.array([0]), np.full((1, 3), 0.01))
    np.testing.assert_allclose(bending.images[0] - chain(40).images[0], 0.01, rtol=1e-3)
    assert np.isfinite(bending.images).all()
    assert np.abs(bending.images - chain(40).images).max() < 0.02


def test_rotation_about_a_limb_carries_the_neighbour_along() -> None:
    bending = chain(2)
    step(bending, *requested_turn(bending, 0, 0.05))
    angles = Rotation.from_matrix(bending.rotations).as_rotvec()[:, 0]
    assert angles[0] == pytest.approx(0.05, rel=0.3)
    assert angles[1] > 0.5 * angles[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_differently_rotated_nodes_come_to_agree(axis: int) -> None:
    bending = chain(2)
    turn = np.zeros(3)
    turn[axis] = 0.2
    bending.rotations[1] = Rotation.from_rotvec(turn).as_matrix()
    held = np.concatenate([[0], 2 + np.arange(4)])
    for _ in range(3):
        step(bending, held, bending.rest[held] - bending.deform()[0][held])
    assert np.linalg.norm(Rotation.from_matrix(bending.rotations[1]).as_rotvec()) < 0.05


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_nodes_that_are_twisted_about_their_row_come_to_agree(axis: int) -> None:
    bending = chain(2, axis=axis)
    bending.rotations[1] = Rotation.from_rotvec(0.2 * np.eye(3)[axis]).as_matrix()
    held = np.concatenate([[0], 2 + np.arange(4)])
    for _ in range(3):
        step(bending, held, bending.rest[held] - bending.deform()[0][held])
    assert np.linalg.norm(Rotation.from_matrix(bending.rotations[1]).as_rotvec()) < 0.05


def test_steps_towards_closest_points_are_longer_and_continue() -> None:
    plain, hurried = chain(2), chain(2)
    shift = np.tile([0.01, 0, 0], (2, 1))
    reported = [
        step(bending, np.arange(2), shift, approaching) for bending, approaching in ((plain, False), (hurried, True))
    ]
    assert reported[0] == pytest.approx(reported[1])
    ahead = (hurried.images - chain(2).images)[:, 0].mean() / (plain.images - chain(2).images)[:, 0].mean()
    assert 1.2 < ahead < 2
    before = hurried.images.copy()
    step(hurried, np.arange(2), np.zeros((2, 3)), True)
    assert (hurried.images - before)[:, 0].mean() > 0.001


def test_rigid_motion_is_recovered_exactly_from_images(shape: ShapeAnalysis) -> None:
    rest, normals = shape.mesh.vertices, shape.mesh.vertex_normals
    turn, shift = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix(), np.array([0.3, 0.2, 0.1])
    bending = DeformationGraph.from_images(Nodes.on(shape, 40), rest, normals, rest @ turn.T + shift, shape.basis.areas)
    np.testing.assert_allclose(bending.rotations, np.tile(turn, (40, 1, 1)), atol=1e-9)
    positions, turned, _ = bending.deform()
    np.testing.assert_allclose(positions, rest @ turn.T + shift, atol=1e-9)
    np.testing.assert_allclose(turned, normals @ turn.T, atol=1e-9)


def test_graph_from_images_can_be_stepped_at_once(shape: ShapeAnalysis) -> None:
    rest = shape.mesh.vertices
    bending = DeformationGraph.from_images(
        Nodes.on(shape, 20), rest, shape.mesh.vertex_normals, rest, shape.basis.areas
    )
    np.testing.assert_array_equal(bending.stride, np.zeros((20, 6)))
    step(bending, np.arange(len(rest)), np.full(rest.shape, 0.01), approaching=True)
    np.testing.assert_allclose(bending.stride[:, 3:], (bending.images - rest[bending.nodes.vertex]), atol=1e-9)
    assert bending.stride[:, 3:].min() > 0.005


def test_equidistant_vertex_has_equal_weights() -> None:
    corners = 1.0 - np.eye(7)
    distances = np.column_stack([corners, np.full(7, 0.5)])
    target: Any = SimpleNamespace(
        distances=distances,
        basis=SimpleNamespace(areas=np.full(8, 1 / 8)),
        sampled=SimpleNamespace(samples=np.arange(7)),
    )
    nodes = Nodes.on(target, 7)
    np.testing.assert_allclose(nodes.weight[7], 1 / nodes.weight.shape[1])
    assert (nodes.weight[np.arange(7), 0] > 0.99).all()


def test_neighbours_stabilise_the_rotation_of_a_node(shape: ShapeAnalysis) -> None:
    rest = shape.mesh.vertices
    nodes = Nodes.on(shape, 40)
    images = rest.copy()
    # Vertices around one node are wrongly reflected.
    mine = nodes.near[:, 0] == 7
    images[mine] = rest[nodes.vertex[7]] - (rest[mine] - rest[nodes.vertex[7]])
    bending = DeformationGraph.from_images(nodes, rest, shape.mesh.vertex_normals, images, shape.basis.areas)
    assert np.trace(bending.rotations[7]) > 1.5


def test_vertices_move_with_several_nodes_nearest_first(shape: ShapeAnalysis) -> None:
    nodes = Nodes.on(shape, 40)
    assert nodes.near.shape[1] >= 3
    np.testing.assert_allclose(nodes.weight.sum(axis=1), 1)
    assert (np.diff(nodes.weight, axis=1) <= 1e-12).all()
    np.testing.assert_array_equal(nodes.near[nodes.vertex, 0], np.arange(40))
    # Square roots of weights fall linearly with distance, to zero at the nearest node without weight.
    distance = np.sort(shape.distances[:40].T, axis=1)[:, : nodes.near.shape[1] + 1]
    nearness = distance[:, -1:] - distance[:, :-1]
    root = np.sqrt(nodes.weight / nodes.weight[:, :1])
    np.testing.assert_allclose(root, nearness / nearness[:, :1], atol=1e-4)
    np.testing.assert_allclose(np.bincount(nodes.first, nodes.bond), 1)
    assert (nodes.first != nodes.second).all()
    assert {tuple(pair) for pair in np.stack([nodes.first, nodes.second], axis=1).tolist()} == {
        tuple(pair) for pair in np.stack([nodes.second, nodes.first], axis=1).tolist()
    }
    # The two nodes with most weight at a vertex are connected.
    pairs = nodes.first * 40 + nodes.second
    assert np.isin(nodes.near[:, 0] * 40 + nodes.near[:, 1], pairs).all()
    # Connected nodes are near: their geodesic distance is at most a few node spacings.
    between = shape.distances[:40][:, nodes.vertex][nodes.first, nodes.second]
    assert between.max() < 6 * np.sqrt(1 / 40)


def stretched(shape: ShapeAnalysis, factor: float) -> tuple[DeformationGraph, np.ndarray]:
    """A graph that is fitted to a shape's vertices stretched along an axis, and these."""
    images = shape.mesh.vertices * [factor, 1, 1]
    nodes = Nodes.on(shape, 60)
    return DeformationGraph.from_images(
        nodes, shape.mesh.vertices, shape.mesh.vertex_normals, images, shape.basis.areas
    ), images


def test_stretch_of_surroundings_moves_vertices_closer_to_their_images(shape: ShapeAnalysis) -> None:
    bending, images = stretched(shape, 1.4)
    before = np.linalg.norm(bending.deform()[0] - images, axis=1).mean()
    bending.adapt_stretch()
    assert np.linalg.norm(bending.deform()[0] - images, axis=1).mean() < 0.75 * before
    # Half of the stretch, along that axis alone.
    np.testing.assert_allclose(np.median(bending.stretch, axis=0), np.diag([1.2, 1, 1]), atol=0.05)


def test_offsets_from_stretched_nodes_lead_to_the_vertices(shape: ShapeAnalysis) -> None:
    bending, _ = stretched(shape, 1.4)
    bending.adapt_stretch()
    vertex, nodes = np.arange(len(bending.rest)), bending.nodes
    places = bending.offsets(vertex) + bending.images[nodes.near]
    np.testing.assert_allclose(np.einsum("nc,ncx->nx", nodes.weight, places), bending.deform()[0], atol=1e-12)


def test_adapted_nodes_resist_a_stretch_less(shape: ShapeAnalysis) -> None:
    back = []
    for adapts in (False, True):
        bending, images = stretched(shape, 1.2)
        if adapts:
            bending.adapt_stretch()
        start = bending.images.copy()
        vertex = bending.nodes.vertex
        step(bending, vertex, 1e-3 * (images - bending.deform()[0])[vertex])
        back.append(np.abs((bending.images - start)[:, 0]).mean())
    assert back[1] < 0.7 * back[0]


def test_rigid_motion_stretches_nothing(shape: ShapeAnalysis) -> None:
    rest, turn = shape.mesh.vertices, Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()
    bending = DeformationGraph.from_images(
        Nodes.on(shape, 40), rest, shape.mesh.vertex_normals, rest @ turn.T, shape.basis.areas
    )
    bending.adapt_stretch()
    np.testing.assert_allclose(bending.stretch, np.tile(np.eye(3), (40, 1, 1)), atol=1e-9)


def test_a_node_without_neighbours_does_not_stretch() -> None:
    """As one that shares no vertices with others."""
    joined = chain(3)
    one, other, bond = np.array([0, 1]), np.array([1, 0]), np.ones(2)
    nodes = replace(joined.nodes, first=one, second=other, bond=bond)
    bending = replace(joined, nodes=nodes, images=1.4 * joined.images)
    bending.adapt_stretch()
    np.testing.assert_allclose(bending.stretch[2], np.eye(3))
    assert bending.stretch[0, 0, 0] > 1.1


def test_motion_does_not_depend_on_the_order_of_nodes() -> None:
    bending, count = chain(12), 12
    order = np.random.default_rng(0).permutation(count)
    number = np.argsort(order)  # of each node in the other order
    nodes = bending.nodes
    shuffled = DeformationGraph(
        Nodes(order, number[nodes.near], nodes.weight, number[nodes.first], number[nodes.second], nodes.bond),
        bending.rest,
        bending.normals,
        bending.rotations[order],
        bending.images[order],
        bending.stride[order],
    )
    vertex = np.arange(len(bending.rest))
    residual = np.random.default_rng(1).normal(scale=0.02, size=(len(vertex), 3))
    assert step(shuffled, vertex, residual) == pytest.approx(step(bending, vertex, residual), rel=1e-4)
    np.testing.assert_allclose(shuffled.images, bending.images[order], atol=1e-5)
    np.testing.assert_allclose(shuffled.rotations, bending.rotations[order], atol=1e-4)


def test_nodes_that_move_a_vertex_are_close_together_in_the_system(shape: ShapeAnalysis) -> None:
    nodes = Nodes.on(shape, 100)
    place = nodes.place[nodes.near]
    assert sorted(nodes.place) == list(range(100))
    assert np.ptp(place, axis=1).max() < 50
    assert np.ptp(nodes.near, axis=1).max() > 80  # in the order of the samples


def test_each_vertex_is_moved_by_the_nearest_nodes(shape: ShapeAnalysis) -> None:
    nodes = Nodes.on(shape, 60)
    nearest = np.argsort(shape.distances[:60], axis=0, kind="stable")[: nodes.near.shape[1]].T
    np.testing.assert_array_equal(nodes.near, nearest)
    assert (np.diff(nodes.weight, axis=1) <= 1e-12).all()
