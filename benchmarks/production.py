# SPDX-License-Identifier: GPL-3.0-or-later
"""Live links beside the operator: their difference, and the time that Blender takes to evaluate them while painting."""

from __future__ import annotations

from time import perf_counter, process_time
from typing import Any

import bpy
import numpy as np
from bpy.types import Object

from blender_addon import mesh_data, registered
from blender_addon.demo.character import build_character, select_only
from blender_addon.demo.target import remeshed
from blender_addon.services.live_link import keep_linked
from blender_addon.services.match import match_objects
from zoomout_core.arrays import Floats

# Edge length of the character and voxel size of the target, in metres, and number of the target's vertices.
CELL, VOXEL, VERTICES = 0.0067, 0.006, 50_000
# Evaluations of which the median is taken, after one that is not counted.
EVALUATIONS = 7
KINDS = ("uv_maps", "color_attributes", "attributes", "vertex_groups")

Row = dict[str, Any]


def run(cell: float = CELL, voxel: float = VOXEL, vertices: int = VERTICES) -> dict[str, list[Row]]:
    """Link the demo's character to another mesh of it, one kind of data after the other.

    Returns:
        `link`: for each kind the number of layers, the share of elements that follow, the largest difference from what
        the operator wrote, and milliseconds of an evaluation after an edit of the source: of the processor in all
        threads, and on the clock; evaluations without the link are subtracted.
    """
    with registered():
        source, target = make_pair(cell, voxel, vertices)
        match_objects(bpy.context, source, target, initial="nearest")
        return {"link": [_measure(source, target, kind) for kind in KINDS]}


def make_pair(cell: float, voxel: float, vertices: int) -> tuple[Object, Object]:
    """The demo's character, and the same shape as another mesh, in the same place."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    source, _ = build_character(cell)
    heat = source.data.attributes.new("heat", "FLOAT", "POINT")
    heat.data.foreach_set("value", mesh_data.read_positions(source.data)[:, 2])
    posed = source.copy()
    posed.data = source.data.copy()
    bpy.context.scene.collection.objects.link(posed)
    target = remeshed(posed, voxel, vertices)
    bpy.data.meshes.remove(posed.data)
    select_only(target, source)
    return source, target


def _measure(source: Object, target: Object, kind: str) -> Row:
    shares = keep_linked(bpy.context, target, [kind])
    modifier = mesh_data.link_modifier(target)
    assert modifier is not None
    linked = _values(target)
    with_link = _milliseconds(source, target)
    modifier.show_viewport = False
    written = _values(target)
    without = _milliseconds(source, target)
    mesh_data.remove_link(target)
    processor, clock = (max(0.0, one - other) for one, other in zip(with_link, without, strict=True))
    return {
        "data": kind,
        "vertices": len(target.data.vertices),
        "layers": len(shares),
        "follows %": 100 * float(np.mean(list(shares.values()))),
        "difference": max(float(np.abs(linked[name] - written[name]).max()) for name in shares),
        "CPU ms": processor,
        "ms": clock,
    }


def _milliseconds(source: Object, target: Object) -> tuple[float, float]:
    """The median time of an evaluation after the source's data was edited, of the processor and on the clock."""
    times = []
    for _ in range(1 + EVALUATIONS):
        source.data.update()
        target.data.update()
        processor, clock = process_time(), perf_counter()
        bpy.context.evaluated_depsgraph_get().update()
        times.append((1000 * (process_time() - processor), 1000 * (perf_counter() - clock)))
    processor, clock = np.median(times[1:], axis=0).tolist()
    return processor, clock


def _values(obj: Object) -> dict[str, Floats]:
    """The numbers of all layers and vertex groups of an object after its modifiers."""
    with mesh_data.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as (evaluated, mesh):
        layers, _ = mesh_data.read_layers(mesh)
        weights = mesh_data.read_weights(evaluated, mesh)
    found = {
        layer.attribute.name: np.asarray(layer.attribute.values, float)
        for layer in layers
        if layer.data_type in mesh_data.NODE_TYPES
    }
    return found | {name: weights.values[:, [number]].toarray() for number, name in enumerate(weights.labels)}
