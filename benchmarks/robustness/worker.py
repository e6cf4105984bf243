# SPDX-License-Identifier: GPL-3.0-or-later
"""Run one tool on one case in its own process: `python -m benchmarks.robustness.worker TOOL TARGET [SOURCE]`.

It prints the result as JSON. A tool reads a file, or transfers the source's positions to the target, which coincides
with it, so that the transferred positions give the error.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats

Answer = dict[str, Any]


def _ours(target: str, source: str | None) -> Answer:
    import zoomout_core as zo

    try:
        if source is None:
            zo.read_surface(target)
            return {"read": True}
        ours = zo.read_surface(source)
        result = zo.match(ours, target)
    except (zo.MeshError, ImportError) as error:
        return {"said": str(error)}
    carried = result.surface_map.interpolate(ours.vertices)
    return {"carried": carried.tolist(), "doubts": [*result.notes, *(["uncertain"] if result.certainty < 0.9 else [])]}


def _pyfm(target: str, source: str | None) -> Answer:
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh

    from benchmarks.robustness.cases import landmarks

    if source is None:
        return {"read": bool(TriMesh.load(target).n_vertices)}
    first, second = TriMesh.load(source), TriMesh.load(target)
    model = FunctionalMapping(first, second)
    model.preprocess(landmarks=landmarks())  # descriptors alone cannot distinguish left and right
    model.fit(K=(30, 30))
    model.zoomout_refine(nit=12, step=5)
    return {"carried": np.asarray(first.vertices)[model.get_p2p()].tolist(), "doubts": []}


def _data_transfer(target: str, source: str | None) -> Answer:
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    readers = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import, ".stl": bpy.ops.wm.stl_import}

    def read(path: str) -> Any:
        options = {"forward_axis": "Y", "up_axis": "Z"}
        before = set(bpy.data.objects)
        readers[Path(path).suffix](filepath=path, **options)
        made = [obj for obj in bpy.data.objects if obj not in before]
        return made[0] if made else None

    try:
        if source is None:
            made = read(target)
            return {"read": made is not None and bool(len(made.data.polygons))}
        first, second = read(source), read(target)
    except RuntimeError as error:  # an operator's failure
        return {"said": str(error)}
    if second is None:
        return {"doubts": ["nothing was read"]}
    points = np.empty((len(first.data.vertices), 3), np.float32)
    first.data.vertices.foreach_get("co", points.ravel())
    low, high = points.min(), points.max()
    colors = np.ones((len(points), 4), np.float32)
    colors[:, :3] = (points - low) / (high - low)
    first.data.color_attributes.new("at", "FLOAT_COLOR", "POINT").data.foreach_set("color", colors.ravel())
    modifier = second.modifiers.new("transfer", "DATA_TRANSFER")
    modifier.object, modifier.use_vert_data = first, True
    modifier.data_types_verts, modifier.vert_mapping = {"COLOR_VERTEX"}, "POLYINTERP_NEAREST"
    second.data.color_attributes.new("at", "FLOAT_COLOR", "POINT")
    evaluated = second.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    found = np.empty((len(evaluated.vertices), 4), np.float32)
    evaluated.color_attributes["at"].data.foreach_get("color", found.ravel())
    return {"carried": (low + found[:, :3].astype(float) * (high - low)).tolist(), "doubts": []}


def _meshlab(target: str, source: str | None) -> Answer:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    try:
        if source is None:
            meshes.load_new_mesh(target)
            return {"read": bool(meshes.current_mesh().face_number())}
        meshes.load_new_mesh(source)
        axes: list[Floats] = []
        meshes.load_new_mesh(target)
        for axis in "xyz":
            meshes.set_current_mesh(0)
            meshes.compute_scalar_by_function_per_vertex(q=axis)
            meshes.transfer_attributes_per_vertex(sourcemesh=0, targetmesh=1, qualitytransfer=True)
            axes.append(meshes.mesh(1).vertex_scalar_array())
    except pymeshlab.PyMeshLabException as error:
        return {"said": str(error)}
    return {"carried": np.column_stack(axes).tolist(), "doubts": []}


TOOLS: dict[str, Callable[[str, str | None], Answer]] = {
    "zoomout_core": _ours,
    "pyFMaps": _pyfm,
    "Data Transfer": _data_transfer,
    "MeshLab": _meshlab,
}

if __name__ == "__main__":
    answer = TOOLS[sys.argv[1]](sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)
    print(json.dumps(answer))
