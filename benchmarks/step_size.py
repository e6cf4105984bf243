"""How much the functional map may grow in a step of ZoomOut, beside spectral ICP at its final size.

As in Melzi et al. 2019: horses in poses, from a map of size 10 to one of size 310, all vertices in every step. They
found steps of 1 to 10 as good as each other.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.spectral_icp import spectral_icp
from benchmarks.datasets import PairOfMeshes, load_pair, sets_in, shipped_map, shipped_pairs
from zoomout_core.arrays import Floats, Integers

INITIAL, FINAL = 10, 310
STEPS = (1, 2, 3, 4, 5, 10, 20, 30, 40, 50)
CLASS, PAIRS = "horse", 4
START = "WKSini_direct"
ICP = "spectral ICP"


def run(data: Path, pairs: int | None) -> dict[str, list[dict[str, Any]]]:
    """Refine the shipped initial maps of pairs of horses.

    `rows`: for each step, and spectral ICP, the mean error over the pairs, times 1000, and the median seconds. `pairs`:
    each pair's.

    Args:
        data: the folder of the sets.
        pairs: number of pairs, four when not given.
    """
    records: list[dict[str, Any]] = []
    for folder in sets_in(data):
        names = [names for names in shipped_pairs(folder, START) if all(name.startswith(CLASS) for name in names)]
        for chosen in tqdm(names[: pairs or PAIRS], desc=folder.name, leave=False):
            pair = load_pair(folder, *chosen)
            records += _of_pair(pair, shipped_map(folder, START, *chosen))
    methods = dict.fromkeys(record["step"] for record in records)
    return {"rows": [_row(records, method) for method in methods], "pairs": records}


def _of_pair(pair: PairOfMeshes, initial: Integers) -> list[dict[str, Any]]:
    source, target = (zo.eigenbasis(surface, FINAL) for surface in (pair.source, pair.target))
    start = zo.functional_map_of(initial, source, target, INITIAL, INITIAL)
    runs: dict[int | str, Callable[[], Integers]] = {"initial": lambda: initial}
    runs[ICP] = lambda: spectral_icp(source, target, initial, FINAL).vertex
    for step in STEPS:
        runs[step] = partial(_upsampled, source, target, start, step)
    records = []
    for method, refined in runs.items():
        begin = perf_counter()
        vertex = refined()
        seconds = perf_counter() - begin
        error = float(np.nanmean(pair.errors(vertex[:, None])))
        records.append(
            {"pair": f"{pair.target_name} {pair.source_name}", "step": method, "error": error, "seconds": seconds}
        )
    return records


def _upsampled(source: zo.SpectralBasis, target: zo.SpectralBasis, start: Floats, step: int) -> Integers:
    return zo.zoomout(source, target, start, FINAL, step, None).vertex


def _row(records: list[dict[str, Any]], method: Any) -> dict[str, Any]:
    chosen = [record for record in records if record["step"] == method]
    return {
        "step": str(method),
        "pairs": len(chosen),
        "mean error": float(np.mean([record["error"] for record in chosen])),
        "seconds": float(np.median([record["seconds"] for record in chosen])),
    }
