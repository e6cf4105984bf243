# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables that compare ZoomOut with other methods of refinement, all from the same initial maps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.curves import draw_curves, share_below
from benchmarks.datasets import PairOfMeshes, evenly, is_far, load_pair, pair_names, sets_in
from benchmarks.paper.compared import mean_curves
from benchmarks.paper.refinement_methods import METHODS, Maps, Start
from benchmarks.paper.refinement_settings import (
    PUBLISHED_RESAMPLED,
    SHREC19,
    Setting,
    published_maps,
    settings_of_set,
    start_from_features,
    start_from_landmarks,
)
from benchmarks.stored import read_or_compute
from benchmarks.tables import Record, Tables, over
from zoomout_core.arrays import Floats, Integers
from zoomout_core.evaluation import coverage, edge_distortion
from zoomout_core.mesh.surface import Surface

# Published maps that are measured without refinement.
SHIPPED = ("BIM", "PMF_hk", "WKSini_direct_BCICP")
# Mean error times 1000 above which a pair counts as failed.
ISOMETRIC_LIMIT, NON_ISOMETRIC_LIMIT = 80, 130


def run(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Refine the initial maps of the sets in a folder with every method.

    `rows`, for each set of nearly isometric shapes and each method: mean and median over the pairs of the mean
    geodesic error times 1000, the share of failed pairs, mean coverage of the source, mean geodesic
    distance times 1000 between a vertex and its image under both maps in turn, mean edge distortion
    (`zoomout_core.evaluation`), median seconds, and the paper's figures. All maps are measured vertex to vertex.
    Seconds exclude the bases, which all share, but include RHM's preparation; PMF, RHM and BCICP compute the maps in
    both directions in that time; `zo.match` starts from the meshes.

    `not isometric`: the same for sets of shapes that are far from isometric, with published maps.

    Initial maps are `map_WKSini_direct.npz` of the set, or, if it has only `map_WKSini_symm.npz`, made by
    `from_signatures`. Sets of the latter kind, which are people, are refined again with an eighth of the edges
    of both meshes flipped, from two random landmarks (`from_landmarks`); in sets with several meshes of one surface,
    meshes of different kinds are refined from SHOT descriptors (`from_shot`); the paper used learned ones.

    A pair takes about 30 s.

    Args:
        data: the folder of the sets; sets without any of these are left out.
        pairs: number of pairs of each set, evenly spread over its list.
        figure: an image file for the share of places below each error.

    Returns:
        The tables by name, and under `pairs` a record for each pair and method, with its curve (`benchmarks.curves`).
    """
    settings = [each for folder in sets_in(data) for each in settings_of_set(folder)]
    return _refine(settings, pairs, figure)


def run_shrec19(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Refine maps between the people of SHREC'19 with every method, from two random landmarks (`from_landmarks`).

    Arguments and tables are those of `run`.
    """
    settings = [
        Setting(folder.name, pair_names(folder, None), partial(load_pair, folder), start_from_landmarks, None, SHREC19)
        for folder in sets_in(data)
        if folder.name.startswith("shrec19")
    ]
    return _refine(settings, pairs, figure)


def run_features(data: Path, features: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Refine initial maps from features in files, such as learned descriptors, with every method.

    Other arguments and tables are those of `run`.

    Args:
        data: the folder of the sets.
        features: folder with a file `SET/NAME.npy` for each shape of a set: an array (n, d) of features of its
            vertices, the same ones for all shapes of the set. Pairs of shapes without a file are left out.
        pairs: number of pairs of each set.
        figure: an image file for the curves.

    Raises:
        ValueError: a file does not have features of each vertex.
    """
    settings = []
    for folder in sets_in(data):
        there = {path.stem for path in (features / folder.name).glob("*.npy")}
        listed = [names for names in pair_names(folder, None) if there.issuperset(names)]
        begin = partial(start_from_features, features / folder.name)
        published = PUBLISHED_RESAMPLED if folder.name.startswith(("faust", "scape")) else {}
        settings.append(Setting(f"{folder.name}, features", listed, partial(load_pair, folder), begin, None, published))
    return _refine([setting for setting in settings if setting.pairs], pairs, figure)


def _refine(settings: Sequence[Setting], pairs: int | None, figure: Path | None) -> Tables:
    """The tables of settings."""
    records: list[Record] = []
    rows: list[Record] = []
    for setting in settings:
        found: list[Record] = []
        for names in tqdm(evenly(setting.pairs, pairs), desc=setting.name, leave=False):
            found += read_or_compute((setting.name, *names), partial(_of_names, setting, *names))
        records += found
        rows += _rows(setting, found)
    if not records:
        return {"rows": []}
    if figure is not None:
        draw_curves(figure, mean_curves("set", records))
    near, far = ([row for row in rows if is_far(row["set"]) is wanted] for wanted in (False, True))
    return {"rows": near or far, "not isometric": far if near else [], "pairs": records}


def _of_names(setting: Setting, target_name: str, source_name: str) -> list[Record]:
    pair = setting.load(target_name, source_name)
    initial, initial_back = setting.begin(pair)
    if initial is None or initial_back is None:
        return []
    start = Start.of(pair, initial, initial_back)
    found = {name: method(start) for name, method in METHODS.items()}
    for name in SHIPPED:
        there, back = published_maps(setting.folder, name, pair)
        if there is not None:
            found[f"{name}, published"] = Maps(there, back, None)
    about = {"set": setting.name, "target": pair.target_name, "source": pair.source_name}
    figures = _figures(pair, list(found.values()))
    return [about | {"method": name} | figure for name, figure in zip(found, figures, strict=True)]


def _figures(pair: PairOfMeshes, found: list[Maps]) -> list[Record]:
    """The figures of a pair's maps; those that need an image of every vertex are left out if one has none."""
    errors = pair.errors(np.column_stack([maps.there for maps in found])).T
    cycles = {
        number: maps.back[maps.there]
        for number, maps in enumerate(found)
        if maps.back is not None and min(maps.there.min(), maps.back.min()) >= 0
    }
    missed: Sequence[float] | Floats = (
        _bijectivity(np.column_stack(list(cycles.values())), pair.target) if cycles else []
    )
    bijectivity = dict(zip(cycles, missed, strict=True))
    records = []
    for number, (maps, of_map) in enumerate(zip(found, errors, strict=True)):
        figures: Record = {"error": float(np.nanmean(of_map)), "seconds": maps.seconds, "curve": share_below(of_map)}
        if maps.there.min() >= 0:
            surface_map = zo.SurfaceMap.from_vertices(maps.there, pair.source)
            figures["covered %"] = 100 * coverage(surface_map, pair.source)
            figures["edge distortion"] = edge_distortion(surface_map, pair.source, pair.target)
        if number in bijectivity:
            figures["bijectivity"] = float(bijectivity[number])
        records.append(figures)
    return records


def _bijectivity(cycles: Integers, target: Surface) -> Floats:
    """(m,) mean geodesic distance, times 1000, of up to 1000 target vertices from their images under m maps both ways.

    Args:
        cycles: (n_t, m) the image of each target vertex under a map there and the map back.
        target: the shape.
    """
    every = np.arange(len(cycles))
    return np.asarray(1000 * zo.geodesic_error(cycles, target, every, every).mean(axis=0))


def _rows(setting: Setting, records: list[Record]) -> list[Record]:
    rows = []
    limit = NON_ISOMETRIC_LIMIT if is_far(setting.name) else ISOMETRIC_LIMIT
    for method in dict.fromkeys(record["method"] for record in records):
        chosen = [record for record in records if record["method"] == method]
        errors = np.array([record["error"] for record in chosen])
        published = setting.published.get(method)
        rows.append(
            {
                "set": setting.name,
                "method": method,
                "pairs": len(chosen),
                "mean": float(errors.mean()),
                "median": float(np.median(errors)),
                "failed %": 100 * float((errors > limit).mean()),
                "covered %": over(np.mean, chosen, "covered %"),
                "bijectivity": over(np.mean, chosen, "bijectivity"),
                "edge distortion": over(np.mean, chosen, "edge distortion"),
                "seconds": over(np.median, chosen, "seconds"),
                "published mean": published and published[0],
                "published s": published and published[1],
            }
        )
    return rows
