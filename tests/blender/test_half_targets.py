# SPDX-License-Identifier: GPL-3.0-or-later
"""Half a character with a Mirror modifier, matched with a whole one."""

import bmesh
import bpy
import numpy as np
import pytest
from character import POSE, character
from scenes import activate, link, positions, visible_positions
from scipy.spatial import cKDTree

from blender_addon import jobs, mesh_data
from blender_addon.adapters import Binding
from blender_addon.services.matching.half_match import HalfResult
from blender_addon.services.matching.match import match_objects
from blender_addon.services.matching.use_candidate import use_candidate_async
from blender_addon.services.transfer import bind_to_rig
from blender_addon.storage import stored_candidates, stored_match


def half_of(obj, voxel_size=0.045):
    """The side of a mesh at +X with another topology, mirrored and subdivided by modifiers."""
    half = link("Half", obj.data.copy())
    activate(half)
    half.data.remesh_voxel_size = voxel_size
    bpy.ops.object.voxel_remesh()
    cut = bmesh.new()
    cut.from_mesh(half.data)
    everything = [*cut.verts, *cut.edges, *cut.faces]
    bmesh.ops.bisect_plane(cut, geom=everything, plane_co=(0, 0, 0), plane_no=(1, 0, 0), clear_inner=True)
    cut.to_mesh(half.data)
    cut.free()
    half.modifiers.new("Mirror", "MIRROR")
    half.modifiers.new("Finer", "SUBSURF")
    bpy.context.view_layer.update()
    return half


def errors(match, source, half):
    """Distances of each vertex's image from its true place, and from the other side's, at rest."""
    images, places = match.surface_map.interpolate(positions(source.data)), positions(half.data)
    return (np.linalg.norm(images * [sign, 1, 1] - places, axis=1) for sign in (1, -1))


def test_half_is_matched_as_the_whole_and_keeps_its_part():
    source, rig = character()
    half = half_of(source)
    for name, angles in POSE.items():
        rig.pose.bones[name].rotation_mode = "XYZ"
        rig.pose.bones[name].rotation_euler = angles
    bpy.context.view_layer.update()
    match = match_objects(bpy.context, source, half, detail="fast")
    count = len(half.data.vertices)
    assert len(match.confidence) == len(match.has_partner) == stored_match.description(half.data)["vertices"] == count
    error, mirrored = errors(match, source, half)
    assert np.median(error) < 0.015 < 0.2 < np.median(mirrored)
    assert match.source_has_partner.mean() > 0.95
    assert any("Mirror modifier" in note for note in match.notes)
    listing = stored_candidates.read(half.data)
    assert listing.vertices.max() < count
    other = next(place for place in range(len(listing.candidates)) if place != listing.chosen)
    assert len(jobs.run(use_candidate_async(bpy.context, half.name, other)).confidence) == count


def test_bones_of_both_sides_pose_a_bound_half():
    source, rig = character(levels=2)
    half = half_of(source)
    match_objects(bpy.context, source, half, detail="fast")
    bind_to_rig(bpy.context, source, half, Binding(shape="keep_shape"))
    assert [each.type for each in half.modifiers] == ["MIRROR", "ARMATURE", "SUBSURF"]
    for name, angles in POSE.items():
        rig.pose.bones[name].rotation_mode = "XYZ"
        rig.pose.bones[name].rotation_euler = angles
    bpy.context.view_layer.update()
    seen, wanted = (visible_positions(each) for each in (half, source))
    nearest = cKDTree(seen).query(wanted)[0]
    assert np.quantile(nearest, 0.95) < 0.05


def test_mirrored_surface_starts_with_vertices_of_the_mesh(target):
    target.location.x = 2
    assert whole(target) is None
    mirror = target.modifiers.new("Mirror", "MIRROR")
    target.modifiers.new("Finer", "SUBSURF")
    surface, count = whole(target), len(target.data.vertices)
    assert count < len(surface.vertices) <= 2 * count
    np.testing.assert_allclose(surface.vertices[:count], positions(target.data) + np.array([2, 0, 0]), atol=1e-3)
    mirror.use_bisect_axis[0] = True
    assert whole(target) is None
    mirror.use_bisect_axis[0] = False
    target.modifiers.move(1, 0)
    assert whole(target) is None


def whole(obj):
    bpy.context.view_layer.update()
    return mesh_data.read_mirrored_surface(obj, bpy.context.evaluated_depsgraph_get())


@pytest.mark.parametrize("option", ["initial_map", "nearest"])
def test_vertex_indexed_starts_match_only_the_half(source, target, option):
    target.modifiers.new("Mirror", "MIRROR")
    given = {"initial": "nearest"} if option == "nearest" else {"initial_map": np.arange(len(target.data.vertices))}
    match = match_objects(bpy.context, source, target, **given)
    assert not isinstance(match, HalfResult)
    assert len(match.confidence) == len(target.data.vertices)
