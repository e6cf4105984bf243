# SPDX-License-Identifier: GPL-3.0-or-later
"""Proxies stay on their surface, keep its thin parts, and lift maps back to it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.proxy import PROXY, Proxy, ProxyTuning, full_images, make_proxy
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.tuning import retune


def test_proxy_stays_on_the_surface_and_reaches_its_tips() -> None:
    part = creature(20000).surface.working
    proxy = make_proxy(part, 3000)
    assert 0.8 * 3000 < len(proxy.mesh.vertices) < 1.2 * 3000
    distance = np.linalg.norm(proxy.place.interpolate(proxy.vertices) - part.vertices, axis=1)
    assert distance.max() < 0.02
    tips = part.vertices[np.linalg.norm(part.vertices, axis=1).argsort()[-5:]]
    assert np.linalg.norm(tips[:, None] - proxy.vertices, axis=2).min(axis=1).max() < 0.02


def test_small_mesh_is_its_own_proxy() -> None:
    part = creature(3000).surface.working
    for count in (None, 3000, 2500):
        proxy = make_proxy(part, count)
        assert proxy.mesh is part
        np.testing.assert_array_equal(proxy.place.vertex, np.arange(3000))
        np.testing.assert_array_equal(proxy.full_vertex, np.arange(3000))


def test_a_coarse_mesh_is_subdivided_and_its_vertices_stay_in_place() -> None:
    part = creature(200).surface.working
    with retune(PROXY, fewest=400):
        proxy = make_proxy(part, None)
    assert len(proxy.mesh.vertices) >= 400
    np.testing.assert_allclose(proxy.place.interpolate(proxy.vertices), part.vertices, atol=1e-12)
    np.testing.assert_array_equal(proxy.full_vertex[:200], np.arange(200))
    np.testing.assert_allclose(triangle_areas(proxy.mesh.vertices, proxy.mesh.triangles).sum(), 1)


@pytest.mark.slow
def test_subdivision_makes_coarse_matches_more_accurate() -> None:
    source, target = creature(260, seed=0), creature(200, seed=1, bend=0.6)
    truth, errors = true_vertex(source, target), []
    for fewest in (12, ProxyTuning().fewest):
        zo.forget_shapes()
        with retune(PROXY, fewest=fewest):
            found = zo.match(source.surface, target.surface).surface_map
        errors.append(zo.geodesic_error(found, source.surface, np.arange(len(truth)), truth).mean())
    assert errors[1] < 0.8 * errors[0]


def test_mesh_is_decimated_only_if_worthwhile() -> None:
    part = creature(3000).surface.working
    counts = [len(make_proxy(part, count).mesh.vertices) for count in (3000, 2700, 1500)]
    assert counts[:2] == [3000, 3000]
    assert 1200 < counts[2] < 1800


@pytest.fixture(scope="module")
def coarse_proxy() -> Proxy:
    return make_proxy(creature(3000).surface.working, 600)


def test_proxy_has_unit_area_and_an_invertible_frame(coarse_proxy: Proxy) -> None:
    on_surface = coarse_proxy.to_surface(coarse_proxy.mesh.vertices)
    np.testing.assert_allclose(on_surface, coarse_proxy.full.to_surface(coarse_proxy.vertices))
    np.testing.assert_allclose(coarse_proxy.from_surface(on_surface), coarse_proxy.mesh.vertices, atol=1e-12)
    place, size = coarse_proxy.frame
    np.testing.assert_allclose(coarse_proxy.mesh.vertices * size + place, coarse_proxy.vertices, atol=1e-9)
    assert triangle_areas(coarse_proxy.mesh.vertices, coarse_proxy.mesh.triangles).sum() == pytest.approx(1)
    moved = replace(coarse_proxy, vertices=3 * coarse_proxy.vertices + [1, 2, 3])
    np.testing.assert_allclose(moved.frame[0], 3 * place + [1, 2, 3])
    assert moved.frame[1] == pytest.approx(3 * size)


def test_vertices_are_placed_near_the_vertex_they_merged_into(coarse_proxy: Proxy) -> None:
    corners = coarse_proxy.mesh.triangles[coarse_proxy.place.triangle]
    near = np.linalg.norm(
        coarse_proxy.vertices[corners] - coarse_proxy.vertices[coarse_proxy.merged][:, None], axis=2
    ).min(axis=1)
    assert (near == 0).mean() > 0.9
    exact = SurfaceMap(
        *closest_points(coarse_proxy.full.vertices, coarse_proxy.vertices, coarse_proxy.mesh.triangles),
        coarse_proxy.mesh.triangles,
    )
    off, least = (
        np.linalg.norm(each.interpolate(coarse_proxy.vertices) - coarse_proxy.full.vertices, axis=1)
        for each in (coarse_proxy.place, exact)
    )
    assert np.median(off - least) < 1e-9
    assert (off < least + 0.05).all()


def test_images_on_the_full_mesh_are_nearly_the_closest_points(coarse_proxy: Proxy) -> None:
    full = coarse_proxy.full
    images = full.vertices[full.triangles].mean(axis=1) + 0.01 * full.vertex_normals[full.triangles[:, 0]]
    found = coarse_proxy.closest(images).interpolate(full.vertices)
    least = SurfaceMap(*closest_points(images, full.vertices, full.triangles), full.triangles).interpolate(
        full.vertices
    )
    off, best = (np.linalg.norm(each - images, axis=1) for each in (found, least))
    assert (off <= np.maximum(best, 0.005) + 1e-12).all()


def test_splinter_of_a_decimation_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    part = creature(600).surface.working

    def with_a_splinter(points: np.ndarray, triangles: np.ndarray, _: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # Five vertices merge into a separate triangle beside a hand.
        beside = points[np.argmax(points[:, 0])] + np.array([[0.01, 0, 0], [0.01, 0.001, 0], [0.01, 0, 0.001]])
        merged = np.arange(len(points))
        merged[[0, 1, 2, 3, 4]] = len(points)
        merged[-1] = 0  # a distant vertex, as across a gap
        return np.vstack([points, beside]), np.vstack([triangles, len(points) + np.arange(3)]), merged

    monkeypatch.setattr("zoomout_core.matching.preparation.proxy.decimate", with_a_splinter)
    proxy = make_proxy(part, 100)
    assert len(proxy.vertices) == 600
    np.testing.assert_array_equal(proxy.merged, [*range(599), 0])
    np.testing.assert_allclose(proxy.vertices, part.vertices)


@pytest.fixture
def threads_that_take_turns() -> Iterator[None]:
    """Switch threads after nearly every instruction, so that rare race conditions occur at once."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("threads_that_take_turns")
def test_concurrent_decimations_do_not_mix_meshes() -> None:
    parts = [creature(count, seed).surface.working for count, seed in ((30000, 0), (20000, 1))]
    alone = [make_proxy(part, 3000) for part in parts]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda part: make_proxy(part, 3000), parts * 4))
    for proxy, expected in zip(together, alone * 4, strict=True):
        np.testing.assert_array_equal(proxy.mesh.triangles, expected.mesh.triangles)


def test_map_between_proxies_is_carried_over_to_the_surfaces() -> None:
    first, second = creature(16000, seed=0).surface.working, creature(12000, seed=1).surface.working
    source, target = make_proxy(first, 3000), make_proxy(second, 3000)
    between = SurfaceMap(
        *closest_points(target.vertices, source.vertices, source.mesh.triangles), source.mesh.triangles
    )
    surface_map = source.closest(full_images(between, source, target))
    images = surface_map.interpolate(first.vertices)
    assert np.linalg.norm(images - second.vertices, axis=1).max() < 0.03
    np.testing.assert_array_equal(surface_map.source_triangles, first.triangles)


def test_open_and_non_manifold_meshes_have_proxies() -> None:
    whole = creature(20000).surface
    kept = whole.vertices[whole.triangles].mean(axis=1)[:, 2] < 0.8
    fin = np.array([[*whole.triangles[np.flatnonzero(kept)[0], :2], len(whole.vertices)]])
    tip = whole.vertices[fin[0, 0]] * 1.1
    opened = Surface(np.vstack([whole.vertices, tip]), np.vstack([whole.triangles[kept], fin]))
    part, _ = opened.working.part(0)
    proxy = make_proxy(part, 3000)
    distance = np.linalg.norm(proxy.place.interpolate(proxy.vertices) - part.vertices, axis=1)
    assert np.quantile(distance, 0.99) < 0.01


@pytest.mark.parametrize("name", ["dense_080", "mc_081"])
def test_proxies_of_dense_and_sliver_meshes_stay_on_them(benchmark_data: Path, name: str) -> None:
    part, _ = read_surface(benchmark_data / "faust_discretisation" / f"{name}.ply").working.part(0)
    for count in (3000, 4000):
        proxy = make_proxy(part, count)
        # Proxy vertices are close to the mesh, and mesh vertices to their places on the proxy.
        assert cKDTree(part.vertices).query(proxy.vertices)[0].max() < 0.02
        assert np.linalg.norm(proxy.place.interpolate(proxy.vertices) - part.vertices, axis=1).max() < 0.02
