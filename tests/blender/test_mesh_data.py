# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion between Blender's meshes and arrays."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from scenes import (
    ELEMENTS,
    activate,
    add_attribute,
    add_uv_map,
    ellipsoid,
    from_pydata,
    link,
    new_material,
    positions,
    set_weights,
    values,
    weights,
)

import zoomout_core as zo
from blender_addon import mesh_data
from zoomout_core.transfer import Domain, Kind

# Begun at a corner from which a fan of triangles would leave the outline.
L_SHAPE = [(3, 0, 0), (3, 1, 0), (1, 1, 0), (1, 3, 0), (0, 3, 0), (0, 0, 0)]


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def random_values(data_type, count, seed=0):
    generator = np.random.default_rng(seed)
    _, width, dtype = ELEMENTS[data_type]
    if data_type == "BYTE_COLOR":  # what a byte of sRGB can hold, decoded
        encoded = generator.integers(0, 256, count * width).reshape(-1, 4) / 255
        linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
        linear[:, 3] = encoded[:, 3]
        return linear.astype(np.float32)
    array = generator.integers(-100, 100, count * width)
    if dtype == np.bool_:
        array = array > 0
    elif data_type == "QUATERNION":  # Blender may normalise them
        array = array.reshape(-1, 4) / np.linalg.norm(array.reshape(-1, 4), axis=1, keepdims=True)
    elif dtype == np.float32:
        array = array / 7
    return array.astype(dtype).reshape((count, width) if width > 1 else count)


@pytest.mark.parametrize("domain", ["POINT", "EDGE", "FACE", "CORNER"])
@pytest.mark.parametrize("data_type", list(ELEMENTS))
def test_every_type_of_attribute_survives_the_round_trip(data_type, domain):
    if data_type not in {item.identifier for item in bpy.types.Attribute.bl_rna.properties["data_type"].enum_items}:
        pytest.skip(f"this version has no {data_type}")
    source, target = ellipsoid("Source", 2), ellipsoid("Target", 2)
    count = {
        "POINT": len(source.data.vertices),
        "EDGE": len(source.data.edges),
        "FACE": len(source.data.polygons),
        "CORNER": len(source.data.loops),
    }
    expected = random_values(data_type, count[domain])
    add_attribute(source.data, "data", data_type, domain, expected)

    layer = mesh_data.read_layer(source.data, "data")
    assert layer.attribute.domain is Domain[domain]
    assert layer.attribute.values.shape == expected.shape
    mesh_data.write_layer(target.data, layer)

    written = target.data.attributes["data"]
    assert (written.data_type, written.domain) == (data_type, domain)
    np.testing.assert_allclose(values(target.data, "data"), expected, atol=1e-6)


@pytest.mark.parametrize("domain", ["POINT", "EDGE", "FACE", "CORNER"])
def test_strings_survive_the_round_trip(domain):
    source, target = ellipsoid("Source", 2), ellipsoid("Target", 2)
    words = [b"", b"boot", "façade".encode()]
    for element, i in zip(source.data.attributes.new("word", "STRING", domain).data, range(10**6), strict=False):
        element.value = words[i % 3]
    mesh_data.write_layer(target.data, mesh_data.read_layer(source.data, "word"))
    written = [element.value for element in target.data.attributes["word"].data]
    assert written == [words[i % 3] for i in range(len(written))]


def test_matrices_are_read_row_by_row():
    source = ellipsoid("Source", 1)
    rows = np.arange(16.0).reshape(4, 4)
    attribute = source.data.attributes.new("frame", "FLOAT4X4", "POINT")
    attribute.data[3].value = Matrix(rows)
    values_read = mesh_data.read_layer(source.data, "frame").attribute.values
    np.testing.assert_array_equal(values_read[3], rows.ravel())


def test_writing_overwrites_same_type_and_replaces_other_types():
    source, target = ellipsoid("Source", 2), ellipsoid("Target", 2)
    add_attribute(source.data, "data", "FLOAT", "POINT", np.arange(len(source.data.vertices)))
    add_attribute(target.data, "data", "INT", "FACE", np.zeros(len(target.data.polygons)))
    add_attribute(target.data, "other", "FLOAT", "POINT", np.full(len(target.data.vertices), 3.0))
    layer = mesh_data.read_layer(source.data, "data")
    for _ in range(2):
        mesh_data.write_layer(target.data, layer)
    assert [a.name for a in target.data.attributes if a.name.startswith("data")] == ["data"]
    assert values(target.data, "data")[7] == 7
    assert (values(target.data, "other") == 3).all()


def test_byte_colors_are_read_scene_linear():
    source = ellipsoid("Source", 1)
    color = source.data.color_attributes.new("Color", "BYTE_COLOR", "CORNER")
    for element in color.data:
        element.color_srgb = (0.5, 0.5, 0.5, 1)
    layer = mesh_data.read_layer(source.data, "Color", mesh_data.Role.COLOR)
    assert layer.attribute.kind is Kind.COLOR
    np.testing.assert_allclose(layer.attribute.values[:, 0], 0.21586, atol=1e-4)  # 128 of 255


def test_layers_are_classified_by_their_use_in_blender():
    mesh = ellipsoid("Source", 2).data
    add_uv_map(mesh, "UV A")
    add_uv_map(mesh, "UV B")
    mesh.color_attributes.new("Paint", "FLOAT_COLOR", "POINT")
    add_attribute(mesh, "mass", "FLOAT", "POINT", np.zeros(len(mesh.vertices)))
    add_attribute(mesh, "face color", "FLOAT_COLOR", "FACE", np.zeros((len(mesh.polygons), 4)))
    add_attribute(mesh, "flow", "FLOAT2", "POINT", np.zeros((len(mesh.vertices), 2)))
    layers, skipped = mesh_data.read_layers(mesh)
    assert {(layer.attribute.name, layer.role.value, layer.attribute.kind) for layer in layers} == {
        ("UV A", "uv_maps", Kind.UV),
        ("UV B", "uv_maps", Kind.UV),
        ("Paint", "color_attributes", Kind.COLOR),
        ("mass", "attributes", Kind.SCALAR),
        ("face color", "attributes", Kind.COLOR),
        ("flow", "attributes", Kind.VECTOR),
        ("sharp_face", "attributes", Kind.BOOLEAN),
    }
    assert [layer.attribute.name for layer in layers[:2]] == ["UV A", "UV B"]
    assert skipped == {}


def test_all_mesh_data_is_read_or_skipped_with_a_reason():
    source = ellipsoid("Source", 2)
    mesh = source.data
    mesh.materials.append(new_material("red"))
    mesh.polygons[0].material_index = 0
    mesh.edges[0].use_seam = True
    mesh.edge_creases_ensure()
    add_uv_map(mesh, "UVMap")
    add_attribute(mesh, "zoomout_confidence", "FLOAT", "POINT", np.ones(len(mesh.vertices)))
    add_attribute(mesh, "zoomout_speed", "FLOAT", "POINT", np.ones(len(mesh.vertices)))
    add_attribute(mesh, ".sculpt_mask", "FLOAT", "POINT", np.ones(len(mesh.vertices)))
    add_attribute(mesh, ".sculpt_face_set", "INT", "FACE", np.ones(len(mesh.polygons)))
    mesh.attributes.new("label", "STRING", "POINT")
    mesh.normals_split_custom_set([(0, 0, 1)] * len(mesh.loops))
    activate(source)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.select_all(action="SELECT")
    bpy.ops.uv.pin()
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.mesh.select_random()
    bpy.ops.mesh.hide()
    bpy.ops.object.mode_set(mode="OBJECT")
    layers, skipped = mesh_data.read_layers(mesh)
    read = {layer.attribute.name for layer in layers}
    assert read == {"UVMap", "sharp_face", "zoomout_speed", ".sculpt_mask", ".sculpt_face_set", "label"}
    assert set(skipped) == {"zoomout_confidence", ".pn.UVMap"}
    assert [marks.name for marks in mesh_data.read_marks(mesh)] == ["seams"]
    assert mesh.has_custom_normals
    elsewhere = {"material_index", "uv_seam", ".uv_seam", "sharp_edge", "crease_edge", "custom_normal"}
    left = {attribute.name for attribute in mesh.attributes if not attribute.is_required}.difference(read, skipped)
    assert {name for name in left if not name.startswith((".select_", ".hide_", ".uv_select_"))} <= elsewhere


def test_non_attribute_data_is_skipped_with_a_reason():
    source = ellipsoid("Source", 2)
    assert mesh_data.untransferable_data(source, source.data) == {}
    source.modifiers.new("Multires", "MULTIRES")
    assert set(mesh_data.untransferable_data(source, source.data)) == {"multires displacement"}


@pytest.mark.parametrize(
    ("name", "data_type", "domain"),
    [(".sculpt_face_set", "INT", "FACE"), ("sharp_face", "BOOLEAN", "FACE"), (".sculpt_mask", "FLOAT", "POINT")],
)
def test_sculpt_and_shading_data_survive_the_round_trip(name, data_type, domain):
    source, target = ellipsoid("Source", 2), ellipsoid("Target", 2)
    count = len(source.data.polygons) if domain == "FACE" else len(source.data.vertices)
    expected = random_values(data_type, count)
    for mesh in (source.data, target.data):
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
    add_attribute(source.data, name, data_type, domain, expected)
    (layer,) = [layer for layer in mesh_data.read_layers(source.data)[0] if layer.attribute.name == name]
    mesh_data.write_layer(target.data, layer)
    np.testing.assert_allclose(values(target.data, name), expected)
    if name == "sharp_face":
        assert [polygon.use_smooth for polygon in target.data.polygons] == [not sharp for sharp in expected]


def test_source_is_read_after_modifiers_with_all_data():
    source = ellipsoid("Source", 2)
    set_weights(source, "Bone", np.linspace(0, 1, len(source.data.vertices)))
    add_uv_map(source.data, "UVMap")
    add_attribute(source.data, "mass", "FLOAT", "POINT", np.arange(len(source.data.vertices)))
    add_attribute(source.data, "zone", "INT", "FACE", np.arange(len(source.data.polygons)))
    source.data.materials.append(new_material("red"))
    subdivision = source.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels = 1
    vertices, faces = len(source.data.vertices), len(source.data.polygons)

    surface = mesh_data.read_source_surface(source, depsgraph())
    assert len(surface.face_start) - 1 == 3 * faces
    assert len(surface.vertices) > 3 * vertices
    with mesh_data.evaluated_mesh(source, depsgraph()) as (evaluated, mesh):
        layers, _ = mesh_data.read_layers(mesh)
        weights = mesh_data.read_weights(evaluated, mesh)
        materials, face_slots = mesh_data.read_materials(evaluated, mesh)
    assert weights.values.shape == (len(surface.vertices), 1)
    assert weights.labels == ("Bone",)
    assert weights.values.nnz > 3 * vertices
    assert {layer.attribute.name: len(layer.attribute.values) for layer in layers} == {
        "sharp_face": 3 * faces,
        "UVMap": len(surface.corner_vertex),
        "mass": len(surface.vertices),
        "zone": 3 * faces,
    }
    assert materials == ["red"]
    assert len(face_slots.values) == 3 * faces


def test_attributes_captured_by_nodes_are_not_read():
    source = ellipsoid("Source", 2)
    tree = bpy.data.node_groups.new("Capture", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeCaptureAttribute", "GeometryNodeSetPosition", "NodeGroupOutput")
    start, capture, move, end = map(tree.nodes.new, kinds)
    capture.capture_items.new("VECTOR", "place")
    tree.links.new(tree.nodes.new("GeometryNodeInputPosition").outputs[0], capture.inputs["place"])
    for one, other in ((start, capture), (capture, move), (move, end)):
        tree.links.new(one.outputs[0], other.inputs[0])
    tree.links.new(capture.outputs["place"], move.inputs["Position"])
    source.modifiers.new("Capture", "NODES").node_group = tree
    with mesh_data.evaluated_mesh(source, depsgraph()) as (_, mesh):
        layers, skipped = mesh_data.read_layers(mesh)
    assert not skipped
    assert {layer.attribute.name for layer in layers} == {"sharp_face"}


def test_mirrored_object_is_read_with_outward_faces():
    source = ellipsoid("Source", 2)
    source.scale = (-2, 2, 2)
    source.location = (5, 0, 0)
    bpy.context.view_layer.update()
    surface = mesh_data.read_source_surface(source, depsgraph())
    np.testing.assert_allclose(surface.vertices, positions(source.data) * [-2, 2, 2] + [5, 0, 0], atol=1e-5)
    a, b, c = (surface.vertices[surface.triangles[:, i]] - surface.vertices.mean(axis=0) for i in range(3))
    assert np.einsum("ij,ij->i", np.cross(b - a, c - a), a).sum() > 0
    corner_vertex = np.empty(len(source.data.loops), np.int32)
    source.data.loops.foreach_get("vertex_index", corner_vertex)
    np.testing.assert_array_equal(surface.corner_vertex, corner_vertex)


def test_a_concave_polygon_is_triangulated_inside_its_outline():
    surface = mesh_data.read_source_surface(from_pydata("L", L_SHAPE, [range(6)]), depsgraph())
    assert len(surface.triangles) == 4
    assert surface.area == pytest.approx(5)


@pytest.mark.parametrize("faces", [[(0, 1, 2), (0, 2, 3), (0, 3, 5)], [(0, 1, 2), (0, 2, 3, 5)]])
def test_face_starts_match_those_of_blender(faces):
    mesh = from_pydata("L", L_SHAPE, faces).data
    np.testing.assert_array_equal(mesh_data.read_faces(mesh).start, [face.loop_start for face in mesh.polygons])


def test_deforming_modifiers_keep_the_targets_topology():
    target = ellipsoid("Target", 2)
    cast = target.modifiers.new("Cast", "CAST")
    cast.factor, cast.radius, cast.use_radius_as_size = 1.0, 2.0, False
    cast.size = 3.0
    surface = mesh_data.read_target_surface(target, depsgraph())
    assert len(surface.vertices) == len(target.data.vertices)
    assert np.abs(surface.vertices - positions(target.data)).max() > 0.5


def test_an_object_that_blender_does_not_evaluate_is_refused():
    source = ellipsoid("Source", 2)
    source.modifiers.new("Finer", "SUBSURF")
    source.hide_viewport = True
    with pytest.raises(zo.MeshError, match="'Source'"):
        mesh_data.read_source_surface(source, depsgraph())


def test_face_with_two_corners_is_refused():
    # Beside a quad, it has three corners on average, as in a mesh of triangles.
    mesh = bpy.data.meshes.new("broken")
    mesh.vertices.add(4)
    mesh.loops.add(6)
    mesh.polygons.add(2)
    mesh.loops.foreach_set("vertex_index", [0, 1, 0, 1, 2, 3])
    mesh.polygons.foreach_set("loop_start", [0, 2])
    obj = bpy.data.objects.new("broken", mesh)
    bpy.context.collection.objects.link(obj)
    with pytest.raises(zo.MeshError, match="Face 0 has 2 corners"):
        mesh_data.read_source_surface(obj, depsgraph())


def test_a_mesh_without_faces_is_refused_with_the_name_of_its_object():
    with pytest.raises(zo.MeshError, match=r"'Points'.*no faces"):
        mesh_data.read_source_surface(from_pydata("Points", [(0, 0, 0), (1, 0, 0)], []), depsgraph())


def test_weights_survive_the_round_trip_in_the_order_of_the_groups():
    source, target = ellipsoid("Source", 3), ellipsoid("Target", 3)
    generator = np.random.default_rng(0)
    count = len(source.data.vertices)
    for name in ("Spine", "Arm.L", "Arm.R", "Empty"):
        set_weights(source, name, generator.random(count) * (generator.random(count) < 0.4) * (name != "Empty"))
    set_weights(target, "Arm.R", np.ones(count))
    set_weights(target, "Own", np.full(count, 0.25))
    target.vertex_groups.active_index = 1
    before = weights(source)

    mesh_data.write_weights(target, mesh_data.read_weights(source, source.data))
    after = weights(target)
    assert list(after) == ["Own", "Spine", "Arm.L", "Arm.R", "Empty"]
    assert {name: after[name] for name in before} == before
    assert after["Own"] == dict.fromkeys(range(count), 0.25)
    assert target.vertex_groups.active.name == "Own"


def test_materials_are_read_as_displayed():
    mesh = ellipsoid("Source", 1).data
    bpy.data.objects.remove(bpy.data.objects["Source"])
    mesh.materials.append(new_material("data red"))
    mesh.materials.append(new_material("blue"))
    mesh.materials.append(None)
    source = link("Source", mesh)
    source.material_slots[0].link = "OBJECT"
    source.material_slots[0].material = new_material("object green")
    mesh.polygons[3].material_index = 1
    mesh.polygons[4].material_index = 9  # Blender shows the last slot
    materials, face_slots = mesh_data.read_materials(source, mesh)
    assert materials == ["object green", "blue", None]
    assert face_slots.values[[0, 3, 4]].tolist() == [0, 1, 2]


def test_materials_are_matched_by_identity_or_appended():
    source, target = ellipsoid("Source", 1), ellipsoid("Target", 1)
    red, green, blue = (new_material(name) for name in ("red", "green", "blue"))
    for material in (red, green, blue):
        source.data.materials.append(material)
    for material in (blue, None):
        target.data.materials.append(material)
    for polygon in source.data.polygons:
        polygon.material_index = 2 * (polygon.index % 2)  # red and blue, never green
    mesh_data.write_materials(target, *mesh_data.read_materials(source, source.data))
    assert [material and material.name for material in target.data.materials] == ["blue", None, "red"]
    shown = [target.data.materials[polygon.material_index].name for polygon in target.data.polygons]
    assert shown == ["red", "blue"] * (len(shown) // 2)


def test_edges_are_numbered_as_blender_numbers_them():
    mesh = bpy.data.meshes.new("Wire")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (5, 5, 5)], [(4, 2)], [(0, 1, 2, 3)])
    obj = link("Wire", mesh)
    expected = [list(edge.vertices) for edge in mesh.edges]
    assert [2, 4] in [sorted(edge) for edge in expected]
    for surface in (mesh_data.read_source_surface(obj, depsgraph()), mesh_data.read_target_surface(obj, depsgraph())):
        assert surface.edges.tolist() == expected
