# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY files as assets: colours and texture coordinates of vertices or corners."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import COLOR, NORMALS, UV, Asset, from_srgb, on_points, to_srgb
from zoomout_core.mesh.formats.files import drop_broken_faces, surface_of
from zoomout_core.mesh.formats.opening import file_bytes
from zoomout_core.mesh.formats.ply_files import ply_columns, ply_polygons
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

# Names of texture coordinates of vertices.
COORDINATES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def read_ply(path: Path, _: Iterable[Path] = ()) -> Asset:
    """Read a PLY file, which needs no other file.

    Raises:
        MeshError: it cannot be read, or has no faces.
    """
    columns = ply_columns(file_bytes(path))
    vertex, attributes = columns["vertex"], []
    given = ply_polygons(columns)
    polygons, kept = drop_broken_faces(given)
    surface = surface_of(polygons, vertex, path)
    if {"red", "green", "blue"} <= vertex.keys():
        names = ("red", "green", "blue", *(["alpha"] if "alpha" in vertex else []))
        values = np.stack([np.asarray(vertex[name], dtype=np.float64) for name in names], axis=1)
        if vertex["red"].dtype.kind in "iu" or values.max(initial=0) > 1:
            values /= 255
        attributes.append(Attribute(f"{COLOR} 0", Domain.POINT, Kind.COLOR, from_srgb(values)))
    of_corners = columns.get("face", {}).get("texcoord")
    for u, v in COORDINATES:
        if of_corners is None and {u, v} <= vertex.keys():
            uv = np.stack([np.asarray(vertex[name], dtype=np.float64) for name in (u, v)], axis=1)
            attributes.append(Attribute(f"{UV} 0", Domain.CORNER, Kind.UV, uv[surface.corner_vertex]))
            break
    if of_corners is not None:
        flat = np.concatenate([np.asarray(each, dtype=np.float64).ravel() for each in of_corners])
        if len(flat) == 2 * len(given[1]):
            uv = flat.reshape(-1, 2)[np.repeat(kept, np.diff(given[2]))]
            attributes.append(Attribute(f"{UV} 0", Domain.CORNER, Kind.UV, uv))
    return Asset(surface, tuple(attributes))


def write_ply(asset: Asset, path: Path) -> tuple[str, ...]:
    """Write a binary PLY file; data that the format cannot store is reported in the notes."""
    surface = asset.surface
    uv, color = asset.find(f"{UV} 0"), asset.find(f"{COLOR} 0")
    fields: list[tuple[str, str]] = [(axis, "<f8") for axis in "xyz"]
    values = list(surface.vertices.T)
    if color is not None:
        rgba = np.asarray(on_points(color, surface))
        rgba = np.column_stack([to_srgb(rgba), np.ones((len(rgba), 4 - rgba.shape[1]))])
        fields += [(name, "u1") for name in ("red", "green", "blue", "alpha")]
        values += list(np.round(255 * np.clip(rgba, 0, 1)).T)
    table = np.zeros(len(surface.vertices), dtype=fields)
    for (name, _), column in zip(fields, values, strict=True):
        table[name] = column
    types = {"<f8": "double", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [f"property {types[kind]} {name}" for name, kind in fields]
    header += [f"element face {len(surface.face_start) - 1}", "property list int int vertex_indices"]
    if uv is not None:
        header.append("property list int float texcoord")
    faces = _faces(surface, None if uv is None else np.asarray(uv.values))
    path.write_bytes("\n".join([*header, "end_header\n"]).encode() + table.tobytes() + faces.tobytes())
    held = (f"{UV} 0", f"{COLOR} 0", NORMALS)
    left = [each.name for each in asset.attributes if each.name not in held]
    left += ["skin weights"] if asset.skin is not None else []
    if not left:
        return ()
    return (f"PLY files cannot store {' or '.join(left)}, which were left out: write a .glb file to keep them.",)


def _faces(surface: Surface, uv: Floats | None) -> Integers:
    """4-byte words for each face: the number of corners and these, the number of texture coordinates and these."""
    size = np.diff(surface.face_start)
    words = 1 + size + (0 if uv is None else 1 + 2 * size)
    first = np.cumsum(words) - words
    found = np.zeros(words.sum(), "<i4")
    found[first] = size
    within = np.arange(len(surface.corner_vertex)) - np.repeat(surface.face_start[:-1], size)
    at = np.repeat(first + 1, size) + within
    found[at] = surface.corner_vertex
    if uv is not None:
        found[first + 1 + size] = 2 * size
        at = np.repeat(first + 2 + size, size) + 2 * within
        found[at[:, None] + [0, 1]] = np.ascontiguousarray(uv, "<f4").view("<i4")
    return found
