# SPDX-License-Identifier: GPL-3.0-or-later
"""The files that a mesh file names: buffers, materials and images, found without reading the mesh itself."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from html import unescape
from os import PathLike
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_files import named_uris, parse_gltf
from zoomout_core.mesh.formats.opening import existing, file_bytes, outside, shown
from zoomout_core.mesh.formats.text_tables import decode
from zoomout_core.runtime.input_files import OutsideError, beside, read_whole

# Statements that name files, in OBJ, .mtl and PLY files, and the element that does in COLLADA files.
FLAGS = re.MULTILINE | re.IGNORECASE
LIBRARY = re.compile(r"^[^\S\n]*mtllib[^\S\n]+(.+)$", FLAGS)
IMAGE = re.compile(r"^[^\S\n]*(?:map_\w+|bump|disp|decal|refl|norm)[^\S\n]+(.+)$", FLAGS)
TEXTURE = re.compile(r"^comment[^\S\n]+TextureFile[^\S\n]+(.+)$", FLAGS)
ELEMENT = re.compile(r"<init_from[^>]*>\s*(?:<ref>)?\s*([^<]+?)\s*<")


class NamedFile(NamedTuple):
    """A file as another one names it, and the folder that the name is relative to."""

    name: str
    folder: Path

    @property
    def path(self) -> Path:
        """Where the file would be, which may be outside the folder."""
        return self.folder / self.name.replace("\\", "/")


def named_files(path: str | PathLike[str], folders: Iterable[Path] = ()) -> list[NamedFile]:
    """The files that an OBJ, PLY, glTF, GLB, VRM or COLLADA file names; none for other formats, and for broken files.

    Args:
        path: the file.
        folders: further folders in which its files may be.

    Raises:
        MeshError: the file is missing or cannot be opened.
    """
    path = existing(path)
    find = FINDERS.get(path.suffix.lower())
    return [] if find is None else list(find(path, file_bytes(path), tuple(folders)))


def check_named_files(path: str | PathLike[str], folders: Iterable[Path] = ()) -> None:
    """Check the names in a file before a program reads it that would follow them anywhere.

    Raises:
        MeshError: the file is missing, or names one that is outside its folder, or no regular file.
    """
    folders = tuple(folders)
    for named in named_files(path, folders):
        try:
            found = beside(named.name, named.folder, folders)
        except OutsideError as error:
            raise outside(Path(path), named.name) from error
        if found.exists() and not found.is_file():
            raise MeshError(
                "{path} refers to {name}, which is not a file: remove it.", path=path, name=shown(named.name)
            )


def _of_obj(path: Path, content: bytes, folders: tuple[Path, ...]) -> Iterator[NamedFile]:
    for library in _names(LIBRARY, content):
        yield NamedFile(library, path.parent)
        try:
            place = beside(library, path.parent, folders)
            materials = read_whole(place)
        except (OutsideError, OSError):
            continue  # it is not read in any case
        yield from (NamedFile(image, place.parent) for image in _names(IMAGE, materials))


def _names(statement: re.Pattern[str], content: bytes) -> dict[str, None]:
    """The names in statements: a name may have spaces, but it may also be several names or options."""
    found: dict[str, None] = {}
    for text in statement.findall(decode(content).replace("\\\n", " ")):
        words = text.partition("#")[0].split()
        if words:
            found |= dict.fromkeys((" ".join(words), *words))
    return found


def _of_ply(path: Path, content: bytes, _: tuple[Path, ...]) -> Iterator[NamedFile]:
    header = decode(content[: content.find(b"end_header")])
    return (NamedFile(name.strip(), path.parent) for name in TEXTURE.findall(header))


def _of_collada(path: Path, content: bytes, _: tuple[Path, ...]) -> Iterator[NamedFile]:
    return (NamedFile(unquote(unescape(name)), path.parent) for name in ELEMENT.findall(decode(content)))


def _of_gltf(path: Path, content: bytes, _: tuple[Path, ...]) -> Iterator[NamedFile]:
    try:
        tree, _binary = parse_gltf(content)
    except ValueError:
        return
    yield from (NamedFile(unquote(uri), path.parent) for uri in named_uris(tree))


FINDERS: dict[str, Callable[[Path, bytes, tuple[Path, ...]], Iterator[NamedFile]]] = {
    ".dae": _of_collada,
    ".glb": _of_gltf,
    ".gltf": _of_gltf,
    ".obj": _of_obj,
    ".ply": _of_ply,
    ".vrm": _of_gltf,
}
