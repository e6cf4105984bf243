# SPDX-License-Identifier: GPL-3.0-or-later
"""Decompress glTF documents: meshes by Draco, and views of buffers by meshopt.

The result is a document without these extensions, so that all else reads it like any other file.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

import numpy as np

from zoomout_core.mesh.formats.compression.draco import decode_draco
from zoomout_core.mesh.formats.compression.meshopt_attributes import decode_attributes
from zoomout_core.mesh.formats.compression.meshopt_filters import STRIDES, decode_filter
from zoomout_core.mesh.formats.compression.meshopt_indices import decode_indices, decode_triangles
from zoomout_core.runtime.input_files import ExpansionError, FormatError, max_bytes

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
# Strides of elements, in bytes.
MAX_STRIDE, INDEX_STRIDES = 256, (2, 4)
# glTF's codes of indices, and of triangles.
UNSIGNED_INTS, TRIANGLES = 5125, 4
# The types of numbers by glTF's codes, and the numbers in the types of elements; smaller matrices have gaps.
NUMBER_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def decompress_gltf(tree: dict[str, Any], buffers: Sequence[bytes]) -> tuple[bytes, ...]:
    """Decompress a document in place; returns its buffers.

    If the document also has the uncompressed data, that is used instead.

    Args:
        tree: its JSON, which was checked.
        buffers: the content of its buffers.

    Raises:
        FormatError: the compressed data is damaged, or would expand too far.
        ImportError: DracoPy is not installed, and the document needs it.
    """
    used = {DRACO, *MESHOPT} & {*(tree.get("extensionsUsed") or []), *(tree.get("extensionsRequired") or [])}
    needed = used & set(tree.get("extensionsRequired") or [])
    if not used:
        return tuple(buffers)
    _check_expansion(tree, sum(map(len, buffers)))
    made = list(buffers)
    _decompress_views(tree, needed, made)
    _decompress_primitives(tree, needed, made)
    for key in ("extensionsUsed", "extensionsRequired"):
        if key in tree:
            tree[key] = [name for name in tree[key] if name not in used]
    return tuple(made)


def _check_expansion(tree: dict[str, Any], packed: int) -> None:
    """Check that the stated sizes of the views are not much larger than the buffers."""
    sizes = [
        about["count"] * about["byteStride"]
        for view in tree.get("bufferViews") or []
        for name, about in (view.get("extensions") or {}).items()
        if name in MESHOPT
    ]
    size, most = sum(sizes), max_bytes(packed)
    if size > most:
        raise ExpansionError(f"it would expand to {size} bytes, and {most} are allowed for its size")


def _slice(buffers: Sequence[bytes], number: int, start: int, length: int) -> bytes:
    content = buffers[number][start : start + length]
    if len(content) < length:
        raise FormatError("its compressed data ends after its buffer")
    return content


# --- meshopt ------------------------------------------------------------------------------------------------


def _decompress_views(tree: dict[str, Any], needed: Container[str], buffers: list[bytes]) -> None:
    """Remove the extensions of meshopt, and decode views without other data into buffers of their own."""
    for view in tree.get("bufferViews") or []:
        extensions = view.get("extensions") or {}
        for name in (each for each in MESHOPT if each in extensions):
            about = extensions.pop(name)
            if name in needed:
                buffers.append(_decode_view(about, view["byteLength"], buffers))
                view["buffer"], view["byteOffset"] = len(buffers) - 1, 0
    for each in tree.get("buffers") or []:
        for name in MESHOPT:
            (each.get("extensions") or {}).pop(name, None)


def _decode_view(about: dict[str, Any], length: int, buffers: Sequence[bytes]) -> bytes:
    """The bytes of a view."""
    count, stride, mode = about["count"], about["byteStride"], about["mode"]
    name = about.get("filter") or "NONE"
    strides = STRIDES[name]
    if mode == "ATTRIBUTES":
        fits = 0 < stride <= MAX_STRIDE and stride % 4 == 0 and (strides is None or stride in strides)
    else:
        fits = stride in INDEX_STRIDES and name == "NONE" and (mode == "INDICES" or count % 3 == 0)
    if not fits or count * stride != length:
        raise FormatError("its compressed views have sizes that contradict each other")
    content = _slice(buffers, about["buffer"], about.get("byteOffset") or 0, about["byteLength"])
    if mode == "ATTRIBUTES":
        with np.errstate(all="ignore"):  # the content of a damaged file is any bytes
            return decode_filter(decode_attributes(content, count, stride), name).tobytes()
    indices = (decode_triangles if mode == "TRIANGLES" else decode_indices)(content, count)
    if count and indices.max() >> 8 * stride:
        raise FormatError("its compressed indices are too large for their type")
    return indices.astype(f"<u{stride}").tobytes()


# --- Draco --------------------------------------------------------------------------------------------------


def _decompress_primitives(tree: dict[str, Any], needed: Container[str], buffers: list[bytes]) -> None:
    """Remove the extension of Draco, and decode meshes without other data into buffers of their own."""
    decoded: dict[int, Any] = {}
    for mesh in tree.get("meshes") or []:
        for primitive in mesh["primitives"]:
            about = (primitive.get("extensions") or {}).pop(DRACO, None)
            if about is not None and DRACO in needed:
                _decode_primitive(tree, primitive, about, buffers, decoded)


def _decode_primitive(
    tree: dict[str, Any],
    primitive: dict[str, Any],
    about: dict[str, Any],
    buffers: list[bytes],
    decoded: dict[int, Any],
) -> None:
    """Decode the mesh of a primitive into buffers of its own."""
    accessors, number = tree["accessors"], about["bufferView"]
    named = {name: primitive["attributes"].get(name) for name in about["attributes"]}
    place, indices = primitive["attributes"].get("POSITION"), primitive.get("indices")
    if place is None or indices is None or None in named.values():
        raise FormatError("its Draco data has attributes that its meshes lack")
    if number not in decoded:
        view = tree["bufferViews"][number]
        content = _slice(buffers, view["buffer"], view.get("byteOffset") or 0, view["byteLength"])
        triangles = accessors[indices]["count"] // 3
        decoded[number] = decode_draco(content, triangles, accessors[place]["count"])
    mesh = decoded[number]
    accessors[indices]["componentType"] = UNSIGNED_INTS
    _replace(tree, indices, mesh.faces.astype("<u4").reshape(-1, 1), buffers)
    primitive["mode"] = TRIANGLES
    for name, at in named.items():
        found = mesh.get_attribute_by_unique_id(about["attributes"][name])
        values = None if found is None else np.asarray(found["data"])
        if values is None or values.shape != (accessors[at]["count"], WIDTHS.get(accessors[at]["type"])):
            raise FormatError(f"its Draco data has no {name} of this size")
        _replace(tree, at, values.astype(NUMBER_TYPES[accessors[at]["componentType"]]), buffers)


def _replace(tree: dict[str, Any], number: int, values: Any, buffers: list[bytes]) -> None:
    """Give an accessor values (count, width), in a buffer of their own."""
    accessor = tree["accessors"][number]
    if len(values) != accessor["count"]:
        raise FormatError("its Draco data has another number of elements than it states")
    content = values.tobytes()
    buffers.append(content)
    tree["buffers"].append({"byteLength": len(content)})
    tree["bufferViews"].append({"buffer": len(buffers) - 1, "byteLength": len(content)})
    accessor.pop("sparse", None)
    accessor |= {"bufferView": len(tree["bufferViews"]) - 1, "byteOffset": 0}
