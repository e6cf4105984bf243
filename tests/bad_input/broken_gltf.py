# SPDX-License-Identifier: GPL-3.0-or-later
"""A small glTF document, and changes that make it contradict the specification, by name."""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from collections.abc import Callable
from typing import Any

from zoomout_core.mesh.formats.gltf_structure import MAX_PARTS

DATA = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 1, 1, 0) + struct.pack("<3H", 0, 1, 2)


def document() -> dict[str, Any]:
    """A triangle with a joint, a morph target and an animation."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [{"children": [1]}, {"name": "Tip", "translation": [0, 1, 0]}, {"mesh": 0}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0}, "indices": 1, "material": 0, "targets": [{"POSITION": 0}]},
                ]
            }
        ],
        "materials": [{"name": "Red", "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
            {"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6},
        ],
        "buffers": [{"byteLength": len(DATA), "uri": f"data:;base64,{b64encode(DATA).decode()}"}],
        "animations": [
            {
                "samplers": [{"input": 2, "output": 0}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
            }
        ],
    }


def content_of(tree: Any) -> bytes:
    return json.dumps(tree).encode()


def changed(*place: str | int, to: Any) -> Callable[[dict[str, Any]], None]:
    """A change that puts a value at a place of the document."""

    def change(tree: dict[str, Any]) -> None:
        *above, last = place
        part: Any = tree
        for key in above:
            part = part[key]
        part[last] = to

    return change


def without(*place: str | int) -> Callable[[dict[str, Any]], None]:
    """A change that removes what is at a place of the document."""

    def change(tree: dict[str, Any]) -> None:
        *above, last = place
        part: Any = tree
        for key in above:
            part = part[key]
        del part[last]

    return change


def changed_to_many() -> Callable[[dict[str, Any]], None]:
    """A change that makes nodes share a mesh whose parts share their corners, so that there are 90 million of these."""

    def change(tree: dict[str, Any]) -> None:
        tree["meshes"][0]["primitives"] *= 3000
        tree["nodes"] += [{"mesh": 0}] * 3000

    return change


def changed_to_fewer() -> Callable[[dict[str, Any]], None]:
    """A change that gives a morph target fewer elements than there are vertices."""

    def change(tree: dict[str, Any]) -> None:
        tree["accessors"].append(tree["accessors"][0] | {"count": 2})
        tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 3}]

    return change


PRIMITIVE = "meshes", 0, "primitives", 0
SPARSE = {
    "count": 1,
    "indices": {"bufferView": 1, "componentType": 5123},
    "values": {"bufferView": 0},
}
# The bytes of coordinates, taken as numbers of elements.
AT_FLOATS = {"indices": {"bufferView": 0, "byteOffset": 14, "componentType": 5123}}
OF_FLOATS = {"indices": {"bufferView": 0, "componentType": 5126}}
BROKEN: dict[str, Callable[[dict[str, Any]], None]] = {
    "a cycle of two nodes": changed("nodes", 1, "children", to=[0]),
    "a node that is its own child": changed("nodes", 0, "children", to=[0]),
    "a cycle beside the tree": changed("nodes", to=[{"mesh": 0}, {"children": [2]}, {"children": [1]}]),
    "the same child twice": changed("nodes", 0, "children", to=[1, 1]),
    "a child of two nodes": changed("nodes", 2, "children", to=[1]),
    "two children at each of forty levels": changed(
        "nodes", to=[*({"children": [number + 1] * 2} for number in range(40)), {"mesh": 0}]
    ),
    "a child that does not exist": changed("nodes", 0, "children", to=[77]),
    "a negative child": changed("nodes", 0, "children", to=[-1]),
    "a child that is a fraction": changed("nodes", 0, "children", to=[0.5]),
    "a child that is text": changed("nodes", 0, "children", to=["1"]),
    "children that are not a list": changed("nodes", 0, "children", to={"0": 1}),
    "a node that is no object": changed("nodes", 1, to=7),
    "nodes that are not a list": changed("nodes", to="nodes"),
    "a matrix of fifteen numbers": changed("nodes", 2, "matrix", to=[1.0] * 15),
    "a rotation of text": changed("nodes", 2, "rotation", to=["a"] * 4),
    "an infinite place": changed("nodes", 2, "translation", to=[float("inf"), 0, 0]),
    "a place of hundreds of digits": changed("nodes", 2, "translation", to=[10**400, 0, 0]),
    "a mesh that does not exist": changed("nodes", 2, "mesh", to=1),
    "a skin that does not exist": changed("nodes", 2, "skin", to=0),
    "a scene that does not exist": changed("scene", to=1),
    "a root that does not exist": changed("scenes", 0, "nodes", to=[0, 9]),
    "positions that do not exist": changed(*PRIMITIVE, "attributes", "POSITION", to=9),
    "positions that are text": changed(*PRIMITIVE, "attributes", "POSITION", to="0"),
    "positions that are true": changed(*PRIMITIVE, "attributes", "POSITION", to=True),
    "a primitive without attributes": without(*PRIMITIVE, "attributes"),
    "a mesh without primitives": without("meshes", 0, "primitives"),
    "a material that does not exist": changed(*PRIMITIVE, "material", to=1),
    "an unknown mode": changed(*PRIMITIVE, "mode", to=9),
    "a target that is a list": changed(*PRIMITIVE, "targets", to=[[0]]),
    "an accessor of unknown numbers": changed("accessors", 0, "componentType", to=5124),
    "an accessor of unknown elements": changed("accessors", 0, "type", to="VEC5"),
    "an accessor of no type": without("accessors", 0, "type"),
    "billions of elements without a view": changed(
        "accessors", 0, to={"componentType": 5126, "count": 4_000_000_000, "type": "VEC3"}
    ),
    "less than no elements": changed("accessors", 0, "count", to=-3),
    "no elements": changed("accessors", 2, "count", to=0),
    "half an element": changed("accessors", 0, "count", to=2.5),
    "more elements than the view has": changed("accessors", 0, "count", to=4),
    "an offset beyond the view": changed("accessors", 0, "byteOffset", to=4),
    "a negative offset": changed("accessors", 0, "byteOffset", to=-4),
    "a view that does not exist": changed("accessors", 0, "bufferView", to=2),
    "a view beyond the buffer": changed("bufferViews", 0, "byteLength", to=1 << 40),
    "a view before the buffer": changed("bufferViews", 1, "byteOffset", to=-6),
    "a view without a length": without("bufferViews", 0, "byteLength"),
    "a buffer that does not exist": changed("bufferViews", 0, "buffer", to=1),
    "a buffer that is missing": changed("buffers", 0, "uri", to="missing.bin"),
    "a buffer without data": without("buffers", 0, "uri"),
    "a buffer of broken data": changed("buffers", 0, "uri", to="data:;base64,A"),
    "a buffer whose name is a number": changed("buffers", 0, "uri", to=5),
    "a change beyond the elements": changed("accessors", 0, "sparse", to=SPARSE | AT_FLOATS),
    "more changes than elements": changed("accessors", 0, "sparse", to=SPARSE | {"count": 1000}),
    "changes at fractions": changed("accessors", 0, "sparse", to=SPARSE | OF_FLOATS),
    "changes without values": changed("accessors", 0, "sparse", to={"count": 1, "indices": SPARSE["indices"]}),
    "an animation of a node that does not exist": changed("animations", 0, "channels", 0, "target", "node", to=8),
    "a channel of a sampler that does not exist": changed("animations", 0, "channels", 0, "sampler", to=1),
    "times that do not exist": changed("animations", 0, "samplers", 0, "input", to=9),
    "a joint that does not exist": changed("skins", to=[{"joints": [9]}]),
    "joints that are not a list": changed("skins", to=[{"joints": 1}]),
    "bind matrices that do not exist": changed("skins", to=[{"joints": [0], "inverseBindMatrices": 9}]),
    "a colour of three numbers": changed("materials", 0, "pbrMetallicRoughness", "baseColorFactor", to=[1, 0, 0]),
    "a texture that does not exist": changed(
        "materials", 0, "pbrMetallicRoughness", "baseColorTexture", to={"index": 0}
    ),
    "an image that does not exist": changed("textures", to=[{"source": 0}]),
    "many copies of a mesh of many copies of itself": changed_to_many(),
    "too many nodes": lambda tree: tree["nodes"].extend({} for _ in range(MAX_PARTS)),
    "too many animations": lambda tree: tree["animations"].extend(
        {"channels": [], "samplers": []} for _ in range(MAX_PARTS)
    ),
    "positions of two numbers": changed("accessors", 0, "type", to="VEC2"),
    "texture coordinates of three numbers": changed(*PRIMITIVE, "attributes", "TEXCOORD_0", to=0),
    "colours of one number": changed(*PRIMITIVE, "attributes", "COLOR_0", to=1),
    "normals of one number": changed(*PRIMITIVE, "attributes", "NORMAL", to=1),
    "joints of three numbers": changed(*PRIMITIVE, "attributes", "JOINTS_0", to=0),
    "corners of three numbers": changed(*PRIMITIVE, "indices", to=0),
    "a target of single numbers": changed(*PRIMITIVE, "targets", to=[{"POSITION": 1}]),
    "fewer targets than vertices": changed_to_fewer(),
    "bind matrices of three numbers": changed("skins", to=[{"joints": [0], "inverseBindMatrices": 0}]),
    "a view of Draco that is not there": changed(
        *PRIMITIVE, "extensions", to={"KHR_draco_mesh_compression": {"bufferView": 99, "attributes": {"POSITION": 0}}}
    ),
}
