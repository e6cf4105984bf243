# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail: simplified meshes of an asset, each with all data of the asset itself.

Each vertex of a level is one of the asset's, with its morph targets, texture coordinates and joints. Seams and borders
of materials stay in place, and vertices where the mesh bends in its poses. Then the positions, and the weights of these
joints, are fitted to the asset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import MATERIALS, NORMALS, SHAPE_KEYS, UV, Asset, at_rest, on_corners
from zoomout_core.assets.fit_level import LEVEL_FIT, Places, fit_level, fit_weights
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.maps.surface_map import SurfaceMap, interpolation_matrix
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.mirror_pairs import mirror_moves, mirror_pairs
from zoomout_core.mesh.simplify import simplify
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.mesh.triangles import (
    area_normals,
    components,
    triangle_normals,
    unique_edges,
    unit_vectors,
    vertex_normals,
)
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer.attribute import Domain
from zoomout_core.transfer.groups import expand_ranges, first_of_each
from zoomout_core.transfer.rigging.poses import MAX_FRAMES, distinct_poses, extreme_poses
from zoomout_core.transfer.rigging.skinning import blend_matrices, transform_points
from zoomout_core.transfer.rigging.weights import limit_weights

# Differences of weights that are rounding.
SAME_WEIGHT = 1e-9
# Share of the largest offset of all morph targets from which a vertex counts as moved, and the most poses of them.
MOVED, MAX_KEY_POSES = 0.02, 6
# Vertices in all poses of the joints, to bound time and memory: of larger meshes, fewer poses are used, but at least
# this number. Half of the poses raise the errors by 1 %.
MAX_POSED, MIN_POSES = 400_000, 4
# Points of the asset, per vertex of a level, that the level is fitted to.
FITTED = 24
# Digits of texture coordinates; smaller differences are rounding.
UV_DIGITS = 5
# Vertices of a level, relative to those wanted, from which a note says why.
MORE = 1.1
# Smallest cosine between the normal at a corner and that of its face; lower ones are shaded almost black.
MIN_FACING = 0.25
# Vertices of the asset whose distances from a level are averaged: a sample with a standard error of about 1 %.
MAX_POINTS = 10_000
# Share of the time that simplifying takes.
SIMPLIFY = 0.6
# Levels with fewer vertices than this have no faces to speak of.
MIN_VERTICES = 12


@dataclass(frozen=True, eq=False)
class Level:
    """A level of detail.

    Attributes:
        asset: the mesh with its data.
        vertices: (k,) the vertices of the asset that its vertices are.
        match: the map of its vertices to the surface of the asset.
        notes: sentences for the user.
        rest_error: mean distance of the asset's vertices, or of a sample, from the level at rest, relative to the
            asset's extent.
        posed_error: the same in poses that turn the joints, with the level's own weights; None without joints.
        posed_geometry_error: the same if each vertex moved with all weights at its place on the asset.
    """

    asset: Asset
    vertices: Integers
    match: Any
    notes: tuple[str, ...]
    rest_error: float
    posed_error: float | None
    posed_geometry_error: float | None


@memory_in_words
def make_lods(asset: Asset, ratios: Sequence[float], max_weights: int | None = None) -> list[Level]:
    """Simplify an asset for each of several levels.

    Args:
        asset: the asset, which is level 0.
        ratios: for each further level the share of vertices to keep, between 0 and 1.
        max_weights: how many joints a vertex may have; as many as on the asset, when not given.

    Returns:
        The further levels, whose meshes are on the nodes of the asset's.

    Raises:
        MeshError: a ratio leaves too few vertices, or is not between 0 and 1.
    """
    source = at_rest(asset)
    working = source.surface.working
    for ratio in ratios:
        if not 0 < ratio < 1 or ratio * len(working.vertices) < MIN_VERTICES:
            raise MeshError(
                f"A level cannot have {ratio:g} of {len(working.vertices):,} vertices: give shares below 1 that leave "
                f"{MIN_VERTICES} vertices or more."
            )
    poses = _Poses(source)
    with stage(message("Simplify the mesh"), 0.0, SIMPLIFY):
        parts = _simplify(source, poses, ratios)
    levels = []
    for number, (ratio, part) in enumerate(zip(ratios, parts, strict=True)):
        begin, end = (SIMPLIFY + (1 - SIMPLIFY) * (number + step) / len(ratios) for step in (0, 1))
        with stage(message("Level {number}", number=number + 1), begin, end):
            levels.append(_level(asset, source, poses, part, ratio, max_weights))
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


def _level(
    asset: Asset,
    source: Asset,
    poses: _Poses,
    part: tuple[Integers, Integers, Integers],
    ratio: float,
    max_weights: int | None,
) -> Level:
    """A level of an asset, whose state at rest is `source`, with the triangles and corners of a part of it."""
    level, used = _select(asset, *part)
    if max_weights is not None:
        level = with_fewer_weights(level, max_weights)
    level = _with_facing_normals(_fit(source, level, used, poses), asset, used)
    found = _map_of(asset.surface, used)
    match = SimpleNamespace(surface_map=found, confidence=np.ones(len(used)), has_partner=None)
    notes = [*asset.notes]
    wanted, count = round(ratio * len(source.surface.working.vertices)), len(level.surface.working.vertices)
    if count > MORE * wanted:
        notes.append(
            message(
                "The level has {count:,} vertices instead of {wanted:,}, because its borders and parts would be lost.",
                count=count,
                wanted=wanted,
            )
        )
    return Level(level, used, match, tuple(notes), *errors_of_level(source, at_rest(level), found))


class _Poses:
    """The poses in which a level is to be like its asset: the joints turned to extremes, and the morph targets.

    Args:
        source: the asset at rest.

    Attributes:
        positions: (n, 3) its vertices in each pose.
        parts: (n,) the connected part of each vertex; vertices in one place are connected.
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
        first, of_vertex = _merge_places(rest)
        edges, _ = unique_edges(of_vertex[source.surface.triangles])
        self.parts = components(edges, len(first))[of_vertex]

    def motions(self, asset: Asset, rows: Integers) -> Iterator[Floats]:
        """(k, 3, 4) transforms of vertices (k,) of the asset at rest in each pose.

        Args:
            asset: the asset at rest, or a level of it.
            rows: the vertices of the asset at rest that its vertices are.
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


def _simplify(source: Asset, poses: _Poses, ratios: Sequence[float]) -> list[tuple[Integers, Integers, Integers]]:
    """For each level the triangles of an asset at rest that it keeps, and their corners, see `simplify`."""
    surface = source.surface
    first, of_vertex = _merge_places(surface.vertices)
    rest = surface.vertices[first]
    corners = surface.triangle_corners
    textures = sorted((each for each in source.attributes if each.name.startswith(UV)), key=lambda each: each.name)
    layers = [surface.triangles]  # vertices in one place, as of two meshes, or with other weights
    materials = source.find(MATERIALS)
    if materials is not None:
        number = np.asarray(materials.values)[surface.triangle_face]
        layers.insert(0, np.repeat(number[:, None], 3, axis=1))
    for texture in reversed(textures):
        values = np.round(on_corners(texture, surface), UV_DIGITS)
        layers.insert(0, np.unique(values, axis=0, return_inverse=True)[1].ravel()[corners])
    order = np.argsort(-np.asarray(ratios), kind="stable")
    found = simplify(
        np.array([rest, *(each[first] for each in poses.positions)]),
        of_vertex[surface.triangles],
        layers,
        [round(ratios[number] * len(surface.working.vertices)) for number in order],
        mirror_pairs(rest),
        on_corners(textures[0], surface)[corners] if textures else None,
    )
    parts = [(alive, corners.ravel()[places], corners.ravel()[content]) for alive, places, content in found]
    return [parts[place] for place in np.argsort(order)]


def _select(asset: Asset, alive: Integers, corners: Integers, content: Integers) -> tuple[Asset, Integers]:
    """The part of an asset that a level keeps, and (k,) the vertices of the asset that it has.

    Args:
        asset: the asset.
        alive: (m,) numbers of triangles, for the data of faces.
        corners: (m, 3) corners of the asset at the vertices that the triangles have.
        content: (m, 3) the corners of the asset whose data the triangles' corners have.
    """
    surface = asset.surface
    used, triangles = np.unique(surface.corner_vertex[corners], return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    made = Surface(surface.vertices[used], triangles)
    elements = {Domain.POINT: used, Domain.CORNER: content.ravel(), Domain.FACE: surface.triangle_face[alive]}
    attributes = [
        replace(each, values=np.asarray(each.values)[elements[each.domain]])
        for each in asset.attributes
        if each.domain in elements
    ]
    skin = asset.skin
    if skin is not None:
        skin = replace(skin, rest=skin.rest[used], linear=skin.linear[used], weights=csr_array(skin.weights)[used])
    ends = np.cumsum([0, *(count for _, count in asset.objects)])
    counts = np.diff(np.searchsorted(used, ends))
    objects = tuple((name, int(count)) for (name, _), count in zip(asset.objects, counts, strict=True))
    level = replace(asset, surface=made, attributes=tuple(attributes), skin=skin, objects=objects, stored_map=None)
    return level, used


def _with_facing_normals(level: Asset, asset: Asset, used: Integers) -> Asset:
    """A level with, at each corner, the normal nearest to its face's of those that its vertex has in the asset.

    If all of them face another way, the face's own normal is used: such a place would be black. Vertices whose normals
    face another way in the asset, such as those of foliage, keep them.
    """
    normals, surface, made = asset.find(NORMALS), asset.surface, level.surface
    if normals is None:
        return level
    values = on_corners(normals, surface)
    order = np.argsort(surface.corner_vertex, kind="stable")
    start = np.searchsorted(surface.corner_vertex[order], np.arange(len(surface.vertices) + 1))
    vertex = used[made.triangles.ravel()]
    of_corner, place = expand_ranges(start[vertex], start[vertex + 1])
    choices = values[order[place]]
    flat = unit_vectors(area_normals(surface.vertices, surface.triangles))
    off = np.einsum("mcx,mx->mc", values[surface.triangle_corners], flat) < MIN_FACING
    meant = np.zeros(len(surface.vertices), dtype=bool)
    meant[surface.triangles[off]] = True
    facing = np.repeat(unit_vectors(area_normals(made.vertices, made.triangles)), 3, axis=0)
    cosine = np.einsum("kx,kx->k", choices, facing[of_corner])
    best = first_of_each(of_corner, -cosine)
    turned = (cosine[best] < MIN_FACING) & ~meant[vertex] & facing.any(axis=1)  # triangles without area have no normal
    found = np.where(turned[:, None], facing, choices[best])
    attributes = tuple(replace(each, values=found) if each.name == NORMALS else each for each in level.attributes)
    return replace(level, attributes=attributes)


def _fit(source: Asset, level: Asset, used: Integers, poses: _Poses) -> Asset:
    """A level, moved and weighted to be close to the asset in all poses; vertices in one place stay together."""
    surface = source.surface
    rest = at_rest(level).surface.vertices
    first, of_vertex = _merge_places(rest)
    vertices = np.unique(surface.triangles)
    parts = poses.parts[np.concatenate([vertices, surface.triangles[:, 0]])]
    kept = np.flatnonzero(np.isin(parts, poses.parts[used]))
    chosen = np.random.default_rng(0).permutation(kept)[: FITTED * len(first)]

    def place(positions: Floats) -> Floats:
        """The points of the asset that the level is fitted to, in a pose: vertices, and centres of triangles."""
        found = np.concatenate([positions[vertices], positions[surface.triangles].mean(axis=1)])
        return np.asarray(found[chosen])

    at_vertices = vertex_normals(surface.vertices, surface.triangles)[vertices]
    normals = np.concatenate([at_vertices, triangle_normals(surface.vertices, surface.triangles)])[chosen]
    places = Places(place(surface.vertices), normals, parts[chosen], [place(each) for each in poses.positions])
    triangles, own_parts = of_vertex[level.surface.triangles], poses.parts[used[first]]
    pairs = mirror_pairs(rest[first])

    def fit(weighted: Asset, rounds: int) -> Floats:
        motions = [each[first] for each in poses.motions(weighted, used)]
        fitted = fit_level(rest[first], triangles, own_parts, motions, places, rounds)
        return fitted if pairs is None else mirror_moves(rest[first], fitted, pairs)

    if level.skin is not None:
        fitted = fit(level, 1)  # so that weights do not make up for the places of the vertices
        weights = csr_array(level.skin.weights)[first]
        weights = fit_weights(fitted, triangles, own_parts, weights, poses.joints, places)
        level = replace(level, skin=replace(level.skin, weights=csr_array(weights[of_vertex])))
    fitted = fit(level, LEVEL_FIT.rounds)
    moved = fitted[of_vertex]
    if level.skin is None:
        return replace(level, surface=level.surface.with_vertices(moved))
    step = np.linalg.solve(level.skin.linear, (moved - rest)[:, :, None])[:, :, 0]
    placed = level.surface.with_vertices(level.surface.vertices + step)
    return replace(level, surface=placed, skin=replace(level.skin, rest=moved))


def _merge_places(vertices: Floats) -> tuple[Integers, Integers]:
    """The first vertex (k,) of each place, and for vertices (n, 3) the number of their place (n,)."""
    _, first, of_vertex = np.unique(vertices.astype(np.float32), axis=0, return_index=True, return_inverse=True)
    return first, of_vertex.ravel()


def _map_of(surface: Surface, used: Integers) -> SurfaceMap:
    """The map of a level's vertices (k,), each of which is a vertex of the surface."""
    triangle = np.zeros(len(surface.vertices), dtype=np.int64)
    triangle[surface.triangles.ravel()] = np.repeat(np.arange(len(surface.triangles)), 3)
    barycentric = (surface.triangles[triangle[used]] == used[:, None]).astype(np.float64)
    return SurfaceMap(triangle[used], barycentric, surface.triangles)


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
    """(n, 3) vertices (n, 3) after joints (b, 3, 4) moved them by weights (n, b)."""
    return transform_points(blend_matrices(pose, weights), rest)


def _mean_distance(points: Floats, vertices: Floats, triangles: Integers) -> float:
    triangle, barycentric = SurfaceSearch(vertices, triangles).closest(points)
    nearest = np.einsum("nk,nkx->nx", barycentric, vertices[triangles[triangle]])
    return float(np.linalg.norm(points - nearest, axis=1).mean())
