# SPDX-License-Identifier: GPL-3.0-or-later
"""Live links beside the operator: their difference and time; levels of detail beside Blender's; compressed files."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

import bpy
import numpy as np
from bpy.types import Object
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from blender_addon import mesh_data, registered
from blender_addon.demo.character import build_character, select_only
from blender_addon.demo.target import remeshed
from blender_addon.services.live_link import keep_linked
from blender_addon.services.matching.match import match_objects
from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import UV, Asset, at_rest, on_corners
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.gltf.compress import METHODS
from zoomout_core.assets.lods import errors_of_level, make_lods
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap

# Edge length of the character and voxel size of the target, in metres, and number of the target's vertices.
CELL, VOXEL, VERTICES = 0.0067, 0.006, 50_000
# Evaluations of which the median is taken, after one that is not counted.
EVALUATIONS = 7
# Edge length of the character whose levels are made, in metres, and their shares of the vertices.
DETAILED, RATIOS = 0.0134, (0.5, 0.25, 0.1)
KINDS = ("uv_maps", "color_attributes", "attributes", "vertex_groups")

Row = dict[str, Any]


def run(
    cell: float = CELL, voxel: float = VOXEL, vertices: int = VERTICES, detailed: float = DETAILED
) -> dict[str, list[Row]]:
    """Link the demo's character to another mesh of it, one kind of data after the other, and make its levels.

    Returns:
        `link`: for each kind the number of layers, the share of elements that follow, the largest difference from what
        the operator wrote, and milliseconds of an evaluation after an edit of the source: of the processor in all
        threads, and on the clock; evaluations without the link are subtracted. `lods`: for each level the mean
        distance of the character's vertices from it, in percent of the extent, at rest, in poses with its own weights,
        and in poses with all weights at the places of its vertices, beside a *Decimate* and a *Data Transfer* modifier.
        `compression`: the size of the character's file in each way, and the largest differences when it is read again.
    """
    with registered():
        source, target = make_pair(cell, voxel, vertices)
        match_objects(bpy.context, source, target, initial="nearest")
        link = [_measure(source, target, kind) for kind in KINDS]
    return {"link": link, "lods": make_levels(detailed), "compression": compress(detailed)}


def make_pair(cell: float, voxel: float, vertices: int) -> tuple[Object, Object]:
    """The demo's character, and the same shape as another mesh, in the same place."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    source, _ = build_character(cell)
    heat = source.data.attributes.new("heat", "FLOAT", "POINT")
    heat.data.foreach_set("value", mesh_data.read_positions(source.data)[:, 2])
    posed = source.copy()
    posed.data = source.data.copy()
    bpy.context.scene.collection.objects.link(posed)
    target = remeshed(posed, voxel, vertices)
    bpy.data.meshes.remove(posed.data)
    select_only(target, source)
    return source, target


def make_levels(cell: float) -> list[Row]:
    """The levels of the demo's character, made here and by Blender."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    character, rig = build_character(cell)
    rows = []
    with TemporaryDirectory() as folder:
        asset = _through_file(character, rig, Path(folder) / "character.glb")
        for ratio, level in zip(RATIOS, make_lods(asset, RATIOS), strict=True):
            errors = level.rest_error, level.posed_error, level.posed_geometry_error
            rows.append(_row_of_level("zoomout lods", ratio, level.asset, errors))
            made = _decimate_in_blender(character, ratio)
            theirs = _through_file(made, rig, Path(folder) / "level.glb")
            bpy.data.meshes.remove(made.data)
            rows.append(_row_of_level("Decimate, Data Transfer", ratio, theirs, _errors_beside(asset, theirs)))
    return rows


def compress(cell: float) -> list[Row]:
    """The demo's character in compressed files: their sizes, and the largest differences in millionths."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    character, rig = build_character(cell)
    rows = []
    with TemporaryDirectory() as folder:
        asset = _through_file(character, rig, Path(folder) / "character.glb")
        for method in (None, *METHODS):
            path = Path(folder) / f"{method}.glb"
            begin = process_time()
            write_asset(asset, path, compression=method)
            written = process_time()
            again = read_asset(path)
            rows.append(
                {
                    "compression": method or "none",
                    "kB": path.stat().st_size / 1000,
                    "write s": written - begin,
                    "read s": process_time() - written,
                    **_differences(asset, again),
                }
            )
    return rows


def _differences(asset: Asset, again: Asset) -> Row:
    """How far a file's content is from that of another one, whose vertices may have another order."""
    surface, extent = asset.surface, float(np.ptp(asset.surface.vertices, axis=0).max())
    off, place = map(np.asarray, cKDTree(again.surface.vertices).query(surface.vertices))
    faces, found = (
        {tuple(sorted(row)) for row in triangles.tolist()}
        for triangles in (place[surface.triangles], again.surface.triangles)
    )
    rows = [
        np.column_stack([each.surface.vertices[each.surface.corner_vertex] / extent, _values_of(each)])
        for each in (asset, again)
    ]
    return {
        "vertices": len(again.surface.vertices),
        "same faces %": 100 * len(faces & found) / len(faces),
        "position": 1e6 * off.max() / extent,
        "UV": 1e6 * float(np.max(cKDTree(rows[1]).query(rows[0])[0])),
        "weight": 1e6 * float(abs(csr_array(again.skin.weights)[place] - asset.skin.weights).max())
        if asset.skin is not None and again.skin is not None
        else None,
    }


def _values_of(asset: Asset) -> Floats:
    """(c, 2) the texture coordinates of an asset's corners, zero without any."""
    texture = asset.find(f"{UV} 0")
    return np.zeros((len(asset.surface.corner_vertex), 2)) if texture is None else on_corners(texture, asset.surface)


def _through_file(obj: Object, rig: Object, path: Path) -> Asset:
    """An object and its rig as Blender exports them, at rest."""
    select_only(obj, rig)
    bpy.ops.export_scene.gltf(filepath=str(path), use_selection=True, export_animations=False)
    return at_rest(read_asset(path))


def _decimate_in_blender(character: Object, ratio: float) -> Object:
    """A decimated copy of the character, whose weights a *Data Transfer* modifier takes from it."""
    made = character.copy()
    made.data = character.data.copy()
    bpy.context.scene.collection.objects.link(made)
    made.modifiers.new("Decimate", "DECIMATE").ratio = ratio
    transfer = made.modifiers.new("Data Transfer", "DATA_TRANSFER")
    transfer.object = character
    transfer.use_vert_data, transfer.data_types_verts = True, {"VGROUP_WEIGHTS"}
    transfer.vert_mapping = "POLYINTERP_NEAREST"
    select_only(made)
    for name in ("Decimate", "Data Transfer"):
        made.modifiers.move(made.modifiers.find(name), 0 if name == "Decimate" else 1)
    for name in ("Decimate", "Data Transfer"):
        bpy.ops.object.modifier_apply(modifier=name)
    return made


def _errors_beside(asset: Asset, level: Asset) -> tuple[float, float | None, float | None]:
    """The errors of a level whose places on the asset are the nearest ones."""
    surface = asset.surface
    found = SurfaceMap(*closest_points(level.surface.vertices, surface.vertices, surface.triangles), surface.triangles)
    return errors_of_level(asset, level, found)


def _row_of_level(way: str, ratio: float, level: Asset, errors: tuple[float, float | None, float | None]) -> Row:
    rest, posed, geometry = (None if error is None else 100 * error for error in errors)
    return {
        "share": ratio,
        "made by": way,
        "triangles": len(level.surface.triangles),
        "rest %": rest,
        "posed %": posed,
        "all weights %": geometry,
        "joints": int(np.diff(csr_array(level.skin.weights).indptr).max()) if level.skin else 0,
    }


def _measure(source: Object, target: Object, kind: str) -> Row:
    shares = keep_linked(bpy.context, target, [kind])
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
        "data": kind,
        "vertices": len(target.data.vertices),
        "layers": len(shares),
        "follows %": 100 * float(np.mean(list(shares.values()))),
        "difference": max(float(np.abs(linked[name] - written[name]).max()) for name in shares),
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
