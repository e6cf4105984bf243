# SPDX-License-Identifier: GPL-3.0-or-later
"""The time of a match by function, and the speed of the machine to compare it with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from cProfile import Profile
from pathlib import Path
from pstats import Stats
from time import perf_counter
from typing import Any
from unittest.mock import patch

import numpy as np

import zoomout_core as zo
from benchmarks.timings.speed import sized_pairs
from zoomout_core.mesh.surface import Surface

Record = dict[str, Any]

SHOWN = 15
GEMM, COPIED = 2000, 1 << 26


def run(data: Path, pairs: int | None) -> dict[str, list[Record]]:
    """Profile one match of each pair, in a single thread, so that every function is included.

    Args:
        data: the folder of the sets.
        pairs: number of pairs, the smallest first.

    Returns:
        `rows`: for each pair the functions with the most time of their own. `machine`: its speed.
    """
    rows: list[Record] = []
    for pair in list(sized_pairs(data))[:pairs]:
        source, target = (Surface(surface.vertices, surface.triangles) for surface in (pair.source, pair.target))
        zo.forget_shapes()
        profile = Profile()
        with patch("zoomout_core.runtime.threads._in_threads", _one_after_the_other):
            profile.enable()
            zo.match(source, target)
            profile.disable()
        stats: dict[tuple[str, int, str], tuple[int, int, float, float, Any]] = Stats(profile).stats  # type: ignore[attr-defined]
        total = sum(own for _, _, own, _, _ in stats.values())
        for (file, line, name), (_, calls, own, whole, _) in sorted(stats.items(), key=lambda item: -item[1][2])[
            :SHOWN
        ]:
            where = name if line == 0 else f"{Path(file).stem}.{name}"
            rows.append(
                {
                    "pair": pair.name,
                    "vertices": len(target.vertices),
                    "function": where,
                    "calls": calls,
                    "own seconds": own,
                    "with callees": whole,
                    "share": f"{own / total:.0%}",
                }
            )
    return {"rows": rows, "machine": [_machine()]}


def _one_after_the_other(works: Sequence[Callable[[], Any]]) -> list[Any]:
    """A serial replacement of threads, which the profiler does not follow."""
    return [work() for work in works]


def _machine() -> Record:
    random = np.random.default_rng(0)
    a = random.standard_normal((GEMM, GEMM)).astype(np.float32)
    products = min(_seconds(lambda: a @ a) for _ in range(3))
    block = np.ones(COPIED // 8)
    copies = min(_seconds(block.copy) for _ in range(3))
    return {"float32 GFLOP/s": 2 * GEMM**3 / products / 1e9, "GB/s copied": 2 * COPIED / copies / 1e9}


def _seconds(work: Any) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start
