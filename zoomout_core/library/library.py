# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder of finished characters, which is prepared once and searched for the best source for a new body."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from zoomout_core.arrays import check_counts
from zoomout_core.assets.files import MESHES, inputs_of
from zoomout_core.collection.shapes import content_key
from zoomout_core.library.bodies import LibraryAsset, bodies_of
from zoomout_core.library.found import FoundSources
from zoomout_core.library.index import Index, Listed, key_of, key_of_asset, look_at
from zoomout_core.library.search import search
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import ENDINGS, write_assets
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.shapes import ShapeLike, as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import NO_MEMORY, message_of
from zoomout_core.runtime.input_files import check_path
from zoomout_core.runtime.outputs import OutputError
from zoomout_core.runtime.progress import Progress, listening, portion, renaming
from zoomout_core.runtime.threads import on_one_blas_thread

# The folder of the index in that of the assets.
INDEX = ".zoomout"
# Names of assets that would lead out of their file as paths.
BAD_NAME = "The name of an asset contains a backslash, a double slash or dots alone: rename it in Blender."
NOT_PREPARED = "{folder} contains no prepared characters: choose another folder, or run `zoomout library` on it."


@dataclass(frozen=True)
class Preparation:
    """The outcome of preparing a library.

    Attributes:
        assets: the number of assets that can be found.
        new: the number of those that were prepared now; the others were known.
        failures: why the others were skipped, in one sentence for each file, or asset in a .blend file.

    Example:
        >>> zo.Library(folder).prepare()  # of an empty folder
        Preparation(assets=0, new=0, failures={})
    """

    assets: int
    new: int
    failures: dict[Path, str]


class Library:
    """A folder of assets, including those in its subfolders.

    Args:
        folder: the folder.
        index: the folder of the index; `.zoomout` in the folder if not given.
        blender: Blender's program for .blend and .fbx, see `blender_command`.

    Raises:
        MeshError: there is no such folder.
        TypeError: it is neither a string nor a path.

    Example:
        >>> notes = zo.write_asset(zo.Asset(source), folder / "hero.ply")
        >>> library = zo.Library(folder)
        >>> library.prepare().assets
        1
        >>> library.find(target).ranked[0].path.name
        'hero.ply'
    """

    def __init__(
        self, folder: str | PathLike[str], index: str | PathLike[str] | None = None, blender: str | None = None
    ) -> None:
        check_path(folder, "folder")
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise MeshError("There is no folder {folder}: check the path.", folder=folder)
        self.index_folder = self.folder / INDEX if index is None else Path(index)
        self._index, self._blender = Index(self.index_folder), blender

    @on_one_blas_thread
    def prepare(self, *, progress: Callable[[Progress], object] | None = None) -> Preparation:
        """Prepare the files that are new or changed.

        Each asset is stored at once, so that an interrupted preparation resumes where it stopped.

        Args:
            progress: called with the `Progress` from time to time, see `zoomout_core.progress`.

        Raises:
            OutputError: the index cannot be written.
        """
        known, files = self._index.read_list(), list(self._files())
        if not (known or files):  # probably another folder than was meant, which gets no index
            return Preparation(0, 0, {})
        self._index.check()
        names = {each.key: each.assets for each in known.values()}
        listed: dict[str, Listed] = {}
        failures: dict[Path, str] = {}
        new = 0
        with listening(progress):
            for number, path in enumerate(files):
                place, name = f"{number + 1}/{len(files)} ", self._name(path)
                with portion(number / len(files), (number + 1) / len(files)), renaming(place.__add__):
                    try:
                        found, prepared, failed = self._prepare(path, known.get(name), names)
                        if found.assets:
                            listed[name] = found
                        new += prepared
                        failures |= failed
                    except OutputError:
                        raise
                    except (ValueError, OSError, ImportError) as error:
                        failures[path] = message_of(error)
                    except MemoryError:
                        failures[path] = NO_MEMORY
            self._index.write_list(listed)
        return Preparation(sum(len(each.assets) for each in listed.values()), new, failures)

    def find(
        self,
        target: ShapeLike,
        compare: int | None = None,
        *,
        progress: Callable[[Progress], object] | None = None,
    ) -> FoundSources:
        """Find the assets that fit a target in any pose, orientation and unit.

        Args:
            target: a surface, a point cloud or the path of a file, see `ShapeLike`.
            compare: number of nearest assets to match; by default four or fewer.
            progress: called with the `Progress` from time to time, see `zoomout_core.progress`.

        Returns:
            The assets that were matched, the best first, or why nothing fits.

        Raises:
            MeshError: the library is not prepared, or the target cannot be analysed.
            ValueError: `compare` is not a positive whole number.
        """
        return find_source(target, (self,), compare, progress=progress)

    def assets(self) -> Iterator[LibraryAsset]:
        """The prepared assets whose files still exist."""
        for name, listed in self._index.read_list().items():
            path = self.folder / name
            for asset, key in zip(listed.assets, listed.keys, strict=True):
                bodies = self._index.load(key) if path.is_file() else None
                if bodies is not None:
                    yield LibraryAsset(path / asset, bodies)

    def content(self) -> str:
        """A hash of the prepared files, for results that depend on all of them."""
        return content_key(repr(sorted(self._index.read_list().items())).encode())

    def new_files(self) -> list[Path]:
        """Files of the folder that are not prepared: added or changed since `prepare`, skipped by it, or without bodies
        in the index.
        """
        known = self._index.read_list()
        return [
            path
            for path in self._files()
            if (listed := known.get(self._name(path))) is None
            or not (self._index.holds(listed) and _is_current(path, listed))
        ]

    def _files(self) -> Iterator[Path]:
        """The mesh files, sorted, without those in hidden folders."""
        for folder, folders, files in os.walk(self.folder):
            folders[:] = sorted(each for each in folders if not each.startswith("."))
            for name in sorted(files):
                if Path(name).suffix.lower() in MESHES and not name.startswith("."):
                    yield Path(folder, name)

    def _name(self, path: Path) -> str:
        return path.relative_to(self.folder).as_posix()

    def _prepare(
        self, path: Path, known: Listed | None, names: Mapping[str, tuple[str, ...]]
    ) -> tuple[Listed, int, dict[Path, str]]:
        """Prepare the assets of a file.

        Args:
            path: the file.
            known: its listing, if it is prepared.
            names: the names of the assets in prepared files, by the keys of their contents.

        Returns:
            The listing, the number of assets whose bodies were computed now, and why others of a .blend or .fbx file
                failed.

        Raises:
            MeshError: the file cannot be read, or its shape cannot be analysed.
            OutputError: its bodies cannot be stored.
        """
        inputs = inputs_of(path)
        seen = look_at(inputs)
        key = known.key if known is not None and known.seen == seen else key_of(inputs)
        listed = Listed(*seen, key, names.get(key, ("",)))
        if listed.assets and all(self._index.load(each) is not None for each in listed.keys):
            return listed, 0, {}
        if path.suffix.lower() not in ENDINGS:
            self._index.save(key, bodies_of(read_surface(path)))
            return listed, 1, {}
        done, failures = list[str](), dict[Path, str]()
        with TemporaryDirectory(prefix="zoomout-") as folder:
            for name, written in write_assets(path, Path(folder), self._blender).items():
                try:
                    self._index.save(key_of_asset(key, name), bodies_of(_surface_of_asset(name, written)))
                    done.append(name)
                except MeshError as error:
                    failures[path / name] = message_of(error)
        return Listed(*seen, key, tuple(done)), len(done), failures


def _is_current(path: Path, listed: Listed) -> bool:
    """Whether a file, and those that it names, have the content that was prepared."""
    try:
        if look_at([path]) == listed.seen:  # it names no others
            return True
        inputs = inputs_of(path)
        return look_at(inputs) == listed.seen or key_of(inputs) == listed.key
    except OSError:  # one is gone
        return False


def _surface_of_asset(name: str, written: Path | str) -> Surface:
    """The surface of an asset in a .blend file, see `write_assets`.

    Raises:
        MeshError: it has none, or its name cannot be a part of a path.
    """
    if isinstance(written, str):
        raise MeshError(written)
    if "\\" in name or (name and any(part in ("", ".", "..") for part in name.split("/"))):
        raise MeshError(BAD_NAME)
    return read_surface(written)


@on_one_blas_thread
def find_source(
    target: ShapeLike,
    libraries: Sequence[Library],
    compare: int | None = None,
    *,
    progress: Callable[[Progress], object] | None = None,
) -> FoundSources:
    """Find the assets of several libraries that fit a target, see `Library.find`.

    Raises:
        MeshError: a library is not prepared, or the target cannot be analysed.
        ValueError: `compare` is not a positive whole number.
        TypeError: the libraries are not a list of them.

    Example:
        >>> notes = zo.write_asset(zo.Asset(source), folder / "hero.ply")
        >>> library = zo.Library(folder)
        >>> report = library.prepare()
        >>> zo.find_source(target, [library]).nearest.name
        'hero.ply'
    """
    if compare is not None:
        check_counts(compare=compare)
    if not (isinstance(libraries, Sequence) and all(isinstance(each, Library) for each in libraries)):
        raise TypeError(f"The libraries are {libraries!r:.60}: give a list, such as [zo.Library('characters')].")
    assets = prepared_assets(libraries)
    with listening(progress):
        return search(as_surface(target), assets, compare)


def prepared_assets(libraries: Sequence[Library]) -> list[LibraryAsset]:
    """The assets of several libraries; those of overlapping folders once.

    Raises:
        MeshError: a library is not prepared.
    """
    assets: dict[Path, LibraryAsset] = {}
    for library in libraries:
        found = {asset.path: asset for asset in library.assets()}
        if not found:
            raise MeshError(NOT_PREPARED, folder=library.folder)
        assets |= found
    return list(assets.values())
