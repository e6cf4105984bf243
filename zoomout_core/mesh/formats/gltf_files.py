# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF and GLB files: their checked JSON and the contents of their buffers."""

from __future__ import annotations

import json
import math
from base64 import b64decode
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.compression.decompress_gltf import decompress_gltf
from zoomout_core.mesh.formats.glb import MAGIC, unpack_glb
from zoomout_core.mesh.formats.gltf_structure import check_structure, check_views, values_at
from zoomout_core.mesh.formats.opening import file_bytes, outside, shown
from zoomout_core.runtime.input_files import FormatError, OutsideError, beside, read_whole, reason_of


@dataclass(frozen=True, eq=False)
class GltfFile:
    """A checked file.

    Attributes:
        tree: its JSON.
        buffers: the content of its buffers.
        path: its path.
        folders: further folders in which its buffers and images may be.
    """

    tree: dict[str, Any]
    buffers: tuple[bytes, ...]
    path: Path
    folders: tuple[Path, ...] = ()

    def read_uri(self, uri: str) -> bytes:
        """The bytes of a URI: embedded data, or a file beside this one.

        Raises:
            OutsideError: the file is outside the folders.
            OSError: the file is missing or cannot be read.
            ValueError: the embedded data is damaged.
        """
        if uri.startswith("data:"):
            return data_of(uri)
        return read_whole(beside(unquote(uri), self.path.parent, self.folders))


def read_gltf_file(path: Path, folders: Iterable[Path] = ()) -> GltfFile:
    """Read a glTF or GLB file.

    Args:
        path: the file.
        folders: further folders in which its buffers and images may be.

    Raises:
        MeshError: it cannot be opened, it contradicts the specification, or a buffer cannot be read.
        ImportError: a package that decompresses it is not installed.
    """
    try:
        tree, binary = parse_gltf(file_bytes(path))
    except MeshError:
        raise
    except ValueError as error:
        raise _damage_error(path, error) from error
    file = GltfFile(tree, (), path, tuple(folders))
    buffers = _buffers(file, binary)
    try:
        buffers = decompress_gltf(tree, buffers)
        check_views(tree, buffers)
    except FormatError as error:
        raise _damage_error(path, error) from error
    return GltfFile(tree, buffers, path, file.folders)


def parse_gltf(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The checked JSON of a glTF or GLB file, and the binary data of a GLB file.

    Raises:
        ValueError: it is damaged, or contradicts the specification.
    """
    text, binary = unpack_glb(content) if content.startswith(MAGIC) else (content, b"")
    try:
        tree = json.loads(
            text.decode("utf-8-sig"), object_hook=_without_nulls, parse_constant=_finite, parse_float=_finite
        )
    except RecursionError:
        raise FormatError("it is nested too deeply") from None
    except UnicodeDecodeError:
        raise FormatError("its JSON is not UTF-8 text") from None
    except json.JSONDecodeError as error:
        raise FormatError(f"its JSON is damaged in line {error.lineno}, column {error.colno}") from None
    check_structure(tree, len(content))
    return tree, binary


def _without_nulls(part: dict[str, Any]) -> dict[str, Any]:
    """A JSON object without its null values, which mean missing ones."""
    return {name: value for name, value in part.items() if value is not None}


def _finite(text: str) -> float:
    """A number of JSON, which has no infinite ones."""
    value = float(text)
    if not math.isfinite(value):
        raise FormatError(f"it contains the number {text}")
    return value


def data_of(uri: str) -> bytes:
    """The bytes that a data URI contains.

    Raises:
        ValueError: they are damaged.
    """
    head, _, data = uri.partition(",")
    if not head.endswith(";base64"):
        return unquote_to_bytes(data)
    try:
        return b64decode(data)
    except ValueError as error:  # also of characters beyond ASCII
        raise FormatError("its embedded data is damaged") from error


def named_uris(tree: Any, tables: Iterable[str] = ("buffers", "images")) -> list[str]:
    """The names of the files to which the JSON of a glTF file refers."""
    return [uri for table in tables for uri in values_at(tree, f"{table}[].uri") if not uri.startswith("data:")]


def _buffers(file: GltfFile, binary: bytes) -> tuple[bytes, ...]:
    """The content of all buffers; one that several entries name is read once."""
    read: dict[str, bytes] = {}
    for uri in dict.fromkeys(values_at(file.tree, "buffers[].uri")):
        try:
            read[uri] = file.read_uri(uri)
        except OutsideError as error:
            raise outside(file.path, uri) from error
        except OSError as error:
            raise MeshError(
                "{path} refers to {name}, which could not be opened ({reason}): put it beside the file.",
                path=file.path,
                name=shown(uri),
                reason=error.strerror,
            ) from error
        except ValueError as error:
            raise _damage_error(file.path, error) from error
    return tuple(read.get(each.get("uri"), binary) for each in file.tree.get("buffers") or [])


def _damage_error(path: Path, error: ValueError) -> MeshError:
    reason = reason_of(error)
    return MeshError(f"{path} could not be read ({reason}): check that the file is complete, or export it again.")
