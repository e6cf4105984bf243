# SPDX-License-Identifier: GPL-3.0-or-later
"""Match a whole collection: prepare each shape once, match pairs in parallel, and choose maps that agree."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, Literal
from uuid import uuid4

from zoomout_core.collection.cycles import CYCLES, Agreement, choose_agreeing, pairs_in_cycles
from zoomout_core.collection.engine import Engine, Failure, InThisProcess, Task, run_tasks
from zoomout_core.collection.pair_map import CandidateMaps, PairName, PairRecord, load_candidate_maps
from zoomout_core.collection.pairs import all_pairs, pairs_of_neighbours, pairs_of_uncertain, pairs_with_template
from zoomout_core.collection.shapes import Item, ShapeSummary, items_of
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
from zoomout_core.collection.through_blender import read_items
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.report.verdict import Verdict, judge
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.shapes import ShapeLike, as_shape, as_surface
from zoomout_core.runtime.array_files import ArrayFileError
from zoomout_core.runtime.outputs import is_same_file, write_whole
from zoomout_core.runtime.progress import Progress, listening, portion

_log = logging.getLogger(__name__)

# Shape summaries kept in memory, at a third of a megabyte each.
KEPT = 2000
# Fractions of the progress at the end of: reading by Blender, preparing shapes, matching the given pairs, and others.
READ, PREPARED, MATCHED, COMPARED = 0.05, 0.3, 0.8, 0.9


@dataclass(frozen=True, eq=False)
class CollectionResult:
    """The maps of a collection.

    Attributes:
        folder: folder of the maps, `maps/SOURCE/TARGET.npz`, as `zoomout match` writes them.
        items: the files, by the names of their shapes.
        records: how each pair went.
        failures: what failed and why, by the name of a shape or by the pair.
        agreement: which candidates agree best; None where no three shapes are matched with each other.
        seconds_of_shapes: preparation time of each shape that was prepared in this run.
        matched: how many pairs were matched in this run, not found in the folder.
        temporary: removes a temporary folder when the result is dropped; None if a folder was given.

    Example:
        >>> options = zo.MatchOptions(k_final=30)
        >>> collection = zo.match_collection({"a": source, "b": target}, template="a", options=options)
        >>> sorted(collection.items)
        ['a', 'b']
    """

    folder: Path
    items: dict[str, Item]
    records: dict[PairName, PairRecord]
    failures: dict[str, str]
    agreement: Agreement | None
    seconds_of_shapes: dict[str, float]
    matched: int
    temporary: Any = None

    def surface_map(self, source: str, target: str) -> SurfaceMap:
        """The map of a pair, from its file.

        Raises:
            MeshError: the pair was not matched.
        """
        return SurfaceMap.load(
            self.folder / place_of_map(PairName(source, target)), as_surface(self.items[source].path)
        )

    def trust(self, pair: PairName) -> float:
        """Trust in a pair's map as a whole, in [0, 1], from its certainty and the cycles around it."""
        certainty, agreement = self.records[pair].certainty, self.agreement
        if agreement is None or pair not in agreement.after:
            return certainty
        # A map that was composed, or chosen by other pairs, has little certainty by itself.
        own = agreement.certainty[pair] if agreement.candidate[pair] else certainty
        openness = (agreement.after[pair] - CYCLES.closed) / (CYCLES.open - CYCLES.closed)
        return own * (1 - min(1.0, max(0.0, openness)) / 2)

    def verdict(self, pair: PairName) -> Verdict:
        """Whether to use a pair's map, like `MatchResult.verdict`, but also from the cycles around it."""
        return judge(self.trust(pair), self.records[pair].faults)


def match_collection(
    shapes: Sequence[ShapeLike] | Mapping[str, ShapeLike],
    folder: str | PathLike[str] | None = None,
    *,
    template: str | PathLike[str] | None = None,
    pairs: Sequence[tuple[str, str]] | Literal["all"] | None = None,
    neighbours: int | None = None,
    options: MatchOptions | None = None,
    engine: Engine | None = None,
    cache: str | PathLike[str] | None = None,
    agree: bool = True,
    carries: bool = False,
    blender: str | None = None,
    progress: Callable[[Progress], object] | None = None,
) -> CollectionResult:
    """Match the shapes of a collection, and choose among the candidates of each pair those that agree.

    Give one of `template`, `pairs` and `neighbours`. Results are written to `folder` pair by pair; those of the same
    shapes with the same options are reused.

    Args:
        shapes: a mapping of names to shapes; or a list. Files in a list are named without their extension, surfaces and
            other shapes (`ShapeLike`) by their number.
        folder: folder of the results, created if missing. None for a temporary one, which is removed with the result.
        template: the name or path of the shape that is the source of all others. If a map from it is uncertain, its
            target is also matched with a few other shapes.
        pairs: sources and targets by their names, or "all".
        neighbours: number of shapes with similar spectra to match each shape with; all shapes are connected.
        options: options of every match, without landmarks or an initial map.
        engine: runs the tasks, see `collection.dask_engine.local_engine`; None for this process.
        cache: folder of prepared shapes.
        agree: whether to choose candidates that agree with each other.
        carries: whether Blender reads all shapes, so that it can transfer data between them. It always reads .blend and
            .fbx.
        blender: Blender's program, see `mesh.blender_files.blender_command`.
        progress: called with the `Progress`, see `zoomout_core.progress`.

    Raises:
        MeshError: no pairs are chosen, or a name is unknown.
        ImportError: the engine needs a package that is missing.

    Example:
        >>> options = zo.MatchOptions(k_final=30)
        >>> collection = zo.match_collection({"a": source, "b": target}, template="a", options=options)
        >>> collection.matched
        1
    """
    if sum(choice is not None for choice in (template, pairs, neighbours)) != 1:
        raise MeshError(
            "Give exactly one of a template, pairs and a number of neighbours to choose which shapes are matched."
        )
    options = MatchOptions() if options is None else options
    if options.landmarks is not None or options.initial_map is not None or options.regions is not None:
        raise ValueError("Landmarks, regions and initial maps belong to a single pair: match that pair on its own.")
    temporary = tempfile.TemporaryDirectory(prefix="zoomout-") if folder is None else None
    place = Path(temporary.name if temporary is not None else folder or "")
    items = _items_of(shapes, template, place)
    template_name = None if template is None else _find_template(template, items)
    chosen = _chosen_pairs(template_name, pairs, items)
    engine = InThisProcess() if engine is None else engine
    with listening(progress):
        with portion(0.0, READ):
            readable, failures = read_items(items, place, template_name, carries, blender, engine)
        run = _Run(readable, place, options, engine, cache)
        run.failures |= failures
        if chosen is None:
            assert neighbours is not None
            run.match_neighbours(neighbours)
        else:
            run.match_chosen([pair for pair in chosen if not failures.keys() & set(pair)])
            if template is not None and agree:
                with portion(MATCHED, COMPARED):
                    run.match(dict.fromkeys(run.uncertain_pairs()))
        agreement = run.agreement() if agree else None
        if agreement is not None:
            with portion(COMPARED, 1.0):
                run.match(run.beginnings(agreement), "Making maps consistent")
    return CollectionResult(
        run.folder,
        items | readable,
        run.records,
        run.failures,
        agreement,
        run.seconds_of_shapes,
        run.matched,
        temporary,
    )


def _items_of(
    shapes: Sequence[ShapeLike] | Mapping[str, ShapeLike], template: str | PathLike[str] | None, place: Path
) -> dict[str, Item]:
    """The shapes of a collection by name, and its template if that is another file.

    Raises:
        MeshError: there are fewer than two.
    """
    paths = _as_files(shapes, place / "given")
    if template is not None and Path(template).is_file() and not any(is_same_file(path, template) for path in paths):
        paths.insert(0, Path(template))
    items = {item.name: item for item in items_of(paths)}
    if len(items) < 2:
        raise MeshError("A collection needs at least two shapes: add more.")
    return items


def _as_files(shapes: Sequence[ShapeLike] | Mapping[str, ShapeLike], folder: Path) -> list[Path]:
    """Shapes as files; shapes in memory are written to a folder.

    Raises:
        MeshError: the name of a shape is not that of a file in a folder.
    """
    named = shapes if isinstance(shapes, Mapping) else {str(number): shape for number, shape in enumerate(shapes)}
    files = []
    for name, shape in named.items():
        if isinstance(shape, str | PathLike) and not isinstance(shapes, Mapping):
            files.append(Path(shape))
            continue
        if not isinstance(name, str) or "\\" in name or Path(name).name != name or not name.strip("."):
            raise MeshError(f"A shape is named {name!r:.60}: its files need a name, without slashes.")
        folder.mkdir(parents=True, exist_ok=True)
        files.append(folder / f"{name}.ply")
        write_shape(as_shape(shape), files[-1])
    return files


def _find_template(template: str | PathLike[str], items: Mapping[str, Item]) -> str:
    """The name of the template, which may be given by its file.

    Raises:
        MeshError: the collection has no such shape.
    """
    name = next((name for name, item in items.items() if is_same_file(item.path, template)), str(template))
    if name not in items:
        raise MeshError(f"The collection has no shape named {template}: give the name of one, or its file.")
    return name


def _chosen_pairs(
    template: str | None, pairs: Sequence[tuple[str, str]] | Literal["all"] | None, items: Mapping[str, Item]
) -> list[PairName] | None:
    """The pairs that the user chose; None if they are those of neighbours, which the prepared shapes decide.

    Raises:
        MeshError: a name is unknown.
    """
    if template is not None:
        return pairs_with_template(template, list(items))
    if pairs == "all":
        return all_pairs(list(items))
    return None if pairs is None else [_known_pair(pair, items) for pair in pairs]


def _known_pair(pair: tuple[str, str], items: Mapping[str, Item]) -> PairName:
    for name in pair:
        if name not in items:
            raise MeshError(f"The collection has no shape named {name}: give its file name without the extension.")
    return PairName(*pair)


class _Run:
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
        self.folder.mkdir(parents=True, exist_ok=True)
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
