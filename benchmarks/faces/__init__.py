# SPDX-License-Identifier: GPL-3.0-or-later
"""Expression keys transferred to other heads, beside methods that get the true landmarks."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.faces.cases import cases
from benchmarks.faces.measures import figures
from benchmarks.faces.methods import METHODS, SLOW_METHODS
from benchmarks.tables import NOT_SHOWN, Record, Tables, over

PRODUCT = "transfer"
# Methods whose time includes the match.
USE_MATCH = (PRODUCT, "along the map")


def run(data: Path, pairs: int | None, slow: bool) -> Tables:
    """Match heads, and transfer the keys of one to the other.

    `rows`: for each kind of pairs and each method the means of the figures over the pairs; see `figures`. `worst`:
    the pairs, by `zo.transfer`. Seconds are processor time; those of the product and of the map include the match.

    Args:
        data: a folder with the set `faces`, or the set itself.
        pairs: largest number of pairs of each kind; all if not given.
        slow: include non-rigid ICP, which takes minutes for each pair.
    """
    records: list[Record] = []
    for case in tqdm(list(cases(data, pairs)), leave=False):
        begin = process_time()
        match = zo.match(case.source, case.target)
        matched = process_time() - begin
        for name, method in (METHODS | (SLOW_METHODS if slow else {})).items():
            begin = process_time()
            keys = method(case, match)
            seconds = process_time() - begin
            if keys is not None:
                about = {"kind": case.kind, "pair": case.name, "method": name, "certainty": match.certainty}
                taken = seconds + matched if name in USE_MATCH else seconds
                records.append(about | figures(case, keys) | {"seconds": taken})
    product = [record for record in records if record["method"] == PRODUCT]
    return {"rows": _rows(records), "worst": sorted(product, key=lambda row: -row["error"]), NOT_SHOWN: records}


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for kind, method in dict.fromkeys((record["kind"], record["method"]) for record in records):
        chosen = [record for record in records if (record["kind"], record["method"]) == (kind, method)]
        row: Record = {"kind": kind, "method": method, "pairs": len(chosen)}
        means = {name: over(np.mean, chosen, name) for name in ("error", "median", "skin")}
        lips = {"lips, least": over(min, chosen, "lips"), "lips, most": over(max, chosen, "lips")}
        worst = {name: over(max, chosen, name) for name in ("worst", "blink", "solids", "bent")}
        sums = {name: int(sum(record[name] for record in chosen)) for name in ("flipped", "overturned", "torn")}
        rows.append(row | means | worst | lips | sums | {"seconds": over(np.mean, chosen, "seconds")})
    return rows
