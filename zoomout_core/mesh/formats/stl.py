# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an STL file is complete: trimesh reads an incomplete one as an empty one."""

from __future__ import annotations

from zoomout_core.runtime.input_files import FormatError

# Bytes of a binary file before the triangles, of which the last four are their number, and of each triangle.
HEAD, TRIANGLE = 84, 50


def stated_size(head: bytes) -> int:
    """The size of a binary file by the number of triangles in its first 84 bytes; 0 for a text file."""
    in_words = head.lstrip()[:5].lower() == b"solid" and b"\0" not in head
    return 0 if in_words or len(head) < HEAD else HEAD + TRIANGLE * int.from_bytes(head[HEAD - 4 : HEAD], "little")


def complete_stl(content: bytes) -> bytes:
    """The content of a file without what some programs append to a binary one.

    Raises:
        FormatError: it ends too early, or has no triangles.
    """
    size = stated_size(content[:HEAD])
    if not size:
        if b"endsolid" not in content.lower():
            raise FormatError("it ends too early")
        return content
    if size == HEAD:
        raise FormatError("it declares no triangles")
    if len(content) < size:
        raise FormatError(f"it ends after {len(content)} of {size} bytes")
    return content[:size]
