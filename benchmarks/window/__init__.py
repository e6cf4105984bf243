# SPDX-License-Identifier: GPL-3.0-or-later
"""Responsiveness of Blender's window while operators run, latency of ESC, and the cost of undo."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any

import bpy
from bpy.types import Object

import blender_addon
import zoomout_core as zo
from benchmarks.window import scene, undo
from benchmarks.window.watching import Watch, watch
from blender_addon.demo.character import select_only

Record = dict[str, Any]

REPEATS, CANCELS = 3, 20
# Noticeable duration of a block in seconds.
NOTICED = 0.15
# Quantities in which the sides of a mesh are compared.
CHECKS = ("SHAPE", "WEIGHTS", "KEY")
TABLES = ("rows", "escape", "undo")


def run(data: Path, tables: tuple[str, ...] = TABLES) -> dict[str, list[Record]]:
    """Run each operator as in a window, except for Blender's drawing between ticks of the timer.

    Args:
        data: the folder of the sets.
        tables: the tables to compute.

    Returns:
        `rows`: for each operator the wall-clock and processor seconds from the click to the end, the longest
        step before it writes and the processor time of the window's thread in it, the seconds of the last step, which
        writes, the longest tick of the timer, and the number of noticeable ticks; of several matches the
        medians.
        `stages`: the time of each stage of matching, cold and warm.
        `escape`: for ESC at evenly spread moments of a match, the longest time until the window is free, the part of it
        that closes the job, and the longest time until the last thread has ended.
        `undo`: see `undo.rows`.
    """
    if not scene.is_there(data):
        return {"rows": []}
    with blender_addon.registered():
        made = _operators(data) if "rows" in tables else {"rows": []}
        if "escape" in tables:
            made["escape"] = _escapes(data)
        if "undo" in tables:
            made["undo"] = undo.rows()
    return made


def _operators(data: Path) -> dict[str, list[Record]]:
    source, target = scene.make_pair(data)
    select_only(target)
    cold = [_cold() for _ in range(REPEATS)]
    warm = [watch(bpy.ops.zoomout.match) for _ in range(REPEATS)]
    rows = [_row("match, cold", cold), _row("match, warm", warm)]
    rows += [*_measure_target(data), *_measure_source(source)]
    stages = [{"match": name} | row for name, runs in (("cold", cold), ("warm", warm)) for row in _stages(runs)]
    return {"rows": rows, "stages": stages}


def _stages(runs: list[Watch]) -> list[Record]:
    """Median time of each stage. A stage shorter than a tick of the timer is missing in some runs: it counts as 0."""
    seen = [run.of_stages() for run in runs]
    times = {stage: [stages.get(stage, (0.0, 0.0)) for stages in seen] for stage in chain.from_iterable(seen)}
    return [
        {
            "stage": stage,
            "seconds": median(clock for clock, _ in each),
            "processor": median(processor for _, processor in each),
        }
        for stage, each in times.items()
    ]


def _cold() -> Watch:
    zo.forget_shapes()
    return watch(bpy.ops.zoomout.match)


def _measure_target(data: Path) -> list[Record]:
    """Rows of the operators that use a match, in order."""
    do = bpy.ops.zoomout
    rows = [
        _measure("preview, places", do.preview, kind="PLACES"),
        _measure("preview, checker", do.preview, kind="CHECKER"),
        _measure("swap sides", do.swap_match_sides),
    ]
    do.clear_preview()
    rows += [_measure("transfer", do.transfer), _measure("match, names on both", do.match)]
    scene.put_together()
    rows += [
        _measure("match, nearest points", do.match, initial="NEAREST"),
        _measure("match, same order", do.match, initial="SAME_ORDER"),
        _measure("cut along seams", do.cut_seams),
    ]
    scene.make_collections(data)
    return [*rows, _measure("match collections", do.match_collections)]


def _measure_source(source: Object) -> list[Record]:
    """Rows of the operators that use a symmetry, in order."""
    do = bpy.ops.zoomout
    select_only(source)
    source.vertex_groups.active_index, source.active_shape_key_index = 0, 1
    rows = [
        _measure("detect symmetry", do.detect_symmetry),
        _measure("preview, symmetry", do.preview, kind="PAIRS"),
        _measure("swap its sides", do.swap_sides),
        _measure("symmetrise weights", do.symmetrise_weights),
        _measure("split a shape key", do.mirror_shape_key, key_mode="SPLIT"),
        _measure("mirror attributes", do.mirror_attributes),
        *(_measure(f"check symmetry, {check.lower()}", do.check_symmetry, check=check) for check in CHECKS),
        _measure("select symmetry line", do.select_symmetry_line),
        _measure("name sides", do.name_sides),
    ]
    scene.sculpt(source)
    return [*rows, _measure("mirror sculpt", do.mirror_sculpt)]


def _measure(name: str, operator: Callable[..., object], **options: str) -> Record:
    return _row(name, [watch(partial(operator, **options))])


def _row(operator: str, runs: list[Watch]) -> Record:
    return {
        "operator": operator,
        "seconds": median(run.seconds for run in runs),
        "processor": median(run.processor for run in runs),
        "longest step": median(run.longest.clock for run in runs),
        "of its thread": median(run.longest.thread for run in runs),
        "last step": median(run.steps[-1].clock for run in runs),
        "longest tick": median(max(run.ticks) for run in runs),
        f"ticks over {NOTICED} s": median(sum(tick > NOTICED for tick in run.ticks) for run in runs),
        "ticks": median(len(run.ticks) for run in runs),
        "longest in": runs[-1].longest.stage,
    }


def _escapes(data: Path) -> list[Record]:
    """ESC at evenly spread moments of a match, cold and with both shapes cached."""
    _, target = scene.make_pair(data)
    select_only(target)
    rows = []
    for name, match in (("match, cold", _cold), ("match, warm", partial(watch, bpy.ops.zoomout.match))):
        whole = match().seconds
        ended = []
        for number in range(CANCELS):
            if name == "match, cold":
                zo.forget_shapes()
            ended.append(watch(bpy.ops.zoomout.match, escape_after=whole * (number + 0.5) / CANCELS))
        ended = [run for run in ended if run.closing]  # the last may have been faster than the first
        rows.append(
            {
                "operator": name,
                "cancels": len(ended),
                "longest wait": max(run.ticks[-1] + run.closing for run in ended),
                "of that closing": max(run.closing for run in ended),
                "threads end after": max(run.trailing for run in ended),
                "median of that": median(run.trailing for run in ended),
            }
        )
    return rows
