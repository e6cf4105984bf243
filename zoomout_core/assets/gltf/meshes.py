# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the surface of an asset as the meshes and skins of a glTF document.

As long as the surface is that of the document, each mesh stays on its node. The surface of another file becomes one
mesh, on the node of the document's largest mesh, and the nodes of its other meshes become empty.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import COLOR, MATERIALS, NORMALS, SHAPE_KEYS, UV, Asset, layers_of, on_corners
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.formats.gltf_document import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    PLACE,
    VARIANTS,
    VRM_0,
    Buffer,
    Document,
    library,
    morph_target_names,
)
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.transfer.rigging.skinning import row_of

if TYPE_CHECKING:
    from pygltflib import GLTF2, Mesh, Primitive

# Joints per vertex in a set.
INFLUENCES = 4
# Offsets of a morph target that are no more than rounding to single floats, relative to the extent of the surface.
STILL = 1e-6
# The order of a triangle's corners on the other side of a mirror.
REVERSED = np.array([0, 2, 1])


@dataclass(frozen=True, eq=False)
class Part:
    """The part of a surface that becomes the mesh of a node.

    Attributes:
        node: number of the node.
        start: its first vertex.
        stop: the vertex after its last one.
        bearers: the document's nodes whose meshes it stands for; its own node first.
        origins: these meshes, by number.
        keys: names of its morph targets, those of the document's mesh first.
    """

    node: int
    start: int
    stop: int
    bearers: tuple[int, ...]
    origins: dict[int, Mesh]
    keys: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Renumbering:
    """The new numbers of what a document refers to.

    Attributes:
        nodes: by node with a mesh, the node that has its mesh now.
        meshes: by mesh, the meshes that it became: several if several nodes had it.
        keys: by mesh, the number of each of its morph targets; None for one that is gone.
        key_names: by new mesh, the names of its morph targets.
        is_joined: whether several meshes became one.
    """

    nodes: dict[int, int] = field(default_factory=dict)
    meshes: dict[int, list[int]] = field(default_factory=dict)
    keys: dict[int, list[int | None]] = field(default_factory=dict)
    key_names: tuple[tuple[str, ...], ...] = ()
    is_joined: bool = False


@dataclass(frozen=True, eq=False)
class _Shape:
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


def write_meshes(
    made: GLTF2, asset: Asset, look: Document | None, buffer: Buffer, name: str
) -> tuple[Renumbering, tuple[str, ...]]:
    """Write the surface of an asset; returns the new numbers of what its document refers to, and notes.

    Args:
        made: the document to write, with the nodes, meshes and skins of the asset's document.
        asset: the asset.
        look: the document whose materials are written in full, if there is one.
        buffer: the buffer of the document.
        name: the name of a mesh or node that has none.
    """
    known = bool(asset.nodes) and asset.document is not None
    stays = known and sum(count for _, count in asset.objects) == len(asset.surface.vertices)
    parts = _parts_on_their_nodes(asset) if stays else [_whole_part(made, asset, name)]
    skins = [_skin_of(part, asset, stays) for part in parts]
    weights = None if asset.skin is None else normalise(asset.skin.weights)
    made.skins = _write_skins(asset, parts, skins, weights, buffer, stays)
    shape = _shape(asset, parts, skins)
    meshes, notes = [], dict[str, None]()
    for part, skin in zip(parts, skins, strict=True):
        mesh = library().Mesh(name=next((each.name for each in part.origins.values() if each.name), name))
        joints = None if skin is None else made.skins[skin].joints
        mesh.primitives = _primitives(shape, asset, part, weights, joints, buffer)
        notes |= dict.fromkeys(_keep_free_data(mesh, part, asset, look))
        _name_keys(mesh, part, asset.document)
        meshes.append(mesh)
    for node in made.nodes:
        node.mesh = node.skin = None
    for number, (part, skin) in enumerate(zip(parts, skins, strict=True)):
        made.nodes[part.node].mesh, made.nodes[part.node].skin = number, skin
    made.meshes = meshes
    return _renumber(parts, not stays), tuple(notes)


# --- parts --------------------------------------------------------------------------------------------------


def _parts_on_their_nodes(asset: Asset) -> list[Part]:
    """The parts of a surface that is that of its document, in the order of the document's meshes."""
    ends = np.cumsum([0, *(count for _, count in asset.objects)]).tolist()
    parts = []
    for node, start, stop in zip(asset.nodes, ends[:-1], ends[1:], strict=True):
        mesh = _mesh_on(asset, node)
        number = asset.document.gltf.nodes[node].mesh  # type: ignore[union-attr]
        parts.append(Part(node, start, stop, (node,), {number: mesh}, _keys_of(asset, mesh, start, stop)))
    return sorted(parts, key=lambda part: (*part.origins, part.node))


def _whole_part(made: GLTF2, asset: Asset, name: str) -> Part:
    """The whole surface, on the node of the document's largest mesh, or on a new one."""
    keys = asset.find(SHAPE_KEYS)
    labels = () if keys is None else keys.labels
    origins: dict[int, Mesh] = {}
    bearers: list[int] = []
    node = -1
    if asset.document is not None:
        gltf = asset.document.gltf
        origins = {each.mesh: gltf.meshes[each.mesh] for each in gltf.nodes if each.mesh is not None}
        sizes = {number: _size_of(gltf, mesh) for number, mesh in origins.items()}
        bearers = [number for number, each in enumerate(gltf.nodes) if each.mesh is not None]
        node = max(bearers, key=lambda at: (gltf.nodes[at].skin is not None, sizes[gltf.nodes[at].mesh]), default=-1)
    if node < 0:
        made.nodes.append(library().Node(name=name))
        node = len(made.nodes) - 1
        if not made.scenes:
            made.scenes, made.scene = [library().Scene(nodes=[])], 0
        made.scenes[made.scene or 0].nodes.append(node)
    bearers.sort(key=lambda bearer: bearer != node)
    return Part(node, 0, len(asset.surface.vertices), tuple(bearers), origins, labels)


def _size_of(gltf: GLTF2, mesh: Mesh) -> int:
    """The number of a mesh's vertices."""
    places = {each.attributes.POSITION for each in mesh.primitives} - {None}
    return sum(gltf.accessors[each].count for each in places)


def _mesh_on(asset: Asset, node: int) -> Mesh:
    """The mesh of a node of the asset's document."""
    assert asset.document is not None
    return asset.document.gltf.meshes[asset.document.gltf.nodes[node].mesh]


def _keys_of(asset: Asset, mesh: Mesh, start: int, stop: int) -> tuple[str, ...]:
    """The morph targets of a mesh: those that it has, then others that move its vertices."""
    keys = asset.find(SHAPE_KEYS)
    if keys is None:
        return ()
    names = [name for name in morph_target_names(mesh) if name in keys.labels]
    places, offsets = asset.surface.vertices, np.asarray(keys.values)
    still = STILL * float((np.nanmax(places, axis=0) - np.nanmin(places, axis=0)).max())
    moved = (label for key, label in enumerate(keys.labels) if np.abs(offsets[start:stop, key]).max() > still)
    return tuple(dict.fromkeys([*names, *moved]))


def _renumber(parts: Sequence[Part], is_joined: bool) -> Renumbering:
    meshes: dict[int, list[int]] = {}
    keys: dict[int, list[int | None]] = {}
    for new, part in enumerate(parts):
        number = {key: at for at, key in enumerate(part.keys)}
        for old, mesh in part.origins.items():
            meshes.setdefault(old, []).append(new)
            keys[old] = [number.get(name) for name in morph_target_names(mesh)]
    nodes = {bearer: part.node for part in parts for bearer in part.bearers}
    return Renumbering(nodes, meshes, keys, tuple(part.keys for part in parts), is_joined)


# --- skins --------------------------------------------------------------------------------------------------


def _skin_of(part: Part, asset: Asset, stays: bool) -> int | None:
    """The number of a part's skin."""
    if asset.skin is None:
        return None
    return asset.document.gltf.nodes[part.node].skin if stays and asset.document is not None else 0


def _write_skins(
    asset: Asset,
    parts: Sequence[Part],
    skins: Sequence[int | None],
    weights: csr_array | None,
    buffer: Buffer,
    stays: bool,
) -> list[Any]:
    """Write the skins of the parts, and those that no part has; each has the joints that its parts need."""
    gltf, skin, document = library(), asset.skin, asset.document
    if skin is None or weights is None:
        return []
    if not stays or document is None:
        return [gltf.Skin(joints=skin.nodes.tolist(), inverseBindMatrices=_add_matrices(skin.inverse_bind, buffer))]
    column = {node: number for number, node in enumerate(skin.nodes.tolist())}
    written = deepcopy(document.gltf.skins)
    for number, each in enumerate(written):
        rows = [weights[part.start : part.stop] for part, own in zip(parts, skins, strict=True) if own == number]
        if rows:
            used = np.unique(np.concatenate([row.indices for row in rows]))
            before, each.joints = each.joints, list(dict.fromkeys([*each.joints, *skin.nodes[used].tolist()]))
            if len(each.joints) > len(before):
                each.skeleton = None  # it may not be above the further joints
            bind = skin.inverse_bind[[column[joint] for joint in each.joints]]
            each.inverseBindMatrices = _add_matrices(bind, buffer)
        elif each.inverseBindMatrices is not None:
            each.inverseBindMatrices = _add_matrices(document.matrices(each.inverseBindMatrices), buffer)
    return written


def _add_matrices(matrices: Floats, buffer: Buffer) -> int:
    return buffer.add(matrices.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"))


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


# --- shape --------------------------------------------------------------------------------------------------


def _shape(asset: Asset, parts: Sequence[Part], skins: Sequence[int | None]) -> _Shape:
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
    return _Shape(positions, linear, corners, triangles, rows, _split_vertices(rows, surface.corner_vertex))


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


def _primitives(
    shape: _Shape, asset: Asset, part: Part, weights: csr_array | None, joints: Sequence[int] | None, buffer: Buffer
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
    shape: _Shape,
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


# --- free data ----------------------------------------------------------------------------------------------


def _name_keys(mesh: Mesh, part: Part, document: Document | None) -> None:
    """Name the morph targets of a mesh, also in its primitives as VRM 0 does, with the weights of the document."""
    if not part.keys:
        return
    given: dict[str, float] = {}
    for node in part.bearers:
        assert document is not None  # it has the node
        origin = part.origins[document.gltf.nodes[node].mesh]
        weights = document.node_weights(node) or origin.weights or []
        for name, weight in zip(morph_target_names(origin), weights, strict=False):
            given.setdefault(name, weight)
    mesh.weights = [given.get(key, 0.0) for key in part.keys]
    in_primitives = document is not None and VRM_0 in (document.gltf.extensions or {})
    for each in (mesh, *(mesh.primitives if in_primitives else [])):
        each.extras = {**(each.extras or {}), "targetNames": list(part.keys)}


def _keep_free_data(mesh: Mesh, part: Part, asset: Asset, look: Document | None) -> list[str]:
    """Copy free data and variants of materials from the meshes that a mesh stands for; returns notes on lost data."""
    before = [each for origin in part.origins.values() for each in origin.primitives]
    notes: list[str] = []
    if look is asset.document:
        notes += _keep_variants(mesh, before)
    elif look is not None:
        notes += _keep_variants(mesh, [each for other in look.gltf.meshes for each in other.primitives])
    own = [_without_names(each) for each in part.origins.values()]
    joined = len(own) > 1 and any(own)
    if len(own) == 1:
        mesh.extras = own[0]
        mesh.extensions = deepcopy(next(iter(part.origins.values())).extensions) or {}
    for primitive in mesh.primitives:
        found = [_without_names(each) for each in before if each.material == primitive.material]
        if found and look is asset.document and all(each == found[0] for each in found):
            primitive.extras = found[0]
        else:
            joined = joined or any(found)
    if joined:
        notes.append(
            "The meshes have free data (extras) of their own, which was left out, because they were joined or have "
            "other materials."
        )
    return notes


def _without_names(part: Mesh | Primitive) -> dict[str, Any]:
    """The free data of a mesh or primitive, without the names of its morph targets."""
    return {name: deepcopy(value) for name, value in (part.extras or {}).items() if name != "targetNames"}


def _keep_variants(mesh: Mesh, before: Sequence[Primitive]) -> list[str]:
    """Copy the mappings of material variants by material; returns a note for each part whose mappings differ."""
    notes = []
    for primitive in mesh.primitives:
        mappings = [(each.extensions or {}).get(VARIANTS) for each in before if each.material == primitive.material]
        if any(mapping != mappings[0] for mapping in mappings):
            notes.append(
                "Some parts with the same material have different material variants, which are left out: give these "
                "parts materials of their own."
            )
        elif mappings and mappings[0] is not None:
            primitive.extensions = {VARIANTS: deepcopy(mappings[0])}
    return notes
