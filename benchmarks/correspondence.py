"""How often `match` is right with no hint, how exact it is, and how long it takes; published maps beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import PairOfMeshes, load_pair, pair_names, sets_in
from zoomout_core.correspondence.matching import SURE

# Mean error times 1000 above which a pair counts as failed.
ISOMETRIC_LIMIT, NON_ISOMETRIC_LIMIT = 80, 130


def run(data: Path, pairs: int | None) -> list[dict[str, Any]]:
    """A row for each set and method: success, mean and median over the pairs, median seconds of a cold pair.

    Calibration: the share of maps that are announced as sure, and how many of these are right.
    """
    rows = []
    for folder in sets_in(data):
        names = pair_names(folder, pairs)
        limit = NON_ISOMETRIC_LIMIT if "nonisometric" in folder.name else ISOMETRIC_LIMIT
        errors, seconds, certainties = [], [], []
        for target_name, source_name in tqdm(names, desc=folder.name, leave=False):
            pair = load_pair(folder, target_name, source_name)
            start = perf_counter()
            result = zo.match(pair.source, pair.target)
            seconds.append(perf_counter() - start)
            errors.append(1000 * _error(result.surface_map.vertex, pair))
            certainties.append(result.certainty)
        sure = np.array(certainties) >= SURE
        right = np.array(errors)[sure] < limit
        calibration = {
            "sure %": float(100 * sure.mean()),
            "sure and right %": float(100 * right.mean()) if sure.any() else None,
        }
        rows.append(_row(folder.name, "zo.match", errors, limit, seconds) | calibration)
        rows += [
            _row(folder.name, path.stem.removeprefix("map_"), _published(path, folder, names), limit, None)
            for path in sorted(folder.glob("map_*.npz"))
        ]
    return rows


def _published(path: Path, folder: Path, names: list[tuple[str, str]]) -> list[float]:
    errors = []
    with np.load(path) as maps:
        for target_name, source_name in names:
            if f"{target_name}__{source_name}" in maps:
                vertex = maps[f"{target_name}__{source_name}"]
                errors.append(1000 * _error(vertex, load_pair(folder, target_name, source_name)))
    return errors


def _error(vertex: np.ndarray, pair: PairOfMeshes) -> float:
    mapped = vertex[pair.target_vertex] >= 0
    errors = zo.geodesic_error(vertex, pair.source, pair.target_vertex[mapped], pair.source_vertex[mapped])
    return float(errors[np.isfinite(errors)].mean())  # an image on a loose part has no distance to the body


def _row(name: str, method: str, errors: list[float], limit: float, seconds: list[float] | None) -> dict[str, Any]:
    def over(statistic: Callable[[list[float]], Any], values: list[float] | None) -> float | None:
        return float(statistic(values)) if values else None

    return {
        "set": name,
        "method": method,
        "pairs": len(errors),
        "success %": over(lambda values: 100 * np.mean(np.array(values) < limit), errors),
        "mean": over(np.mean, errors),
        "median": over(np.median, errors),
        "seconds": over(np.median, seconds),
    }
