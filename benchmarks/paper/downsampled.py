# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of large meshes, refined on decimated ones and extended to all vertices.

As in the supplement of Melzi et al. 2019: both meshes are decimated, ZoomOut refines the map on all remaining
vertices, and the map is extended to the full meshes by nearest vertices, or by its functional map between the full
meshes' bases. Compared with ZoomOut on as many samples of the full meshes, with one last conversion as in the paper,
and with the core's ZoomOut, whose last rounds use all vertices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.sampled_zoomout import sampled_zoomout
from benchmarks.curves import draw_lines
from benchmarks.datasets import PairOfMeshes, load_same_order
from benchmarks.paper.compared import compare, rows_by
from benchmarks.paper.large import K_FINAL, SET, STEP
from benchmarks.paper.starts import K_INITIAL, K_SIGNATURES, from_landmarks, landmarks_of
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Integers
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.mesh.decimation import decimate

# Target and source, of 19,000 vertices.
PAIRS = (("horse0", "horse6"), ("horse10", "horse14"), ("horse0", "horse14"))
VERTICES = (500, 1000, 5000)
INITIAL = "initial"
NEAREST, FUNCTIONAL = "decimated, carried by nearest vertices", "decimated, carried by functional map"
SAMPLED, CORE = "ZoomOut on samples, one conversion", "ZoomOut on samples, last rounds on all"
FULL = "ZoomOut on all vertices"


def run(data: Path, pairs: int | None, figure: Path | None = None) -> Tables:
    """Refine one initial map, from two landmarks, in several ways.

    `rows`, for each number of vertices or samples, and each method: mean and median over the pairs of the mean error,
    times 1000, and median seconds including decimation and eigenbases. `pairs`: each pair.

    Args:
        data: the folder of the sets, or that of the meshes.
        pairs: number of pairs, three at most.
        figure: an image file for the mean errors by the number of vertices.
    """
    folder = data / SET if (data / SET).is_dir() else data
    there = [names for names in PAIRS if all((folder / f"{name}.off").is_file() for name in names)]
    records: list[Record] = []
    for names in tqdm(there[:pairs], desc=SET, leave=False):
        records += _of_pair(load_same_order(folder, *names))
    rows = rows_by(("vertices", "method"), records, {})
    if figure is not None and rows:
        _draw(rows, figure)
    return {"rows": rows, "pairs": records}


def _of_pair(pair: PairOfMeshes) -> list[Record]:
    begin = perf_counter()
    source, target = (zo.eigenbasis(surface, K_SIGNATURES) for surface in (pair.source, pair.target))
    preparing = perf_counter() - begin
    initial = from_landmarks(source, target, *landmarks_of(pair))
    methods: dict[tuple[str, int], Integers | Callable[[], Integers]] = {
        (INITIAL, len(initial)): initial,
        (FULL, len(initial)): lambda: zo.zoomout(source, target, initial, K_FINAL, STEP, None).vertex,
    }
    for vertices in VERTICES:
        methods[NEAREST, vertices] = partial(_by_nearest, pair, initial, vertices)
        methods[FUNCTIONAL, vertices] = partial(_by_functional_map, pair, source, target, initial, vertices)
        methods[SAMPLED, vertices] = partial(_on_samples, source, target, initial, vertices)
        methods[CORE, vertices] = partial(_in_core, source, target, initial, vertices)
    named = {f"{method} {vertices}": make for (method, vertices), make in methods.items()}
    records, _ = compare(pair, named, {})
    for (method, vertices), record in zip(methods, records, strict=True):
        record |= {"method": method, "vertices": vertices}
        if method not in (INITIAL, NEAREST):
            record["seconds"] += preparing
    return records


@dataclass(frozen=True, eq=False)
class _Decimated:
    """A surface and its decimated version.

    Attributes:
        basis: of the decimated surface.
        merged: (n,) the decimated vertex that each original vertex was merged into.
        stands_for: (n',) the original vertex nearest to each decimated vertex.
    """

    basis: zo.SpectralBasis
    merged: Integers
    stands_for: Integers

    @classmethod
    def of(cls, surface: zo.Surface, vertices: int) -> _Decimated:
        """Decimate a surface to about a given number of vertices."""
        points, triangles, merged = decimate(surface.vertices, surface.triangles, vertices)
        stands_for = np.asarray(cKDTree(surface.vertices).query(points)[1])
        return cls(zo.eigenbasis(zo.Surface(points, triangles), K_FINAL), merged, stands_for)


def _refine_small(pair: PairOfMeshes, initial: Integers, vertices: int) -> tuple[_Decimated, _Decimated, Integers]:
    """Both decimated surfaces, and (n'_t,) the image of each vertex of the decimated target."""
    source, target = (_Decimated.of(surface, vertices) for surface in (pair.source, pair.target))
    start = source.merged[initial[target.stands_for]]
    return source, target, zo.zoomout(source.basis, target.basis, start, K_FINAL, STEP, None).vertex


def _by_nearest(pair: PairOfMeshes, initial: Integers, vertices: int) -> Integers:
    """(n_t,) every vertex takes the image of the vertex that it was merged into."""
    source, target, small = _refine_small(pair, initial, vertices)
    return source.stands_for[small[target.merged]]


def _by_functional_map(
    pair: PairOfMeshes, source: zo.SpectralBasis, target: zo.SpectralBasis, initial: Integers, vertices: int
) -> Integers:
    """(n_t,) by the functional map fitted to the decimated vertices as samples of the full meshes."""
    small_source, small_target, small = _refine_small(pair, initial, vertices)
    images = source.eigenvectors[small_source.stands_for[small], :K_FINAL]
    functional_map = SampledBasis.of(target, small_target.stands_for).fit(images, K_FINAL)
    return zo.vertex_map_of(functional_map, source, target)


def _on_samples(source: zo.SpectralBasis, target: zo.SpectralBasis, initial: Integers, samples: int) -> Integers:
    return sampled_zoomout(source, target, initial, K_FINAL, STEP, samples, K_INITIAL).vertex


def _in_core(source: zo.SpectralBasis, target: zo.SpectralBasis, initial: Integers, samples: int) -> Integers:
    return zo.zoomout(source, target, initial, K_FINAL, STEP, samples).vertex


def _draw(rows: list[Record], figure: Path) -> None:
    """The mean error by the number of vertices, and the error of ZoomOut on all vertices as a level line."""
    lines: dict[str, tuple[Sequence[float], Sequence[float]]] = {}
    for method in (NEAREST, FUNCTIONAL, SAMPLED, CORE):
        lines[method] = VERTICES, [row["mean error"] for row in rows if row["method"] == method]
    full = next(row["mean error"] for row in rows if row["method"] == FULL)
    lines[FULL] = (VERTICES[0], VERTICES[-1]), (full, full)
    draw_lines(figure, lines, "vertices, or samples", "mean geodesic error, times 1000")
