# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost of undoing the transfer of everything to 100,000 vertices in one step."""

from __future__ import annotations

import gc
import resource
from collections.abc import Callable
from ctypes import CDLL
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import bpy
import numpy as np
from bpy.types import Object

import blender_addon
from benchmarks.transfer.load import GROUPS, KEYS, SIZE, burden
from blender_addon import jobs, mesh_data
from blender_addon.demo import Size, make_demo_objects
from blender_addon.demo.character import select_only
from blender_addon.mesh_data.arrays import hash_of, read_array
from blender_addon.scene.pair import read_pair
from blender_addon.storage import stored_match

Record = dict[str, Any]


@blender_addon.registered()
def rows(size: Size = SIZE, groups: int = GROUPS, keys: int = KEYS) -> list[Record]:
    """Transfer everything along the true map, then undo and redo it, like the keyboard.

    Args:
        size: number of vertices of the character and of the target.
        groups: number of the source's vertex groups.
        keys: number of its shape keys.

    Returns:
        For the transfer, the stored undo step, undo, and redo: the wall-clock and
        processor seconds, the memory that stays allocated, and whether the target is right.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    demo = make_demo_objects(size)
    burden(demo.character, groups, keys)
    match = stored_match.StoredMatch(demo.truth.surface_map, demo.truth.known.astype(float), ())
    pair = jobs.run(read_pair(bpy.context, demo.character.name, demo.target.name))
    stored_match.write(demo.target.data, match, pair, {})
    bpy.context.scene.zoomout.source = demo.character
    select_only(demo.target)
    name = demo.target.name
    del demo, pair, match
    bpy.ops.ed.undo_push(message="Before")
    before = _content(bpy.data.objects[name])
    made = [_measure("transfer", bpy.ops.zoomout.transfer)]
    after = _content(bpy.data.objects[name])
    made.append(_measure("keep a step of undo", lambda: bpy.ops.ed.undo_push(message="Transfer")))
    for step, wanted in (("undo", before), ("redo", after)):
        made.append(_measure(step, getattr(bpy.ops.ed, step)) | {"exact": _content(bpy.data.objects[name]) == wanted})
    return [made[0] | {"exact": before != after}, made[1] | {"exact": None}, *made[2:]]


def _measure(step: str, work: Callable[[], object]) -> Record:
    clock, processor, memory = perf_counter(), process_time(), _resident()
    work()
    return {
        "step": step,
        "seconds": perf_counter() - clock,
        "processor": process_time() - processor,
        "MB more": (_resident() - memory) / 2**20,
    }


def _resident() -> int:
    """Resident memory of the process in bytes, after freed memory has been returned."""
    gc.collect()
    CDLL("libc.so.6").malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _content(obj: Object) -> str:
    """A hash of all data that a transfer writes to an object."""
    mesh = obj.data
    words = [str(sorted(items)) for items in (mesh.items(), obj.items())]
    words += [str(names.keys()) for names in (obj.vertex_groups, mesh.materials)]
    arrays = []
    for attribute in mesh.attributes:
        words.append(f"{attribute.name} {attribute.data_type} {attribute.domain}")
        arrays.append(mesh_data.read_layer(mesh, attribute.name).attribute.values)
    records = ((v.index, g.group, g.weight) for v in mesh.vertices for g in v.groups)
    arrays.append(np.fromiter(records, np.dtype([("vertex", "i4"), ("group", "i4"), ("weight", "f4")])))
    for key in mesh.shape_keys.key_blocks if mesh.shape_keys else ():
        words.append(f"{key.name} {key.value} {key.relative_key.name}")
        arrays.append(read_array(key.points, "co", np.float32, 3))
    return hash_of("\n".join(words), *arrays)
