# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the surface of an asset as the meshes and skins of a glTF document."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import Asset
from zoomout_core.assets.gltf.mesh_parts import Part, parts_on_their_nodes, whole_part
from zoomout_core.assets.gltf.primitives import place_in_nodes, write_primitives
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.formats.gltf_buffer import Buffer
from zoomout_core.mesh.formats.gltf_document import VARIANTS, VRM_0, Document, library, morph_target_names

if TYPE_CHECKING:
    from pygltflib import GLTF2, Mesh, Primitive


@dataclass(frozen=True, eq=False)
class Renumbering:
    """The new numbers of the items of a document.

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


def write_meshes(
    made: GLTF2, asset: Asset, look: Document | None, buffer: Buffer, name: str
) -> tuple[Renumbering, tuple[str, ...]]:
    """Write the surface of an asset; returns the new numbers of rows that its document refers to, and notes.

    Args:
        made: the document to write, with the nodes, meshes and skins of the asset's document.
        asset: the asset.
        look: the document whose materials are written in full, if there is one.
        buffer: the buffer of the document.
        name: the name of a mesh or node that has none.
    """
    known = bool(asset.nodes) and asset.document is not None
    stays = known and sum(count for _, count in asset.objects) == len(asset.surface.vertices)
    parts = parts_on_their_nodes(asset) if stays else [whole_part(made, asset, name)]
    skins = [_skin_of(part, asset, stays) for part in parts]
    weights = None if asset.skin is None else normalise(asset.skin.weights)
    made.skins = _write_skins(asset, parts, skins, weights, buffer, stays)
    shape = place_in_nodes(asset, parts, skins)
    meshes, notes = [], dict[str, None]()
    for part, skin in zip(parts, skins, strict=True):
        mesh = library().Mesh(name=next((each.name for each in part.origins.values() if each.name), name))
        joints = None if skin is None else made.skins[skin].joints
        mesh.primitives = write_primitives(shape, asset, part, weights, joints, buffer)
        notes |= dict.fromkeys(_keep_free_data(mesh, part, asset, look))
        _name_keys(mesh, part, asset.document)
        meshes.append(mesh)
    for node in made.nodes:
        node.mesh = node.skin = None
    for number, (part, skin) in enumerate(zip(parts, skins, strict=True)):
        made.nodes[part.node].mesh, made.nodes[part.node].skin = number, skin
    made.meshes = meshes
    return _renumber(parts, not stays), tuple(notes)


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
