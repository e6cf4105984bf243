# SPDX-License-Identifier: GPL-3.0-or-later
"""Areas without a partner are detected, stored with the match, shown, reported, and filled in or left unchanged."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest
from pieces import in_lower_half, lower_half
from scenes import (
    activate,
    add_attribute,
    add_uv_map,
    ellipsoid,
    from_pydata,
    key_shape,
    new_material,
    positions,
    set_weights,
    values,
    weight_array,
)

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.adapters import Settings
from blender_addon.operators.matching.match import _summary
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.match import match_objects
from blender_addon.services.targets import Outcome
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from blender_addon.viewport import overlay, preview
from zoomout_core.colors import LONELY, MET, confidence_colors
from zoomout_core.matching.attempt import ATTEMPTS
from zoomout_core.matching.partial.part_candidates import PART_CANDIDATES
from zoomout_core.matching.partial.part_match import PART_MATCH
from zoomout_core.matching.ranking.certainty import PART_CERTAINTY
from zoomout_core.tuning import retune


@pytest.fixture
def target(source):
    """A copy of the mesh; one end has no partner, and is mapped to the other end with full confidence."""
    obj = ellipsoid("Target", 4)
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    vertex = np.arange(len(pair.target.vertices))
    vertex[alone(obj)] = np.argmin(positions(obj.data)[:, 0])
    match = stored_match.StoredMatch(
        zo.SurfaceMap.from_vertices(vertex, pair.source),
        np.full(len(vertex), 0.9),
        (),
        has_partner=~alone(obj),
        source_has_partner=~alone(source),
        without_partner=(0.12, 0.34),
    )
    stored_match.write(obj.data, match, pair, {})
    activate(obj, source)
    return obj


def alone(obj):
    return positions(obj.data)[:, 0] > 0.6


def transfer(source, target, *data, **settings):
    return transfer_objects(bpy.context, source, target, data, Settings(**settings))


# --- kept, seen and said --------------------------------------------------------------------------------------------


def test_partner_mask_is_stored_with_the_match(source, target):
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    kept = stored_match.read(target.data, pair)
    np.testing.assert_array_equal(kept.has_partner, ~alone(target))
    np.testing.assert_array_equal(kept.source_has_partner, ~alone(source))
    assert tuple(kept.without_partner) == (0.12, 0.34)
    np.testing.assert_array_equal(values(target.data, "zoomout_has_partner"), ~alone(target))
    # A match that does not know, such as one of an earlier version, has no note.
    stored = stored_match.description(target.data)
    for name in ("source_has_partner", "without_partner"):
        del stored[name]
    target.data[stored_match.PROPERTY] = json.dumps(stored)
    target.data.attributes.remove(target.data.attributes["zoomout_has_partner"])
    bare = stored_match.read(target.data, pair)
    assert (bare.has_partner, bare.source_has_partner, bare.without_partner) == (None, None, None)
    # And one that is kept in place of another takes its mask away.
    stored_match.write(target.data, kept, pair, {})
    stored_match.write(target.data, bare, pair, {})
    assert "zoomout_has_partner" not in target.data.attributes


def test_confidence_preview_colours_missing_partners(source, target):
    bpy.ops.zoomout.preview(kind="CONFIDENCE")
    shown = {overlay.find(one.object_uid).name: one.values for one in overlay.overlays()}
    np.testing.assert_allclose(shown["Target"], np.where(alone(target)[:, None], LONELY, confidence_colors([0.9])))
    np.testing.assert_allclose(shown["Source"], np.where(alone(source)[:, None], LONELY, MET))
    scale = np.vstack([confidence_colors(np.linspace(0, 1, 20)), [MET]])
    assert np.linalg.norm(scale - LONELY, axis=1).min() > 0.4
    assert "Violet: no partner" in preview.legend(preview.preview_of(target))


def test_source_with_all_partners_is_not_coloured(source, target):
    pair = jobs.run(read_pair(bpy.context, "Source", "Target"))
    kept = stored_match.read(target.data, pair)
    everywhere = np.ones(len(source.data.vertices), dtype=bool)
    stored_match.write(
        target.data,
        stored_match.StoredMatch(kept.surface_map, kept.confidence, (), source_has_partner=everywhere),
        pair,
        {},
    )
    bpy.ops.zoomout.preview(kind="CONFIDENCE")
    assert [overlay.find(one.object_uid).name for one in overlay.overlays()] == ["Target"]


def test_operator_reports_large_areas_without_partner(source, target):
    kept = stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))
    said = _summary("Source", Outcome({"Target": kept}, {}))
    assert said.endswith("; 12% of the target and 34% of the source have no partner")
    for little in (None, (0.01, 0.02)):
        assert "no partner" not in _summary("Source", Outcome({"Target": replace(kept, without_partner=little)}, {}))
    assert "no partner" not in _summary("Source", Outcome({"Target": kept, "Other": kept}, {}))


def test_partial_match_reports_missing_areas_consistently():
    part, whole = lower_half(1500)
    source = from_pydata("Source", whole.surface.vertices, whole.surface.triangles)
    target = from_pydata("Target", part.surface.vertices, part.surface.triangles)
    activate(target, source)
    with (
        retune(ATTEMPTS, same_share=1.0),
        retune(PART_MATCH, uncertain=1.0),
        retune(PART_CERTAINTY, misfit=-50.0, another_map=2.0),
        retune(PART_CANDIDATES, landmarks=7, regions=0, registered=4),
    ):
        result = match_objects(bpy.context, source, target, k_final=60, samples=400)
    stored = stored_match.read(target.data, jobs.run(read_pair(bpy.context, "Source", "Target")))
    np.testing.assert_array_equal(stored.source_has_partner, result.source_has_partner)
    overlap = stored.source_has_partner & in_lower_half(whole)
    assert overlap.sum() > 0.85 * (stored.source_has_partner | in_lower_half(whole)).sum()
    shares = [result.share_without_partner, result.source_share_without_partner]
    assert stored_match.description(target.data)["without_partner"] == shares
    assert shares[0] < 0.1 < 0.2 < shares[1]
    set_weights(source, "Bone", np.ones(len(source.data.vertices)))
    assert transfer(source, target, "vertex_groups")["without_partner"] == shares


# --- filled in, or left as it is ------------------------------------------------------------------------------------


def dressed(obj, value):
    """Add data of every kind to an object, each derived from one number per vertex."""
    count = len(obj.data.vertices)
    add_uv_map(obj.data, "UVMap")
    obj.data.uv_layers["UVMap"].data.foreach_set("uv", np.full(2 * len(obj.data.loops), value))
    set_weights(obj, "Bone", np.full(count, value))
    add_attribute(obj.data, "Paint", "FLOAT_COLOR", "CORNER", np.full((len(obj.data.loops), 4), value))
    add_attribute(obj.data, "number", "INT", "POINT", np.full(count, round(10 * value)))
    obj.data.materials.append(new_material(f"M{value}"))
    obj.shape_key_add(name="Basis")
    obj.shape_key_add(name="Up").points.foreach_set("co", (positions(obj.data) + np.array([0, 0, value])).ravel())
    return obj


ALL = ("uv_maps", "vertex_groups", "color_attributes", "attributes", "materials", "shape_keys")


def received(obj):
    """For each kind of data the number at each vertex; for corners and faces the number at one of them."""
    mesh = obj.data
    corner = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner)
    at = np.empty(len(mesh.vertices), np.int64)
    at[corner] = np.arange(len(corner))
    material = np.array([float(mesh.materials[face.material_index].name[1:]) for face in mesh.polygons])
    return {
        "UVMap": values(mesh, "UVMap")[at, 0],
        "Bone": weight_array(obj, "Bone"),
        "Paint": values(mesh, "Paint")[at, 0],
        "number": values(mesh, "number") / 10,
        "material": material[at // 3],
        "Up": (key_shape(mesh, "Up") - key_shape(mesh, "Basis"))[:, 2],
    }


def deep(obj):
    """(n,) which vertices have no partner, and (n,) which have one, without vertices next to the other kind."""
    lone = alone(obj)
    inside, outside = lone.copy(), ~lone
    for edge in obj.data.edges:
        ends = list(edge.vertices)
        if lone[ends].any() and not lone[ends].all():
            inside[ends] = outside[ends] = False
    return inside, outside


@pytest.mark.parametrize(("how", "expected"), [("fill", 0.8), ("keep", 0.3)])
def test_missing_areas_are_filled_in_or_kept_for_every_kind(source, target, how, expected):
    """The source has another value at the wrong images."""
    dressed(target, 0.3)
    dressed(source, 0.8)
    wrong = positions(source.data)[:, 0] < -0.6
    spoil(source, wrong)
    report = transfer(source, target, *ALL, without_partner=how)
    lone, rest = deep(target)
    rest &= positions(target.data)[:, 0] > -0.3
    for name, found in received(target).items():
        np.testing.assert_allclose(found[lone], expected, atol=0.02, err_msg=name)
        np.testing.assert_allclose(found[rest], 0.8, atol=0.02, err_msg=name)
    kept = f"{alone(target).sum()} vertices without a partner keep their data."
    assert (kept in report["notes"]) is (how == "keep")


def spoil(obj, where):
    """Remove an object's data at some vertices."""
    mesh = obj.data
    corner = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner)
    uv, paint = values(mesh, "UVMap"), values(mesh, "Paint")
    uv[where[corner]], paint[where[corner]] = 0, 0
    mesh.uv_layers["UVMap"].data.foreach_set("uv", uv.ravel())
    mesh.attributes["Paint"].data.foreach_set("color", paint.ravel())
    number = values(mesh, "number")
    number[where] = 0
    mesh.attributes["number"].data.foreach_set("value", number)
    obj.vertex_groups["Bone"].remove(np.flatnonzero(where).tolist())
    key = key_shape(mesh, "Up")
    key[where] = key_shape(mesh, "Basis")[where]
    mesh.shape_keys.key_blocks["Up"].points.foreach_set("co", key.ravel())


def test_custom_normals_without_partner_can_be_kept(source, target):
    turned = np.tile([0.0, 0.6, 0.8], (len(source.data.loops), 1))
    source.data.normals_split_custom_set(turned.tolist())
    before = np.array([corner.vector for corner in target.data.corner_normals])
    transfer(source, target, "custom_normals", without_partner="keep")
    after = np.array([corner.vector for corner in target.data.corner_normals])
    corner = np.empty(len(target.data.loops), np.int32)
    target.data.loops.foreach_get("vertex_index", corner)
    lone, rest = (some[corner] for some in deep(target))
    np.testing.assert_allclose(after[lone], before[lone], atol=0.02)
    assert np.abs(after[rest] - before[rest]).max() > 0.5


def test_operator_has_the_without_partner_option(source, target):
    dressed(target, 0.3)
    dressed(source, 0.8)
    assert bpy.ops.zoomout.transfer(without_partner="KEEP", shape_keys=False, materials=False) == {"FINISHED"}
    np.testing.assert_allclose(weight_array(target, "Bone")[deep(target)[0]], 0.3, atol=1e-6)
