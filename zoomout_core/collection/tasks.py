# SPDX-License-Identifier: GPL-3.0-or-later
"""The tasks of a collection: prepare a shape, match a pair. Results are written atomically, and reused.

Workers with access to the folder of results write there themselves. Otherwise files are sent to them and return with
the tasks, and each worker keeps prepared shapes in a folder of its own.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TypeVar

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.files import inputs_of, read_asset, write_asset
from zoomout_core.assets.part_names import parts_of_file
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.collection.pair_map import PairName, PairRecord, arrays_of, candidate_maps_of, load_candidate_maps
from zoomout_core.collection.shapes import Item, ShapeSummary, content_key, spread_from_samples, summarise
from zoomout_core.collection.transfer_records import (
    PairTransfer,
    TransferOutcome,
    forget_outcome,
    read_outcome,
    write_outcome,
)
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.preparation.memory_cache import store_shapes_in
from zoomout_core.matching.report.part_report import name_components, notes_on_parts
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.formats.opening import existing, file_bytes
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.runtime.array_files import ArrayFileError, write_arrays
from zoomout_core.runtime.outputs import atomic_write, make_folder, write_whole
from zoomout_core.runtime.version import package_version

SHAPES, MAPS, MESHES = "shapes", "maps", "meshes"
# Folders of workers without access to the results: prepared shapes to send, and received ones.
PREPARED, CACHE = "prepared", "cache"
Stored = TypeVar("Stored", ShapeSummary, PairRecord)
# Maximum bytes of a collection's prepared shapes: a thousand of the usual size.
MAX_BYTES = 16 << 30


@dataclass(frozen=True)
class Workplace:
    """Where and how tasks work.

    Attributes:
        results: the folder of the results; None if workers have no access to it.
        cache: the folder of prepared shapes for all workers; None for the current one.
        options: options of every match.
        token: names the private folder of each worker.
    """

    results: Path | None
    cache: Path | None
    options: MatchOptions
    token: str

    @property
    def folder(self) -> Path:
        """Where this worker writes: the results, or a private folder that is removed with the worker."""
        return self.results if self.results is not None else _folder_of_worker() / f"zoomout-{self.token}"

    def storing(self, of: str = "") -> AbstractContextManager[None]:
        """A context that stores prepared shapes as this workplace says; that `of` a name, to be sent, separately."""
        private = self.folder / PREPARED / of if of else self.folder / CACHE
        cache = self.cache if self.results is not None else private
        return nullcontext() if cache is None else store_shapes_in(cache, MAX_BYTES)

    def key(self, *parts: object) -> str:
        """A hash of some inputs, the options and the version of this package."""
        options = sorted((name, repr(value)) for name, value in vars(self.options).items())
        return content_key(repr((parts, options, package_version())).encode())


@dataclass(frozen=True, eq=False)
class Prepared:
    """A prepared shape.

    Attributes:
        name: name of the shape.
        key: a hash of its file's content.
        eigenvalues: (k,).
        seconds: duration; 0 if it was prepared before.
        content: files by their path in the workplace's folder, if workers share none.
    """

    name: str
    key: str
    eigenvalues: Floats
    seconds: float
    content: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Matched:
    """A matched pair.

    Attributes:
        pair: its shapes.
        record: how the match went.
        new: whether it was matched now, not found in the folder.
        content: files, as in `Prepared`.
    """

    pair: PairName
    record: PairRecord
    new: bool
    content: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Beginning:
    """A starting point of a map, instead of matching from the shapes alone.

    Attributes:
        candidate: the number of the candidate to take.
        through: or the shape to compose a map through, which is better than any candidate.
        samples: (s,) vertices of the target with known images.
        images: (s,) the vertices of the source that these map to.
    """

    candidate: int = 0
    through: str = ""
    samples: Integers | None = None
    images: Integers | None = None

    def is_start_of(self, record: PairRecord) -> bool:
        """Whether a map was started from this."""
        return (record.candidate, record.through) == (self.candidate, self.through)


def place_of_shape(name: str) -> Path:
    """Path of a shape's summary in the results."""
    return Path(SHAPES) / f"{name}.npz"


def place_of_map(pair: PairName) -> Path:
    """Path of a pair's map in the results."""
    return Path(MAPS) / pair.source / f"{pair.target}.npz"


def prepare(item: Item, content: bytes | None, place: Workplace) -> Prepared:
    """Prepare a shape once for all of its pairs; the content of its file is given if workers have no access to it.

    Raises:
        MeshError: it cannot be read or matched.
    """
    began = perf_counter()
    path = _path_of(item, place, sent=content is not None)
    if content is not None:
        write_whole(path, content)
    key = content_key(file_bytes(existing(path)))
    output = place.folder / place_of_shape(item.name)
    summary = _known(ShapeSummary.load, output, place.key(key))
    seconds = 0.0
    if summary is None:
        with place.storing(item.name):
            summary = summarise(path, place.key(key), place.options)
        make_folder(output.parent)
        with atomic_write(output) as part:
            write_arrays(part, summary.as_arrays())
        seconds = perf_counter() - began
    shipped = {}
    if content is not None:
        shipped = {str(each.relative_to(place.folder)): each.read_bytes() for each in (path, output)}
        apart = place.folder / PREPARED / item.name
        shipped |= {str(Path(CACHE) / each.relative_to(apart)): each.read_bytes() for each in apart.rglob("*.npz")}
    return Prepared(item.name, key, summary.eigenvalues, seconds, shipped)


def match_pair(
    pair: PairName,
    items: tuple[Item, Item],
    beginning: Beginning | None,
    place: Workplace,
    source: Prepared,
    target: Prepared,
) -> Matched:
    """Match a pair of files, after both are prepared, unless its map exists.

    The beginning is the starting point of its map; None for the shapes alone, or for the earlier choice.

    Raises:
        MeshError: a file cannot be read or matched.
    """
    for shape in (source, target):
        for name, content in shape.content.items():
            if not (place.folder / name).exists():
                write_whole(place.folder / name, content)
    output = place.folder / place_of_map(pair)
    key = place.key(source.key, target.key)
    record = _known(PairRecord.load, output, key)
    if record is not None and (beginning is None or beginning.is_start_of(record)):
        return Matched(pair, record, False)
    earlier = load_candidate_maps(output) if record is not None else None
    began = perf_counter()
    paths = [_path_of(item, place, sent=bool(source.content)) for item in items]
    first, second = map(read_shape, paths)
    options = place.options
    if beginning is not None and beginning.samples is not None and beginning.images is not None:
        images = spread_from_samples(as_surface(second), beginning.samples, beginning.images)
        options = replace(options, initial="given", initial_map=images)
    with place.storing():
        result = match(first, second, options)
        if beginning is not None and beginning.candidate:
            result = result.use(beginning.candidate)
        parts = parts_of_file(paths[0], result.source)
    result = name_components(replace(result, notes=(*notes_on_parts(result, parts), *result.notes)), parts)
    summaries = [ShapeSummary.load(place.folder / place_of_shape(name)) for name in pair]
    through = "" if beginning is None else beginning.through
    # Keep the earlier candidates, so that the next run makes the same choice.
    candidates = earlier or candidate_maps_of(result, summaries)
    arrays = arrays_of(result, candidates, key, perf_counter() - began, through)
    make_folder(output.parent)
    result.surface_map.save(output, **arrays)
    record = PairRecord.load(output)
    shipped = {str(place_of_map(pair)): output.read_bytes()} if source.content else {}
    return Matched(pair, record, True, shipped)


def transfer_pair(transfer: PairTransfer) -> TransferOutcome:
    """Transfer a source's data to a target by their map file, unless this is on record.

    Raises:
        MeshError: there is nothing to transfer, or a file cannot be read or written.
    """
    kinds, output, record, move_rig = transfer.kinds, transfer.output, transfer.record, transfer.move_rig
    inputs = inputs_of(transfer.source, transfer.target)
    contents = [content_key(path.read_bytes()) for path in (*inputs, transfer.map_file) if path.is_file()]
    key = content_key(repr((contents, kinds, move_rig, output.name, package_version())).encode())
    earlier = read_outcome(record, key)
    if earlier is not None and all(path.is_file() for path in inputs_of(output)):
        return earlier
    forget_outcome(record)
    assets = read_asset(transfer.source), read_asset(transfer.target)
    known = KnownMatch.load(transfer.map_file, assets[0].surface, assets[1].surface)
    made = transfer_asset(*assets, known, kinds, move_rig=move_rig)
    make_folder(output.parent)
    left_out = write_asset(made.asset, output, inputs)
    notes = (*assets[0].notes, *assets[1].notes, *made.notes, *left_out)
    found = TransferOutcome(notes, tuple(map(asdict, made.motions)))
    write_outcome(record, key, found)
    return found


def _folder_of_worker() -> Path:
    """The folder that a Dask worker removes when it ends; in other processes the temporary folder."""
    if "distributed" in sys.modules:
        with suppress(ValueError):  # this process is not a worker
            return Path(sys.modules["distributed"].get_worker().local_directory)
    return Path(tempfile.gettempdir())


def _path_of(item: Item, place: Workplace, sent: bool) -> Path:
    """Path of an item's file, or of its copy that was sent to a worker without access to it."""
    return place.folder / "inputs" / item.name / item.path.name if sent else item.path


def _known(load: Callable[[Path], Stored], path: Path, key: str) -> Stored | None:
    """The result of an earlier run; None if its contents or options differ, or it cannot be read."""
    try:
        stored = load(path)
    except (FileNotFoundError, ArrayFileError):
        return None
    return stored if stored.key == key else None
