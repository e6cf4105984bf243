"""ZoomOut beside the methods that its paper compares it with, all from the same initial maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.bcicp import Side, bcicp
from benchmarks.baselines.deblur import deblur
from benchmarks.baselines.kernel_matching import kernel_matching
from benchmarks.baselines.rhm import rhm
from benchmarks.baselines.spectral_icp import spectral_icp
from benchmarks.curves import draw_curves, share_below
from benchmarks.datasets import PairOfMeshes, load_pair, pair_names, sets_in
from zoomout_core.arrays import Floats, Integers
from zoomout_core.evaluation import coverage, edge_distortion
from zoomout_core.maps.functional_map import vertex_map_of
from zoomout_core.mesh.surface import Surface

Record: TypeAlias = dict[str, Any]

# Sizes of functional maps in the paper: those that grow, and those of fixed size.
K_INITIAL, K_FINAL, STEP, K_FIXED = 20, 120, 5, 50
SAMPLES = 500
# Eigenfunctions that signatures of fitted initial maps are made of.
K_SIGNATURES = 200
# Published initial maps, from wave kernel signatures with a term that keeps the orientation, and with one that reverses
# it. Where a set has the latter alone, the former are fitted: the mirrored ones of FAUST exchange some limbs and leave
# others, from which hardly a map recovers.
START, MIRRORED_START = "WKSini_direct", "WKSini_symm"
# Published maps that are measured as they are.
SHIPPED = ("BIM", "PMF_hk", "WKSini_direct_BCICP")
MATCH = "zo.match, nothing given"
# Mean error times 1000 above which a pair counts as failed.
ISOMETRIC_LIMIT, NON_ISOMETRIC_LIMIT = 80, 130
# Melzi et al. 2019: mean errors and seconds on FAUST in its original meshes, from the same kind of initial maps.
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


class Maps(NamedTuple):
    """What a method makes of a pair.

    Attributes:
        there: (n_t,) source vertex of each target vertex, -1 where there is none.
        back: (n_s,) target vertex of each source vertex; None where there is no such map.
        seconds: of the map there, or of both where they are made together; None for maps from a file.
    """

    there: Integers
    back: Integers | None
    seconds: float | None


@dataclass(frozen=True, eq=False)
class Start:
    """What every method is given.

    Attributes:
        source: the shape that the map lands on, with K_FINAL eigenfunctions.
        target: the shape that the map starts from.
        initial: (n_t,) source vertex of each target vertex.
        initial_back: (n_s,) target vertex of each source vertex.
    """

    source: Side
    target: Side
    initial: Integers
    initial_back: Integers

    def swapped(self) -> Start:
        """The start of the map in the other direction."""
        return Start(self.target, self.source, self.initial_back, self.initial)


def run(data: Path, pairs: int | None, figure: Path | None) -> dict[str, list[Record]]:
    """Refine the initial maps of the sets in a folder by every method.

    `rows`, for each set of nearly isometric shapes and each method: mean and median over the pairs of the mean
    geodesic error times 1000, the share of failed pairs, mean share of the source that the map covers, mean geodesic
    distance times 1000 between a vertex and where going there and back leads, mean edge distortion
    (`zoomout_core.evaluation`), median seconds, and what the paper has for FAUST's original meshes. All maps are
    measured vertex to vertex. Seconds are without the bases, which all share, but with all that RHM prepares; PMF,
    RHM and BCICP make the maps in both directions in that time; `zo.match` starts from the meshes.

    `not isometric`: the same for sets of shapes that are far from isometric, with published maps.

    Initial maps are `map_WKSini_direct.npz` of the set, or, beside a `map_WKSini_symm.npz` alone, made by `fitted`.

    Args:
        data: the folder of the sets; those with neither file are left out.
        pairs: number of pairs of each set, evenly spread over its list.
        figure: an image file to draw the share of places below each error to.

    Returns:
        The tables by name, and under `pairs` a record for each pair and method, with its curve (`benchmarks.curves`).
    """
    records: list[Record] = []
    for folder in sets_in(data):
        for names in tqdm(pair_names(folder, pairs), desc=folder.name, leave=False):
            if any((folder / f"map_{name}.npz").is_file() for name in (START, MIRRORED_START)):
                records += _of_pair(folder, *names)
    if not records:
        return {"rows": []}
    if figure is not None:
        _draw(records, figure)
    near, far = ([record for record in records if _is_far(record["set"]) is is_far] for is_far in (False, True))
    return {"rows": _rows(near or far), "not isometric": _rows(far) if near else [], "pairs": records}


# --- methods ------------------------------------------------------------------------------------------------


def _each_way(method: Callable[[Start], Integers]) -> Callable[[Start], Maps]:
    """A method that makes one map at a time, run in both directions."""

    def maps(start: Start) -> Maps:
        begin = perf_counter()
        there = method(start)
        seconds = perf_counter() - begin
        return Maps(there, method(start.swapped()), seconds)

    return maps


def _together(method: Callable[[Start], tuple[Integers, Integers]]) -> Callable[[Start], Maps]:
    """A method that makes the maps in both directions together."""

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
    return zo.zoomout(start.source.basis, start.target.basis, start.initial, K_FINAL, STEP, SAMPLES).vertex


def _match(start: Start) -> Maps:
    """What is reached without the start; the match back finds the shapes analysed."""
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
    MATCH: _match,
}


# --- records ------------------------------------------------------------------------------------------------


def _of_pair(folder: Path, target_name: str, source_name: str) -> list[Record]:
    pair = load_pair(folder, target_name, source_name)
    source, target = (Side(surface, zo.eigenbasis(surface, K_FINAL)) for surface in (pair.source, pair.target))
    if (folder / f"map_{START}.npz").is_file():
        initial, initial_back = _stored(folder, START, target_name, source_name)
    else:
        initial, initial_back = fitted(pair.source, pair.target), fitted(pair.target, pair.source)
    if initial is None or initial_back is None:
        return []
    start = Start(source, target, initial, initial_back)
    about = {"set": folder.name, "target": target_name, "source": source_name}
    records = [about | {"method": name} | _figures(pair, method(start)) for name, method in METHODS.items()]
    for name in SHIPPED:
        there, back = _stored(folder, name, target_name, source_name)
        if there is not None:
            records.append(about | {"method": f"{name}, published"} | _figures(pair, Maps(there, back, None)))
    return records


def fitted(source: Surface, target: Surface) -> Integers:
    """(n_t,) the initial map as the paper makes it: from wave kernel signatures, keeping the orientation."""
    bases = [zo.eigenbasis(surface, K_SIGNATURES) for surface in (source, target)]
    signatures = [zo.wave_kernel_signature(basis) for basis in bases]
    of_source, of_target = (
        zo.orientation_operators(surface, basis, of_surface, K_INITIAL)
        for surface, basis, of_surface in zip((source, target), bases, signatures, strict=True)
    )
    functional_map = zo.fit_functional_map(
        bases[0], bases[1], signatures[0], signatures[1], K_INITIAL, orientation_operators=(of_source, of_target)
    )
    return vertex_map_of(functional_map, bases[0], bases[1])


def _stored(folder: Path, name: str, target_name: str, source_name: str) -> tuple[Integers | None, Integers | None]:
    """(n_t,) and (n_s,) published maps from the target and from the source, where the set has them."""
    path = folder / f"map_{name}.npz"
    if not path.is_file():
        return None, None
    with np.load(path) as maps:
        return maps.get(f"{target_name}__{source_name}"), maps.get(f"{source_name}__{target_name}")


def _figures(pair: PairOfMeshes, maps: Maps) -> Record:
    """What is measured of the maps of a pair; what needs an image of every vertex is left out where one has none."""
    errors = pair.errors(maps.there[:, None])[:, 0]
    figures: Record = {"error": float(np.nanmean(errors)), "seconds": maps.seconds}
    figures["curve"] = share_below(errors)
    if maps.there.min() >= 0:
        surface_map = zo.SurfaceMap.from_vertices(maps.there, pair.source)
        figures["covered %"] = 100 * coverage(surface_map, pair.source)
        figures["edge distortion"] = edge_distortion(surface_map, pair.source, pair.target)
        if maps.back is not None and maps.back.min() >= 0:
            figures["bijectivity"] = _bijectivity(maps.there, maps.back, pair.target)
    return figures


def _bijectivity(there: Integers, back: Integers, target: Surface) -> float:
    """Mean geodesic distance, times 1000, of up to 1000 target vertices from where there and back leads."""
    every = np.arange(len(there))
    return float(1000 * zo.geodesic_error(back[there], target, every, every).mean())


# --- tables and curves --------------------------------------------------------------------------------------


def _is_far(name: str) -> bool:
    return "nonisometric" in name


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for name, method in dict.fromkeys((record["set"], record["method"]) for record in records):
        chosen = [record for record in records if (record["set"], record["method"]) == (name, method)]
        errors = np.array([record["error"] for record in chosen])
        published = PUBLISHED.get(method) if name.startswith("faust") else None
        rows.append(
            {
                "set": name,
                "method": method,
                "pairs": len(chosen),
                "mean": float(errors.mean()),
                "median": float(np.median(errors)),
                "failed %": 100 * float((errors > (NON_ISOMETRIC_LIMIT if _is_far(name) else ISOMETRIC_LIMIT)).mean()),
                "covered %": _over(np.mean, chosen, "covered %"),
                "bijectivity": _over(np.mean, chosen, "bijectivity"),
                "edge distortion": _over(np.mean, chosen, "edge distortion"),
                "seconds": _over(np.median, chosen, "seconds"),
                "published mean": published and published[0],
                "published s": published and published[1],
            }
        )
    return rows


def _over(statistic: Callable[[list[float]], Any], records: list[Record], column: str) -> float | None:
    """A statistic of a column over the records that have it."""
    values = [record[column] for record in records if record.get(column) is not None]
    return float(statistic(values)) if values else None


def _draw(records: list[Record], figure: Path) -> None:
    """Cumulative curves, a panel for each set."""
    panels: dict[str, dict[str, Floats]] = {}
    for name, method in dict.fromkeys((record["set"], record["method"]) for record in records):
        curves = [r["curve"] for r in records if (r["set"], r["method"]) == (name, method)]
        panels.setdefault(name, {})[method] = np.mean(curves, axis=0)
    draw_curves(figure, panels)
