# SPDX-License-Identifier: GPL-3.0-or-later
"""The test list of a public set: its pairs, its shapes, and where their vertices truly correspond.

A set is a folder with `pairs.txt`, a line `TARGET SOURCE` for each pair, and

- shapes `NAME.off`, in the folder itself, or in `shapes` or `off`;
- the truth: `truth.npz` or `correspondence.npz`, or `corres/NAME.vts`, as the remeshed sets are distributed;
- `protocol.json`, if there are published figures.

There are three kinds of truth. *template*: a list of vertices for each shape, in the order of one template. Lists
of two shapes correspond entry by entry, and -1 stands for none; .vts files count from 1, and 0 stands for none.
*maps*: `TARGET__SOURCE` is the source vertex of every target vertex, -1 for none. *none*: the file is missing or empty.

Two shapes that belong to one pair alone may be called `NAME_target` and `NAME_source`. Their line, and the key of their
truth, is then `NAME`.
"""

from __future__ import annotations

import json
import os
import random
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.datasets import CORRESPONDENCE, TRUTH
from benchmarks.tables import Record
from zoomout_core.arrays import Integers
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays
from zoomout_core.runtime.input_files import read_whole

PAIRS, PROTOCOL = "pairs.txt", "protocol.json"
FOLDERS_OF_SHAPES = ("shapes", "off", ".")
FOLDER_OF_VTS = "corres"
TEMPLATE, MAPS, NONE = "template", "maps", "none"
# Beginnings of the names of sets whose shapes are of different species, and so far from isometric.
OTHER_SPECIES = ("smal", "partialsmal", "becos", "tosca_nonisometric")


@dataclass(frozen=True)
class OfficialList:
    """The test list of a public set.

    Attributes:
        folder: the folder of the set.
        pairs: names of target and source, in the order of `pairs.txt`.
    """

    folder: Path
    pairs: tuple[tuple[str, str], ...]

    @classmethod
    def load(cls, folder: Path) -> OfficialList:
        """Read the list of a set.

        Raises:
            ValueError: a line is not one or two names, or the list is empty or not text.
            OSError: the list cannot be read.
        """
        pairs = []
        for line in _text(folder / PAIRS).splitlines():
            names = line.split()
            if len(names) > 2:
                raise ValueError(f"{folder / PAIRS} has the line {line!r}: write the names of target and source.")
            if names:
                target, source = names if len(names) == 2 else (f"{names[0]}_target", f"{names[0]}_source")
                pairs.append((target, source))
        if not pairs:
            raise ValueError(f"{folder / PAIRS} has no pairs: write a line TARGET SOURCE for each.")
        return cls(folder, tuple(pairs))

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def protocol(self) -> Record:
        """The content of `protocol.json`; empty if there is none.

        Raises:
            ValueError: it is not an object in JSON, or the published figures in it are not.
        """
        path = self.folder / PROTOCOL
        if not path.is_file():
            return {}
        try:
            content = json.loads(_text(path))
        except json.JSONDecodeError as error:
            raise ValueError(f"{path} is not valid JSON in line {error.lineno}: correct it.") from None
        if not (isinstance(content, dict) and isinstance(content.get("published", {}), dict)):
            raise ValueError(f"{path} must be a JSON object, and `published` in it another one: correct it.")
        return content

    @property
    def is_far(self) -> bool:
        """Whether its shapes are far from isometric."""
        return self.name.lower().startswith(OTHER_SPECIES)

    @property
    def truth_kind(self) -> str:
        """`TEMPLATE`, `MAPS` or `NONE`."""
        truth = _truth(self.folder)
        if not truth:
            return NONE
        return MAPS if any(_key(truth, *pair) for pair in self.pairs) else TEMPLATE

    def sample(self, max_count: int | None) -> list[tuple[str, str]]:
        """All pairs, or the first `max_count` in a random but fixed order: a larger sample contains the smaller one."""
        if max_count is None or max_count >= len(self.pairs):
            return list(self.pairs)
        return random.Random(0).sample(self.pairs, len(self.pairs))[:max_count]

    def shape_file(self, name: str) -> Path:
        """The file of a shape.

        Raises:
            ValueError: there is none.
        """
        for place in FOLDERS_OF_SHAPES:
            path = self.folder / place / f"{name}.off"
            if os.path.isfile(path):  # pathlib's raises errors for names that are too long
                return path
        raise ValueError(f"{self.folder} has no shape {name}.off: remove it from {PAIRS}, or add the file.")

    def places(self, target: str, source: str) -> tuple[Integers, Integers]:
        """(c,) target vertices that have a partner, and (c,) their partners on the source.

        Raises:
            ValueError: the truth does not have this pair, or no vertex has a partner.
        """
        truth = _truth(self.folder)
        if self.truth_kind == MAPS:
            image = self.image(target, source)
            places = np.flatnonzero(image >= 0), image[image >= 0]
        elif target not in truth or source not in truth or len(truth[target]) != len(truth[source]):
            raise ValueError(f"The truth of {self.folder} has no lists of the same length for {target} and {source}.")
        else:
            known = (truth[target] >= 0) & (truth[source] >= 0)
            places = truth[target][known], truth[source][known]
        if not len(places[0]):
            raise ValueError(f"The truth of {self.folder} has no partner for any vertex of {target} on {source}.")
        return places

    def image(self, target: str, source: str) -> Integers:
        """(n_t,) the source vertex of each target vertex, -1 for none; for truth of the kind `MAPS`.

        Raises:
            ValueError: the truth does not have this pair.
        """
        truth = _truth(self.folder)
        key = _key(truth, target, source)
        if key is None:
            raise ValueError(f"The truth of {self.folder} has no {target}__{source}.")
        return truth[key]


def lists_in(folder: Path, names: tuple[str, ...] = ()) -> list[OfficialList]:
    """The test lists of the sets in a folder, or that of the folder itself if it is a set.

    A folder without `pairs.txt` is no set.

    Args:
        folder: of the sets.
        names: of the sets to use; all if empty.

    Raises:
        ValueError: there is no set, or none of a name.
    """
    found = {path.parent.name: path.parent for mark in (PAIRS, f"*/{PAIRS}") for path in sorted(folder.glob(mark))}
    if not found:
        raise ValueError(f"{folder} has no set: a set is a folder with {PAIRS}, shapes and a truth.")
    for name in names:
        if name not in found:
            raise ValueError(f"{folder} has no set {name!r}: it has {', '.join(found)}.")
    return [OfficialList.load(path) for name, path in found.items() if not names or name in names]


def _key(truth: dict[str, Integers], target: str, source: str) -> str | None:
    """The key of a pair in a truth of the kind `MAPS`."""
    shared = target.removesuffix("_target")
    keys = (f"{target}__{source}", shared if f"{shared}_source" == source else "")
    return next((key for key in keys if key in truth), None)


@lru_cache(maxsize=2)
def _truth(folder: Path) -> dict[str, Integers]:
    """The arrays of a truth by their names; empty if there is none.

    Raises:
        ValueError: a file is damaged, or has something else than lists of whole numbers.
    """
    for path in (folder / TRUTH, folder / CORRESPONDENCE):
        if path.exists():
            try:
                arrays = read_arrays(path)
            except ArrayFileError as error:
                raise ValueError(f"{path} could not be read ({error}): download it again.") from error
            return {name: _vertex_list(path, values) for name, values in arrays.items()}
    files = sorted((folder / FOLDER_OF_VTS).glob("*.vts"))
    return {path.stem: _read_vts(path) for path in files}


def _read_vts(path: Path) -> Integers:
    """The vertices (c,) in a .vts file, counted from 0."""
    try:
        return np.array(_text(path).split(), dtype=np.int64) - 1
    except (ValueError, OverflowError):
        raise ValueError(f"{path} has a line that is not a whole number: correct it.") from None


def _vertex_list(path: Path, values: Any) -> Integers:
    """An array of a truth as numbers of vertices (c,)."""
    found = np.asarray(values)
    if found.ndim != 1 or found.dtype.kind not in "iuf" or not np.array_equal(found, np.floor(found)):
        raise ValueError(f"{path} has an array that is not a list of whole numbers: number the vertices from 0.")
    return found.astype(np.int64)


def _text(path: Path) -> str:
    """The content of a text file.

    Raises:
        ValueError: it is not text.
        OSError: it cannot be read.
    """
    try:
        return read_whole(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not a text file in UTF-8: save it as one.") from None
