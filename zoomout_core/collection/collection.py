# SPDX-License-Identifier: GPL-3.0-or-later
"""Match a whole collection: prepare each shape once, match pairs in parallel, and choose maps that agree."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from zoomout_core.arrays import check_counts
from zoomout_core.collection.cycles import CYCLES, Agreement
from zoomout_core.collection.engine import Engine, InThisProcess
from zoomout_core.collection.pair_map import PairName, PairRecord
from zoomout_core.collection.pairs import all_pairs, pairs_with_template
from zoomout_core.collection.run import COMPARED, MATCHED, READ, CollectionRun
from zoomout_core.collection.shapes import Item, items_of
from zoomout_core.collection.tasks import place_of_map
from zoomout_core.collection.through_blender import read_items
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.report.verdict import Verdict, judge
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.shapes import ShapeLike, as_shape, as_surface
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.runtime.outputs import is_same_file, make_folder
from zoomout_core.runtime.progress import Progress, listening, portion


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


@suggest_names
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
    options = MatchOptions() if options is None else options
    _check_choices(template, pairs, neighbours, options)
    temporary = tempfile.TemporaryDirectory(prefix="zoomout-") if folder is None else None
    place = Path(temporary.name if temporary is not None else folder or "")
    items = _items_of(shapes, template, place)
    template_name = None if template is None else _find_template(template, items)
    chosen = _chosen_pairs(template_name, pairs, items)
    engine = InThisProcess() if engine is None else engine
    with listening(progress):
        with portion(0.0, READ):
            readable, failures = read_items(items, place, template_name, carries, blender, engine)
        run = CollectionRun(readable, place, options, engine, cache)
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


def _check_choices(template: object, pairs: object, neighbours: int | None, options: MatchOptions) -> None:
    """Check that pairs are chosen in one way, and that the options suit all of them."""
    if sum(choice is not None for choice in (template, pairs, neighbours)) != 1:
        raise MeshError(
            "Give exactly one of a template, pairs and a number of neighbours to choose which shapes are matched."
        )
    if neighbours is not None:
        check_counts(neighbours=neighbours)
    if options.landmarks is not None or options.initial_map is not None or options.regions is not None:
        raise ValueError("Landmarks, regions and initial maps belong to a single pair: match that pair on its own.")


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
        make_folder(folder)
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
    if pairs is not None and (isinstance(pairs, str) or not isinstance(pairs, Iterable)):
        raise MeshError(f"pairs is {pairs!r:.60}: give 'all', or a list of pairs of names, the source first.")
    return None if pairs is None else [_known_pair(pair, items) for pair in pairs]


def _known_pair(pair: Iterable[str], items: Mapping[str, Item]) -> PairName:
    names = tuple(pair) if isinstance(pair, Iterable) and not isinstance(pair, str) else ()
    if len(names) != 2 or not all(isinstance(name, str) for name in names):
        raise MeshError(f"A pair is {names or pair!r:.60}: give the names of a source and a target.")
    for name in names:
        if name not in items:
            raise MeshError(f"The collection has no shape named {name}: give its file name without the extension.")
    return PairName(*names)
