# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail: decimated meshes of an asset, each of which receives all data from the asset itself.

Each vertex of a level takes its data from the asset's surface near the vertices that were merged into it, so nothing
is taken from another layer, such as from a body below clothes.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import NORMALS, SHAPE_KEYS, Asset
from zoomout_core.assets.transfer_asset import KINDS, transfer_asset
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.maps.surface_map import SurfaceMap, interpolation_matrix
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer.cut_mesh import cut_surface
from zoomout_core.transfer.groups import first_of_each
from zoomout_core.transfer.poses import distinct_poses, extreme_poses
from zoomout_core.transfer.skinning import blend_matrices, transform_points
from zoomout_core.transfer.weights import limit_weights

# Levels with fewer vertices than this have no faces to speak of.
MIN_VERTICES = 12


@dataclass(frozen=True, eq=False)
class Level:
    """A level of detail.

    Attributes:
        asset: the mesh with its data.
        match: the map of its vertices to the surface of the asset.
        notes: sentences for the user.
        rest_error: mean distance of the asset's vertices from the level at rest, relative to the asset's extent.
        posed_error: the same in poses that turn the joints, with the level's own weights; None without joints.
        posed_geometry_error: the same if each vertex moved with all weights at its place on the asset.
    """

    asset: Asset
    match: Any
    notes: tuple[str, ...]
    rest_error: float
    posed_error: float | None
    posed_geometry_error: float | None


@memory_in_words
def make_lods(asset: Asset, ratios: Sequence[float], max_weights: int | None = None) -> list[Level]:
    """Decimate an asset, and transfer its data to each of the levels.

    Args:
        asset: the asset, which is level 0.
        ratios: for each further level the share of vertices to keep, between 0 and 1.
        max_weights: how many joints a vertex may have; as many as on the asset, when not given.

    Returns:
        The further levels. Their vertices are in the rest pose, as one mesh, which the asset's joints move.

    Raises:
        MeshError: a ratio leaves too few vertices, or is not between 0 and 1.
    """
    source = at_rest(asset)
    working = source.surface.working
    for ratio in ratios:
        if not 0 < ratio < 1 or ratio * len(working.vertices) < MIN_VERTICES:
            raise MeshError(
                f"A level with {ratio:g} of {len(working.vertices):,} vertices cannot be made: give shares below 1, of "
                f"{MIN_VERTICES} vertices or more."
            )
    levels = []
    for number, ratio in enumerate(ratios, start=1):
        begin, end = ((number - step) / len(ratios) for step in (1, 0))
        with stage(message("Level {number}", number=number), begin, end):
            levels.append(_level(asset, source, ratio, max_weights))
    return levels


def with_fewer_weights(asset: Asset, limit: int) -> Asset:
    """An asset whose vertices keep the `limit` largest weights, see `limit_weights`."""
    if asset.skin is None:
        return asset
    weights = csr_array(asset.skin.weights.astype(np.float64))  # a copy
    limit_weights(weights, asset.surface, np.ones(weights.shape[1], dtype=bool), limit)
    return replace(asset, skin=replace(asset.skin, weights=weights))


def with_level_names(asset: Asset, level: int) -> Asset:
    """An asset whose meshes and their nodes have names that end in `_LOD0`, as engines group levels.

    Meshes that have no name get that of the file when it is written.
    """
    if asset.document is None:
        return asset
    document = copy(asset.document)
    document.gltf = deepcopy(asset.document.gltf)
    bearers = [node for node in document.gltf.nodes if node.mesh is not None]
    for each in (*document.gltf.meshes, *bearers):
        if each.name:
            each.name = f"{each.name}_LOD{level}"
    return replace(asset, document=document, look=document if asset.look is asset.document else asset.look)


def at_rest(asset: Asset) -> Asset:
    """The asset in the rest pose of its joints, with its normals and shape keys in that pose."""
    skin = asset.skin
    if skin is None:
        return asset
    attributes = []
    for each in asset.attributes:
        values = np.asarray(each.values)
        if each.name == SHAPE_KEYS:
            each = replace(each, values=np.einsum("nxy,nky->nkx", skin.linear, values))
        elif each.name == NORMALS:
            inverse = np.linalg.pinv(skin.linear)[asset.surface.corner_vertex]
            each = replace(each, values=unit_vectors(np.einsum("cyx,cy->cx", inverse, values)))
        attributes.append(each)
    still = np.tile(np.eye(4), (len(skin.names), 1, 1))
    linear = np.tile(np.eye(3), (len(skin.rest), 1, 1))
    rest = replace(skin, transforms=still, linear=linear)
    return replace(asset, surface=asset.surface.with_vertices(skin.rest), attributes=tuple(attributes), skin=rest)


def _level(asset: Asset, source: Asset, ratio: float, max_weights: int | None) -> Level:
    """A level of an asset, whose state at rest is `source`."""
    surface, match = _decimate_surface(source.surface, ratio)
    made = transfer_asset(source, Asset(surface), match, KINDS, "keep shape", max_weights=max_weights)
    level = replace(made.asset, document=asset.document, nodes=())
    errors = errors_of_level(source, level, match.surface_map)
    return Level(level, match, made.notes, *errors)


def _decimate_surface(surface: Surface, ratio: float) -> tuple[Surface, Any]:
    """A surface with a share of the vertices, and the map of its vertices to the surface, as a `Match`."""
    working = surface.working
    points, triangles, merged = decimate(
        working.vertices, working.oriented_triangles, round(ratio * len(working.vertices)), careful=True
    )
    used, corners = np.unique(triangles, return_inverse=True)
    points = points[used] * working.scale + working.origin
    nearest = _nearest_of_merged(working.vertices * working.scale + working.origin, points, used, merged)
    of_vertex = np.empty(len(working.vertices), dtype=np.int64)
    of_vertex[working.triangles.ravel()] = np.repeat(working.triangle_of, 3)
    start = of_vertex[nearest]
    whole = cut_surface(surface, np.zeros((len(surface.corner_vertex), 1)))
    triangle, barycentric, _ = whole.walk(start, points)
    found = SurfaceMap(triangle, barycentric, surface.triangles)
    match = SimpleNamespace(surface_map=found, confidence=np.ones(len(points)), has_partner=None)
    return Surface(points, corners.reshape(-1, 3)), match


def _nearest_of_merged(vertices: Floats, points: Floats, used: Integers, merged: Integers) -> Integers:
    """(v,) for each point (v, 3), which has a number (v,), the nearest of the vertices (n, 3) merged (n,) into it."""
    place = np.full(int(max(used.max(), merged.max())) + 1, -1)
    place[used] = np.arange(len(used))
    owner = place[merged]
    member = np.flatnonzero(owner >= 0)
    off = np.linalg.norm(vertices[member] - points[owner[member]], axis=1)
    return np.asarray(member[first_of_each(owner[member], off)])


def errors_of_level(source: Asset, level: Asset, found: SurfaceMap) -> tuple[float, float | None, float | None]:
    """The errors at rest, in poses, and in poses with all weights of a level, see `Level`.

    Args:
        source: the asset at rest.
        level: its level, at rest, with the same joints in the same order.
        found: the map of its vertices to the asset.
    """
    vertices = source.surface.vertices[np.unique(source.surface.triangles)]
    extent = float(np.ptp(vertices, axis=0).max())
    at_rest = _mean_distance(vertices, level.surface.vertices, level.surface.triangles) / extent
    if source.skin is None or level.skin is None:
        return at_rest, None, None
    own, exact = list[float](), list[float]()
    corners = found.source_triangles[found.triangle]
    mixed = interpolation_matrix(corners, found.barycentric, len(source.surface.vertices)) @ source.skin.weights
    heads = np.linalg.pinv(source.skin.inverse_bind)[:, :3, 3]
    for pose in distinct_poses(extreme_poses(heads, source.skin.parents), heads):
        moved = _pose(source.skin.rest, source.skin.weights, pose)[np.unique(source.surface.triangles)]
        for errors, weights in ((own, level.skin.weights), (exact, mixed)):
            posed = _pose(level.skin.rest, csr_array(weights), pose)
            errors.append(_mean_distance(moved, posed, level.surface.triangles) / extent)
    return at_rest, float(np.mean(own)), float(np.mean(exact))


def _pose(rest: Floats, weights: csr_array, pose: Floats) -> Floats:
    """(n, 3) vertices (n, 3) after joints (b, 3, 4) moved them by weights (n, b)."""
    return transform_points(blend_matrices(pose, weights), rest)


def _mean_distance(points: Floats, vertices: Floats, triangles: Integers) -> float:
    triangle, barycentric = SurfaceSearch(vertices, triangles).closest(points)
    nearest = np.einsum("nk,nkx->nx", barycentric, vertices[triangles[triangle]])
    return float(np.linalg.norm(points - nearest, axis=1).mean())
