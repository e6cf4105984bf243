# SPDX-License-Identifier: GPL-3.0-or-later
"""Spring bones of an outfit on another avatar, from file to file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolls import CHAIN, HEIGHTS

from zoomout_core.assets.files import read_asset
from zoomout_core.assets.gltf.append import append_to_gltf
from zoomout_core.assets.gltf.document import Document
from zoomout_core.mesh.formats.glb import pack_glb
from zoomout_core.mesh.formats.gltf_files import parse_gltf
from zoomout_core.outfits.dress_avatar import dress_avatar
from zoomout_core.outfits.parts import split_avatar

# Nodes of a doll: those of its body, and then the chain.
SPINE, ROOT = 1, len(HEIGHTS)
NODES = range(ROOT, ROOT + len(CHAIN))


def as_vrm(given: Path, path: Path, version: int, *, has_springs: bool) -> None:
    """Write a doll as an avatar, whose chain swings and collides with its spine."""
    tree, binary = parse_gltf(given.read_bytes())
    bones = {name.lower(): number for number, name in enumerate(HEIGHTS)}
    extensions: dict[str, Any]
    if version == 0:
        humanoid = {"humanBones": [{"bone": name, "node": node} for name, node in bones.items()]}
        swinging = {
            "boneGroups": [
                {"comment": "tassel", "center": -1, "stiffiness": 0.7, "bones": [ROOT], "colliderGroups": [0]}
            ],
            "colliderGroups": [{"node": SPINE, "colliders": [{"offset": {"x": 0, "y": 0, "z": 0}, "radius": 0.1}]}],
        }
        extensions = {
            "VRM": {"specVersion": "0.0", "humanoid": humanoid, "secondaryAnimation": swinging if has_springs else {}}
        }
    else:
        extensions = {
            "VRMC_vrm": {
                "specVersion": "1.0",
                "humanoid": {"humanBones": {name: {"node": node} for name, node in bones.items()}},
            }
        }
        if has_springs:
            extensions["VRMC_springBone"] = {
                "specVersion": "1.0",
                "colliders": [{"node": SPINE, "shape": {"sphere": {"offset": [0, 0, 0], "radius": 0.1}}}],
                "colliderGroups": [{"colliders": [0]}],
                "springs": [
                    {
                        "name": "tassel",
                        "joints": [{"node": node, "stiffness": 0.7} for node in NODES],
                        "colliderGroups": [0],
                    }
                ],
            }
    tree["extensions"], tree["extensionsUsed"] = extensions, sorted(extensions)
    path.write_bytes(pack_glb(tree, binary))


def chains_of(tree: dict[str, Any]) -> list[tuple[list[str], list[str], float]]:
    """For each chain the names of its joints, those of the nodes of its colliders, and its stiffness."""
    nodes = tree["nodes"]
    if "VRM" in tree["extensions"]:
        found = []
        groups = tree["extensions"]["VRM"]["secondaryAnimation"]
        for each in groups["boneGroups"]:
            (node,) = each["bones"]
            chain = [node]
            while nodes[chain[-1]].get("children"):
                chain.append(nodes[chain[-1]]["children"][0])
            colliders = [groups["colliderGroups"][group]["node"] for group in each["colliderGroups"]]
            found.append((chain, colliders, each["stiffiness"]))
    else:
        given = tree["extensions"]["VRMC_springBone"]
        of_group = [given["colliders"][each["colliders"][0]]["node"] for each in given["colliderGroups"]]
        found = [
            (
                [joint["node"] for joint in each["joints"]],
                [of_group[group] for group in each["colliderGroups"]],
                each["joints"][0]["stiffness"],
            )
            for each in given["springs"]
        ]
    return [([nodes[n]["name"] for n in chain], [nodes[n]["name"] for n in near], k) for chain, near, k in found]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("version", [0, 1])
def test_chains_swing_on_the_other_avatar(version: int, dolls: Path, tmp_path: Path) -> None:
    outfit, avatar, output = (tmp_path / f"{name}.vrm" for name in ("outfit", "avatar", "output"))
    as_vrm(dolls / "dressed.glb", outfit, version, has_springs=True)
    as_vrm(dolls / "naked.glb", avatar, version, has_springs=False)
    parts, target = split_avatar(read_asset(outfit)), read_asset(avatar)
    assert parts.worn is not None
    assert target.document is not None
    shape = parts.body.surface.vertices * [1.15, 1, 1]
    made = dress_avatar(shape, parts.body, parts.worn, split_avatar(target, wears=False).body)
    assert append_to_gltf(target.document, made.joints, made.clothes, output, made.partners) == ()
    assert chains_of(parse_gltf(output.read_bytes())[0]) == [(list(CHAIN), ["J_Spine"], 0.7)]
    written = Document(output)
    worlds, parents = written.worlds()
    names = [node.name for node in written.gltf.nodes]
    assert names[parents[names.index("Tassel 1")]] == "J_Hips"
    for name, place in CHAIN.items():
        assert np.linalg.norm(worlds[names.index(name), :3, 3] - place * np.array([1.15, 1, 1])) < 0.1
