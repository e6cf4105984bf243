# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes prepared for one match are reused by the next, if the mesh is the same."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.matching.pipeline import prepare
from zoomout_core.matching.preparation import memory_cache
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.memory_cache import cached_analysis, cached_hull, cached_working_mesh
from zoomout_core.matching.ranking import rotational_symmetry
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.memory import bytes_of

pytestmark = pytest.mark.usefixtures("few_candidates")


@pytest.fixture(autouse=True)
def clear_cache() -> Iterator[None]:
    zo.forget_shapes()
    yield
    zo.forget_shapes()


@pytest.fixture(scope="module")
def part() -> WorkingMesh:
    return creature(1500).surface.working


def as_new(surface: Surface) -> Surface:
    return Surface(surface.vertices, surface.triangles)


def analyse_cached(part: WorkingMesh, k: int = 30) -> ShapeAnalysis:
    return cached_analysis(part, k, 100, 0, None)


def test_an_equal_mesh_is_prepared_once(part: WorkingMesh) -> None:
    again = Surface(*(array.copy() for array in (creature(1500).surface.vertices, part.triangles))).working
    assert again is not part
    assert analyse_cached(again) is analyse_cached(part)


def test_surfaces_of_the_same_arrays_share_a_working_mesh() -> None:
    first, again, other = (as_new(creature(count).surface) for count in (1500, 1500, 1400))
    assert cached_working_mesh(first) is first.working
    assert cached_working_mesh(again) is first.working
    assert again.working is first.working
    assert cached_working_mesh(other) is not first.working
    zo.forget_shapes()
    assert cached_working_mesh(as_new(first)) is not first.working


def test_surfaces_of_the_same_arrays_share_hulls_of_each_kind() -> None:
    first, again, other = (as_new(creature(count).surface) for count in (600, 600, 500))
    hull = cached_hull(first)
    assert hull.is_hull
    assert cached_hull(again) is hull
    assert cached_hull(again, tight=True) is not hull
    assert cached_hull(other) is not hull


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("field", ["vertices", "triangles", "vertex_of", "triangle_of", "flipped", "scale"])
def test_any_difference_of_the_mesh_makes_another_shape(part: WorkingMesh, field: str) -> None:
    value = getattr(part, field)
    if isinstance(value, float):
        other = 2 * value
    else:
        other = value.copy()
        other[:2] = value[1::-1] if value.dtype != bool else ~value[:2]
    assert analyse_cached(part) is not analyse_cached(replace(part, **{field: other}))


def test_another_number_of_functions_makes_another_shape(part: WorkingMesh) -> None:
    assert len(analyse_cached(part, 30).basis.eigenvalues) == 30
    assert len(analyse_cached(part, 20).basis.eigenvalues) == 20


def test_least_recently_used_shapes_are_evicted_first(part: WorkingMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = analyse_cached(part, 20), analyse_cached(part, 21)
    monkeypatch.setattr(memory_cache, "MAX_BYTES", 2.5 * bytes_of(second))
    assert analyse_cached(part, 20) is first
    analyse_cached(part, 22)  # no room for three
    assert analyse_cached(part, 20) is first
    assert analyse_cached(part, 21) is not second


def test_two_shapes_of_the_last_match_are_always_kept(part: WorkingMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory_cache, "MAX_BYTES", 1000)
    first, second = analyse_cached(part, 20), analyse_cached(part, 21)
    assert analyse_cached(part, 20) is first
    assert analyse_cached(part, 21) is second
    analyse_cached(part, 22)
    assert analyse_cached(part, 20) is not first


@pytest.mark.slow
def test_a_second_match_gives_the_same_map() -> None:
    source, target = creature(1500).surface, creature(1200, seed=1).surface
    maps = [zo.match(source, target).surface_map for _ in range(2)]
    np.testing.assert_array_equal(maps[0].triangle, maps[1].triangle)
    np.testing.assert_array_equal(maps[0].barycentric, maps[1].barycentric)


@pytest.mark.parametrize("changed", ["k", "samples", "seed", "proxy_vertices"])
def test_every_number_of_an_analysis_is_part_of_its_key(
    monkeypatch: pytest.MonkeyPatch, part: WorkingMesh, changed: str
) -> None:
    asked: list[tuple[int | None, ...]] = []

    def prepare(part: WorkingMesh, *numbers: int | None) -> ShapeAnalysis:
        asked.append(numbers)
        return first

    first = analyse_cached(part)
    monkeypatch.setattr(memory_cache, "analyse", prepare)
    numbers = {"k": 31, "samples": 100, "seed": 0, "proxy_vertices": None}
    other = numbers | {changed: 700}
    for each in (numbers, other, numbers, other):
        cached_analysis(part, **each)
    assert asked == [tuple(numbers.values()), tuple(other.values())]


@pytest.mark.slow
def test_match_reuses_shapes_that_were_prepared_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (creature(count, bend=bend).surface for count, bend in ((1500, 0.0), (1400, 0.9)))
    expected = zo.match(as_new(one), as_new(other), k_final=30)
    zo.forget_shapes()
    prepare(as_new(one), as_new(other), zo.MatchOptions(k_final=30))
    monkeypatch.setattr(memory_cache, "analyse", None)
    monkeypatch.setattr(rotational_symmetry, "_fitting", None)
    result = zo.match(as_new(one), as_new(other), k_final=30)
    np.testing.assert_array_equal(result.surface_map.triangle, expected.surface_map.triangle)
    np.testing.assert_array_equal(result.surface_map.barycentric, expected.surface_map.barycentric)
