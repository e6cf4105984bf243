# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrong and doubtful places of a match are selected on the meshes, for Edit Mode."""

from dataclasses import replace

import bmesh
import bpy
import numpy as np
import pytest
from scenes import activate, positions, values
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.faults import DOUBTFUL, FLIPPED, WITHOUT_PARTNER
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.select_faults import select_faults
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points


def selected(obj):
    """Which vertices and faces are selected after leaving Edit Mode."""
    if bpy.context.mode != "EDIT_MESH":
        bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.object.mode_set(mode="OBJECT")
    chosen = []
    for elements in (obj.data.vertices, obj.data.polygons):
        array = np.zeros(len(elements), dtype=bool)
        elements.foreach_get("select", array)
        chosen.append(array)
    return chosen


def keep(target, **parts):
    """Store the match with other parts."""
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    kept = stored_match.read(target.data, pair)
    stored_match.write(target.data, replace(kept, **parts), pair, {})


def share_of_faces(obj, chosen):
    area = np.array([polygon.area for polygon in obj.data.polygons])
    return area[chosen].sum() / area.sum()


def test_vertices_of_low_confidence_are_selected_and_no_others(source, target):
    keep_true_match(target, doubtful=40)
    for polygon in target.data.polygons:
        polygon.select = True
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    assert bpy.ops.zoomout.select_doubtful() == {"FINISHED"}
    vertices, _ = selected(target)
    np.testing.assert_array_equal(vertices, np.arange(len(vertices)) < 40)


def test_message_gives_count_and_share_of_area(source, target):
    keep_true_match(target, doubtful=40)
    area = jobs.run(read_pair(bpy.context, "Source", "Target")).target.share_of_area(
        np.arange(len(target.data.vertices)) < 40
    )
    said = select_faults(bpy.context, target, DOUBTFUL)
    assert said == f"Doubtful: 40 vertices of 'Target', {area:.1%} of its area"
    assert select_faults(bpy.context, target, FLIPPED) == "Flipped: no faces of 'Target', 0.0% of its area"


@pytest.mark.parametrize("mirrored", [False, True])
def test_flipped_faces_are_selected(source, target, mirrored):
    keep_true_match(target)
    triangle = values(target.data, "zoomout_triangle").copy()
    weights = values(target.data, "zoomout_barycentric").copy()
    points = positions(target.data)
    if mirrored:  # all are flipped: each vertex goes to where its mirror image is
        pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
        triangle, weights = closest_points(points * [1, -1, 1], pair.source.vertices, pair.source.triangles)
    tip = points[:, 0].argmax()
    around = next(edge for edge in target.data.edges if tip in edge.vertices[:])
    other = around.vertices[0] if around.vertices[1] == tip else around.vertices[1]
    triangle[[tip, other]], weights[[tip, other]] = triangle[[other, tip]], weights[[other, tip]]
    surface_map = zo.SurfaceMap(
        triangle, weights.astype(float), jobs.run(read_pair(bpy.context, "Source", "Target")).source.triangles
    )
    keep(target, surface_map=surface_map)
    assert bpy.ops.zoomout.select_flipped() == {"FINISHED"}
    _, faces = selected(target)
    at_both = np.array([{tip, other} <= set(polygon.vertices) for polygon in target.data.polygons])
    near = np.array([bool({tip, other} & set(polygon.vertices)) for polygon in target.data.polygons])
    assert faces[at_both].all()
    assert not faces[~near].any()
    said = select_faults(bpy.context, target, FLIPPED)
    assert said == f"Flipped: {faces.sum()} faces of 'Target', {share_of_faces(target, faces):.1%} of its area"
    keep(target, has_partner=np.arange(len(points)) != tip)
    assert bpy.ops.zoomout.select_flipped() == {"FINISHED"}
    assert not selected(target)[1][at_both].any()  # vertices without a partner have no place to be wrong about


def test_vertices_without_partner_are_selected_on_both_meshes(source, target):
    keep_true_match(target)
    with pytest.raises(RuntimeError, match="has no information about partners: match again"):
        bpy.ops.zoomout.select_without_partner()
    low, high = (positions(obj.data)[:, 2] * sign > 0.3 for obj, sign in ((target, -1), (source, 1)))
    keep(target, has_partner=~low, source_has_partner=~high)
    said = select_faults(bpy.context, target, WITHOUT_PARTNER)
    np.testing.assert_array_equal(selected(target)[0], low)
    activate(source)
    np.testing.assert_array_equal(selected(source)[0], high)
    assert said.startswith(f"Without a partner: {low.sum()} vertices of 'Target', ")
    assert f"; {high.sum()} vertices of 'Source', " in said


def test_source_with_vertex_adding_modifiers_is_unchanged(source, target):
    source.modifiers.new("Finer", "SUBSURF").levels = 1
    bpy.context.view_layer.update()
    keep_true_match(target)
    finer = len(jobs.run(read_pair(bpy.context, "Source", "Target")).source.vertices)
    keep(target, has_partner=np.ones(len(target.data.vertices), bool), source_has_partner=np.arange(finer) > 9)
    said = select_faults(bpy.context, target, WITHOUT_PARTNER)
    assert said == "Without a partner: no vertices of 'Target', 0.0% of its area"


@pytest.mark.parametrize("operator", ["select_doubtful", "select_flipped", "select_without_partner"])
def test_without_a_match_or_after_an_edit_nothing_is_selected(source, target, operator):
    with pytest.raises(RuntimeError, match="Match this mesh first"):
        getattr(bpy.ops.zoomout, operator)()
    keep_true_match(target)
    target.data.vertices[5].co.x += 1
    before = [vertex.select for vertex in target.data.vertices]
    with pytest.raises(RuntimeError, match="was edited since"):
        getattr(bpy.ops.zoomout, operator)()
    assert [vertex.select for vertex in target.data.vertices] == before


def test_selection_is_visible_in_edit_mode(source, target):
    keep_true_match(target, doubtful=40)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    assert bpy.ops.zoomout.select_doubtful() == {"FINISHED"}
    assert bpy.context.mode == "EDIT_MESH"
    chosen = [vert.index for vert in bmesh.from_edit_mesh(target.data).verts if vert.select]
    assert chosen == list(range(40))
