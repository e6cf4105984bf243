"""How large the functional map that ZoomOut begins with has to be, and how much noise it may have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.correspondence import ISOMETRIC_LIMIT
from benchmarks.datasets import PairOfMeshes, load_pair, sets_in, shipped_map, shipped_pairs
from zoomout_core.arrays import Floats

START = "WKSini_direct"
SIZES = (2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 40, 50)
FINAL = 120
# Noise is added to true maps of this size, of these standard deviations, so often.
NOISY_SIZE, NOISES, DRAWS = 4, (0.1, 0.2, 0.4, 0.8), 100


def run(data: Path, pairs: int | None) -> dict[str, list[dict[str, Any]]]:
    """Refine maps of several sizes, and true maps of size 4 with noise.

    `rows`: for each size the mean error, times 1000, of what becomes of the shipped initial map's functional map of
    that size. `noise`: how many of 100 noisy maps, over the pairs, end at a mean error below 80. Growth is by one up to
    size 20, since a small map says nothing of many functions.

    Args:
        data: the folder of the sets.
        pairs: number of pairs of each set, evenly spread; two when not given.
    """
    sized: list[dict[str, Any]] = []
    noisy: list[dict[str, Any]] = []
    for folder in sets_in(data):
        names = shipped_pairs(folder, START)
        chosen = [names[i] for i in np.linspace(0, len(names) - 1, min(pairs or 2, len(names))).round().astype(int)]
        for each in tqdm(chosen, desc=folder.name, leave=False):
            pair = load_pair(folder, *each)
            bases = zo.eigenbasis(pair.source, FINAL), zo.eigenbasis(pair.target, FINAL)
            initial = shipped_map(folder, START, *each)
            for size in SIZES:
                error = _error(pair, bases, zo.functional_map_of(initial, *bases, size, size))
                sized.append({"size": size, "error": error})
            draws = max(1, DRAWS // len(chosen))
            noisy += [{"noise": noise, "error": error} for noise, error in _noisy_errors(pair, bases, draws)]
    return {
        "rows": [_of_size(sized, size) for size in SIZES if sized],
        "noise": [_of_noise(noisy, n) for n in NOISES if noisy],
    }


def _noisy_errors(pair: PairOfMeshes, bases: tuple[zo.SpectralBasis, zo.SpectralBasis], draws: int) -> Any:
    true, random = true_map(pair, *bases, NOISY_SIZE), np.random.default_rng(0)
    for noise in NOISES:
        for _ in range(draws):
            yield noise, _error(pair, bases, true + noise * random.standard_normal(true.shape))


def true_map(pair: PairOfMeshes, source: zo.SpectralBasis, target: zo.SpectralBasis, k: int) -> Floats:
    """(k, k) the functional map that fits the known places best."""
    on_target, on_source = target.eigenvectors[pair.target_vertex, :k], source.eigenvectors[pair.source_vertex, :k]
    return np.asarray(np.linalg.lstsq(on_target, on_source, rcond=None)[0])


def _error(pair: PairOfMeshes, bases: tuple[zo.SpectralBasis, zo.SpectralBasis], start: Floats) -> float:
    small = range(len(start) + 1, 20)
    large = range(max(20, len(start) + 5), FINAL + 1, 5)
    refined = zo.zoomout(*bases, start, sizes=[*small, *large])
    return float(np.nanmean(pair.errors(refined.vertex[:, None])))


def _of_size(records: list[dict[str, Any]], size: int) -> dict[str, Any]:
    errors = np.array([record["error"] for record in records if record["size"] == size])
    return {
        "size": size,
        "pairs": len(errors),
        "mean error": float(errors.mean()),
        "right": int((errors < ISOMETRIC_LIMIT).sum()),
    }


def _of_noise(records: list[dict[str, Any]], noise: float) -> dict[str, Any]:
    errors = np.array([record["error"] for record in records if record["noise"] == noise])
    return {"noise": noise, "draws": len(errors), "converged": int((errors < ISOMETRIC_LIMIT).sum())}
