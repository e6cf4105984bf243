"""Blender's meshes as arrays, and arrays back onto meshes: the only place that converts between the two.

Whole arrays go through `foreach_get` and `foreach_set`. Vertex weights have neither: they are read in one pass
over `MeshVertex.groups`, and written with one `VertexGroup.add` a weight, which takes about a microsecond and,
unlike a round trip through BMesh, leaves the rest of the mesh alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from enum import Enum
from typing import Any

import bpy
import numpy as np
from bpy.types import Depsgraph, Mesh, Object
from numpy.typing import DTypeLike
from scipy.sparse import csc_array, csr_array

import zoomout_core as zo
from zoomout_core.transfer import RULES, Attribute, Domain, Kind

# Blender refuses more UV maps in its panels, and draws no more than these.
MOST_UV_MAPS = 8
# What a match that is kept on a mesh consists of: for each vertex a triangle of the source, a point in it, and trust.
MATCH_ATTRIBUTES = ("zoomout_triangle", "zoomout_barycentric", "zoomout_confidence")
# Attributes that Blender itself gives a meaning which is bound to the edges and corners of one mesh.
CUSTOM_NORMAL = "custom_normal"
BOUND_TO_MESH = frozenset({"crease_vert", "bevel_weight_vert", CUSTOM_NORMAL, "freestyle_face"})
# Internal attributes that hold what was made on a mesh, and those that hold how it was being edited.
SCULPTED = frozenset({".sculpt_mask", ".sculpt_face_set"})
EDITING_STATES = (".select_", ".hide_", ".uv_select_", ".vs.", ".es.")
PINS = ".pn."
# Modifiers that move vertices or change data, but neither add nor remove vertices.
KEEPING_VERTICES = frozenset(
    {
        "ARMATURE", "CAST", "CLOTH", "COLLISION", "CORRECTIVE_SMOOTH", "CURVE", "DATA_TRANSFER", "DISPLACE",
        "HOOK", "LAPLACIANDEFORM", "LAPLACIANSMOOTH", "LATTICE", "MESH_CACHE", "MESH_DEFORM",
        "MESH_SEQUENCE_CACHE", "NORMAL_EDIT", "SHRINKWRAP", "SIMPLE_DEFORM", "SMOOTH", "SOFT_BODY", "SURFACE",
        "SURFACE_DEFORM", "UV_PROJECT", "UV_WARP", "VERTEX_WEIGHT_EDIT", "VERTEX_WEIGHT_MIX",
        "VERTEX_WEIGHT_PROXIMITY", "WARP", "WAVE", "WEIGHTED_NORMAL",
    }
)  # fmt: skip


@dataclass(frozen=True)
class Storage:
    """How Blender stores attributes of one type.

    Attributes:
        kind: what such values mean, unless the attribute's role says otherwise.
        element: the property of each element that holds the value.
        width: numbers in a value.
        dtype: their type.
    """

    kind: Kind
    element: str
    width: int
    dtype: DTypeLike


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
    "QUATERNION": Storage(Kind.QUATERNION, "value", 4, np.float32),
    "FLOAT4X4": Storage(Kind.MATRIX, "value", 16, np.float32),
}


class Role(Enum):
    """What Blender uses an attribute as; the values are the names of the options and of the report's lists."""

    UV_MAP = "uv_maps"
    COLOR = "color_attributes"
    GENERIC = "attributes"


@dataclass(frozen=True, eq=False)
class Layer:
    """An attribute, with what Blender needs to make it anew on another mesh.

    Attributes:
        attribute: its values.
        role: what Blender uses it as.
        data_type: a key of `STORAGE`.
    """

    attribute: Attribute
    role: Role
    data_type: str


@dataclass(frozen=True)
class ActiveLayers:
    """Names of the layers that are shown and edited, and of those that are rendered."""

    uv: str | None
    uv_render: str | None
    color: str | None
    color_render: str | None

    def among(self, names: Collection[str]) -> ActiveLayers:
        """The same, without layers of other names."""
        return ActiveLayers(*(name if name in names else None for name in astuple(self)))


# --- geometry -----------------------------------------------------------------------------------------------


@contextmanager
def evaluated_mesh(obj: Object, depsgraph: Depsgraph) -> Iterator[tuple[Object, Mesh]]:
    """The evaluated object and its mesh as the modifiers leave it, with all data layers.

    Raises:
        MeshError: the object is disabled, so that Blender does not evaluate it.
    """
    evaluated = obj.evaluated_get(depsgraph)
    if not evaluated.is_evaluated:
        raise zo.MeshError(
            f"'{obj.name}' or its collection is disabled in the viewport: enable it, so that its modifiers work."
        )
    try:
        yield evaluated, evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    finally:
        evaluated.to_mesh_clear()


def read_source_surface(obj: Object, depsgraph: Depsgraph) -> zo.Surface:
    """The surface of an object as the modifiers leave it, in world space.

    Where they leave the faces as they are, these are divided into triangles like those of the object's own
    mesh: Blender divides a quad another way when a pose folds it, and a match would not outlive that.

    Raises:
        MeshError: there is no surface, or it is not evaluated.
    """
    with evaluated_mesh(obj, depsgraph) as (evaluated, mesh):
        return _surface(evaluated, obj.data if _same_faces(mesh, obj.data) else mesh, read_positions(mesh))


def read_target_surface(obj: Object, depsgraph: Depsgraph) -> zo.Surface:
    """The surface of an object's own mesh, its vertices where the modifiers move them, in world space.

    Raises:
        MeshError: there is no surface, or modifiers add or remove vertices.
    """
    with evaluated_mesh(obj, depsgraph) as (evaluated, mesh):
        if len(mesh.vertices) != len(obj.data.vertices):
            raise zo.MeshError(_change_of_vertices(obj))
        return _surface(evaluated, obj.data, read_positions(mesh))


def read_positions(mesh: Mesh) -> np.ndarray:
    """(n, 3) positions of the vertices, in the mesh's own space."""
    return _read(mesh.vertices, "co", np.float32, 3)


def _surface(obj: Object, mesh: Mesh, positions: np.ndarray) -> zo.Surface:
    """A mesh in world space: corners and triangles are numbered as Blender does.

    A mirroring object matrix turns the surface inside out, so triangles are then wound the other way.
    """
    matrix = np.array(obj.matrix_world)
    mesh.calc_loop_triangles()
    triangle_corners = _read(mesh.loop_triangles, "loops", np.int32, 3)
    if is_mirrored(obj):
        triangle_corners = triangle_corners[:, ::-1]
    face_start = np.append(_read(mesh.polygons, "loop_start", np.int32), len(mesh.loops))
    try:
        return zo.Surface.from_corners(
            positions @ matrix[:3, :3].T + matrix[:3, 3],
            _read(mesh.loops, "vertex_index", np.int32),
            face_start,
            triangle_corners,
        )
    except zo.MeshError as error:
        raise zo.MeshError(f"'{obj.name}' cannot be used. {error}") from error


def is_mirrored(obj: Object) -> bool:
    """Whether an object's matrix turns its mesh into its mirror image."""
    return obj.matrix_world.is_negative


def _same_faces(mesh: Mesh, other: Mesh) -> bool:
    return (
        len(mesh.vertices) == len(other.vertices)
        and np.array_equal(_read(mesh.polygons, "loop_start", np.int32), _read(other.polygons, "loop_start", np.int32))
        and np.array_equal(_read(mesh.loops, "vertex_index", np.int32), _read(other.loops, "vertex_index", np.int32))
    )


def _change_of_vertices(obj: Object) -> str:
    suspects = [m.name for m in obj.modifiers if m.show_viewport and m.type not in KEEPING_VERTICES]
    names = " and ".join(f"'{name}'" for name in suspects) or "modifiers"
    return (
        f"Disable {names} on '{obj.name}' in the viewport: data is written to the mesh itself, "
        "and modifiers give it other vertices."
    )


def _read(elements: Any, name: str, dtype: DTypeLike, width: int = 1) -> np.ndarray:
    """(count,) or, for a width above one, (count, width) values of a property of all elements."""
    values = np.empty(len(elements) * width, dtype)
    elements.foreach_get(name, values)
    return values if width == 1 else values.reshape(-1, width)


# --- attributes ---------------------------------------------------------------------------------------------


def read_layers(mesh: Mesh) -> tuple[list[Layer], dict[str, str]]:
    """UV maps, colour attributes and other attributes, and why some of the others cannot be transferred.

    Returns:
        Layers in the order of Blender's lists, and a sentence for each attribute that is not among them.
    """
    roles = dict.fromkeys(mesh.uv_layers.keys(), Role.UV_MAP)
    roles |= dict.fromkeys(mesh.color_attributes.keys(), Role.COLOR)
    layers, skipped = [], {}
    for name in [*roles, *(other.name for other in mesh.attributes if other.name not in roles)]:
        attribute = mesh.attributes[name]
        if attribute.is_required or name == "material_index":
            continue  # the mesh itself, and what goes with its materials
        role = roles.get(name, Role.GENERIC)
        reason = _obstacle(attribute, role)
        if reason is None:
            layers.append(read_layer(mesh, name, role))
        elif name.startswith(EDITING_STATES):
            skipped["selection and hiding"] = reason  # of all kinds of elements
        else:
            skipped[name] = reason
    return layers, skipped


def data_without_a_way(obj: Object, mesh: Mesh) -> dict[str, str]:
    """What else an object carries, besides attributes, that cannot be transferred, each with the reason.

    Args:
        obj: the object as it is in the file.
        mesh: its mesh as the modifiers leave it.
    """
    keys = [] if obj.data.shape_keys is None else obj.data.shape_keys.key_blocks[1:]
    found = (
        ("shape keys", bool(keys), f"{len(keys)} of them, which cannot be transferred yet"),
        (
            "custom normals",
            mesh.has_custom_normals and CUSTOM_NORMAL not in mesh.attributes,
            "they are bound to the shape of the source's own mesh",
        ),
        ("skin radii", bool(mesh.skin_vertices), "they belong to the edges that the Skin modifier grows a mesh from"),
        (
            "multires displacement",
            any(modifier.type == "MULTIRES" for modifier in obj.modifiers),
            "it is bound to the faces of the source's own mesh",
        ),
    )
    return {name: reason for name, present, reason in found if present}


def _kind(attribute: bpy.types.Attribute, role: Role) -> Kind:
    return Kind.UV if role is Role.UV_MAP else STORAGE[attribute.data_type].kind


def _obstacle(attribute: bpy.types.Attribute, role: Role) -> str | None:
    name = attribute.name
    if name.startswith(EDITING_STATES):
        return "they belong to the editing of the source's own mesh"
    if name in MATCH_ATTRIBUTES:
        return "it belongs to a match that the source itself is the target of"
    if name.startswith(PINS):
        return "pins of UVs are set for one unwrapping of one mesh"
    if attribute.is_internal and name not in SCULPTED:
        return "it is internal to Blender"
    if attribute.domain == "EDGE":
        return "values of edges have no counterpart on another mesh"
    if name in BOUND_TO_MESH:
        return "it is bound to the shape of the source's own mesh"
    if attribute.data_type not in STORAGE:
        return f"values of the type {attribute.data_type} cannot be transferred"
    rule = RULES.get(_kind(attribute, role))
    if rule is None or Domain[attribute.domain] not in rule.domains:
        return f"values of the type {attribute.data_type} cannot be transferred"
    return None


def read_layer(mesh: Mesh, name: str, role: Role = Role.GENERIC) -> Layer:
    """One attribute of a mesh: values (count,) or (count, width), colours scene-linear."""
    attribute = mesh.attributes[name]
    storage = STORAGE[attribute.data_type]
    values = _read(attribute.data, storage.element, storage.dtype, storage.width)
    return Layer(Attribute(name, Domain[attribute.domain], _kind(attribute, role), values), role, attribute.data_type)


def fits(attribute: bpy.types.Attribute, layer: Layer) -> bool:
    """Whether an attribute can take a layer's values as it is."""
    return (attribute.data_type, attribute.domain) == (layer.data_type, layer.attribute.domain.name)


def write_layer(mesh: Mesh, layer: Layer) -> None:
    """Write an attribute to a mesh; one of the same name is overwritten, or replaced if it is of another type."""
    name, domain = layer.attribute.name, layer.attribute.domain.name
    storage = STORAGE[layer.data_type]
    present = mesh.attributes.get(name)
    if present is not None and not fits(present, layer):
        mesh.attributes.remove(present)
        present = None
    if present is None:
        present = mesh.attributes.new(name, layer.data_type, domain)
    present.data.foreach_set(storage.element, np.ascontiguousarray(layer.attribute.values, storage.dtype).ravel())


def read_active_layers(mesh: Mesh) -> ActiveLayers:
    """Which UV maps and colour attributes are shown, and which are rendered."""
    rendered = [layer.name for layer in mesh.uv_layers if layer.active_render]
    return ActiveLayers(
        uv=mesh.uv_layers.active.name if mesh.uv_layers.active else None,
        uv_render=rendered[0] if rendered else None,
        color=mesh.attributes.active_color_name or None,
        color_render=mesh.attributes.default_color_name or None,
    )


def write_active_layers(mesh: Mesh, active: ActiveLayers) -> None:
    """Make layers of the mesh the shown and the rendered ones; None leaves what is."""
    if active.uv is not None:
        mesh.uv_layers.active = mesh.uv_layers[active.uv]
    if active.uv_render is not None:
        mesh.uv_layers[active.uv_render].active_render = True
    if active.color is not None:
        mesh.attributes.active_color_name = active.color
    if active.color_render is not None:
        mesh.attributes.default_color_name = active.color_render


# --- vertex groups ------------------------------------------------------------------------------------------


def read_weights(obj: Object, mesh: Mesh) -> Attribute:
    """The weights of all vertex groups, as one sparse attribute labelled by the groups' names.

    Args:
        obj: the object that names the groups.
        mesh: its mesh, original or evaluated.
    """
    names = tuple(group.name for group in obj.vertex_groups)
    record = np.dtype([("vertex", np.int32), ("group", np.int32), ("weight", np.float32)])
    entries = np.fromiter(
        ((vertex.index, group.group, group.weight) for vertex in mesh.vertices for group in vertex.groups), record
    )
    entries = entries[entries["group"] < len(names)]
    values = csr_array(
        (entries["weight"], (entries["vertex"], entries["group"])), shape=(len(mesh.vertices), len(names))
    )
    return Attribute("vertex groups", Domain.POINT, Kind.WEIGHT, values, labels=names)


def write_weights(obj: Object, weights: Attribute) -> None:
    """Write vertex groups in the order of their labels, in place of those of the same names."""
    groups = obj.vertex_groups
    active = groups.active.name if groups.active else None
    for name in weights.labels:
        if name in groups:
            groups.remove(groups[name])
    columns = csc_array(weights.values)
    for column, name in enumerate(weights.labels):
        entries = slice(*columns.indptr[column : column + 2])
        add = groups.new(name=name).add
        for vertex, weight in zip(columns.indices[entries].tolist(), columns.data[entries].tolist(), strict=True):
            add((vertex,), weight, "REPLACE")
    if active is not None:
        groups.active_index = groups[active].index


def locked_groups(obj: Object) -> set[str]:
    """Names of the vertex groups that are locked against changes."""
    return {group.name for group in obj.vertex_groups if group.lock_weight}


def deforming_bones(obj: Object) -> set[str]:
    """Names of the deforming bones of the armatures that deform an object, as its modifiers or as its parent."""
    armatures = [modifier.object for modifier in obj.modifiers if modifier.type == "ARMATURE"]
    armatures.append(obj.find_armature())
    return {bone.name for armature in armatures if armature for bone in armature.data.bones if bone.use_deform}


# --- materials ----------------------------------------------------------------------------------------------


def read_materials(obj: Object, mesh: Mesh) -> tuple[list[str | None], Attribute]:
    """The full names of the materials in an object's slots (None where empty), and each face's slot.

    Blender shows faces that name a slot beyond the last one in the last; they are read so.
    """
    names = [material and material.name_full for material in mesh.materials]
    for i, slot in enumerate(obj.material_slots[: len(names)]):
        if slot.link == "OBJECT":
            names[i] = slot.material and slot.material.name_full
    slots = np.clip(_read(mesh.polygons, "material_index", np.int32), 0, max(0, len(names) - 1))
    return names, Attribute("materials", Domain.FACE, Kind.LABEL, slots)


def write_materials(obj: Object, names: Sequence[str | None], slots: Attribute) -> None:
    """Give faces the materials that `slots` has for them, by name; slots that are missing are appended."""
    present, _ = read_materials(obj, obj.data)
    by_name = {material.name_full: material for material in bpy.data.materials}
    used, face_slot = np.unique(slots.values, return_inverse=True)
    for name in (names[slot] for slot in used):
        if name not in present:
            obj.data.materials.append(by_name[name] if name else None)
            present.append(name)
    own = np.array([present.index(names[slot]) for slot in used], dtype=np.int32)
    obj.data.polygons.foreach_set("material_index", own[face_slot.reshape(-1)])


# --- all of it ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SourceData:
    """What an object carries, as its modifiers leave it, besides its geometry.

    Attributes:
        layers: UV maps, colour attributes and other attributes, in the order of Blender's lists.
        skipped: why other attributes cannot be transferred, by their names.
        without_a_way: the same of what is no attribute, see `data_without_a_way`.
        active: which layers are shown and rendered.
        weights: all vertex groups, see `read_weights`.
        materials: names of the materials in the slots, see `read_materials`.
        face_slots: the slot of each face.
    """

    layers: list[Layer]
    skipped: dict[str, str]
    without_a_way: dict[str, str]
    active: ActiveLayers
    weights: Attribute
    materials: list[str | None]
    face_slots: Attribute


def read_source_data(obj: Object, depsgraph: Depsgraph) -> SourceData:
    """Read everything that can be transferred from an object.

    Raises:
        MeshError: the object is disabled.
    """
    with evaluated_mesh(obj, depsgraph) as (evaluated, mesh):
        return SourceData(
            *read_layers(mesh),
            data_without_a_way(obj, mesh),
            read_active_layers(mesh),
            read_weights(evaluated, mesh),
            *read_materials(evaluated, mesh),
        )
