# SPDX-License-Identifier: GPL-3.0-or-later
"""Collections: the number of right maps between neighbours before and after they are made cycle-consistent.

Each class of a set is a collection. All classes together are another one for each set that is far from isometric. Each
collection is also tested with a wrong first candidate in some of its pairs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.datasets import CORRESPONDENCE, evenly, is_far, load_pair
from benchmarks.tables import NOT_SHOWN, Record, Tables
from zoomout_core.collection.collection import CollectionResult, match_collection
from zoomout_core.collection.cycles import CYCLES, choose_agreeing
from zoomout_core.collection.dask_engine import local_engine
from zoomout_core.collection.pair_map import CandidateMaps, PairName, load_candidate_maps
from zoomout_core.collection.shapes import ShapeSummary
from zoomout_core.collection.tasks import place_of_map, place_of_shape
from zoomout_core.maps.surface_map import read_vertex_map

SETS = ("faust_r", "tosca_r", "tosca_nonisometric", "smal_r")
NEIGHBOURS = 4
# Errors, times 1000, above which a map is wrong as a whole: for nearly isometric shapes, and for others.
WRONG, WRONG_IF_FAR = 80, 130
# Shares of pairs that get a wrong candidate first, and number of random draws.
SHARES, DRAWS = (0.1, 0.2, 0.3), 3


def run(data: Path, max_count: int | None, workers: int = 2) -> Tables:
    """Match collections.

    `rows`: for each class of a set how many maps are wrong before and after they were made consistent, how many were
    corrected and how many broken. `flips`: the same where a share of the pairs has a wrong first candidate from the
    search on samples.

    Args:
        data: a folder with some of the sets `SETS`.
        max_count: shapes of each class; all if not given.
        workers: processes to match in.
    """
    rows, records, flips = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, kind, files) in enumerate(tqdm(list(classes(data, max_count)), leave=False)):
            place = Path(folder) / str(number)
            with local_engine(workers, retries=0) as engine:
                alone = match_collection(
                    files, place, neighbours=NEIGHBOURS, engine=engine, cache=place / "cache", agree=False
                )
                before = errors_of(alone, data / name)
                agreed = match_collection(files, place, neighbours=NEIGHBOURS, engine=engine, cache=place / "cache")
            after = errors_of(agreed, data / name)
            wrong = WRONG_IF_FAR if is_far(name) else WRONG
            agreement = agreed.agreement
            about = {"set": name, "class": kind, "shapes": len(files), "pairs": len(before)}
            rows.append(
                {
                    **about,
                    **_changes(before, after, wrong),
                    "changed": len(agreement.changed) if agreement else 0,
                    "mean before": float(np.mean(list(before.values()))),
                    "mean after": float(np.mean(list(after.values()))),
                    "cycles before": 1000 * float(np.mean(list(agreement.before.values()))) if agreement else None,
                    "cycles after": 1000 * float(np.mean(list(agreement.after.values()))) if agreement else None,
                }
            )
            for pair, error in before.items():
                records.append({**about, "pair": str(pair), "before": error, "after": after[pair]})
            if agreement is not None:
                flips += [{**about, **each} for each in _flips(agreed)]
    return {"rows": rows, "flips": flips, NOT_SHOWN: records}


def classes(data: Path, max_count: int | None) -> Iterator[tuple[str, str, list[Path]]]:
    """Set, class and files of each collection: shapes with known correspondences to each other."""
    for name in SETS:
        truth_file = data / name / CORRESPONDENCE
        if not truth_file.is_file():
            continue
        groups: dict[tuple[str, int], list[Path]] = {}
        together: dict[int, list[Path]] = {}
        truth = np.load(truth_file)
        for path in sorted((data / name).glob("*.off")):
            if path.stem in truth:
                places = len(truth[path.stem])
                groups.setdefault((path.stem.rstrip("0123456789"), places), []).append(path)
                together.setdefault(places, []).append(path)
        kinds = {kind.strip("_"): files for (kind, _), files in groups.items()}
        if is_far(name):
            kinds = {f"all with {count} places": files for count, files in together.items()}
        for kind, files in kinds.items():
            if len(files) > 2:
                yield name, kind, evenly(files, max_count)


def errors_of(result: CollectionResult, folder: Path) -> dict[PairName, float]:
    """The mean geodesic error, times 1000, of every map of a collection."""
    return {
        pair: float(
            np.nanmean(
                load_pair(folder, pair.target, pair.source).errors(
                    read_vertex_map(result.folder / place_of_map(pair))[:, None]
                )
            )
        )
        for pair in sorted(result.records)
    }


def _changes(before: Mapping[PairName, float], after: Mapping[PairName, float], wrong: float) -> Record:
    """How many maps are wrong, were corrected, and were broken."""
    return {
        "wrong before": sum(error > wrong for error in before.values()),
        "wrong after": sum(error > wrong for error in after.values()),
        "put right": sum(before[pair] > wrong >= after[pair] for pair in before),
        "broken": sum(before[pair] <= wrong < after[pair] for pair in before),
    }


def _flips(result: CollectionResult) -> Iterator[Record]:
    """Changes of pairs whose first candidate is wrong, with the same certainty as the right one.

    The consistent map counts as right.
    """
    agreement = result.agreement
    assert agreement is not None
    maps = {pair: load_candidate_maps(result.folder / place_of_map(pair)) for pair in agreement.before}
    names = {name for pair in maps for name in pair}
    shapes = {name: ShapeSummary.load(result.folder / place_of_shape(name)) for name in names}
    for share in SHARES:
        counts = {"wrong before": 0, "wrong after": 0, "put right": 0, "broken": 0}
        for draw in range(DRAWS):
            random = np.random.default_rng(draw)
            turned = {pair: _with_a_wrong_one_first(each, pair, shapes, random, share) for pair, each in maps.items()}
            found = choose_agreeing(turned, shapes.__getitem__)
            before = {pair: _unlike(turned[pair].forward[0], maps[pair], pair, shapes) for pair in maps}
            after = {
                pair: _unlike(found.maps[pair].forward[found.candidate[pair]], maps[pair], pair, shapes)
                for pair in maps
            }
            for name, count in _changes(before, after, CYCLES.open).items():
                counts[name] += count
        yield {"share": share, **counts}


def _with_a_wrong_one_first(
    maps: CandidateMaps,
    pair: PairName,
    shapes: Mapping[str, ShapeSummary],
    random: np.random.Generator,
    share: float,
) -> CandidateMaps:
    """With the given probability, the candidates with the most likely wrong one first, if there is one."""
    unlike = [_unlike(each, maps, pair, shapes) for each in maps.forward]
    alike = maps.reverses_orientation == maps.reverses_orientation[0]
    wrong = np.flatnonzero((np.array(unlike) > CYCLES.open) & alike)
    if not len(wrong) or random.random() >= share:
        return maps
    order = np.arange(len(unlike))
    order[[0, wrong[0]]] = order[[wrong[0], 0]]
    return CandidateMaps(maps.forward[order], maps.backward[order], maps.certainty, maps.reverses_orientation[order])


def _unlike(forward: np.ndarray, maps: CandidateMaps, pair: PairName, shapes: Mapping[str, ShapeSummary]) -> float:
    """Mean distance, at unit area, between a map and the first candidate."""
    return float(shapes[pair.source].distance(forward, maps.forward[0]).mean())
