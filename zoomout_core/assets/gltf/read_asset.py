# SPDX-License-Identifier: GPL-3.0-or-later
"""Read glTF and GLB files as assets: the surface of their scene with attributes, materials and one skin."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array, vstack

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import (
    COLOR,
    NORMALS,
    SHAPE_KEYS,
    UV,
    Asset,
    Material,
    Skin,
    by_number,
    material_numbers,
    to_rest,
)
from zoomout_core.assets.gltf.compress_meshopt import QUANTIZED
from zoomout_core.assets.stored_map import StoredMap, stored_map_from
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_document import INSTANCES, PLACE, STORED_MAP, Document
from zoomout_core.mesh.formats.gltf_scene import FAN, STRIP, TRIANGLES, GltfMesh, Skeleton, read_scene, sparse_weights
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.messages import plural_warning
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

# Beginnings of the names of extensions that do not change the shape: of materials, textures, lights and avatars.
OF_LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "VRM")
# Rounding difference of two bind matrices, relative to the largest entry.
SAME = 1e-4


def read_gltf(path: Path, folders: Iterable[Path] = ()) -> Asset:
    """Read a glTF or GLB file.

    Args:
        path: the file.
        folders: further folders in which its buffers and images may be.

    Raises:
        MeshError: it cannot be read, is compressed, or has no triangles.
        ImportError: pygltflib is not installed.
    """
    scene = read_scene(path, folders)
    if scene is None:
        raise MeshError(f"{path} contains no triangles: choose a file with a surface.")
    document, nodes, meshes, skeleton, matrices, surface = scene
    attributes = [
        *_corner_attributes(meshes, matrices),
        *_shape_keys(meshes, matrices),
        material_numbers(np.concatenate([mesh.material for mesh in meshes])),
    ]
    skin, materials = _skin(skeleton, meshes, surface.vertices), materials_of(document)
    return Asset(
        surface,
        tuple(attributes),
        materials,
        skin,
        document,
        (*_omissions(path, document, nodes), *_without_weights(path, meshes), *document.notes),
        objects=tuple((document.gltf.nodes[mesh.node].name or "", len(mesh.vertices)) for mesh in meshes),
        nodes=tuple(mesh.node for mesh in meshes),
        look=document,
        stored_map=_stored_map(document, meshes),
    )


def _stored_map(document: Document, meshes: Sequence[GltfMesh]) -> StoredMap | None:
    """The map that a file stores; None unless all meshes have it."""
    places = [mesh.place for mesh in meshes if mesh.place is not None]
    if len(places) < len(meshes):
        return None
    return stored_map_from(np.concatenate(places), (document.gltf.asset.extras or {}).get(STORED_MAP))


def _omissions(path: Path, document: Document, nodes: Sequence[int]) -> list[str]:
    """Notes on the parts of a scene that an asset does not include."""
    meshes = [document.gltf.meshes[document.gltf.nodes[node].mesh] for node in nodes]
    found = []
    if any(each.mode not in (None, TRIANGLES, STRIP, FAN) for mesh in meshes for each in mesh.primitives):
        found.append(f"{path.name} contains points or lines, which are left out.")
    if any(INSTANCES in (document.gltf.nodes[node].extensions or {}) for node in nodes):
        found.append(f"{path.name} contains copies of meshes ({INSTANCES}), of which only the original is read.")
    primitives = [each for mesh in meshes for each in mesh.primitives if each.attributes]
    names = {name for each in primitives for name in vars(each.attributes)}
    if own := sorted(name for name in names if name.startswith("_") and name != PLACE):
        found.append(f"{path.name} contains the vertex attributes {', '.join(own)}, which are left out.")
    needed = {name for name in document.gltf.extensionsRequired or [] if not name.startswith(OF_LOOKS)}
    if unknown := sorted(needed - {INSTANCES, QUANTIZED}):
        found.append(f"{path.name} requires {', '.join(unknown)}, which is not read: check the meshes.")
    return found


def _without_weights(path: Path, meshes: Sequence[GltfMesh]) -> list[str]:
    """A note on vertices of skinned meshes without weights."""
    count = sum(mesh.bare for mesh in meshes)
    if not count:
        return []
    return [
        plural_warning(
            count,
            "1 vertex in {name} has no skin weights and follows the first joint that it lists, as in Blender: check "
            "whether it moves with the vertices around it.",
            "{count:,} vertices in {name} have no skin weights and follow the first joint that they list, as in "
            "Blender: check whether they move with the vertices around them.",
            name=path.name,
        )
    ]


# --- attributes ---------------------------------------------------------------------------------------------


def _corner_attributes(meshes: Sequence[GltfMesh], matrices: Sequence[Floats]) -> list[Attribute]:
    """Texture coordinates, colours and normals of all corners; zero, or white, if a mesh has none."""
    found = []
    for name in sorted({name for mesh in meshes for name in mesh.corners}, key=by_number):
        width = max(mesh.corners[name].shape[1] for mesh in meshes if name in mesh.corners)
        blank = 1.0 if name.startswith("COLOR_") else 0.0
        values = [
            np.full((mesh.triangles.size, width), blank) if name not in mesh.corners else mesh.corners[name]
            for mesh in meshes
        ]
        if name == "NORMAL":
            if all(name in mesh.corners for mesh in meshes):
                turned = [_turn(*each) for each in zip(values, meshes, matrices, strict=True)]
                found.append(Attribute(NORMALS, Domain.CORNER, Kind.NORMAL, np.concatenate(turned)))
            continue
        filled = [np.hstack([each, np.ones((len(each), width - each.shape[1]))]) for each in values]
        whole, number = np.concatenate(filled), name.rpartition("_")[2]
        if name.startswith("COLOR_"):
            found.append(Attribute(f"{COLOR} {number}", Domain.CORNER, Kind.COLOR, whole))
        else:
            found.append(Attribute(f"{UV} {number}", Domain.CORNER, Kind.UV, whole * [1, -1] + [0, 1]))
    return found


def _turn(normals: Floats, mesh: GltfMesh, matrices: Floats) -> Floats:
    """Normals (3 m, 3) of the posed mesh."""
    inverse = np.linalg.pinv(matrices[:, :, :3])[mesh.triangles.ravel()]
    return unit_vectors(np.einsum("cyx,cy->cx", inverse, normals))


def _shape_keys(meshes: Sequence[GltfMesh], matrices: Sequence[Floats]) -> list[Attribute]:
    """Morph targets of all meshes, by name."""
    keys = list(dict.fromkeys(key for mesh in meshes for key in mesh.keys))
    if not keys:
        return []
    offsets = [np.zeros((len(mesh.vertices), len(keys), 3)) for mesh in meshes]
    for each, mesh, matrix in zip(offsets, meshes, matrices, strict=True):
        each[:, [keys.index(key) for key in mesh.keys]] = np.einsum("nxy,nky->nkx", matrix[:, :, :3], mesh.offsets)
    return [Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, np.concatenate(offsets), tuple(keys))]


def materials_of(document: Document) -> tuple[Material, ...]:
    """The materials of a document, restricted to what every format can store."""
    materials = []
    for number, material in enumerate(document.gltf.materials):
        look = material.pbrMetallicRoughness
        color = look.baseColorFactor if look is not None and look.baseColorFactor else [1.0, 1.0, 1.0, 1.0]
        texture = None if look is None else look.baseColorTexture
        image = None if texture is None else document.image_of(texture.index)
        materials.append(Material(material.name or f"Material {number + 1}", tuple(color), image))
    return tuple(materials)


# --- joints -------------------------------------------------------------------------------------------------


def _skin(skeleton: Skeleton, meshes: Sequence[GltfMesh], seen: Floats) -> Skin | None:
    """Make one skin for all meshes, with posed positions (n, 3)."""
    if not len(skeleton.nodes):
        return None
    weights = csr_array(vstack([_weights(skeleton, mesh) for mesh in meshes]))
    rest, linear = to_rest(seen, weights, skeleton.transforms)
    start = 0
    for mesh in meshes:
        if mesh.skin is not None and _is_bound_alike(skeleton, mesh.skin):
            rest[start : start + len(mesh.vertices)] = mesh.vertices
        start += len(mesh.vertices)
    number = {node: joint for joint, node in enumerate(skeleton.nodes.tolist())}
    names = (skeleton.document.gltf.nodes[node].name or f"Joint {node}" for node in skeleton.nodes.tolist())
    parents = [number.get(skeleton.ancestor(int(skeleton.parent[node])), -1) for node in skeleton.nodes.tolist()]
    return Skin(
        skeleton.nodes, tuple(names), np.array(parents), skeleton.bind, skeleton.transforms, rest, linear, weights
    )


def _weights(skeleton: Skeleton, mesh: GltfMesh) -> csr_array:
    """(n, b) weights of the joints of all skins; a vertex without weight follows its parent joint, or the first."""
    count, size = len(mesh.vertices), (len(mesh.vertices), len(skeleton.nodes))
    above = skeleton.ancestor(mesh.node)
    hanging = 0 if above < 0 else int(np.searchsorted(skeleton.nodes, above))
    rows = np.arange(count)[:, None]
    if mesh.skin is None:
        return sparse_weights(rows, np.full((count, 1), hanging), np.ones((count, 1)), size)
    joint = np.searchsorted(skeleton.nodes, skeleton.skins[mesh.skin][0])[mesh.joint]
    none = mesh.weight.sum(axis=1, keepdims=True) <= 0
    joint, weight = np.hstack([joint, np.full((count, 1), hanging)]), np.hstack([mesh.weight, none])
    return normalise(sparse_weights(rows, joint, weight, size))


def _is_bound_alike(skeleton: Skeleton, number: int) -> bool:
    """Whether a skin binds its joints like the first skin that has them."""
    nodes, inverse_bind = skeleton.skins[number]
    common = skeleton.bind[np.searchsorted(skeleton.nodes, nodes)]
    return bool(np.abs(inverse_bind - common).max() <= SAME * np.abs(common).max())
