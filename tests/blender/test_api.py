"""The functions for scripts and other add-ons do what their documentation shows."""

import doctest

import bpy
import numpy as np
import pytest
from scenes import add_uv_map, ellipsoid, set_weights

import zoomout_core as zo
from blender_addon import api


@pytest.fixture
def objects():
    hero, scan = ellipsoid("Hero", 4), ellipsoid("Scan", 4)
    add_uv_map(hero.data, "UVMap")
    set_weights(hero, "Bone", np.ones(len(hero.data.vertices)))
    bpy.context.view_layer.update()
    return hero, scan


def test_the_example_runs(objects):
    hero, scan = objects
    found = doctest.DocTestFinder().find(api, globs={"api": api, "context": bpy.context, "hero": hero, "scan": scan})
    (example,) = [test for test in found if test.name == api.__name__]
    assert len(example.examples) >= 9
    assert doctest.DocTestRunner().run(example).failed == 0


def test_a_vertex_that_is_none_is_one_sentence(objects):
    for vertex in (-1, 642):
        with pytest.raises(zo.MeshError, match=f"'Hero' is no mesh with a vertex {vertex}"):
            api.set_landmark(bpy.context, objects[0], 1, vertex)


def test_every_name_is_explained():
    for name in api.__all__:
        assert getattr(api, name).__doc__ or name.isupper()
