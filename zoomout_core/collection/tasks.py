# SPDX-License-Identifier: GPL-3.0-or-later
"""The tasks of a collection: prepare a shape, match a pair. What each makes is written whole, and found again.

Where workers see the folder of results they write there themselves. Where they do not, files go to them and come back
with the tasks, and each keeps what it prepares in a folder of its own.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.collection.pair_map import (
    PairName,
    PairRecord,
    arrays_of,
    candidate_maps_of,
    load_candidate_maps,
)
from zoomout_core.collection.shapes import Item, ShapeSummary, content_key, spread_from_samples, summarise
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.matching.disk_cache import package_version
from zoomout_core.matching.memory_cache import store_shapes_in
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.pipeline import match
from zoomout_core.mesh.files import existing, read_shape
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.runtime.array_files import ArrayFileError
from zoomout_core.runtime.outputs import atomic_write

SHAPES, MAPS, MESHES = "shapes", "maps", "meshes"
# Folders of workers that do not see the results: prepared shapes to send, and received ones.
PREPARED, CACHE = "prepared", "cache"
# Bytes that the prepared shapes of a collection take at most: a thousand of the usual size.
MAX_BYTES = 16 << 30


@dataclass(frozen=True)
class Workplace:
    """Where and how tasks work.

    Attributes:
        results: the folder of the results; None where workers do not see it.
        cache: the folder in which prepared shapes are kept for all workers; None to leave that as it is.
        options: of every match.
        token: a name for what workers keep to themselves.
    """

    results: Path | None
    cache: Path | None
    options: MatchOptions
    token: str

    @property
    def folder(self) -> Path:
        """Where this worker writes: where none sees the results, to a folder of its own that goes with it."""
        return self.results if self.results is not None else _folder_of_worker() / f"zoomout-{self.token}"

    def storing(self, of: str = "") -> AbstractContextManager[None]:
        """A context in which shapes that are prepared are kept where this workplace says.

        Args:
            of: the shape that is prepared to be sent on, which is kept apart.
        """
        cache = self.cache if self.results is not None else self.folder / (f"{PREPARED}/{of}" if of else CACHE)
        return nullcontext() if cache is None else store_shapes_in(cache, MAX_BYTES)

    def key(self, *parts: object) -> str:
        """A name for what comes of some inputs by the options and the version of this package."""
        options = sorted((name, repr(value)) for name, value in vars(self.options).items())
        return content_key(repr((parts, options, package_version())).encode())


@dataclass(frozen=True, eq=False)
class Prepared:
    """A shape that is ready to be matched.

    Attributes:
        name: of the shape.
        key: a hash of its file's content.
        eigenvalues: (k,).
        seconds: that it took; 0 where it was prepared before.
        content: files, by their place in the workplace's folder, where workers share none.
    """

    name: str
    key: str
    eigenvalues: Floats
    seconds: float
    content: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Matched:
    """A pair that is matched.

    Attributes:
        pair: its shapes.
        record: how it went.
        new: whether it was matched now, rather than found.
        content: files, as of `Prepared`.
    """

    pair: PairName
    record: PairRecord
    new: bool
    content: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Beginning:
    """The start of a map, in place of the shapes alone.

    Attributes:
        candidate: the number of the candidate to take.
        through: or the shape that leads to a better map than any candidate.
        samples: (s,) vertices of the target, where it is known.
        images: (s,) the vertices of the source that these go to.
    """

    candidate: int = 0
    through: str = ""
    samples: Integers | None = None
    images: Integers | None = None

    def is_start_of(self, record: PairRecord) -> bool:
        """Whether this is what a map was begun from."""
        return (record.candidate, record.through) == (self.candidate, self.through)


def place_of_shape(name: str) -> Path:
    """Where in the results a shape's summary is."""
    return Path(SHAPES) / f"{name}.npz"


def place_of_map(pair: PairName) -> Path:
    """Where in the results a pair's map is."""
    return Path(MAPS) / pair.source / f"{pair.target}.npz"


def prepare(item: Item, content: bytes | None, place: Workplace) -> Prepared:
    """Prepare a shape, once and for all of its pairs.

    Args:
        item: its file.
        content: of the file, where workers do not see it.
        place: where to work.

    Raises:
        MeshError: it cannot be read, or not be matched.
    """
    began = perf_counter()
    path = item.path
    if content is not None:
        path = _place_of_input(item, place)
        write_whole(path, content)
    key = content_key(existing(path).read_bytes())
    output = place.folder / place_of_shape(item.name)
    summary = _known_shape(output, place.key(key))
    seconds = 0.0
    if summary is None:
        with place.storing(item.name):
            summary = summarise(path, place.key(key), place.options)
        _write_arrays(output, summary.as_arrays())
        seconds = perf_counter() - began
    shipped = {}
    if content is not None:
        shipped = {str(file.relative_to(place.folder)): file.read_bytes() for file in (path, output)}
        apart = place.folder / PREPARED / item.name
        shipped |= {str(Path(CACHE) / file.relative_to(apart)): file.read_bytes() for file in apart.rglob("*.npz")}
    return Prepared(item.name, key, summary.eigenvalues, seconds, shipped)


def match_pair(
    pair: PairName,
    items: tuple[Item, Item],
    beginning: Beginning | None,
    place: Workplace,
    source: Prepared,
    target: Prepared,
) -> Matched:
    """Match a pair, unless its map is there already.

    Args:
        pair: its names.
        items: its files.
        beginning: what its map is begun from; None for the shapes alone, or for whatever was chosen before.
        place: where to work.
        source: as it was prepared.
        target: as it was prepared.

    Raises:
        MeshError: a file cannot be read, or not be matched.
    """
    for shape in (source, target):
        for name, content in shape.content.items():
            if not (place.folder / name).exists():
                write_whole(place.folder / name, content)
    output = place.folder / place_of_map(pair)
    key = place.key(source.key, target.key)
    record = _known_record(output, key)
    if record is not None and (beginning is None or beginning.is_start_of(record)):
        return Matched(pair, record, False)
    earlier = load_candidate_maps(output) if record is not None else None
    began = perf_counter()
    paths = [_path_of(item, place, shape) for item, shape in zip(items, (source, target), strict=True)]
    shapes = read_shape(paths[0]), read_shape(paths[1])
    options = place.options
    if beginning is not None and beginning.samples is not None and beginning.images is not None:
        images = spread_from_samples(as_surface(shapes[1]), beginning.samples, beginning.images)
        options = replace(options, initial="given", initial_map=images)
    with place.storing():
        result = match(*shapes, options)
        if beginning is not None and beginning.candidate:
            result = result.use(beginning.candidate)
    summaries = (
        ShapeSummary.load(place.folder / place_of_shape(pair.source)),
        ShapeSummary.load(place.folder / place_of_shape(pair.target)),
    )
    through = "" if beginning is None else beginning.through
    # What there was to choose among stays the same, so that the next run chooses alike.
    candidates = earlier or candidate_maps_of(result, summaries)
    arrays = arrays_of(result, candidates, key, perf_counter() - began, through)
    output.parent.mkdir(parents=True, exist_ok=True)
    result.surface_map.save(output, **arrays)
    record = PairRecord.load(output)
    shipped = {str(place_of_map(pair)): output.read_bytes()} if source.content else {}
    return Matched(pair, record, True, shipped)


def transfer_pair(source: Path, target: Path, map_file: Path, output: Path, kinds: tuple[str, ...]) -> tuple[str, ...]:
    """Transfer a source's data to a target, by their map in a file; returns notes for the user.

    Raises:
        MeshError: there is nothing to carry, or a file cannot be read or written.
    """
    assets = read_asset(source), read_asset(target)
    known = KnownMatch.load(map_file, assets[0].surface, assets[1].surface)
    made = transfer_asset(*assets, known, kinds)
    output.parent.mkdir(parents=True, exist_ok=True)
    left_out = write_asset(made.asset, output)
    return (*made.notes, *left_out)


def _folder_of_worker() -> Path:
    """The folder that a worker of Dask removes when it ends; elsewhere the folder of temporary files."""
    if "distributed" in sys.modules:
        with suppress(ValueError):  # this process is no worker
            return Path(sys.modules["distributed"].get_worker().local_directory)
    return Path(tempfile.gettempdir())


def _place_of_input(item: Item, place: Workplace) -> Path:
    """The local copy of a file for a worker that does not see it."""
    return place.folder / "inputs" / item.name / item.path.name


def _path_of(item: Item, place: Workplace, shape: Prepared) -> Path:
    return _place_of_input(item, place) if shape.content else item.path


def _known_shape(path: Path, key: str) -> ShapeSummary | None:
    """The stored summary of the same content; None if it is of another one or cannot be read."""
    try:
        summary = ShapeSummary.load(path)
    except (FileNotFoundError, ArrayFileError):
        return None
    return summary if summary.key == key else None


def _known_record(path: Path, key: str) -> PairRecord | None:
    """How a pair went that was matched before, of the same contents in the same way."""
    try:
        record = PairRecord.load(path)
    except (FileNotFoundError, ArrayFileError):
        return None
    return record if record.key == key else None


def _write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    file = BytesIO()
    np.savez_compressed(file, **arrays)
    write_whole(path, file.getvalue())


def write_whole(path: Path, content: bytes) -> None:
    """Write a file, and the folders above it.

    Raises:
        OutputError: it cannot be written; the earlier file is unchanged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as part:
        part.write_bytes(content)
