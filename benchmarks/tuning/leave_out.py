# SPDX-License-Identifier: GPL-3.0-or-later
"""Matches with and without single parts of the method, on the shapes that each part is meant for.

`benchmarks.tuning.ablation` measures the maps of candidates before the dense refinement; here each match is complete.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import PARTS, PairOfParts, evenly, part_names
from benchmarks.golden import shapes as made
from benchmarks.paper.partial import ANOTHER_UNIT
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.matching import pipeline, retry
from zoomout_core.matching.components.similarity_field import SimilarityField
from zoomout_core.matching.hypotheses import collect
from zoomout_core.matching.report.verdict import VERDICT

# Mean error, relative to the square root of the source's area, above which a map counts as wrong.
LIMIT = 0.08
# Number of known places at which the map of a part is measured.
PLACES = 300
# Numbers of vertices of the two meshes of a thing or solid; with equal ones, remeshing gives nearly the same mesh.
SOURCE_VERTICES, TARGET_VERTICES = 2500, 2000


class Case(NamedTuple):
    """A pair with a known map.

    Attributes:
        set: name of the pair's set.
        name: of the pair.
        source: the surface with the images.
        target: the surface to be mapped.
        error: computes the mean error of a map, relative to the square root of the source's area.
    """

    set: str
    name: str
    source: zo.Surface
    target: zo.Surface
    error: Callable[[zo.SurfaceMap], float]


class LeftOut(NamedTuple):
    """A part of the method.

    Attributes:
        name: of the part.
        cases: yields cases from the folder of the sets, at most a given number of each set.
        replacements: tuples of a module or class, the name of a function in it, and its replacement.
    """

    name: str
    cases: Callable[[Path, int | None], Iterator[Case]]
    replacements: tuple[tuple[Any, str, Callable[..., Any]], ...]


def run(data: Path, pairs: int | None) -> Tables:
    """Match with and without each part of the method.

    `rows`, for each part of the method and set: pairs, the share of right ones, mean and worst error times 1000, mean
    certainty, the share of pairs that are wrong at a certainty of 90 % or more, and the mean seconds.

    Args:
        data: the folder of the sets.
        pairs: number of pairs of each set, evenly spread.

    Returns:
        The table, and under `pairs` a record of each match.
    """
    records = []
    for part in LEFT_OUT:
        for case in tqdm(part.cases(data, pairs), desc=part.name, leave=False):
            for is_left_out in (False, True):
                records.append(_record(part, case, is_left_out))
    return {"rows": _rows(records), "pairs": records}


def _record(part: LeftOut, case: Case, is_left_out: bool) -> Record:
    zo.forget_shapes()
    with ExitStack() as stack:
        for module, name, replacement in part.replacements if is_left_out else ():
            stack.enter_context(patch.object(module, name, replacement))
        begin = perf_counter()
        result = zo.match(case.source, case.target)
        seconds = perf_counter() - begin
    return {
        "part": part.name,
        "set": case.set,
        "method": "without" if is_left_out else "with",
        "pair": case.name,
        "error": 1000 * case.error(result.surface_map),
        "certainty": float(result.certainty),
        "seconds": seconds,
    }


def _rows(records: list[Record]) -> list[Record]:
    groups: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record[key] for key in ("part", "set", "method")), []).append(record)
    rows = []
    for (part, of_set, method), group in groups.items():
        error, certainty = (np.array([record[key] for record in group]) for key in ("error", "certainty"))
        is_wrong = ~(error < 1000 * LIMIT)
        rows.append(
            {
                "part": part,
                "set": of_set,
                "method": method,
                "pairs": len(group),
                "right %": 100 * float(np.mean(~is_wrong)),
                "mean error": float(np.nanmean(error)),
                "worst error": float(np.nanmax(error)),
                "certainty %": 100 * float(certainty.mean()),
                "certain and wrong %": 100 * float(np.mean(is_wrong & (certainty >= VERDICT.certain))),
                "seconds": float(np.mean([record["seconds"] for record in group])),
            }
        )
    return rows


# --- cases --------------------------------------------------------------------------------------------------


def _turn(surface: zo.Surface, seed: int) -> zo.Surface:
    """Turn a surface at random, so that its position is no evidence."""
    return surface.with_vertices(Rotation.random(random_state=seed).apply(surface.vertices))


def _made_twice(of_set: str, name: str, make: Callable[[int, int], zo.Surface]) -> Iterator[Case]:
    """Two meshes of one shape in the same frame; the target is turned in two ways before the match.

    Args:
        of_set: name of the cases' set.
        name: of the shape.
        make: builds the shape with a number of vertices, from a seed.
    """
    source, target = make(SOURCE_VERTICES, 0), make(TARGET_VERTICES, 1)

    def error(found: zo.SurfaceMap) -> float:
        off = np.linalg.norm(found.interpolate(source.vertices) - target.vertices, axis=1)
        return float(off.mean() / np.sqrt(source.area))

    for turn in range(2):
        yield Case(of_set, f"{name} {turn}", source, _turn(target, turn), error)


def _round(data: Path, max_count: int | None) -> Iterator[Case]:
    """Solids and things with rotational symmetries; only one of these maps counts as right."""
    from benchmarks.generate.things import THINGS, thing  # only if Blender is installed to build them

    for name, radius in evenly(
        [("cube", made.CUBE), ("icosahedron", made.ICOSAHEDRON), ("gear", made.gear)], max_count
    ):
        yield from _made_twice("solids", name, partial(made.round_shape, radius))
    for name in evenly(list(THINGS), max_count):
        yield from _made_twice("things", name, partial(thing, name))


def _without_extremities(data: Path, max_count: int | None) -> Iterator[Case]:
    """The same shapes, with all rotations counted as right, and shapes without extremities."""
    for case in _round(data, max_count):
        yield case._replace(error=partial(_off_rigid, case))
    for name, radius in evenly([("egg", made.egg), ("box", made.BOX)], max_count):
        yield from _made_twice("eggs and boxes", name, partial(made.round_shape, radius))
    folder = data / "specimens"
    with np.load(folder / "landmarks.npz") as landmarks:
        for line in evenly((folder / "pairs.txt").read_text().splitlines(), max_count):
            target, source = line.split()
            yield _specimens(folder / "shapes", source, target, landmarks[source], landmarks[target])


def _off_rigid(case: Case, found: zo.SurfaceMap) -> float:
    """Mean distance of the images from the target's vertices, after the best rigid alignment."""
    here, there = case.target.vertices, found.interpolate(case.source.vertices)
    motion = procrustes(here, there, scales=(1, 1))
    return float(np.linalg.norm(motion(here) - there, axis=1).mean() / np.sqrt(case.source.area))


def _specimens(folder: Path, source_name: str, target_name: str, there: Floats, here: Floats) -> Case:
    """Two specimens with landmarks (k, 3) on source and target."""
    source, target = (zo.read_surface(folder / f"{name}.ply") for name in (source_name, target_name))
    nearest = cKDTree(target.vertices).query(here)[1]

    def error(found: zo.SurfaceMap) -> float:
        images = found.interpolate(source.vertices)[nearest]
        return float(np.linalg.norm(images - there, axis=1).mean() / np.sqrt(source.area))

    return Case("specimens", f"{target_name} {source_name}", source, target, error)


def _parts_in_other_units(data: Path, max_count: int | None) -> Iterator[Case]:
    folder = data / "partial"
    for kind in PARTS.values():
        for name in part_names(folder, max_count, [kind]):
            pair = PairOfParts.load(folder, name)
            target = pair.target.with_vertices(ANOTHER_UNIT * pair.target.vertices)

            def error(found: zo.SurfaceMap, pair: PairOfParts = pair) -> float:
                return float(np.nanmean(pair.errors(found.vertex, PLACES))) / 1000

            yield Case(kind, name, pair.source, target, error)


def _of_many_parts(data: Path, max_count: int | None) -> Iterator[Case]:
    """Characters of many parts; the error is the share of vertices mapped to a wrong limb or bone."""
    from benchmarks.characters.cases import Case as CharacterCase  # it starts Blender
    from benchmarks.characters.cases import cases
    from benchmarks.characters.figures import wrong

    for case in cases(data / "characters", max_count):

        def error(found: zo.SurfaceMap, case: CharacterCase = case) -> float:
            return float(wrong(case, found).mean())

        yield Case(case.kind, case.name, case.source, case.target, error)


# --- parts of the method ------------------------------------------------------------------------------------


def _no_turns(candidates: Any, *_: Any) -> list[Any]:
    return list(candidates)


def _rigid(motion: SimilarityField, points: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
    """A replacement of `SimilarityField.transform`: one similarity for all."""
    fit = procrustes(motion.places, motion.images, motion.basis.areas, motion.handedness)
    return fit(points), normals @ fit.rotation.T, np.full(len(points), float(motion.confidence.mean()))


LEFT_OUT = (
    LeftOut("rotational symmetry", _round, ((pipeline, "with_turned", _no_turns), (retry, "with_turned", _no_turns))),
    LeftOut("sign hypotheses", _without_extremities, ((collect, "sign_hypotheses", lambda *_: []),)),
    LeftOut("unknown scale", _parts_in_other_units, ((retry, "match_at_unknown_scale", lambda *_: None),)),
    LeftOut("similarity field", _of_many_parts, ((SimilarityField, "transform", _rigid),)),
)
