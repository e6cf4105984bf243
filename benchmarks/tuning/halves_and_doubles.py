# SPDX-License-Identifier: GPL-3.0-or-later
"""The effect of each tuned number: maps with half and with twice its value.

A number without any effect on all sets can be removed, with all that depends on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.characters.cases import Case, cases
from benchmarks.characters.figures import figures
from benchmarks.datasets import FEW_PLACES, PairOfMeshes, load_pair, pair_names, sets_in
from zoomout_core.tuning import Tuning, retune, stages

# Half and twice a number.
FACTORS = (0.5, 2.0)
# Errors are different if they differ by more than this fraction and by more than this value.
DIFFERENT, MIN_DIFFERENCE = 0.05, 0.01


def run(data: Path, pairs: int | None, names: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each number and value: on how many pairs errors fall and rise, and their mean before and after.

    The error of a pair of meshes is the mean geodesic error divided by 0.1, at most 3. The error of a pair of
    characters is the share of the target that is mapped to another limb, or the mean error divided by 10 cm.

    Args:
        data: the folder of the sets, with or without characters.
        pairs: number of pairs of each set and kind, evenly spread.
        names: parts of the names of the stages, such as `components.shells`; all stages if empty.

    Raises:
        ValueError: no stage has such a name.
    """
    chosen = {name: stage for name, stage in stages().items() if not names or any(part in name for part in names)}
    if not chosen:
        raise ValueError(f"No stage is called so; these there are: {', '.join(stages())}.")
    measures = list(chain(_of_sets(data, pairs), _of_characters(data, pairs)))
    before = _errors(measures, nullcontext())
    rows = []
    trials = [(name, stage, *trial) for name, stage in chosen.items() for trial in _trials(stage)]
    for name, stage, number, value in tqdm(trials, desc="numbers", leave=False):
        after = _errors(measures, retune(stage, **{number: value}))
        limit = np.maximum(DIFFERENT * before, MIN_DIFFERENCE)
        rows.append(
            {
                "stage": name.removeprefix("zoomout_core."),
                "number": number,
                "value": getattr(stage, number),
                "tried": value,
                "better": int((after < before - limit).sum()),
                "worse": int((after > before + limit).sum()),
                "error": float(before.mean()),
                "error then": float(after.mean()),
            }
        )
    return rows


def _errors(measures: Sequence[Callable[[], float]], setting: AbstractContextManager[None]) -> Any:
    """(p,) the error of each pair, with caches of other settings emptied."""
    with setting:
        found = []
        for measure in measures:
            zo.forget_shapes()
            found.append(measure())
    return np.array(found)


def _trials(stage: Tuning) -> Iterator[tuple[str, Any]]:
    """The numbers of a stage, each with its values to try."""
    for each in fields(stage):  # type: ignore[arg-type]
        value, valid = getattr(stage, each.name), each.metadata["valid"]
        for factor in FACTORS:
            tried = _scale(value, factor, *valid)
            if tried != value:
                yield each.name, tried


def _scale(value: Any, factor: float, low: float, high: float) -> Any:
    """Scale a number, or those in nested tuples; integers stay integers, and all stay in their range."""
    if isinstance(value, tuple):
        scaled = [_scale(each, factor, low, high) for each in value]
        return type(value)(*scaled) if hasattr(value, "_fields") else tuple(scaled)
    return type(value)(np.clip(round(factor * value) if isinstance(value, int) else factor * value, low, high))


def _of_sets(data: Path, pairs: int | None) -> Iterator[Callable[[], float]]:
    for folder in sets_in(data):
        for names in pair_names(folder, pairs):
            pair = load_pair(folder, *names)
            yield lambda pair=pair: _error_of_pair(pair)  # type: ignore[misc]


def _error_of_pair(pair: PairOfMeshes) -> float:
    vertex = zo.match(pair.source, pair.target).surface_map.vertex
    known = pair.target_vertex, pair.source_vertex
    error = zo.geodesic_error(vertex, pair.source, *known, FEW_PLACES)
    return min(3.0, 10 * float(error[np.isfinite(error)].mean()))


def _of_characters(data: Path, pairs: int | None) -> Iterator[Callable[[], float]]:
    for case in cases(data / "characters", pairs) if (data / "characters").is_dir() else ():
        yield lambda case=case: _error_of_case(case)  # type: ignore[misc]


def _error_of_case(case: Case) -> float:
    found = figures(case, zo.match(case.source, case.target).surface_map)
    return 1 - found.limb if found.limb is not None else (found.error or 0) / 10
