# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of pairs that take long, stored in files so that a run can be interrupted and resumed.

A file has one line of JSON for each entry, appended as soon as it is computed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from time import perf_counter

import zoomout_core
from benchmarks.tables import Record


def code_version(*places: Path) -> str:
    """A hash of the code that computes maps, and of more files or folders of code."""
    digest = blake2b(digest_size=6)
    for place in (Path(zoomout_core.__file__).parent, *places):
        for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def read(path: Path) -> list[Record]:
    """The entries of a file, without a line that was not written to its end; none if there is no file."""
    if not path.is_file():
        return []
    entries = []
    for line in path.read_text().splitlines():
        with suppress(json.JSONDecodeError):
            entries.append(json.loads(line))
    return [entry for entry in entries if isinstance(entry, dict)]


def append(path: Path, entry: Record) -> None:
    """Append an entry to a file, after a line break if its last line was not written to its end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        if file.tell():
            file.seek(-1, os.SEEK_END)
            if file.read() != b"\n":
                file.write(b"\n")
        file.write(json.dumps(entry).encode() + b"\n")


@dataclass(frozen=True)
class Store:
    """A file of records.

    Attributes:
        path: the file.
        code: version of the code.
        known: entries of this code by the names of what they are records of.
        reused: seconds that each reused entry took.
    """

    path: Path
    code: str
    known: dict[tuple[str, ...], Record]
    reused: list[float] = field(default_factory=list)


_current: ContextVar[Store | None] = ContextVar("store", default=None)


@contextmanager
def storing(path: Path, code: Iterable[Path]) -> Iterator[Store]:
    """A context in which `stored` keeps records in a file.

    Args:
        path: the file.
        code: files and folders of code, besides the core's, a change to which makes stored records invalid.
    """
    version = code_version(*code)
    known = {tuple(entry["names"]): entry for entry in read(path) if entry["code"] == version}
    store = Store(path, version, known)
    token = _current.set(store)
    try:
        yield store
    finally:
        _current.reset(token)


def read_or_compute(names: Iterable[str], compute: Callable[[], list[Record]]) -> list[Record]:
    """Records that are computed, unless they are stored; simply computed outside of `storing`.

    Args:
        names: what they are records of, such as the names of a set and of a pair; unique in the file.
        compute: computes them.
    """
    store, key = _current.get(), tuple(names)
    if store is None:
        return compute()
    if key in store.known:
        store.reused.append(store.known[key]["seconds"])
    else:
        begin = perf_counter()
        entry = {"code": store.code, "names": key, "records": compute(), "seconds": perf_counter() - begin}
        append(store.path, entry)
        store.known[key] = entry
    return list(store.known[key]["records"])
