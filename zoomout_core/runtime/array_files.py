# SPDX-License-Identifier: GPL-3.0-or-later
"""Write arrays to .npz files, and read them from files that may be broken or malicious: no code is run."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from math import prod
from pathlib import Path
from typing import IO, Any, TypeAlias
from zipfile import ZipFile

import numpy as np

from zoomout_core.runtime.input_files import MAX_BYTES, ExpansionError, check_expansion, check_path, open_regular

# Reads from the start of a file: the shape of its array, whether it is in column-major order, and its type.
Header: TypeAlias = Callable[[IO[bytes]], tuple[tuple[int, ...], bool, np.dtype[Any]]]
HEADERS: dict[tuple[int, int], Header] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


class ArrayFileError(ValueError):
    """A file whose arrays cannot be read; the message says why, without its name."""


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Any], compressed: bool = True) -> None:
    """Write arrays to a file.

    They are collected in memory first: on a full disk, `zipfile` would print an error of its own.

    Raises:
        OSError: it cannot be written.
    """
    content = BytesIO()
    (np.savez_compressed if compressed else np.savez)(content, **arrays)
    Path(path).write_bytes(content.getbuffer())


def read_arrays(
    path: str | os.PathLike[str], names: Sequence[str] = (), max_bytes: int = MAX_BYTES
) -> dict[str, np.ndarray[Any, Any]]:
    """Read all arrays of an .npz file, or some of them; missing ones are left out.

    Sizes are checked before anything is read: those in the headers, and those of the decompressed content.

    Raises:
        FileNotFoundError: the file is missing.
        ArrayFileError: it is not an .npz file, it is broken, or its arrays take more than `max_bytes`, or too much for
            its size.
    """
    check_path(path)
    try:
        opened = open_regular(path)
    except FileNotFoundError:
        raise FileNotFoundError(f"There is no file {path}: check the path.") from None
    except OSError as error:
        raise ArrayFileError(str(error.strerror)) from error
    try:
        with opened, ZipFile(opened) as archive:
            held = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            wanted = {name: held[name] for name in names or held if name in held}
            size = sum(info.file_size for info in wanted.values())
            if size > max_bytes:
                raise ArrayFileError(f"its arrays take {size} bytes, and {max_bytes} are allowed")
            check_expansion(archive, wanted.values())
            found = {}
            for name, info in wanted.items():
                with archive.open(info) as file:
                    found[name] = _array(file, info.file_size, name)
            return found
    except ArrayFileError:
        raise
    except ExpansionError as error:
        raise ArrayFileError(str(error)) from error
    except Exception as error:  # on a broken file zipfile, zlib and numpy raise various errors
        raise ArrayFileError("it is not an .npz file, or it is damaged") from error


def _array(file: IO[bytes], size: int, name: str) -> np.ndarray[Any, Any]:
    """Read the array in a file, whose header must match the file's size."""
    header = HEADERS[np.lib.format.read_magic(file)]
    shape, fortran_order, dtype = header(file)  # reads a bounded length
    if dtype.hasobject or min(shape, default=0) < 0:
        raise ArrayFileError(f"its array '{name}' does not contain numbers")
    if prod(shape) * dtype.itemsize != size - file.tell():
        raise ArrayFileError(f"its array '{name}' does not have the size that it declares")
    values = np.frombuffer(bytearray(file.read()), dtype)
    return values.reshape(shape, order="F" if fortran_order else "C")
