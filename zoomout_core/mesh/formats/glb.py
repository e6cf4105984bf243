# SPDX-License-Identifier: GPL-3.0-or-later
"""GLB files: the JSON and the binary data of a glTF document in one file."""

from __future__ import annotations

import json
from typing import Any

from zoomout_core.runtime.input_files import FormatError

MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
VERSION = 2


def pack_glb(tree: dict[str, Any], binary: bytes) -> bytes:
    """The content of a GLB file."""
    text = json.dumps(tree, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    body = b"".join(
        len(chunk).to_bytes(4, "little") + name + chunk for name, chunk in ((JSON_CHUNK, text), (BINARY_CHUNK, binary))
    )
    return b"".join([MAGIC, VERSION.to_bytes(4, "little"), (12 + len(body)).to_bytes(4, "little"), body])


def unpack_glb(content: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary data of a GLB file.

    Raises:
        FormatError: it is damaged, or has another version.
    """
    version, length = (int.from_bytes(content[at : at + 4], "little") for at in (4, 8))
    if version != VERSION:
        raise FormatError(f"its version is {version}, not {VERSION}")
    chunks, at = dict[bytes, bytes](), 12
    while at + 8 <= length:
        size = int.from_bytes(content[at : at + 4], "little")
        chunks.setdefault(content[at + 4 : at + 8], content[at + 8 : at + 8 + size])
        at += 8 + size
    if max(at, length) > len(content):
        raise FormatError("it ends too early")
    if JSON_CHUNK not in chunks:
        raise FormatError("it has no JSON")
    return chunks[JSON_CHUNK], chunks.get(BINARY_CHUNK, b"")
