# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes compressed by Draco, with the package DracoPy."""

from __future__ import annotations

from typing import Any

from zoomout_core.runtime.extras import install_hint
from zoomout_core.runtime.input_files import FormatError

MAGIC = b"DRACO"
TRIANGLE_MESH = 1
SEQUENTIAL = 0
# The flag of a stream that begins with metadata.
HAS_METADATA = 0x8000
# Levels of metadata that are skipped; files have one or two.
MAX_DEPTH = 8


def library() -> Any:
    """The package that compresses and decompresses.

    Raises:
        ImportError: it is not installed.
    """
    try:
        import DracoPy
    except ImportError as error:
        raise ImportError(f"Meshes compressed by Draco need DracoPy: {install_hint('web')}.") from error
    return DracoPy


def decode_draco(content: bytes, triangles: int, vertices: int) -> Any:
    """Decode a mesh, which has its triangles in `faces`, and its data in `get_attribute_by_unique_id`.

    Args:
        content: the stream.
        triangles: the number that its file states. It is compared first, so that a stream cannot demand memory.
        vertices: the number of vertices that its file states.

    Raises:
        FormatError: it is damaged, or has other numbers of elements.
        ImportError: DracoPy is not installed.
    """
    package = library()
    faces, points = _read_sizes(content)
    if faces > triangles or points > vertices:
        raise FormatError(
            f"its Draco data has {faces} triangles and {points} vertices, not {triangles} and {vertices} as it states"
        )
    try:
        found = package.decode(content)
    except Exception as error:  # of several types
        raise FormatError("its Draco data is damaged") from error
    if not hasattr(found, "faces") or len(found.faces) != triangles or len(found.points) != vertices:
        raise FormatError("its Draco data has another number of elements than it states")
    if len(found.faces) and found.faces.max() >= vertices:
        raise FormatError("its Draco data refers to vertices that do not exist")
    return found


def _read_sizes(content: bytes) -> tuple[int, int]:
    """The numbers of triangles, and of different positions, in the head of a stream."""
    reader = _Reader(content)
    if reader.take(len(MAGIC)) != MAGIC:
        raise FormatError("its Draco data is damaged")
    major, minor, kind, method = reader.take(4)
    flags = int.from_bytes(reader.take(2), "little")
    if kind != TRIANGLE_MESH or (major, minor) < (2, 2) or method > 1:
        raise FormatError("its Draco data is of an old version, or no mesh")
    if flags & HAS_METADATA:
        for _ in range(reader.number()):
            reader.number()
            reader.skip_metadata(0)
        reader.skip_metadata(0)
    if method == SEQUENTIAL:
        faces = reader.number()
        return faces, reader.number()
    reader.take(1)
    points = reader.number()
    return reader.number(), points


class _Reader:
    """Reads the head of a stream."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0

    def take(self, count: int) -> bytes:
        """The next bytes."""
        taken = self.content[self.at : self.at + count]
        if len(taken) < count:
            raise FormatError("its Draco data ends too early")
        self.at += count
        return taken

    def number(self) -> int:
        """A number in bytes of seven bits."""
        value = 0
        for shift in range(0, 70, 7):
            byte = self.take(1)[0]
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise FormatError("its Draco data is damaged")

    def skip_metadata(self, depth: int) -> None:
        """Skip names and values, and those of nested metadata."""
        if depth > MAX_DEPTH:
            raise FormatError("its Draco data is nested too deeply")
        for _ in range(self.number()):
            self.take(self.take(1)[0])
            self.take(self.number())
        for _ in range(self.number()):
            self.take(self.take(1)[0])
            self.skip_metadata(depth + 1)
