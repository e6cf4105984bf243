# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods to dress another body: ours, and those of Blender for a body that has been wrapped to the other's shape."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from bpy.types import Object

from benchmarks.dressing.cases import Case
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import carry

# From a case and the source's vertices (n_s, 3) in the target's shape, computes (n, 3) positions of each object.
Way = Callable[[Case, Floats], list[Floats]]


def dress(case: Case, shape: Floats) -> list[Floats]:
    """Ours."""
    return list(carry(case.source, shape, case.target, list(case.things.values())).vertices)


def stiff(case: Case, shape: Floats) -> list[Floats]:
    """Ours, with stiffer cloth."""
    return list(carry(case.source, shape, case.target, list(case.things.values()), stiffness=0.8).vertices)


def displace_nearest(case: Case, shape: Floats) -> list[Floats]:
    """Align rigidly with the body, then displace each vertex like the nearest point of the skin."""
    motion, found = procrustes(case.source.vertices, shape), []
    for thing in case.things.values():
        triangle, weights = closest_points(thing.vertices, case.source.vertices, case.source.triangles)
        corners = case.source.triangles[triangle]
        feet, images = (np.einsum("nc,ncx->nx", weights, points[corners]) for points in (case.source.vertices, shape))
        found.append(motion(thing.vertices) + images - motion(feet))
    return found


def surface_deform(case: Case, shape: Floats) -> list[Floats]:
    """Blender's Surface Deform, bound to the source, which is then deformed to the target's shape at its own size.

    It is bound to triangles because it refuses concave polygons. Distances to the skin are not scaled.
    """
    motion = procrustes(case.source.vertices, shape)
    body = _object("Body", Surface(case.source.vertices, case.source.triangles))
    things = [_object(name, thing) for name, thing in case.things.items()]
    try:
        for obj in things:
            modifier = obj.modifiers.new("Bound", "SURFACE_DEFORM")
            modifier.target = body
            with bpy.context.temp_override(object=obj, active_object=obj):
                bpy.ops.object.surfacedeform_bind(modifier=modifier.name)
        body.data.vertices.foreach_set("co", motion.inverse(shape).astype(np.float32).ravel())
        body.data.update()
        bpy.context.view_layer.update()
        return [motion(_visible_positions(obj)) for obj in things]
    finally:
        for obj in (body, *things):
            bpy.data.meshes.remove(obj.data)


WAYS: dict[str, Way] = {
    "dress": dress,
    "dress, stiff": stiff,
    "Surface Deform": surface_deform,
    "nearest skin": displace_nearest,
}


def _object(name: str, surface: Surface) -> Object:
    mesh = bpy.data.meshes.new(name)
    faces = np.split(surface.corner_vertex, surface.face_start[1:-1])
    mesh.from_pydata(surface.vertices, [], [face.tolist() for face in faces])
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def _visible_positions(obj: Object) -> Floats:
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty(3 * len(evaluated.data.vertices), np.float32)
    evaluated.data.vertices.foreach_get("co", points)
    return points.reshape(-1, 3).astype(np.float64)
