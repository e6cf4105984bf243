# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a match's arguments that users give as words and files: start, directions, landmarks, maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats, Integers, RealsOrIntegers
from zoomout_core.maps.surface_map import read_vertex_map
from zoomout_core.matching.constraints import check_axes
from zoomout_core.matching.option_table import OPTIONS, Interface, Kind, Option
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.opening import existing, file_bytes
from zoomout_core.mesh.formats.text_tables import text_lines

STARTS = ("auto", "landmarks", "proximity")
AXES = {"x": "1,0,0", "y": "0,1,0", "z": "0,0,1", "-x": "-1,0,0", "-y": "0,-1,0", "-z": "0,0,-1"}


def read_values(values: Mapping[str, Any], interface: Interface) -> dict[str, Any]:
    """Read the files and directions among the options of a match, by name of the option table; arrays stay unchanged.

    Errors name the options as in the interface.

    Raises:
        MeshError: a file or a direction is invalid.
    """
    return {name: _read_value(OPTIONS[name], value, interface) for name, value in values.items()}


def _read_value(option: Option, value: Any, interface: Interface) -> Any:
    if option.kind is Kind.LANDMARKS and isinstance(value, str):
        return read_landmarks(value)
    if option.kind is Kind.MAP and isinstance(value, str):
        return read_vertex_map(value)
    words = [value] if isinstance(value, str) else value
    if option.kind is Kind.DIRECTIONS and isinstance(words, list) and all(isinstance(word, str) for word in words):
        return [read_axis(word, option.name_in(interface)) for word in words]
    return value


def read_axis(text: str, option: str = "--common-axis") -> Floats:
    """The unit direction (3,) of `x`, `-y` or three numbers with commas.

    Raises:
        MeshError: it is not a direction.
    """
    try:
        return check_axes([float(number) for number in AXES.get(text.lower(), text).split(",")])[0]
    except ValueError:
        raise MeshError(f"{option} is {text!r}: give x, -x, y, -y, z, -z, or a direction such as 0,0,1.") from None


def read_landmarks(path: str) -> tuple[RealsOrIntegers, RealsOrIntegers]:
    """Source and target vertices (m,), or points (m, 3), from a text file with one pair per line.

    Raises:
        MeshError: the file cannot be opened; or a line is neither a pair of vertex numbers nor a pair of points, or
            differs from the others.
    """
    rows = _rows_of(path, "landmarks")
    columns = 6 if len(rows[0][1]) == 6 else 2
    table = _table_of(
        rows,
        columns,
        f"{path} is not a list of landmarks{{line}}: write two vertex numbers (source and target) per line, or six "
        "coordinates of a source and a target point.",
    )
    source, target = np.split(table, 2, axis=1)
    return (source, target) if columns == 6 else (source[:, 0], target[:, 0])


def read_truth(path: str) -> tuple[Integers, Integers]:
    """Source and target vertices (m,) from a text file of ground-truth pairs, one per line.

    Raises:
        MeshError: the file cannot be opened, or a line is not a pair of vertex numbers.
    """
    fault = f"{path} is not a list of ground-truth pairs{{line}}: write a source vertex and a target vertex per line."
    source, target = _table_of(_rows_of(path, "ground-truth pairs"), 2, fault).T
    return source, target


def _rows_of(path: str, what: str) -> list[tuple[int, list[str]]]:
    """The words of each line of a text file, without comments and empty lines, and the number of the line."""
    content = file_bytes(existing(path))
    if b"\0" in content:
        raise MeshError(f"{path} is not a list of {what}: save it as plain text in UTF-8.")
    lines = ((number, line.partition("#")[0].split()) for number, line in enumerate(text_lines(content), start=1))
    rows = [(number, words) for number, words in lines if words]
    if not rows:
        raise MeshError(f"{path} is not a list of {what}: it contains no vertex numbers.")
    return rows


def _table_of(rows: Sequence[tuple[int, list[str]]], columns: int, fault: str) -> RealsOrIntegers:
    """(m, 2) whole numbers or (m, 6) numbers of lines; `fault` is the message for a line that has none."""
    dtype = np.float64 if columns == 6 else np.int64
    table = np.empty((len(rows), columns), dtype)
    for row, (number, words) in zip(table, rows, strict=True):
        try:
            row[:] = np.array(words).reshape(columns).astype(dtype)
        except (ValueError, OverflowError):
            raise MeshError(fault.format(line=f" (line {number})")) from None
    return table
