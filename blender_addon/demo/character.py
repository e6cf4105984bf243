# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's character as a Blender artist would deliver it: UVs, skin weights, an armature and paint."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.samples.implicit import Ellipsoid, Solid, surface_net
from zoomout_core.samples.skeletons import BoneRow

from . import shape
from .seams import seam_edges

UV_MAP = "UVMap"
PAINT = "Paint"

MIDDLE_BONES = [
    BoneRow("hips", None, (0, 0.02, 0.52), (0, 0, 0.66)),
    BoneRow("spine", "hips", (0, 0, 0.66), (0, 0, 0.82)),
    BoneRow("chest", "spine", (0, 0, 0.82), (0, 0, 0.97)),
    BoneRow("neck", "chest", (0, 0, 0.97), (0, 0, 1.09)),
    BoneRow("head", "neck", (0, 0, 1.09), (0, -0.02, 1.42)),
    BoneRow("tail_1", "hips", (0, 0.12, 0.48), (0, 0.30, 0.37)),
    BoneRow("tail_2", "tail_1", (0, 0.30, 0.37), (0, 0.52, 0.30)),
    BoneRow("tail_3", "tail_2", (0, 0.52, 0.30), (0, 0.72, 0.34)),
    BoneRow("tail_4", "tail_3", (0, 0.72, 0.34), (0, 0.87, 0.47)),
    BoneRow("tail_5", "tail_4", (0, 0.87, 0.47), (0, 0.935, 0.62)),
]
LEFT_BONES = [
    BoneRow("ear.L", "head", (0.16, 0.03, 1.36), (0.38, 0.09, 1.65)),
    BoneRow("shoulder.L", "chest", (0.03, 0, 0.90), (0.16, 0, 0.87)),
    BoneRow("upper_arm.L", "shoulder.L", (0.16, 0, 0.87), (0.34, 0.012, 0.81)),
    BoneRow("forearm.L", "upper_arm.L", (0.34, 0.012, 0.81), (0.56, 0, 0.755)),
    BoneRow("hand.L", "forearm.L", (0.56, 0, 0.755), (0.665, -0.005, 0.74)),
    BoneRow("thumb.L", "hand.L", (0.613, -0.02, 0.77), (0.572, -0.048, 0.885)),
    BoneRow("index.L", "hand.L", (0.67, -0.012, 0.795), (0.74, -0.023, 0.866)),
    BoneRow("middle.L", "hand.L", (0.69, -0.006, 0.743), (0.82, -0.017, 0.754)),
    BoneRow("ring.L", "hand.L", (0.67, -0.006, 0.69), (0.78, -0.016, 0.636)),
    BoneRow("thigh.L", "hips", (0.12, 0, 0.50), (0.15, -0.02, 0.29)),
    BoneRow("shin.L", "thigh.L", (0.15, -0.02, 0.29), (0.155, 0.03, 0.085)),
    BoneRow("foot.L", "shin.L", (0.155, 0.03, 0.085), (0.17, -0.10, 0.05)),
    BoneRow("toes.L", "foot.L", (0.17, -0.10, 0.05), (0.182, -0.21, 0.04)),
]
BONES = MIDDLE_BONES + LEFT_BONES + [row.mirrored() for row in LEFT_BONES]


def build_character(cell: float) -> tuple[bpy.types.Object, bpy.types.Object]:
    """Build the character and its armature, and link both to the scene.

    Args:
        cell: approximate edge length, in metres; 0.0135 gives about 25,000 vertices.

    Returns:
        The mesh object (UV map, vertex groups, colour attribute) and the armature object.
    """
    vertices, faces = surface_net(cell, shape.SOLIDS, shape.BOUNDS)
    mesh = bpy.data.meshes.new("Character")
    mesh.from_pydata(vertices, [], faces)
    mesh.shade_smooth()
    character = bpy.data.objects.new("Character", mesh)
    bpy.context.scene.collection.objects.link(character)
    _paint(mesh, vertices)
    _unwrap(character, vertices, faces)
    return character, rig(character)


def select_only(active: bpy.types.Object, *others: bpy.types.Object) -> None:
    """Select only these objects, and make the first one active."""
    bpy.ops.object.select_all(action="DESELECT")
    for each in (active, *others):
        each.select_set(True)
    bpy.context.view_layer.objects.active = active


# --- paint --------------------------------------------------------------------------------------------------

SKIN, BELLY, STRIPE = (0.10, 0.38, 0.30), (0.87, 0.72, 0.42), (0.03, 0.16, 0.19)
LEFT, RIGHT = (0.85, 0.23, 0.04), (0.33, 0.10, 0.62)
EYE, PUPIL = (0.90, 0.90, 0.86), (0.01, 0.01, 0.015)


def _paint(mesh: bpy.types.Mesh, vertices: Floats) -> None:
    """Paint warm colours on the left, cool ones on the right, stripes on the back, and a face."""
    x, y, z = vertices.T
    color = np.tile(SKIN, (len(vertices), 1))

    def paint(rgb: tuple[float, float, float], depth: Floats, softness: float) -> None:
        opacity = np.clip(0.5 + depth / softness, 0, 1)[:, None]
        color[:] = color * (1 - opacity) + np.multiply(rgb, opacity)

    def inside(solid: Solid) -> Floats:
        return -solid.distance(vertices)

    paint(BELLY, inside(Ellipsoid((0, -0.2, 0.66), (0.15, 0.16, 0.23))), 0.03)
    paint(BELLY, inside(Ellipsoid((0, -0.30, 1.11), (0.15, 0.17, 0.085))), 0.03)
    striped = np.isin(shape.nearest_part(vertices), ("torso", "tail")) & (y > 0)
    width = 0.028 - 0.15 * np.abs(x)
    paint(STRIPE, np.where(striped, width - np.abs((y - z + 3) % 0.16 - 0.08), -1), 0.02)
    for side, rgb in ((1, LEFT), (-1, RIGHT)):
        paint(rgb, side * x - 0.50, 0.05)  # mitten
        paint(rgb, np.minimum(side * x - 0.24, z - 1.45), 0.05)  # ear
        paint(rgb, np.minimum(side * x, 0.12 - z), 0.05)  # shoe
    for solid in (shape.EYE_LEFT, shape.EYE_LEFT.mirrored()):
        middle = np.array(solid.centre)
        inwards = -np.sign(middle[0])
        paint(EYE, 0.007 + inside(solid), 0.012)
        paint(PUPIL, 0.055 - np.linalg.norm(vertices - middle - (0.015 * inwards, -0.06, -0.005), axis=1), 0.015)
        paint(EYE, 0.018 - np.linalg.norm(vertices - middle - (0.01, -0.06, 0.025), axis=1), 0.012)
    for solid in (shape.NOSTRIL_LEFT, shape.NOSTRIL_LEFT.mirrored()):
        paint(STRIPE, inside(solid), 0.015)

    layer = mesh.color_attributes.new(PAINT, "FLOAT_COLOR", "POINT")
    layer.data.foreach_set("color", np.column_stack([color, np.ones(len(color))]).ravel())


# --- UVs ----------------------------------------------------------------------------------------------------


def _unwrap(character: bpy.types.Object, vertices: Floats, faces: Integers) -> None:
    """Mark seams and unwrap the body."""
    mesh = character.data
    edges, face_edges = np.empty(2 * len(mesh.edges), dtype=np.int32), np.empty(faces.size, dtype=np.int32)
    mesh.edges.foreach_get("vertices", edges)
    mesh.loops.foreach_get("edge_index", face_edges)
    mesh.edges.foreach_set("use_seam", seam_edges(vertices, faces, edges.reshape(-1, 2), face_edges.reshape(-1, 4)))
    unwrap_islands(character)


def unwrap_islands(obj: bpy.types.Object) -> None:
    """Unwrap an object at its seams, into an atlas of islands."""
    obj.data.uv_layers.new(name=UV_MAP)
    select_only(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.unwrap(method="ANGLE_BASED", margin=0.01)
    bpy.ops.uv.select_all(action="SELECT")
    bpy.ops.uv.average_islands_scale()
    bpy.ops.uv.pack_islands(margin=0.01)
    bpy.ops.object.mode_set(mode="OBJECT")


# --- armature -----------------------------------------------------------------------------------------------


def rig(character: bpy.types.Object, bones: Sequence[BoneRow] = BONES) -> bpy.types.Object:
    """Add an armature with the bones of a table, and bind the character to it with Blender's automatic weights."""
    armature = bpy.data.objects.new("Armature", bpy.data.armatures.new("Armature"))
    bpy.context.scene.collection.objects.link(armature)
    select_only(armature)
    bpy.ops.object.mode_set(mode="EDIT")
    for row in bones:
        bone = armature.data.edit_bones.new(row.name)
        bone.head, bone.tail = row.head, row.tail
        bone.parent = armature.data.edit_bones[row.parent] if row.parent else None
    bpy.ops.object.mode_set(mode="OBJECT")
    select_only(armature, character)
    bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    select_only(character)
    bpy.ops.object.mode_set(mode="WEIGHT_PAINT")
    bpy.ops.object.vertex_group_smooth(group_select_mode="ALL", factor=0.5, repeat=10)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.vertex_group_clean(group_select_mode="ALL", limit=0.01)
    bpy.ops.object.vertex_group_normalize_all(lock_active=False)
    smooth = character.modifiers.new("Corrective Smooth", "CORRECTIVE_SMOOTH")
    smooth.iterations = 10
    return armature
