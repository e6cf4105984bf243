# SPDX-License-Identifier: GPL-3.0-or-later
"""The meshes of glTF and GLB files, joined as one surface, with transforms and pose applied.

glTF splits vertices where texture coordinates or normals differ. Here vertices with equal position, skin weights and
morph targets are merged, and the other data belongs to the corners.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.affine_maps import blend_matrices, normalise, transform_points
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_document import PLACE, Document, morph_target_names
from zoomout_core.mesh.formats.opening import shown
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.input_files import FormatError

if TYPE_CHECKING:
    from pygltflib import Primitive

# Modes of primitives.
TRIANGLES, STRIP, FAN = 4, 5, 6
# Corners of the even and odd triangles of a strip.
EVEN, ODD = np.array([0, 1, 2]), np.array([1, 0, 2])


@dataclass(frozen=True, eq=False)
class GltfMesh:
    """The mesh of one node: n vertices, and m triangles with three corners each.

    Attributes:
        node: its number.
        skin: the number of its skin, None without one.
        vertices: (n, 3) rest positions, in the bind frame of the skin, or without one in the node's frame.
        triangles: (m, 3) vertex numbers.
        material: (m,) numbers of materials, -1 for none.
        corners: values (3 m, w) of the corners, by name.
        offsets: (n, keys, 3) offsets of the morph targets.
        keys: names of the morph targets.
        joint: (n, s) numbers of joints in the skin.
        weight: (n, s) weights of these joints.
        bare: the number of vertices that have no positive weight in the file.
        place: (n, 4) rows of a stored map; None without one.
    """

    node: int
    skin: int | None
    vertices: Floats
    triangles: Integers
    material: Integers
    corners: dict[str, Floats]
    offsets: Floats
    keys: tuple[str, ...]
    joint: Integers
    weight: Floats
    bare: int
    place: Floats | None


class GltfScene(NamedTuple):
    """The meshes of a file, posed and joined."""

    document: Document
    nodes: Sequence[int]  # with meshes
    meshes: Sequence[GltfMesh]  # with triangles
    skeleton: Skeleton
    matrices: Sequence[Floats]  # (n, 3, 4) of each mesh, which pose its vertices
    surface: Surface


def read_scene(path: Path, folders: Iterable[Path] = ()) -> GltfScene | None:
    """Read the meshes of a file; None without triangles.

    Args:
        path: the file.
        folders: further folders in which its buffers and images may be.

    Raises:
        MeshError: it cannot be read, or is compressed.
        ImportError: pygltflib is not installed.
    """
    document = Document(path, folders)
    worlds, parent = document.worlds()
    nodes = [number for number in document.in_order(parent) if document.gltf.nodes[number].mesh is not None]
    meshes = [mesh for mesh in (_mesh(document, number) for number in nodes) if len(mesh.triangles)]
    if not meshes:
        return None
    skeleton = Skeleton(document, worlds, parent, meshes)
    meshes = [_wind_outwards(mesh, worlds[mesh.node]) for mesh in meshes]
    matrices = [skeleton.matrices(mesh) for mesh in meshes]
    vertices = np.concatenate(
        [transform_points(each, mesh.vertices) for each, mesh in zip(matrices, meshes, strict=True)]
    )
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, first, strict=False)])
    surface = Surface.from_corners(vertices, triangles.ravel(), np.arange(0, triangles.size + 1, 3))
    return GltfScene(document, nodes, meshes, skeleton, matrices, surface)


def _wind_outwards(mesh: GltfMesh, world: Floats) -> GltfMesh:
    """Reverse the faces of a mesh if its node mirrors it; the node of a skinned mesh does not count."""
    if mesh.skin is not None or np.linalg.det(world[:3, :3]) > 0:
        return mesh
    order = np.array([0, 2, 1])
    corners = {
        name: values.reshape(-1, 3, values.shape[1])[:, order].reshape(values.shape)
        for name, values in mesh.corners.items()
    }
    return replace(mesh, triangles=mesh.triangles[:, order], corners=corners)


# --- meshes -------------------------------------------------------------------------------------------------


def _mesh(document: Document, number: int) -> GltfMesh:
    """The mesh of a node, with vertices merged that were split by corner data."""
    node = document.gltf.nodes[number]
    mesh = document.gltf.meshes[node.mesh]
    primitives = [
        each
        for each in mesh.primitives
        if each.mode in (None, TRIANGLES, STRIP, FAN) and each.attributes and each.attributes.POSITION is not None
    ]
    attributes = [
        {name: document.array(at) for name, at in vars(each.attributes).items() if isinstance(at, int)}
        for each in primitives
    ]
    counts = [len(each["POSITION"]) for each in attributes]
    start = np.cumsum([0, *counts])
    rows, keys = _rows_of_all(attributes, counts), morph_target_names(mesh)
    offsets = _morph_offsets(document, primitives, start, len(keys))
    joint, weight, bare = _influences(rows)
    broken = np.isnan(rows["POSITION"]).any(axis=1)  # vertices that keep their numbers, and lose their triangles
    offsets[broken], weight[broken] = 0, 0
    chosen, merged = _merge_equal(
        np.hstack([rows["POSITION"], joint, weight, offsets.reshape(len(offsets), 3 * len(keys))])
    )
    corner, material = _triangles_of_all(document, primitives, start)
    intact = ~broken[corner].any(axis=1)
    corner, material = corner[intact], material[intact]
    names = (name for name in rows if name.startswith(("TEXCOORD_", "COLOR_")) or name == "NORMAL")
    has_map = PLACE in rows and all(PLACE in each for each in attributes)
    return GltfMesh(
        node=number,
        skin=node.skin,
        vertices=rows["POSITION"][chosen],
        triangles=merged[corner],
        material=material,
        corners={name: rows[name][corner.ravel()] for name in names},
        offsets=offsets[chosen],
        keys=keys,
        joint=joint[chosen],
        weight=weight[chosen],
        bare=0 if node.skin is None else int((bare & ~broken)[chosen].sum()),
        place=rows[PLACE][chosen] if has_map else None,
    )


def _morph_offsets(document: Document, primitives: Sequence[Primitive], start: Integers, count: int) -> Floats:
    """(n, count, 3) offsets of the morph targets of primitives, whose vertices begin at `start` (p + 1,)."""
    offsets = np.zeros((start[-1], count, 3))
    for primitive, first, end in zip(primitives, start, start[1:], strict=False):
        for key, target in enumerate(primitive.targets or []):
            at = target.get("POSITION") if isinstance(target, dict) else target.POSITION
            if at is not None:
                offsets[first:end, key] = document.array(at)
    return offsets


def _merge_equal(rows: Floats) -> tuple[Integers, Integers]:
    """Merge equal rows (n, w): the kept rows (k,) in the order of the file, and (n,) the kept one of each."""
    _, chosen, merged = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(chosen, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return chosen[order], rank[merged.ravel()]


def _rows_of_all(attributes: Sequence[dict[str, NDArray[Any]]], counts: Sequence[int]) -> dict[str, Floats]:
    """(n, w) values of all primitives by name, zero for primitives without them."""
    width = {"POSITION": 3} | {name: values.shape[1] for each in attributes for name, values in each.items()}
    rows = {name: np.zeros((sum(counts), w)) for name, w in width.items()}
    start = 0
    for each, count in zip(attributes, counts, strict=True):
        for name, values in each.items():
            rows[name][start : start + count, : values.shape[1]] = values
            if name.startswith("COLOR_") and values.shape[1] == 3:
                rows[name][start : start + count, 3:] = 1
        start += count
    return rows


def _triangles_of_all(
    document: Document, primitives: Sequence[Primitive], start: Integers
) -> tuple[Integers, Integers]:
    """(m, 3) triangles of primitives, whose vertices begin at `start` (p + 1,), and (m,) their materials; -1 for none.

    Raises:
        MeshError: a triangle refers to a vertex that does not exist.
    """
    triangles = [_triangles(document, each, int(n)) for each, n in zip(primitives, np.diff(start), strict=True)]
    corner = np.concatenate([np.zeros((0, 3), int), *(t + first for t, first in zip(triangles, start, strict=False))])
    materials = [-1 if each.material is None else each.material for each in primitives]
    return corner, np.repeat(materials, [len(t) for t in triangles])


def _triangles(document: Document, primitive: Primitive, count: int) -> Integers:
    """(m, 3) vertex numbers of a primitive."""
    numbers = np.arange(count) if primitive.indices is None else document.array(primitive.indices).ravel().astype(int)
    if len(numbers) and numbers.max() >= count:
        raise MeshError(f"A face refers to vertex {numbers.max()}, but there are only {count}: export the file again.")
    if primitive.mode == STRIP:
        at = np.arange(max(len(numbers) - 2, 0))[:, None]
        return numbers[np.where(at % 2, at + ODD, at + EVEN)]
    if primitive.mode == FAN:
        at = np.arange(max(len(numbers) - 2, 0))
        return numbers[np.column_stack([at + 1, at + 2, np.zeros_like(at)])]
    return numbers[: len(numbers) // 3 * 3].reshape(-1, 3)


def _influences(rows: dict[str, Floats]) -> tuple[Integers, Floats, Booleans]:
    """(n, s) joints and (n, s) weights of all sets, the largest first; joints without weight are 0.

    If no weight of a vertex is a positive number, which glTF leaves undefined, its first joint gets a weight of one,
    as in Blender's importer. The last array (n,) marks these vertices.
    """
    none = np.zeros((len(rows["POSITION"]), 4))
    sets = [number for number in range(len(rows)) if f"JOINTS_{number}" in rows]
    joint = np.hstack([none[:, :0], *(rows[f"JOINTS_{number}"] for number in sets)]).astype(int)
    weight = np.hstack([none[:, :0], *(rows.get(f"WEIGHTS_{number}", none) for number in sets)])
    weight[~np.isfinite(weight)] = 0
    bare = (weight <= 0).all(axis=1) & bool(sets)
    weight[bare, :1] = 1
    order = np.lexsort((joint, -weight)) if sets else np.zeros_like(joint)
    joint, weight = np.take_along_axis(joint, order, 1), np.take_along_axis(weight, order, 1)
    return np.where(weight > 0, joint, 0), np.maximum(weight, 0), bare


# --- joints -------------------------------------------------------------------------------------------------


class Skeleton:
    """The joints of all skins of a file, and the nodes of meshes that are parented to joints.

    Args:
        document: the file.
        worlds: (nodes, 4, 4) world transforms of the nodes.
        parent: (nodes,) the parent of each.
        meshes: the visible meshes.
    """

    def __init__(self, document: Document, worlds: Floats, parent: Integers, meshes: Sequence[GltfMesh]) -> None:
        self.document, self.worlds, self.parent = document, worlds, parent
        self.skins = {
            number: (np.asarray(document.gltf.skins[number].joints), self._inverse_bind(number))
            for number in sorted({mesh.skin for mesh in meshes if mesh.skin is not None})
        }
        bind: dict[int, Floats] = {}
        for nodes, inverse_bind in self.skins.values():
            for node, matrix in zip(nodes.tolist(), inverse_bind, strict=True):
                bind.setdefault(node, matrix)
        self.nodes = np.array(sorted(bind), dtype=np.int64)
        self.bind = np.array([bind[node] for node in self.nodes]).reshape(-1, 4, 4)
        self.transforms = worlds[self.nodes] @ self.bind

    def _inverse_bind(self, number: int) -> Floats:
        skin = self.document.gltf.skins[number]
        if skin.inverseBindMatrices is None:
            return np.tile(np.eye(4), (len(skin.joints), 1, 1))
        return self.document.matrices(skin.inverseBindMatrices)

    def matrices(self, mesh: GltfMesh) -> Floats:
        """(n, 3, 4) matrices that pose the vertices of a mesh.

        Raises:
            FormatError: a vertex follows a joint that does not exist, or has no inverse bind matrix that can be
                inverted.
        """
        count = len(mesh.vertices)
        if mesh.skin is None:
            return np.broadcast_to(self.worlds[mesh.node][:3], (count, 3, 4))
        nodes, inverse_bind = self.skins[mesh.skin]
        used = np.unique(mesh.joint[mesh.weight > 0])
        if used.max(initial=0) >= len(nodes):
            raise FormatError(f"a vertex follows joint {used[-1]}, but its skin has only {len(nodes)} joints")
        invertible = np.isfinite(inverse_bind[used]).all(axis=(1, 2))
        invertible[invertible] = np.linalg.det(inverse_bind[used[invertible], :3, :3]) != 0
        if len(singular := used[~invertible]):
            joint = shown(self.document.gltf.nodes[nodes[singular[0]]].name or f"Joint {singular[0]}")
            raise FormatError(f"the inverse bind matrix of {joint} cannot be inverted")
        shares = normalise(sparse_weights(np.arange(count)[:, None], mesh.joint, mesh.weight, (count, len(nodes))))
        matrices = blend_matrices((self.worlds[nodes] @ inverse_bind)[:, :3], shares)
        unweighted = np.diff(shares.indptr) == 0
        matrices[unweighted] = self.worlds[mesh.node][:3]
        return matrices

    def ancestor(self, node: int) -> int:
        """The nearest joint among a node and its ancestors, -1 without one."""
        while node >= 0 and node not in self.nodes:
            node = int(self.parent[node])
        return node


def sparse_weights(rows: Integers, columns: Integers, values: Floats, shape: tuple[int, int]) -> csr_array:
    """A sparse matrix of a given shape, from rows, columns and values that are broadcast (...); zeros are dropped."""
    rows, columns, values = (each.ravel() for each in np.broadcast_arrays(rows, columns, values))
    kept = values > 0
    return csr_array(coo_array((values[kept], (rows[kept], columns[kept])), shape=shape))
