# SPDX-License-Identifier: GPL-3.0-or-later
"""Output files: written completely or not at all, and never over their inputs.

A file is written under a temporary name beside its place, and renamed once it is complete. So a full disk, a limit or a
kill leaves the earlier file, and nobody reads an incomplete one.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from filecmp import cmp
from pathlib import Path
from secrets import token_hex
from time import time

from zoomout_core.runtime.input_files import check_path

# Names of files and folders that are being written, followed by the extension of the output.
PART = re.compile(r"\.[0-9a-f]{8}\.part(\.[^.]*)?")
# Seconds after which an unfinished file counts as left behind by a dead process.
ABANDONED = 3600


class OutputError(OSError):
    """A file that cannot be written; the message says in one sentence why and what to do."""


def check_output(
    output: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]] = (), in_place: bool = False
) -> None:
    """Check, before the work begins, that a file can be written and, unless `in_place`, is none of its inputs.

    Raises:
        OutputError: its folder is missing or cannot be written to, such as on a full disk; or the file is a folder, is
            one of the inputs, or has an invalid name.
    """
    path = Path(output)
    _check_name(path)
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(f"There is no folder {folder}: create it, or choose another one.")
    if path.is_dir():
        raise OutputError(f"{path} is a folder: give the name of a file in it.")
    if os.path.islink(os.path.realpath(path)):
        raise OutputError(f"{path} is a link that leads back to itself: remove it, or choose another place.")
    for place in (folder, path):
        if place.exists() and not os.access(place, os.W_OK):
            raise OutputError(f"{place} is not writable: change its permissions, or choose another place.")
    if not in_place:
        check_no_input(path, inputs)
    if not path.exists() or path.is_file():
        _try_to_write(path)


def check_no_input(path: Path, inputs: Iterable[str | os.PathLike[str]]) -> None:
    """Raise an OutputError if a file is one of the inputs."""
    if path.exists() and any(is_same_file(path, one) for one in inputs):
        raise replaces_input(path)


def replaces_input(path: Path) -> OutputError:
    """The error that an output would replace an input."""
    return OutputError(f"{path} is an input, and would be overwritten: choose another output, or pass --in-place.")


def _try_to_write(path: Path) -> None:
    """Write a byte beside an output: a full disk or a limit shows only then.

    Raises:
        OutputError: it cannot be written.
    """
    path = Path(os.path.realpath(path))
    with _explain_errors(path):
        part = _part_of(path)
        try:
            part.write_bytes(b"\0")
        finally:
            part.unlink(missing_ok=True)


def is_same_file(one: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Whether two paths lead to the same existing file, through any links or spelling."""
    try:
        return os.path.samefile(one, other)
    except OSError:  # one of them is missing
        return False


@contextmanager
def atomic_write(output: str | os.PathLike[str]) -> Iterator[Path]:
    """A path to write to in the same folder, with the same extension; replaces the output on success.

    Special files, such as a pipe, are written to directly.

    Raises:
        OutputError: it could not be written; the earlier file is unchanged.
    """
    path = _destination(output)
    if path.exists() and not path.is_file():
        with _explain_errors(path):
            yield path
        return
    with _explain_errors(path):
        part = _part_of(path)
        try:
            yield part
            _complete(part)
            _replace(path, part)
        finally:
            part.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make a folder for outputs, and those above it.

    Raises:
        OutputError: it cannot be made.
    """
    _check_no_file(folder)
    with _explain_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file, and the folders above it.

    Raises:
        OutputError: it cannot be written; the earlier file is unchanged.
    """
    make_folder(path.parent)
    with atomic_write(path) as part:
        part.write_bytes(content)


@contextmanager
def atomic_write_together(
    output: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]] = ()
) -> Iterator[Path]:
    """A path of the same name in a temporary folder, for a file that refers to others, such as textures.

    On success, all files of that folder are moved beside `output`, the file itself last.

    Args:
        output: the file to write.
        inputs: files that must not be replaced; one that would get its present content is not written.

    Raises:
        OutputError: it could not be written, or would replace an input; the earlier files are unchanged.
    """
    path, inputs = _destination(output), tuple(inputs)
    with _explain_errors(path):
        folder = _part_of(path)
        try:
            folder.mkdir()
            main = folder / path.name
            yield main
            parts = sorted(folder.iterdir(), key=lambda part: part == main)
            for part in parts:
                _complete(part)
            kept = [part for part in parts if any(is_same_file(path.with_name(part.name), one) for one in inputs)]
            for part in kept:
                if not cmp(part, path.with_name(part.name), shallow=False):
                    raise replaces_input(path.with_name(part.name))
            for part in parts:
                if part not in kept:
                    _replace(path.with_name(part.name), part)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _destination(output: str | os.PathLike[str]) -> Path:
    """The path of an output, behind links, which stay links.

    Raises:
        OutputError: it is a folder, or has a name that no file can have.
        TypeError: it is neither a string nor a path.
    """
    check_path(output)
    _check_name(Path(output))
    path = Path(os.path.realpath(output))
    if path.is_dir():
        raise OutputError(f"{path} is a folder: give the name of a file in it.")
    return path


def _check_name(path: Path) -> None:
    """Raise an OutputError if no file can have this name."""
    try:
        os.lstat(path)
    except ValueError:
        raise OutputError(f"{str(path)!r:.60} has a null character in its name: choose another name.") from None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise OutputError(f"The name {path.name!r:.60} is too long for a file: choose a shorter one.") from None


@contextmanager
def _explain_errors(path: Path) -> Iterator[None]:
    """Turn a system error into a sentence that names the output."""
    existed = path.is_file()
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(
            f"{path} could not be written ({error.strerror or error}){', and the existing file was kept' * existed}: "
            "check disk space and permissions, or choose another place."
        ) from error


def _complete(part: Path) -> None:
    """Make sure that a file was written completely; raises OSError if not.

    Many libraries ignore failed writes. A full disk or a limit also prevents the file from growing by one byte, so that
    is tried.
    """
    with part.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.write(b"\0")
        file.flush()
        file.truncate(size)
        os.fsync(file.fileno())


def _replace(path: Path, part: Path) -> None:
    """Replace a file by another, which takes over its permissions."""
    if path.exists():
        with suppress(OSError):  # it is another user's
            part.chmod(stat.S_IMODE(path.stat().st_mode))
    part.replace(path)


def _part_of(path: Path) -> Path:
    """A temporary name beside a file, with its extension, by which some libraries choose the format.

    Files that dead processes left in the folder are removed.
    """
    for part in path.parent.iterdir():
        if PART.fullmatch(part.name):
            with suppress(OSError):  # another process removed it, or it is another user's
                if time() - part.stat().st_mtime > ABANDONED:
                    shutil.rmtree(part) if part.is_dir() else part.unlink()
    return path.with_name(f".{token_hex(4)}.part{path.suffix}")


def check_results_folder(folder: Path, names: Iterable[str]) -> None:
    """Check, before the work begins, that results can be written to a folder.

    Args:
        folder: the folder, which may not exist yet.
        names: the names of its results; those without an extension are folders.

    Raises:
        OutputError: a result, or the folder, cannot be written, or is a file in place of a folder or the reverse.
    """
    if not folder.is_dir():
        check_output(folder)
        _check_no_file(folder)
        return
    for place in (folder / name for name in names):
        if place.suffix:
            check_output(place)
        else:
            _check_no_file(place)


def _check_no_file(folder: Path) -> None:
    """Raise an OutputError if a file is in the place of a folder."""
    if os.path.lexists(folder) and not folder.is_dir():
        what = "a file" if folder.exists() else "a link that leads nowhere"
        raise OutputError(f"{folder} is {what}: name a folder for the results.")


def check_inputs_outside(inputs: Iterable[Path], output: Path, names: Iterable[str]) -> None:
    """Check that no input is at one of the places in a folder, given by their names, where results are replaced.

    Raises:
        OutputError: one is.
    """
    written = [os.path.realpath(output / name) for name in names]
    for path in inputs:
        place = Path(os.path.realpath(path))
        if any(place.is_relative_to(each) for each in written):
            raise OutputError(f"{path} is an input in a place of {output} for results: choose another output folder.")
