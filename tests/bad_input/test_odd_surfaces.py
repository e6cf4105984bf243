# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that form no surface, such as soups, fans and books, are matched with a doubtful verdict, or refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.matching.partial import part_match


def soup(count: int, seed: int) -> zo.Surface:
    """Triangles between random points."""
    random = np.random.default_rng(seed)
    return zo.Surface(random.random((count, 3)), [random.choice(count, 3, replace=False) for _ in range(2 * count)])


def fan(count: int, seed: int) -> zo.Surface:
    """Triangles around a point, half of them flipped."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(5 * angle)])
    faces = np.array([[0, number + 1, (number + 1) % count + 1] for number in range(count)])
    turned = np.random.default_rng(seed).random(count) < 0.5
    faces[turned] = faces[turned, ::-1]
    return zo.Surface(np.vstack([np.zeros(3), rim]), faces)


def book(count: int, seed: int) -> zo.Surface:
    """Triangles that share one edge."""
    pages = np.random.default_rng(seed).random((count, 3))
    return zo.Surface(
        np.vstack([[0, 0, 0], [0, 0, 1], pages]), np.array([[0, 1, number + 2] for number in range(count)])
    )


def repeated(count: int, seed: int) -> zo.Surface:
    """Each triangle of a fan three times."""
    once = fan(count, seed)
    return zo.Surface(once.vertices, np.tile(once.triangles, (3, 1)))


ODD = {"soup": soup, "fan": fan, "book": book, "repeated": repeated}


@pytest.mark.slow(but=4)
@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("start", [{"initial": "proximity"}, {"initial": "given", "initial_map": ()}])
def test_odd_surfaces_match_by_proximity_or_given_map(name: str, start: dict[str, Any]) -> None:
    surfaces = ODD[name](80, 0), ODD[name](80, 1)
    numbers = {"initial_map": np.arange(len(surfaces[1].vertices))} if "initial_map" in start else {}
    result = zo.match(*surfaces, k_final=20, samples=60, **start | numbers)
    assert np.isfinite(result.surface_map.barycentric).all()


def test_match_survives_dependent_functions_at_samples() -> None:
    result = zo.match(book(500, 1), book(500, 11), initial="proximity", k_final=20, samples=60)
    assert result.surface_map.vertex.max() < 502


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", ODD)
def test_search_on_odd_surfaces_is_doubtful(name: str) -> None:
    assert zo.match(ODD[name](60, 2), fan(50, 3), k_final=20, samples=60).verdict.level in ("red", "amber")


@pytest.mark.slow
def test_part_search_in_a_book_is_doubtful() -> None:
    assert zo.match(book(500, 1), book(500, 11)).verdict.level in ("red", "amber")


def test_a_small_part_without_regions_is_searched_for_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []

    def search(regions: list[part_match.Region], given: list[object], upright: bool) -> list[object]:
        found.extend(regions)
        return []

    pair = zo.match(creature(150).surface, creature(150, seed=1).surface, initial="proximity", k_final=20).pair
    monkeypatch.setattr(part_match, "is_small", lambda *_: True)
    monkeypatch.setattr(part_match, "find_regions", lambda *_: [])
    monkeypatch.setattr(part_match, "part_candidates", search)
    assert part_match.match_part(pair) == []
    assert [region.is_everywhere for region in found] == [True]
