# SPDX-License-Identifier: GPL-3.0-or-later
"""Matches of clouds with meshes, meshes with clouds, and clouds with each other.

Clouds come from a set, or are drawn at random from TOSCA's meshes, without normals. As in
Melzi et al. 2019 a given functional map is refined by ZoomOut and spectral ICP; `zo.match` gets no initial map. Their
clouds and initial maps are not available: initial maps here come from wave kernel signatures and two landmarks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.sampled_zoomout import sampled_zoomout
from benchmarks.baselines.spectral_icp import spectral_icp
from benchmarks.correspondence import ISOMETRIC_LIMIT
from benchmarks.curves import draw_curves, share_below
from benchmarks.datasets import TEMPLATE, PairOfMeshes, evenly, is_far, load_pair, pair_names, sets_in
from benchmarks.paper.compared import compare, mean_curves, rows_by
from benchmarks.paper.discretisation import match
from benchmarks.paper.starts import K_SIGNATURES, from_landmarks, landmarks_of
from benchmarks.stored import read_or_compute
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import triangle_areas

# Number of points drawn from a mesh.
POINTS = 8000
# Prefixes of the sets from whose meshes points are drawn.
SAMPLED = "tosca"
K_FINAL, STEP, SAMPLES = 120, 5, 500
MATCH = "zo.match, nothing given"
# Mean errors; the paper has no times.
PUBLISHED: dict[str, tuple[float, float | None]] = {
    "initial": (51.0, None),
    "ICP20": (31.4, None),
    "ICP": (49.7, None),
    "ICP120": (36.9, None),
    "ZoomOut*": (22.3, None),
}
DIRECTIONS = ("cloud to mesh", "mesh to cloud", "cloud to cloud")


def run(data: Path, pairs: int | None, figure: Path | None = None) -> Tables:
    """Refine maps of clouds, and match the same clouds without one.

    `rows`, for each set and each method: number of pairs in all directions, mean and median of the mean errors, times
    1000, median seconds without the eigenbases, and the paper's figures. `ICP` is spectral ICP with 50 functions;
    ZoomOut uses 500 samples; the time of `zo.match` includes the surfaces reconstructed from the points.

    `match`, for each set and direction (from the target to the source): number of pairs, how many have a mean error
    below 80 thousandths, the median of the mean errors, how many have a certainty of 90 % or more, and how many of them
    are wrong. `pairs`: each pair.

    Args:
        data: the folder of the sets.
        pairs: number of pairs of each set, evenly spread over its list.
        figure: an image file for the share of places below each error.
    """
    records: list[Record] = []
    for folder in sets_in(data):
        sampled = not (folder / TEMPLATE).is_file()
        if sampled and (is_far(folder.name) or not folder.name.startswith(SAMPLED)):
            continue
        for number, names in enumerate(tqdm(_names(folder, pairs), desc=folder.name, leave=False)):
            key = (folder.name, *names, str(number))
            records += read_or_compute(key, partial(_of_names, folder, names, number, sampled))
    if figure is not None and records:
        draw_curves(figure, mean_curves("set", records))
    matches = [record for record in records if record["method"] == MATCH]
    kinds = dict.fromkeys((record["set"], record["direction"]) for record in matches)
    return {
        "rows": rows_by(("set", "method"), records, PUBLISHED),
        "match": [_row(matches, *kind) for kind in kinds],
        "pairs": records,
    }


def _of_names(folder: Path, names: tuple[str, str], seed: int, sampled: bool) -> list[Record]:
    records: list[Record] = []
    for direction, pair in _pairs(load_pair(folder, *names), seed, sampled):
        about = {"set": folder.name, "direction": direction}
        records += compare(pair, _methods(pair, seed), about)[0]
        begin = perf_counter()
        result, errors = match(pair)
        seconds = perf_counter() - begin
        measured = {"error": float(np.nanmean(errors)), "seconds": seconds, "curve": share_below(errors)}
        about |= {"target": pair.target_name, "source": pair.source_name, "method": MATCH}
        records.append(about | measured | {"certainty": result.certainty})
    return records


def _methods(pair: PairOfMeshes, seed: int) -> dict[str, Integers | Callable[[], Integers]]:
    source, target = (zo.eigenbasis(surface, K_SIGNATURES) for surface in (pair.source, pair.target))
    initial = from_landmarks(source, target, *landmarks_of(pair, seed))

    def by_icp(k: int) -> Integers:
        return spectral_icp(source, target, initial, k).vertex

    return {
        "initial": initial,
        "ICP20": lambda: by_icp(20),
        "ICP": lambda: by_icp(50),
        "ICP120": lambda: by_icp(120),
        "ZoomOut*": lambda: sampled_zoomout(source, target, initial, K_FINAL, STEP, SAMPLES).vertex,
    }


def _names(folder: Path, pairs: int | None) -> list[tuple[str, str]]:
    """The pairs of a set; if it has clouds, only those with a cloud."""
    if not (folder / TEMPLATE).is_file():
        return pair_names(folder, pairs)
    with_cloud = [names for names in pair_names(folder, None) if any(_is_cloud(name) for name in names)]
    return evenly(with_cloud, pairs)


def _is_cloud(name: str) -> bool:
    return name.startswith("cloud_")


def _pairs(pair: PairOfMeshes, seed: int, sampled: bool) -> Iterator[tuple[str, PairOfMeshes]]:
    """The pairs made from one pair, by direction; two meshes give one for each direction, with drawn points."""
    if not sampled:
        kinds = ("cloud" if _is_cloud(name) else "mesh" for name in (pair.target_name, pair.source_name))
        yield " to ".join(kinds), pair
        return
    random = np.random.default_rng(seed)
    for direction in DIRECTIONS:
        target_kind, _, source_kind = direction.split()
        target, target_vertex = pair.target, pair.target_vertex
        source, source_vertex = pair.source, pair.source_vertex
        if target_kind == "cloud":
            target = zo.PointCloud(_draw(target, random)).surface
            target_vertex = _nearest_vertices(target, pair.target.vertices[target_vertex])
        if source_kind == "cloud":
            source = zo.PointCloud(_draw(source, random)).surface
            source_vertex = _nearest_vertices(source, pair.source.vertices[source_vertex])
        names = pair.target_name, pair.source_name
        yield direction, PairOfMeshes(*names, target, source, target_vertex, source_vertex, None)


def _draw(surface: zo.Surface, random: np.random.Generator) -> Floats:
    """(POINTS, 3) points drawn uniformly from a surface."""
    area = triangle_areas(surface.vertices, surface.triangles)
    triangle = random.choice(len(area), POINTS, p=area / area.sum())
    barycentric = random.dirichlet((1, 1, 1), POINTS)
    return np.einsum("nc,ncx->nx", barycentric, surface.vertices[surface.triangles[triangle]])


def _nearest_vertices(surface: zo.Surface, places: Floats) -> Any:
    """(c,) the vertex of a surface's largest part nearest to each place (c, 3)."""
    used = np.flatnonzero(surface.components == 0)
    return used[cKDTree(surface.vertices[used]).query(places)[1]]


def _row(records: list[dict[str, Any]], folder: str, direction: str) -> dict[str, Any]:
    chosen = [record for record in records if (record["set"], record["direction"]) == (folder, direction)]
    errors = np.array([record["error"] for record in chosen])
    sure = np.array([record["certainty"] for record in chosen]) >= 0.9
    return {
        "set": folder,
        "direction": direction,
        "pairs": len(chosen),
        "right": int((errors < ISOMETRIC_LIMIT).sum()),
        "median error": float(np.median(errors)),
        "certain": int(sure.sum()),
        "certain and wrong": int((sure & (errors >= ISOMETRIC_LIMIT)).sum()),
    }
