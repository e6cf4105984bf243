# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of transferred data."""

from __future__ import annotations

import bpy
import numpy as np

from benchmarks.transfer.cases import Case, seams
from blender_addon import mesh_data
from blender_addon.demo.character import PAINT, UV_MAP
from blender_addon.demo.truth import color_error, torn_faces, uv_error, weight_error

# Weights that sum to one up to single precision.
SUM_TOLERANCE = 1e-4


def figures(case: Case, target: bpy.types.Object) -> dict[str, float | None]:
    """The figures of one transfer; None for data that the method does not transfer.

    UVs in widths of the UV square; weights as the sum of absolute differences at a vertex; colours as distances in
    linear RGB; keys as the relative error of offsets; seams as the ratio of their length to the source's.
    """
    mesh, truth = target.data, case.truth
    surface = mesh_data.read_target_surface(target, bpy.context.evaluated_depsgraph_get())
    row: dict[str, float | None] = dict.fromkeys(
        ["uv median", "uv 95 %", "torn", "seams", "weights", "not 1", "color", "materials", "keys"]
    )
    if UV_MAP in mesh.uv_layers:
        error = uv_error(target, truth)
        begin, end = seams(target, surface).T
        length = np.linalg.norm(surface.vertices[begin] - surface.vertices[end], axis=1).sum()
        row |= {
            "uv median": float(np.median(error)),
            "uv 95 %": float(np.percentile(error, 95)),
            "torn": torn_faces(target, surface, truth) / len(mesh.polygons),
            "seams": float(length / case.seam),
        }
    if target.vertex_groups:
        sums = mesh_data.read_weights(target, mesh).values.sum(axis=1)
        row |= {
            "weights": float(weight_error(target, truth).mean()),
            "not 1": float((np.abs(sums - 1) > SUM_TOLERANCE).mean()),
        }
    if PAINT in mesh.color_attributes:
        row["color"] = float(color_error(target, truth).mean())
    if mesh.materials:
        row["materials"] = float((_materials(target) == _wanted_values(case)).mean())
    if mesh.shape_keys:
        missed, wanted = (keys[truth.known] for keys in (_keys(target) - case.keys, case.keys))
        row["keys"] = float(np.linalg.norm(missed) / np.linalg.norm(wanted))
    return row


def _materials(target: bpy.types.Object) -> np.ndarray:
    """(f,) names of the materials of the faces."""
    names, slots = mesh_data.read_materials(target, target.data)
    return np.array(names)[slots.values]


def _wanted_values(case: Case) -> np.ndarray:
    names, _ = mesh_data.read_materials(case.source, case.source.data)
    return np.array(names)[case.material]


def _keys(target: bpy.types.Object) -> np.ndarray:
    """(n, keys, 3) offsets of the shape keys from the first."""
    positions = []
    for key in target.data.shape_keys.key_blocks:
        array = np.empty(3 * len(key.data), np.float32)
        key.data.foreach_get("co", array)
        positions.append(array.reshape(-1, 3))
    return np.stack(positions[1:], axis=1) - positions[0][:, None]
