# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of every mesh, map and attribute, tested on random ones (hypothesis)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from creatures import creature
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.triangles import triangle_areas, triangle_normals
from zoomout_core.mesh.triangulation import triangulate
from zoomout_core.samples.grids import grid_faces
from zoomout_core.transfer import RULES

# Few, deterministic examples, and no deadline: a busy machine would exceed it.
few = settings(
    max_examples=15, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
seeds = st.integers(0, 2**32 - 1)
VERTICES = 160


@cache
def small() -> zo.Surface:
    """A closed creature, the same in all tests."""
    return creature(VERTICES, asymmetry=0.3).surface


def random_map(random: np.random.Generator, count: int, source: zo.Surface) -> zo.SurfaceMap:
    """A map to random points on a surface."""
    triangle = random.integers(len(source.triangles), size=count)
    return zo.SurfaceMap(triangle, random.dirichlet([0.5] * 3, count), source.triangles)


def identity() -> zo.SurfaceMap:
    return zo.SurfaceMap.from_vertices(np.arange(VERTICES), small())


# --- meshes -------------------------------------------------------------------------------------------------


@few
@given(seeds, st.floats(1e-4, 1e4))
def test_eigenvalues_do_not_depend_on_placement_size_order_or_winding(seed: int, size: float) -> None:
    random, surface = np.random.default_rng(seed), small()
    order = random.permutation(VERTICES)
    number = np.argsort(order)
    turn = Rotation.random(random_state=seed).as_matrix()
    moved = size * (surface.vertices[order] @ turn.T + 10 * random.standard_normal(3))
    triangles = np.roll(number[surface.triangles], random.integers(3), axis=1)[
        random.permutation(len(surface.triangles))
    ]
    for faces in (triangles, triangles[:, ::-1]):
        found = zo.eigenbasis(zo.Surface(moved, faces), 12).eigenvalues
        np.testing.assert_allclose(found, zo.eigenbasis(surface, 12).eigenvalues, rtol=1e-6, atol=1e-7)


@few
@given(seeds, st.integers(3, 40))
def test_polygons_are_cut_into_triangles_of_the_same_area(seed: int, corners: int) -> None:
    """Polygons are star-shaped and randomly rotated."""
    random = np.random.default_rng(seed)
    angle = (np.arange(corners) + 0.8 * random.random(corners)) * 2 * np.pi / corners
    radius = random.uniform(0.2, 1, corners)
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(corners)])
    x, y = flat[:, 0], flat[:, 1]
    area = 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    if corners == 3 and area <= 0:
        return
    turn = Rotation.random(random_state=seed).as_matrix()
    triangles = triangulate(flat @ turn.T, np.arange(corners), np.array([0, corners]))
    assert len(triangles) == corners - 2
    assert triangle_areas(flat @ turn.T, triangles).sum() == pytest.approx(area)
    sound = triangle_areas(flat, triangles) > 1e-12
    assert (triangle_normals(flat, triangles)[sound, 2] > 0).all()


# --- maps ---------------------------------------------------------------------------------------------------


@few
@given(seeds, st.integers(1, 60))
def test_interpolation_keeps_constants_and_bounds(seed: int, count: int) -> None:
    random, source = np.random.default_rng(seed), small()
    surface_map = random_map(random, count, source)
    values = random.standard_normal((VERTICES, 2))
    found = surface_map.interpolate(values)
    assert (found <= values.max(axis=0) + 1e-12).all()
    assert (found >= values.min(axis=0) - 1e-12).all()
    np.testing.assert_allclose(surface_map.interpolate(np.full((VERTICES, 1), 3.25)), 3.25)


@few
@given(seed=seeds, count=st.integers(1, 60))
def test_maps_are_read_as_they_were_written(tmp_path: Path, seed: int, count: int) -> None:
    surface_map = random_map(np.random.default_rng(seed), count, small())
    surface_map.save(tmp_path / "map.npz")
    again = zo.SurfaceMap.load(tmp_path / "map.npz", small())
    np.testing.assert_array_equal(again.triangle, surface_map.triangle)
    np.testing.assert_array_equal(again.barycentric, surface_map.barycentric)


# --- attributes ---------------------------------------------------------------------------------------------

COUNTS: dict[zo.Domain, Callable[[zo.Surface], int]] = {
    zo.Domain.POINT: lambda surface: len(surface.vertices),
    zo.Domain.EDGE: lambda surface: len(surface.edges),
    zo.Domain.FACE: lambda surface: len(surface.face_start) - 1,
    zo.Domain.CORNER: lambda surface: len(surface.corner_vertex),
}


def unit(values: np.ndarray) -> np.ndarray:
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def values_of(kind: zo.Kind, count: int, random: np.random.Generator) -> Any:
    """Random values of a kind."""
    noise = random.standard_normal((count, 16))
    if kind is zo.Kind.WEIGHT:
        weights = random.random((count, 4)) * (random.random((count, 4)) < 0.6)
        weights[:, 0] += 0.1
        return csr_array(weights / weights.sum(axis=1, keepdims=True))
    return {
        zo.Kind.SCALAR: noise[:, 0],
        zo.Kind.VECTOR: noise[:, :5],
        zo.Kind.DIRECTION: noise[:, :3],
        zo.Kind.NORMAL: unit(noise[:, :3]),
        zo.Kind.COLOR: np.abs(noise[:, :4]),
        zo.Kind.QUATERNION: unit(noise[:, :4]),
        zo.Kind.MATRIX: noise,
        zo.Kind.LABEL: random.integers(-3, 3, count),
        zo.Kind.BOOLEAN: noise[:, 0] > 0,
        zo.Kind.MARK: np.where(noise[:, 0] > 1, 1.0, 0.0),
        zo.Kind.OFFSET: noise[:, :6].reshape(count, 2, 3),
        zo.Kind.UV: noise[:, :2],
    }[kind]


def dense(values: Any) -> np.ndarray:
    return values.toarray() if hasattr(values, "toarray") else np.asarray(values)


# Transfer assumes charts that are continuous, smooth offsets, edge marks that form lines, and smooth edge values.
# Random values violate these assumptions.
SMOOTH = {(zo.Kind.MARK, zo.Domain.EDGE)} | {
    (kind, zo.Domain.EDGE) for kind in (zo.Kind.SCALAR, zo.Kind.VECTOR, zo.Kind.COLOR)
}
PAIRS = [
    (kind, domain)
    for kind in RULES
    for domain in RULES[kind].domains
    if kind not in (zo.Kind.UV, zo.Kind.OFFSET) and (kind, domain) not in SMOOTH
]


@pytest.mark.parametrize(("kind", "domain"), PAIRS, ids=lambda each: each.name.lower())
@settings(few, max_examples=4)
@given(seed=seeds)
def test_identity_map_preserves_attributes(kind: zo.Kind, domain: zo.Domain, seed: int) -> None:
    values = values_of(kind, COUNTS[domain](small()), np.random.default_rng(seed))
    attribute = zo.Attribute("any", domain, kind, values)
    found = zo.transfer(attribute, identity(), small(), small())
    assert (found.domain, found.kind) == (domain, kind)
    before, after = dense(values), dense(found.values)
    assert after.dtype == before.dtype
    if kind is zo.Kind.QUATERNION:
        after = after * np.sign(np.einsum("nx,nx->n", after, before))[:, None]  # both signs are the same rotation
    if after.dtype.kind == "f":
        np.testing.assert_allclose(after, before, atol=1e-6)
    else:
        np.testing.assert_array_equal(after, before)


@settings(few, max_examples=4)
@given(seeds)
def test_identity_map_preserves_smooth_attributes(seed: int) -> None:
    """Texture coordinates of a chart, shape keys, and values on edges."""
    random, surface = np.random.default_rng(seed), small()
    linear, at = random.standard_normal((3, 3)), surface.vertices
    chart = (at @ linear[:2].T)[surface.corner_vertex]
    keys = np.stack([0.1 * at @ linear, np.roll(at, 1, axis=1)], axis=1)
    heights = at[surface.edges].mean(axis=1) @ linear[0]
    for domain, kind, values, most in (
        (zo.Domain.CORNER, zo.Kind.UV, chart, 1e-6),
        (zo.Domain.POINT, zo.Kind.OFFSET, keys, 1e-5),
        (zo.Domain.EDGE, zo.Kind.SCALAR, heights, 0.2),
    ):
        found = zo.transfer(zo.Attribute("any", domain, kind, values), identity(), surface, surface).values
        assert np.abs(found - values).max() < most * np.ptp(values), kind


@settings(few, max_examples=4)
@given(seeds, st.floats(1e-3, 1e3))
def test_proximity_match_ignores_frame_unit_order_and_winding(seed: int, size: float) -> None:
    random, source, target = np.random.default_rng(seed), small(), creature(150, 1, asymmetry=0.3).surface
    turn, shift = Rotation.random(random_state=seed).as_matrix(), random.standard_normal(3)
    order = random.permutation(len(target.vertices))
    number = np.argsort(order)
    moved = [size * (one.vertices @ turn.T + shift) for one in (source, target)]
    ours = zo.match_by_proximity(source, target, max_angle=180, either_side=True).surface_map
    theirs = zo.match_by_proximity(
        zo.Surface(moved[0], source.triangles[:, ::-1]),
        zo.Surface(moved[1][order], number[target.triangles]),
        max_angle=180,
        either_side=True,
    ).surface_map
    places = ours.interpolate(source.vertices)[order], theirs.interpolate(source.vertices)
    assert np.quantile(np.linalg.norm(places[0] - places[1], axis=1), 0.95) < 1e-6


@settings(few, max_examples=4)
@given(seeds, st.floats(1e-3, 1e3))
def test_surface_functions_do_not_depend_on_quad_diagonals(seed: int, size: float) -> None:
    """Areas, normals and interpolated values of planar quads."""
    random = np.random.default_rng(seed)
    grid = size * np.stack(np.meshgrid(np.arange(4.0), np.arange(5.0), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    quads = grid_faces(3, 4)
    turned = np.array([np.roll(quad, random.integers(4)) for quad in quads])
    surfaces = [zo.Surface(grid, faces) for faces in (quads, turned)]
    np.testing.assert_allclose(surfaces[0].area, surfaces[1].area)
    values = grid @ random.standard_normal(3)
    points = size * random.uniform(0, 3, (20, 3)) * [1, 1, 0]
    found = []
    for one in surfaces:
        triangle, barycentric = closest_points(points, one.vertices, one.triangles)
        found.append(zo.SurfaceMap(triangle, barycentric, one.triangles).interpolate(values[:, None]))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6, atol=1e-9 * size)


@few
@given(seeds)
def test_fields_on_edges_keep_constants_and_bounds(seed: int) -> None:
    random, source = np.random.default_rng(seed), small()
    surface_map = random_map(random, VERTICES, source)
    for values in (np.full(len(source.edges), 2.5), random.uniform(1, 2, len(source.edges))):
        attribute = zo.Attribute("e", zo.Domain.EDGE, zo.Kind.SCALAR, values)
        found = zo.transfer(attribute, surface_map, source, source).values
        assert found.min() >= values.min() - 1e-12
        assert found.max() <= values.max() + 1e-12


@few
@given(seeds, st.integers(1, 4))
def test_transferred_weights_are_normalised_and_limited(seed: int, limit: int) -> None:
    random, source = np.random.default_rng(seed), small()
    attribute = zo.Attribute("w", zo.Domain.POINT, zo.Kind.WEIGHT, values_of(zo.Kind.WEIGHT, VERTICES, random))
    found = zo.transfer(attribute, random_map(random, VERTICES, source), source, source, limit=limit).values
    assert (found.data >= 0).all()
    np.testing.assert_allclose(np.asarray(found.sum(axis=1)).ravel(), 1)
    assert np.diff(found.indptr).max() <= limit


@few
@given(seeds)
def test_transfer_creates_no_new_labels(seed: int) -> None:
    random, source = np.random.default_rng(seed), small()
    surface_map = random_map(random, VERTICES, source)
    labels = random.choice(random.integers(-1000, 1000, 3), VERTICES)
    found = zo.transfer(zo.Attribute("l", zo.Domain.POINT, zo.Kind.LABEL, labels), surface_map, source, source)
    assert set(np.unique(found.values)) <= set(labels.tolist())


# --- progress -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_cancelled_match_does_not_affect_the_next_one() -> None:
    source, target = creature(220).surface, creature(200, seed=1, bend=0.2).surface
    options: dict[str, Any] = {"initial": "proximity", "k_final": 20, "samples": 100}
    zo.forget_shapes()
    expected = zo.match(source, target, **options).surface_map
    zo.forget_shapes()
    told: list[zo.Progress] = []
    zo.match(source, target, **options, progress=told.append)
    count = len(told)
    assert count > 10
    assert [one.fraction for one in told] == sorted(one.fraction for one in told)
    for most in np.unique(np.geomspace(1, count - 1, 8).astype(int)):
        zo.forget_shapes()
        left = most

        def listen(_: zo.Progress) -> None:
            nonlocal left
            left -= 1
            if left <= 0:
                raise zo.Cancelled

        with pytest.raises(zo.Cancelled), zo.progress(listen):
            zo.match(source, target, **options)
        again = zo.match(source, target, **options).surface_map
        np.testing.assert_array_equal(again.triangle, expected.triangle)
        np.testing.assert_array_equal(again.barycentric, expected.barycentric)
