# SPDX-License-Identifier: GPL-3.0-or-later
"""If meshes are edited while an operator runs, the operator reports it and writes nothing."""

from itertools import islice

import bmesh
import bpy
import numpy as np
import pytest
from scenes import add_uv_map, delete_vertex, new_material, positions, set_weights, snapshot_file
from true_match import keep_true_match
from turns import finish, turns

import zoomout_core as zo
from blender_addon.adapters import USUAL_DATA
from blender_addon.jobs import Job
from blender_addon.services.matching.collection_match import match_collections_async
from blender_addon.services.matching.match import match
from blender_addon.services.matching.seam_cut import cut_seams_async
from blender_addon.services.transfer import transfer


def moved(obj):
    obj.data.vertices[7].co.z += 0.25
    obj.data.update()


def divided(obj):
    """Change the connectivity, with the same numbers of vertices and faces."""
    editable = bmesh.new()
    editable.from_mesh(obj.data)
    editable.edges.ensure_lookup_table()
    bmesh.ops.rotate_edges(editable, edges=editable.edges[:1])
    editable.to_mesh(obj.data)
    editable.free()
    obj.data.update()


# Turns of the window after which both are read, and what they carry, in any work; and in that on collections.
LAST, LAST_OF_COLLECTIONS = 7, 5
EDITS = (moved, delete_vertex, divided)


def furnish(obj):
    """Add some data of every kind to an object."""
    x = positions(obj.data)[:, 0]
    for name, side in (("Arm.L", x > 0.3), ("Arm.R", x < -0.3)):
        set_weights(obj, name, side.astype(float))
    add_uv_map(obj.data, "Atlas")
    obj.data.materials.append(new_material("Skin"))
    obj.data.materials.append(new_material("Cloth"))
    obj.data.polygons.foreach_set("material_index", np.arange(len(obj.data.polygons)) % 2)
    obj.shape_key_add(name="Basis")
    obj.shape_key_add(name="Smile.L").points[7].co.z += 1


@pytest.fixture
def pair(source, target):
    """Two objects with data, each in its own collection, and their true match."""
    for obj in (source, target):
        furnish(obj)
        collection = bpy.data.collections.new(f"{obj.name}s")
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(obj)
    bpy.context.view_layer.update()
    keep_true_match(target)
    return {"Source": source, "Target": target}


WORK = {
    "match": lambda: match(bpy.context, "Source", "Target", k_final=30),
    "transfer": lambda: transfer(bpy.context, "Source", "Target", USUAL_DATA),
    "cut seams": lambda: cut_seams_async(bpy.context, "Source", "Target"),
    "collections": lambda: match_collections_async(bpy.context, "Sources", "Targets", k_final=30),
}


@pytest.mark.slow(but=8)
@pytest.mark.parametrize("work", WORK)
@pytest.mark.parametrize("edited", ["Source", "Target"])
@pytest.mark.parametrize("edit", EDITS)
def test_edit_during_operation_is_detected_and_nothing_written(pair, work, edited, edit):
    taken_before = range(1, LAST)
    if work == "collections":
        # Its objects are read one after another, each as it is then.
        taken_before = range(3 if edited == "Target" else 1, LAST_OF_COLLECTIONS + 1)
    # One kind of edit is made at every turn, the others at the first and the last.
    for taken in taken_before if edit is moved else (taken_before[0], taken_before[-1]):
        job = Job(WORK[work]())
        assert len([*islice(turns(job), taken)]) == taken
        edit(pair[edited])
        bpy.context.view_layer.update()
        before = snapshot_file()
        with pytest.raises(zo.MeshError, match=f"'{edited}' was edited during the operation: start again"):
            finish(job)
        assert snapshot_file() == before
        keep_true_match(pair["Target"])
