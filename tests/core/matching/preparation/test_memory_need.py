# SPDX-License-Identifier: GPL-3.0-or-later
"""A match that exceeds the memory is rejected before it starts, with a suggestion that would fit."""

from __future__ import annotations

import re

import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.matching.preparation import memory_need
from zoomout_core.matching.preparation.memory_need import GIB, check_memory

MILLION = [1_000_000, 800_000]


def refusal(monkeypatch: pytest.MonkeyPatch, free: float, vertices: list[int], proxy_vertices: int | None) -> str:
    """The error message when `free` GiB are available."""
    monkeypatch.setattr(memory_need, "free_memory", lambda: int(free * GIB))
    with pytest.raises(zo.MeshError) as refused:
        check_memory(vertices, 200, proxy_vertices)
    return str(refused.value)


def test_fitting_or_unknown_memory_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for free in (None, 100 * GIB):
        monkeypatch.setattr(memory_need, "free_memory", lambda free=free: free)
        check_memory(MILLION, 200, None)


@pytest.mark.parametrize(("free", "detail"), [(1.75, "fine"), (1.65, "balanced"), (1.5, "fast")])
def test_finest_detail_that_fits_is_suggested(monkeypatch: pytest.MonkeyPatch, free: float, detail: str) -> None:
    said = refusal(monkeypatch, free, MILLION, None)
    assert f"1,000,000 and 800,000 vertices need about 38.3 GiB of memory, but only {free:.1f} GiB are free" in said
    assert f"use detail '{detail}'" in said


def test_suggested_size_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    for vertices, proxy_vertices in ((MILLION, None), ([3_000_000], 8000)):
        said = refusal(monkeypatch, 1.0, vertices, proxy_vertices)
        fitting = [int(n.replace(",", "")) for n in re.findall(r"\d+,[\d,]+", said.partition("simplify them to")[2])]
        assert len(fitting) == len(vertices)
        check_memory(fitting, 200, proxy_vertices)
        with pytest.raises(zo.MeshError):
            check_memory([int(1.1 * n + 0.02 * all_of) for n, all_of in zip(fitting, vertices, strict=True)], 200, None)


def test_closing_programs_is_suggested_if_nothing_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    said = refusal(monkeypatch, 0.01, [100, 100], 500)
    assert said.endswith("0.0 GiB are free: close other programs.")


def test_match_and_symmetry_are_refused_before_they_start(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = creature(300).surface
    monkeypatch.setattr(memory_need, "free_memory", lambda: 1 << 20)
    with pytest.raises(zo.MeshError, match="Meshes of 300 and 300 vertices need about 0"):
        zo.match(surface, surface)
    with pytest.raises(zo.MeshError, match="Meshes of 300 vertices need"):
        zo.detect_symmetry(surface)
