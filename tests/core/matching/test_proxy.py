"""Stand-ins lie on their surface, keep its thin parts, and lift maps back to it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from creatures import creature
from scipy.spatial import cKDTree

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.proxy import carried, proxy_steps
from zoomout_core.mesh.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.stepping import drain


def test_a_stand_in_lies_on_the_surface_and_reaches_its_tips() -> None:
    part = creature(20000).surface.working
    proxy = drain(proxy_steps(part, 3000))
    assert 0.8 * 3000 < len(proxy.mesh.vertices) < 1.2 * 3000
    distance = np.linalg.norm(proxy.place.interpolate(proxy.vertices) - part.vertices, axis=1)
    assert distance.max() < 0.02
    tips = part.vertices[np.linalg.norm(part.vertices, axis=1).argsort()[-5:]]
    assert np.linalg.norm(tips[:, None] - proxy.vertices, axis=2).min(axis=1).max() < 0.02


def test_a_small_mesh_stands_for_itself() -> None:
    part = creature(3000).surface.working
    for count in (None, 3000, 2500):
        proxy = drain(proxy_steps(part, count))
        assert proxy.mesh is part
        np.testing.assert_array_equal(proxy.place.vertex, np.arange(3000))
        np.testing.assert_array_equal(proxy.full_vertex, np.arange(3000))


@pytest.fixture
def threads_that_take_turns() -> Iterator[None]:
    """Threads change after nearly every instruction: what goes wrong rarely otherwise goes wrong at once."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("threads_that_take_turns")
def test_two_stand_ins_made_at_the_same_time_are_those_of_their_own_meshes() -> None:
    parts = [creature(count, seed).surface.working for count, seed in ((30000, 0), (20000, 1))]
    alone = [drain(proxy_steps(part, 3000)) for part in parts]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda part: drain(proxy_steps(part, 3000)), parts * 4))
    for proxy, expected in zip(together, alone * 4, strict=True):
        np.testing.assert_array_equal(proxy.mesh.triangles, expected.mesh.triangles)


def test_a_map_between_stand_ins_is_carried_over_to_the_surfaces() -> None:
    first, second = creature(16000, seed=0).surface.working, creature(12000, seed=1).surface.working
    source, target = drain(proxy_steps(first, 3000)), drain(proxy_steps(second, 3000))
    between = SurfaceMap(
        *closest_points(target.vertices, source.vertices, source.mesh.triangles), source.mesh.triangles
    )
    surface_map = source.closest(carried(between, source, target))
    images = surface_map.interpolate(first.vertices)
    assert np.linalg.norm(images - second.vertices, axis=1).max() < 0.03
    np.testing.assert_array_equal(surface_map.source_triangles, first.triangles)


def test_open_and_non_manifold_meshes_have_stand_ins() -> None:
    whole = creature(20000).surface
    kept = whole.vertices[whole.triangles].mean(axis=1)[:, 2] < 0.8
    fin = np.array([[*whole.triangles[np.flatnonzero(kept)[0], :2], len(whole.vertices)]])
    tip = whole.vertices[fin[0, 0]] * 1.1
    opened = Surface(np.vstack([whole.vertices, tip]), np.vstack([whole.triangles[kept], fin]))
    part, _ = opened.working.part(0)
    proxy = drain(proxy_steps(part, 3000))
    distance = np.linalg.norm(proxy.place.interpolate(proxy.vertices) - part.vertices, axis=1)
    assert np.quantile(distance, 0.99) < 0.01


@pytest.mark.parametrize("name", ["dense_080", "mc_081"])
def test_dense_and_sliver_meshes_have_stand_ins_that_lie_on_them(benchmark_data: Path, name: str) -> None:
    part, _ = read_surface(benchmark_data / "faust_discretisation" / f"{name}.ply").working.part(0)
    for count in (3000, 4000):
        proxy = drain(proxy_steps(part, count))
        # Both ways: no vertex of the stand-in is off the mesh, and none of the mesh off its place on the stand-in.
        assert cKDTree(part.vertices).query(proxy.vertices)[0].max() < 0.02
        assert np.linalg.norm(proxy.place.interpolate(proxy.vertices) - part.vertices, axis=1).max() < 0.02
