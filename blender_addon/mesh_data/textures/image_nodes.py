# SPDX-License-Identifier: GPL-3.0-or-later
"""The image textures of materials: their use, their UVs, and copies that use other images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from bpy.types import Image, Material, Node, NodeSocket, ShaderNodeTexImage

from zoomout_core.arrays import Floats
from zoomout_core.messages import message

from .images import ImageFormat, format_of

READABLE = ("FILE", "GENERATED", "TILED")
NO_UV = message("it is not placed by a UV map")


@dataclass(frozen=True)
class ImageRole:
    """The purpose of an image; images of one role in several materials are baked into one image.

    Attributes:
        inputs: the names of the shaders' inputs that depend on them.
        number: counts the images of a material with the same inputs.
        format: the images' format.
        normals: whether they are normal maps in tangent space.
    """

    inputs: tuple[str, ...]
    number: int
    format: ImageFormat
    normals: bool


@dataclass(frozen=True, eq=False)
class ImageUse:
    """An image texture of a material.

    Attributes:
        node: the name of its node.
        role: its use.
        image: the full name of the image.
        uv_map: the name of its UV map; None for the active one.
        placing: (2, 3) the linear part and the translation that take UVs to places in the image.
    """

    node: str
    role: ImageRole
    image: str
    uv_map: str | None
    placing: Floats


def read_image_uses(material: Material) -> tuple[list[ImageUse], dict[str, str]]:
    """The image textures of a material, and the reasons why others cannot be baked, by the names of their images."""
    found, left_out = list[ImageUse](), dict[str, str]()
    if material.node_tree is None:
        return found, left_out
    for node in material.node_tree.nodes:
        if isinstance(node, ShaderNodeTexImage) and node.image is not None and not node.mute:
            inputs, normals = _inputs_of(node)
            if not inputs:
                continue
            placed = _placing(node)
            if node.image.source not in READABLE:
                left_out[node.image.name] = message("it is a movie or a sequence")
            elif placed is None or node.projection != "FLAT":
                left_out[node.image.name] = NO_UV
            else:
                uv_map, placing = placed
                form = format_of(node.image)
                same = sum(use.role.inputs == inputs and use.role.format == form for use in found)
                role = ImageRole(inputs, same, form, normals)
                found.append(ImageUse(node.name, role, node.image.name_full, uv_map, placing))
        elif node.type == "GROUP" and node.node_tree is not None:
            for inner in node.node_tree.nodes:
                if isinstance(inner, ShaderNodeTexImage) and inner.image is not None:
                    left_out[inner.image.name] = message("it is inside a node group")
    return found, left_out


def copy_with_images(material: Material, name: str, images: Mapping[str, Image], uv_map: str) -> Material:
    """A copy of a material, whose nodes named in `images` show these images on a UV map."""
    copy = material.copy()
    copy.name = name
    tree = copy.node_tree
    for number, (node_name, image) in enumerate(images.items()):
        node = tree.nodes[node_name]
        node.image, node.extension = image, "EXTEND"
        placing = tree.nodes.new("ShaderNodeUVMap")
        placing.uv_map, placing.location = uv_map, (node.location.x - 200, node.location.y - 40 * number)
        tree.links.new(placing.outputs["UV"], node.inputs["Vector"])
    for node in tree.nodes:
        if node.type in ("NORMAL_MAP", "TANGENT") and images:
            node.uv_map = uv_map
    return copy


def _inputs_of(node: Node) -> tuple[tuple[str, ...], bool]:
    """The inputs of shaders that depend on a node, and whether it is used as a normal map."""
    inputs, normals = set[str](), False
    waiting, seen = list(node.outputs), set[str]()
    while waiting:
        for link in waiting.pop().links:
            there = link.to_node
            normals |= there.type == "NORMAL_MAP" and link.to_socket.name == "Color"
            if there.type in ("GROUP", "OUTPUT_MATERIAL") or any(out.type == "SHADER" for out in there.outputs):
                inputs.add(link.to_socket.name)
            elif there.name not in seen and not isinstance(there, ShaderNodeTexImage):
                seen.add(there.name)
                waiting += there.outputs
    return tuple(sorted(inputs)), normals


def _placing(node: Node) -> tuple[str | None, Floats] | None:
    """The UV map of an image texture and the placing of its image there; None if it is not placed by a UV map."""
    placing = np.eye(2, 3)
    socket = _origin(node.inputs["Vector"])
    if socket is not None and socket.node.type == "MAPPING":
        mapping = socket.node
        if mapping.vector_type not in ("POINT", "TEXTURE") or any(each.is_linked for each in list(mapping.inputs)[1:]):
            return None
        placing = _placement(mapping)
        socket = _origin(mapping.inputs["Vector"])
        if socket is None:
            return None
    if socket is None:
        return None, placing
    if socket.node.type == "UVMAP":
        return socket.node.uv_map or None, placing
    if socket.node.type == "TEX_COORD" and socket.name == "UV":
        return None, placing
    return None


def _origin(socket: NodeSocket) -> NodeSocket | None:
    """The output that an input takes its values from, through reroutes."""
    while socket.is_linked:
        socket = socket.links[0].from_socket
        if socket.node.type != "REROUTE":
            return socket
        socket = socket.node.inputs[0]
    return None


def _placement(mapping: Node) -> Floats:
    """(2, 3) the map of a Mapping node between points of the plane."""
    place, turn, size = (np.array(mapping.inputs[name].default_value) for name in ("Location", "Rotation", "Scale"))
    cosine, sine = np.cos(turn[2]), np.sin(turn[2])
    linear = np.array([[cosine, -sine], [sine, cosine]]) * size[:2]
    if mapping.vector_type == "TEXTURE":
        linear = np.linalg.pinv(linear)
        return np.column_stack([linear, -linear @ place[:2]])
    return np.column_stack([linear, place[:2]])
