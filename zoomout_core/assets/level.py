# SPDX-License-Identifier: GPL-3.0-or-later
"""A level of detail of an asset: the poses in which both are compared, and its errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import SHAPE_KEYS, Asset
from zoomout_core.assets.fit_level import Places
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.maps.surface_map import SurfaceMap, interpolation_matrix
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.triangles import components, triangle_normals, unique_edges, vertex_normals
from zoomout_core.transfer.rigging.poses import MAX_FRAMES, distinct_poses, extreme_poses

# Differences of weights that are rounding.
SAME_WEIGHT = 1e-9
# A vertex counts as moved from this share of the largest offset of all morph targets; and the maximum number of poses
# of morph targets.
MOVED, MAX_KEY_POSES = 0.02, 6
# Total number of vertices in all poses of the joints, which bounds time and memory: larger meshes have fewer poses, but
# at least this number. Half of the poses raise the errors by 1 %.
MAX_POSED, MIN_POSES = 400_000, 4
# Points of the asset, per vertex of a level, that the level is fitted to.
FITTED = 24
# Vertices of the asset whose distances from a level are averaged: a sample with a standard error of about 1 %.
MAX_POINTS = 10_000


@dataclass(frozen=True, eq=False)
class Level:
    """A level of detail.

    Attributes:
        asset: the mesh with its data.
        match: the map of its vertices to the surface of the asset.
        notes: sentences for the user.
        rest_error: mean distance of the asset's vertices, or of a sample, from the level at rest, relative to the
            asset's extent.
        posed_error: the same in poses that rotate the joints, with the level's own weights; None without joints.
        posed_geometry_error: the same if each vertex moved with all weights at its place on the asset.
    """

    asset: Asset
    match: Any
    notes: tuple[str, ...]
    rest_error: float
    posed_error: float | None
    posed_geometry_error: float | None


class Poses:
    """The poses in which a level should equal its asset: joints rotated to extremes, and the morph targets.

    Args:
        source: the asset at rest.

    Attributes:
        positions: (n, 3) its vertices in each pose.
        parts: (n,) the connected part of each vertex; coincident vertices are connected.
    """

    def __init__(self, source: Asset) -> None:
        count = max(MIN_POSES, MAX_POSED // len(source.surface.vertices))
        self.joints = np.zeros((0, 0, 3, 4)) if source.skin is None else joint_poses(source, count)
        self.keys = list[Floats]()
        attribute = source.find(SHAPE_KEYS)
        if attribute is not None:
            self.keys = _group_keys(np.asarray(attribute.values))
        rest = source.surface.vertices
        self.positions = [transform_points(each, rest) for each in self.motions(source, np.arange(len(rest)))]
        first, of_vertex = merge_places(rest)
        edges, _ = unique_edges(of_vertex[source.surface.triangles])
        self.parts = components(edges, len(first))[of_vertex]

    def motions(self, asset: Asset, rows: Integers) -> Iterator[Floats]:
        """(k, 3, 4) transforms of vertices (k,) of the asset at rest in each pose.

        Args:
            asset: the asset at rest, or a level of it.
            rows: for each of its vertices, the corresponding vertex of the asset at rest.
        """
        weights = [] if asset.skin is None else [csr_array(asset.skin.weights)]
        yield from (blend_matrices(pose, each) for each in weights for pose in self.joints)
        for offsets in self.keys:
            still = np.tile(np.eye(4)[:3], (len(rows), 1, 1))
            still[:, :, 3] = offsets[rows]
            yield still


def joint_poses(source: Asset, count: int = MAX_FRAMES) -> Floats:
    """(f, b, 3, 4) transforms of the joints of an asset at rest in the `count` most different extreme poses."""
    assert source.skin is not None
    heads = np.linalg.pinv(source.skin.inverse_bind)[:, :3, 3]
    return distinct_poses(extreme_poses(heads, source.skin.parents), heads, count)


def _group_keys(offsets: Floats) -> list[Floats]:
    """Sums (n, 3) of morph targets (n, keys, 3) that move different vertices, the largest first."""
    size = np.linalg.norm(offsets, axis=2)
    moves = size > MOVED * max(float(size.max(initial=0)), 1e-30)
    sums, taken = list[Floats](), list[Booleans]()
    for key in np.argsort(-size.sum(axis=0), kind="stable"):
        if not moves[:, key].any():
            continue
        free = next((number for number, own in enumerate(taken) if not (own & moves[:, key]).any()), len(sums))
        if free == MAX_KEY_POSES:
            continue
        if free == len(sums):
            sums.append(np.zeros(offsets[:, 0].shape))
            taken.append(np.zeros(len(offsets), dtype=bool))
        sums[free] += offsets[:, key]
        taken[free] |= moves[:, key]
    return sums


def points_in_poses(source: Asset, poses: Poses, parts: Integers, kept: Integers, count: int) -> Places:
    """At most `count` points of an asset at rest: vertices, and centres of triangles in the kept parts (n,)."""
    surface = source.surface
    vertices = np.unique(surface.triangles)
    part = parts[np.concatenate([vertices, surface.triangles[:, 0]])]
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(np.isin(part, kept)))[:count]

    def place(positions: Floats) -> Floats:
        found = np.concatenate([positions[vertices], positions[surface.triangles].mean(axis=1)])
        return np.asarray(found[chosen])

    at_vertices = vertex_normals(surface.vertices, surface.triangles)[vertices]
    normals = np.concatenate([at_vertices, triangle_normals(surface.vertices, surface.triangles)])[chosen]
    return Places(place(surface.vertices), normals, part[chosen], [place(each) for each in poses.positions])


def merge_places(vertices: Floats) -> tuple[Integers, Integers]:
    """The first vertex (k,) at each position, and the number (n,) of the position of each vertex (n, 3)."""
    _, first, of_vertex = np.unique(vertices.astype(np.float32), axis=0, return_index=True, return_inverse=True)
    return first, of_vertex.ravel()


def errors_of_level(source: Asset, level: Asset, found: SurfaceMap) -> tuple[float, float | None, float | None]:
    """The errors at rest, in poses, and in poses with all weights of a level, see `Level`.

    Args:
        source: the asset at rest.
        level: its level, at rest, with the same joints in the same order.
        found: the map of its vertices to the asset.
    """
    points = np.unique(source.surface.triangles)
    extent = float(np.ptp(source.surface.vertices[points], axis=0).max())
    points = np.random.default_rng(0).permutation(points)[:MAX_POINTS]
    at_rest = _mean_distance(source.surface.vertices[points], level.surface.vertices, level.surface.triangles) / extent
    if source.skin is None or level.skin is None:
        return at_rest, None, None
    own, exact = list[float](), list[float]()
    corners = found.source_triangles[found.triangle]
    mixed = interpolation_matrix(corners, found.barycentric, len(source.surface.vertices)) @ source.skin.weights
    has_all = abs(csr_array(level.skin.weights) - mixed).max() < SAME_WEIGHT
    for pose in joint_poses(source):
        moved = _pose(source.skin.rest[points], csr_array(source.skin.weights)[points], pose)
        for errors, weights in ((own, level.skin.weights), (exact, mixed)):
            if errors is exact and has_all:
                exact.append(own[-1])
                continue
            posed = _pose(level.skin.rest, csr_array(weights), pose)
            errors.append(_mean_distance(moved, posed, level.surface.triangles) / extent)
    return at_rest, float(np.mean(own)), float(np.mean(exact))


def _pose(rest: Floats, weights: csr_array, pose: Floats) -> Floats:
    """Move vertices (n, 3) by joints (b, 3, 4) with weights (n, b)."""
    return transform_points(blend_matrices(pose, weights), rest)


def _mean_distance(points: Floats, vertices: Floats, triangles: Integers) -> float:
    triangle, barycentric = SurfaceSearch(vertices, triangles).closest(points)
    nearest = np.einsum("nk,nkx->nx", barycentric, vertices[triangles[triangle]])
    return float(np.linalg.norm(points - nearest, axis=1).mean())
