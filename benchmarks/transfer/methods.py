# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods to transfer everything from a source to a target: ours, and those that artists have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import bpy
import numpy as np
from mathutils import Matrix
from scipy.sparse import csr_array

import zoomout_core as zo
from benchmarks.transfer.cases import Case
from blender_addon import jobs, mesh_data
from blender_addon.demo.baseline import KINDS, transfer_best
from blender_addon.demo.character import PAINT
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.match import match_objects
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from zoomout_core.transfer import Attribute, Domain, Kind

# A method gets a target without data, and returns its time.
Way = Callable[[Case, bpy.types.Object], float]
DATA = ("uv_maps", "vertex_groups", "color_attributes", "materials", "shape_keys")


def by_match(case: Case, target: bpy.types.Object) -> float:
    """Ours, without hints."""
    zo.forget_shapes()
    start = perf_counter()
    match_objects(bpy.context, case.source, target)
    transfer_objects(bpy.context, case.source, target, DATA)
    return perf_counter() - start


def by_truth(case: Case, target: bpy.types.Object) -> float:
    """Ours along the true map: its error is that of the transfer alone."""
    start = perf_counter()
    pair = jobs.run(read_pair(bpy.context, case.source.name, target.name))
    trust = case.truth.known.astype(float)
    stored_match.write(target.data, stored_match.StoredMatch(case.truth.surface_map, trust, ()), pair, {})
    transfer_objects(bpy.context, case.source, target, DATA)
    return perf_counter() - start


def by_proximity(case: Case, target: bpy.types.Object) -> float:
    """Ours by nearest points if these are near and face the same way, filled in elsewhere.

    For weights, this is robust transfer by inpainting (Abdrashitov et al. 2023).
    """
    start = perf_counter()
    match_objects(bpy.context, case.source, target, initial="nearest")
    transfer_objects(bpy.context, case.source, target, DATA)
    return perf_counter() - start


def by_data_transfer(case: Case, target: bpy.types.Object) -> float:
    """Blender's Data Transfer, with the best mapping for each kind of data."""
    start = perf_counter()
    transfer_best(case.source, target, case.truth)
    trials = sum(len(kind.mappings) + 1 for kind in KINDS.values())
    return (perf_counter() - start) * len(KINDS) / trials


def by_meshlab(case: Case, target: bpy.types.Object) -> float:
    """MeshLab's transfer of vertex attributes: colours, and weights as the quality of vertices, group by group."""
    import pymeshlab  # after bpy, which cannot be imported after pymeshlab

    start = perf_counter()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    source = mesh_data.read_source_surface(case.source, depsgraph)
    bare = mesh_data.read_target_surface(target, depsgraph)
    paint = mesh_data.read_layer(case.source.data, PAINT).attribute.values.astype(float)
    weights = mesh_data.read_weights(case.source, case.source.data)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(bare.vertices, bare.triangles))
    columns: list[np.ndarray] = []
    for column in weights.values.toarray().T.astype(float):
        meshes.add_mesh(pymeshlab.Mesh(source.vertices, source.triangles, v_color_matrix=paint, v_scalar_array=column))
        meshes.apply_filter(
            "transfer_attributes_per_vertex",
            sourcemesh=meshes.current_mesh_id(),
            targetmesh=0,
            colortransfer=not columns,
            qualitytransfer=True,
        )
        columns.append(meshes.mesh(0).vertex_scalar_array())
    colors = np.array(meshes.mesh(0).vertex_color_matrix())
    layer = mesh_data.Layer(Attribute(PAINT, Domain.POINT, Kind.COLOR, colors), mesh_data.Role.COLOR, "FLOAT_COLOR")
    mesh_data.write_layer(target.data, layer)
    mesh_data.write_weights(target, replace(weights, values=csr_array(np.stack(columns, axis=1))))
    return perf_counter() - start


def align(way: Way) -> Way:
    """A method preceded by the best rigid alignment."""

    def after_alignment(case: Case, target: bpy.types.Object) -> float:
        target.matrix_world = Matrix(case.aligned) @ target.matrix_world
        bpy.context.view_layer.update()
        return way(case, target)

    return after_alignment


WAYS: dict[str, Way] = {
    "ZoomOut": by_match,
    "true map": by_truth,
    "proximity": by_proximity,
    "proximity, aligned": align(by_proximity),
    "Data Transfer": by_data_transfer,
    "Data Transfer, aligned": align(by_data_transfer),
    "MeshLab": by_meshlab,
    "MeshLab, aligned": align(by_meshlab),
}
