# SPDX-License-Identifier: GPL-3.0-or-later
"""Input files that may be malicious: which files are opened, and how far archives expand."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable
from pathlib import Path, PureWindowsPath
from typing import IO, BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

# Compressed data may expand to this many times its size, or to the bytes in the second constant if that is more, but
# never beyond the third. Deflated meshes and maps shrink to a third or a twentieth of their size; 1000 times is
# possible.
MAX_EXPANSION, ALWAYS_ALLOWED, MAX_BYTES = 100, 1 << 25, 1 << 31


class OutsideError(ValueError):
    """A file names another one that is outside its folder."""


class FormatError(ValueError):
    """A file that contradicts its format; the message is a part of a sentence, without the name of the file."""


class ExpansionError(FormatError):
    """Compressed data that expands too far; the message says how far, without the name of the file."""


def check_path(path: object, what: str = "file") -> None:
    """Raise a TypeError unless a user's path is a string or a path."""
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"Give the {what} as a string or a path, not as a {type(path).__name__}.")


def check_paths(paths: object, what: str) -> None:
    """Raise a TypeError if a user's list of paths, of the name `what`, is a single path, whose letters are no paths."""
    if isinstance(paths, str | os.PathLike) or not isinstance(paths, Iterable):
        raise TypeError(f"{what} is {paths!r:.60}: give a list of paths.")


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file to read it; a pipe, a device or a socket, which could block or act, is not opened.

    Raises:
        OSError: the file is missing, is not a regular file, or cannot be read; `strerror` is a part of a sentence.
    """
    _check_regular(path, os.stat(path))
    # The file may have been replaced by a pipe since, so opening must not wait, and the opened file is checked again.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags)
    try:
        _check_regular(path, os.fstat(descriptor))
    except OSError:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")


def read_whole(path: str | os.PathLike[str]) -> bytes:
    """The content of a regular file, see `open_regular`.

    Raises:
        OSError: the file is missing, is not a regular file, or cannot be read.
    """
    with open_regular(path) as file:
        return file.read()


def _check_regular(path: str | os.PathLike[str], status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        is_folder = stat.S_ISDIR(status.st_mode)
        reason = "it is a folder, not a file" if is_folder else "it is a pipe, a device or a socket, not a file"
        raise OSError(errno.EINVAL, reason, os.fspath(path))


def beside(name: str, folder: Path, folders: Iterable[str | os.PathLike[str]] = ()) -> Path:
    """The path of a file that another file names.

    Args:
        name: its name, with `/` or Windows' separator.
        folder: the folder of the file that names it.
        folders: further folders in which it may be.

    Raises:
        OutsideError: it is outside these folders: its name is absolute or an address, climbs, or follows a link.
    """
    parts = PureWindowsPath(name)  # takes both separators, on every system
    try:
        given = Path(os.path.realpath(folder / name)), Path(os.path.realpath(folder.joinpath(*parts.parts)))
        for allowed in map(os.path.realpath, folders):
            for path in given:
                if path.is_relative_to(allowed):
                    return path
        absolute = parts.drive or parts.root or "://" in name
        if not absolute and ".." not in parts.parts and given[1].is_relative_to(os.path.realpath(folder)):
            return given[1]
    except ValueError:  # a name with a null character
        raise OutsideError(name) from None
    raise OutsideError(name)


def reason_of(error: Exception) -> str:
    """Why a file cannot be used, as a part of a sentence; errors of libraries describe their own internals."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) if isinstance(error, FormatError) else "its content is damaged, or of another format"


def max_bytes(packed: int, expansion: int = MAX_EXPANSION, allowed: int = ALWAYS_ALLOWED) -> int:
    """The number of bytes to which compressed data of some size may expand, see `MAX_EXPANSION`."""
    return min(max(allowed, expansion * packed), MAX_BYTES)


def check_expansion(
    archive: ZipFile,
    members: Iterable[ZipInfo] | None = None,
    expansion: int = MAX_EXPANSION,
    allowed: int = ALWAYS_ALLOWED,
) -> None:
    """Check how far a zip archive, or some members of it, would expand, without expanding them.

    Python reads no more from a member than the size that the archive declares for it.

    Raises:
        ExpansionError: it would expand too far, or it is compressed by a method whose expansion cannot be bounded.
    """
    chosen = archive.infolist() if members is None else list(members)
    if any(info.compress_type not in (ZIP_STORED, ZIP_DEFLATED) for info in chosen):
        raise ExpansionError("it is compressed by an unusual method")
    size, most = sum(info.file_size for info in chosen), max_bytes(_size(archive.fp), expansion, allowed)
    if size > most:
        raise ExpansionError(f"it would expand to {size} bytes, and {most} are allowed for its size")


def _size(file: IO[bytes] | None) -> int:
    if file is None:
        return 0
    before = file.tell()
    size = file.seek(0, os.SEEK_END)
    file.seek(before)
    return size
