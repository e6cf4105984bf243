# SPDX-License-Identifier: GPL-3.0-or-later
"""Compress the meshes of glTF files by Draco or meshopt, as the web ships them.

Both round numbers. Positions and morph targets are exact to 2^-17 of the mesh's extent, texture coordinates to 2^-17,
normals to a tenth of a degree. Weights and colours have 16 bits. Joints, indices, animations and stored maps are not
rounded.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.formats.compression.decompress_gltf import DRACO, MESHOPT, NUMBER_TYPES, UNSIGNED_INTS, WIDTHS
from zoomout_core.mesh.formats.compression.draco import library
from zoomout_core.mesh.formats.compression.meshopt_attributes import Bytes, encode_attributes
from zoomout_core.mesh.formats.compression.meshopt_filters import decode_filter, encode_exponential, encode_octahedral
from zoomout_core.mesh.formats.compression.meshopt_indices import encode_triangles
from zoomout_core.mesh.formats.glb import MAGIC, pack_glb
from zoomout_core.mesh.formats.gltf_files import data_of, parse_gltf

METHODS = ("draco", "meshopt")
MESHOPT_NAME, QUANTIZED = MESHOPT[0], "KHR_mesh_quantization"
# Bits of positions, relative to the extent, of texture coordinates, and of the coordinates of normals.
POSITION_BITS, UV_BITS, NORMAL_BITS = 16, 16, 12
# Draco's level of compression; 10 takes more time for a few bytes.
LEVEL = 7
SHORT, UNSIGNED_SHORT, FLOAT = 5122, 5123, 5126
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
TRIANGLES = 4
# Numbers of Draco's attributes that have no type of their own there begin here, after those that it gives itself.
FIRST_OTHER = 16


def compress_gltf(path: Path, method: str) -> None:
    """Compress a glTF or GLB file in its place.

    Args:
        path: a file whose accessors each have a view of their own, as `write_gltf` writes it.
        method: one of `METHODS`.

    Raises:
        ImportError: DracoPy is not installed, and the method needs it.
    """
    content = path.read_bytes()
    tree, binary = parse_gltf(content)
    if not tree.get("meshes"):
        return
    uri = tree["buffers"][0].get("uri")
    beside = uri is not None and not uri.startswith("data:")
    if uri is not None:
        binary = path.with_name(unquote(uri)).read_bytes() if beside else data_of(uri)
    made = (_compress_by_draco if method == "draco" else _compress_by_meshopt)(_Parts(tree, binary))
    if content.startswith(MAGIC):
        path.write_bytes(pack_glb(tree, made))
        return
    if beside:
        path.with_name(unquote(uri)).write_bytes(made)
    else:
        uri = "data:application/octet-stream;base64," + b64encode(made).decode()
    tree["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(tree), encoding="utf-8")


@dataclass
class _Parts:
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


def _round_weights(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Weights of vertices in 16 bits, whose sum over all sets is still one."""
    names = sorted(name for name in attributes if name.startswith("WEIGHTS_"))
    if not names or attributes[names[0]].dtype.kind != "f":
        return {}
    most = np.iinfo(np.uint16).max
    exact = np.hstack([attributes[name] for name in names]).astype(np.float64)
    exact *= most / np.maximum(exact.sum(axis=1, keepdims=True), 1e-12)
    rounded = np.floor(exact).astype(np.int64)
    # The largest remainders are rounded up, and of a vertex without weights none.
    rank = np.argsort(np.argsort(rounded - exact, axis=1, kind="stable"), axis=1)
    rounded += rank < np.rint(exact.sum(axis=1)).astype(np.int64)[:, None] - rounded.sum(axis=1, keepdims=True)
    return dict(zip(names, np.split(rounded.astype("<u2"), len(names), axis=1), strict=True))


def _round_colors(attributes: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Colours of vertices in 16 bits."""
    most = np.iinfo(np.uint16).max
    return {
        name: np.rint(np.clip(values, 0, 1) * most).astype("<u2")
        for name, values in attributes.items()
        if name.startswith("COLOR_") and values.dtype.kind == "f"
    }


def _set_bounds(accessor: dict[str, Any], values: NDArray[Any]) -> None:
    """If an accessor has bounds, set them to those of values (count, width)."""
    if "min" in accessor:
        accessor["min"], accessor["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()


# --- meshopt ------------------------------------------------------------------------------------------------


def _compress_by_meshopt(parts: _Parts) -> bytes:
    writer = _MeshoptWriter(parts)
    for primitive, _, extent in parts.primitives():
        writer.add_primitive(primitive, extent * 2.0**-POSITION_BITS)
    for number in range(len(parts.tree["accessors"])):  # of animations and skins, without loss
        if writer.waits(number):
            writer.add(number, _rows_of_four(parts.array(number)))
    return writer.finish()


class _MeshoptWriter:
    """Compresses accessors one by one, each into a view of its own."""

    def __init__(self, parts: _Parts) -> None:
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
        rounded = _round_weights(attributes) | _round_colors(attributes)
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
        _set_bounds(self.accessors[number], decode_filter(stored, "EXPONENTIAL").view("<f4"))
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


# --- Draco --------------------------------------------------------------------------------------------------


def _compress_by_draco(parts: _Parts) -> bytes:
    package, tree, done = library(), parts.tree, set[int]()
    # A mesh without indices, or one that shares its data with another one, stays as it is.
    primitives = [each for each, *_ in parts.primitives()]
    uses = Counter(number for each in primitives for number in (*each["attributes"].values(), each.get("indices")))
    for primitive, origin, extent in parts.primitives():
        numbers = [*primitive["attributes"].values(), primitive.get("indices")]
        if None in numbers or any(uses[number] > 1 or not parts.is_plain(number) for number in numbers):
            continue
        attributes = {name: parts.array(at) for name, at in primitive["attributes"].items()}
        rounded = _round_weights(attributes) | _round_colors(attributes)
        grid = {"quantization_origin": origin.tolist(), "quantization_range": extent}
        triangles = parts.array(primitive["indices"]).reshape(-1, 3).astype("<u4")
        found = _encode_mesh(package, attributes | rounded, triangles, grid, bool(primitive.get("targets")))
        if found is None:
            continue
        content, ids, mesh = found
        start, length = parts.add(content)
        parts.views.append({"buffer": 0, "byteOffset": start, "byteLength": length})
        about = {"bufferView": len(parts.views) - 1, "attributes": ids}
        primitive.setdefault("extensions", {})[DRACO] = about
        for name, number in (*primitive["attributes"].items(), ("", primitive["indices"])):
            accessor = tree["accessors"][number]
            for key in ("bufferView", "byteOffset"):
                accessor.pop(key, None)
            accessor["count"] = len(mesh.points) if name else 3 * len(mesh.faces)
            if name in rounded:
                accessor |= {"componentType": UNSIGNED_SHORT, "normalized": True}
            done.add(number)
        tree["accessors"][primitive["indices"]]["componentType"] = UNSIGNED_INTS
        _set_bounds(tree["accessors"][primitive["attributes"]["POSITION"]], np.asarray(mesh.points, "<f4"))
    parts.copy_others(done)
    return parts.finish(*([DRACO] if done else []))


def _encode_mesh(
    package: Any,
    attributes: dict[str, NDArray[Any]],
    triangles: Integers,
    grid: dict[str, Any],
    keeps_order: bool,
) -> tuple[bytes, dict[str, int], Any] | None:
    """Encode a mesh; returns the stream, its number of each attribute, and the mesh as it is decoded.

    Morph targets are not part of the stream, so with them the order of the vertices must stay. Returns None if the
    stream cannot be decoded, as it happens with few vertices.
    """
    own: dict[str, Floats] = {
        name: np.asarray(attributes[name], dtype=np.float64) for name in ("NORMAL", "TEXCOORD_0") if name in attributes
    }
    others = [name for name in attributes if name not in (*own, "POSITION")]
    ids = {name: FIRST_OTHER + number for number, name in enumerate(others)}
    try:
        content = package.encode(
            np.asarray(attributes["POSITION"], "<f4"),
            triangles,
            quantization_bits=POSITION_BITS,
            compression_level=LEVEL,
            preserve_order=keeps_order,
            **grid,
            normals=own.get("NORMAL"),
            tex_coord=own.get("TEXCOORD_0"),
            normal_quantization_bits=NORMAL_BITS,
            tex_coord_quantization_bits=UV_BITS,
            generic_attributes={ids[name]: np.ascontiguousarray(attributes[name]) for name in others} or None,
        )
        mesh = package.decode(content)
    except Exception:  # of several types
        return None
    by_type = {each["attribute_type"]: each["unique_id"] for each in mesh.attributes}
    kinds = package.AttributeType
    ids |= {"POSITION": by_type[kinds.POSITION]}
    if "NORMAL" in own:
        ids["NORMAL"] = by_type[kinds.NORMAL]
    if "TEXCOORD_0" in own:
        ids["TEXCOORD_0"] = by_type[kinds.TEX_COORD]
    if keeps_order and (len(mesh.points) != len(attributes["POSITION"]) or not np.array_equal(mesh.faces, triangles)):
        return None
    return content, ids, mesh
