# SPDX-License-Identifier: GPL-3.0-or-later
"""The faults of a VRM file, by the specifications of VRM 0 and 1: https://github.com/vrm-c/vrm-specification."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

from vrm_files import tree_of

from zoomout_core.mesh.formats.gltf_document import Document

LIMBS = [f"{side}{part}" for side in ("left", "right") for part in ("UpperLeg", "LowerLeg", "Foot", "UpperArm")]
LIMBS += [f"{side}{part}" for side in ("left", "right") for part in ("LowerArm", "Hand")]
REQUIRED_1 = {"hips", "spine", "head", *LIMBS}
REQUIRED_0 = REQUIRED_1 | {"chest", "neck"}
# The bones above a bone, of which the nearest one that exists is its parent.
TORSO = ("upperChest", "chest", "spine", "hips")
ABOVE = {"spine": ("hips",), "chest": TORSO[2:], "upperChest": TORSO[1:], "neck": TORSO, "head": ("neck", *TORSO)}
ABOVE |= {"leftEye": ("head",), "rightEye": ("head",), "jaw": ("head",)}
for _side in ("left", "right"):
    ABOVE |= {f"{_side}UpperLeg": ("hips",), f"{_side}LowerLeg": (f"{_side}UpperLeg",)}
    ABOVE |= {f"{_side}Foot": (f"{_side}LowerLeg",), f"{_side}Shoulder": TORSO}
    ABOVE |= {f"{_side}UpperArm": (f"{_side}Shoulder", *TORSO), f"{_side}LowerArm": (f"{_side}UpperArm",)}
    ABOVE |= {f"{_side}Hand": (f"{_side}LowerArm",)}
PRESETS_1 = {"happy", "angry", "sad", "relaxed", "surprised", "aa", "ih", "ou", "ee", "oh", "blink", "blinkLeft"}
PRESETS_1 |= {"blinkRight", "lookUp", "lookDown", "lookLeft", "lookRight", "neutral"}
FLAGS_0 = {"Auto", "FirstPersonOnly", "ThirdPersonOnly", "Both"}
FLAGS_1 = {"auto", "firstPersonOnly", "thirdPersonOnly", "both"}


def faults(path: Path) -> list[str]:
    """The faults of a file, each in a few words; the reader itself checks the numbers of glTF."""
    document, tree = Document(path), tree_of(path)
    found = [*_faults_of_meshes(document, tree), *_faults_of_declarations(tree)]
    extensions = tree.get("extensions", {})
    if "VRM" not in extensions and "VRMC_vrm" not in extensions:
        found.append("no avatar")
    if "VRM" in extensions:
        found += _faults_0(extensions["VRM"], tree)
    if "VRMC_vrm" in extensions:
        found += _faults_1(extensions["VRMC_vrm"], tree)
    if "VRMC_springBone" in extensions:
        found += _faults_of_springs(extensions["VRMC_springBone"], tree)
    return found


def _faults_of_meshes(document: Document, tree: dict[str, Any]) -> Iterator[str]:
    for number, mesh in enumerate(tree["meshes"]):
        counts = {len(primitive.get("targets", ())) for primitive in mesh["primitives"]}
        if len(counts) > 1:
            yield f"mesh {number} has primitives with different morph targets"
        names = next(
            (
                part["extras"]["targetNames"]
                for part in (mesh, *mesh["primitives"])
                if "targetNames" in part.get("extras", {})
            ),
            [],
        )
        if max(counts) != len(names) or len(set(names)) < len(names):
            yield f"mesh {number} has {max(counts)} morph targets with the names {names}"
        if len(mesh.get("weights", names)) != len(names):
            yield f"mesh {number} has {len(mesh['weights'])} weights"
    for number, node in enumerate(tree["nodes"]):
        if "skin" in node and "mesh" not in node:
            yield f"node {number} has a skin and no mesh"
        if "skin" in node and "mesh" in node:
            joints = tree["skins"][node["skin"]]["joints"]
            if len(set(joints)) < len(joints):
                yield f"skin {node['skin']} has a joint twice"
            for primitive in document.gltf.meshes[node["mesh"]].primitives:
                if document.array(primitive.attributes.JOINTS_0).max() >= len(joints):
                    yield f"mesh {node['mesh']} has joints that skin {node['skin']} has not"
    for animation in document.gltf.animations:
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            if channel.target.path == "weights":
                mesh = tree["nodes"][channel.target.node].get("mesh")
                targets = 0 if mesh is None else len(tree["meshes"][mesh]["primitives"][0].get("targets", ()))
                times = tree["accessors"][sampler.input]["count"]
                if not targets or tree["accessors"][sampler.output]["count"] != times * targets:
                    yield f"the animated weights of node {channel.target.node} are not those of its morph targets"


def _faults_of_declarations(tree: dict[str, Any]) -> Iterator[str]:
    used, required = set(tree.get("extensionsUsed", ())), set(tree.get("extensionsRequired", ()))

    def occurring(part: Any) -> Iterator[str]:
        if isinstance(part, dict):
            yield from part.get("extensions", ())
            for each in part.values():
                yield from occurring(each)
        elif isinstance(part, list):
            for each in part:
                yield from occurring(each)

    yield from (f"{name} is not declared" for name in set(occurring(tree)) - used)
    yield from (f"{name} is required and not used" for name in required - used)


def _faults_of_bones(bones: dict[str, Any], required: set[str], tree: dict[str, Any]) -> Iterator[str]:
    nodes = tree["nodes"]
    parent = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    yield from (f"the bone {name} is missing" for name in required - bones.keys())
    yield from _out_of_range("bones", bones.values(), nodes)
    yield from (f"node {node} is several bones" for node, count in Counter(bones.values()).items() if count > 1)
    for name, node in bones.items():
        above = next((bones[each] for each in ABOVE.get(name, ()) if each in bones), None)
        if above is not None and above not in _ancestors(node, parent):
            yield f"the bone {name} is not below its parent"


def _ancestors(node: int, parent: dict[int, int]) -> Iterator[int]:
    while node in parent:
        node = parent[node]
        yield node


def _out_of_range(what: str, numbers: Iterable[Any], table: Iterable[Any]) -> Iterator[str]:
    count = len(list(table))
    yield from (
        f"{what}: {number} of {count}" for number in numbers if not (isinstance(number, int) and 0 <= number < count)
    )


def _faults_0(vrm: dict[str, Any], tree: dict[str, Any]) -> Iterator[str]:
    listed = vrm["humanoid"]["humanBones"]
    bones = {each["bone"]: each["node"] for each in listed}
    if len(bones) < len(listed):
        yield "a bone is listed twice"
    yield from _faults_of_bones(bones, REQUIRED_0, tree)
    groups = vrm["blendShapeMaster"]["blendShapeGroups"]
    known = [each["name"] if each["presetName"] == "unknown" else each["presetName"] for each in groups]
    yield from (f"the expression {name} is there twice" for name, count in Counter(known).items() if count > 1)
    for group in groups:
        for bind in group.get("binds", ()):
            wrong = list(_out_of_range(f"meshes of {group['name']}", [bind["mesh"]], tree["meshes"]))
            yield from wrong
            if not wrong:
                targets = tree["meshes"][bind["mesh"]]["primitives"][0].get("targets", ())
                yield from _out_of_range(f"morph targets of {group['name']}", [bind["index"]], targets)
        names = {material["name"] for material in tree["materials"]}
        for value in group.get("materialValues", ()):
            if value["materialName"] not in names:
                yield f"{group['name']} has the material {value['materialName']}"
    annotations = vrm["firstPerson"].get("meshAnnotations", [])
    yield from _out_of_range("annotations", [each["mesh"] for each in annotations], tree["meshes"])
    yield from _faults_of_annotations(annotations, "mesh", "firstPersonFlag", FLAGS_0)
    if len(vrm["materialProperties"]) != len(tree["materials"]):
        yield f"{len(vrm['materialProperties'])} properties of {len(tree['materials'])} materials"
    for properties, material in zip(vrm["materialProperties"], tree["materials"], strict=False):
        if properties["name"] != material["name"]:
            yield f"the properties of {material['name']} are those of {properties['name']}"
        textures = properties["textureProperties"].values()
        yield from _out_of_range("textures of materials", textures, tree.get("textures", ()))
    if "texture" in vrm["meta"]:
        yield from _out_of_range("thumbnail", [vrm["meta"]["texture"]], tree.get("textures", ()))
    springs = vrm["secondaryAnimation"]
    for group in springs["boneGroups"]:
        yield from _out_of_range("springs", group["bones"], tree["nodes"])
        yield from _out_of_range("colliders of springs", group["colliderGroups"], springs["colliderGroups"])
    yield from _out_of_range("colliders", [each["node"] for each in springs["colliderGroups"]], tree["nodes"])


def _faults_1(vrm: dict[str, Any], tree: dict[str, Any]) -> Iterator[str]:
    bones = {name: each["node"] for name, each in vrm["humanoid"]["humanBones"].items()}
    yield from _faults_of_bones(bones, REQUIRED_1, tree)
    yield from (f"meta has no {name}" for name in ("name", "authors", "licenseUrl") if not vrm["meta"].get(name))
    if "thumbnailImage" in vrm["meta"]:
        yield from _out_of_range("thumbnail", [vrm["meta"]["thumbnailImage"]], tree.get("images", ()))
    expressions = vrm.get("expressions", {})
    presets, custom = expressions.get("preset", {}), expressions.get("custom", {})
    yield from (f"{name} is no preset" for name in presets.keys() - PRESETS_1)
    yield from (f"{name} is a preset" for name in custom.keys() & PRESETS_1)
    for name, expression in (*presets.items(), *custom.items()):
        for bind in expression.get("morphTargetBinds", ()):
            mesh = tree["nodes"][bind["node"]].get("mesh")
            targets = () if mesh is None else tree["meshes"][mesh]["primitives"][0].get("targets", ())
            yield from _out_of_range(f"morph targets of {name}", [bind["index"]], targets)
        materials = [
            bind["material"]
            for part in ("materialColorBinds", "textureTransformBinds")
            for bind in expression.get(part, ())
        ]
        yield from _out_of_range(f"materials of {name}", materials, tree["materials"])
    annotations = vrm.get("firstPerson", {}).get("meshAnnotations", [])
    yield from _faults_of_annotations(annotations, "node", "type", FLAGS_1)
    for each in annotations:
        if "mesh" not in tree["nodes"][each["node"]]:
            yield f"the annotation of node {each['node']} has no mesh"
    for number, node in enumerate(tree["nodes"]):
        constraint = node.get("extensions", {}).get("VRMC_node_constraint", {}).get("constraint", {})
        sources = [each["source"] for each in constraint.values()]
        yield from _out_of_range("sources of constraints", sources, tree["nodes"])
        if number in sources:
            yield f"node {number} constrains itself"
    for material in tree["materials"]:
        toon = material.get("extensions", {}).get("VRMC_materials_mtoon", {})
        textures = [each["index"] for name, each in toon.items() if name.endswith("Texture")]
        yield from _out_of_range("textures of toon materials", textures, tree.get("textures", ()))


def _faults_of_annotations(annotations: list[dict[str, Any]], what: str, name: str, flags: set[str]) -> Iterator[str]:
    yield from (f"an annotation is {each[name]}" for each in annotations if each[name] not in flags)
    counts = Counter(each[what] for each in annotations)
    yield from (f"{what} {number} has {count} annotations" for number, count in counts.items() if count > 1)


def _faults_of_springs(springs: dict[str, Any], tree: dict[str, Any]) -> Iterator[str]:
    nodes, colliders = tree["nodes"], springs["colliders"]
    parent = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    yield from _out_of_range("colliders", [each["node"] for each in colliders], nodes)
    for group in springs["colliderGroups"]:
        yield from _out_of_range("colliders of groups", group["colliders"], colliders)
    chains = [[joint["node"] for joint in spring["joints"]] for spring in springs["springs"]]
    for spring, chain in zip(springs["springs"], chains, strict=True):
        yield from _out_of_range("joints of springs", chain, nodes)
        yield from _out_of_range("groups of springs", spring.get("colliderGroups", ()), springs["colliderGroups"])
        for above, below in pairwise(chain):
            if above not in _ancestors(below, parent):
                yield f"the joint {below} is not below {above}"
        if "center" in spring and spring["center"] not in (chain[0], *_ancestors(chain[0], parent)):
            yield f"the centre {spring['center']} is not above its spring"
    yield from (
        f"{node} is in {n} springs" for node, n in Counter(node for each in chains for node in each).items() if n > 1
    )
