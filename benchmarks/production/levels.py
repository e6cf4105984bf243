# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail beside those of Blender's modifiers: errors at rest and in poses.

A level is compared with the character in poses. Two further errors separate the geometry of a level from its weights.
The first is that of the level with exact weights, interpolated at the place of each vertex on the character. The second
is that of another level with as many vertices, made from the character in this pose and without weights. No single mesh
can reach the second in all poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import bpy
import numpy as np
from bpy.types import Object
from scipy.sparse import csr_array

from blender_addon.demo.character import build_character, select_only
from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import NORMALS, SHAPE_KEYS, Asset, at_rest
from zoomout_core.assets.files import read_asset
from zoomout_core.assets.level import joint_poses
from zoomout_core.assets.lods import make_lods
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.maps.surface_map import interpolation_matrix
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.transfer.rigging.poses import pose_of_turns

Row = dict[str, Any]

# Poses of each kind: extreme ones, to which levels are fitted, and random ones, to which they are not.
POSES = 2
# Standard deviation of the random turns of a joint about each axis, in degrees.
TURN = 20.0
# Vertices of the character whose distances from a level are averaged.
POINTS = 5000


def levels_beside_blender(cell: float, ratios: Sequence[float]) -> list[Row]:
    """The levels of the demo's character, made here and by Blender, and their errors in percent of the extent.

    Args:
        cell: edge length of the character, in metres.
        ratios: shares of the vertices that levels keep.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    character, rig = build_character(cell)
    rows = []
    with TemporaryDirectory() as folder:
        asset = through_file(character, rig, Path(folder) / "character.glb")
        errors = _Errors(asset, ratios)
        for number, (ratio, level) in enumerate(zip(ratios, make_lods(asset, ratios), strict=True)):
            rows.append(errors.row("zoomout lods", number, level.asset))
            made = _decimate_in_blender(character, ratio)
            theirs = through_file(made, rig, Path(folder) / "level.glb")
            bpy.data.meshes.remove(made.data)
            rows.append(errors.row("Decimate, Data Transfer", number, theirs))
    return rows


class _Errors:
    """The errors of levels of an asset at rest."""

    def __init__(self, asset: Asset, ratios: Sequence[float]) -> None:
        assert asset.skin is not None
        self.asset, self.skin, self.ratios = asset, asset.skin, ratios
        used = np.unique(asset.surface.triangles)
        self.points = np.random.default_rng(0).permutation(used)[:POINTS]
        self.extent = float(np.ptp(asset.surface.vertices[used], axis=0).max())
        heads = np.linalg.pinv(self.skin.inverse_bind)[:, :3, 3]
        random = np.random.default_rng(0).normal(size=(POSES, len(heads), 3)) * np.radians(TURN)
        self.fitted = [*joint_poses(asset, POSES)]
        self.left_out = [pose_of_turns(turns, heads, self.skin.parents) for turns in random]
        self.search = SurfaceSearch(asset.surface.vertices, asset.surface.triangles)
        self.posed = [_pose(self.skin.rest, self.skin.weights, pose) for pose in (*self.fitted, *self.left_out)]
        self.alone = np.array([self._errors_alone(posed) for posed in self.posed])  # (poses, ratios)

    def row(self, way: str, number: int, level: Asset) -> Row:
        """A row of the table, for the level of a ratio with this number."""
        level = at_rest(level)
        assert level.skin is not None
        surface = self.asset.surface
        triangle, barycentric = self.search.closest(level.surface.vertices)
        places = interpolation_matrix(surface.triangles[triangle], barycentric, len(surface.vertices))
        own, exact = (
            np.array(
                [
                    self._distance(posed, _pose(level.skin.rest, weights, pose), level)
                    for posed, pose in zip(self.posed, (*self.fitted, *self.left_out), strict=True)
                ]
            )
            for weights in (level.skin.weights, places @ self.skin.weights)
        )
        fitted, alone = slice(POSES), self.alone[:, number]
        return {
            "share": self.ratios[number],
            "made by": way,
            "triangles": len(level.surface.triangles),
            "rest %": self._distance(surface.vertices, level.surface.vertices, level),
            "posed %": own.mean(),
            "exact weights %": exact.mean(),
            "made posed %": alone.mean(),
            "to exact weights": own.mean() / exact.mean(),
            "to made posed": own[fitted].mean() / alone[fitted].mean(),
            "in other poses": own[POSES:].mean() / alone[POSES:].mean(),
            "joints": int(np.diff(csr_array(level.skin.weights).indptr).max()),
        }

    def _errors_alone(self, posed: Floats) -> list[float]:
        """The errors of levels that are made of the asset in a pose (n, 3), without weights."""
        kept = tuple(each for each in self.asset.attributes if each.name not in (SHAPE_KEYS, NORMALS))
        still = Asset(self.asset.surface.with_vertices(posed), kept, self.asset.materials)
        return [
            self._distance(posed, level.asset.surface.vertices, level.asset) for level in make_lods(still, self.ratios)
        ]

    def _distance(self, posed: Floats, vertices: Floats, level: Asset) -> float:
        """The mean distance of the asset's vertices (n, 3) from the triangles of a level with vertices (k, 3)."""
        triangles, points = level.surface.triangles, posed[self.points]
        triangle, barycentric = SurfaceSearch(vertices, triangles).closest(points)
        nearest = np.einsum("nk,nkx->nx", barycentric, vertices[triangles[triangle]])
        return 100 * float(np.linalg.norm(points - nearest, axis=1).mean()) / self.extent


def _pose(rest: Floats, weights: csr_array, pose: Floats) -> Floats:
    """(n, 3) vertices (n, 3) after joints (b, 3, 4) moved them by weights (n, b)."""
    return transform_points(blend_matrices(pose, csr_array(weights)), rest)


def through_file(obj: Object, rig: Object, path: Path) -> Asset:
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
