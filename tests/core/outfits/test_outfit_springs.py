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
from zoomout_core.mesh.formats.glb import pack_glb
from zoomout_core.mesh.formats.gltf_document import Document
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
                {
                    "comment": "tassel",
                    "center": -1,
                    "stiffiness": 0.7,
                    "hitRadius": 0.05,
                    "bones": [ROOT],
                    "colliderGroups": [0],
                }
            ],
            "colliderGroups": [{"node": SPINE, "colliders": [{"offset": {"x": 0, "y": 0, "z": -0.3}, "radius": 0.1}]}],
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
                "colliders": [{"node": SPINE, "shape": {"sphere": {"offset": [0, 0, 0.3], "radius": 0.1}}}],
                "colliderGroups": [{"colliders": [0]}],
                "springs": [
                    {
                        "name": "tassel",
                        "joints": [{"node": node, "stiffness": 0.7, "hitRadius": 0.05} for node in NODES],
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


def hit_radius_of(path: Path) -> float:
    """The radius of the joints of the only chain, or of its first one."""
    extensions = parse_gltf(path.read_bytes())[0]["extensions"]
    if "VRM" in extensions:
        return float(extensions["VRM"]["secondaryAnimation"]["boneGroups"][0]["hitRadius"])
    return float(extensions["VRMC_springBone"]["springs"][0]["joints"][0]["hitRadius"])


def sphere_of(path: Path) -> tuple[np.ndarray, float]:
    """The place (3,) and radius of the only collider of an avatar, in the scene."""
    extensions, worlds = parse_gltf(path.read_bytes())[0]["extensions"], Document(path).worlds()[0]
    if "VRM" in extensions:
        (group,) = extensions["VRM"]["secondaryAnimation"]["colliderGroups"]
        (sphere,) = group["colliders"]
        node, offset = group["node"], [sphere["offset"]["x"], sphere["offset"]["y"], -sphere["offset"]["z"]]
    else:
        (collider,) = extensions["VRMC_springBone"]["colliders"]
        node, sphere = collider["node"], collider["shape"]["sphere"]
        offset = sphere["offset"]
    return worlds[node, :3, :3] @ offset + worlds[node, :3, 3], sphere["radius"]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(("version", "other"), [(0, 1), (1, 0), (0, 0), (1, 1)])
def test_chains_swing_on_the_other_avatar(version: int, other: int, dolls: Path, tmp_path: Path) -> None:
    outfit, avatar, output = (tmp_path / f"{name}.vrm" for name in ("outfit", "avatar", "output"))
    as_vrm(dolls / "dressed.glb", outfit, version, has_springs=True)
    as_vrm(dolls / "naked.glb", avatar, other, has_springs=False)
    parts, target = split_avatar(read_asset(outfit)), read_asset(avatar)
    assert parts.worn is not None
    assert target.document is not None
    shape = parts.body.surface.vertices * [1.15, 1, 1] + [0, 0, 0.5]
    made = dress_avatar(shape, parts.body, parts.worn, split_avatar(target, wears=False).body)
    assert append_to_gltf(target.document, made.joints, made.clothes, output, made.partners) == ()
    end = ["Tassel end end"] if (version, other) == (0, 1) else []
    assert chains_of(parse_gltf(output.read_bytes())[0]) == [([*CHAIN, *end], ["J_Spine"], 0.7)]
    written = Document(output)
    worlds, parents = written.worlds()
    names = [node.name for node in written.gltf.nodes]
    assert names[parents[names.index("Tassel 1")]] == "J_Hips"
    for name, place in CHAIN.items():
        wanted = place * np.array([1.15, 1, 1]) + [0, 0, 0.5]
        assert np.linalg.norm(worlds[names.index(name), :3, 3] - wanted) < 0.1
    # The collider stays in its place inside the body, which its bone does not follow.
    place, radius = sphere_of(output)
    assert np.linalg.norm(place - [0, HEIGHTS["Spine"], 0.3 + 0.5]) < 0.1
    assert 1.01 < radius / 0.1 < 1.15
    assert 1.01 < hit_radius_of(output) / 0.05 < 1.15


def test_partners_know_the_axes_of_both_bones(dolls: Path) -> None:
    parts, target = split_avatar(read_asset(dolls / "dressed.glb")), read_asset(dolls / "naked.glb")
    assert parts.worn is not None
    assert target.document is not None
    spine = target.document.gltf.nodes[SPINE]
    spine.rotation, spine.scale = [0, 0, np.sqrt(0.5), np.sqrt(0.5)], [2, 2, 2]
    # The avatar has no partner for what hangs from the spine, so that the spine itself stands for it.
    made = dress_avatar(parts.body.surface.vertices, parts.body, parts.worn, split_avatar(target, wears=False).body)
    partner = made.partners[SPINE]
    assert partner.node == SPINE
    assert partner.growth == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(partner.move(np.array([1.0, 0, 0])), [0, -0.5, 0], atol=1e-3)
