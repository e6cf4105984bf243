# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY files: columns of numbers, in text or binary, of elements such as vertices and faces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.formats.text_tables import SHOWN, flatten, real_number, text_lines, whole_number, whole_numbers
from zoomout_core.runtime.input_files import FormatError

# Columns of an element: arrays (count,), or (count, k) for lists of equal size; otherwise a list of arrays.
PlyColumns: TypeAlias = Mapping[str, Any]
# Names of types in PLY headers, and in numpy.
PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}


@dataclass(frozen=True)
class _Property:
    """A column of a PLY element; for a list, `size_type` is the type of the length that precedes it."""

    name: str
    type: np.dtype[Any]
    size_type: np.dtype[Any] | None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def ply_polygons(columns: Mapping[str, PlyColumns]) -> tuple[Floats, Integers, Integers]:
    """(n, 3) positions, (c,) the vertex of each corner, (f + 1,) the first corner of each face, from `ply_columns`."""
    vertices = np.stack([np.array(columns["vertex"][axis], dtype=np.float64) for axis in "xyz"], axis=1)
    faces = _lists(columns, "face")
    return vertices, *flatten([*faces, *strip_triangles(_lists(columns, "tristrips"))])


def _lists(columns: Mapping[str, PlyColumns], element: str) -> Any:
    """The lists of vertex numbers of an element."""
    found = columns.get(element, {})
    return found.get("vertex_indices", found.get("vertex_index", []))


def strip_triangles(strips: Iterable[Any]) -> Integers:
    """(m, 3) triangles of strips of vertex numbers, in which -1 begins another strip; without degenerate ones."""
    corners = np.concatenate([np.full(3, -1), *(np.append(strip, -1) for strip in strips)]).astype(np.int64)
    place = np.arange(len(corners))
    since = place - np.maximum.accumulate(np.where(corners < 0, place + 1, 0))  # the first of a strip is 0
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    odd = since[: len(triangles)] % 2 == 1
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    first, second, third = triangles.T
    return triangles[(triangles >= 0).all(axis=1) & (first != second) & (second != third) & (third != first)]


def ply_normals(vertex_columns: PlyColumns) -> Floats | None:
    """(n, 3) normals; None unless each vertex has one."""
    if not {"nx", "ny", "nz"} <= vertex_columns.keys():
        return None
    return np.stack([np.array(vertex_columns[axis], dtype=np.float64) for axis in ("nx", "ny", "nz")], axis=1)


def ply_columns(content: bytes) -> dict[str, PlyColumns]:
    """The content of a PLY file, by element and property.

    Raises:
        FormatError: it is not PLY, or damaged.
    """
    end = content.find(b"end_header")
    if not content.startswith(b"ply") or end < 0:
        raise FormatError("it has no PLY header")
    header = [line.split() for line in text_lines(content[:end])]
    body = content[content.index(b"\n", end) + 1 :]
    encoding = next((words[1] for words in header if words[:1] == ["format"] and len(words) > 1), "")
    if not encoding:
        raise FormatError("its header has no format")
    if encoding == "ascii":
        body = _doubles(body.split())  # treat it as a binary file of doubles from here on
        types = {word: np.dtype(np.float64) for word in PLY_TYPES}
    else:
        order = ">" if encoding == "binary_big_endian" else "<"
        types = {word: np.dtype(order + code) for word, code in PLY_TYPES.items()}
    columns: dict[str, PlyColumns] = {}
    for element in _ply_elements(header, types):
        columns[element.name], body = _element_columns(body, element)
    if "vertex" not in columns or not {"x", "y", "z"} <= columns["vertex"].keys():
        raise FormatError("its header has no vertices with x, y and z")
    return columns


def _doubles(words: list[bytes]) -> bytes:
    """Written numbers as doubles."""
    try:
        return np.array(words, dtype=np.float64).tobytes()
    except ValueError:
        for word in words:
            real_number(word.decode(errors="replace"))  # names the wrong one
        raise


def _ply_elements(header: list[list[str]], types: dict[str, np.dtype[Any]]) -> list[_Element]:
    elements: list[_Element] = []
    for words in header:
        try:
            if words[:1] == ["element"]:
                if (count := whole_number(words[2])) < 0:
                    raise FormatError(f"its header declares {count} elements")
                elements.append(_Element(words[1], count, []))
            elif words[:2] == ["property", "list"]:
                elements[-1].properties.append(_Property(words[4], types[words[3]], types[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1].properties.append(_Property(words[2], types[words[1]], None))
        except LookupError:  # a word is missing, a type unknown, or a property of nothing
            raise FormatError(f"its header has the line {' '.join(words)!r:.{SHOWN}}") from None
    return elements


def _element_columns(body: bytes, element: _Element) -> tuple[dict[str, Any], bytes]:
    """The columns of an element, arrays (count, ...) or lists of arrays of any size, and the rest of the file."""
    if element.count == 0:
        return {column.name: np.zeros(0) for column in element.properties}, body
    first, _ = _ply_row(body, 0, element.properties)
    fields: list[Any] = []
    for column in element.properties:
        if column.size_type is not None:
            fields.append((column.name + " size", column.size_type))
        fields.append((column.name, column.type, first[column.name].shape))
    row = np.dtype(fields)
    if len(body) >= element.count * row.itemsize:
        table = np.frombuffer(body, row, element.count)
        lists = [column.name for column in element.properties if column.size_type is not None]
        if all((table[name + " size"] == len(first[name])).all() for name in lists):
            columns = {column.name: table[column.name] for column in element.properties}
            return columns, body[element.count * row.itemsize :]
    offset, rows = 0, []
    for _ in range(element.count):
        values, offset = _ply_row(body, offset, element.properties)
        rows.append(values)
    return {column.name: [values[column.name] for values in rows] for column in element.properties}, body[offset:]


def _ply_row(body: bytes, offset: int, properties: list[_Property]) -> tuple[dict[str, Any], int]:
    """The values of the row that begins at an offset, and the offset of the next."""
    values: dict[str, Any] = {}
    for column in properties:
        size: int | None = None
        if column.size_type is not None:
            size = int(whole_numbers(_read(body, column.size_type, 1, offset).astype(np.float64))[0])
            if size < 0:  # numpy would read all that follows
                raise FormatError(f"a list has {size} entries")
            offset += column.size_type.itemsize
        flat = _read(body, column.type, 1 if size is None else size, offset)
        values[column.name] = flat[0] if size is None else flat
        offset += len(flat) * column.type.itemsize
    return values, offset


def _read(body: bytes, kind: np.dtype[Any], count: int, offset: int) -> Any:
    """Values (count,) that begin at an offset."""
    if offset + count * kind.itemsize > len(body):
        raise FormatError("it ends too early")
    return np.frombuffer(body, kind, count, offset) if count else np.zeros(0)
