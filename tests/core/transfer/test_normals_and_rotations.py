# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions, normals, quaternions and matrices rotate with the surface."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from creatures import Creature, creature
from scipy.spatial.transform import Rotation
from transfer_meshes import identity

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unit_vectors, vertex_normals
from zoomout_core.samples.grids import grid, grid_faces, triangles_of
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.normals import _are_flat

BEND = 0.6
TURN = Rotation.from_euler("xyz", [0.7, -1.1, 2.0]).as_matrix()


def map_of(source: Creature, target: Creature) -> SurfaceMap:
    triangles = source.surface.triangles
    return SurfaceMap(*closest_points(target.directions, source.directions, triangles), triangles)


def degrees(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    cosine = np.einsum("qx,qx->q", first, second) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def normals_of(surface: Surface) -> np.ndarray:
    return vertex_normals(surface.vertices, surface.triangles)


def directions_on(surface: Surface, seed: int = 0) -> np.ndarray:
    """A smooth field of directions, neither tangential nor normal."""
    wave = np.random.default_rng(seed).normal(size=(3, 3))
    field = np.sin(surface.vertices @ wave) + 0.5 * normals_of(surface)
    return field / np.linalg.norm(field, axis=1, keepdims=True)


def transfer_values(
    values: np.ndarray, kind: Kind, surface_map: SurfaceMap, source: Surface, target: Surface, **options: bool
):
    domain = {
        len(source.vertices): Domain.POINT,
        len(source.face_start) - 1: Domain.FACE,
        len(source.corner_vertex): Domain.CORNER,
    }[len(values)]
    return transfer(Attribute("x", domain, kind, values), surface_map, source, target, **options).values


def at_domain(values: np.ndarray, surface: Surface, domain: str) -> np.ndarray:
    at_corners = values[surface.corner_vertex]
    return {"point": values, "corner": at_corners, "face": at_corners.reshape(-1, 3, values.shape[1]).mean(axis=1)}[
        domain
    ]


@pytest.mark.parametrize("domain", ["point", "corner", "face"])
@pytest.mark.parametrize("kind", [Kind.DIRECTION, Kind.NORMAL])
def test_directions_turn_rigidly_at_any_size_and_mesh(kind: Kind, domain: str) -> None:
    source, target = creature(6000), creature(3000, seed=5)
    turned = Surface(3 * target.surface.vertices @ TURN.T + 7, target.surface.triangles)
    surface_map = map_of(source, target)
    values = at_domain(directions_on(source.surface), source.surface, domain)
    still = transfer_values(values, Kind.VECTOR, surface_map, source.surface, target.surface)
    result = transfer_values(values, kind, surface_map, source.surface, turned)
    assert degrees(result, still @ TURN.T).mean() < 1.5  # the target's edges cut across the source's corners


def test_directions_turn_with_the_posed_surface() -> None:
    source, posed, target = creature(8000), creature(8000, bend=1.5), creature(6000, seed=5, bend=1.5)
    surface_map = map_of(source, target)
    # On the same mesh the rotation of every triangle is known.
    sides = [
        (s.surface.vertices[s.surface.triangles] - np.roll(s.surface.vertices[s.surface.triangles], 1, axis=1))
        for s in (posed, source)
    ]
    normals = [triangle_normals(s.surface.vertices, s.surface.triangles) for s in (posed, source)]
    products = np.einsum("msx,msy->mxy", *sides) + np.einsum("m,mx,my->mxy", (sides[1] ** 2).sum(axis=(1, 2)), *normals)
    turns = nearest_rotations(products)
    values = np.random.default_rng(0).normal(size=(1, 3)).repeat(len(source.surface.vertices), axis=0)
    truth = np.einsum("mxy,y->mx", turns, values[0])[surface_map.triangle]
    result = transfer_values(values, Kind.DIRECTION, surface_map, source.surface, target.surface)
    unturned = degrees(surface_map.interpolate(values), truth)
    bent = unturned > 15
    error = degrees(result, truth)
    assert bent.sum() > 300
    assert np.median(error[bent]) < 0.25 * np.median(unturned[bent])  # limb tips have few vertices
    assert error.mean() < 2
    shaken = target.directions + np.random.default_rng(0).normal(scale=0.01, size=target.directions.shape)
    triangles = source.surface.triangles
    rough = SurfaceMap(*closest_points(shaken, source.directions, triangles), triangles)
    result = transfer_values(values, Kind.DIRECTION, rough, source.surface, target.surface)
    assert degrees(result, truth).mean() < 4
    np.testing.assert_allclose(np.linalg.norm(result, axis=1), np.linalg.norm(values[0]), rtol=1e-6)


def test_smooth_normals_become_those_of_the_target() -> None:
    source, target = creature(8000), creature(6000, seed=5, bend=BEND)
    values = normals_of(source.surface)[source.surface.corner_vertex].astype(np.float32)
    result = transfer_values(values, Kind.NORMAL, map_of(source, target), source.surface, target.surface)
    assert result.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(result, axis=1), 1, rtol=1e-5)
    error = degrees(result, normals_of(target.surface)[target.surface.corner_vertex])
    assert np.median(error) < 2
    assert error.mean() < 4


@pytest.mark.parametrize("mirrored", [True, False])
@pytest.mark.parametrize("inside_out", [True, False])
@pytest.mark.parametrize("domain", ["point", "corner", "face"])
def test_normals_are_right_for_mirrored_maps_and_reversed_winding(
    mirrored: bool, inside_out: bool, domain: str
) -> None:
    source, target = creature(8000), creature(6000, seed=5)
    vertices = target.surface.vertices * [-1 if mirrored else 1, 1, 1]
    order = 1 if mirrored == inside_out else -1
    other = Surface(vertices, target.surface.triangles[:, ::order])
    values = at_domain(normals_of(source.surface), source.surface, domain)
    result = transfer_values(values, Kind.NORMAL, map_of(source, target), source.surface, other)
    assert np.median(degrees(result, at_domain(normals_of(other), other, domain))) < 2


def test_normals_keep_the_hard_edges_of_the_source() -> None:
    flat, quads = grid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)).vertices, grid_faces(20, 20)
    roof = np.column_stack([flat[:, :2], -np.abs(flat[:, 0])])
    source, target = Surface(roof, quads), Surface(roof @ TURN.T, triangles_of(quads))
    slope = np.sign(roof[source.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, 0])
    flat = np.column_stack([slope, 0 * slope, np.ones(len(slope))]) / np.sqrt(2)
    result = transfer_values(flat.repeat(4, axis=0), Kind.NORMAL, identity(source), source, target)
    own = triangle_normals(target.vertices, target.triangles)
    assert degrees(result, own.repeat(3, axis=0)).max() < 0.01


def shaded_flat(surface: Surface) -> np.ndarray:
    """(c, 3) the normals of the corners' triangles."""
    return triangle_normals(surface.vertices, surface.triangles).repeat(3, axis=0)


def test_coarse_targets_of_a_source_that_is_shaded_flat_have_no_streaks() -> None:
    """Without the rule, 30 % of the normals are far from their face. Faces within one of the source keep its normal."""
    source, target = creature(100).surface, creature(60, seed=5).surface
    surface_map = map_of(creature(100), creature(60, seed=5))
    result = transfer_values(shaded_flat(source), Kind.NORMAL, surface_map, source, target)
    tilt = degrees(result, shaded_flat(target))
    assert (tilt > 30.1).mean() < 0.05
    assert (tilt > 1).mean() > 0.5


def test_coarse_targets_of_a_smooth_source_stay_smooth() -> None:
    source, target = creature(3000).surface, creature(300, seed=5).surface
    surface_map = map_of(creature(3000), creature(300, seed=5))
    smooth = normals_of(source)
    result = transfer_values(smooth[source.corner_vertex], Kind.NORMAL, surface_map, source, target)
    assert degrees(result, shaded_flat(target)).max() > 40
    first = np.unique(target.corner_vertex, return_index=True)[1]
    assert degrees(result, result[first[target.corner_vertex]]).mean() < 5


def test_gentle_turns_beside_a_hard_edge_do_not_make_a_face_smooth() -> None:
    """Faces at the ridge of a slightly curved roof turn by 1 to 2 degrees towards the others, smoothly."""
    x, y = grid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)).vertices.T[:2]
    roof = Surface(np.column_stack([x, y, -np.abs(x) - 0.2 * x**2]), grid_faces(20, 20))
    across = roof.vertices[roof.corner_vertex].reshape(-1, 4, 3)[..., 0]
    slope = np.sign(across.mean(axis=1))[:, None] + 0.4 * across
    normals = np.stack([slope, 0 * slope, np.ones_like(slope)], axis=2).reshape(-1, 3)
    at_ridge = (np.abs(across) < 1e-9).any(axis=1)
    np.testing.assert_array_equal(_are_flat(unit_vectors(normals), roof), at_ridge)


def test_fine_targets_keep_the_facets_of_a_source_that_is_shaded_flat() -> None:
    source, target = creature(300).surface, creature(6000, seed=5).surface
    surface_map = map_of(creature(300), creature(6000, seed=5))
    result = transfer_values(shaded_flat(source), Kind.NORMAL, surface_map, source, target)
    assert (degrees(result, shaded_flat(target)) > 30.1).mean() > 0.02


def test_normals_stay_above_the_surface_unless_below_on_the_source() -> None:
    source, target = creature(3000), creature(3000, seed=5, bend=BEND)
    up = np.tile([0.0, 0, 1], (len(source.surface.vertices), 1))
    surface_map = map_of(source, target)
    result = transfer_values(up, Kind.NORMAL, surface_map, source.surface, target.surface)
    above = surface_map.interpolate(np.einsum("nx,nx->n", up, normals_of(source.surface))) > 0
    assert 0.2 < above.mean() < 0.8
    height = np.einsum("nx,nx->n", result, normals_of(target.surface))
    assert (height[above] > 0).all()
    assert (height[~above] < 0).mean() > 0.9


@pytest.mark.parametrize("domain", ["point", "corner", "face"])
def test_quaternions_of_either_sign_agree_and_turn_on_request(domain: str) -> None:
    source, target = creature(4000), creature(3000, seed=5)
    turned = Surface(target.surface.vertices @ TURN.T, target.surface.triangles)
    surface_map = map_of(source, target)

    def rotations(surface: Surface) -> Rotation:
        return Rotation.from_rotvec(at_domain(np.sin(surface.vertices), surface, domain))

    def quaternions(rotation: Rotation) -> np.ndarray:
        return np.roll(rotation.as_quat(), 1, axis=1)

    values = quaternions(rotations(source.surface))
    values *= np.where(np.random.default_rng(0).random(len(values)) < 0.5, -1, 1)[:, None]
    truth = rotations(target.surface)
    for options, expected in (({}, truth), ({"turned": True}, Rotation.from_matrix(TURN) * truth)):
        result = transfer_values(values, Kind.QUATERNION, surface_map, source.surface, turned, **options)
        np.testing.assert_allclose(np.linalg.norm(result, axis=1), 1, rtol=1e-6)
        off = (Rotation.from_quat(np.roll(result, -1, axis=1)) * expected.inv()).magnitude()
        assert np.median(np.degrees(off)) < 2


def test_quaternions_keep_their_sign_and_zero_ones_become_identity() -> None:
    mesh = creature(1000).surface
    values = np.random.default_rng(0).normal(size=(1000, 4))
    values /= np.linalg.norm(values, axis=1, keepdims=True)
    np.testing.assert_allclose(transfer_values(values, Kind.QUATERNION, identity(mesh), mesh, mesh), values, atol=1e-9)
    result = transfer_values(0 * values, Kind.QUATERNION, identity(mesh), mesh, mesh)
    np.testing.assert_allclose(result, np.tile([1, 0, 0, 0], (1000, 1)), atol=1e-9)


def test_matrices_are_not_sheared_or_shrunk_between_rotations() -> None:
    source, target = creature(4000), creature(3000, seed=5)
    surface_map = map_of(source, target)
    angle = np.pi * (source.surface.vertices[:, 2] > 0)  # rotations by half a turn or zero
    rotation = Rotation.from_rotvec(np.column_stack([0 * angle, 0 * angle, 0.999 * angle])).as_matrix()
    matrices = np.tile(np.eye(4), (4000, 1, 1))
    matrices[:, :3, :3] = rotation @ np.diag([1.0, 2, -3])
    matrices[:, :3, 3] = source.surface.vertices
    result = transfer_values(matrices.reshape(-1, 16), Kind.MATRIX, surface_map, source.surface, target.surface)
    result = result.reshape(-1, 4, 4)
    np.testing.assert_allclose(np.linalg.det(result[:, :3, :3]), -6, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.svd(result[:, :3, :3])[1], np.tile([3, 2, 1], (3000, 1)), rtol=1e-6)
    np.testing.assert_allclose(result[:, :3, 3], surface_map.interpolate(source.surface.vertices), atol=1e-9)
    np.testing.assert_allclose(result[:, 3], np.tile([0, 0, 0, 1], (3000, 1)), atol=1e-12)
    kept = transfer_values(
        matrices.reshape(-1, 16), Kind.MATRIX, identity(source.surface), source.surface, source.surface
    )
    np.testing.assert_allclose(kept, matrices.reshape(-1, 16), atol=1e-6)


@pytest.mark.parametrize("kind", [Kind.DIRECTION, Kind.NORMAL, Kind.QUATERNION, Kind.MATRIX])
def test_rotating_kinds_are_filled_in_and_reported_if_doubtful(kind: Kind) -> None:
    mesh = creature(3000).surface
    doubtful = mesh.vertices[:, 2] > np.quantile(mesh.vertices[:, 2], 0.98)
    match = SimpleNamespace(has_partner=None, surface_map=identity(mesh), confidence=np.where(doubtful, 0.0, 1.0))
    width = {Kind.QUATERNION: 4, Kind.MATRIX: 16}.get(kind, 3)
    values = np.tile(np.eye(4).ravel()[:width] if kind is not Kind.NORMAL else np.ones(3) / np.sqrt(3), (3000, 1))
    values[doubtful] *= -1
    result = transfer(Attribute("x", Domain.POINT, kind, values), match, mesh, mesh, fill_below=0.5)
    assert any(f"{doubtful.sum()} vertices" in note for note in result.notes)
    if kind is Kind.DIRECTION:
        assert (result.values[doubtful, 0] > 0.9).all()
