# SPDX-License-Identifier: GPL-3.0-or-later
"""A character, and a copy of it in another pose and topology: our errors and those of Data Transfer.

The truth is known because the copy is remeshed from the posed original: all its points are on that.
"""

import bpy
import numpy as np
import pytest
from character import character, pose_copy
from scenes import activate, link, values, weights

from blender_addon import mesh_data
from zoomout_core.geometry.closest_points import closest_points


@pytest.fixture
def scene():
    source, armature = character()
    target, posed = pose_copy(source, armature)
    posed_surface = mesh_data.read_source_surface(posed, bpy.context.evaluated_depsgraph_get())
    return source, target, posed_surface


def dense_weights(obj, names):
    table = np.zeros((len(obj.data.vertices), len(names)))
    for name, members in weights(obj).items():
        table[list(members), names.index(name)] = list(members.values())
    return table


def face_means(mesh, corner_values):
    """(f, ...) means over the corners of each face."""
    start = np.empty(len(mesh.polygons), np.int32)
    size = np.empty_like(start)
    mesh.polygons.foreach_get("loop_start", start)
    mesh.polygons.foreach_get("loop_total", size)
    return np.add.reduceat(corner_values, start) / size[:, None]


def read_at(surface, points, values, corners):
    """Values at the vertices or corners of a surface, interpolated at the closest point to each point."""
    triangle, barycentric = closest_points(points, surface.vertices, surface.triangles)
    numbers = surface.triangle_corners if corners else surface.triangles
    return np.einsum("qc,qcx->qx", barycentric, values[numbers[triangle]])


@pytest.mark.slow
def test_transfer_to_posed_character_beats_data_transfer(scene):
    source, target, posed = scene
    assert not target.vertex_groups
    assert "rest" not in target.data.attributes
    by_blender = link("By Blender", target.data.copy())
    activate(target, source)
    assert bpy.ops.zoomout.match() == {"FINISHED"}
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    activate(source, by_blender)
    # Transferring UVs so leaves a block of memory, which Blender names at its exit: "Not freed memory blocks: 1".
    layers = {"layers_select_src": "ALL", "layers_select_dst": "NAME", "mix_mode": "REPLACE"}
    bpy.ops.object.data_transfer(data_type="VGROUP_WEIGHTS", vert_mapping="POLYINTERP_NEAREST", **layers)
    bpy.ops.object.data_transfer(data_type="UV", loop_mapping="POLYINTERP_NEAREST", **layers)

    surface = mesh_data.read_target_surface(target, bpy.context.evaluated_depsgraph_get())
    rest = values(source.data, "rest")
    unit = np.sqrt(posed.area)
    error = np.linalg.norm(values(target.data, "rest") - read_at(posed, surface.vertices, rest, False), axis=1) / unit
    assert error.mean() < 0.025
    assert np.percentile(error, 99) < 0.08

    names = [group.name for group in source.vertex_groups]
    assert [group.name for group in target.vertex_groups] == names
    truth = read_at(posed, surface.vertices, dense_weights(source, names), False)
    wrong = [np.abs(dense_weights(obj, names) - truth).sum(axis=1).mean() for obj in (target, by_blender)]
    assert wrong[0] < 0.15
    assert wrong[1] > 0.4

    (uv_map,) = source.data.uv_layers.keys()
    corners = surface.vertices[surface.corner_vertex]
    truth = read_at(posed, face_means(target.data, corners), values(source.data, uv_map), True)
    right = [
        (np.linalg.norm(face_means(obj.data, values(obj.data, uv_map)) - truth, axis=1) < 0.03).mean()
        for obj in (target, by_blender)
    ]
    assert right[0] > 0.8
    assert right[1] < 0.5
