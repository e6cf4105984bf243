# SPDX-License-Identifier: GPL-3.0-or-later
"""Free memory on all operating systems."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from zoomout_core.runtime import memory
from zoomout_core.runtime.memory import free_memory

MEMINFO = "MemTotal:  100000 kB\nMemFree:  100 kB\nMemAvailable:  2000 kB\n"


def write_files(root: Path, **texts: str) -> None:
    for name, text in texts.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.fixture(autouse=True)
def without_unix_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the calls that Windows lacks."""
    monkeypatch.delattr(os, "sysconf", raising=False)
    monkeypatch.setitem(__import__("sys").modules, "resource", None)


def test_unknown_free_memory_is_none(tmp_path: Path) -> None:
    assert free_memory(tmp_path) is None


def test_available_memory_counts_rather_than_unused_memory(tmp_path: Path) -> None:
    write_files(tmp_path, proc__meminfo=MEMINFO)
    assert free_memory(tmp_path) == 2000 << 10


def test_container_limit_bounds_free_memory(tmp_path: Path) -> None:
    write_files(tmp_path, proc__meminfo=MEMINFO)
    limit, taken = (tmp_path / name for name in memory.GROUPS[0])
    limit.parent.mkdir(parents=True)
    limit.write_text("max\n")
    taken.write_text("700\n")
    assert free_memory(tmp_path) == 2000 << 10
    limit.write_text("1000\n")
    assert free_memory(tmp_path) == 300
    limit.write_text("500\n")
    assert free_memory(tmp_path) == 0


def test_total_memory_is_the_last_resort(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}
    monkeypatch.setattr(os, "sysconf", sizes.__getitem__, raising=False)
    assert free_memory(tmp_path) == 4096000


def test_address_space_limit_bounds_free_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (10 * resource.getpagesize(), -1))
    write_files(tmp_path, proc__self__statm="7 5 4 3 2 1 0")
    assert free_memory(tmp_path) == 3 * resource.getpagesize()
