# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a tube with two joints as a GLB file, with a UV seam, a morph target and an animation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib as gltf

from zoomout_core.mesh.formats.gltf_buffer import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer
from zoomout_core.samples.grids import grid_faces, triangles_of

RINGS, SIDES, LENGTH = 13, 12, 4.0
# A one-pixel image.
PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c4944415408d763f8cfc0000003010100"
    "18dd8db00000000049454e44ae426082"
)


def tube(rings: int = RINGS, sides: int = SIDES) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (n, 3) with the first column of vertices twice, texture coordinates (n, 2), and triangles (m, 3)."""
    along, around = np.meshgrid(np.linspace(0, 1, rings), np.linspace(0, 1, sides + 1), indexing="ij")
    angle = 2 * np.pi * np.where(around == 1, 0, around)
    radius = (0.4 + 0.2 * along) * (1 + 0.3 * np.cos(2 * angle) + 0.2 * np.sin(angle))
    positions = np.stack([radius * np.cos(angle), LENGTH * along, radius * np.sin(angle)], axis=2).reshape(-1, 3)
    triangles = triangles_of(grid_faces(rings - 1, sides))
    return positions, np.stack([around, along], axis=2).reshape(-1, 2), triangles


def weights_of(height: np.ndarray) -> np.ndarray:
    """(n, 2) weights of the lower and the upper joint."""
    upper = np.clip((height / LENGTH - 0.3) / 0.4, 0, 1)
    return np.column_stack([1 - upper, upper])


def write_tube(path: Path, armature_scale: float = 1.0, bend: float = 0.0, parts: int = 1, bare: bool = False) -> None:
    """Write a tube whose armature node is scaled, with its upper joint bent by an angle in radians.

    Args:
        path: path of the .glb file.
        armature_scale: scale of the node above the joints; the mesh is bound in the frame of that node.
        bend: rotation of the upper joint about z, in radians.
        parts: number of primitives of the mesh, each with its own material.
        bare: whether the last ring, which only the upper joint moves, has no weights, but lists that joint first.
    """
    positions, uv, triangles = tube()
    made = gltf.GLTF2(asset=gltf.Asset(version="2.0"), scene=0, scenes=[gltf.Scene(nodes=[0, 3])])
    buffer = Buffer(made)
    weights = weights_of(positions[:, 1]).astype("<f4")
    joints = np.tile(np.array([[0, 1, 0, 0]], "u1"), (len(positions), 1))
    if bare:
        weights[-SIDES - 1 :], joints[-SIDES - 1 :, 0] = 0, 1
    offsets = np.zeros_like(positions)
    offsets[:, 0] = positions[:, 1] / LENGTH
    columns = {
        "POSITION": buffer.add((positions / armature_scale).astype("<f4"), ARRAY_BUFFER, bounded=True),
        "TEXCOORD_0": buffer.add(uv.astype("<f4"), ARRAY_BUFFER),
        "JOINTS_0": buffer.add(joints, ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(np.hstack([weights, np.zeros_like(weights)]), ARRAY_BUFFER),
    }
    target = buffer.add((offsets / armature_scale).astype("<f4"), ARRAY_BUFFER, bounded=True)
    of_part = (np.arange(len(triangles)) % parts).astype(int)
    primitives = [
        gltf.Primitive(
            attributes=gltf.Attributes(**columns),
            indices=buffer.add(triangles[of_part == part].ravel().astype("<u2"), ELEMENT_ARRAY_BUFFER),
            material=part,
            targets=[{"POSITION": target}],
        )
        for part in range(parts)
    ]
    view = buffer.add_view(PNG)
    made.images = [gltf.Image(bufferView=view, mimeType="image/png")]
    made.textures = [gltf.Texture(source=0)]
    for part in range(parts):
        look = gltf.PbrMetallicRoughness(
            baseColorFactor=[0.5, 0.25, part / 4, 1], baseColorTexture=gltf.TextureInfo(index=0)
        )
        made.materials.append(gltf.Material(name=f"Cloth {part}", pbrMetallicRoughness=look))
    made.meshes = [gltf.Mesh(primitives=primitives, extras={"targetNames": ["Lean"]}, weights=[0.0])]
    inverse_bind = np.tile(np.eye(4), (2, 1, 1))
    inverse_bind[1, 1, 3] = -LENGTH / 2 / armature_scale
    made.skins = [
        gltf.Skin(
            joints=[1, 2], inverseBindMatrices=buffer.add(inverse_bind.transpose(0, 2, 1).reshape(2, 16).astype("<f4"))
        )
    ]
    turn = [0, 0, float(np.sin(bend / 2)), float(np.cos(bend / 2))]
    made.nodes = [
        gltf.Node(name="Armature", children=[1], scale=[armature_scale] * 3),
        gltf.Node(name="Lower", children=[2]),
        gltf.Node(name="Upper", translation=[0, LENGTH / 2 / armature_scale, 0], rotation=turn),
        gltf.Node(name="Tube", mesh=0, skin=0),
    ]
    times = buffer.add(np.array([0, 1], "<f4"), bounded=True)
    turns = buffer.add(np.array([[0, 0, 0, 1], [0, 0, 0.6, 0.8]], "<f4"))
    shares = buffer.add(np.array([0, 1], "<f4"))
    made.animations = [
        gltf.Animation(
            name="Bend",
            samplers=[
                gltf.AnimationSampler(input=times, output=turns),
                gltf.AnimationSampler(input=times, output=shares),
            ],
            channels=[
                gltf.AnimationChannel(sampler=0, target=gltf.AnimationChannelTarget(node=2, path="rotation")),
                gltf.AnimationChannel(sampler=1, target=gltf.AnimationChannelTarget(node=3, path="weights")),
            ],
        )
    ]
    buffer.finish()
    path.write_bytes(b"".join(made.save_to_bytes()))
