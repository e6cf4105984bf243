# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers and polygons of text mesh files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from zoomout_core.arrays import Integers


def decode(content: bytes) -> str:
    """A file's text, with lines that end in a line feed."""
    # Names and comments may be in any encoding; only numbers and keywords are used.
    return content.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def text_lines(content: bytes) -> list[str]:
    """The lines of a file; a separator of pages or paragraphs, which may be in a name, ends none."""
    return decode(content).split("\n")


def number_table(lines: list[str], columns: Sequence[int], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """(len(lines), len(columns)) numbers."""
    if not lines:
        return np.zeros((0, len(columns)), dtype)
    table = np.loadtxt(lines, usecols=columns, ndmin=2)
    found = table.astype(dtype)
    if (found != table).any() and np.issubdtype(dtype, np.integer):
        raise ValueError(f"{table[found != table][0]} is not a whole number")
    return found


def flatten(polygons: Any) -> tuple[Integers, Integers]:
    """The corners (c,) and face starts (f + 1,) of polygons."""
    sizes = [len(polygon) for polygon in polygons]
    return np.concatenate([[], *polygons]).astype(np.int64), np.cumsum([0, *sizes])
