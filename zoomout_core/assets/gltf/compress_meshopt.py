# SPDX-License-Identifier: GPL-3.0-or-later
"""Compression of glTF documents by meshoptimizer's codecs (EXT_meshopt_compression)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.assets.gltf.compressed_parts import (
    ARRAY_BUFFER,
    NORMAL_BITS,
    POSITION_BITS,
    SHORT,
    UNSIGNED_SHORT,
    UV_BITS,
    CompressedParts,
    round_colors,
    round_weights,
    set_bounds,
)
from zoomout_core.mesh.formats.compression.decompress_gltf import MESHOPT, UNSIGNED_INTS
from zoomout_core.mesh.formats.compression.meshopt_attributes import Bytes, encode_attributes
from zoomout_core.mesh.formats.compression.meshopt_filters import decode_filter, encode_exponential, encode_octahedral
from zoomout_core.mesh.formats.compression.meshopt_indices import encode_triangles

MESHOPT_NAME, QUANTIZED = MESHOPT[0], "KHR_mesh_quantization"


def compress_by_meshopt(parts: CompressedParts) -> bytes:
    """Compress the accessors of a document; returns its new buffer."""
    writer = _MeshoptWriter(parts)
    for primitive, _, extent in parts.primitives():
        writer.add_primitive(primitive, extent * 2.0**-POSITION_BITS)
    for number in range(len(parts.tree["accessors"])):  # of animations and skins, without loss
        if writer.waits(number):
            writer.add(number, _rows_of_four(parts.array(number)))
    return writer.finish()


class _MeshoptWriter:
    """Compresses accessors one by one, each into a view of its own."""

    def __init__(self, parts: CompressedParts) -> None:
        self.parts = parts
        self.accessors: list[dict[str, Any]] = parts.tree["accessors"]
        self.done: set[int] = set()  # numbers of the compressed accessors
        self.expanded = 0  # bytes of the buffer that readers without the extension would need
        self.is_quantized = False

    def waits(self, number: int) -> bool:
        """Whether an accessor can be compressed, and is not yet."""
        return number not in self.done and self.parts.is_plain(number)

    def add_primitive(self, primitive: dict[str, Any], step: float) -> None:
        """Compress the accessors of a primitive, whose positions are rounded to multiples of a step."""
        numbers = {name: at for name, at in primitive["attributes"].items() if self.waits(at)}
        attributes = {name: self.parts.array(at) for name, at in numbers.items()}
        rounded = round_weights(attributes) | round_colors(attributes)
        for name, number in numbers.items():
            if name == "POSITION" or name.startswith("TEXCOORD_"):
                self._add_rounded(number, step if name == "POSITION" else 2.0**-UV_BITS)
            elif name == "NORMAL":
                self.accessors[number] |= {"componentType": SHORT, "normalized": True}
                self.is_quantized = True
                self.add(number, encode_octahedral(attributes[name], NORMAL_BITS), "OCTAHEDRAL")
            elif name in rounded:
                self.accessors[number] |= {"componentType": UNSIGNED_SHORT, "normalized": True}
                self.add(number, rounded[name].view(np.uint8))
            else:
                self.add(number, _rows_of_four(attributes[name]))
        for target in primitive.get("targets") or []:
            for name, number in target.items():
                if self.waits(number):
                    self._add_rounded(number, step if name == "POSITION" else 2.0**-NORMAL_BITS)
        if (indices := primitive.get("indices")) is not None and self.waits(indices):
            corners = self.parts.array(indices).astype("<u4")
            self.accessors[indices]["componentType"] = UNSIGNED_INTS
            self._add_view(indices, "TRIANGLES", encode_triangles(corners.reshape(-1, 3)), (len(corners), 4))

    def add(self, number: int, stored: Bytes, filter_: str = "NONE") -> None:
        """Compress the elements (count, stride) of an accessor, which a filter has encoded."""
        count, stride = stored.shape
        self._add_view(number, "ATTRIBUTES", encode_attributes(stored), (count, stride), filter_)

    def finish(self) -> bytes:
        """Complete the document; returns its buffer."""
        self.parts.copy_others(self.done)
        made = self.parts.finish(MESHOPT_NAME, *([QUANTIZED] if self.is_quantized else []))
        fallback = {"byteLength": self.expanded, "extensions": {MESHOPT_NAME: {"fallback": True}}}
        self.parts.tree["buffers"][1:] = [fallback]
        return made

    def _add_rounded(self, number: int, step: float) -> None:
        """Compress floating-point numbers as multiples of a step."""
        stored = encode_exponential(self.parts.array(number), step)
        set_bounds(self.accessors[number], decode_filter(stored, "EXPONENTIAL").view("<f4"))
        self.add(number, stored, "EXPONENTIAL")

    def _add_view(self, number: int, mode: str, content: bytes, shape: tuple[int, int], filter_: str = "NONE") -> None:
        """Give an accessor a view of compressed content, which expands to `shape`, elements and bytes of each."""
        self.done.add(number)
        count, stride = shape
        start, length = self.parts.add(content)
        about: dict[str, Any] = {"buffer": 0, "byteOffset": start, "byteLength": length}
        about |= {"byteStride": stride, "count": count, "mode": mode}
        about |= {} if filter_ == "NONE" else {"filter": filter_}
        before = self.parts.tree["bufferViews"][self.accessors[number]["bufferView"]]
        view: dict[str, Any] = {"buffer": 1, "byteOffset": self.expanded, "byteLength": count * stride}
        if "target" in before:
            view["target"] = before["target"]
        if before.get("target") == ARRAY_BUFFER:
            view["byteStride"] = stride
        self.parts.views.append(view | {"extensions": {MESHOPT_NAME: about}})
        self.accessors[number] |= {"bufferView": len(self.parts.views) - 1, "byteOffset": 0}
        self.expanded += -(-count * stride // 4) * 4


def _rows_of_four(values: NDArray[Any]) -> Bytes:
    """The bytes of elements (count, width), with zeros up to a multiple of four."""
    rows = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    return np.hstack([rows, np.zeros((len(rows), -rows.shape[1] % 4), np.uint8)])
