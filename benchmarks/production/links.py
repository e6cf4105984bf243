# SPDX-License-Identifier: GPL-3.0-or-later
"""Live links beside the operator: their difference from what it writes, their time, and frames while painting."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter, process_time
from typing import Any

import bpy
import numpy as np
from bpy.types import Object

from blender_addon import mesh_data, registered
from blender_addon.demo.character import build_character, select_only
from blender_addon.demo.target import remeshed
from blender_addon.services.live_link import keep_linked
from blender_addon.services.matching.match import match_objects
from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import to_srgb

Row = dict[str, Any]

# Evaluations of which the median is taken, after one that is not counted.
EVALUATIONS = 7
# The layer whose colors are rounded to eight bits when they are stored, here and there.
EIGHT_BITS = "tint"
# Height of the zones that the character is divided into, in metres.
ZONE = 0.2
KINDS = ("uv_maps", "color_attributes", "attributes", "vertex_groups")


def link_each_kind(cell: float, voxel: float, vertices: int) -> list[Row]:
    """Link another mesh of the demo's character to it, one kind of data after the other, and all together.

    The difference is that from what the operator wrote. Milliseconds are of an evaluation after an edit of the source,
    of the processor in all threads and on the clock, less those without the link. Frames per second are those of
    whole evaluations while the source is edited, with and without the link, without drawing.
    """
    with registered():
        source, target = make_pair(cell, voxel, vertices)
        match_objects(bpy.context, source, target, initial="nearest")
        rows = [_measure(source, target, kinds) for kinds in (*((kind,) for kind in KINDS), KINDS)]
        return [*rows, _measure_groups_alone(source, target)]


def make_pair(cell: float, voxel: float, vertices: int) -> tuple[Object, Object]:
    """The demo's character with attributes of all types, and the same shape as another mesh, in the same place."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    source, _ = build_character(cell)
    places = mesh_data.read_positions(source.data)
    _add(source, "heat", "FLOAT", "POINT", "value", places[:, 2])
    _add(source, "flow", "FLOAT_VECTOR", "POINT", "vector", places)
    _add(source, "mask", "BOOLEAN", "POINT", "value", places[:, 0] > 0)
    first = np.array([face.vertices[0] for face in source.data.polygons])
    _add(source, "zone", "INT", "FACE", "value", np.floor(places[first, 2] / ZONE).astype(int))
    of_corner = np.array([loop.vertex_index for loop in source.data.loops])
    colors = np.column_stack([places[of_corner] % 1, np.ones(len(of_corner))])
    _add(source, EIGHT_BITS, "BYTE_COLOR", "CORNER", "color", colors)
    posed = source.copy()
    posed.data = source.data.copy()
    bpy.context.scene.collection.objects.link(posed)
    target = remeshed(posed, voxel, vertices)
    bpy.data.meshes.remove(posed.data)
    select_only(target, source)
    return source, target


def _add(obj: Object, name: str, data_type: str, domain: str, field: str, values: Any) -> None:
    layer = obj.data.attributes.new(name, data_type, domain)
    layer.data.foreach_set(field, np.ascontiguousarray(values).ravel())


def _measure(source: Object, target: Object, kinds: Sequence[str]) -> Row:
    """A row of the table: kinds of data that are linked together."""
    shares = keep_linked(bpy.context, target, kinds)
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
        "data": kinds[0] if len(kinds) == 1 else "all of them",
        "vertices": len(target.data.vertices),
        "layers": len(shares),
        "follows %": 100 * float(np.mean(list(shares.values()))),
        "difference": max(float(np.abs(linked[name] - written[name]).max()) for name in shares if name != EIGHT_BITS),
        "8-bit steps": _steps_apart(linked[EIGHT_BITS], written[EIGHT_BITS]) if EIGHT_BITS in shares else None,
        "CPU ms": processor,
        "ms": clock,
        "frames/s": 1000 / with_link[1],
        "without": 1000 / without[1],
    }


def _steps_apart(first: Floats, second: Floats) -> int:
    """The largest difference of scene-linear colors (q, 4), in steps of eight bits."""
    one, other = (np.rint(255 * to_srgb(each[:, :3])) for each in (first, second))
    return int(np.abs(one - other).max())


def _measure_groups_alone(source: Object, target: Object) -> Row:
    """The time of nodes that read each vertex group of the target and write it unchanged: no link can take less."""
    names = [group.name for group in target.vertex_groups]
    tree = bpy.data.node_groups.new("Groups", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    geometry = tree.nodes.new("NodeGroupInput").outputs[0]
    for name in names:
        read, stored = (tree.nodes.new(f"GeometryNode{kind}NamedAttribute") for kind in ("Input", "Store"))
        read.inputs["Name"].default_value = stored.inputs["Name"].default_value = name
        tree.links.new(geometry, stored.inputs["Geometry"])
        value = next(socket for socket in stored.inputs if socket.name == "Value" and socket.enabled)
        tree.links.new(read.outputs[0], value)
        geometry = stored.outputs[0]
    tree.links.new(geometry, tree.nodes.new("NodeGroupOutput").inputs[0])
    without = _milliseconds(source, target)
    modifier = target.modifiers.new("Groups", "NODES")
    modifier.node_group = tree
    processor, clock = (one - other for one, other in zip(_milliseconds(source, target), without, strict=True))
    target.modifiers.remove(modifier)
    return {
        "data": "vertex_groups, read and written unchanged",
        "vertices": len(target.data.vertices),
        "layers": len(names),
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
