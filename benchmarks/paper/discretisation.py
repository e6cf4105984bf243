# SPDX-License-Identifier: GPL-3.0-or-later
"""Does the map depend on the triangulation? People are meshed in several ways, and matched between all of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.correspondence import ISOMETRIC_LIMIT
from benchmarks.curves import draw_curves, share_below
from benchmarks.datasets import TEMPLATE, PairOfMeshes, load_pair, pair_names, sets_in
from benchmarks.paper.compared import mean_curves
from benchmarks.stored import read_or_compute
from benchmarks.tables import Record
from zoomout_core.arrays import Floats


def run(data: Path, pairs: int | None, figure: Path | None = None) -> dict[str, list[dict[str, Any]]]:
    """Match pairs of different people, whose meshes are named KIND_PERSON.

    `rows`: for each kind of target the mean error, times 1000, for each kind of source; `right`: the number of pairs
    with less than 80, and of all pairs. `pairs`: the error and certainty of each.

    Args:
        data: a set that has a common template, or a folder of sets.
        pairs: number of pairs of each set, evenly spread over its list.
        figure: an image file for the share of places below each error, a panel for each kind of target.
    """
    records: list[Record] = []
    for folder in (folder for folder in sets_in(data) if (folder / TEMPLATE).is_file()):
        for names in tqdm(pair_names(folder, pairs), desc=folder.name, leave=False):
            records += read_or_compute((folder.name, *names), partial(_of_names, folder, *names))
    kinds = sorted({record["target"] for record in records} | {record["source"] for record in records})
    rows: list[dict[str, Any]] = []
    right: list[dict[str, Any]] = []
    for target in kinds:
        of = {
            source: [each["error"] for each in records if (each["target"], each["source"]) == (target, source)]
            for source in kinds
        }
        rows.append(
            {"target": target} | {source: float(np.mean(errors)) if errors else None for source, errors in of.items()}
        )
        right.append(
            {"target": target}
            | {source: f"{sum(e < ISOMETRIC_LIMIT for e in errors)}/{len(errors)}" for source, errors in of.items()}
        )
    if figure is not None and records:
        draw_curves(figure, mean_curves("target", records, "source"))
    return {"rows": rows, "right": right, "pairs": records}


def _of_names(folder: Path, *names: str) -> list[Record]:
    result, errors = match(load_pair(folder, *names))
    target, source = (name.partition("_")[0] for name in names)
    measured = {"error": float(np.nanmean(errors)), "certainty": result.certainty, "curve": share_below(errors)}
    return [{"target": target, "source": source} | measured]


def match(pair: PairOfMeshes) -> tuple[zo.MatchResult, Floats]:
    """A cold match without hints, and (c,) its errors, times 1000, at the known places."""
    zo.forget_shapes()
    result = zo.match(pair.source, pair.target)
    return result, pair.errors(result.surface_map.vertex[:, None])[:, 0]
