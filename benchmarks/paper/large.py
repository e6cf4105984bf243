# SPDX-License-Identifier: GPL-3.0-or-later
"""Large meshes without decimation: ZoomOut on all vertices and on samples, compared with ICP and RHM.

As in Melzi et al. 2019 on FARM: functional maps of size 20 from wave kernel signatures and two landmarks, refined to
size 120. FARM's people are not available: these are TOSCA's horses and men in their original meshes, which are closer
to isometric, so that all errors are lower.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.rhm import rhm
from benchmarks.baselines.sampled_zoomout import sampled_zoomout
from benchmarks.baselines.spectral_icp import spectral_icp
from benchmarks.datasets import PairOfMeshes, load_same_order
from benchmarks.paper.compared import compare, rows_by
from benchmarks.paper.starts import K_SIGNATURES, from_landmarks, landmarks_of
from benchmarks.pictures import View, draw_views, heat, spread
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Floats, Integers

# Target and source; meshes of one class have the same vertex order, so the identity is the truth.
PAIRS = (("horse0", "horse6"), ("michael0", "michael10"), ("horse10", "horse14"))
SET = "tosca_full"
K_FINAL, STEP, SAMPLES = 120, 5, 500
# Maximum number of vertices for RHM, which takes more than two minutes beyond.
MAX_FOR_RHM = 25_000
# Error times 1000 that is shown black.
BLACK = 150
# Melzi et al. 2019: mean errors and seconds on 15 shapes of FARM, of up to 50,000 vertices.
PUBLISHED: dict[str, tuple[float, float | None]] = {
    "initial": (82.1, None),
    "ICP20": (57.8, 7.2),
    "ICP": (78.9, 44),
    "ICP120": (75, 110),
    "RHM": (60.3, 296),
    "ZoomOut": (28.3, 76.5),
    "ZoomOut*": (29.3, 1.2),
}


def run(data: Path, pairs: int | None, figure: Path | None = None) -> Tables:
    """Refine initial maps of the original meshes of TOSCA.

    `rows`, for each number of vertices and each method: mean and median over the pairs of the mean error, times 1000,
    median seconds without the eigenbases, and the paper's figures on other shapes. `ICP` is spectral ICP with 50
    functions; RHM computes the maps in both directions in its time, and is left out if it takes more than two minutes;
    `zo.match` starts from the meshes alone, without landmarks and with its own eigenbases. `pairs`: each pair.

    Args:
        data: the folder of the sets, or that of the meshes.
        pairs: number of pairs, three at most.
        figure: an image file for the errors on the targets, from white to black.
    """
    folder = data / SET if (data / SET).is_dir() else data
    records: list[Record] = []
    views: list[list[View]] = []
    there = [names for names in PAIRS if all((folder / f"{name}.off").is_file() for name in names)]
    for names in tqdm(there[:pairs], desc=SET, leave=False):
        pair = load_same_order(folder, *names)
        found, errors = compare(pair, _methods(pair), {"vertices": len(pair.target.vertices)})
        records += found
        views.append(heat_views(pair, found, errors))
    if figure is not None and views:
        draw_views(figure, views)
    return {"rows": rows_by(("vertices", "method"), records, PUBLISHED), "pairs": records}


def heat_views(pair: PairOfMeshes, records: list[Record], errors: Floats) -> list[View]:
    """The target with the errors (c, m) of each method at its known places."""
    return [
        View(
            f"{record['method']}: {record['error']:.1f}",
            pair.target,
            heat(spread(each, pair.target_vertex, pair.target), BLACK),
        )
        for record, each in zip(records, errors.T, strict=True)
    ]


def _methods(pair: PairOfMeshes) -> dict[str, Integers | Callable[[], Integers]]:
    source, target = (zo.eigenbasis(surface, K_SIGNATURES) for surface in (pair.source, pair.target))
    on_source, on_target = landmarks_of(pair)
    initial = from_landmarks(source, target, on_source, on_target)

    def by_icp(k: int) -> Integers:
        return spectral_icp(source, target, initial, k).vertex

    def by_rhm() -> Integers:
        return rhm(pair.source, pair.target, initial, from_landmarks(target, source, on_target, on_source))[0]

    def by_zoomout() -> Integers:
        return zo.zoomout(source, target, initial, K_FINAL, STEP, samples=None).vertex

    def on_samples() -> Integers:
        return sampled_zoomout(source, target, initial, K_FINAL, STEP, SAMPLES).vertex

    def by_match() -> Integers:
        zo.forget_shapes()
        return zo.match(pair.source, pair.target).surface_map.vertex

    methods: dict[str, Integers | Callable[[], Integers]] = {
        "initial": initial,
        "ICP20": lambda: by_icp(20),
        "ICP": lambda: by_icp(50),
        "ICP120": lambda: by_icp(120),
        "RHM": by_rhm,
        "ZoomOut": by_zoomout,
        "ZoomOut*": on_samples,
        "zo.match": by_match,
    }
    if len(initial) > MAX_FOR_RHM:
        del methods["RHM"]
    return methods
