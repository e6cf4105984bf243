# SPDX-License-Identifier: GPL-3.0-or-later
"""Two characters of 52,000 vertices in Blender, one of which has all data that operators use."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.types import Object

from benchmarks.transfer.load import burden
from blender_addon import mesh_data
from blender_addon.demo.character import select_only
from zoomout_core.mesh.formats.files import read_surface

# Two poses of a man, and of a horse in the same collection. Meshes of one class have the same vertex order.
CHARACTERS, COMPANIONS = ("michael0", "michael10"), ("horse0", "horse6")
# The source's data, and the distance between the poses relative to its size.
GROUPS, KEYS, APART = 30, 10, 1.5
# Displacement of one side's vertices for a sculpt, relative to the size of the mesh.
SCULPT = 0.01


def is_there(data: Path) -> bool:
    """Whether a folder of sets has the files of the scene."""
    return all(_path(data, name).is_file() for name in CHARACTERS + COMPANIONS)


def make_pair(data: Path) -> tuple[Object, Object]:
    """Build a file with a source and a target beside it, and register the add-on."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    source, target = (_object(name, data, name) for name in CHARACTERS)
    target.location.x = APART * max(source.dimensions)
    bpy.context.view_layer.update()
    select_only(source)
    burden(source, GROUPS, KEYS)
    bpy.context.scene.zoomout.source = source
    bpy.context.view_layer.update()
    return source, target


def put_together() -> None:
    """Move the target to the source."""
    bpy.context.active_object.location.x = 0
    bpy.context.view_layer.update()


def make_collections(data: Path) -> None:
    """Put copies of both, each with a companion, into collections, and choose these."""
    settings = bpy.context.scene.zoomout
    for names, role in zip(zip(CHARACTERS, COMPANIONS, strict=True), ("source", "target"), strict=True):
        collection = bpy.data.collections.new(role)
        bpy.context.scene.collection.children.link(collection)
        setattr(settings, f"{role}_collection", collection)
        for name in names:
            obj = _object(f"{name} of {role}", data, name)
            bpy.context.scene.collection.objects.unlink(obj)
            collection.objects.link(obj)
    bpy.context.view_layer.update()


def sculpt(obj: Object) -> None:
    """Move the vertices of one half of an object's mesh."""
    places = mesh_data.read_rest_positions(obj.data)
    half = places[:, 0] > np.median(places[:, 0])
    mesh_data.move_vertices(obj.data, SCULPT * np.ptp(places, axis=0).max() * half[:, None] * np.ones(3))


def _object(name: str, data: Path, mesh_name: str) -> Object:
    surface, mesh = read_surface(_path(data, mesh_name)), bpy.data.meshes.new(name)
    mesh.from_pydata(surface.vertices.tolist(), [], surface.triangles.tolist())
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _path(data: Path, name: str) -> Path:
    return data / "tosca_full" / f"{name}.off"
