# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets whose modifiers change the topology: the mesh itself is matched and written."""

import bpy
import numpy as np
import pytest
from scenes import activate, positions, set_weights, snapshot_file, visible_positions, weight_array

import zoomout_core as zo
from blender_addon import mesh_data
from blender_addon.services import preflight
from blender_addon.services.matching.match import match_objects
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match

GENERATING = (
    "SUBSURF",
    "MULTIRES",
    "MIRROR",
    "ARRAY",
    "SOLIDIFY",
    "DECIMATE",
    "BEVEL",
    "TRIANGULATE",
    "REMESH",
    "NODES",
)


def add_modifier(obj, kind):
    """A modifier that changes the object's vertices, or its faces."""
    modifier = obj.modifiers.new(kind.title(), kind)
    if kind == "MULTIRES":
        activate(obj)
        bpy.ops.object.multires_subdivide(modifier=modifier.name)
    elif kind == "DECIMATE":
        modifier.ratio = 0.5
    elif kind == "REMESH":
        modifier.voxel_size = 0.2
    elif kind == "BEVEL":
        modifier.limit_method, modifier.width = "NONE", 0.001
    elif kind == "NODES":
        modifier.node_group = subdividing_nodes()
    return modifier


def subdividing_nodes():
    """Geometry Nodes that subdivide a mesh."""
    group = bpy.data.node_groups.new("Finer", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    begin, finer, end = (
        group.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeSubdivideMesh", "NodeGroupOutput")
    )
    group.links.new(begin.outputs[0], finer.inputs[0])
    group.links.new(finer.outputs[0], end.inputs[0])
    return group


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def bend(obj):
    """A deforming modifier, and where it moves the vertices."""
    cast = obj.modifiers.new("Cast", "CAST")
    cast.factor = 0.4
    return visible_positions(obj)


@pytest.mark.parametrize("kind", GENERATING)
def test_target_is_read_before_generating_modifiers(target, kind):
    target.shape_key_add(name="Basis")
    target.shape_key_add(name="Long").data[3].co.z += 0.5
    target.data.shape_keys.key_blocks["Long"].value = 0.5
    expected = bend(target)
    add_modifier(target, kind)
    target.modifiers.new("Smooth", "SMOOTH").iterations = 5
    activate(target)
    before = snapshot_file()
    surface = mesh_data.read_target_surface(target, depsgraph())
    if kind == "TRIANGULATE":  # which leaves triangles as they are, so that the last one acts, too
        expected = visible_positions(target)
    np.testing.assert_allclose(surface.vertices, expected, atol=1e-5)
    assert len(surface.face_start) - 1 == len(target.data.polygons)
    assert snapshot_file() == before
    assert (bpy.context.object, bpy.context.selected_objects) == (target, [target])


def test_bones_pose_the_mesh_below_generating_modifiers(target):
    """Half a character, mirrored, subdivided and posed: the half matches its visible position."""
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(armature)
    activate(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones.new("Bone").tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    armature.pose.bones["Bone"].location = (0, 3, 0)
    set_weights(target, "Bone", np.ones(len(target.data.vertices)))
    add_modifier(target, "MIRROR")
    add_modifier(target, "SUBSURF")
    target.modifiers.new("Armature", "ARMATURE").object = armature
    bpy.context.view_layer.update()
    surface = mesh_data.read_target_surface(target, depsgraph())
    np.testing.assert_allclose(surface.vertices, positions(target.data) + np.array([0, 0, 3]), atol=1e-5)


@pytest.mark.parametrize("kind", ["SUBSURF", "MULTIRES", "ARRAY", "SOLIDIFY", "NODES"])
def test_target_with_modifiers_is_matched_and_written(source, target, kind):
    height = positions(source.data)[:, 2]
    set_weights(source, "Bone", (height > 0.2).astype(float))
    modifier = add_modifier(target, kind)
    activate(target, source)
    assert [one.text for one in preflight.findings(bpy.context) if one.blocks] == []
    assert bpy.ops.zoomout.match(initial="NEAREST") == {"FINISHED"}
    match = stored_match.description(target.data)
    assert match["vertices"] == len(target.data.vertices)
    assert preflight.stale(bpy.context, target) == ""
    target.modifiers.remove(modifier)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    add_modifier(target, "BEVEL")
    bpy.context.view_layer.update()
    assert preflight.stale(bpy.context, target) == ""
    activate(target, source)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    assert stored_match.description(target.data) == match
    inside = np.abs(height - 0.2) > 0.1
    np.testing.assert_allclose(weight_array(target, "Bone")[inside], height[inside] > 0.2, atol=0.05)


def test_target_without_faces_names_its_modifiers(source, target):
    target.data = bpy.data.meshes.new("Stick")
    target.data.from_pydata([(0, 0, 0), (0, 0, 1)], [(0, 1)], [])
    target.modifiers.new("Turned", "SCREW")
    target.modifiers.new("Cast", "CAST")
    with pytest.raises(zo.MeshError, match="apply 'Turned', because data is written"):
        match_objects(bpy.context, source, target)


def test_a_disabled_target_is_refused(source, target):
    add_modifier(target, "SUBSURF")
    target.hide_viewport = True
    with pytest.raises(zo.MeshError, match="disabled"):
        transfer_objects(bpy.context, source, target)
