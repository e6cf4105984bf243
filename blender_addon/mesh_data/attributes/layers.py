# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of meshes: UV maps, colours and other named layers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import astuple, dataclass
from enum import Enum

import bpy
import numpy as np
from bpy.types import Mesh, Object
from numpy.typing import DTypeLike

from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Domain, Kind

from ..arrays import read_array
from .marks import MARK_ATTRIBUTES
from .normals import CUSTOM_NORMAL

# Blender's panels do not allow more UV maps, and it draws no more than these.
MAX_UV_MAPS = 8
# The attributes of a stored match: triangle of the source, barycentric coordinates and confidence of each vertex.
MATCH_ATTRIBUTES = ("zoomout_triangle", "zoomout_barycentric", "zoomout_confidence")
# A further attribute of newer matches: whether a vertex has a partner on the source.
HAS_PARTNER = "zoomout_has_partner"
# Prefix of the names of the attributes that store a mesh's own symmetry.
SYMMETRY_ATTRIBUTES = ".zoomout_symmetry_"
# Prefix of the names of the attributes of links; the dot hides them from Blender's lists.
LINK_ATTRIBUTES = ".zoomout_link_"
# Attributes that other modules read and write: faces' materials, marks of edges and vertices, and custom normals.
READ_ELSEWHERE = MARK_ATTRIBUTES | {"material_index", CUSTOM_NORMAL}
# Types of attributes that may be directions or rotations.
MAY_TURN = frozenset({"FLOAT_VECTOR", "QUATERNION", "FLOAT4X4"})
# Internal attributes with the user's work, and those with the state of editing.
SCULPTED = frozenset({".sculpt_mask", ".sculpt_face_set"})
EDITING_STATES = (".select_", ".hide_", ".uv_select_", ".vs.", ".es.")
PINS = ".pn."
# Prefix of the names that Blender gives to attributes that nodes captured, which have none of the user's.
CAPTURED = ".a_"


ON_FACES = Domain.POINT, Domain.FACE, Domain.CORNER


@dataclass(frozen=True)
class Storage:
    """How Blender stores attributes of one type.

    Attributes:
        kind: meaning of the values, unless the attribute's role implies another.
        element: the property of each element with the value.
        width: count of numbers per value.
        dtype: their type.
        domains: where such values can be transferred, as `RULES` of the core says; panels cannot wait for its import.
    """

    kind: Kind
    element: str
    width: int
    dtype: DTypeLike
    domains: tuple[Domain, ...] = tuple(Domain)


STORAGE = {
    "FLOAT": Storage(Kind.SCALAR, "value", 1, np.float32),
    "FLOAT2": Storage(Kind.VECTOR, "vector", 2, np.float32),
    "FLOAT_VECTOR": Storage(Kind.VECTOR, "vector", 3, np.float32),
    "FLOAT4": Storage(Kind.VECTOR, "vector", 4, np.float32),
    "FLOAT_COLOR": Storage(Kind.COLOR, "color", 4, np.float32),
    "BYTE_COLOR": Storage(Kind.COLOR, "color", 4, np.float32),
    "INT": Storage(Kind.LABEL, "value", 1, np.int32),
    "INT8": Storage(Kind.LABEL, "value", 1, np.int32),
    "INT16_2D": Storage(Kind.LABEL, "value", 2, np.int32),
    "INT32_2D": Storage(Kind.LABEL, "value", 2, np.int32),
    "BOOLEAN": Storage(Kind.BOOLEAN, "value", 1, np.bool_),
    "STRING": Storage(Kind.LABEL, "value", 1, np.bytes_),
    "QUATERNION": Storage(Kind.QUATERNION, "value", 4, np.float32, ON_FACES),
    "FLOAT4X4": Storage(Kind.MATRIX, "value", 16, np.float32, ON_FACES),
}


class Role(Enum):
    """Blender's use of an attribute; the values are the names of options and of lists in the report."""

    UV_MAP = "uv_maps"
    COLOR = "color_attributes"
    GENERIC = "attributes"


@dataclass(frozen=True, eq=False)
class Layer:
    """An attribute, with all that is needed to create it on another mesh.

    Attributes:
        attribute: its values.
        role: Blender's use of it.
        data_type: a key of `STORAGE`.
        turning: whether it is a direction or a rotation, in the mesh's own space, that turns with the surface.
    """

    attribute: Attribute
    role: Role
    data_type: str
    turning: bool = False


@dataclass(frozen=True)
class ActiveLayers:
    """Names of the layers that are shown and edited, and of those that are rendered."""

    uv: str | None
    uv_render: str | None
    color: str | None
    color_render: str | None

    def among(self, names: Collection[str]) -> ActiveLayers:
        """The same active layers, with None in place of names that are not given."""
        return ActiveLayers(*(name if name in names else None for name in astuple(self)))


def read_layers(mesh: Mesh, turning: Collection[str] = ()) -> tuple[list[Layer], dict[str, str]]:
    """UV maps, colour attributes and other attributes, and why some of the others cannot be transferred.

    Args:
        mesh: the mesh to read.
        turning: names of directions and rotations that turn with the surface.

    Returns:
        Layers in the order of Blender's lists, and the reason for each attribute that is left out.
    """
    layers, skipped = [], dict[str, str]()
    for name, role, reason in _list_attributes(mesh):
        if reason is None:
            layers.append(read_layer(mesh, name, role, name in turning))
        elif name.startswith(SYMMETRY_ATTRIBUTES):
            skipped[message("symmetry")] = reason  # of all candidates
        else:
            skipped[name] = reason
    return layers, skipped


def count_layers(mesh: Mesh) -> dict[Role, int]:
    """Number of attributes of each role that `read_layers` would read, without reading their values."""
    return Counter(role for _, role, reason in _list_attributes(mesh) if reason is None)


def _list_attributes(mesh: Mesh) -> Iterator[tuple[str, Role, str | None]]:
    """Name and role of each attribute, in the order of Blender's lists, and why it cannot be transferred, if so.

    Selection, hiding, attributes captured by nodes, and the mesh's own link are left out silently.
    """
    roles = dict.fromkeys(mesh.uv_layers.keys(), Role.UV_MAP)
    roles |= dict.fromkeys(mesh.color_attributes.keys(), Role.COLOR)
    for name in [*roles, *(other.name for other in mesh.attributes if other.name not in roles)]:
        attribute = mesh.attributes[name]
        left_out = name in READ_ELSEWHERE or name.startswith((*EDITING_STATES, CAPTURED, LINK_ATTRIBUTES))
        if not (attribute.is_required or left_out):
            role = roles.get(name, Role.GENERIC)
            yield name, role, _obstacle(attribute)


def untransferable_data(obj: Object, mesh: Mesh) -> dict[str, str]:
    """Data of an object, besides attributes, that cannot be transferred, each with the reason.

    Args:
        obj: the object as it is in the file.
        mesh: its evaluated mesh.
    """
    found = (
        (message("skin radii"), bool(mesh.skin_vertices), "they belong to the edges used by the Skin modifier"),
        (
            message("multires displacement"),
            any(modifier.type == "MULTIRES" for modifier in obj.modifiers),
            "it depends on the faces of the source mesh",
        ),
    )
    return {name: reason for name, present, reason in found if present}


def _kind(attribute: bpy.types.Attribute, role: Role, turning: bool) -> Kind:
    if role is Role.UV_MAP:
        return Kind.UV
    kind = STORAGE[attribute.data_type].kind
    return Kind.DIRECTION if turning and kind is Kind.VECTOR else kind


def is_bookkeeping(name: str) -> bool:
    """Whether an attribute stores a match, a symmetry or a link, which users do not miss on copies."""
    return name in (*MATCH_ATTRIBUTES, HAS_PARTNER) or name.startswith((SYMMETRY_ATTRIBUTES, LINK_ATTRIBUTES))


def _obstacle(attribute: bpy.types.Attribute) -> str | None:
    name = attribute.name
    if name.startswith(SYMMETRY_ATTRIBUTES):
        return "it maps the source mesh onto itself"
    if name in MATCH_ATTRIBUTES or name == HAS_PARTNER:
        return "it belongs to a match in which the source is the target"
    if name.startswith(PINS):
        return "UV pins belong to a single unwrapping of a single mesh"
    if attribute.is_internal and name not in SCULPTED:
        return "it is internal to Blender"
    if attribute.data_type not in STORAGE:
        return message("values of the type {kind} cannot be transferred", kind=attribute.data_type)
    if Domain[attribute.domain] not in STORAGE[attribute.data_type].domains:
        return message("values of the type {kind} cannot be transferred", kind=attribute.data_type)
    return None


def read_layer(mesh: Mesh, name: str, role: Role = Role.GENERIC, turning: bool = False) -> Layer:
    """One attribute of a mesh: values (count,) or (count, width), colours scene-linear, matrices row by row.

    Args:
        mesh: the mesh to read.
        name: name of the attribute.
        role: Blender's use of it.
        turning: whether it turns with the surface; ignored for types that cannot, see `MAY_TURN`.
    """
    attribute = mesh.attributes[name]
    turning = turning and attribute.data_type in MAY_TURN
    kind = _kind(attribute, role, turning)
    values = Attribute(name, Domain[attribute.domain], kind, _read_values(attribute))
    return Layer(values, role, attribute.data_type, turning)


def _read_values(attribute: bpy.types.Attribute) -> np.ndarray:
    storage = STORAGE[attribute.data_type]
    if attribute.data_type == "STRING":  # Blender provides no arrays of strings
        return np.array([element.value for element in attribute.data])
    values = read_array(attribute.data, storage.element, storage.dtype, storage.width)
    return _transpose(values) if storage.kind is Kind.MATRIX else values


def _transpose(matrices: np.ndarray) -> np.ndarray:
    """Convert matrices (count, 16) from column-major to row-major order, or back."""
    return matrices.reshape(-1, 4, 4).transpose(0, 2, 1).reshape(-1, 16)


def fits(attribute: bpy.types.Attribute, layer: Layer) -> bool:
    """Whether an attribute has the type and domain for a layer's values."""
    return (attribute.data_type, attribute.domain) == (layer.data_type, layer.attribute.domain.name)


def write_layer(mesh: Mesh, layer: Layer) -> None:
    """Write an attribute to a mesh; overwrites one of the same name, or replaces it if its type differs."""
    name, domain = layer.attribute.name, layer.attribute.domain.name
    storage = STORAGE[layer.data_type]
    present = mesh.attributes.get(name)
    if present is not None and not fits(present, layer):
        mesh.attributes.remove(present)
        present = None
    if present is None:
        present = mesh.attributes.new(name, layer.data_type, domain)
    values = layer.attribute.values
    if layer.data_type == "STRING":
        for element, value in zip(present.data, values.tolist(), strict=True):
            element.value = value
        return
    values = _transpose(values) if storage.kind is Kind.MATRIX else values
    present.data.foreach_set(storage.element, np.ascontiguousarray(values, storage.dtype).ravel())


def read_active_layers(mesh: Mesh) -> ActiveLayers:
    """The names of the shown and rendered UV maps and colour attributes."""
    rendered = [layer.name for layer in mesh.uv_layers if layer.active_render]
    return ActiveLayers(
        uv=mesh.uv_layers.active.name if mesh.uv_layers.active else None,
        uv_render=rendered[0] if rendered else None,
        color=mesh.attributes.active_color_name or None,
        color_render=mesh.attributes.default_color_name or None,
    )


def write_active_layers(mesh: Mesh, active: ActiveLayers) -> None:
    """Set the shown and rendered layers of a mesh; None keeps the present one."""
    if active.uv is not None:
        mesh.uv_layers.active = mesh.uv_layers[active.uv]
    if active.uv_render is not None:
        mesh.uv_layers[active.uv_render].active_render = True
    if active.color is not None:
        mesh.attributes.active_color_name = active.color
    if active.color_render is not None:
        mesh.attributes.default_color_name = active.color_render
