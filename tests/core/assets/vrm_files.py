# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a small avatar as a VRM 0 or VRM 1 file, with everything that refers to its nodes, meshes and materials."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
from skinned_tubes import PNG

from zoomout_core.mesh.formats.gltf_buffer import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer
from zoomout_core.mesh.formats.gltf_files import parse_gltf
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

# Each bone: its parent, and its place relative to it.
BONES: Mapping[str, tuple[str, tuple[float, float, float]]] = {
    "hips": ("", (0, 0.9, 0)),
    "spine": ("hips", (0, 0.1, 0)),
    "chest": ("spine", (0, 0.2, 0)),
    "neck": ("chest", (0, 0.2, 0)),
    "head": ("neck", (0, 0.1, 0)),
    "leftEye": ("head", (0.03, 0.06, 0.08)),
    "leftUpperLeg": ("hips", (0.1, 0, 0)),
    "leftLowerLeg": ("leftUpperLeg", (0, -0.4, 0)),
    "leftFoot": ("leftLowerLeg", (0, -0.4, 0)),
    "rightUpperLeg": ("hips", (-0.1, 0, 0)),
    "rightLowerLeg": ("rightUpperLeg", (0, -0.4, 0)),
    "rightFoot": ("rightLowerLeg", (0, -0.4, 0)),
    "leftUpperArm": ("chest", (0.15, 0.15, 0)),
    "leftLowerArm": ("leftUpperArm", (0.25, 0, 0)),
    "leftHand": ("leftLowerArm", (0.25, 0, 0)),
    "rightUpperArm": ("chest", (-0.15, 0.15, 0)),
    "rightLowerArm": ("rightUpperArm", (-0.25, 0, 0)),
    "rightHand": ("rightLowerArm", (-0.25, 0, 0)),
}
# Nodes after the bones: a chain of hair, a bone that twists with the arm, and the nodes of the meshes.
HAIR, TWIST, BODY, FACE, HAT = (len(BONES) + 1 + offset for offset in (0, 3, 4, 5, 6))
HAT_SHAPE = ball(0.13, (0, 0.1, 0), count=40, seed=3)


def body() -> Surface:
    """The body, in the rest pose."""
    return ball(0.25, (0, 1.1, 0), (1, 1.6, 0.7), count=120, seed=1)


def face() -> Surface:
    """The face, in the rest pose."""
    return ball(0.12, (0, 1.56, 0), count=90, seed=2)


def face_keys(vertices: np.ndarray) -> dict[str, np.ndarray]:
    """Offsets (n, 3) of the morph targets of the face."""
    low = vertices[:, 1] < 1.54
    return {
        "Fcl_Blink": np.where(low, 0, -0.02)[:, None] * [0, 1, 0],
        "Fcl_A": np.where(low, -0.01, 0)[:, None] * [0, 1, 0],
    }


def write_avatar(path: Path, version: int) -> None:
    """Write an avatar of VRM 0 or 1.

    The face has its own skin, its morph targets and two materials; the hat hangs from the head, mirrored, without skin;
    the weights of the face and one of its materials are animated.
    """
    made = gltf.GLTF2(asset=gltf.Asset(version="2.0"), scene=0)
    names = list(BONES)
    made.nodes = [gltf.Node(name="Root", children=[1, BODY, FACE])]
    for name, (_, at) in BONES.items():
        below = [1 + names.index(each) for each, (parent, _) in BONES.items() if parent == name]
        made.nodes.append(gltf.Node(name=f"J_{name}", translation=list(at), children=below))
    made.nodes[1 + names.index("head")].children += [HAIR, HAT]
    made.nodes[1 + names.index("leftLowerArm")].children += [TWIST]
    made.nodes += [
        gltf.Node(name="Hair1", translation=[0, 0.1, -0.1], children=[HAIR + 1]),
        gltf.Node(name="Hair2", translation=[0, -0.1, 0], children=[HAIR + 2]),
        gltf.Node(name="Hair3", translation=[0, -0.1, 0]),
        gltf.Node(name="Twist", translation=[0.1, 0, 0]),
        gltf.Node(name="Body", mesh=0, skin=0),
        gltf.Node(name="Face", mesh=1, skin=1),
        gltf.Node(name="Hat", mesh=2, translation=[0, 0.1, 0.02], scale=[-1.5, 1, 1]),
    ]
    made.scenes = [gltf.Scene(nodes=[0])]
    buffer = Buffer(made)
    view = buffer.add_view(PNG)
    made.images = [gltf.Image(bufferView=view, mimeType="image/png", name=name) for name in ("skin", "thumbnail")]
    made.textures = [gltf.Texture(source=0), gltf.Texture(source=1)]
    for name in ("Skin", "Mouth", "Felt"):
        look = gltf.PbrMetallicRoughness(baseColorTexture=gltf.TextureInfo(index=0))
        made.materials.append(gltf.Material(name=name, pbrMetallicRoughness=look))
    chest, head, eye = (1 + names.index(name) for name in ("chest", "head", "leftEye"))
    heights = {1: 0.9, 2: 1.0, chest: 1.2, head: 1.5, eye: 1.56}
    made.skins = [_skin([1, 2, chest], heights, buffer, "Torso"), _skin([head, eye], heights, buffer, "Skull")]
    made.skins[1].skeleton = head
    for shape, joints, materials, keys in (
        (body(), 3, [0], {}),
        (face(), 2, [0, 1], face_keys(face().vertices)),
        (HAT_SHAPE, 0, [2], {}),
    ):
        made.meshes.append(_mesh(shape, joints, materials, keys, buffer, version))
    made.meshes[1].weights = [0.0, 0.25]
    made.meshes[1].extras = {**(made.meshes[1].extras or {}), "maker": "me"}
    times = buffer.add(np.array([0, 1], "<f4"), bounded=True)
    weights = buffer.add(np.array([0, 0.5, 1, 0.25], "<f4"))
    made.animations = [
        gltf.Animation(
            name="Blink",
            samplers=[gltf.AnimationSampler(input=times, output=weights)],
            channels=[gltf.AnimationChannel(sampler=0, target=gltf.AnimationChannelTarget(node=FACE, path="weights"))],
        )
    ]
    (_describe_0 if version == 0 else _describe_1)(made)
    made.extensionsUsed = sorted({*made.extensions, *("VRMC_node_constraint", "VRMC_materials_mtoon")[: 2 * version]})
    buffer.finish()
    path.write_bytes(b"".join(made.save_to_bytes()))


def _skin(joints: list[int], heights: dict[int, float], buffer: Buffer, name: str) -> gltf.Skin:
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    bind[:, 1, 3] = [-heights[joint] for joint in joints]
    bind[:, :2, 3] -= [[0.03 * (heights[joint] == 1.56), 0] for joint in joints]
    bind[:, 2, 3] -= [0.08 * (heights[joint] == 1.56) for joint in joints]
    matrices = buffer.add(bind.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"))
    return gltf.Skin(name=name, joints=joints, inverseBindMatrices=matrices, extras={"of": name})


def _mesh(
    shape: Surface, joints: int, materials: list[int], keys: dict[str, np.ndarray], buffer: Buffer, version: int
) -> gltf.Mesh:
    count = len(shape.vertices)
    columns = {
        "POSITION": buffer.add(shape.vertices.astype("<f4"), ARRAY_BUFFER, bounded=True),
        "TEXCOORD_0": buffer.add(shape.vertices[:, :2].astype("<f4"), ARRAY_BUFFER),
    }
    if joints:
        height = shape.vertices[:, 1]
        share = (height - height.min()) / np.ptp(height) * (joints - 1)
        low = np.minimum(share.astype(int), joints - 2)
        joint = np.column_stack([low, low + 1, 0 * low, 0 * low]).astype("u1")
        weight = np.column_stack([low + 1 - share, share - low, 0 * share, 0 * share]).astype("<f4")
        joint[weight == 0] = 0
        columns["JOINTS_0"] = buffer.add(joint, ARRAY_BUFFER)
        columns["WEIGHTS_0"] = buffer.add(weight, ARRAY_BUFFER)
    targets = [{"POSITION": buffer.add(each.astype("<f4"), ARRAY_BUFFER, bounded=True)} for each in keys.values()]
    names = {"targetNames": list(keys)} if keys else {}
    of_part = np.arange(len(shape.triangles)) % len(materials)
    primitives = [
        gltf.Primitive(
            attributes=gltf.Attributes(**columns),
            indices=buffer.add(shape.triangles[of_part == part].ravel().astype("<u2"), ELEMENT_ARRAY_BUFFER),
            material=material,
            targets=targets,
            extras=names if version == 0 else {},
        )
        for part, material in enumerate(materials)
    ]
    assert count
    return gltf.Mesh(name=f"Mesh of {count}", primitives=primitives, extras={} if version == 0 else names)


def _describe_0(made: gltf.GLTF2) -> None:
    """Add the extension of VRM 0."""
    names = list(BONES)
    made.extensions = {
        "VRM": {
            "exporterVersion": "",
            "specVersion": "0.0",
            "meta": {"title": "Doll", "author": "me", "licenseName": "CC0", "texture": 1, "reference": ""},
            "humanoid": {"humanBones": [{"bone": name, "node": 1 + at} for at, name in enumerate(names)]},
            "firstPerson": {
                "firstPersonBone": 1 + names.index("head"),
                "meshAnnotations": [
                    {"mesh": 0, "firstPersonFlag": "Both"},
                    {"mesh": 1, "firstPersonFlag": "ThirdPersonOnly"},
                ],
                "lookAtTypeName": "Bone",
            },
            "blendShapeMaster": {
                "blendShapeGroups": [
                    {"name": "Blink", "presetName": "blink", "binds": [{"mesh": 1, "index": 0, "weight": 100}]},
                    {"name": "A", "presetName": "a", "binds": [{"mesh": 1, "index": 1, "weight": 80}]},
                    {"name": "Joy", "presetName": "joy", "binds": [], "materialValues": []},
                    {
                        "name": "Pale",
                        "presetName": "unknown",
                        "binds": [],
                        "materialValues": [
                            {"materialName": "Skin", "propertyName": "_Color", "targetValue": [1, 1, 1, 1]}
                        ],
                    },
                ]
            },
            "secondaryAnimation": {
                "boneGroups": [{"comment": "", "center": -1, "bones": [HAIR], "colliderGroups": [0]}],
                "colliderGroups": [{"node": 1 + names.index("head"), "colliders": []}],
            },
            "materialProperties": [
                {"name": each.name, "shader": "VRM/MToon", "textureProperties": {"_MainTex": 0}, "tagMap": {}}
                for each in made.materials
            ],
        }
    }


def _describe_1(made: gltf.GLTF2) -> None:
    """Add the extensions of VRM 1."""
    at = {name: 1 + number for number, name in enumerate(BONES)}
    binds = [{"node": FACE, "index": index, "weight": weight} for index, weight in ((0, 1.0), (1, 0.8))]
    made.extensions = {
        "VRMC_vrm": {
            "specVersion": "1.0",
            "meta": {
                "name": "Doll",
                "authors": ["me", "you"],
                "licenseUrl": "https://vrm.dev/licenses/1.0/",
                "thumbnailImage": 1,
                "modification": "allowModification",
            },
            "humanoid": {"humanBones": {name: {"node": node} for name, node in at.items()}},
            "firstPerson": {
                "meshAnnotations": [{"node": BODY, "type": "both"}, {"node": FACE, "type": "thirdPersonOnly"}]
            },
            "lookAt": {"offsetFromHeadBone": [0, 0.06, 0], "type": "bone"},
            "expressions": {
                "preset": {
                    "blink": {"morphTargetBinds": binds[:1], "isBinary": False},
                    "aa": {"morphTargetBinds": binds[1:]},
                    "happy": {"morphTargetBinds": []},
                },
                "custom": {
                    "Pale": {
                        "materialColorBinds": [{"material": 0, "type": "color", "targetValue": [1, 1, 1, 1]}],
                        "textureTransformBinds": [{"material": 1, "scale": [1, 1], "offset": [0.5, 0]}],
                    }
                },
            },
        },
        "VRMC_springBone": {
            "specVersion": "1.0",
            "colliders": [{"node": at["head"], "shape": {"sphere": {"offset": [0, 0, 0], "radius": 0.1}}}],
            "colliderGroups": [{"name": "head", "colliders": [0]}],
            "springs": [
                {
                    "name": "Hair",
                    "joints": [{"node": node} for node in (HAIR, HAIR + 1, HAIR + 2)],
                    "colliderGroups": [0],
                    "center": at["head"],
                }
            ],
        },
    }
    constraint = {"roll": {"source": at["leftLowerArm"], "rollAxis": "X", "weight": 0.5}}
    made.nodes[TWIST].extensions = {"VRMC_node_constraint": {"specVersion": "1.0", "constraint": constraint}}
    for material in made.materials:
        material.extensions = {"VRMC_materials_mtoon": {"specVersion": "1.0", "shadeMultiplyTexture": {"index": 0}}}


def tree_of(path: Path) -> dict[str, Any]:
    """The JSON of a file."""
    return parse_gltf(path.read_bytes())[0]


def replace_tree(path: Path, tree: dict[str, Any]) -> None:
    """Replace the JSON of a binary file."""
    binary = parse_gltf(path.read_bytes())[1]
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + len(binary).to_bytes(4, "little") + b"BIN\0" + binary
    path.write_bytes(b"glTF\x02\0\0\0" + (12 + len(chunks)).to_bytes(4, "little") + chunks)
