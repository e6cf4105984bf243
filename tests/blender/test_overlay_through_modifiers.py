# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours over objects whose modifiers change the topology."""

import bpy
import numpy as np
import pytest
from scenes import activate, add_uv_map, positions, snapshot_file
from test_target_modifiers import add_modifier

from blender_addon.services.matching.match import match_objects
from blender_addon.viewport import evaluated_values, overlay, preview


def seen():
    """The drawn content of the first overlay's object."""
    bpy.context.view_layer.update()
    one, *_ = overlay.overlays()
    obj = overlay.find(one.object_uid)
    return overlay.visible_surface(one, obj, obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def evaluated(obj):
    bpy.context.view_layer.update()
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data


@pytest.fixture
def shown(source, target):
    """The positions of a match as colours."""
    match_objects(bpy.context, source, target, initial="nearest")
    activate(target, source)
    bpy.ops.zoomout.preview(kind="PLACES")
    return overlay.overlays()[0].values


@pytest.mark.parametrize("kind", ["SUBSURF", "MULTIRES", "MIRROR", "ARRAY", "SOLIDIFY", "NODES", "BEVEL"])
def test_modifier_geometry_is_coloured_like_the_mesh(target, shown, kind):
    add_modifier(target, kind)
    before = snapshot_file()
    assert seen() is None  # copies are not made while the views are drawn
    evaluated_values.compute_requested()
    assert snapshot_file() == before
    surface = seen()
    made = evaluated(target)
    assert len(surface["position"]) == len(surface["color"]) == len(made.vertices) > len(shown)
    if kind == "BEVEL":
        return
    np.testing.assert_allclose(surface["color"][: len(shown)], shown, atol=1e-6)
    if kind == "MIRROR":  # which has a second copy, except merged vertices
        nearest = np.abs(positions(made)[:, None] * [-1, 1, 1] - positions(target.data)[None]).sum(axis=2)
        copied = np.arange(len(made.vertices)) >= len(shown)
        np.testing.assert_allclose(surface["color"][copied], shown[nearest.argmin(axis=1)[copied]], atol=1e-6)


def test_colours_follow_a_modifier_that_is_added_changed_or_removed(target, shown):
    assert len(seen()["color"]) == len(shown)
    modifier = add_modifier(target, "SUBSURF")
    counts = []
    for level in (1, 2):
        modifier.levels = level
        assert seen() is None
        evaluated_values.compute_requested()
        counts.append(len(seen()["color"]))
    assert counts[1] > 3 * counts[0]
    target.modifiers.remove(modifier)
    assert len(seen()["color"]) == len(shown)


def test_checker_is_drawn_on_modifier_geometry(source, target):
    add_uv_map(source.data, "UVMap")
    add_modifier(target, "SUBSURF")
    match_objects(bpy.context, source, target, initial="nearest")
    activate(target, source)
    bpy.ops.zoomout.preview(kind="CHECKER")
    assert seen() is None
    evaluated_values.compute_requested()
    assert len(seen()["color"]) == len(evaluated(target).loops)


def test_legend_reports_colours_lost_by_modifiers(target, shown):
    plane = bpy.data.node_groups.new("Other", "GeometryNodeTree")
    plane.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    made, end = plane.nodes.new("GeometryNodeMeshGrid"), plane.nodes.new("NodeGroupOutput")
    plane.links.new(made.outputs[0], end.inputs[0])
    target.modifiers.new("Other", "NODES").node_group = plane
    assert preview.legend(preview.current()) == preview.current().legend
    assert seen() is None
    evaluated_values.compute_requested()
    assert seen() is None
    assert preview.legend(preview.current()) == preview.LOST


def test_legend_explains_hidden_colours_in_other_modes(target, shown):
    bpy.ops.object.mode_set(mode="SCULPT")
    assert preview.legend(preview.current()) == preview.HIDDEN
    bpy.ops.object.mode_set(mode="OBJECT")
    assert preview.legend(preview.current()) == preview.current().legend
