# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles and sequences of indices in glTF files that are compressed by meshopt, decoded and encoded.

They follow the specification of EXT_meshopt_compression. A triangle names an edge of one of the last triangles, and its
third vertex among the last ones.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.runtime.input_files import FormatError

# The first bytes, without the version.
TRIANGLES, INDICES = 0xE0, 0xD0
# The codes of the two last corners of a triangle without a known edge that take no byte of their own.
CODES = bytes([0x00, 0x76, 0x87, 0x56, 0x67, 0x78, 0xA9, 0x86, 0x65, 0x89, 0x68, 0x98, 0x01, 0x69, 0, 0])
LIST = 16  # edges, and vertices, that a triangle can refer to
# Codes of a vertex that has no age: the lowest one not used yet, neighbours in number of the last one that was written
# as a number, and any other, which is written.
NEXT, BEFORE, AFTER, OTHER = 0, 13, 14, 15


def encode_triangles(triangles: Integers) -> bytes:
    """Encode triangles (m, 3); each keeps its winding, but may begin at another corner."""
    encoder = _TriangleEncoder()
    for corners in np.asarray(triangles).tolist():
        encoder.add(corners)
    return bytes([TRIANGLES | 1]) + bytes(encoder.codes) + bytes(encoder.data) + CODES


class _Ages:
    """How many items were added after the latest equal one."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all items."""
        self._numbers, self._count = dict[Any, int](), 0

    def add(self, item: Any) -> None:
        """Add an item, whose age is 0."""
        self._numbers[item] = self._count
        self._count += 1

    def of(self, item: Any) -> int:
        """The age of an item; `LIST` if it was not added."""
        return self._count - 1 - self._numbers[item] if item in self._numbers else LIST


class _TriangleEncoder:
    """Triangles as codes of one byte, and data of those that need more.

    A code has four bits for the known edge, and four for the third vertex: its age, `NEXT` or `OTHER`.
    """

    def __init__(self) -> None:
        self.codes, self.data = bytearray(), bytearray()
        self._edges, self._vertices = _Ages(), _Ages()
        self._next = self._last = 0  # the lowest vertex not used yet; the latest vertex that was written as a number

    def add(self, corners: list[int]) -> None:
        """Add a triangle."""
        age, turn = min((self._edges.of((corners[turn], corners[(turn + 1) % 3])), turn) for turn in range(3))
        if age < LIST - 1:
            a, b, c = _rotate(corners, turn)
            self._attach(age, c)
        else:
            a, b, c = self._begin(corners)
            self._edges.add((b, a))
        self._edges.add((c, b))
        self._edges.add((a, c))

    def _attach(self, edge_age: int, vertex: int) -> None:
        """Encode a triangle by an edge of earlier ones and its third vertex."""
        age = self._vertices.of(vertex)
        if 1 <= age < BEFORE:
            code = age
        elif self._takes_next(vertex):
            code = NEXT
        elif abs(vertex - self._last) == 1:
            code = BEFORE if vertex < self._last else AFTER
            self._last = vertex
        else:
            code = OTHER
            self._write(vertex)
        self.codes.append(edge_age << 4 | code)
        if code == NEXT or code >= BEFORE:
            self._vertices.add(vertex)

    def _begin(self, corners: list[int]) -> tuple[int, int, int]:
        """Encode a triangle without a known edge; returns its corners in the order of the code."""
        a, b, c = _rotate(corners, 1 if corners[1] == self._next else 2 if corners[2] == self._next else 0)
        restarts = (a, b, c) == (0, 1, 2) and self._next > 0
        if restarts:
            self._next = 0
            self._vertices.clear()
        ages = self._vertices.of(b), self._vertices.of(c)
        first = NEXT if self._takes_next(a) else OTHER
        second, third = (
            age + 1 if age < OTHER - 1 else NEXT if self._takes_next(vertex) else OTHER
            for age, vertex in zip(ages, (b, c), strict=True)
        )
        pair = second << 4 | third
        known = CODES[:14].find(pair)
        if first == NEXT and known >= 0 and not restarts:
            self.codes.append(0xF0 | known)
        else:
            self.codes.append(0xFE | first & 1)
            self.data.append(pair)
        coded = ((first, a), (second, b), (third, c))
        for code, vertex in coded:
            if code == OTHER:
                self._write(vertex)
        for code, vertex in coded:
            if code in (NEXT, OTHER):
                self._vertices.add(vertex)
        return a, b, c

    def _takes_next(self, vertex: int) -> bool:
        """Use a vertex if it is the lowest one not used yet; returns whether it is."""
        found = vertex == self._next
        self._next += found
        return found

    def _write(self, vertex: int) -> None:
        """Write a vertex as its difference from the latest one written."""
        _write_number(self.data, vertex - self._last)
        self._last = vertex


def _rotate(corners: list[int], turn: int) -> tuple[int, int, int]:
    return corners[turn], corners[(turn + 1) % 3], corners[(turn + 2) % 3]


def _write_number(data: bytearray, difference: int) -> None:
    """Add a difference of 32 bits in bytes of seven bits."""
    difference = (difference + (1 << 31)) % (1 << 32) - (1 << 31)
    value = (difference << 1 ^ difference >> 31) & 0xFFFFFFFF
    while value > 127:
        data.append(value & 127 | 128)
        value >>= 7
    data.append(value)


def decode_triangles(content: bytes, count: int) -> Integers:
    """Decode (count,) corners of triangles.

    Raises:
        FormatError: the stream is damaged.
    """
    number, end = count // 3, len(content) - len(CODES)
    if end < 1 + number or content[0] & 0xF0 != TRIANGLES or content[0] & 0x0F > 1:
        raise FormatError("its compressed triangles have another format")
    oldest = BEFORE if content[0] & 0x0F else OTHER  # version 0 has no neighbours of the last vertex
    state = _Decoded(_Numbers(content, 1 + number, end), content[end:])
    edges, vertices = state.edges, state.vertices
    found: list[int] = []
    for code in content[1 : 1 + number]:
        if code < 0xF0:
            (a, b), own = edges[code >> 4], code & 15
            if own == NEXT:
                c = state.take_next()
            elif own < oldest:
                c = vertices[own]
            else:
                c = state.read() if own == OTHER else state.step(-1 if own == BEFORE else 1)
            if own == NEXT or own >= oldest:
                vertices.appendleft(c)
        else:
            a, b, c = _begin(code, state)
            edges.appendleft((b, a))
        edges.appendleft((c, b))
        edges.appendleft((a, c))
        found += (a, b, c)
    if state.numbers.at != end:
        raise FormatError("its compressed triangles have another size")
    return np.array(found, dtype=np.int64) & 0xFFFFFFFF


class _Decoded:
    """The state of a decoder of triangles.

    Args:
        numbers: the data of codes that need more.
        table: the codes of the two last corners of triangles without a known edge, as `CODES`.
    """

    def __init__(self, numbers: _Numbers, table: bytes) -> None:
        self.numbers, self.table = numbers, table
        # By age, the latest first.
        self.edges, self.vertices = deque([(0, 0)] * LIST, LIST), deque([0] * LIST, LIST)
        self.next = self._last = 0  # the lowest vertex not used yet; the latest vertex that was read as a number

    def take_next(self) -> int:
        """The lowest vertex not used yet, which is used by this."""
        self.next += 1
        return self.next - 1

    def read(self) -> int:
        """A vertex from the data."""
        return self.step(self.numbers.read())

    def step(self, difference: int) -> int:
        """A vertex from its difference to the latest one that was read."""
        self._last += difference
        return self._last


def _begin(code: int, state: _Decoded) -> tuple[int, int, int]:
    """Decode a triangle without a known edge."""
    pair = state.table[code & 15] if code < 0xFE else state.numbers.byte()
    if code >= 0xFE and pair == 0:
        state.next = 0
    second, third, vertices = pair >> 4, pair & 15, state.vertices
    # Numbers follow the codes: vertices in order, or of some age, come before any number is read.
    a = 0 if code == 0xFF else state.take_next()
    b = state.take_next() if second == NEXT else vertices[second - 1]
    c = state.take_next() if third == NEXT else vertices[third - 1]
    if code == 0xFF:
        a = state.read()
    if second == OTHER:
        b = state.read()
    if third == OTHER:
        c = state.read()
    vertices.appendleft(a)
    if second in (NEXT, OTHER):
        vertices.appendleft(b)
    if third in (NEXT, OTHER):
        vertices.appendleft(c)
    return a, b, c


def decode_indices(content: bytes, count: int) -> Integers:
    """Decode a sequence of (count,) indices.

    Raises:
        FormatError: the stream is damaged.
    """
    end = len(content) - 4
    if end < 1 + count or content[0] & 0xF0 != INDICES or content[0] & 0x0F > 1:
        raise FormatError("its compressed indices have another format")
    numbers, last, found = _Numbers(content, 1, end), [0, 0], []
    for _ in range(count):
        value = numbers.value()
        last[value & 1] += _sign(value >> 1)
        found.append(last[value & 1])
    if numbers.at != end:
        raise FormatError("its compressed indices have another size")
    return np.array(found, dtype=np.int64) & 0xFFFFFFFF


def _sign(value: int) -> int:
    """Decode a signed difference from an unsigned number."""
    return value >> 1 ^ -(value & 1)


class _Numbers:
    """Numbers in bytes of seven bits, read one after the other."""

    def __init__(self, content: bytes, at: int, end: int) -> None:
        self.content, self.at, self.end = content, at, end

    def byte(self) -> int:
        """The next byte."""
        if self.at >= self.end:
            raise FormatError("its compressed indices end too early")
        self.at += 1
        return self.content[self.at - 1]

    def value(self) -> int:
        """The next number, which has 32 bits."""
        value = shift = 0
        while shift < 35:
            byte = self.byte()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        return value & 0xFFFFFFFF

    def read(self) -> int:
        """The next difference."""
        return _sign(self.value())
