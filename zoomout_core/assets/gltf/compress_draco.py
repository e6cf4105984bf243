# SPDX-License-Identifier: GPL-3.0-or-later
"""Compression of glTF documents by Draco (KHR_draco_mesh_compression)."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.gltf.compressed_parts import (
    NORMAL_BITS,
    POSITION_BITS,
    UNSIGNED_SHORT,
    UV_BITS,
    CompressedParts,
    round_colors,
    round_weights,
    set_bounds,
)
from zoomout_core.mesh.formats.compression.decompress_gltf import DRACO, UNSIGNED_INTS
from zoomout_core.mesh.formats.compression.draco import library

# Draco's level of compression; 10 takes more time for a few bytes.
LEVEL = 7
# Numbers of Draco's attributes that have no type of their own there begin here, after those that it gives itself.
FIRST_OTHER = 16


def compress_by_draco(parts: CompressedParts) -> bytes:
    """Compress the meshes of a document; returns its new buffer."""
    package, tree, done = library(), parts.tree, set[int]()
    # A mesh without indices, or one that shares its data with another one, stays as it is.
    primitives = [each for each, *_ in parts.primitives()]
    uses = Counter(number for each in primitives for number in (*each["attributes"].values(), each.get("indices")))
    for primitive, origin, extent in parts.primitives():
        numbers = [*primitive["attributes"].values(), primitive.get("indices")]
        if None in numbers or any(uses[number] > 1 or not parts.is_plain(number) for number in numbers):
            continue
        attributes = {name: parts.array(at) for name, at in primitive["attributes"].items()}
        rounded = round_weights(attributes) | round_colors(attributes)
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
        set_bounds(tree["accessors"][primitive["attributes"]["POSITION"]], np.asarray(mesh.points, "<f4"))
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
