# SPDX-License-Identifier: GPL-3.0-or-later
"""The run of a collection: prepares shapes, matches pairs by an engine, and collects the records."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from uuid import uuid4

from zoomout_core.collection.cycles import Agreement, choose_agreeing, pairs_in_cycles
from zoomout_core.collection.engine import Engine, Failure, Task, run_tasks
from zoomout_core.collection.pair_map import CandidateMaps, PairName, PairRecord, load_candidate_maps
from zoomout_core.collection.pairs import pairs_of_neighbours, pairs_of_uncertain
from zoomout_core.collection.shapes import Item, ShapeSummary
from zoomout_core.collection.tasks import (
    MAPS,
    SHAPES,
    Beginning,
    Matched,
    Prepared,
    Workplace,
    match_pair,
    place_of_map,
    place_of_shape,
    prepare,
)
from zoomout_core.matching.options import MatchOptions
from zoomout_core.runtime.array_files import ArrayFileError
from zoomout_core.runtime.outputs import make_folder, write_whole
from zoomout_core.runtime.progress import portion

_log = logging.getLogger(__name__)
# Shape summaries kept in memory, at a third of a megabyte each.
KEPT = 2000
# Fractions of the progress at the end of: reading by Blender, preparing shapes, matching the given pairs, and others.
READ, PREPARED, MATCHED, COMPARED = 0.05, 0.3, 0.8, 0.9


class CollectionRun:
    """A collection that is being matched.

    Attributes:
        prepared: the shapes that are ready.
        records: the records of the pairs matched so far.
        failures: what failed and why.
    """

    def __init__(
        self,
        items: dict[str, Item],
        folder: Path,
        options: MatchOptions,
        engine: Engine,
        cache: str | PathLike[str] | None,
    ) -> None:
        self.items, self.folder, self._engine = items, folder.absolute(), engine
        self.prepared: dict[str, Prepared] = {}
        self.records: dict[PairName, PairRecord] = {}
        self.failures: dict[str, str] = {}
        self.seconds_of_shapes: dict[str, float] = {}
        self.matched = 0
        self._summary = lru_cache(KEPT)(lambda name: ShapeSummary.load(self.folder / place_of_shape(name)))
        make_folder(self.folder)
        self._shared = engine.sees([self.folder, *(item.path for item in items.values() if item.path.exists())])
        results = self.folder if self._shared else None
        kept = None if cache is None else Path(cache).absolute()
        self._place = Workplace(results, kept, options, uuid4().hex[:12])

    def match_chosen(self, pairs: Sequence[PairName]) -> None:
        """Prepare all shapes, and match pairs."""
        with portion(READ, MATCHED):
            self.match(dict.fromkeys(pairs), "Matching" if pairs else "Preparing", self.items)

    def match_neighbours(self, count: int) -> None:
        """Prepare all shapes, and match each with a number of shapes that have similar spectra."""
        with portion(READ, PREPARED):
            self.match({}, "Preparing", self.items)
        with portion(PREPARED, COMPARED):
            spectra = {name: self.prepared[name].eigenvalues for name in self.items if name in self.prepared}
            self.match(dict.fromkeys(pairs_of_neighbours(spectra, count)))

    def match(
        self,
        beginnings: Mapping[PairName, Beginning | None],
        title: str = "Matching",
        names: Iterable[str] | None = None,
    ) -> None:
        """Prepare shapes, by default those of the pairs, match the pairs, and record the results."""
        needed = sorted({name for pair in beginnings for name in pair}) if names is None else names
        tasks = [self._preparing(self.items[name]) for name in needed]
        tasks += [self._matching(pair, beginning) for pair, beginning in beginnings.items()]
        failed: dict[Item | PairName, str] = {}
        matched = 0

        def title_of(ended: int) -> str:
            failures = f", {len(failed)} failed" if failed else ""
            counts = (matched, len(beginnings)) if beginnings else (ended, len(tasks))
            return f"{title} {counts[0]} of {counts[1]}{failures}"

        of = {task.key: task.arguments[0] for task in tasks}
        for done in run_tasks(self._engine, tasks, title_of):
            if isinstance(done.result, Failure):
                failed[of[done.key]] = done.result.message
            else:
                self._take_in(done.result)
                matched += isinstance(done.result, Matched)
        self.failures |= {item.name: reason for item, reason in failed.items() if isinstance(item, Item)}
        for pair, reason in failed.items():
            if isinstance(pair, PairName) and not self.failures.keys() & set(pair):  # else the failure names the shape
                self.failures[str(pair)] = reason

    def _preparing(self, item: Item) -> Task:
        content = item.path.read_bytes() if not self._shared and item.path.is_file() else None
        return Task(f"prepare {item.name}", prepare, (_absolute(item), content, self._place))

    def _matching(self, pair: PairName, beginning: Beginning | None) -> Task:
        items = _absolute(self.items[pair.source]), _absolute(self.items[pair.target])
        after = tuple(f"prepare {name}" for name in pair)
        return Task(f"match {pair}", match_pair, (pair, items, beginning, self._place), after)

    def _take_in(self, result: Prepared | Matched) -> None:
        """Record the result of a task."""
        for place, content in result.content.items():
            if Path(place).parts[0] in (MAPS, SHAPES):
                write_whole(self.folder / place, content)
        if isinstance(result, Prepared):
            self.prepared[result.name] = result
            if result.seconds:
                self.seconds_of_shapes[result.name] = result.seconds
        else:
            self.records[result.pair] = result.record
            self.matched += result.new

    def uncertain_pairs(self) -> list[PairName]:
        """Pairs of shapes whose map from the template is uncertain with similar shapes whose map is certain."""
        certainty = {pair.target: record.certainty for pair, record in self.records.items()}
        in_order = {name: certainty[name] for name in self.items if name in certainty}
        return pairs_of_uncertain(in_order, lambda name: self.prepared[name].eigenvalues)

    def agreement(self) -> Agreement | None:
        """The candidates that agree best; None where no three shapes are matched with each other."""
        maps: dict[PairName, CandidateMaps] = {}
        for pair in pairs_in_cycles(sorted(self.records)):  # sorted, so that the order of completion does not matter
            try:
                maps[pair] = load_candidate_maps(self.folder / place_of_map(pair))
            except (FileNotFoundError, ArrayFileError) as error:
                _log.warning("The candidates of %s cannot be read: %s", pair, error)
        found = choose_agreeing(maps, self._summary)
        return found if found.before else None

    def beginnings(self, agreement: Agreement) -> dict[PairName, Beginning]:
        """Starting points for pairs whose maps do not agree with the others."""
        found = {}
        for pair, record in self.records.items():
            candidate, third = agreement.candidate.get(pair, 0), agreement.through.get(pair)
            beginning = Beginning(candidate)
            if third is not None:
                source, target = map(self._summary, pair)
                images = source.samples[agreement.maps[pair].forward[candidate]]
                beginning = Beginning(0, third, target.samples, images)
            if not beginning.is_start_of(record):
                found[pair] = beginning
        return found


def _absolute(item: Item) -> Item:
    return replace(item, path=item.path.absolute())
