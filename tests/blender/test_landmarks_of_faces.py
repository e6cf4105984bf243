# SPDX-License-Identifier: GPL-3.0-or-later
"""The landmarks of a face come from its keys, and their partners from the match."""

import bpy
import numpy as np
import pytest
from face_masks import make_face
from scenes import activate, from_pydata
from test_landmarks import add, numbers, world
from test_proposed_partners import proposed, where
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon.scene.landmarks import landmark_pairs
from zoomout_core.transfer.keys.face_landmarks import FACE_LANDMARKS

FACE = make_face()
VERTICES = FACE.surface.vertices
PLACES = VERTICES[list(zo.propose_face_landmarks(FACE.surface, FACE.keys).values())]


@pytest.fixture
def heads():
    """A mask with keys, and one without that was matched and moved."""
    faces = FACE.surface.triangles.tolist()
    source, target = (from_pydata(name, VERTICES.tolist(), faces) for name in ("Source", "Target"))
    source.shape_key_add(name="Basis")
    for number, name in enumerate(FACE.keys.labels):
        block = source.shape_key_add(name=name)
        block.value = 0
        block.data.foreach_set("co", (VERTICES + FACE.keys.values[:, number]).astype(np.float32).ravel())
    bpy.context.view_layer.update()
    keep_true_match(target)
    target.location.x = 4
    bpy.context.view_layer.update()
    activate(target, source)
    return source, target


def test_landmarks_are_named_on_the_source_and_proposed_on_the_target(heads):
    source, target = heads
    source.data.shape_keys.key_blocks["jawOpen"].value = 1  # they belong to the face at rest
    bpy.context.view_layer.update()
    assert bpy.ops.zoomout.face_landmarks() == {"FINISHED"}
    source.data.shape_keys.key_blocks["jawOpen"].value = 0
    assert [landmark.name for landmark in bpy.context.scene.zoomout.landmarks] == list(FACE_LANDMARKS)
    assert numbers(source) == proposed(target) == list(range(1, 13))
    places = world(source)
    np.testing.assert_allclose([places[number] for number in range(1, 13)], PLACES, atol=1e-5)
    np.testing.assert_allclose([where(target, i) for i in range(1, 13)], PLACES + np.array([4, 0, 0]), atol=1e-3)
    assert bpy.ops.zoomout.confirm_landmarks() == {"FINISHED"}
    assert landmark_pairs(bpy.context, source, target).numbers == tuple(range(1, 13))


def test_landmarks_that_were_moved_stay_there(heads):
    source, _ = heads
    add(source, 5, 0.3, 0.3, 0)  # a number in use
    add(source, 7, 0.1, 0.1, 0.4, name="Nose")
    moved = world(source)[7]
    assert bpy.ops.zoomout.face_landmarks() == {"FINISHED"}
    np.testing.assert_allclose(world(source)[7], moved)
    assert len(numbers(source)) == 13
    assert sorted({landmark.name for landmark in bpy.context.scene.zoomout.landmarks}) == sorted(
        [*FACE_LANDMARKS, "Landmark 5"]
    )


def test_a_source_without_the_keys_is_refused(heads):
    source, _ = heads
    source.shape_key_remove(source.data.shape_keys.key_blocks["jawOpen"])
    with pytest.raises(RuntimeError, match="There is no shape key jawOpen: add one"):
        bpy.ops.zoomout.face_landmarks()
    source.shape_key_clear()
    with pytest.raises(RuntimeError, match="'Source' has no shape keys"):
        bpy.ops.zoomout.face_landmarks()
    assert not len(bpy.context.scene.zoomout.landmarks)
