# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of the window's responsiveness: every operator is measured, as are ESC and undo."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import bpy
import pytest
from conftest import write_off
from creatures import creature

from benchmarks import window
from benchmarks.window import scene, undo
from benchmarks.window.watching import watch
from blender_addon.demo import Size
from blender_addon.jobs import pause
from blender_addon.operators.base import modal_operator

pytestmark = pytest.mark.slow

SMALL = Size(cell=0.05, voxel=0.04, target_vertices=1500)
BENDS = {"michael0": 0.0, "michael10": 0.9, "horse0": 0.0, "horse6": 0.6}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two poses of each of two meshes."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "tosca_full").mkdir()
    for name, bend in BENDS.items():
        seed, count = (0, 600) if name in scene.CHARACTERS else (1, 500)
        write_off(folder / "tosca_full" / f"{name}.off", creature(count, seed, bend).surface)
    return folder


@pytest.fixture(scope="module")
def tables(data: Path) -> Iterator[dict[str, list[window.Record]]]:
    """All tables of one run."""
    changes = (scene, "GROUPS", 2), (scene, "KEYS", 2), (window, "REPEATS", 1), (window, "CANCELS", 3)
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in (*changes, (undo, "rows", partial(undo.rows, SMALL, 30, 3))):
            patch.setattr(module, name, value)
        yield window.run(data)


def test_the_add_on_is_gone_afterwards(tables: dict[str, list[window.Record]]) -> None:
    assert tables.keys() == {"rows", "stages", "escape", "undo"}
    assert not hasattr(bpy.types.Scene, "zoomout")


def test_every_operator_is_measured(tables: dict[str, list[window.Record]]) -> None:
    rows = {row["operator"]: row for row in tables["rows"]}
    assert len(rows) == len(tables["rows"]) > 20
    assert {"match, cold", "match, warm", "transfer", "match collections", "cut along seams", "mirror sculpt"} <= {
        *rows
    }
    for row in rows.values():
        assert 0 < row["longest tick"] <= row["seconds"]
        assert row["ticks over 0.15 s"] <= row["ticks"]
    cold = [row for row in tables["stages"] if row["match"] == "cold"]
    assert sum(row["seconds"] for row in cold) == pytest.approx(rows["match, cold"]["seconds"], rel=0.05)


def test_escape_is_measured_during_matches(tables: dict[str, list[window.Record]]) -> None:
    cold, warm = tables["escape"]
    assert (cold["operator"], warm["operator"]) == ("match, cold", "match, warm")
    for row in (cold, warm):
        assert 0 < row["cancels"] <= 3
        assert row["of that closing"] <= row["longest wait"]


def test_escaped_operator_writes_nothing() -> None:
    written = []

    async def work() -> str:
        await pause()
        written.append("all")
        return "Done"

    seen = watch(lambda: modal_operator.run(work()), escape_after=0.0)
    assert not written
    assert not seen.steps
    assert seen.closing > 0


def test_transfer_is_undone_and_redone_exactly(tables: dict[str, list[window.Record]]) -> None:
    rows = tables["undo"]
    assert [row["step"] for row in rows] == ["transfer", "keep a step of undo", "undo", "redo"]
    assert [row["exact"] for row in rows] == [True, None, True, True]
    assert all(row["seconds"] > 0 for row in rows)
