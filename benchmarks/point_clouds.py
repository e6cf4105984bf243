"""Clouds against meshes, meshes against clouds, and clouds against each other, with nothing given.

Clouds are those of a set that has them, and points that are drawn at random from the meshes of other sets, without
normals. ZoomOut's own table on clouds (Melzi et al. 2019) begins with given functional maps: 51.0 initial, 49.7 by
spectral ICP, 22.3 by ZoomOut on samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.correspondence import ISOMETRIC_LIMIT
from benchmarks.datasets import TEMPLATE, PairOfMeshes, evenly, load_pair, pair_names, sets_in
from benchmarks.discretisation import matched
from zoomout_core.arrays import Floats
from zoomout_core.mesh.triangles import triangle_areas

# Points that are drawn from a mesh.
POINTS = 8000
DIRECTIONS = ("cloud to mesh", "mesh to cloud", "cloud to cloud")


def run(data: Path, pairs: int | None) -> dict[str, list[dict[str, Any]]]:
    """Match clouds.

    `rows`, for each set and direction (from the target to the source): number of pairs, how many have a mean error
    below 80 thousandths, the median of the mean errors, how many are announced with 90 % or more, and how many of these
    are wrong. `pairs`: each.

    Args:
        data: the folder of the sets.
        pairs: number of pairs of each set, evenly spread over its list.
    """
    records: list[dict[str, Any]] = []
    for folder in sets_in(data):
        for number, names in enumerate(tqdm(_names(folder, pairs), desc=folder.name, leave=False)):
            for direction, pair in _pairs(load_pair(folder, *names), number, sampled=not (folder / TEMPLATE).is_file()):
                result, error = matched(pair)
                record = {"set": folder.name, "direction": direction, "pair": " ".join(names)}
                records.append(record | {"error": error, "certainty": result.certainty})
    kinds = dict.fromkeys((record["set"], record["direction"]) for record in records)
    return {"rows": [_row(records, *kind) for kind in kinds], "pairs": records}


def _names(folder: Path, pairs: int | None) -> list[tuple[str, str]]:
    """The pairs of a set; of one that has clouds those with a cloud."""
    if not (folder / TEMPLATE).is_file():
        return pair_names(folder, pairs)
    with_cloud = [names for names in pair_names(folder, None) if any(_is_cloud(name) for name in names)]
    return evenly(with_cloud, pairs)


def _is_cloud(name: str) -> bool:
    return name.startswith("cloud_")


def _pairs(pair: PairOfMeshes, seed: int, sampled: bool) -> Iterator[tuple[str, PairOfMeshes]]:
    """A pair by its direction; of two meshes one for each direction, with points drawn from them."""
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
            target = zo.PointCloud(_drawn(target, random)).surface
            target_vertex = _nearest_used(target, pair.target.vertices[target_vertex])
        if source_kind == "cloud":
            source = zo.PointCloud(_drawn(source, random)).surface
            source_vertex = _nearest_used(source, pair.source.vertices[source_vertex])
        names = pair.target_name, pair.source_name
        yield direction, PairOfMeshes(*names, target, source, target_vertex, source_vertex, None)


def _drawn(surface: zo.Surface, random: np.random.Generator) -> Floats:
    """(POINTS, 3) points of a surface, as likely in any place."""
    area = triangle_areas(surface.vertices, surface.triangles)
    triangle = random.choice(len(area), POINTS, p=area / area.sum())
    barycentric = random.dirichlet((1, 1, 1), POINTS)
    return np.einsum("nc,ncx->nx", barycentric, surface.vertices[surface.triangles[triangle]])


def _nearest_used(surface: zo.Surface, places: Floats) -> Any:
    """(c,) the vertex of the largest part of a surface that is nearest to each place (c, 3)."""
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
        "sure": int(sure.sum()),
        "sure and wrong": int((sure & (errors >= ISOMETRIC_LIMIT)).sum()),
    }
