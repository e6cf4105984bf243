# SPDX-License-Identifier: GPL-3.0-or-later
"""ZoomOut and the methods that its paper compares it with, all from the same initial maps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.bcicp import Side, bcicp
from benchmarks.baselines.deblur import deblur
from benchmarks.baselines.kernel_matching import kernel_matching
from benchmarks.baselines.rhm import rhm
from benchmarks.baselines.sampled_zoomout import sampled_zoomout
from benchmarks.baselines.spectral_icp import spectral_icp
from benchmarks.curves import draw_curves, share_below
from benchmarks.datasets import TEMPLATE, PairOfMeshes, evenly, is_far, load_pair, pair_names, sets_in
from benchmarks.paper.compared import mean_curves
from benchmarks.paper.flips import with_flipped_edges
from benchmarks.paper.starts import (
    K_INITIAL,
    K_SIGNATURES,
    from_descriptors,
    from_landmarks,
    from_shot,
    from_signatures,
    landmarks_of,
)
from benchmarks.stored import read_or_compute
from benchmarks.tables import Record, Tables, over
from zoomout_core.arrays import Floats, Integers
from zoomout_core.evaluation import coverage, edge_distortion
from zoomout_core.mesh.surface import Surface

# Sizes of functional maps in the paper: the final one, and the fixed one.
K_FINAL, STEP, K_FIXED = 120, 5, 50
SAMPLES = 500
# Published initial maps, from wave kernel signatures with a term that preserves the orientation, or with one that
# reverses it. If a set has only the latter, the former are fitted: the mirrored ones of FAUST exchange only some limbs,
# from which almost no map recovers.
START, MIRRORED_START = "WKSini_direct", "WKSini_symm"
# Published maps that are measured without refinement.
SHIPPED = ("BIM", "PMF_hk", "WKSini_direct_BCICP")
CORE, MATCH = "zo.zoomout, samples", "zo.match, nothing given"
# Mean error times 1000 above which a pair counts as failed.
ISOMETRIC_LIMIT, NON_ISOMETRIC_LIMIT = 80, 130
# Share of flipped edges.
FLIPPED = 0.125
# Kinds of meshes of one surface that are refined from one to the other: others have loose parts, or 14,000 vertices, of
# which BCICP and RHM take minutes a pair.
KINDS = ("dense", "iso")
# Melzi et al. 2019: mean errors and seconds on FAUST in its original meshes, from the same kind of initial maps; mean
# errors after random flips of edges, from two landmarks; and on FAUST and SCAPE resampled, from learned descriptors.
PUBLISHED: dict[str, tuple[float, float | None]] = {
    "initial": (67.3, None),
    "ICP": (54.0, 10.2),
    "Deblur": (61.9, 10.9),
    "PMF": (26.4, 736),
    "RHM": (41.9, 41.4),
    "BCICP": (21.6, 184),
    "ZoomOut": (15.8, 9.6),
    "ZoomOut*": (17.5, 1.1),
}
PUBLISHED_FLIPPED: dict[str, tuple[float, float | None]] = {
    "initial": (44.0, None),
    "ICP": (36.3, None),
    "Deblur": (38.6, None),
    "PMF": (25.9, None),
    "RHM": (33.3, None),
    "BCICP": (19.5, None),
    "ZoomOut": (13.3, None),
    "ZoomOut*": (14.5, None),
}
PUBLISHED_RESAMPLED: dict[str, tuple[float, float | None]] = {
    "initial": (46.5, None),
    "ICP": (29.3, None),
    "Deblur": (44.4, None),
    "PMF": (86.4, None),
    "RHM": (32.0, None),
    "BCICP": (26.0, None),
    "ZoomOut": (21.7, None),
    "ZoomOut*": (24.6, None),
}
# On SHREC'19.
SHREC19: dict[str, tuple[float, float | None]] = {
    "initial": (60.4, None),
    "ICP": (47.0, None),
    "Deblur": (55.4, None),
    "PMF": (51.8, None),
    "RHM": (42.6, None),
    "BCICP": (30.1, None),
    "ZoomOut*": (28.8, None),
}


class Maps(NamedTuple):
    """The maps that a method computes for a pair.

    Attributes:
        there: (n_t,) source vertex of each target vertex, -1 for none.
        back: (n_s,) target vertex of each source vertex; None if there is no such map.
        seconds: time of the map there, or of both if they are computed together; None for maps from a file.
    """

    there: Integers
    back: Integers | None
    seconds: float | None


@dataclass(frozen=True, eq=False)
class Start:
    """The input of every method.

    Attributes:
        source: the shape with the images, with K_FINAL eigenfunctions.
        target: the shape to be mapped.
        initial: (n_t,) source vertex of each target vertex.
        initial_back: (n_s,) target vertex of each source vertex.
    """

    source: Side
    target: Side
    initial: Integers
    initial_back: Integers

    def swap(self) -> Start:
        """The input of the map in the other direction."""
        return Start(self.target, self.source, self.initial_back, self.initial)


class Setting(NamedTuple):
    """Pairs, and the source of their initial maps.

    Attributes:
        name: as in the tables.
        pairs: names of target and source.
        load: loads a pair by its names.
        begin: computes (n_t,) and (n_s,) the initial maps of a pair there and back; None if there is none.
        folder: folder of the published maps; None if there are none.
        published: the paper's mean errors and seconds on the same pairs.
    """

    name: str
    pairs: list[tuple[str, str]]
    load: Callable[[str, str], PairOfMeshes]
    begin: Callable[[PairOfMeshes], tuple[Integers | None, Integers | None]]
    folder: Path | None
    published: Mapping[str, tuple[float, float | None]]


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
    settings = [each for folder in sets_in(data) for each in _settings(folder)]
    return _refine(settings, pairs, figure)


def run_shrec19(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Refine maps between the people of SHREC'19 with every method, from two random landmarks (`from_landmarks`).

    Arguments and tables are those of `run`.
    """
    settings = [
        Setting(folder.name, pair_names(folder, None), partial(load_pair, folder), _start_from_landmarks, None, SHREC19)
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
        begin = partial(_start_from_features, features / folder.name)
        published = PUBLISHED_RESAMPLED if folder.name.startswith(("faust", "scape")) else {}
        settings.append(Setting(f"{folder.name}, features", listed, partial(load_pair, folder), begin, None, published))
    return _refine([setting for setting in settings if setting.pairs], pairs, figure)


def _start_from_features(folder: Path, pair: PairOfMeshes) -> tuple[Integers, Integers]:
    of_source, of_target = (
        _features(folder / f"{name}.npy", surface)
        for name, surface in ((pair.source_name, pair.source), (pair.target_name, pair.target))
    )
    return (
        from_descriptors(pair.source, pair.target, of_source, of_target),
        from_descriptors(pair.target, pair.source, of_target, of_source),
    )


def _features(path: Path, surface: Surface) -> Floats:
    """(n, d) the features of a surface in a file."""
    found = np.load(path)
    if found.ndim != 2 or len(found) != len(surface.vertices):
        raise ValueError(
            f"{path} has an array of shape {found.shape}, but needs a row for each of {len(surface.vertices)} vertices."
        )
    return np.asarray(found, dtype=float)


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


def _settings(folder: Path) -> Iterator[Setting]:
    """The settings in which a set is refined."""
    listed = pair_names(folder, None)
    load = partial(load_pair, folder)
    if (folder / TEMPLATE).is_file():
        kinds = [tuple(name.partition("_")[0] for name in names) for names in listed]
        mixed = [names for names, (a, b) in zip(listed, kinds, strict=True) if a != b and {a, b} <= set(KINDS)]
        yield Setting(f"{folder.name}, SHOT", mixed, load, _start_from_shot, None, PUBLISHED_RESAMPLED)
    elif (folder / f"map_{START}.npz").is_file():
        yield Setting(folder.name, listed, load, partial(_published_maps, folder, START), folder, {})
    elif (folder / f"map_{MIRRORED_START}.npz").is_file():
        published = PUBLISHED if folder.name.startswith("faust") else {}
        yield Setting(folder.name, listed, load, _start_from_signatures, folder, published)
        name = f"{folder.name}, flipped edges, 2 landmarks"
        yield Setting(name, listed, partial(_flip, folder), _start_from_landmarks, None, PUBLISHED_FLIPPED)


def _flip(folder: Path, target_name: str, source_name: str) -> PairOfMeshes:
    """Flip edges of a pair, differently on each shape."""
    pair = load_pair(folder, target_name, source_name)
    target, source = (with_flipped_edges(each, FLIPPED, seed) for seed, each in enumerate((pair.target, pair.source)))
    return replace(pair, target=target, source=source)


def _published_maps(folder: Path | None, method: str, pair: PairOfMeshes) -> tuple[Integers | None, Integers | None]:
    """Published maps of a pair there and back, if the set has them."""
    path = folder and folder / f"map_{method}.npz"
    if path is None or not path.is_file():
        return None, None
    with np.load(path) as maps:
        there, back = f"{pair.target_name}__{pair.source_name}", f"{pair.source_name}__{pair.target_name}"
        return maps.get(there), maps.get(back)


def _start_from_signatures(pair: PairOfMeshes) -> tuple[Integers, Integers]:
    return from_signatures(pair.source, pair.target), from_signatures(pair.target, pair.source)


def _start_from_landmarks(pair: PairOfMeshes) -> tuple[Integers, Integers]:
    source, target = (zo.eigenbasis(surface, K_SIGNATURES) for surface in (pair.source, pair.target))
    on_source, on_target = landmarks_of(pair)
    return (
        from_landmarks(source, target, on_source, on_target),
        from_landmarks(target, source, on_target, on_source),
    )


def _start_from_shot(pair: PairOfMeshes) -> tuple[Integers, Integers]:
    return from_shot(pair.source, pair.target), from_shot(pair.target, pair.source)


# --- methods ------------------------------------------------------------------------------------------------


def _each_way(method: Callable[[Start], Integers]) -> Callable[[Start], Maps]:
    """Run a method that computes one map at a time in both directions."""

    def maps(start: Start) -> Maps:
        begin = perf_counter()
        there = method(start)
        seconds = perf_counter() - begin
        return Maps(there, method(start.swap()), seconds)

    return maps


def _together(method: Callable[[Start], tuple[Integers, Integers]]) -> Callable[[Start], Maps]:
    """Run a method that computes the maps in both directions together."""

    def maps(start: Start) -> Maps:
        begin = perf_counter()
        there, back = method(start)
        return Maps(there, back, perf_counter() - begin)

    return maps


def _icp(start: Start) -> Integers:
    return spectral_icp(start.source.basis, start.target.basis, start.initial, K_FIXED).vertex


def _deblur(start: Start) -> Integers:
    return deblur(start.source.basis, start.target.basis, start.initial, K_INITIAL, K_FINAL, STEP).vertex


def _pmf(start: Start) -> tuple[Integers, Integers]:
    return kernel_matching(start.source.basis, start.target.basis, start.initial)


def _rhm(start: Start) -> tuple[Integers, Integers]:
    return rhm(start.source.surface, start.target.surface, start.initial, start.initial_back)


def _bcicp(start: Start) -> tuple[Integers, Integers]:
    there, back = bcicp(start.source, start.target, start.initial, start.initial_back, K_FIXED)
    return there.vertex, back.vertex


def _zoomout(start: Start) -> Integers:
    return zo.zoomout(start.source.basis, start.target.basis, start.initial, K_FINAL, STEP, samples=None).vertex


def _sampled_zoomout(start: Start) -> Integers:
    return sampled_zoomout(start.source.basis, start.target.basis, start.initial, K_FINAL, STEP, SAMPLES).vertex


def _core_zoomout(start: Start) -> Integers:
    """ZoomOut on samples, with the core's last rounds on all vertices."""
    return zo.zoomout(start.source.basis, start.target.basis, start.initial, K_FINAL, STEP, SAMPLES).vertex


def _match(start: Start) -> Maps:
    """Match without the initial map; the match back uses the shapes' cached analysis."""
    zo.forget_shapes()
    source, target = start.source.surface, start.target.surface
    begin = perf_counter()
    there = zo.match(source, target).surface_map.vertex
    seconds = perf_counter() - begin
    return Maps(there, zo.match(target, source).surface_map.vertex, seconds)


METHODS: dict[str, Callable[[Start], Maps]] = {
    "initial": lambda start: Maps(start.initial, start.initial_back, None),
    "ICP": _each_way(_icp),
    "Deblur": _each_way(_deblur),
    "PMF": _together(_pmf),
    "RHM": _together(_rhm),
    "BCICP": _together(_bcicp),
    "ZoomOut": _each_way(_zoomout),
    "ZoomOut*": _each_way(_sampled_zoomout),
    CORE: _each_way(_core_zoomout),
    MATCH: _match,
}


# --- records ------------------------------------------------------------------------------------------------


def _of_names(setting: Setting, target_name: str, source_name: str) -> list[Record]:
    pair = setting.load(target_name, source_name)
    initial, initial_back = setting.begin(pair)
    if initial is None or initial_back is None:
        return []
    source, target = (Side(surface, zo.eigenbasis(surface, K_FINAL)) for surface in (pair.source, pair.target))
    start = Start(source, target, initial, initial_back)
    found = {name: method(start) for name, method in METHODS.items()}
    for name in SHIPPED:
        there, back = _published_maps(setting.folder, name, pair)
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


# --- tables and curves --------------------------------------------------------------------------------------


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
