# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes for tests, and snapshots of everything that a test may find changed."""

import bmesh
import bpy
import numpy as np

# Blender's property, the numbers in a value, and their type, for each type of attribute that all versions have.
ELEMENTS = {
    "FLOAT": ("value", 1, np.float32),
    "FLOAT2": ("vector", 2, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
    "BYTE_COLOR": ("color", 4, np.float32),
    "INT": ("value", 1, np.int32),
    "INT8": ("value", 1, np.int32),
    "INT16_2D": ("value", 2, np.int32),
    "INT32_2D": ("value", 2, np.int32),
    "BOOLEAN": ("value", 1, np.bool_),
    "QUATERNION": ("value", 4, np.float32),
    "FLOAT4X4": ("value", 16, np.float32),
}


def ellipsoid(name="Mesh", subdivisions=5, radii=(1.0, 0.7, 0.5)):
    """An ellipsoid with a bump, without symmetry, from an icosphere (2562 vertices at 5 subdivisions)."""
    mesh = bpy.data.meshes.new(name)
    working = bmesh.new()
    bmesh.ops.create_icosphere(working, subdivisions=subdivisions, radius=1.0)
    working.to_mesh(mesh)
    working.free()
    points = positions(mesh)
    bump = np.exp(-8 * ((points - np.array([0.5, 0.6, 0.62])) ** 2).sum(axis=1))
    points *= np.array(radii) * (1 + 0.8 * bump[:, None])
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.update()
    return link(name, mesh)


def decimate(name="Target", subdivisions=5):
    """The ellipsoid with fewer triangles, in the same place."""
    obj = ellipsoid(name, subdivisions)
    activate(obj)
    obj.modifiers.new("Decimate", "DECIMATE").ratio = 0.7
    bpy.ops.object.modifier_apply(modifier="Decimate")
    return obj


def link(name, mesh):
    """Add an object of a mesh to the scene."""
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def from_pydata(name, vertices, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    return link(name, mesh)


def delete_vertex(obj):
    """Delete one vertex and the faces around it, so that arrays read afterwards have other sizes."""
    editable = bmesh.new()
    editable.from_mesh(obj.data)
    editable.verts.ensure_lookup_table()
    editable.verts.remove(editable.verts[7])
    editable.to_mesh(obj.data)
    editable.free()
    obj.data.update()


def activate(target, *others):
    """Select objects; the first is the active one."""
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in (target, *others))
    bpy.context.view_layer.objects.active = target


def positions(mesh):
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3)


def values(mesh, name):
    """(count,) or (count, width) values of an attribute."""
    attribute = mesh.attributes[name]
    element, width, dtype = ELEMENTS[attribute.data_type]
    array = np.empty(len(attribute.data) * width, dtype)
    attribute.data.foreach_get(element, array)
    return array if width == 1 else array.reshape(-1, width)


def add_attribute(mesh, name, data_type, domain, array):
    attribute = mesh.attributes.new(name, data_type, domain)
    element, _, dtype = ELEMENTS[data_type]
    attribute.data.foreach_set(element, np.ascontiguousarray(array, dtype).ravel())


def add_uv_map(mesh, name):
    """A UV map without seams: x and y of the vertices."""
    corner_vertex = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner_vertex)
    add_attribute(mesh, name, "FLOAT2", "CORNER", positions(mesh)[corner_vertex, :2] / 4 + 0.5)


def weights(obj):
    """Weights as {group: {vertex: weight}}, in the order of the groups."""
    table = {group.name: {} for group in obj.vertex_groups}
    names = list(table)
    for vertex in obj.data.vertices:
        for element in vertex.groups:
            table[names[element.group]][vertex.index] = element.weight
    return table


def set_weights(obj, name, array):
    """Add a vertex group with weights (n,); vertices of weight zero are no members."""
    group = obj.vertex_groups.new(name=name)
    for vertex, weight in enumerate(np.asarray(array).tolist()):
        if weight > 0:
            group.add([vertex], weight, "REPLACE")
    return group


def weight_array(obj, name):
    """(n,) weights of one group."""
    array = np.zeros(len(obj.data.vertices))
    members = weights(obj)[name]
    array[list(members)] = list(members.values())
    return array


def key_shape(mesh, name):
    """(n, 3) positions of a shape key."""
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.shape_keys.key_blocks[name].points.foreach_get("co", points)
    return points.reshape(-1, 3)


def shape_keys(mesh):
    """Everything about the shape keys of a mesh."""
    if mesh.shape_keys is None:
        return None
    settings = ("name", "value", "slider_min", "slider_max", "mute", "interpolation", "vertex_group", "lock_shape")
    keys = [
        ([getattr(key, name) for name in settings], key.relative_key.name, key_shape(mesh, key.name).tobytes())
        for key in mesh.shape_keys.key_blocks
    ]
    animation = mesh.shape_keys.animation_data
    drivers = [] if animation is None else [driver.data_path for driver in animation.drivers]
    return keys, drivers, animation and animation.action and animation.action.name


def visible_positions(obj):
    """(n, 3) positions in world space after modifiers and shape keys."""
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    points = positions(mesh) @ np.array(obj.matrix_world)[:3, :3].T + np.array(obj.matrix_world.translation)
    evaluated.to_mesh_clear()
    return points


def new_material(name):
    return bpy.data.materials.new(name)


def snapshot(obj):
    """Everything about an object and its mesh that a transfer could change."""
    mesh = obj.data
    return {
        "attributes": {
            a.name: (a.data_type, a.domain, values(mesh, a.name).tobytes())
            for a in mesh.attributes
            if a.data_type in ELEMENTS
        },
        "uv": [(layer.name, layer.active, layer.active_render) for layer in mesh.uv_layers],
        "colors": (list(mesh.color_attributes.keys()), mesh.attributes.active_color_name),
        "default color": mesh.attributes.default_color_name,
        "weights": weights(obj),
        "groups": [(group.name, group.index, group.lock_weight) for group in obj.vertex_groups],
        "active group": obj.vertex_groups.active_index,
        "materials": [material and material.name for material in mesh.materials],
        "shape keys": shape_keys(mesh),
        "properties": dict(mesh.items()) | dict(obj.items()),
        "matrix": [list(row) for row in obj.matrix_world],
        "modifiers": [(modifier.name, modifier.show_viewport) for modifier in obj.modifiers],
    }


def snapshot_file():
    """The same for all objects, and the names of all data-blocks."""
    blocks = {
        kind: sorted(block.name for block in getattr(bpy.data, kind))
        for kind in (
            "objects",
            "meshes",
            "shape_keys",
            "actions",
            "materials",
            "images",
            "collections",
            "texts",
            "node_groups",
        )
    }
    return blocks, {obj.name: snapshot(obj) for obj in bpy.data.objects if obj.type == "MESH"}
