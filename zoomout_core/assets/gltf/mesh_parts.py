# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of an asset's surface that become the meshes of a glTF document, each on a node.

As long as the surface is that of the document, each mesh stays on its node. The surface of another file becomes one
mesh, on the node of the document's largest mesh, and the nodes of its other meshes become empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zoomout_core.assets.asset import SHAPE_KEYS, Asset
from zoomout_core.mesh.formats.gltf_document import library, morph_target_names

if TYPE_CHECKING:
    from pygltflib import GLTF2, Mesh

# Offsets of a morph target that are no more than rounding to single floats, relative to the extent of the surface.
STILL = 1e-6


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


def parts_on_their_nodes(asset: Asset) -> list[Part]:
    """The parts of a surface that is that of its document, in the order of the document's meshes."""
    ends = np.cumsum([0, *(count for _, count in asset.objects)]).tolist()
    parts = []
    for node, start, stop in zip(asset.nodes, ends[:-1], ends[1:], strict=True):
        mesh = _mesh_on(asset, node)
        number = asset.document.gltf.nodes[node].mesh  # type: ignore[union-attr]
        parts.append(Part(node, start, stop, (node,), {number: mesh}, _keys_of(asset, mesh, start, stop)))
    return sorted(parts, key=lambda part: (*part.origins, part.node))


def whole_part(made: GLTF2, asset: Asset, name: str) -> Part:
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
