# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers and polygons of text mesh files."""

from __future__ import annotations

from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from zoomout_core.arrays import Floats, Integers
from zoomout_core.runtime.input_files import FormatError

# Double floats are whole numbers up to here, without gaps.
LARGEST = 2**53
# Characters of a line in a message.
SHOWN = 40


def decode(content: bytes) -> str:
    """A file's text, with lines that end in a line feed."""
    # Names and comments may be in any encoding; only numbers and keywords are used. Some Windows programs write UTF-16.
    encoding = "utf-16" if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig"
    return content.decode(encoding, errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def text_lines(content: bytes) -> list[str]:
    """The lines of a file. Separators of pages and paragraphs, which may be part of a name, do not end a line."""
    return decode(content).split("\n")


def number_table(lines: list[str], columns: Sequence[int], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """(len(lines), len(columns)) numbers.

    Raises:
        FormatError: a line lacks one, or a whole one is needed.
    """
    if not lines:
        return np.zeros((0, len(columns)), dtype)
    try:
        table = np.loadtxt(lines, usecols=columns, ndmin=2)
    except ValueError:
        wrong = next((line for line in lines if not _has_numbers(line, columns)), lines[0])
        raise FormatError(f"the line {wrong!r:.{SHOWN}} lacks one of its numbers") from None
    return whole_numbers(table) if np.issubdtype(dtype, np.integer) else table.astype(dtype)


def _has_numbers(line: str, columns: Sequence[int]) -> bool:
    """Whether a line has a number in each of some columns."""
    words = line.split()
    try:
        return bool([float(words[column]) for column in columns])
    except (ValueError, IndexError):
        return False


def whole_number(word: str | bytes) -> int:
    """The whole number that is written.

    Raises:
        FormatError: it is none.
    """
    try:
        return int(word)
    except ValueError:
        raise FormatError(f"{word!r:.{SHOWN}} is not a whole number") from None


def real_number(word: str) -> float:
    """The number that is written.

    Raises:
        FormatError: it is none.
    """
    try:
        return float(word)
    except ValueError:
        raise FormatError(f"{word!r:.{SHOWN}} is not a number") from None


def whole_numbers(values: Floats) -> Integers:
    """The same numbers as integers.

    Raises:
        FormatError: they are not whole, or too large.
    """
    wrong = values[~((np.abs(values) < LARGEST) & (values == np.trunc(values)))]  # also finds NaN
    if wrong.size:
        raise FormatError(f"{wrong[0]:g} is not a whole number below {LARGEST:.0e}")
    return values.astype(np.int64)


def flatten(polygons: Any) -> tuple[Integers, Integers]:
    """The corners (c,) and face starts (f + 1,) of polygons.

    Raises:
        FormatError: a corner is not a whole number.
    """
    sizes = [len(polygon) for polygon in polygons]
    return whole_numbers(np.concatenate([[], *polygons]).astype(np.float64)), np.cumsum([0, *sizes])
