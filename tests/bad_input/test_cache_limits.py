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

# Number of shapes or meshes that fit into the bound; more than the cache keeps whatever their size.
FITTING = 3 * memory_cache.MIN_KEPT


@pytest.fixture(autouse=True)
def traced() -> Iterator[None]:
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


def kept() -> tuple[object, ...]:
    """All that the cache keeps."""
    return *memory_cache._shapes._values.values(), *memory_cache._meshes._values.values()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("case", KEEPING)
def test_memory_stays_within_the_bound(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    count, keep = KEEPING[case]
    surface = creature(count).surface
    random = np.random.default_rng(0)
    keep(surface)  # imports modules, which stay
    size = bytes_of(*kept())  # of one; coarse meshes are subdivided
    bound = FITTING * size
    monkeypatch.setattr(memory_cache, "MAX_BYTES", bound)
    zo.forget_shapes()
    gc.collect()
    before, memory = tracemalloc.get_traced_memory()[0], []
    for _ in range(4 * FITTING):
        keep(Surface(surface.vertices + 1e-3 * random.standard_normal(surface.vertices.shape), surface.triangles))
        gc.collect()
        memory.append(tracemalloc.get_traced_memory()[0] - before)
    assert memory_cache.MIN_KEPT < len(kept()) <= FITTING + 1
    assert 0.5 * bound < max(memory) < 1.5 * bound
    # Nothing that the cache has dropped stays elsewhere.
    assert max(memory[-FITTING:]) < max(memory[FITTING : 2 * FITTING]) + 0.5 * size


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
