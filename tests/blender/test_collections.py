# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters of several objects."""

from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix
from scenes import (
    activate,
    decimate,
    ellipsoid,
    from_pydata,
    link,
    positions,
    set_weights,
    snapshot_file,
    weight_array,
)

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.scene.selection import own_sources
from blender_addon.services.matching.collection_match import match_collections
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points

# Where the eyes are on the bodies, and how large they are.
EYES = {"Eye.L": (0.8, 0.25, 0.3), "Eye.R": (0.8, -0.25, 0.3)}
SIZE = 0.08


def ball(name, where, subdivisions):
    mesh = bpy.data.meshes.new(name)
    working = bmesh.new()
    bmesh.ops.create_icosphere(working, subdivisions=subdivisions, radius=SIZE, matrix=Matrix.Translation(where))
    working.to_mesh(mesh)
    working.free()
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def gather(name, objects):
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    for obj in objects:
        collection.objects.link(obj)
    return collection


@pytest.fixture
def hero():
    objects = [ball(name, where, 3) for name, where in EYES.items()] + [ellipsoid("Body", 5)]
    set_weights(objects[0], "eye_bone.L", np.ones(len(objects[0].data.vertices)))
    return gather("Hero", objects)


@pytest.fixture(params=["named", "nameless"])
def scan(hero, request):
    """The same character, rotated and moved, with other meshes, and the same or other names."""
    objects = [decimate("Body")] + [ball(name, where, 2) for name, where in EYES.items()]
    for number, obj in enumerate(objects):
        obj.matrix_world = Matrix.Translation((5, 1, 0)) @ Matrix.Rotation(1.2, 4, "Z") @ Matrix.Rotation(0.4, 4, "X")
        if request.param == "nameless":
            obj.name = f"geo{number}"
    bpy.context.view_layer.update()
    return gather("Scan", objects)


@pytest.mark.slow(but=1)
def test_each_part_is_matched_with_its_partner(hero, scan):
    body, left, right = scan.objects
    found = match_collections(bpy.context, hero, scan)
    assert {name: source for name, (source, _) in found.items()} == {
        body.name: "Body",
        left.name: "Eye.L",
        right.name: "Eye.R",
    }
    for obj in (body, left, right):
        source = bpy.data.objects[found[obj.name][0]]
        kept = stored_match.read(obj.data, jobs.run(read_pair(bpy.context, source.name, obj.name)))
        image = kept.surface_map.interpolate(positions(source.data))
        assert np.linalg.norm(image - positions(obj.data), axis=1).mean() < 0.03
        assert kept.verdict.level == "green"
    report = transfer_objects(bpy.context, bpy.data.objects["Eye.L"], left, ["vertex_groups"])
    assert report["written"]["vertex_groups"] == ["eye_bone.L"]
    np.testing.assert_allclose(weight_array(left, "eye_bone.L"), 1)


@pytest.mark.slow
def test_one_mesh_receives_from_all_objects_that_it_lies_on(hero):
    scan = gather("Scan", [decimate("Whole")])
    whole = scan.objects[0]
    editable = bmesh.new()
    editable.from_mesh(whole.data)
    bmesh.ops.create_icosphere(editable, subdivisions=2, radius=SIZE, matrix=Matrix.Translation(EYES["Eye.L"]))
    editable.to_mesh(whole.data)
    editable.free()
    body = bpy.data.objects["Body"]
    set_weights(body, "spine", np.ones(len(body.data.vertices)))
    ((source, match),) = match_collections(bpy.context, hero, scan).values()
    assert (source, match.others) == ("Body", ("Eye.L",))
    assert any("'Whole' corresponds to several objects" in note and "'Body', 'Eye.L'" in note for note in match.notes)
    report = transfer_objects(bpy.context, body, whole, ["vertex_groups"])
    eye = np.linalg.norm(positions(whole.data) - EYES["Eye.L"], axis=1) < 1.01 * SIZE
    assert report["others"] == ["Eye.L"]
    np.testing.assert_allclose(weight_array(whole, "eye_bone.L"), eye, atol=1e-3)
    np.testing.assert_allclose(weight_array(whole, "spine"), ~eye, atol=1e-3)


@pytest.mark.parametrize(("fault", "sentence"), [("empty", "no mesh in"), ("shared", "is in both collections")])
def test_invalid_collections_are_refused_in_one_sentence(hero, fault, sentence):
    other = gather("Other", [hero.objects[0]] if fault == "shared" else [from_pydata("Nothing", [], [])])
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match=sentence):
        match_collections(bpy.context, hero, other)
    assert snapshot_file() == before


@pytest.mark.slow(but=1)
def test_transfer_uses_each_targets_own_source(hero, scan):
    settings = bpy.context.scene.zoomout
    assert not bpy.ops.zoomout.match_collections.poll()
    settings.source_collection, settings.target_collection = hero, scan
    assert bpy.ops.zoomout.match_collections() == {"FINISHED"}
    body, left, right = scan.objects
    assert set(bpy.context.selected_objects) == {body, left, right}
    assert bpy.context.active_object in (body, left, right)
    assert set(own_sources(bpy.context)) == {body.name, left.name, right.name}
    set_weights(bpy.data.objects["Body"], "spine", np.ones(len(bpy.data.objects["Body"].data.vertices)))
    activate(left, body)
    assert bpy.ops.zoomout.transfer() == {"FINISHED"}
    assert [obj.vertex_groups.keys() for obj in (body, left, right)] == [["spine"], ["eye_bone.L"], []]
    stranger = ellipsoid("Stranger", 3)
    bpy.context.view_layer.update()
    activate(left, stranger)
    with pytest.raises(RuntimeError, match="'Stranger' was not matched yet: match it first"):
        bpy.ops.zoomout.transfer(own_sources=True)


def slab(name, height, width):
    """A box around the z axis, from 0 to a height, of many faces."""
    mesh = bpy.data.meshes.new(name)
    working = bmesh.new()
    matrix = Matrix.Translation((0, 0, height / 2)) @ Matrix.Diagonal((width, width, height, 1))
    bmesh.ops.create_cube(working, size=1, matrix=matrix)
    bmesh.ops.subdivide_edges(working, edges=working.edges[:], cuts=4, use_grid_fill=True)
    working.to_mesh(mesh)
    working.free()
    return link(name, mesh)


def test_boots_match_boots_under_overlapping_trousers(monkeypatch):
    hero = gather("Hero", [slab("King_Legs", 1.0, 0.31), slab("King_Boots", 0.4, 0.3)])
    scan = gather("Scan", [slab("Casual_Legs", 1.0, 0.31), slab("Casual_Boots", 0.5, 0.3)])

    def all_on_trousers(source, target, regions, **_):
        trousers, _ = regions[0]
        triangles = np.flatnonzero(np.isin(source.triangles, trousers).all(axis=1))
        found, barycentric = closest_points(target.vertices, source.vertices, source.triangles[triangles])
        surface_map = zo.SurfaceMap(triangles[found], barycentric, source.triangles)
        masks = (surface.vertices[:, 0] < 0.1 for surface in (target, source))
        return SimpleNamespace(
            surface_map=surface_map,
            confidence=np.ones(len(found)),
            has_partner=next(masks),
            source_has_partner=next(masks),
            notes=(),
        )

    monkeypatch.setattr(zo, "match", all_on_trousers)
    found = match_collections(bpy.context, hero, scan)
    assert found["Casual_Legs"][0] == "King_Legs"
    boots, match = found["Casual_Boots"]
    assert (boots, match.others) == ("King_Boots", ("King_Legs",))  # their tops are too far from the boots
    on_boots = match.surface_map.triangle < len(hero.objects["King_Boots"].data.loop_triangles)
    height = positions(scan.objects["Casual_Boots"].data)[:, 2]
    assert on_boots[height <= 0.4].all()
    assert not on_boots[height == height.max()].any()
    # Each target knows which vertices of its own, and of the sources in their order, have a partner.
    np.testing.assert_array_equal(match.has_partner, positions(scan.objects["Casual_Boots"].data)[:, 0] < 0.1)
    sources = [positions(hero.objects[name].data)[:, 0] < 0.1 for name in ("King_Boots", "King_Legs")]
    np.testing.assert_array_equal(match.source_has_partner, np.concatenate(sources))
    assert 0.1 < min(match.without_partner) <= max(match.without_partner) < 0.4
