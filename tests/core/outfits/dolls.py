# SPDX-License-Identifier: GPL-3.0-or-later
"""Write creatures with joints, some of them in a shirt and trousers with their own joints, as GLB files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib as gltf
from clothes import dress, shell, shirt, trousers
from scipy.sparse import csr_array

from zoomout_core.assets.asset import SHAPE_KEYS, Asset, Material, Skin, material_numbers
from zoomout_core.assets.files import write_asset
from zoomout_core.mesh.formats.gltf_document import Document
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

# Joints of a creature by height, and those that only its trousers have: a chain with an end that moves nothing.
HEIGHTS = {"Hips": -0.5, "Spine": 0.3, "Head": 1.2}
CHAIN = {"Tassel 1": (0.0, -1.0, 0.6), "Tassel 2": (0.0, -1.5, 0.6), "Tassel end": (0.0, -2.0, 0.6)}
KEY = "Wide"


def write_doll(
    path: Path,
    *,
    is_dressed: bool,
    seed: int,
    wide: float = 1.0,
    prefix: str = "",
    count: int = 1500,
) -> None:
    """Write a creature, y up, with a morph target that makes it wider if it wears nothing.

    Args:
        path: the file.
        is_dressed: whether it wears something.
        seed: of the mesh.
        wide: its width.
        prefix: of the names of its joints.
        count: number of vertices of the body.
    """
    pieces = [shell("shirt", shirt(), 0.05, 250, 5), shell("trousers", trousers, 0.05, 250, 6)] if is_dressed else []
    doll = dress(pieces, count, seed)
    vertices = doll.surface.vertices[:, [0, 2, 1]] * [wide, 1, -1]
    names = [prefix + name for name in HEIGHTS] + (list(CHAIN) if is_dressed else [])
    heads = np.array([[0, height, 0] for height in HEIGHTS.values()] + list(CHAIN.values()))[: len(names)]
    parents = np.array([-1, 0, 1, 0, 3, 4])[: len(names)]
    weights = np.zeros((len(vertices), len(names)))
    at = np.interp(vertices[:, 1], list(HEIGHTS.values()), [0, 1, 2])
    for joint in range(3):
        weights[:, joint] = np.maximum(1 - np.abs(at - joint), 0)
    if is_dressed:
        low = doll.parts["trousers"][vertices[doll.parts["trousers"], 1] < -1.2]
        weights[low] = 0
        weights[low, 3:5] = 0.5
    bind = np.tile(np.eye(4), (len(names), 1, 1))
    bind[:, :3, 3] = -heads
    still = np.tile(np.eye(4), (len(names), 1, 1)), vertices, np.tile(np.eye(3), (len(vertices), 1, 1))
    skin = Skin(np.arange(len(names)), tuple(names), parents, bind, *still, csr_array(weights))
    shell_document = gltf.GLTF2(asset=gltf.Asset(version="2.0"), scene=0, scenes=[gltf.Scene(nodes=[0])])
    for joint, name in enumerate(names):
        offset = heads[joint] - (heads[parents[joint]] if joint else 0)
        children = np.flatnonzero(parents == joint).tolist()
        shell_document.nodes.append(gltf.Node(name=name, translation=offset.tolist(), children=children))
    for number, part in enumerate(doll.parts):
        shell_document.scenes[0].nodes.append(len(names) + number)
        shell_document.nodes.append(gltf.Node(name=part.title(), mesh=number, skin=0))
        shell_document.meshes.append(gltf.Mesh(name=part))
    shell_document.skins = [gltf.Skin(joints=list(range(len(names))))]
    shell_document.set_binary_blob(b"")
    parts = list(doll.parts)
    attributes = [material_numbers(np.array([parts.index(name) for name in doll.names]))]
    if not is_dressed:
        offsets = 0.2 * vertices[:, None] * [1, 0, 0]
        attributes.append(Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, offsets, (KEY,)))
    asset = Asset(
        Surface(vertices, doll.surface.triangles),
        tuple(attributes),
        tuple(Material(f"{part} material") for part in parts),
        skin,
        Document.from_gltf(shell_document),
        objects=tuple((part.title(), len(chosen)) for part, chosen in doll.parts.items()),
        nodes=tuple(len(names) + number for number in range(len(parts))),
    )
    write_asset(asset, path)
