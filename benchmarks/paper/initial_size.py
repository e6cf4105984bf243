# SPDX-License-Identifier: GPL-3.0-or-later
"""The smallest size and largest noise of an initial functional map from which ZoomOut succeeds.

Melzi et al. 2019 iterate on all vertices. Here ZoomOut uses 500 farthest samples of each shape. At the end, images of
the known places are searched among all vertices.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.correspondence import ISOMETRIC_LIMIT
from benchmarks.curves import draw_lines
from benchmarks.datasets import PairOfMeshes, evenly, is_far, load_pair, sets_in, shipped_map, shipped_pairs
from benchmarks.stored import read_or_compute
from benchmarks.tables import Record
from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.maps.upsample import upsample
from zoomout_core.spectral.sampling import farthest_points

START = "WKSini_direct"
SIZES = (2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 40, 50)
FINAL, SAMPLES = 120, 500
# A map grows by one function up to this size, because a small map cannot predict many functions; then by five.
SLOWLY = 20
# Size of true maps to which noise is added, its standard deviations, and number of samples over all pairs.
NOISY_SIZE, NOISES, DRAWS = 4, (0.0, 0.2, 0.4, 0.8), 100
PAIRS = 10


def run(data: Path, pairs: int | None, figure: Path | None = None) -> dict[str, list[dict[str, Any]]]:
    """Refine maps of several sizes, and true maps of size 4 with noise.

    `rows`: for each size the mean error, times 1000, of the shipped initial map's functional map of that size, before
    and after ZoomOut, and the number of pairs that end below 80. `noise`: how many of 100 noisy maps, over the pairs,
    end at a mean error below 80. Sets of shapes that are far from isometric are left out.

    Args:
        data: the folder of the sets.
        pairs: number of pairs of each set, evenly spread; ten by default.
        figure: an image file for the errors by size.
    """
    found: list[Record] = []
    for folder in sets_in(data):
        names = [] if is_far(folder.name) else shipped_pairs(folder, START)
        chosen = evenly(names, pairs or PAIRS)
        for number, each in enumerate(tqdm(chosen, desc=folder.name, leave=False)):
            draws = DRAWS // len(chosen) + (number < DRAWS % len(chosen))
            found += read_or_compute((folder.name, *each, str(draws)), partial(_of_names, folder, each, draws))
    sized, noisy = ([record for record in found if column in record] for column in ("size", "noise"))
    rows = [_of_size(sized, size) for size in SIZES if sized]
    if figure is not None and rows:
        _draw(rows, figure)
    return {"rows": rows, "noise": [_of_noise(noisy, n) for n in NOISES if noisy]}


def _of_names(folder: Path, names: tuple[str, str], draws: int) -> list[Record]:
    """The records of a pair: one for each size, and one for each draw of each noise."""
    growth = _Growth.of(load_pair(folder, *names))
    initial = shipped_map(folder, START, *names)
    starts = [zo.functional_map_of(initial, growth.source, growth.target, size, size) for size in SIZES]
    records: list[Record] = [
        {"size": size, "initial": before, "error": after}
        for size, before, after in zip(SIZES, growth.errors(starts), growth.refined_errors(starts), strict=True)
    ]
    true, random = true_map(growth.pair, growth.source, growth.target, NOISY_SIZE), np.random.default_rng(0)
    for noise in NOISES:
        drawn = true + noise * random.standard_normal((draws, *true.shape))
        records += [{"noise": noise, "error": error} for error in growth.refined_errors(list(drawn))]
    return records


def true_map(pair: PairOfMeshes, source: zo.SpectralBasis, target: zo.SpectralBasis, k: int) -> Floats:
    """(k, k) the least-squares functional map of the known places."""
    on_target, on_source = target.eigenvectors[pair.target_vertex, :k], source.eigenvectors[pair.source_vertex, :k]
    return np.asarray(np.linalg.lstsq(on_target, on_source, rcond=None)[0])


@dataclass(frozen=True, eq=False)
class _Growth:
    """The bases that ZoomOut needs for a pair.

    Attributes:
        pair: with its known places.
        source: FINAL eigenfunctions of the shape with the images.
        target: those of the shape to be mapped.
        on_source: the source's at samples.
        on_target: the target's at samples.
    """

    pair: PairOfMeshes
    source: zo.SpectralBasis
    target: zo.SpectralBasis
    on_source: SampledBasis
    on_target: SampledBasis

    @classmethod
    def of(cls, pair: PairOfMeshes) -> _Growth:
        """Compute bases and samples of a pair."""
        source, target = zo.eigenbasis(pair.source, FINAL), zo.eigenbasis(pair.target, FINAL)
        on_source, on_target = (
            SampledBasis.of(basis, farthest_points(basis.points, SAMPLES)) for basis in (source, target)
        )
        return cls(pair, source, target, on_source, on_target)

    def refined_errors(self, starts: list[Floats]) -> list[float]:
        """The mean error of each initial map (k, k) after ZoomOut."""
        return self.errors([self._refine(start) for start in starts])

    def errors(self, functional_maps: list[Floats]) -> list[float]:
        """The mean error, times 1000, of each functional map (k, k) at the known places."""
        vertex = np.full((len(self.target.areas), len(functional_maps)), -1)
        for column, functional_map in enumerate(functional_maps):
            vertex[self.pair.target_vertex, column] = self._images(functional_map)
        return [float(error) for error in np.nanmean(self.pair.errors(vertex), axis=0)]

    def _refine(self, start: Floats) -> Floats:
        if len(start) < SLOWLY:
            start, _ = upsample(self.on_source, self.on_target, start, SLOWLY, 1)
        return upsample(self.on_source, self.on_target, start, FINAL, 5)[0]

    def _images(self, functional_map: Floats) -> Integers:
        """(c,) the source vertex of each known place of the target."""
        k_target, k_source = functional_map.shape
        queries = self.target.eigenvectors[self.pair.target_vertex, :k_target]
        return nearest(queries, self.source.eigenvectors[:, :k_source] @ functional_map.T)


def _of_size(records: list[dict[str, Any]], size: int) -> dict[str, Any]:
    chosen = [record for record in records if record["size"] == size]
    errors = np.array([record["error"] for record in chosen])
    return {
        "size": size,
        "pairs": len(errors),
        "initial": float(np.mean([record["initial"] for record in chosen])),
        "mean error": float(errors.mean()),
        "right": int((errors < ISOMETRIC_LIMIT).sum()),
    }


def _of_noise(records: list[dict[str, Any]], noise: float) -> dict[str, Any]:
    errors = np.array([record["error"] for record in records if record["noise"] == noise])
    return {"noise": noise, "draws": len(errors), "converged": int((errors < ISOMETRIC_LIMIT).sum())}


def _draw(rows: list[dict[str, Any]], figure: Path) -> None:
    """The errors of maps of each size, before and after ZoomOut."""
    sizes = [row["size"] for row in rows]
    lines = {"initial": (sizes, [row["initial"] for row in rows])}
    lines[f"ZoomOut to {FINAL}"] = sizes, [row["mean error"] for row in rows]
    draw_lines(figure, lines, "size of the initial functional map", "mean geodesic error, times 1000")
