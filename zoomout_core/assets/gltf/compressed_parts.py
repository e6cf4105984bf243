# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a glTF document that is compressed: its arrays, the views of the new buffer, and rounded attributes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Floats
from zoomout_core.mesh.formats.compression.decompress_gltf import NUMBER_TYPES, WIDTHS

# Bits of positions, relative to the extent, of texture coordinates, and of the coordinates of normals.
POSITION_BITS, UV_BITS, NORMAL_BITS = 16, 16, 12
# Numbers of the glTF specification: component types, buffer targets and a mode of primitives.
SHORT, UNSIGNED_SHORT = 5122, 5123
ARRAY_BUFFER = 34962
TRIANGLES = 4


@dataclass
class CompressedParts:
    """A document, and the buffer that is made for it.

    Attributes:
        tree: its JSON.
        binary: its buffer.
        views: the views that are made.
        content: the buffer that is made.
    """

    tree: dict[str, Any]
    binary: bytes
    views: list[dict[str, Any]] = field(default_factory=list)
    content: bytearray = field(default_factory=bytearray)

    def array(self, number: int) -> NDArray[Any]:
        """(count, width) numbers of an accessor as they are stored."""
        accessor = self.tree["accessors"][number]
        view = self.tree["bufferViews"][accessor["bufferView"]]
        kind, width = np.dtype(NUMBER_TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        stride = view.get("byteStride") or kind.itemsize * width
        start = (view.get("byteOffset") or 0) + (accessor.get("byteOffset") or 0)
        shape = accessor["count"], width
        return np.ndarray(shape, kind, self.binary, start, (stride, kind.itemsize)).copy()

    def is_plain(self, number: int) -> bool:
        """Whether all numbers of an accessor are in its view."""
        accessor = self.tree["accessors"][number]
        return "bufferView" in accessor and "sparse" not in accessor and accessor["type"] in WIDTHS

    def add(self, content: bytes) -> tuple[int, int]:
        """Add bytes to the buffer; returns where they begin, and their number."""
        self.content.extend(bytes(-len(self.content) % 4))
        start = len(self.content)
        self.content.extend(content)
        return start, len(content)

    def copy_view(self, number: int) -> int:
        """Copy a view; returns its new number."""
        view = dict(self.tree["bufferViews"][number])
        start = view.get("byteOffset") or 0
        view["byteOffset"], view["byteLength"] = self.add(self.binary[start : start + view["byteLength"]])
        self.views.append(view)
        return len(self.views) - 1

    def copy_others(self, compressed: set[int]) -> None:
        """Copy the views of images, and of accessors other than those that were compressed."""
        copied: dict[int, int] = {}
        changes = [each["sparse"] for each in self.tree["accessors"] if "sparse" in each]
        sparse = [each[part] for each in changes for part in ("indices", "values")]
        accessors = (each for number, each in enumerate(self.tree["accessors"]) if number not in compressed)
        for each in [*accessors, *sparse, *(self.tree.get("images") or [])]:
            number = each.get("bufferView")
            if number is not None:
                if number not in copied:
                    copied[number] = self.copy_view(number)
                each["bufferView"] = copied[number]

    def finish(self, *extensions: str) -> bytes:
        """Complete the document, which needs extensions; returns its buffer."""
        self.content.extend(bytes(-len(self.content) % 4))
        self.tree["bufferViews"] = self.views
        self.tree["buffers"][0] = {"byteLength": len(self.content)}
        for table in ("extensionsUsed", "extensionsRequired"):
            self.tree[table] = list(dict.fromkeys([*(self.tree.get(table) or []), *extensions]))
        return bytes(self.content)

    def primitives(self) -> Iterator[tuple[dict[str, Any], Floats, float]]:
        """The primitives with triangles, and the lowest corner and the extent of their meshes.

        The primitives of a mesh are rounded alike, so that they still meet.
        """
        accessors = self.tree["accessors"]
        for mesh in self.tree["meshes"]:
            chosen = [each for each in mesh["primitives"] if each.get("mode", TRIANGLES) == TRIANGLES]
            places = [accessors[each["attributes"]["POSITION"]] for each in chosen]
            if not chosen:
                continue
            low, high = np.min([at["min"] for at in places], axis=0), np.max([at["max"] for at in places], axis=0)
            for each in chosen:
                yield each, low, float((high - low).max()) or 1.0


def round_weights(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Weights of vertices in 16 bits, whose sum over all sets is still one."""
    names = sorted(name for name in attributes if name.startswith("WEIGHTS_"))
    if not names or attributes[names[0]].dtype.kind != "f":
        return {}
    limit = np.iinfo(np.uint16).max
    exact = np.hstack([attributes[name] for name in names]).astype(np.float64)
    exact *= limit / np.maximum(exact.sum(axis=1, keepdims=True), 1e-12)
    rounded = np.floor(exact).astype(np.int64)
    # The largest remainders are rounded up, and of a vertex without weights none.
    rank = np.argsort(np.argsort(rounded - exact, axis=1, kind="stable"), axis=1)
    rounded += rank < np.rint(exact.sum(axis=1)).astype(np.int64)[:, None] - rounded.sum(axis=1, keepdims=True)
    return dict(zip(names, np.split(rounded.astype("<u2"), len(names), axis=1), strict=True))


def round_colors(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Colours of vertices in 16 bits."""
    limit = np.iinfo(np.uint16).max
    return {
        name: np.rint(np.clip(values, 0, 1) * limit).astype("<u2")
        for name, values in attributes.items()
        if name.startswith("COLOR_") and values.dtype.kind == "f"
    }


def set_bounds(accessor: dict[str, Any], values: NDArray[Any]) -> None:
    """If an accessor has bounds, set them to those of values (count, width)."""
    if "min" in accessor:
        accessor["min"], accessor["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()
