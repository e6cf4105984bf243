# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects far from the world's origin, where Blender's own single precision no longer resolves their shape."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from scenes import ellipsoid, key_shape, link, positions
from true_match import keep_true_match

from blender_addon import api, jobs
from blender_addon.mesh_data.matrices import world_matrix
from blender_addon.mesh_data.surfaces.surface_points import surface_point_of_vertex
from blender_addon.scene.landmarks import landmark_pairs, set_landmark
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.match import match_objects

# A place, in single precision as Blender keeps it, where numbers are 0.06 or 1 apart.
FAR = {"a million units away": (1e6, -3e5, 5e5), "ten millions": (1e7, -3e6, 5e6)}


def move_to(place, *objects):
    for obj in objects:
        obj.location = place
    bpy.context.view_layer.update()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("place", FAR.values(), ids=FAR)
@pytest.mark.parametrize("initial", ["auto", "nearest"])
def test_matches_do_not_depend_on_distance_from_origin(source, target, place, initial):
    target.rotation_euler = 0.02, 0, 0.01
    found = []
    for where in ((0, 0, 0), place):
        move_to(where, source, target)
        result = match_objects(bpy.context, source, target, initial=initial)
        assert not result.notes
        found.append(result.surface_map.interpolate(positions(source.data)))
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_child_of_distant_parent_keeps_its_relative_place(source, target):
    """Single precision rounds a child's position to 0.06 there, which is the difference of these two."""
    parent = link("Parent", None)
    for obj, x in ((source, 0.0), (target, 0.03)):
        obj.location, obj.rotation_euler, obj.parent = (x, 0.01, 0), (0, 0, 0.3), parent
    move_to(FAR["a million units away"], parent)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    wanted = np.broadcast_to([0.03, 0, 0], pair.source.vertices.shape)
    np.testing.assert_allclose(pair.target.vertices - pair.source.vertices, wanted, atol=1e-6)
    assert np.abs(np.array(target.matrix_world.translation) - np.array(source.matrix_world.translation))[0] != 0.03


def test_constrained_object_is_read_where_blender_places_it(source):
    other = link("Other", None)
    other.location = 5, 6, 7
    source.constraints.new("COPY_LOCATION").target = other
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(world_matrix(source), np.array(source.matrix_world))
    np.testing.assert_array_equal(world_matrix(source)[:3, 3], [5, 6, 7])
    child = ellipsoid("Child", 1)
    child.parent, child.parent_type, child.parent_vertices = source, "VERTEX", (3, 0, 0)
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(world_matrix(child), np.array(child.matrix_world))
    assert np.linalg.norm(world_matrix(child)[:3, 3] - [5, 6, 7]) > 0.4


def test_world_matrix_includes_all_transforms(source):
    parent = link("Parent", None)
    parent.matrix_world = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.4, 4, "X")
    source.parent, source.matrix_parent_inverse = parent, Matrix.Translation((4, 0, 1)).inverted()
    source.delta_location, source.delta_scale, source.delta_rotation_euler = (7, 8, 9), (2, 1, 1), (0, 0.2, 0)
    source.location, source.scale, source.rotation_mode = (0.1, 0.2, 0.3), (1, -2, 3), "QUATERNION"
    source.rotation_quaternion = 0.8, 0.1, 0.5, 0.2
    bpy.context.view_layer.update()
    np.testing.assert_allclose(world_matrix(source), np.array(source.matrix_world), atol=1e-5)
    source.location.x = 77  # Blender has not moved it yet
    np.testing.assert_array_equal(world_matrix(source), np.array(source.matrix_world))


def test_landmarks_stay_on_distant_surfaces(source, target):
    move_to(FAR["a million units away"], source, target)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for number, vertex in enumerate((3, 77, 200), 1):
        for obj in (source, target):
            set_landmark(bpy.context.scene, obj, surface_point_of_vertex(obj, vertex, depsgraph), number)
    found = landmark_pairs(bpy.context, source, target)
    place = np.array(source.location)
    np.testing.assert_allclose(found.source - place, positions(source.data)[[3, 77, 200]], atol=1e-6)


@pytest.mark.parametrize("result", ["shape_key", "mesh", "object"])
def test_distant_wrapped_mesh_keeps_its_shape(source, target, result):
    points = positions(target.data) * [1.1, 0.95, 1.2]
    found = []
    for place in ((0, 0, 0), FAR["a million units away"]):
        target.shape_key_clear()
        target.data.vertices.foreach_set("co", points.ravel().astype(np.float32))
        target.data.update()
        move_to(place, source, target)
        keep_true_match(target)
        report = api.wrap(bpy.context, source, target, api.Wrapping(result=result))
        made = bpy.data.objects[report["object"]]
        found.append(key_shape(made.data, report["key"]) if report["key"] else positions(made.data))
        np.testing.assert_array_equal(np.array(made.matrix_world.translation), np.array(source.location))
    np.testing.assert_allclose(*found, atol=1e-5)


def test_distant_worn_object_keeps_its_shape(source, target):
    hat = ellipsoid("Hat", 2, (0.2, 0.2, 0.2))
    hat.data.transform(Matrix.Translation((0, 0, 0.8)))
    move_to(FAR["a million units away"], source, target, hat)
    keep_true_match(target)
    report = api.dress(bpy.context, source, target, [hat])
    copy = bpy.data.objects[report["objects"]["Hat"]]
    bpy.context.view_layer.update()
    moved = np.linalg.inv(world_matrix(target)) @ world_matrix(copy)
    seen = positions(copy.data) @ moved[:3, :3].T + moved[:3, 3]
    assert np.linalg.norm(seen - positions(hat.data), axis=1).max() < 0.02


def test_vertices_far_from_their_origin_are_reported_as_rounded(source, target):
    assert not match_objects(bpy.context, source, target).notes
    target.data.transform(Matrix.Translation((1e6, 0, 0)))
    target.location.x, target.scale = 5, (0.1, 0.1, 0.1)
    bpy.context.view_layer.update()
    (note,) = (note for note in match_objects(bpy.context, source, target).notes if "rounded" in note)
    assert note.startswith("The target is so far from its origin that its coordinates are rounded by ")
