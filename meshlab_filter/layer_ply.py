# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers as PLY files, with the flags, texture coordinates and polylines that MeshLab reads from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from meshlab_filter.layer import TEXCOORD, Layer
from zoomout_core.assets.asset import to_srgb
from zoomout_core.transfer import Attribute

# Bits of the flags of vertices and faces in MeshLab's PLY files.
SELECTED = 0x20
FAUX = np.array([0x40000, 0x80000, 0x100000])
# A property's name, its type, and its values (count,), or (count, k) for lists.
Column = tuple[str, str, Any]
PLY_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "uchar": "u1"}


def encode_ply(layer: Layer, texture_names: Sequence[str]) -> bytes:
    """The content of a PLY file with a layer, whose textures have these file names."""
    there = layer.components
    vertex_flags = np.zeros(len(layer.vertices), dtype=np.int64)
    face_flags = np.zeros(len(layer.faces), dtype=np.int64)
    if "vertex_selection" in there:
        vertex_flags |= SELECTED * there["vertex_selection"].values.astype(np.int64)
    if "face_selection" in there:
        face_flags |= SELECTED * there["face_selection"].values.astype(np.int64)
    if layer.textures is None:  # MeshLab corrupts texture coordinates of polygons in OBJ files
        face_flags |= (layer.faux * FAUX).sum(axis=1)

    vertex: list[Column] = [(axis, "double", layer.vertices[:, i]) for i, axis in enumerate("xyz")]
    vertex += [(f"n{axis}", "double", layer.normals[:, i]) for i, axis in enumerate("xyz")]
    vertex += [("flags", "int", vertex_flags), *_value_columns(there, "vertex")]
    face: list[Column] = [("vertex_indices", "int", layer.faces)]
    face += [("flags", "int", face_flags), *_value_columns(there, "face")]
    if layer.textures is not None:
        coordinates, number = layer.textures.by_texture(there[TEXCOORD].values)
        face += [("texcoord", "float", coordinates.reshape(-1, 6)), ("texnumber", "int", number)]
    edge: list[Column] = [(f"vertex{i + 1}", "int", layer.edges[:, i]) for i in range(2)]

    header, body = ["ply", "format binary_little_endian 1.0"], b""
    header += [f"comment TextureFile {name}" for name in texture_names]
    for element, columns in (("vertex", vertex), ("face", face), ("edge", edge)):
        lines, rows = _ply_element(element, columns)
        header += lines
        body += rows
    return "\n".join([*header, "end_header\n"]).encode() + body


def _value_columns(components: dict[str, Attribute], of: str) -> list[Column]:
    """Scalars and colours of vertices or of faces."""
    columns: list[Column] = []
    if f"{of}_scalar" in components:
        columns.append(("quality", "double", components[f"{of}_scalar"].values))
    if f"{of}_color" in components:
        encoded = np.rint(255 * np.clip(to_srgb(components[f"{of}_color"].values), 0, 1))
        columns += [(name, "uchar", encoded[:, i]) for i, name in enumerate(("red", "green", "blue", "alpha"))]
    return columns


def _ply_element(name: str, columns: Sequence[Column]) -> tuple[list[str], bytes]:
    """Header lines and rows of an element."""
    count = len(columns[0][2])
    header = [f"element {name} {count}"]
    fields: list[Any] = []
    for column, type_name, values in columns:
        if values.ndim == 2:
            header.append(f"property list uchar {type_name} {column}")
            fields.append((f"{column} size", "u1"))
        else:
            header.append(f"property {type_name} {column}")
        fields.append((column, PLY_TYPES[type_name], values.shape[1:]))
    rows = np.zeros(count, dtype=fields)
    for column, _, values in columns:
        rows[column] = values
        if values.ndim == 2:
            rows[f"{column} size"] = values.shape[1]
    return header, rows.tobytes()
