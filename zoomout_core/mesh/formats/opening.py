# SPDX-License-Identifier: GPL-3.0-or-later
"""Open mesh files and the files that they name, with a sentence where that is not possible."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.input_files import check_path, open_regular, read_whole, reason_of

# Characters of a name in a message.
SHOWN = 60
# How files begin that are stored in place of a mesh, and the end of the sentence about them.
PLACEHOLDERS = {
    b"version https://git-lfs": "it is a pointer of Git LFS): run `git lfs pull` in its repository",
    b"<!doctype html": "it is a web page): download the file again",
    b"<html": "it is a web page): download the file again",
}
MAX_START = 100  # number of bytes in which such a beginning is looked for


def existing(path: str | PathLike[str]) -> Path:
    """The path of an existing file; raises a MeshError if there is none."""
    check_path(path)
    if not str(path):
        raise MeshError("The name of the file is empty: give its path.")
    path = Path(path)
    if path.is_file():
        return path
    if path.is_dir():
        raise MeshError("{path} is a folder: give a file.", path=path)
    if path.exists():
        raise MeshError("{path} is a pipe, a device or a socket: save its content to a file.", path=path)
    raise MeshError("There is no file {path}: check the path.", path=path)


def file_bytes(path: Path) -> bytes:
    """The content of a file; raises a MeshError if it cannot be read."""
    try:
        return read_whole(path)
    except OSError as error:
        raise MeshError(f"{path} could not be opened ({error.strerror}): check its permissions.") from error


@contextmanager
def explain_damage(path: str | PathLike[str]) -> Iterator[None]:
    """Turn any error of a reader, except an ImportError, into a MeshError that names the file."""
    try:
        with name_file(path):
            yield
    except (MeshError, ImportError):
        raise
    except Exception as error:  # readers raise various errors on a broken file
        _refuse_placeholder(path, error)
        raise MeshError(
            f"{path} could not be read ({reason_of(error)}): check that the file is complete and has the right "
            "extension."
        ) from error


@contextmanager
def name_file(path: str | PathLike[str]) -> Iterator[None]:
    """Name a file in a MeshError that does not."""
    try:
        yield
    except MeshError as error:
        _refuse_placeholder(path, error)
        if str(path) in str(error):
            raise
        raise MeshError("{name}: {reason}", name=str(path), reason=error) from error


def _refuse_placeholder(path: str | PathLike[str], error: Exception) -> None:
    """Raise a MeshError if a file that could not be read is not a damaged mesh, but was stored in place of one."""
    try:
        with open_regular(path) as file:
            start = file.read(MAX_START).lstrip().lower()
    except OSError:  # `error` says why
        return
    for beginning, reason in PLACEHOLDERS.items():
        if start.startswith(beginning):
            raise MeshError(f"{path} could not be read ({reason}.") from error


def outside(path: Path, name: str) -> MeshError:
    """The error that a file names another one outside its folder, see `runtime.input_files.beside`."""
    return MeshError(
        "{path} refers to {name}, which is outside its folder, and is not read: move it beside the file.",
        path=path,
        name=shown(name),
    )


def shown(name: str) -> str:
    """A name of a file as a message quotes it: on one line, and of bounded length."""
    return repr(name if len(name) <= SHOWN else f"{name[: SHOWN - 3]}...")
