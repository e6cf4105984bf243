# SPDX-License-Identifier: GPL-3.0-or-later
"""However many shapes a process matches, what it keeps of them stays within its bound."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from creatures import creature
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.matching.preparation import memory_cache
from zoomout_core.matching.preparation.memory_cache import cached_analysis, cached_working_mesh
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.memory import bytes_of

BOUND = 1 << 20


@pytest.fixture(autouse=True)
def traced(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(memory_cache, "MAX_BYTES", BOUND)
    zo.forget_shapes()
    gc.collect()
    tracemalloc.start()
    yield
    tracemalloc.stop()
    zo.forget_shapes()


def analyse(surface: Surface) -> None:
    shape = cached_analysis(surface.working, 20, 60, 0, None)
    _ = shape.search, shape.neighbourhoods, shape.curvature, shape.surroundings  # as matches use it


def analyse_with_many_functions(surface: Surface) -> None:
    cached_analysis(surface.working, 120, 150, 0, None)


def read(surface: Surface) -> None:
    working = cached_working_mesh(surface)
    _ = working.vertex_normals


KEEPING: dict[str, tuple[int, Callable[[Surface], None]]] = {
    "tiny shapes": (60, analyse),
    "small shapes": (200, analyse),
    "small shapes with many eigenfunctions": (150, analyse_with_many_functions),
    "meshes": (1000, read),
}


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("case", KEEPING)
def test_memory_stays_within_the_bound(case: str) -> None:
    count, keep = KEEPING[case]
    surface = creature(count).surface
    random = np.random.default_rng(0)
    keep(surface)  # imports modules, which stay
    zo.forget_shapes()
    gc.collect()
    before, most, kept, full = tracemalloc.get_traced_memory()[0], 0, -1, 0
    while full < 2:  # no more are kept than before
        keep(Surface(surface.vertices + 1e-3 * random.standard_normal(surface.vertices.shape), surface.triangles))
        gc.collect()
        most = max(most, tracemalloc.get_traced_memory()[0] - before)
        kept_before, kept = kept, len(memory_cache._shapes._values) + len(memory_cache._meshes._values)
        full += kept <= kept_before
    assert 0.3 * BOUND < most < 1.5 * BOUND


ARRAY = np.zeros(10_000)
SIZES: dict[str, tuple[object, int]] = {
    "an array": (ARRAY, 80_000),
    "a part of one, which keeps all of it": (ARRAY[:10], 80_000),
    "one array twice": ([ARRAY, ARRAY], 80_000),
    "an array and a part of it": ({"a": ARRAY, "b": ARRAY[5:]}, 80_000),
    "an object": (Surface(np.eye(3), [[0, 1, 2]]), 250),
    "a search tree": (cKDTree(np.zeros((1000, 3)) + np.arange(1000)[:, None]), 24_000 + 8_000 + 9_000),
}


@pytest.mark.parametrize("name", SIZES)
def test_bytes_of_counts_shared_data_once(name: str) -> None:
    value, expected = SIZES[name]
    assert expected <= bytes_of(value) < 1.5 * expected + 3000


def test_bytes_of_handles_cycles() -> None:
    values: list[object] = [ARRAY]
    values.append(values)
    assert bytes_of(values) < 81_000
