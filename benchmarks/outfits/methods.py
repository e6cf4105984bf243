# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods to dress another body: ours, and those of Blender for a body that has been wrapped to the other's shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np
from bpy.types import Object
from scipy.sparse import csr_array

import zoomout_core as zo
from benchmarks.outfits.cases import HAIR, Case
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.outfits.parts import is_hair
from zoomout_core.transfer import (
    JointPairs,
    Manner,
    PosedBody,
    Skeleton,
    WeightedBody,
    align_joints,
    clear_in_poses,
    fit_to_shape,
    follow_weights,
)
from zoomout_core.transfer.rigging.poses import gentle_poses

# The axis that points up.
UP = 1


@dataclass(frozen=True, eq=False)
class Fitted:
    """A case's things on the target.

    Attributes:
        vertices: (n, 3) positions of each.
        keys: for each thing (n, 3) offsets of the target's keys by name; none from a method without keys.
        joints: (j, 3) heads of each thing's own bones; none from a method that does not move them.
        weights: (n, b) skin weights of each; none from a method that keeps them.
    """

    vertices: list[Floats]
    keys: list[dict[str, Floats]] = field(default_factory=list)
    joints: list[Floats] = field(default_factory=list)
    weights: list[Floats] = field(default_factory=list)


# Fits the things of a case, given the source's vertices (n_s, 3) in the target's shape.
Way = Callable[[Case, Floats], Fitted]


def dress(case: Case, shape: Floats, stiffness: float = 0.5, align: bool = True) -> Fitted:
    """Ours; with the joints of both bodies aligned, if they are known and this is wanted."""
    things = list(case.things.values())
    if align:
        shape = _align(case, shape)
    manners: list[Manner] = ["hair" if name in HAIR or is_hair(name, ()) else "automatic" for name in case.things]
    dressed = fit_to_shape(case.source, shape, case.target, things, manners=manners, stiffness=stiffness)
    if case.body is None:
        return Fitted(list(dressed.vertices))
    assert case.weights is not None
    before, after = (
        WeightedBody(surface, normalise(csr_array(weights)))
        for surface, weights in ((case.source, case.weights), (case.target, case.body.weights))
    )
    given = [csr_array(garment.weights) for garment in case.garments.values()]
    weights = follow_weights(before, after, things, dressed.vertices, given, shape=shape)
    poses = gentle_poses(case.body.bones.heads, case.body.bones.parents, UP)
    vertices = list(
        clear_in_poses(dressed, PosedBody(after.weights, poses), [normalise(each) for each in weights]).vertices
    )
    names, offsets = list(case.body.keys), np.stack(list(case.body.keys.values()), axis=1)
    worn = [thing.with_vertices(points) for thing, points in zip(things, vertices, strict=True)]
    followed = zo.follow_keys(case.target, offsets, worn)
    keys = [dict(zip(names, each.transpose(1, 0, 2), strict=True)) for each in followed]
    joints = [
        zo.move_joints(thing, points, garment.joints).positions
        for thing, points, garment in zip(things, vertices, case.garments.values(), strict=True)
    ]
    return Fitted(vertices, keys, joints, [each.toarray() for each in weights])


def _align(case: Case, shape: Floats) -> Floats:
    """The source's vertices in the target's shape, with aligned joints if they are known."""
    if case.body is None or case.heads is None or case.weights is None:
        return shape
    rig = case.body.bones
    bones, others = (Skeleton(rig.names, rig.parents, heads) for heads in (case.heads, rig.heads))
    return align_joints(case.source, shape, case.target, JointPairs.of(bones, csr_array(case.weights), others))


def bind_to_nearest(case: Case, shape: Floats) -> Fitted:
    """Bind each vertex and joint to the nearest triangle of the skin, with its offset in that triangle's frame.

    Offsets are scaled like the whole body.
    Keys displace each vertex like the nearest point of the target's skin.
    """
    carried = _NearestTriangles(case.source, shape)
    vertices = [carried(thing.vertices) for thing in case.things.values()]
    if case.body is None:
        return Fitted(vertices)
    keys = []
    for points in vertices:
        triangle, weights = closest_points(points, case.target.vertices, case.target.triangles)
        corners = case.target.triangles[triangle]
        keys.append({name: np.einsum("nc,ncx->nx", weights, moved[corners]) for name, moved in case.body.keys.items()})
    return Fitted(vertices, keys, [carried(garment.joints) for garment in case.garments.values()])


class _NearestTriangles:
    """Positions relative to the nearest triangle of a body, which takes another shape (n_s, 3)."""

    def __init__(self, body: Surface, shape: Floats) -> None:
        self._body, self._shape = body, shape
        self._growth = procrustes(body.vertices, shape).scale

    def __call__(self, points: Floats) -> Floats:
        """(q, 3) points carried to the other shape."""
        triangle, weights = closest_points(points, self._body.vertices, self._body.triangles)
        corners = self._body.triangles[triangle]
        (feet, frames), (images, turned) = (
            (np.einsum("qc,qcx->qx", weights, places[corners]), _frames(places[corners]))
            for places in (self._body.vertices, self._shape)
        )
        return np.asarray(images + self._growth * np.einsum("qxa,qya,qy->qx", turned, frames, points - feet))


def _frames(corners: Floats) -> Floats:
    """(q, 3, 3) orthonormal axes, as columns, of triangles (q, 3, 3)."""
    first = unit_vectors(corners[:, 1] - corners[:, 0])
    normal = unit_vectors(np.cross(first, corners[:, 2] - corners[:, 0]))
    return np.stack([first, np.cross(normal, first), normal], axis=2)


def scale_box(case: Case, shape: Floats) -> Fitted:
    """Scale everything with the bounding box of the body, along each axis."""
    low, high = (getattr(case.source.vertices, side)(axis=0) for side in ("min", "max"))
    low_after, high_after = (getattr(shape, side)(axis=0) for side in ("min", "max"))
    growth = (high_after - low_after) / (high - low)
    return Fitted([low_after + growth * (thing.vertices - low) for thing in case.things.values()])


def surface_deform(case: Case, shape: Floats) -> Fitted:
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
        return Fitted([motion(_visible_positions(obj)) for obj in things])
    finally:
        for obj in (body, *things):
            bpy.data.meshes.remove(obj.data)


WAYS: dict[str, Way] = {
    "dress": dress,
    "dress, stiff": partial(dress, stiffness=0.8),
    "dress, by the skin alone": partial(dress, align=False),
    "Surface Deform": surface_deform,
    "nearest triangle": bind_to_nearest,
    "box": scale_box,
}
# `bind_to_nearest` with the true map, which no method has.
BY_TRUE_MAP = "nearest triangle, true map"
# The authors' own outfit on the target, if it is known.
TRUE = "truth"


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
