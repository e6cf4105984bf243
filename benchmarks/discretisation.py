"""The same people meshed in other ways, each way against each: does the map depend on triangles?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.correspondence import ISOMETRIC_LIMIT
from benchmarks.datasets import TEMPLATE, PairOfMeshes, load_pair, pair_names, sets_in


def run(data: Path, pairs: int | None) -> dict[str, list[dict[str, Any]]]:
    """Match pairs of different people, whose meshes are named KIND_PERSON.

    `rows`: for each kind of target the mean error, times 1000, for each kind of source; `right`: how many pairs have
    less than 80, of how many. `pairs`: the error and certainty of each.

    Args:
        data: a set that has a common template, or a folder of sets.
        pairs: number of pairs of each set, evenly spread over its list.
    """
    records = []
    for folder in (folder for folder in sets_in(data) if (folder / TEMPLATE).is_file()):
        for names in tqdm(pair_names(folder, pairs), desc=folder.name, leave=False):
            result, error = matched(load_pair(folder, *names))
            target, source = (name.partition("_")[0] for name in names)
            records.append({"target": target, "source": source, "error": error, "certainty": result.certainty})
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
    return {"rows": rows, "right": right, "pairs": records}


def matched(pair: PairOfMeshes) -> tuple[zo.MatchResult, float]:
    """A cold match with nothing given, and its mean error, times 1000."""
    zo.forget_shapes()
    result = zo.match(pair.source, pair.target)
    return result, float(np.nanmean(pair.errors(result.surface_map.vertex[:, None])))
