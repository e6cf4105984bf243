# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail that were made by hand receive all data of their asset.

Their vertices and faces stay as they are, and only the weights are fitted to the asset in its poses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from scipy.sparse import coo_array, csr_array

from zoomout_core.arrays import Integers, row_norms
from zoomout_core.assets.asset import UV, Asset, at_rest, in_pose_of, layers_of, on_corners
from zoomout_core.assets.bind_asset import skin_weights
from zoomout_core.assets.facing_normals import faces_away, turn_to_faces
from zoomout_core.assets.fit_level import Places, closest_facing, fit_weights
from zoomout_core.assets.level import FITTED, Level, Poses, errors_of_level, merge_places, points_in_poses
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import place_unused
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import components, triangle_areas, unique_edges, unit_vectors, vertex_normals
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rules import map_target, transfer_along

# A given mesh coincides with the asset if at most `MAX_FAR_SHARE` of its area is farther from it than `FAR`, relative
# to the asset's extent: the triangles all of whose corners are. Single vertices may be far, as decimating a mesh with
# split edges leaves spikes. In levels of 31 game characters by Blender's Decimate, with a half or a quarter of the
# vertices, up to 11 % of the vertices are far, but no whole triangle. Arms of people turned by 15 degrees have at least
# 3.8 % of the area, front legs of cows, dogs and frogs 2.3 %, and small forelegs of dinosaurs less.
FAR, MAX_FAR_SHARE = 0.03, 0.02
# A connected part of a given mesh replaces the part of the asset that is closest to most of its vertices. It also
# replaces other parts that are closest to at least this share of as many; fewer vertices are due to touching layers.
JOINED = 0.5
# A given mesh may join a small part, such as a hat, to a large one. A vertex receives data from the closest part if the
# replaced parts are farther by more than this share of the extent. Layers are closer.
ASIDE = 0.01


@memory_in_words
@on_one_blas_thread
def complete_levels(
    asset: Asset, given: Mapping[str, Asset], max_weights: int | None = None, keep_uv: bool = False
) -> dict[str, Level]:
    """Transfer the data of an asset to its levels of detail, which were made by hand.

    Their vertices and faces stay as they are. Each vertex receives the data of the closest point of the asset that is
    on the same side. The weights are fitted to the asset in poses.

    Args:
        asset: the asset, which is level 0.
        given: the meshes by their names, each in the place and the rest pose of the asset.
        max_weights: maximum number of joints of a vertex; that of the asset by default.
        keep_uv: whether a mesh with texture coordinates keeps them, in the order of those of the asset.

    Returns:
        The levels by the names of the meshes, those with the most triangles first.

    Raises:
        MeshError: a mesh is not in the place of the asset.
    """
    source = at_rest(asset)
    poses = Poses(source)
    placed = {name: _place_on(source, poses.parts, at_rest(each), name) for name, each in given.items()}
    levels = {}
    for number, name in enumerate(sorted(given, key=lambda name: -len(given[name].surface.triangles))):
        with stage(message("Level {number}", number=number + 1), number / len(given), (number + 1) / len(given)):
            levels[name] = _complete(asset, source, poses, given[name], placed[name], max_weights, keep_uv)
    return levels


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
    surface, made = source.surface, place_unused(level.surface)
    first, of_vertex = merge_places(made.vertices)
    points, triangles = made.vertices[first], of_vertex[made.triangles]
    normals, edges = vertex_normals(points, triangles), unique_edges(triangles)[0]
    own = components(edges, len(first))
    one, whole = np.zeros_like(own), np.zeros_like(parts)
    found = _map_to_side(surface, whole, Places(points, normals, one, []))
    distance = row_norms(found.interpolate(surface.vertices) - points)
    extent = float(np.ptp(surface.vertices[surface.triangles.ravel()], axis=0).max())
    area, far = triangle_areas(points, triangles), (distance > FAR * extent)[triangles].all(axis=1)
    if area[far].sum() > MAX_FAR_SHARE * area.sum():
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
    poses: Poses,
    given: Asset,
    placed: _Placed,
    max_weights: int | None,
    keep_uv: bool,
) -> Level:
    """A given mesh with all data of an asset, whose state at rest is `source`."""
    found = placed.surface_map
    match = SimpleNamespace(surface_map=found, confidence=np.ones(len(found.triangle)), has_partner=None)
    surface, skin = place_unused(at_rest(given).surface), source.skin
    mapped = map_target(match, source.surface, surface)
    if skin is not None:
        weights = _fit_given_weights(source, surface, placed, skin_weights(skin, mapped, max_weights), poses)
        linear = np.tile(np.eye(3), (len(surface.vertices), 1, 1))
        skin = replace(skin, rest=surface.vertices, linear=linear, weights=weights)
    own, notes = _own_uvs(asset, given) if keep_uv else ({}, [])
    attributes = tuple(own.get(each.name) or _transfer_in_place(each, mapped) for each in source.attributes)
    notes += [note for each in attributes for note in each.notes]
    level = replace(
        source,
        surface=surface,
        attributes=attributes,
        skin=skin,
        objects=given.objects,
        nodes=(),
        notes=(),
        stored_map=None,
    )
    errors = errors_of_level(source, level, found)
    return Level(in_pose_of(level, asset), match, (*asset.notes, *notes), *errors)


def _fit_given_weights(source: Asset, surface: Surface, placed: _Placed, weights: csr_array, poses: Poses) -> csr_array:
    """Weights of a given mesh at rest that are fitted to an asset at rest; vertices in one place share theirs."""
    first, of_vertex = merge_places(surface.vertices)
    groups, triangles = placed.groups[first], of_vertex[surface.triangles]
    places = points_in_poses(source, poses, placed.groups_of_asset, groups, FITTED * len(first))
    fitted = fit_weights(surface.vertices[first], triangles, groups, csr_array(weights[first]), poses.joints, places)
    return csr_array(fitted[of_vertex])


def refit_weights(source: Asset, level: Surface, found: SurfaceMap, weights: csr_array) -> csr_array:
    """Weights of a level of detail, whose vertices stay, that are fitted to an asset whose weights were edited.

    Args:
        source: the asset at rest.
        level: the level at rest.
        found: the map of its vertices (k,) to the asset.
        weights: (k, b) its weights to begin with, of the asset's joints.
    """
    poses = Poses(source)
    first, of_vertex = merge_places(level.vertices)
    own = components(unique_edges(of_vertex[level.triangles])[0], len(first))
    there = poses.parts[source.surface.triangles[found.triangle[first], 0]]
    groups, groups_of_asset = _group_parts(own, poses.parts, there)
    return _fit_given_weights(source, level, _Placed(found, groups[of_vertex], groups_of_asset), weights, poses)


def _own_uvs(asset: Asset, given: Asset) -> tuple[dict[str, Attribute], list[str]]:
    """The texture coordinates of a given mesh, by the names of those of an asset that they stand for, and notes."""
    theirs, own = (layers_of(one.attributes, UV) for one in (asset, given))
    kept = {one.name: replace(other, name=one.name) for one, other in zip(theirs, own, strict=False)}
    if len(own) <= len(theirs):
        return kept, []
    left_out = message(
        "{count} of its UV maps were left out, as the mesh itself has fewer.", count=len(own) - len(kept)
    )
    return kept, [left_out]


def _transfer_in_place(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer an attribute between surfaces in the same place: offsets and directions are mixed without turning."""
    if attribute.kind not in (Kind.OFFSET, Kind.DIRECTION, Kind.NORMAL):
        return transfer_along(attribute, mapped)
    values = np.asarray(attribute.values, dtype=np.float64)
    rows = replace(attribute, kind=Kind.VECTOR, values=values.reshape(len(values), -1))
    mixed = np.asarray(transfer_along(rows, mapped).values).reshape(-1, *values.shape[1:])
    if attribute.kind is not Kind.NORMAL:
        return replace(attribute, values=mixed)
    away = faces_away(on_corners(attribute, mapped.source), mapped.source)
    meant = mapped.surface_map.interpolate(away.astype(np.float64)) > 0
    normals = on_corners(replace(attribute, values=unit_vectors(mixed)), mapped.target)
    return replace(attribute, domain=Domain.CORNER, values=turn_to_faces(normals, mapped.target, meant))
