# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of dressed bodies, one for each method."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.types import Object

from benchmarks.binding.pictures import draw
from benchmarks.outfits.cases import Case
from benchmarks.outfits.methods import TRUE, Fitted
from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.mesh.surface import Surface

# Colours of the skin, and of the objects in turn.
SKIN = (0.85, 0.55, 0.42)
COLOURS = ((0.12, 0.25, 0.6), (0.6, 0.08, 0.08), (0.85, 0.8, 0.65), (0.1, 0.1, 0.09), (0.1, 0.4, 0.15))


def picture_of_case(path: Path, case: Case, shape: Floats, found: dict[str, Fitted]) -> None:
    """The dressed source, and the target, turned like it, dressed by each method."""
    motion = procrustes(shape, case.source.vertices)
    things = list(case.things.values())
    shown = [_join_dressed(case.source.vertices, case.source, [thing.vertices for thing in things], things)]
    for way in (TRUE, "dress", "Surface Deform"):
        if way in found:
            positions = [motion(each) for each in found[way].vertices]
            shown.append(_join_dressed(motion(case.target.vertices), case.target, positions, things))
    draw(path, shown)
    for obj in shown:
        bpy.data.meshes.remove(obj.data)


def _join_dressed(points: Floats, body: Surface, worn: list[Floats], things: list[Surface]) -> Object:
    """A body and its clothes as one object, each in its own colour."""
    parts = [body.with_vertices(points), *(thing.with_vertices(each) for thing, each in zip(things, worn, strict=True))]
    whole = Surface.joined(parts)
    mesh = bpy.data.meshes.new("Dressed")
    faces = np.split(whole.corner_vertex, whole.face_start[1:-1])
    # The outfits have y up.
    mesh.from_pydata(whole.vertices[:, [0, 2, 1]] * [1, -1, 1], [], [face.tolist() for face in faces])
    for number in range(len(parts)):
        colour = SKIN if number == 0 else COLOURS[(number - 1) % len(COLOURS)]
        material = bpy.data.materials.new("Colour")
        if material.node_tree is None:  # before Blender 5.0, nodes must be enabled
            material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*colour, 1)
        mesh.materials.append(material)
    index = np.repeat(np.arange(len(parts)), [len(part.face_start) - 1 for part in parts])
    mesh.polygons.foreach_set("material_index", index.astype(np.int32))
    obj = bpy.data.objects.new("Dressed", mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj
