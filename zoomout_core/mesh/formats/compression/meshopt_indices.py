# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles and sequences of indices in glTF files that are compressed by meshopt, decoded and encoded.

They follow the specification of EXT_meshopt_compression. A triangle names an edge of one of the last triangles, and its
third vertex among the last ones.
"""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.runtime.input_files import FormatError

# The first bytes, without the version.
TRIANGLES, INDICES = 0xE0, 0xD0
# The codes of the two last corners of a triangle without a known edge that take no byte of their own.
CODES = bytes([0x00, 0x76, 0x87, 0x56, 0x67, 0x78, 0xA9, 0x86, 0x65, 0x89, 0x68, 0x98, 0x01, 0x69, 0, 0])
LIST = 16  # edges, and vertices, that a triangle can refer to


def encode_triangles(triangles: Integers) -> bytes:
    """Encode triangles (m, 3); each keeps its winding, but may begin at another corner."""
    codes, data = bytearray(), bytearray()
    edges, vertices = dict[tuple[int, int], int](), dict[int, int]()
    edge_count = vertex_count = following = last = 0

    def write(index: int) -> None:
        nonlocal last
        _write_number(data, index - last)
        last = index

    def add_vertex(vertex: int) -> None:
        nonlocal vertex_count
        vertices[vertex] = vertex_count
        vertex_count += 1

    def age_of(vertex: int) -> int:
        return vertex_count - 1 - vertices[vertex] if vertex in vertices else LIST

    for corners in np.asarray(triangles).tolist():
        a, b, c = corners
        found = min(
            (edge_count - 1 - edges[edge], turn)
            if (edge := (corners[turn], corners[(turn + 1) % 3])) in edges
            else (LIST, turn)
            for turn in range(3)
        )
        if found[0] < LIST - 1:
            turn = found[1]
            a, b, c = corners[turn], corners[(turn + 1) % 3], corners[(turn + 2) % 3]
            age = age_of(c)
            if 1 <= age < 13:
                code = age
            elif c == following:
                code, following = 0, following + 1
            elif abs(c - last) == 1:
                code = 13 if c < last else 14
                last = c
            else:
                code = 15
                write(c)
            codes.append(found[0] << 4 | code)
            if code == 0 or code >= 13:
                add_vertex(c)
        else:
            turn = 1 if b == following else 2 if c == following else 0
            a, b, c = corners[turn], corners[(turn + 1) % 3], corners[(turn + 2) % 3]
            starts_anew = (a, b, c) == (0, 1, 2) and following > 0
            if starts_anew:
                following = 0
                vertices.clear()
            ages = age_of(b), age_of(c)
            of_corner = [15, 15, 15]
            if a == following:
                of_corner[0], following = 0, following + 1
            for number, vertex in ((1, b), (2, c)):
                if ages[number - 1] < 14:
                    of_corner[number] = ages[number - 1] + 1
                elif vertex == following:
                    of_corner[number], following = 0, following + 1
            pair = of_corner[1] << 4 | of_corner[2]
            known = CODES[:14].find(pair)
            if of_corner[0] == 0 and known >= 0 and not starts_anew:
                codes.append(0xF0 | known)
            else:
                codes.append(0xFE | of_corner[0] & 1)
                data.append(pair)
            for own, vertex in zip(of_corner, (a, b, c), strict=True):
                if own == 15:
                    write(vertex)
            for own, vertex in zip(of_corner, (a, b, c), strict=True):
                if own in (0, 15):
                    add_vertex(vertex)
            edges[b, a] = edge_count
            edge_count += 1
        edges[c, b], edges[a, c] = edge_count, edge_count + 1
        edge_count += 2
    return bytes([TRIANGLES | 1]) + bytes(codes) + bytes(data) + CODES


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
    most = 13 if content[0] & 0x0F else 15
    table = content[end:]
    numbers = _Numbers(content, 1 + number, end)
    edges, vertices = [(0, 0)] * LIST, [0] * LIST
    edge_at = vertex_at = following = last = 0
    found: list[int] = []
    for code in content[1 : 1 + number]:
        if code < 0xF0:
            a, b = edges[(edge_at - 1 - (code >> 4)) & 15]
            own = code & 15
            if own == 0:
                c = following
                following += 1
            elif own < most:
                c = vertices[(vertex_at - 1 - own) & 15]
            else:
                c = last = last + (own * 2 - 27 if own < 15 else numbers.read())
            if own == 0 or own >= most:
                vertices[vertex_at] = c
                vertex_at = (vertex_at + 1) & 15
        else:
            if code < 0xFE:
                pair, is_new = table[code & 15], True
            else:
                pair, is_new = numbers.byte(), code == 0xFE
                if pair == 0:
                    following = 0
            first, second = pair >> 4, pair & 15
            a = following
            following += is_new
            b = following if first == 0 else vertices[(vertex_at - first) & 15]
            following += first == 0
            c = following if second == 0 else vertices[(vertex_at - second) & 15]
            following += second == 0
            if not is_new:
                a = last = last + numbers.read()
            if first == 15:
                b = last = last + numbers.read()
            if second == 15:
                c = last = last + numbers.read()
            vertices[vertex_at] = a
            vertex_at = (vertex_at + 1) & 15
            for own, vertex in ((first, b), (second, c)):
                if own in (0, 15):
                    vertices[vertex_at] = vertex
                    vertex_at = (vertex_at + 1) & 15
            edges[edge_at] = b, a
            edge_at = (edge_at + 1) & 15
        edges[edge_at] = c, b
        edges[(edge_at + 1) & 15] = a, c
        edge_at = (edge_at + 2) & 15
        found += (a, b, c)
    if numbers.at != end:
        raise FormatError("its compressed triangles have another size")
    return np.array(found, dtype=np.int64) & 0xFFFFFFFF


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
    """The difference that a number without a sign stands for."""
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
