# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's baseline: Blender's own Data Transfer, at its best.

It looks for the source in space, so both objects are at the same place. Each kind of data uses the mapping with the
smallest error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import bpy

from zoomout_core.arrays import Floats

from .character import select_only
from .truth import Truth, color_error, uv_error, weight_error

VERTEX_MAPPINGS = ("NEAREST", "EDGEINTERP_NEAREST", "POLYINTERP_NEAREST", "POLYINTERP_VNORPROJ")
CORNER_MAPPINGS = ("NEAREST_NORMAL", "NEAREST_POLYNOR", "NEAREST_POLY", "POLYINTERP_NEAREST", "POLYINTERP_LNORPROJ")


class KindRow(NamedTuple):
    """A kind of data: its name in the operator, its mappings, and the measure of its errors."""

    data_type: str
    option: str
    mappings: tuple[str, ...]
    error: Callable[[bpy.types.Object, Truth], Floats]


KINDS = {
    "uv": KindRow("UV", "loop_mapping", CORNER_MAPPINGS, uv_error),
    "weights": KindRow("VGROUP_WEIGHTS", "vert_mapping", VERTEX_MAPPINGS, weight_error),
    "color": KindRow("COLOR_VERTEX", "vert_mapping", VERTEX_MAPPINGS, color_error),
}


def transfer_best(source: bpy.types.Object, target: bpy.types.Object, truth: Truth) -> dict[str, dict[str, float]]:
    """Transfer UVs, weights and colours to a bare target, each with the mapping of the smallest mean error.

    Returns:
        The mean error of every mapping for each kind of data, the best first.
    """
    tried = {}
    for name, kind in KINDS.items():
        means = {mapping: _mean_error(source, target, truth, kind, mapping) for mapping in kind.mappings}
        tried[name] = dict(sorted(means.items(), key=lambda item: item[1]))
        _transfer(source, target, kind, next(iter(tried[name])))
    return tried


def _mean_error(source: bpy.types.Object, target: bpy.types.Object, truth: Truth, kind: KindRow, mapping: str) -> float:
    trial = target.copy()
    trial.data = target.data.copy()
    bpy.context.scene.collection.objects.link(trial)
    _transfer(source, trial, kind, mapping)
    mean = float(kind.error(trial, truth).mean())
    bpy.data.meshes.remove(trial.data)
    return mean


def _transfer(source: bpy.types.Object, target: bpy.types.Object, kind: KindRow, mapping: str) -> None:
    select_only(source, target)
    bpy.ops.object.data_transfer(
        data_type=kind.data_type,
        layers_select_src="ALL",
        layers_select_dst="NAME",
        **{kind.option: mapping},
    )
