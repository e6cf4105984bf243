# SPDX-License-Identifier: GPL-3.0-or-later
"""The index of a library on disk: the bodies of each asset, named by the content of its file, and a list of files."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path, PureWindowsPath
from time import time
from typing import Any

from zoomout_core.collection.shapes import content_key
from zoomout_core.library.bodies import Body
from zoomout_core.runtime.array_files import read_arrays, write_arrays
from zoomout_core.runtime.input_files import read_whole, reason_of
from zoomout_core.runtime.outputs import ABANDONED, OutputError, atomic_write, check_output, make_folder
from zoomout_core.runtime.version import package_version

# Increase this when bodies are computed or stored differently.
FORMAT = 3
# The list of files, and the names of bodies.
LIST, STORED = "files.json", re.compile(r"[0-9a-f]{32}\.npz")
# Separates the kind of a body from the name of one of its arrays.
SEPARATOR = "/"


@dataclass(frozen=True)
class Listed:
    """A prepared file, with those that it names, such as buffers."""

    size: int  # of all, in bytes
    modified: int  # when the last of them was modified, in nanoseconds
    key: str  # of its content
    assets: tuple[str, ...] = ("",)  # names of those in a .blend file, see `write_assets`

    @property
    def seen(self) -> tuple[int, int]:
        """The result of `look_at`: if it is the same, the file is unchanged."""
        return self.size, self.modified

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the bodies of each asset."""
        return tuple(key_of_asset(self.key, name) for name in self.assets)


class Index:
    """The index in a folder, which is made when something is stored."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def read_list(self) -> dict[str, Listed]:
        """The prepared files by name; empty if there is no list, or a damaged one."""
        try:
            held = json.loads(read_whole(self._folder / LIST))
            if held["format"] != [FORMAT, package_version()]:
                return {}
            listed = {
                name: Listed(each["size"], each["modified"], each["key"], tuple(each["assets"]))
                for name, each in held["files"].items()
            }
            # The index may come from another person: ignore names of files outside its folders.
            named = chain(listed, *(each.assets for each in listed.values()))
            if not all(STORED.fullmatch(f"{each.key}.npz") for each in listed.values()) or any(map(_climbs, named)):
                return {}
            return listed
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return {}

    def write_list(self, files: Mapping[str, Listed]) -> None:
        """Replace the list, and remove the bodies of files that are gone.

        Those that no list names yet are kept: another process may be preparing the same library.

        Raises:
            OutputError: it cannot be written.
        """
        make_folder(self._folder)
        earlier = self._body_files(self.read_list())
        content = {"format": [FORMAT, package_version()], "files": {name: asdict(each) for name, each in files.items()}}
        with atomic_write(self._folder / LIST) as part:
            part.write_text(f"{json.dumps(content, indent=1)}\n", encoding="utf-8")
        used = self._body_files(files)
        for path in self._folder.iterdir():
            if STORED.fullmatch(path.name) and path not in used:
                with suppress(OSError):  # another process has removed it, or is reading it
                    if path in earlier or time() - path.stat().st_mtime > ABANDONED:
                        path.unlink()

    def check(self) -> None:
        """Check that the index can be written, before the work begins.

        Raises:
            OutputError: its folder cannot be created or written to.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"The index {self._folder} cannot be created ({reason_of(error)}): choose another folder for it with "
                "--index."
            ) from error
        check_output(self._folder / LIST)

    def holds(self, listed: Listed) -> bool:
        """Whether the bodies of each asset of a file are there."""
        return all(path.is_file() for path in self._body_files({"": listed}))

    def load(self, key: str) -> dict[str, Body] | None:
        """The bodies that are stored under a key, by kind; None if they are missing or damaged."""
        try:
            arrays: dict[str, dict[str, Any]] = {}
            for name, values in read_arrays(self._path(key)).items():
                kind, _, field = name.partition(SEPARATOR)
                arrays.setdefault(kind, {})[field] = values
            return {kind: Body.from_arrays(each) for kind, each in arrays.items()}
        except (OSError, ValueError, KeyError):
            return None

    def save(self, key: str, bodies: Mapping[str, Body]) -> None:
        """Store bodies, by kind, under a key.

        Raises:
            OutputError: they cannot be written.
        """
        make_folder(self._folder)
        arrays = {
            f"{kind}{SEPARATOR}{field}": values
            for kind, body in bodies.items()
            for field, values in body.as_arrays().items()
        }
        with atomic_write(self._path(key)) as part:
            write_arrays(part, arrays)

    def _body_files(self, files: Mapping[str, Listed]) -> set[Path]:
        """The files of the bodies of listed files."""
        return {self._path(key) for each in files.values() for key in each.keys}

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.npz"


def _climbs(name: str) -> bool:
    """Whether a name in a list leads out of the library."""
    return os.path.isabs(name) or ".." in PureWindowsPath(name).parts


def look_at(paths: Sequence[Path]) -> tuple[int, int]:
    """The size of some files in bytes, and when the last one was modified, in nanoseconds.

    Raises:
        OSError: one is missing.
    """
    found = [path.stat() for path in paths]
    return sum(each.st_size for each in found), max(each.st_mtime_ns for each in found)


def key_of(paths: Sequence[Path]) -> str:
    """A hash of the content of some files, for the bodies that this version makes of them.

    Raises:
        OSError: one cannot be read.
    """
    contents = [content_key(read_whole(path)) for path in paths]
    return content_key(repr((contents, FORMAT, package_version())).encode())


def key_of_asset(key: str, name: str) -> str:
    """The key of an asset in a file with a key."""
    return content_key(f"{key} {name}".encode()) if name else key
