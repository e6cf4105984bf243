# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail: simplified meshes of an asset with all of its data.

Each vertex of a level is one of the asset's, with its morph targets, texture coordinates and joints. Seams and borders
of materials stay in place, and vertices where the mesh bends in its poses. Then the positions, and the weights of these
joints, are fitted to the asset. For levels that were made by hand see `given_levels.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import replace
from numbers import Real
from types import SimpleNamespace

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import MATERIALS, NORMALS, UV, Asset, at_rest, in_pose_of, layers_of, on_corners
from zoomout_core.assets.facing_normals import faces_away, turn_to_faces
from zoomout_core.assets.fit_level import LEVEL_FIT, fit_level, fit_weights
from zoomout_core.assets.level import FITTED, Level, Poses, errors_of_level, merge_places, points_in_poses
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.mirror_pairs import mirror_moves, mirror_pairs
from zoomout_core.mesh.simplification.simplify import simplify
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, components, triangle_areas, unique_edges, unit_vectors
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.attribute import Domain
from zoomout_core.transfer.groups import expand_ranges, first_of_each
from zoomout_core.transfer.rigging.weights import limit_weights

# Digits of texture coordinates; smaller differences are rounding.
UV_DIGITS = 5
# Ratio of a level's vertices to the requested number from which a note gives the reason.
MORE = 1.1
# Share of the time that simplifying takes.
SIMPLIFY = 0.6
# Levels with fewer vertices than this have no faces to speak of.
MIN_VERTICES = 12


@memory_in_words
@on_one_blas_thread
def make_lods(asset: Asset, ratios: Sequence[float], max_weights: int | None = None) -> list[Level]:
    """Simplify an asset for each of several levels.

    Args:
        asset: the asset, which is level 0.
        ratios: for each further level the share of vertices to keep, between 0 and 1.
        max_weights: maximum number of joints of a vertex; that of the asset by default.

    Returns:
        The further levels, whose meshes are on the nodes of the asset's.

    Raises:
        MeshError: a ratio leaves too few vertices, or is not between 0 and 1.
    """
    source = at_rest(asset)
    working = source.surface.working
    if not ratios:
        raise MeshError("No levels are given: give shares of the vertices, such as 0.5.")
    for ratio in ratios:
        if not isinstance(ratio, Real) or not 0 < ratio < 1 or ratio * len(working.vertices) < MIN_VERTICES:
            raise MeshError(
                f"A level cannot have {ratio!r} of {len(working.vertices):,} vertices: give shares below 1 that leave "
                f"{MIN_VERTICES} vertices or more."
            )
    poses = Poses(source)
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
    poses: Poses,
    part: tuple[Integers, Integers, Integers],
    ratio: float,
    max_weights: int | None,
) -> Level:
    """A level of an asset, whose state at rest is `source`, with the triangles and corners of a part of it."""
    level, used = _select(source, *part)
    if max_weights is not None:
        level = with_fewer_weights(level, max_weights)
    level = _with_facing_normals(_fit(source, level, used, poses), source, used)
    found = _map_of(source.surface, used)
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
    return Level(in_pose_of(level, asset), match, tuple(notes), *errors_of_level(source, level, found))


def _simplify(source: Asset, poses: Poses, ratios: Sequence[float]) -> list[tuple[Integers, Integers, Integers]]:
    """For each level the triangles of an asset at rest that it keeps, and their corners, see `simplify`."""
    surface = source.surface
    first, of_vertex = merge_places(surface.vertices)
    rest = surface.vertices[first]
    corners = surface.triangle_corners
    textures = layers_of(source.attributes, UV)
    materials, seams = source.find(MATERIALS), list[Integers]()
    numbers = [] if materials is None else [np.asarray(materials.values)[surface.triangle_face]]
    for texture in textures:
        values = np.round(on_corners(texture, surface), UV_DIGITS)
        seams.append(np.unique(values, axis=0, return_inverse=True)[1].ravel()[corners])
    # Materials come first: their borders are seen from afar. The vertices differ where several are in one place, as of
    # two meshes, or with other weights.
    layers = [*(np.repeat(each[:, None], 3, axis=1) for each in numbers), *seams, surface.triangles]
    order = np.argsort(-np.asarray(ratios), kind="stable")
    found = simplify(
        np.array([rest, *(each[first] for each in poses.positions)]),
        of_vertex[surface.triangles],
        layers,
        [round(ratios[number] * len(surface.working.vertices)) for number in order],
        mirror_pairs(rest),
        on_corners(textures[0], surface)[corners] if textures else None,
        seams[0] if seams else None,
        _regions(rest, of_vertex[surface.triangles], numbers[0]) if numbers else None,
    )
    parts = [(alive, corners.ravel()[places], corners.ravel()[content]) for alive, places, content in found]
    return [parts[place] for place in np.argsort(order)]


def _regions(vertices: Floats, triangles: Integers, materials: Integers) -> Integers:
    """(m,) numbers of the connected regions of one material that triangles (m, 3) belong to.

    The largest regions of all materials come first, then the second ones, such as the other eye, and so on.
    """
    key = materials[:, None] * len(vertices) + triangles
    first, of_corner = np.unique(key, return_inverse=True)
    corners = of_corner.reshape(-1, 3)
    region = components(unique_edges(corners)[0], len(first))[corners[:, 0]]
    area = np.bincount(region, triangle_areas(vertices, triangles))
    material = np.zeros(len(area), dtype=np.int64)
    material[region] = materials
    order = np.lexsort((-area, material))
    start = np.flatnonzero(np.diff(material[order], prepend=-2))
    rank = np.arange(len(order)) - np.repeat(start, np.diff(start, append=len(order)))
    number = np.empty_like(order)
    number[order[np.lexsort((-area[order], rank))]] = np.arange(len(order))
    return np.asarray(number[region])


def _select(asset: Asset, alive: Integers, corners: Integers, content: Integers) -> tuple[Asset, Integers]:
    """The part of an asset that a level keeps, and (k,) the vertices of the asset that it has.

    Args:
        asset: the asset at rest.
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
    """Give each corner of a level the normal of its vertex in the asset that is nearest to its face's normal.

    If all of them face away, the face's normal is used, because the place would be black. Vertices whose normals face
    away in the asset, such as those of foliage, keep them.
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
    found = turn_to_faces(best, made, faces_away(values, surface)[used])
    attributes = tuple(replace(each, values=found) if each.name == NORMALS else each for each in level.attributes)
    return replace(level, attributes=attributes)


def _fit(source: Asset, level: Asset, used: Integers, poses: Poses) -> Asset:
    """A level at rest, moved and weighted to be close to the asset in all poses; coinciding vertices still coincide."""
    rest = level.surface.vertices
    first, of_vertex = merge_places(rest)
    places = points_in_poses(source, poses, poses.parts, poses.parts[used], FITTED * len(first))
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
    skin = None if level.skin is None else replace(level.skin, rest=moved)
    return replace(level, surface=level.surface.with_vertices(moved), skin=skin)


def _map_of(surface: Surface, used: Integers) -> SurfaceMap:
    """The map of a level whose vertices are vertices (k,) of the surface."""
    triangle = np.zeros(len(surface.vertices), dtype=np.int64)
    triangle[surface.triangles.ravel()] = np.repeat(np.arange(len(surface.triangles)), 3)
    barycentric = (surface.triangles[triangle[used]] == used[:, None]).astype(np.float64)
    return SurfaceMap(triangle[used], barycentric, surface.triangles)
