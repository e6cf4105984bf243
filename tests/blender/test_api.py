# SPDX-License-Identifier: GPL-3.0-or-later
"""The functions for scripts and other add-ons work as documented."""

import doctest

import bpy
import numpy as np
import pytest
from creatures import creature
from scenes import add_uv_map, ellipsoid, from_pydata, set_weights

import zoomout_core as zo
from blender_addon import api


@pytest.fixture
def objects():
    hero, scan = ellipsoid("Hero", 4), ellipsoid("Scan", 4)
    add_uv_map(hero.data, "UVMap")
    set_weights(hero, "Bone", np.ones(len(hero.data.vertices)))
    bpy.context.view_layer.update()
    return hero, scan


@pytest.mark.slow  # the tests of the installed extension run it, too
def test_the_example_runs(objects):
    made = creature(1500, seed=1, bend=0.9)
    body = from_pydata("Body", made.surface.vertices.tolist(), made.surface.triangles.tolist())
    set_weights(body, "Arm.L", np.clip(made.directions[:, 0], 0, 1))
    hat = ellipsoid("Hat", 2, (0.3, 0.3, 0.3))
    names = {
        "hat": hat,
        "api": api,
        "zo": zo,
        "context": bpy.context,
        **dict(zip(("hero", "scan"), objects, strict=True)),
        "body": body,
    }
    found = doctest.DocTestFinder().find(api, globs=names)
    (example,) = [test for test in found if test.name == api.__name__]
    assert len(example.examples) >= 13
    assert doctest.DocTestRunner().run(example).failed == 0


def test_missing_vertex_is_refused_in_one_sentence(objects):
    for vertex in (-1, 642):
        with pytest.raises(zo.MeshError, match=f"'Hero' has no vertex {vertex}"):
            api.set_landmark(bpy.context, objects[0], 1, vertex)


def test_unknown_option_is_refused_for_stored_matches(objects):
    api.match_objects(bpy.context, *objects, initial="same_order")
    with pytest.raises(TypeError, match="no option called without_partner"):
        api.transfer_objects(bpy.context, *objects, data=["uv_maps"], without_partner="keep")
    assert not objects[1].data.uv_layers
    report = api.transfer_objects(bpy.context, *objects, data=["uv_maps"], names=False, k_final=40, max_distance=0.1)
    assert report["written"]["uv_maps"] == ["UVMap"]


def test_every_public_name_is_documented():
    for name in api.__all__:
        assert getattr(api, name).__doc__ or name.isupper()
