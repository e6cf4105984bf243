# SPDX-License-Identifier: GPL-3.0-or-later
"""Success rate, accuracy and time of `match` without hints, next to published maps.

Every figure is computed from records, one per pair and method, so that failures can be looked up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import (
    PARTS,
    PairOfMeshes,
    PairOfParts,
    is_far,
    load_pair,
    pair_names,
    part_names,
    sets_in,
    sets_of_parts_in,
)
from benchmarks.pictures import Picture, draw
from benchmarks.tables import Record, over
from benchmarks.tuning.ablation import maps_without
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.evaluation import coverage, flipped_share
from zoomout_core.matching.report.verdict import VERDICT
from zoomout_core.mesh.surface import Surface

OURS = "zo.match"
# Suffixes of published maps that are inputs of refinement.
INITIAL = ("ini", "ini_direct")
# Mean error times 1000 above which a pair counts as failed.
ISOMETRIC_LIMIT, NON_ISOMETRIC_LIMIT = 80, 130
# A vertex of at least this confidence is trusted, which is right if its error times 1000 is below the second number.
TRUSTED, CLOSE = 0.5, 50
# Classes of certainty in the table of calibration.
CERTAINTIES = (0.0, 0.5, 0.8, VERDICT.certain, 1.0)
WORST = 10
# Kinds of parts whose shapes are of different species.
OTHER_SPECIES = ("both cut, other species",)
# Number of known places at which the map of a part is measured.
PART_PLACES = 500
# Published mean errors times 1000 on SHREC'16: PFM's, and those of trained methods.
PUBLISHED_ON_PARTS = {"cuts": (97, "20 to 33"), "holes": (232, "91")}


@dataclass(frozen=True, eq=False)
class Map:
    """A map to be measured.

    Attributes:
        method: its name.
        vertex: (n_t,) the source vertex of each target vertex, -1 where there is none.
        figures: further columns of the record.
        confidence: (n_t,) of the vertices, if known.
    """

    method: str
    vertex: Integers
    figures: Record = field(default_factory=dict)
    confidence: Floats | None = None


def run(data: Path, pairs: int | None, ablate: bool, picture_folder: Path | None) -> dict[str, list[Record]]:
    """All tables of the sets in a folder.

    `rows`, for each set and method: success, mean and median error over the pairs, median seconds of a cold pair.
    For our maps also the mean share of the target's area that is flipped and of the source's that is covered
    (`zoomout_core.evaluation`); the median over the pairs of the rank correlation between 1 - confidence and error;
    and, of the pairs that succeeded, the median share of trusted vertices that are right and of vertices that are
    not trusted. Vertices are those whose place is known.

    `calibration`, for all sets and each: the maps whose certainty is in some range, its mean, how many
    are right, and how many have left and right exchanged.

    `parts`, for each kind of missing pieces of the sets of parts: success, mean and median error of places with a
    partner, mean certainty; the mean area of the intersection of the true and the stated region that has a partner over
    that of their union, of the source (on all pairs and on those that succeeded) and of the target; how far the stated
    share of the source's area without a partner is from the true one, on average; and the published mean errors of PFM
    and of trained methods on SHREC'16. These pairs are in `calibration`, too.

    `ablation`: `rows` with a stage left out each, measured as `benchmarks.tuning.ablation` says.

    Args:
        data: the folder of the sets.
        pairs: number of pairs of each set, and of each kind of parts, evenly spread over its list.
        ablate: make the last table as well.
        picture_folder: for pictures of the worst pairs of each set.

    Returns:
        The tables by name, and all records under `pairs`; empty tables if there is no set.
    """
    records: list[Record] = []
    ablated: list[Record] = []
    for folder in sets_in(data):
        worst: list[tuple[float, Picture]] = []
        for names in tqdm(pair_names(folder, pairs), desc=folder.name, leave=False):
            pair = load_pair(folder, *names)
            result, ours = _match(OURS, pair)
            of_pair = _records(folder.name, pair, [ours, *_published_maps(folder, pair)])
            records += of_pair
            if ablate:
                without = [Map(name, vertex) for name, vertex in maps_without(result).items()]
                ablated += _records(folder.name, pair, without)
            if picture_folder is not None:
                worst.append((of_pair[0]["error"], _picture(of_pair[0], pair, result)))
                worst = sorted(worst, key=lambda entry: -entry[0])[:WORST]
        if worst and picture_folder is not None:
            draw(picture_folder / f"{folder.name}.png", [picture for _, picture in worst])
    of_parts: list[Record] = []
    for folder in sets_of_parts_in(data):
        of_parts += _records_of_parts(folder, pairs, picture_folder)
    tables = {
        "rows": _rows(records),
        "parts": _rows_of_parts(of_parts),
        "calibration": _calibration(records + of_parts),
        "ablation": _rows(ablated),
    }
    return tables | {"pairs": records + of_parts + ablated}


# --- maps ---------------------------------------------------------------------------------------------------


def _match(method: str, pair: PairOfMeshes | PairOfParts, **start: Any) -> tuple[zo.MatchResult, Map]:
    zo.forget_shapes()
    begin = perf_counter()
    result = zo.match(pair.source, pair.target, **start)
    figures = {
        "seconds": perf_counter() - begin,
        "certainty": result.certainty,
        "origin": result.candidates[result.chosen].origin,
        "turned over %": 100 * flipped_share(result.surface_map, pair.source, pair.target),
        "covered %": 100 * coverage(result.surface_map, pair.source),
    }
    return result, Map(method, result.surface_map.vertex, figures, result.confidence)


def _published_maps(folder: Path, pair: PairOfMeshes) -> Iterator[Map]:
    """The published maps of a pair, and ours refined from those complete initial maps that others refine."""
    for path in sorted(folder.glob("map_*.npz")):
        with np.load(path) as maps:
            vertex = maps.get(f"{pair.target_name}__{pair.source_name}")
        if vertex is None:
            continue
        method = path.stem.removeprefix("map_")
        yield Map(method, vertex)
        if method.endswith(INITIAL) and vertex.min() >= 0:
            yield _match(f"{method} + zoomout", pair, initial="given", initial_map=vertex)[1]


def _picture(record: Record, pair: PairOfMeshes | PairOfParts, result: zo.MatchResult) -> Picture:
    caption = (
        f"{record['target']} from {record['source']}: error {record['error']:.0f}, certainty {record['certainty']:.0%}"
    )
    return Picture(caption, pair.source, pair.target, result.surface_map)


# --- records ------------------------------------------------------------------------------------------------


def _records(name: str, pair: PairOfMeshes, maps: list[Map]) -> list[Record]:
    """Records of the maps of one pair."""
    limit = NON_ISOMETRIC_LIMIT if is_far(name) else ISOMETRIC_LIMIT
    errors = pair.errors(np.column_stack([entry.vertex for entry in maps]))
    records = []
    for entry, error in zip(maps, errors.T, strict=True):
        mean = float(np.nanmean(error))
        record: Record = {"set": name, "method": entry.method, "target": pair.target_name, "source": pair.source_name}
        record |= {"error": mean, "right": mean < limit} | entry.figures
        if entry.confidence is not None:
            record |= _trust(entry.confidence[pair.target_vertex], error)
            mirrored = pair.mirrored_error(entry.vertex)
            flip = None if mirrored is None else mirrored < limit <= mean
            record |= {"symmetric error": mirrored, "flip": flip}
        records.append(record)
    return records


def _records_of_parts(folder: Path, pairs: int | None, picture_folder: Path | None) -> list[Record]:
    """Records of our maps of a set of parts; `pairs` of each kind."""
    records: list[Record] = []
    worst: list[tuple[float, Picture]] = []
    names = [name for kind in PARTS.values() for name in part_names(folder, pairs, [kind])]
    for name in tqdm(names, desc=folder.name, leave=False):
        pair = PairOfParts.load(folder, name)
        result, ours = _match(OURS, pair)
        error = float(np.nanmean(pair.errors(ours.vertex, PART_PLACES)))
        limit = NON_ISOMETRIC_LIMIT if pair.kind in OTHER_SPECIES else ISOMETRIC_LIMIT
        names_of_two = {"target": f"{name}_target", "source": f"{name}_source"}
        record: Record = {"set": pair.kind, "method": OURS} | names_of_two
        records.append(
            record | {"error": error, "right": error < limit, "flip": None} | ours.figures | _regions(pair, result)
        )
        if picture_folder is not None:
            worst.append((error, _picture(records[-1], pair, result)))
            worst = sorted(worst, key=lambda entry: -entry[0])[:WORST]
    if worst and picture_folder is not None:
        draw(picture_folder / f"{folder.name}.png", [picture for _, picture in worst])
    return records


def _regions(pair: PairOfParts, result: zo.MatchResult) -> Record:
    """Accuracy of the regions that a result says have a partner."""
    missing = 100 * pair.source.share_of_area(~pair.region)
    stated = 100 * result.source_share_without_partner
    return {
        "overlap on source": _overlap(pair.source, result.source_has_partner, pair.region),
        "overlap on target": _overlap(pair.target, result.has_partner, pair.truth >= 0),
        "missing %": missing,
        "stated %": stated,
        "share off by %": abs(stated - missing),
    }


def _overlap(surface: Surface, one: Booleans, other: Booleans) -> float:
    """The area of the intersection of two selections (n,) over that of their union."""
    return surface.share_of_area(one & other) / max(surface.share_of_area(one | other), 1e-300)


def _trust(confidence: Floats, error: Floats) -> Record:
    """How well the confidence (c,) predicts the error (c,)."""
    known = np.isfinite(error)
    confidence, error = confidence[known], error[known]
    trusted = confidence >= TRUSTED
    varied = np.ptp(confidence) > 0 and np.ptp(error) > 0  # otherwise there is no rank
    return {
        "rank correlation": float(spearmanr(1 - confidence, error).statistic) if varied else None,
        "trusted and right %": float(100 * (error[trusted] < CLOSE).mean()) if trusted.any() else None,
        "not trusted %": float(100 * (~trusted).mean()),
    }


# --- tables -------------------------------------------------------------------------------------------------


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for name, method in dict.fromkeys((record["set"], record["method"]) for record in records):
        chosen = [record for record in records if (record["set"], record["method"]) == (name, method)]
        right = [record for record in chosen if record["right"]]
        rows.append(
            {
                "set": name,
                "method": method,
                "pairs": len(chosen),
                "success %": 100 * len(right) / len(chosen),
                "mean": over(np.mean, chosen, "error"),
                "median": over(np.median, chosen, "error"),
                "seconds": over(np.median, chosen, "seconds"),
                "turned over %": over(np.mean, chosen, "turned over %"),
                "covered %": over(np.mean, chosen, "covered %"),
                "rank correlation": over(np.median, chosen, "rank correlation"),
                "trusted and right %": over(np.median, right, "trusted and right %"),
                "not trusted %": over(np.median, right, "not trusted %"),
            }
        )
    return rows


def _rows_of_parts(records: list[Record]) -> list[Record]:
    rows = []
    for kind in dict.fromkeys(record["set"] for record in records):
        chosen = [record for record in records if record["set"] == kind]
        right = [record for record in chosen if record["right"]]
        pfm, trained = PUBLISHED_ON_PARTS.get(kind, (None, None))
        rows.append(
            {
                "set": kind,
                "pairs": len(chosen),
                "success %": 100 * len(right) / len(chosen),
                "mean": over(np.mean, chosen, "error"),
                "median": over(np.median, chosen, "error"),
                "PFM's mean": pfm,
                "trained": trained,
                "overlap on source": over(np.mean, chosen, "overlap on source"),
                "of right ones": over(np.mean, right, "overlap on source"),
                "overlap on target": over(np.mean, chosen, "overlap on target"),
                "share off by %": over(np.mean, chosen, "share off by %"),
                "certainty": over(np.mean, chosen, "certainty"),
                "seconds": over(np.median, chosen, "seconds"),
            }
        )
    return rows


def _calibration(records: list[Record]) -> list[Record]:
    ours = [record for record in records if record["method"] == OURS]
    rows = []
    for name in ("all", *dict.fromkeys(record["set"] for record in ours)):
        for low, high in pairwise(CERTAINTIES):
            chosen = [
                record
                for record in ours
                if name in ("all", record["set"]) and low <= record["certainty"] < (high if high < 1 else np.inf)
            ]
            flips = [record["flip"] for record in chosen if record["flip"] is not None]
            rows.append(
                {
                    "set": name,
                    "certainty %": f"{100 * low:.0f} to {100 * high:.0f}",
                    "maps": len(chosen),
                    "announced %": over(lambda values: 100 * np.mean(values), chosen, "certainty"),
                    "right %": over(lambda values: 100 * np.mean(values), chosen, "right"),
                    "flips": sum(flips) if flips else None,
                }
            )
    return rows
