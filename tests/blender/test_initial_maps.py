# SPDX-License-Identifier: GPL-3.0-or-later
"""Matches from given initial maps."""

import bpy
import numpy as np
import pytest
from scenes import activate, link, positions, values

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.match import match_objects
from blender_addon.storage import stored_match


@pytest.fixture
def target(source):
    """A sculpted copy of the source, in another place."""
    obj = link("Target", source.data.copy())
    points = positions(obj.data) * [1, 2, 1] + [0, 0.2, 0]
    obj.data.vertices.foreach_set("co", points.ravel())
    obj.location.x = 3
    bpy.context.view_layer.update()
    activate(obj, source)
    return obj


def test_same_order_maps_each_vertex_to_its_own(source, target):
    assert bpy.ops.zoomout.match(initial="SAME_ORDER") == {"FINISHED"}
    kept = stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))
    np.testing.assert_array_equal(kept.surface_map.vertex, np.arange(len(positions(target.data))))
    np.testing.assert_array_equal(kept.surface_map.interpolate(positions(source.data)), positions(source.data))
    np.testing.assert_array_equal(values(target.data, "zoomout_confidence"), 1)
    assert kept.notes == ()


def test_loose_vertex_maps_to_nearest_point_without_confidence(source, target):
    for obj in (source, target):
        obj.data.vertices.add(1)
        obj.data.vertices[-1].co = (1.5, 0, 0)
        obj.data.update()
    result = match_objects(bpy.context, source, target, initial="same_order")
    assert result.confidence[-1] == 0
    np.testing.assert_array_equal(result.confidence[:-1], 1)
    np.testing.assert_allclose(result.surface_map.interpolate(positions(source.data))[-1], [1, 0, 0], atol=0.1)
    assert result.notes == (
        "1 vertex belongs to no face of the source: mapped to the nearest point, with zero confidence.",
    )


def test_meshes_of_another_count_or_order_are_refused_in_one_sentence(source, target):
    count = len(target.data.vertices)
    order = np.random.default_rng(0).permutation(count)
    shuffled = bpy.data.meshes.new("Shuffled")
    faces = [[int(order[vertex]) for vertex in face.vertices] for face in target.data.polygons]
    shuffled.from_pydata(positions(target.data)[np.argsort(order)].tolist(), [], faces)
    target.data = shuffled
    with pytest.raises(zo.MeshError, match=r"^'Source' and 'Target' share only \d+% of"):
        match_objects(bpy.context, source, target, initial="same_order")
    target.data.vertices.add(1)
    target.data.update()
    bpy.context.view_layer.update()
    with pytest.raises(zo.MeshError, match=f"^'Source' has {count:,} vertices but 'Target' has {count + 1:,}, so"):
        match_objects(bpy.context, source, target, initial="same_order")


def test_a_match_can_start_from_a_file_of_the_command_line(source, target, tmp_path):
    path = tmp_path / "map.npz"
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    # A half turn, which no other start would find.
    turned = positions(source.data) * [-1, -1, 1]
    vertex = np.linalg.norm(positions(source.data)[:, None] - turned, axis=2).argmin(axis=0)
    zo.SurfaceMap.from_vertices(vertex, pair.source).save(path)
    assert bpy.ops.zoomout.match(initial="FILE", map_file=str(path)) == {"FINISHED"}
    kept = stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))
    image = kept.surface_map.interpolate(positions(source.data))
    # The bump, which has no place after the turn, draws it aside; the shapes' own map is 1.2 away.
    assert np.linalg.norm(image - turned, axis=1).mean() < 0.3


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "map file is missing"),
        ("missing", "There is no file"),
        ("text", "contains no map"),
        ([0, 1, 2], "maps 3 vertices to a mesh of at least 3, but 'Target' has 642 and 'Source' has 642"),
        ([700] * 642, "maps 642 vertices to a mesh of at least 701"),
        ([[1.5, 0]] * 642, "it lists no vertices"),
    ],
)
def test_a_file_of_other_meshes_is_refused_in_one_sentence(source, target, tmp_path, content, sentence):
    path = tmp_path / "map.npz"
    if content == "text":
        path.write_text("no map")
    elif isinstance(content, list):
        np.savez(path, vertex=np.array(content))
    with pytest.raises(zo.MeshError, match=sentence) as error:
        match_objects(bpy.context, source, target, initial="file", map_file=str(path) if content else "")
    assert str(error.value).endswith(".")
    assert "zoomout_match" not in target.data
