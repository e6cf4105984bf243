# SPDX-License-Identifier: GPL-3.0-or-later
"""The error of a map by the size of the functional map fitted to descriptors, compared with ZoomOut.

As in Melzi et al. 2019: a larger functional map could resolve finer detail, but descriptors determine only its low
frequencies, and fitting the others overfits; a small map, refined by ZoomOut, gains the high frequencies.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.curves import draw_lines
from benchmarks.datasets import PairOfMeshes, load_pair, pair_names, sets_in
from benchmarks.paper.refinement import ISOMETRIC_LIMIT
from benchmarks.paper.starts import K_SIGNATURES
from benchmarks.stored import read_or_compute
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Integers
from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.maps.nearest import nearest

SIZES = list(range(10, 121, 10))
START, STEP = 20, 5
FITTED, REFINED, TRUE = "fitted", f"ZoomOut from {START}", "true"
# Sets of nearly isometric shapes, and default number of pairs of each.
SETS, PAIRS = ("faust_r", "tosca_r"), 3


def run(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Fit functional maps of 12 sizes to wave kernel signatures and orientation, and refine the one of size 20.

    `rows`, for each size: mean and median over the pairs of the mean geodesic error times 1000 of the vertex maps of
    the fitted functional map, of the one of size 20 refined by ZoomOut to that size, and of the functional map of
    the true correspondence, which bounds maps of that size; the share of failed pairs of the first two,
    and the median seconds of the fit. A pair takes 35 s.

    Args:
        data: the folder of the sets; nearly isometric ones are used.
        pairs: number of pairs of each set, evenly spread; three by default.
        figure: an image file for the mean errors by size.
    """
    records: list[Record] = []
    for folder in sets_in(data):
        if folder.name in SETS:
            for names in tqdm(pair_names(folder, pairs or PAIRS), desc=folder.name, leave=False):
                records += read_or_compute((folder.name, *names), partial(_of_names, folder, *names))
    rows = [_row(records, k) for k in SIZES if records]
    if figure is not None and rows:
        lines = {method: (SIZES, [row[f"{method}: mean"] for row in rows]) for method in (FITTED, TRUE)}
        refined = [row for row in rows if row[f"{REFINED}: mean"] is not None]
        lines[REFINED] = [row["size"] for row in refined], [row[f"{REFINED}: mean"] for row in refined]
        draw_lines(figure, lines, "size of the functional map", "mean geodesic error x 1000")
    return {"rows": rows, "pairs": records}


def _of_names(folder: Path, target_name: str, source_name: str) -> list[Record]:
    pair = load_pair(folder, target_name, source_name)
    bases = zo.eigenbasis(pair.source, K_SIGNATURES), zo.eigenbasis(pair.target, K_SIGNATURES)
    signatures = zo.wave_kernel_signature(bases[0]), zo.wave_kernel_signature(bases[1])
    operators = (
        zo.orientation_operators(pair.source, bases[0], signatures[0], max(SIZES)),
        zo.orientation_operators(pair.target, bases[1], signatures[1], max(SIZES)),
    )
    # The true correspondence, extended from known places to nearby vertices.
    true = pair.source_vertex[nearest(pair.target.vertices, pair.target.vertices[pair.target_vertex])]
    fits = {}
    records = []
    for k in SIZES:
        begin = perf_counter()
        fits[k] = zo.fit_functional_map(*bases, *signatures, k, orientation_operators=operators)
        seconds = perf_counter() - begin
        records.append(_record(pair, FITTED, k, vertex_map_of(fits[k], *bases)) | {"seconds": seconds})
        records.append(_record(pair, TRUE, k, vertex_map_of(functional_map_of(true, *bases, k, k), *bases)))
    refined = fits[START]
    records.append(_record(pair, REFINED, START, vertex_map_of(refined, *bases)))
    for k in (size for size in SIZES if size > START):
        upsampled = zo.zoomout(*bases, refined, samples=None, sizes=range(len(refined) + STEP, k + 1, STEP))
        refined = upsampled.functional_map
        records.append(_record(pair, REFINED, k, upsampled.vertex))
    return records


def _record(pair: PairOfMeshes, method: str, k: int, vertex: Integers) -> Record:
    error = float(np.nanmean(pair.errors(vertex[:, None])))
    return {"pair": f"{pair.target_name} {pair.source_name}", "method": method, "size": k, "error": error}


def _row(records: list[Record], k: int) -> Record:
    row: Record = {"size": k}
    for method in (FITTED, REFINED, TRUE):
        chosen = [record for record in records if (record["method"], record["size"]) == (method, k)]
        errors = np.array([record["error"] for record in chosen])
        row |= {f"{method}: mean": float(errors.mean()) if chosen else None}
        row |= {f"{method}: median": float(np.median(errors)) if chosen else None}
        if method is not TRUE:
            row |= {f"{method}: failed %": 100 * float((errors > ISOMETRIC_LIMIT).mean()) if chosen else None}
        if method is FITTED:
            row |= {"pairs": len(chosen), "seconds": float(np.median([record["seconds"] for record in chosen]))}
    return row
