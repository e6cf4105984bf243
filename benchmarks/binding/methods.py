# SPDX-License-Identifier: GPL-3.0-or-later
"""Ways to bind a target to a rig: ours, and those that artists use otherwise."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import bpy
import numpy as np
from bpy.types import Object

import zoomout_core as zo
from benchmarks.binding.cases import Case
from blender_addon import api, jobs
from blender_addon.demo.character import select_only
from blender_addon.scene.pair import read_pair
from blender_addon.storage import stored_match

# A method gets a target without data, whose match is stored unless it is the truth's, and binds it to the rig.
Way = Callable[[Case, Object], None]


def bind(case: Case, target: Object) -> None:
    """Ours, by the match."""
    api.bind_to_rig(bpy.context, case.source, target, hide_source=False)


def bind_by_truth(case: Case, target: Object) -> None:
    """Ours, along the true map, which leaves the errors of binding only."""
    pair = jobs.run(read_pair(bpy.context, case.source.name, target.name))
    sure = np.ones(len(target.data.vertices))
    stored_match.write(target.data, stored_match.StoredMatch(case.truth, sure, ()), pair, {})
    api.bind_to_rig(bpy.context, case.source, target, hide_source=False)


def weights_alone(case: Case, target: Object) -> None:
    """Weights by the match, and an Armature modifier, without a change of the rest pose."""
    api.transfer_objects(bpy.context, case.source, target, ["vertex_groups"])
    target.modifiers.new("Armature", "ARMATURE").object = case.armature


def data_transfer(case: Case, target: Object) -> None:
    """Blender's Data Transfer of weights from the nearest faces, and an Armature modifier."""
    select_only(case.source, target)
    bpy.ops.object.data_transfer(
        data_type="VGROUP_WEIGHTS",
        layers_select_src="ALL",
        layers_select_dst="NAME",
        vert_mapping="POLYINTERP_NEAREST",
    )
    target.modifiers.new("Armature", "ARMATURE").object = case.armature


WAYS: dict[str, Way] = {
    "Bind to Rig": bind,
    "Bind to Rig, true map": bind_by_truth,
    "weights alone": weights_alone,
    "Data Transfer": data_transfer,
}


def match_bare(case: Case) -> tuple[Object, float, float]:
    """A bare target, matched without hints; seconds and certainty."""
    mesh = bpy.data.meshes.new("Target")
    mesh.from_pydata(case.target.vertices, [], case.target.triangles)
    target = bpy.data.objects.new("Target", mesh)
    bpy.context.scene.collection.objects.link(target)
    bpy.context.view_layer.update()
    zo.forget_shapes()
    begin = perf_counter()
    match = api.match_objects(bpy.context, case.source, target)
    certainty = match.certainty if isinstance(match, zo.MatchResult) else 0.0
    return target, perf_counter() - begin, certainty
