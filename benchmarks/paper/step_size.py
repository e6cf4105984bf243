# SPDX-License-Identifier: GPL-3.0-or-later
"""The effect of ZoomOut's step size, compared with spectral ICP at the final size.

As in Melzi et al. 2019: posed horses, from a map of size 10 to one of size 310. They found steps of 1 to 10 equally
good. They iterate on all vertices; here on 1500 farthest samples of each shape, with all vertices in the
last conversion, which takes a tenth of the time. ICP iterates on all vertices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.spectral_icp import spectral_icp
from benchmarks.curves import draw_lines
from benchmarks.datasets import PairOfMeshes, load_pair, sets_in, shipped_map, shipped_pairs
from benchmarks.paper.compared import compare
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Integers
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.maps.upsample import upsample
from zoomout_core.spectral.sampling import farthest_points

INITIAL, FINAL = 10, 310
STEPS = (1, 2, 3, 4, 5, 10, 20, 30, 40, 50)
SAMPLES = 1500
CLASS, PAIRS = "horse", 4
START = "WKSini_direct"
ICP = "spectral ICP"


def run(data: Path, pairs: int | None, figure: Path | None = None) -> Tables:
    """Refine the shipped initial maps of pairs of horses.

    `rows`: for each step, and spectral ICP, the mean error over the pairs, times 1000, and the median seconds, without
    eigenbases and samples. `pairs`: each pair.

    Args:
        data: the folder of the sets.
        pairs: number of pairs, four at most.
        figure: an image file for error and seconds by step.
    """
    records: list[Record] = []
    for folder in sets_in(data):
        names = [names for names in shipped_pairs(folder, START) if all(name.startswith(CLASS) for name in names)]
        for chosen in tqdm(names[: min(pairs or PAIRS, PAIRS)], desc=folder.name, leave=False):
            pair = load_pair(folder, *chosen)
            records += _of_pair(pair, shipped_map(folder, START, *chosen))
    methods = dict.fromkeys(record["step"] for record in records)
    rows = [_row(records, method) for method in methods]
    if figure is not None and rows:
        _draw(rows, figure)
    return {"rows": rows, "pairs": records}


def _of_pair(pair: PairOfMeshes, initial: Integers) -> list[Record]:
    source, target = (zo.eigenbasis(surface, FINAL) for surface in (pair.source, pair.target))
    on_source, on_target = (
        SampledBasis.of(basis, farthest_points(basis.points, SAMPLES)) for basis in (source, target)
    )
    start = zo.functional_map_of(initial, source, target, INITIAL, INITIAL)

    def upsample_by(step: int) -> Integers:
        return zo.vertex_map_of(upsample(on_source, on_target, start, FINAL, step)[0], source, target)

    methods: dict[str, Integers | Callable[[], Integers]] = {"initial": initial}
    methods[ICP] = lambda: spectral_icp(source, target, initial, FINAL).vertex
    for step in STEPS:
        methods[str(step)] = partial(upsample_by, step)
    return [record | {"step": record["method"]} for record in compare(pair, methods, {})[0]]


def _row(records: list[Record], method: str) -> Record:
    chosen = [record for record in records if record["step"] == method]
    seconds = [record["seconds"] for record in chosen if record["seconds"] is not None]
    return {
        "step": method,
        "pairs": len(chosen),
        "mean error": float(np.mean([record["error"] for record in chosen])),
        "seconds": float(np.median(seconds)) if seconds else None,
    }


def _draw(rows: list[Record], figure: Path) -> None:
    """Error and seconds by step, and the errors of the initial map and of ICP as level lines."""
    by_step = {row["step"]: row for row in rows}
    lines: dict[str, tuple[Sequence[float], Sequence[float]]] = {
        f"ZoomOut, {name}": (STEPS, [by_step[str(step)][column] for step in STEPS])
        for name, column in (("error", "mean error"), ("seconds", "seconds"))
    }
    ends = STEPS[0], STEPS[-1]
    for method in ("initial", ICP):
        lines[f"{method}, error"] = ends, [by_step[method]["mean error"]] * 2
    draw_lines(figure, lines, "step", "mean geodesic error, times 1000; seconds")
