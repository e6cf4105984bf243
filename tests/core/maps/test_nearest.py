# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact nearest neighbours, in blocks for several threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.maps import nearest as module
from zoomout_core.maps.nearest import nearest, nearest_among

QUERIES, POINTS, DIMENSION = 90, 70, 20
# Timeout in seconds of a test that waits for another thread.
LONG = 10


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(module, "MIN_SHARED_PRODUCTS", 0)
    yield
    zo.set_threads(None)


def rows(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, DIMENSION))


def closest(candidates: Integers | None = None) -> Integers:
    """(q,) the nearest points by all distances, or the nearest of some candidates (q, c)."""
    apart = np.linalg.norm(rows(QUERIES, 0)[:, None] - rows(POINTS, 1), axis=2)
    if candidates is None:
        return apart.argmin(axis=1)
    chosen = np.take_along_axis(apart, candidates, axis=1).argmin(axis=1)
    return candidates[np.arange(QUERIES), chosen]


@pytest.mark.parametrize("count", [1, 2, 5])
@pytest.mark.parametrize("block", [1, 300, 1 << 24])
def test_nearest_rows_do_not_depend_on_blocks_or_threads(
    count: int, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BLOCK", block)
    zo.set_threads(count)
    candidates = np.random.default_rng(2).integers(POINTS, size=(QUERIES, 8))
    assert (nearest(rows(QUERIES, 0), rows(POINTS, 1)) == closest()).all()
    assert (nearest_among(rows(QUERIES, 0), rows(POINTS, 1), candidates) == closest(candidates)).all()


def test_large_search_runs_in_two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    meeting, argmax = threading.Barrier(2), np.argmax

    def meet(*given: object, **named: object) -> object:
        meeting.wait(timeout=LONG)  # breaks unless another thread searches meanwhile
        return argmax(*given, **named)  # type: ignore[call-overload]

    monkeypatch.setattr(module.np, "argmax", meet)
    zo.set_threads(2)
    assert (nearest(rows(QUERIES, 0), rows(POINTS, 1)) == closest()).all()


def test_small_search_stays_in_the_calling_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> Callable[[], None]:
        raise AssertionError("a small search was divided")

    monkeypatch.setattr(module, "MIN_SHARED_PRODUCTS", 1 << 30)
    monkeypatch.setattr(module, "for_each", refuse)
    assert (nearest(rows(QUERIES, 0), rows(POINTS, 1)) == closest()).all()
