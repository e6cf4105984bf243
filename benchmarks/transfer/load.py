# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a transfer along a known map, by kind of data, for the data of a film character."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import groupby
from time import perf_counter, process_time
from typing import Any, NamedTuple

import bpy
import numpy as np
from scipy.sparse.csgraph import dijkstra

from blender_addon import jobs, mesh_data
from blender_addon.adapters import COLLECTORS, DEFAULT, USUAL_DATA, Adapter, Remarks, TransferJob, TransferRequest
from blender_addon.demo import Size, make_demo_objects
from blender_addon.demo.character import select_only
from blender_addon.scene.pair import read_pair
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from blender_addon.storage.stored_match import StoredMatch
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import edge_graph, triangle_areas, vertex_normals
from zoomout_core.spectral.sampling import farthest_points

Record = dict[str, Any]

# The target: rebuilt from voxels of this size in metres, and decimated to this number of vertices.
SIZE = Size(cell=0.0134, voxel=0.004, target_vertices=100_000)
# Default numbers of the source's groups, maps and keys.
GROUPS, KEYS = 60, 50
# Radius of groups and keys, and displacement of keys, relative to the square root of the area.
REACH, SWELLING = 0.12, 0.015


class Cost(NamedTuple):
    """Wall-clock and processor seconds."""

    clock: float
    processor: float


def run(size: Size = SIZE, groups: int = GROUPS, keys: int = KEYS) -> dict[str, list[Record]]:
    """Transfer everything along the true map from the demo's character to a posed and remeshed copy.

    Args:
        size: number of vertices of the character and of the target.
        groups: number of the source's vertex groups, including those of its bones.
        keys: number of its shape keys, every other one of which moves all vertices.

    Returns:
        `rows`: for each kind of data the seconds of reading, transferring and writing, and the processor
        time of all three. Shared work counts for the first kind that needs it. The last row is an artist's waiting time
        for everything along a stored match, including reading, writing and checks.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    demo = make_demo_objects(size)
    source, target = demo.character, demo.target
    burden(source, groups, keys)
    match = StoredMatch(demo.truth.surface_map, demo.truth.known.astype(float), ())
    pair, cost = _time(lambda: jobs.run(read_pair(bpy.context, source.name, target.name)))
    job = TransferJob(match, pair, Remarks(), DEFAULT, DEFAULT.blend(target))
    rows = [_row("(surfaces)", 2, {"read": cost})]
    with mesh_data.evaluated_mesh(source, bpy.context.evaluated_depsgraph_get()) as (evaluated, mesh):
        request = TransferRequest(source, evaluated, mesh, target, USUAL_DATA, DEFAULT, job.blend)
        collected = [_time(partial(collect, request, Remarks())) for collect in COLLECTORS]
    for adapters, read in collected:
        for kind, group in groupby(adapters, key=lambda one: one.kind):
            of_kind = list(group)
            costs = {"read": read, "transfer": _time(partial(_transfer, of_kind, job))[1]}
            costs["write"] = _time(partial(_write, of_kind, target))[1]
            rows.append(_row(kind, sum(len(one.names) for one in of_kind), costs))
            read = Cost(0, 0)  # layers of all kinds are read together
    totals = {name: sum(row[name] or 0 for row in rows) for name in rows[0] if name != "kind"}
    stored_match.write(target.data, match, pair, {})
    _, waiting = _time(partial(transfer_objects, bpy.context, source, target))
    return {"rows": [*rows, {"kind": "all", **totals}, _row("(in one transfer)", totals["count"], {"all": waiting})]}


def _transfer(adapters: list[Adapter], job: TransferJob) -> None:
    for one in adapters:
        one.transfer(job)


def _write(adapters: list[Adapter], target: bpy.types.Object) -> None:
    for one in adapters:
        one.write(target)


def _time(work: Callable[[], Any]) -> tuple[Any, Cost]:
    clock, processor = perf_counter(), process_time()
    result = work()
    return result, Cost(perf_counter() - clock, process_time() - processor)


def _row(kind: str, count: int, costs: dict[str, Cost]) -> Record:
    steps = {step: costs[step].clock if step in costs else None for step in ("read", "transfer", "write")}
    seconds, processor = (sum(column) for column in zip(*costs.values(), strict=True))
    return {"kind": kind, "count": count, **steps, "seconds": seconds, "processor": processor}


# --- what the source carries --------------------------------------------------------------------------------


def burden(source: bpy.types.Object, groups: int, keys: int) -> None:
    """Add vertex groups, UV maps and shape keys to the source."""
    vertices = mesh_data.read_positions(source.data).astype(float)
    triangles = mesh_data.read_surface_at_rest(source).triangles
    scale = float(np.sqrt(triangle_areas(vertices, triangles).sum()))
    near = _around(vertices / scale, triangles, max(groups, keys))
    for number in range(groups - len(source.vertex_groups)):
        group = source.vertex_groups.new(name=f"Mask {number}")
        for vertex in np.flatnonzero(near[:, number]).tolist():
            group.add((vertex,), near[vertex, number], "REPLACE")
    _unwrap(source)
    wave = 2 * np.pi * vertices / np.ptp(vertices, axis=0).max()
    normals = vertex_normals(vertices, triangles)
    source.shape_key_add(name="Basis")
    for number in range(keys):
        strength = near[:, number] if number % 2 else 0.5 + 0.5 * np.sin((1 + number / 2) * wave[:, number % 3])
        key = source.shape_key_add(name=f"Key {number}")
        key.value = 0  # Blender 5 plays new keys
        shape = vertices + SWELLING * scale * strength[:, None] * normals
        key.points.foreach_set("co", shape.astype(np.float32).ravel())


def _around(vertices: Floats, triangles: Integers, count: int) -> Floats:
    """(n, count) strengths around `count` evenly spread places at unit area: 1 there, 0 beyond a radius."""
    places = farthest_points(vertices, count)
    distance = dijkstra(edge_graph(vertices, triangles), indices=places, limit=REACH)
    part = np.clip(1 - distance.T / REACH, 0, 1)
    return np.asarray(part * part * (3 - 2 * part))


def _unwrap(source: bpy.types.Object) -> None:
    """Add two UV maps with hundreds of islands."""
    select_only(source)
    for name, unwrap in (("Smart", bpy.ops.uv.smart_project), ("Cube", bpy.ops.uv.cube_project)):
        source.data.uv_layers.active = source.data.uv_layers.new(name=name)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")
        unwrap()
        bpy.ops.object.mode_set(mode="OBJECT")
