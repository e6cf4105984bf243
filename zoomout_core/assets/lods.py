# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail: simplified meshes of an asset, or given ones, each with all data of the asset itself.

Each vertex of a simplified mesh is one of the asset's, with its morph targets, texture coordinates and joints. Seams
and borders of materials stay in place, and vertices where the mesh bends in its poses. Then the positions, and the
weights of these joints, are fitted to the asset. A given mesh keeps its vertices, and only the weights are fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array

from zoomout_core.arrays import Booleans, Floats, Integers, row_norms, segment_sum
from zoomout_core.assets.asset import MATERIALS, NORMALS, SHAPE_KEYS, UV, Asset, at_rest, on_corners
from zoomout_core.assets.fit_level import LEVEL_FIT, Places, closest_facing, fit_level, fit_weights
from zoomout_core.assets.transfer_asset import place_all, skin_weights
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
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.groups import expand_ranges, first_of_each
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.poses import MAX_FRAMES, distinct_poses, extreme_poses
from zoomout_core.transfer.rigging.skinning import blend_matrices, transform_points
from zoomout_core.transfer.rigging.weights import limit_weights
from zoomout_core.transfer.rules import map_target, transfer_along

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
# A given mesh is in the place of the asset if at most this share of its vertices is farther from it than this part of
# the asset's extent. In levels of 100 to 350 vertices of four game characters, at most 0.3 % are; of characters with
# arms turned by 15 degrees, at least 12 %.
FAR, MAX_FAR_SHARE = 0.03, 0.05
# A connected part of a given mesh replaces the part of the asset that most of its vertices are closest to, and others
# that this share of as many are closest to; fewer are where layers touch.
JOINED = 0.5
# Vertices of a given mesh for which these parts are farther than the closest one by more than this share of the extent
# receive data from the latter: a mesh may join a small part, such as a hat, to a large one. Layers are closer.
ASIDE = 0.01
# Levels with fewer vertices than this have no faces to speak of.
MIN_VERTICES = 12


@dataclass(frozen=True, eq=False)
class Level:
    """A level of detail.

    Attributes:
        asset: the mesh with its data.
        match: the map of its vertices to the surface of the asset.
        notes: sentences for the user.
        rest_error: mean distance of the asset's vertices, or of a sample, from the level at rest, relative to the
            asset's extent.
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


@memory_in_words
def complete_levels(
    asset: Asset, given: Mapping[str, Asset], max_weights: int | None = None, keep_uv: bool = False
) -> dict[str, Level]:
    """Give the data of an asset to meshes that are to be its levels of detail, made by hand.

    Their vertices and faces stay as they are. They receive all data of the asset, each vertex from the point of the
    asset that is closest to it and on the same side, and weights that are fitted to the asset in poses.

    Args:
        asset: the asset, which is level 0.
        given: the meshes by their names, each in the place and the rest pose of the asset.
        max_weights: how many joints a vertex may have; as many as on the asset, when not given.
        keep_uv: whether a mesh with texture coordinates keeps them, in the order of those of the asset.

    Returns:
        The levels by the names of the meshes, those with the most triangles first.

    Raises:
        MeshError: a mesh is not in the place of the asset.
    """
    source = at_rest(asset)
    poses = _Poses(source)
    placed = {name: _place_on(source, poses.parts, at_rest(each), name) for name, each in given.items()}
    levels = {}
    for number, name in enumerate(sorted(given, key=lambda name: -len(given[name].surface.triangles))):
        with stage(message("Level {number}", number=number + 1), number / len(given), (number + 1) / len(given)):
            levels[name] = _complete(asset, source, poses, given[name], placed[name], max_weights, keep_uv)
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
    return Level(level, match, tuple(notes), *errors_of_level(source, at_rest(level), found))


@dataclass(frozen=True, eq=False)
class _Placed:
    """A given mesh on an asset, both at rest.

    Attributes:
        surface_map: the map of its vertices (k,) to the asset.
        groups: (k,) numbers of groups that they belong to; a group joins connected parts of the mesh to those of the
            asset that they replace.
        groups_of_asset: (n,) the groups that the asset's vertices belong to.
    """

    surface_map: SurfaceMap
    groups: Integers
    groups_of_asset: Integers


def _place_on(source: Asset, parts: Integers, level: Asset, name: str) -> _Placed:
    """Map a mesh to the closest points on the same side of an asset, both at rest.

    Args:
        source: the asset.
        parts: (n,) the connected parts of its vertices.
        level: the mesh.
        name: its name.

    Raises:
        MeshError: the mesh is not in the place of the asset.
    """
    surface, made = source.surface, place_all(level.surface)
    first, of_vertex = _merge_places(made.vertices)
    points, triangles = made.vertices[first], of_vertex[made.triangles]
    normals, edges = vertex_normals(points, triangles), unique_edges(triangles)[0]
    own = components(edges, len(first))
    one, whole = np.zeros_like(own), np.zeros_like(parts)
    found = _map_to_side(surface, whole, Places(points, normals, one, []))
    distance = row_norms(found.interpolate(surface.vertices) - points)
    extent = float(np.ptp(surface.vertices[surface.triangles.ravel()], axis=0).max())
    if np.mean(distance > FAR * extent) > MAX_FAR_SHARE:
        raise MeshError(
            "'{name}' is not in the place and rest pose of the mesh, as a level of detail must be: move it there, or "
            "use Transfer, which matches meshes of other poses and shapes.",
            name=name,
        )
    groups, groups_of_asset = _group_parts(own, parts, parts[surface.triangles[found.triangle, 0]])
    own_part = _map_to_side(surface, groups_of_asset, Places(points, normals, groups, []))
    farther = row_norms(own_part.interpolate(surface.vertices) - points) - distance
    closest = farther > ASIDE * extent
    triangle = np.where(closest, found.triangle, own_part.triangle)
    barycentric = np.where(closest[:, None], found.barycentric, own_part.barycentric)
    in_full = SurfaceMap(triangle[of_vertex], barycentric[of_vertex], surface.triangles)
    return _Placed(in_full, groups[of_vertex], groups_of_asset)


def _map_to_side(surface: Surface, groups: Integers, places: Places) -> SurfaceMap:
    """The closest points of a surface, whose vertices belong to groups (n,), that do not face opposite to places.

    Places without one get the closest of all, such as the inner side of a sheet that has only one side on the surface.
    """
    triangle, barycentric = closest_facing(surface.vertices, surface.triangles, groups, places)
    without = np.flatnonzero(~barycentric.any(axis=1))
    if len(without):
        search = SurfaceSearch(surface.vertices, surface.triangles)
        triangle[without], barycentric[without] = search.closest(places.points[without])
    return SurfaceMap(triangle, barycentric, surface.triangles)


def _group_parts(own: Integers, parts: Integers, there: Integers) -> tuple[Integers, Integers]:
    """Groups of the vertices of a given mesh (k,) and of an asset (n,), so that layers receive data of their own layer.

    Args:
        own: (k,) the connected parts of the mesh.
        parts: (n,) those of the asset.
        there: (k,) those at the closest points on the asset.
    """
    count = 1 + own.max()
    votes = csr_array((np.ones(len(own)), (own, there)), shape=(count, 1 + parts.max()))
    most = votes.max(axis=1).toarray().ravel()
    share = coo_array(votes / most[:, None])
    joined = share.data > JOINED
    pairs = np.column_stack([share.row, share.col + count])[joined]
    group = components(pairs, sum(votes.shape))
    return group[own], group[count + parts]


def _complete(
    asset: Asset,
    source: Asset,
    poses: _Poses,
    given: Asset,
    placed: _Placed,
    max_weights: int | None,
    keep_uv: bool,
) -> Level:
    """A given mesh with all data of an asset, whose state at rest is `source`."""
    found = placed.surface_map
    match = SimpleNamespace(surface_map=found, confidence=np.ones(len(found.triangle)), has_partner=None)
    surface, skin = place_all(at_rest(given).surface), None
    if source.skin is not None and asset.skin is not None:
        weights = skin_weights(source.skin, map_target(match, source.surface, surface), max_weights)
        weights = _fit_given_weights(source, surface, placed, weights, poses)
        rest, matrices = surface.vertices, blend_matrices(asset.skin.transforms[:, :3], weights)
        surface = surface.with_vertices(transform_points(matrices, rest))
        skin = replace(asset.skin, rest=rest, linear=np.linalg.pinv(matrices[:, :, :3]), weights=weights)
    mapped = map_target(match, asset.surface, surface)
    own, notes = _own_uvs(asset, given) if keep_uv else ({}, [])
    attributes = tuple(own.get(each.name) or _carry_in_place(each, mapped) for each in asset.attributes)
    notes += [note for each in attributes for note in each.notes]
    level = replace(
        asset,
        surface=surface,
        attributes=attributes,
        skin=skin,
        objects=given.objects,
        nodes=(),
        notes=(),
        stored_map=None,
    )
    errors = errors_of_level(source, at_rest(level), found)
    return Level(level, match, (*asset.notes, *notes), *errors)


def _fit_given_weights(
    source: Asset, surface: Surface, placed: _Placed, weights: csr_array, poses: _Poses
) -> csr_array:
    """Weights of a given mesh at rest that are fitted to an asset at rest; vertices in one place share theirs."""
    first, of_vertex = _merge_places(surface.vertices)
    groups, triangles = placed.groups[first], of_vertex[surface.triangles]
    places = _places(source, poses, placed.groups_of_asset, groups, FITTED * len(first))
    fitted = fit_weights(surface.vertices[first], triangles, groups, csr_array(weights[first]), poses.joints, places)
    return csr_array(fitted[of_vertex])


def _own_uvs(asset: Asset, given: Asset) -> tuple[dict[str, Attribute], list[str]]:
    """The texture coordinates of a given mesh, by the names of those of an asset that they stand for, and notes."""
    theirs, own = (
        sorted((each for each in one.attributes if each.name.startswith(UV)), key=lambda each: each.name)
        for one in (asset, given)
    )
    kept = {one.name: replace(other, name=one.name) for one, other in zip(theirs, own, strict=False)}
    if len(own) <= len(theirs):
        return kept, []
    left_out = message(
        "{count} of its UV maps were left out, as the mesh itself has fewer.", count=len(own) - len(kept)
    )
    return kept, [left_out]


def _carry_in_place(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer an attribute between surfaces in the same place: offsets and directions are mixed without turning."""
    if attribute.kind not in (Kind.OFFSET, Kind.DIRECTION, Kind.NORMAL):
        return transfer_along(attribute, mapped)
    values = np.asarray(attribute.values, dtype=np.float64)
    rows = replace(attribute, kind=Kind.VECTOR, values=values.reshape(len(values), -1))
    mixed = np.asarray(transfer_along(rows, mapped).values).reshape(-1, *values.shape[1:])
    if attribute.kind is not Kind.NORMAL:
        return replace(attribute, values=mixed)
    away = _face_away(on_corners(attribute, mapped.source), mapped.source)
    meant = mapped.surface_map.interpolate(away.astype(np.float64)) > 0
    normals = on_corners(replace(attribute, values=unit_vectors(mixed)), mapped.target)
    return replace(attribute, domain=Domain.CORNER, values=_turn_to_faces(normals, mapped.target, meant))


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
    facing = np.repeat(unit_vectors(area_normals(made.vertices, made.triangles)), 3, axis=0)
    cosine = np.einsum("kx,kx->k", choices, facing[of_corner])
    best = choices[first_of_each(of_corner, -cosine)]
    found = _turn_to_faces(best, made, _face_away(values, surface)[used])
    attributes = tuple(replace(each, values=found) if each.name == NORMALS else each for each in level.attributes)
    return replace(level, attributes=attributes)


def _face_away(normals: Floats, surface: Surface) -> Booleans:
    """(n,) the vertices of a surface with a normal, of those at corners (c, 3), that faces away from its triangle."""
    flat = unit_vectors(area_normals(surface.vertices, surface.triangles))
    off = np.einsum("mcx,mx->mc", normals[surface.triangle_corners], flat) < MIN_FACING
    away = np.zeros(len(surface.vertices), dtype=bool)
    away[surface.triangles[off]] = True
    return away


def _turn_to_faces(normals: Floats, surface: Surface, meant: Booleans) -> Floats:
    """Normals at corners (c, 3), with the face's own where they face away from it, but at vertices meant so (n,)."""
    flat = segment_sum(
        area_normals(surface.vertices, surface.triangles), surface.triangle_face, len(surface.face_start) - 1
    )
    facing = unit_vectors(flat)[surface.corner_face]
    away = np.einsum("cx,cx->c", normals, facing) < MIN_FACING
    away &= ~meant[surface.corner_vertex] & facing.any(axis=1)  # faces without area have no normal
    return np.where(away[:, None], facing, normals)


def _fit(source: Asset, level: Asset, used: Integers, poses: _Poses) -> Asset:
    """A level, moved and weighted to be close to the asset in all poses; vertices in one place stay together."""
    rest = at_rest(level).surface.vertices
    first, of_vertex = _merge_places(rest)
    places = _places(source, poses, poses.parts, poses.parts[used], FITTED * len(first))
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


def _places(source: Asset, poses: _Poses, parts: Integers, kept: Integers, count: int) -> Places:
    """At most `count` points of an asset at rest, vertices and centres of triangles, of which parts (n,) are kept."""
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
