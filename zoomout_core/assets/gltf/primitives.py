# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the primitives of glTF meshes: a surface in the frames of its nodes, with vertices split by corner data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import COLOR, MATERIALS, NORMALS, SHAPE_KEYS, UV, Asset, layers_of, on_corners
from zoomout_core.assets.gltf.mesh_parts import Part
from zoomout_core.mesh.formats.gltf_buffer import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer
from zoomout_core.mesh.formats.gltf_document import PLACE, library
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.transfer.rigging.skinning import row_of

if TYPE_CHECKING:
    from pygltflib import Primitive

# Joints per vertex in a set.
INFLUENCES = 4
# The order of a triangle's corners on the other side of a mirror.
REVERSED = np.array([0, 2, 1])


@dataclass(frozen=True, eq=False)
class PlacedSurface:
    """A surface in the frames of its nodes: the rest pose of the joints, or the frame of a node without joints.

    Attributes:
        positions: (n, 3) of the vertices.
        linear: (n, 3, 3) matrices that take small differences of posed positions there; None if all are one.
        corners: (m, 3) corners of the triangles, in reverse order where a node mirrors them.
        triangles: the numbers of each part's triangles, by its first vertex.
        rows: (c, w) data of the corners, by glTF's names.
        split: (c,) the number of each corner's split vertex.
    """

    positions: Floats
    linear: Floats | None
    corners: Integers
    triangles: dict[int, Integers]
    rows: dict[str, Floats]
    split: Integers


def place_in_nodes(asset: Asset, parts: Sequence[Part], skins: Sequence[int | None]) -> PlacedSurface:
    """The surface of an asset in the frames of its nodes."""
    surface = asset.surface
    positions, corners = surface.vertices.copy(), surface.triangle_corners.copy()
    worlds = np.zeros((0, 4, 4)) if asset.document is None else asset.document.worlds()[0]
    # Sort once: a scene may have thousands of parts.
    starts = np.sort([part.start for part in parts])
    of_triangle = np.searchsorted(starts, surface.triangles[:, 0], side="right") - 1
    groups = np.split(
        np.argsort(of_triangle, kind="stable"), np.cumsum(np.bincount(of_triangle, minlength=len(parts)))[:-1]
    )
    triangles = dict(zip(starts.tolist(), groups, strict=True))
    placed = any(part.node < len(worlds) for part in parts)
    linear = np.tile(np.eye(3), (len(positions), 1, 1)) if placed or asset.skin is not None else None
    for part, skin in zip(parts, skins, strict=True):
        own = slice(part.start, part.stop)
        if skin is not None and asset.skin is not None and linear is not None:
            positions[own], linear[own] = asset.skin.rest[own], asset.skin.linear[own]
        elif part.node < len(worlds) and linear is not None:
            world = worlds[part.node]
            inverse = np.linalg.pinv(world[:3, :3])
            positions[own], linear[own] = (positions[own] - world[:3, 3]) @ inverse.T, inverse
            if np.linalg.det(world[:3, :3]) < 0:
                mirrored = triangles[part.start]
                corners[mirrored] = corners[mirrored][:, REVERSED]
    rows = _corner_rows(asset, positions, linear, surface.corner_vertex[corners])
    return PlacedSurface(positions, linear, corners, triangles, rows, _split_vertices(rows, surface.corner_vertex))


def _corner_rows(asset: Asset, positions: Floats, linear: Floats | None, triangles: Integers) -> dict[str, Floats]:
    """Corner data (c, w) by glTF's names."""
    surface = asset.surface
    normals = asset.find(NORMALS)
    if normals is None:
        of_corner = vertex_normals(positions, triangles)[surface.corner_vertex]
    else:
        of_corner = np.asarray(normals.values)
        if linear is not None:
            inverse = np.linalg.pinv(linear)[surface.corner_vertex]
            of_corner = unit_vectors(np.einsum("cyx,cy->cx", inverse, of_corner))
    of_corner = np.where(np.linalg.norm(of_corner, axis=1, keepdims=True) > 0.5, of_corner, [0, 0, 1])
    rows = {"NORMAL": of_corner}
    if asset.stored_map is not None:
        rows[PLACE] = asset.stored_map.rows[surface.corner_vertex]
    for kind, name in ((UV, "TEXCOORD"), (COLOR, "COLOR")):
        for number, attribute in enumerate(layers_of(asset.attributes, kind)):
            values = on_corners(attribute, surface)
            rows[f"{name}_{number}"] = values * [1, -1] + [0, 1] if kind == UV else _rgba(values)
    return rows


def _rgba(colors: Floats) -> Floats:
    return np.clip(np.column_stack([colors, np.ones((len(colors), 4 - colors.shape[1]))]), 0, 1)


def _split_vertices(rows: dict[str, Floats], corner_vertex: Integers) -> Integers:
    """(c,) numbers of corners, equal where vertex and data are."""
    key = np.column_stack([corner_vertex, *rows.values()]).astype(np.float32)
    # Single floats cannot represent vertex numbers above 2^24.
    whole = np.column_stack([corner_vertex, np.ascontiguousarray(key[:, 1:]).view(np.int32)])
    return np.asarray(np.unique(whole, axis=0, return_inverse=True)[1]).ravel()


def write_primitives(
    shape: PlacedSurface,
    asset: Asset,
    part: Part,
    weights: csr_array | None,
    joints: Sequence[int] | None,
    buffer: Buffer,
) -> list[Primitive]:
    """Make a primitive for each material of a part, with vertices split where corners differ."""
    materials = asset.find(MATERIALS)
    number = np.full(len(asset.surface.face_start) - 1, -1) if materials is None else np.asarray(materials.values)
    own = shape.triangles[part.start]
    of_triangle = number[asset.surface.triangle_face[own]]
    influences = None
    if joints is not None and weights is not None and asset.skin is not None:
        at = {node: local for local, node in enumerate(joints)}
        columns = np.array([at.get(node, 0) for node in asset.skin.nodes.tolist()], dtype=np.int64)
        influences = _influences(weights[part.start : part.stop], columns)
    primitives = []
    for material in np.unique(of_triangle):
        corners = shape.corners[own[of_triangle == material]]
        primitives.append(_primitive(shape, asset, part, corners, influences, buffer))
        if material >= 0:
            primitives[-1].material = int(material)
    return primitives


def _primitive(
    shape: PlacedSurface,
    asset: Asset,
    part: Part,
    corners: Integers,  # (m, 3) of its triangles
    influences: tuple[NDArray[Any], NDArray[Any]] | None,  # joints and weights (v, s) of the part's vertices
    buffer: Buffer,
) -> Primitive:
    """Make the primitive of some triangles of a part."""
    gltf = library()
    split, triangles = np.unique(shape.split[corners], return_inverse=True)
    # Use one corner of each vertex for all.
    example = np.empty(len(split), dtype=np.int64)
    example[triangles.ravel()] = corners.ravel()
    vertex = asset.surface.corner_vertex[example]
    attributes = gltf.Attributes(
        POSITION=buffer.add(shape.positions[vertex].astype("<f4"), ARRAY_BUFFER, bounded=True),
        **{name: buffer.add(values[example].astype("<f4"), ARRAY_BUFFER) for name, values in shape.rows.items()},
    )
    if influences is not None:
        joint, share = influences
        _add_influences(attributes, joint[vertex - part.start], share[vertex - part.start], buffer)
    primitive = gltf.Primitive(attributes=attributes, mode=4)
    primitive.indices = buffer.add(triangles.ravel().astype("<u4"), ELEMENT_ARRAY_BUFFER)
    keys = asset.find(SHAPE_KEYS)
    if keys is not None and part.keys:
        labels = np.array([keys.labels.index(key) for key in part.keys], dtype=np.int64)
        offsets = np.asarray(keys.values)[np.ix_(vertex, labels)]
        if shape.linear is not None:
            offsets = np.einsum("nxy,nky->nkx", shape.linear[vertex], offsets)
        primitive.targets = [
            gltf.Attributes(POSITION=buffer.add(offsets[:, key].astype("<f4"), ARRAY_BUFFER, bounded=True))
            for key in range(len(labels))
        ]
    return primitive


def _add_influences(attributes: Any, joint: NDArray[Any], share: NDArray[Any], buffer: Buffer) -> None:
    """Add joints and weights (v, s) of vertices, in sets of four."""
    for number in range(joint.shape[1] // INFLUENCES):
        columns = slice(number * INFLUENCES, (number + 1) * INFLUENCES)
        setattr(attributes, f"JOINTS_{number}", buffer.add(joint[:, columns], ARRAY_BUFFER))
        setattr(attributes, f"WEIGHTS_{number}", buffer.add(share[:, columns], ARRAY_BUFFER))


def _influences(weights: csr_array, columns: Integers) -> tuple[NDArray[Any], NDArray[Any]]:
    """(n, s) joints and weights of vertices, the largest weights first, in sets of four.

    Args:
        weights: (n, b) weights that sum to one.
        columns: (b,) the number of each joint in the skin.
    """
    row, count = row_of(weights), np.diff(weights.indptr)
    order = np.lexsort((weights.indices, -weights.data, row))
    rank = np.arange(len(row)) - np.repeat(weights.indptr[:-1], count)
    sets = max(-(-int(count.max(initial=1)) // INFLUENCES), 1)
    joint = np.zeros((weights.shape[0], sets * INFLUENCES), "<u1" if columns.max(initial=0) < 256 else "<u2")
    share = np.zeros(joint.shape, "<f4")
    joint[row, rank], share[row, rank] = columns[weights.indices[order]], weights.data[order]
    joint[share == 0] = 0  # also where a weight is too small for single floats
    # Readers expect single floats that sum to one.
    share[:, 0] += 1 - share.sum(axis=1, dtype=np.float64)
    return joint, share
