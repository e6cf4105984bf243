# SPDX-License-Identifier: GPL-3.0-or-later
"""Success and error of symmetry detection, and its criteria, next to published figures."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import MAX_PLACES, mirrored_places, sets_in, shapes_with_symmetry
from benchmarks.paper.mirroring import weight_rows
from benchmarks.paper.objects import draw_symmetries, object_rows, things
from benchmarks.paper.symmetry_refinement import records_of as refinement_records
from benchmarks.paper.symmetry_refinement import rows_of as refinement_rows
from benchmarks.tables import Record, Tables
from benchmarks.tuning.ablation import vertex_map
from zoomout_core.arrays import Integers
from zoomout_core.evaluation import distance_distortion
from zoomout_core.maps.functional_map import functional_map_of, vertex_map_of
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.memory_cache import cached_analysis
from zoomout_core.matching.preparation.proxy import proxy_size
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.threads import one_blas_thread
from zoomout_core.symmetry.detect import find_candidates, isometry_errors

OURS, BEST_POSSIBLE, TRUTH = "zo.detect_symmetry", "the truth, read off its functional map", "the truth itself"
# Mean error times 1000 above which a shape counts as failed.
LIMIT = 60
K_FINAL, SAMPLES = 120, 1000


def run(data: Path, shapes: int | None, with_things: bool, figure: Path | None) -> Tables:
    """All tables.

    `rows`: for each set with known mirror images, the share of shapes whose first symmetry has a mean
    error below 60, mean and median error over the shapes, median seconds for the analysis of the shape (eigenbasis
    and distances) and for the rest, and the processor seconds of the latter. Images are rounded to their nearest
    vertex. For comparison, the error of the true map converted from its own functional map, and the change of distances
    between places under each map (median over the shapes): a symmetry preserves distances, and if
    the truth preserves them less than a map does, it is too inexact to measure that map.

    `refined`: see `benchmarks.paper.symmetry_refinement`. Published figures are for other meshes of the same people.

    `criteria`: for each set the share of shapes on which a criterion alone ranks a right map first among the
    candidates that reverse the orientation; `any` is the share with a right candidate.

    `objects`: the number of symmetries of things, and how many of the first ones found are right, by rigid alignment.

    `weights`: see `benchmarks.paper.mirroring`.

    `characters`: see `benchmarks.characters.mirrored`.

    Args:
        data: the folder of the sets.
        shapes: number of shapes of each set, evenly spread over its list.
        with_things: compute the last three tables, which need Blender's module.
        figure: an image file for the vase's symmetries.
    """
    records: list[Record] = []
    criteria: list[Record] = []
    for folder in sets_in(data):
        for name in tqdm(shapes_with_symmetry(folder, shapes), desc=folder.name, leave=False):
            surface, *known = mirrored_places(folder, name)
            head = {"set": folder.name, "shape": name}
            shape, basis_seconds = _prepare(surface)
            found, seconds = _detect(surface, *known)
            records.append(head | {"method": OURS, "basis seconds": basis_seconds} | found | seconds)
            records.append(
                head | {"method": BEST_POSSIBLE} | _figures(_through_basis(surface, *known), surface, *known)
            )
            truth = {"error": 0.0, "distortion": _distortion(known[1], known[0], surface)}
            records.append(head | {"method": TRUTH} | truth)
            criteria.append(head | _by_criterion(surface, shape, *known))
    if not records:
        return {"rows": []}
    of_refined = refinement_records(data, shapes)
    tables = {"rows": _rows(records), "refined": refinement_rows(of_refined), "criteria": _shares(criteria)}
    records += of_refined
    if with_things:
        tables |= {"objects": object_rows(), "weights": weight_rows()}
        if (data / "characters").is_dir():
            from benchmarks.characters.mirrored import symmetry_records, symmetry_rows  # it starts Blender

            of_characters = symmetry_records(data / "characters", shapes)
            tables["characters"] = symmetry_rows(of_characters)
            records += of_characters
    if figure is not None:
        _, vase, count = next(things())
        draw_symmetries(figure, vase, count)
    return tables | {"pairs": records + criteria}


def _prepare(surface: Surface) -> tuple[ShapeAnalysis, float]:
    """Prepare the shape like `detect_symmetry`, which then uses the cached results."""
    zo.forget_shapes()
    start = perf_counter()
    with one_blas_thread:
        part = surface.working.part(0)[0]
        shape = cached_analysis(part, K_FINAL, SAMPLES, 0, proxy_size(len(part.vertices), "auto"))
    return shape, perf_counter() - start


def _detect(surface: Surface, vertex: Integers, mirrored: Integers) -> tuple[Record, Record]:
    start = perf_counter(), process_time()
    found = zo.detect_symmetry(surface)
    seconds = {"seconds after it": perf_counter() - start[0], "processor seconds": process_time() - start[1]}
    first = found[0]
    figures = _figures(first.surface_map.vertex, surface, vertex, mirrored) | {
        "certainty": first.certainty,
        "found": len(found),
        "origin": first.origin,
        "return error": 1000 * first.return_error,
    }
    return figures, seconds


def _figures(image: Integers, surface: Surface, vertex: Integers, mirrored: Integers) -> Record:
    """The mean error of a map of a shape onto itself, and its distance from an isometry."""
    error = _error(image, surface, vertex, mirrored)
    return {"error": error, "distortion": _distortion(image[vertex], vertex, surface)}


def _distortion(image: Integers, vertex: Integers, surface: Surface) -> float:
    """Times 1000."""
    return 1000 * distance_distortion(image, vertex, surface, surface)


def _error(image: Integers, surface: Surface, vertex: Integers, mirrored: Integers) -> float:
    """Mean geodesic error, times 1000, without images on loose parts."""
    errors = zo.geodesic_error(image, surface, vertex, mirrored, MAX_PLACES)
    return float(1000 * errors[np.isfinite(errors)].mean())


def _through_basis(surface: Surface, vertex: Integers, mirrored: Integers) -> Integers:
    """(n,) the true symmetry, extended from its known places to nearby vertices and converted by its functional map."""
    basis = zo.eigenbasis(surface, K_FINAL)
    known = cKDTree(surface.vertices[vertex]).query(surface.vertices)[1]
    functional_map = functional_map_of(mirrored[known], basis, basis, K_FINAL, K_FINAL)
    return vertex_map_of(functional_map, basis, basis)


def _by_criterion(surface: Surface, shape: ShapeAnalysis, vertex: Integers, mirrored: Integers) -> Record:
    """Whether each criterion alone selects a right map among the candidates that reverse the orientation."""
    with one_blas_thread:
        pair = Pair(surface, surface, shape, shape, K_FINAL, 5)
        candidates = [entry for entry in find_candidates(shape) if entry.reverses_orientation]
        right = [_error(vertex_map(entry, pair), surface, vertex, mirrored) < LIMIT for entry in candidates]
    scores = [_criteria(entry, shape) for entry in candidates]
    if not candidates:
        return {"any": False}
    return {name: right[int(np.argmin([entry[name] for entry in scores]))] for name in scores[0]} | {"any": any(right)}


def _criteria(candidate: Candidate, shape: ShapeAnalysis) -> dict[str, float]:
    """The value that each criterion minimises."""
    turned = {name: -candidate.scores[name] for name in ("curvature", "handedness", "fine handedness")}
    kept = {name: candidate.scores[name] for name in ("distance", "place", "facing", "total")}
    return isometry_errors(candidate.functional_map, shape.basis.eigenvalues) | kept | turned


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for name, method in dict.fromkeys((record["set"], record["method"]) for record in records):
        chosen = [record for record in records if (record["set"], record["method"]) == (name, method)]
        errors = np.array([record["error"] for record in chosen])
        rows.append(
            {
                "set": name,
                "method": method,
                "shapes": len(chosen),
                "success %": 100 * float((errors < LIMIT).mean()),
                "mean": float(errors.mean()),
                "median": float(np.median(errors)),
                "distortion": _median(chosen, "distortion"),
                "basis seconds": _median(chosen, "basis seconds"),
                "seconds after it": _median(chosen, "seconds after it"),
                "processor seconds": _median(chosen, "processor seconds"),
            }
        )
    return rows


def _median(records: list[Record], column: str) -> float | None:
    values = [record[column] for record in records if column in record]
    return float(np.median(values)) if values else None


def _shares(criteria: list[Record]) -> list[Record]:
    """Percentage of each set's shapes on which a criterion is right, a row for each criterion."""
    names = [name for name in criteria[0] if name not in ("set", "shape")]
    sets = list(dict.fromkeys(record["set"] for record in criteria))
    return [
        {"criterion": name}
        | {
            folder: 100 * float(np.mean([record.get(name, False) for record in criteria if record["set"] == folder]))
            for folder in sets
        }
        for name in names
    ]
