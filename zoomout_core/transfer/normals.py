# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions, which rotate with the surface, and normals, which point out of it.

A source that is shaded flat has a normal for each face. A coarse face of the target spans several of them, and normals
of different faces at its corners would show as streaks: it is shaded flat, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas, triangle_normals, unit_vectors, vertex_normals
from zoomout_core.transfer.attribute import Attribute, Domain
from zoomout_core.transfer.cut_mesh import adjacent_edges
from zoomout_core.transfer.frames import rotations
from zoomout_core.transfer.interpolate import MIX
from zoomout_core.transfer.mapped_target import MappedTarget

# Sine of the angle to which normals are lifted above the surface, if the transfer pushed them below it.
LIFTED_SINE = 0.05
# An edge is hard if normals jump there by at least this part of the turn between its faces. Flat shading jumps by all
# of it, smooth shading by none.
HARD_JUMP = 0.5
# Degrees by which faces turn at an edge below which it is neither hard nor smooth, as normals hardly differ there.
SMALL_TURN = 15.0
# Target vertices for each triangle of the source that they are on, above which the target is finer than the source. It
# is 1 if far coarser, 1.3 for equal numbers of faces, and at least 1.8 for skins of voxels, which get worse if flat.
FINER = 1.5
# Degrees between a normal and its face above which the face is shaded flat. On two game characters with 30 to 60 % of
# their vertices, 1 to 10 instead of 3 to 19 % of the area is shaded more than 30 degrees off. 15 to 45 do the same.
LARGEST_TILT = 30.0


def turn_directions(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer directions (count, 3): mixed, rotated with the surface, and of the same length as their sources."""
    length = np.linalg.norm(np.asarray(attribute.values, dtype=np.float64), axis=1)
    turned, length = _turn(attribute, length, mapped)
    return replace(turned, values=(unit_vectors(turned.values) * length[:, None]).astype(attribute.values.dtype))


def turn_normals(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer unit normals (count, 3): directions that stay above the surface if they are above the source's.

    The winding of the faces defines the upper side.
    """
    values = np.asarray(attribute.values, dtype=np.float64)
    height = np.einsum("cx,cx->c", values, outward_normals(mapped.source, attribute.domain))
    turned, height = _turn(attribute, height, mapped)
    normals, outward = unit_vectors(turned.values), outward_normals(mapped.target, attribute.domain)
    found = np.einsum("cx,cx->c", normals, outward)
    component = _components(mapped.target, attribute.domain)
    inside_out = (np.bincount(component, height * found) < 0)[component]
    normals[inside_out] -= 2 * (found[:, None] * outward)[inside_out]
    found[inside_out] *= -1
    pushed = (height > 0) & (found < 0)
    normals[pushed] += (LIFTED_SINE - found[pushed])[:, None] * outward[pushed]
    normals = unit_vectors(normals)
    if attribute.domain is Domain.CORNER:
        normals = _flatten(normals, _are_flat(values, mapped.source), mapped)
    return replace(turned, values=normals.astype(attribute.values.dtype))


def _are_flat(normals: Floats, surface: Surface) -> Booleans:
    """(f,) whether faces are shaded flat: corner normals (c, 3) are their own, and jump at all edges that turn."""
    first, second = adjacent_edges(surface)
    faces = surface.corner_face[first[:, 0]], surface.corner_face[second[:, 0]]
    of_face = outward_normals(surface, Domain.FACE)
    turn = np.linalg.norm(of_face[faces[0]] - of_face[faces[1]], axis=1)
    jump = np.linalg.norm(normals[first] - normals[second], axis=2).mean(axis=1)
    turns, is_hard = turn > np.radians(SMALL_TURN), jump > HARD_JUMP * turn
    count = len(surface.face_start) - 1
    hard, smooth = (
        np.bincount(np.concatenate([face[chosen] for face in faces]), minlength=count)
        for chosen in (turns & is_hard, turns & ~is_hard)
    )
    own = np.minimum.reduceat(_cosines(normals, of_face[surface.corner_face]), surface.face_start[:-1])
    return np.asarray((hard > 0) & (smooth == 0) & (own > np.cos(np.radians(LARGEST_TILT))))


def _flatten(normals: Floats, flat: Booleans, mapped: MappedTarget) -> Floats:
    """Corner normals (c_t, 3) with those of tilted faces replaced by the face's own where the source is `flat` (f,)."""
    source, target, triangle = mapped.source, mapped.target, mapped.surface_map.triangle
    if len(triangle) > FINER * len(np.unique(triangle)):
        return normals
    start, face = target.face_start[:-1], target.corner_face
    on_flat = flat[source.triangle_face[triangle]][target.corner_vertex]
    mostly_flat = 2 * np.add.reduceat(on_flat.astype(np.int64), start) > np.diff(target.face_start)
    own = outward_normals(target, Domain.FACE)[face]
    tilted = _cosines(normals, own) < np.cos(np.radians(LARGEST_TILT))
    chosen = (mostly_flat & np.logical_or.reduceat(tilted, start))[face] & own.any(axis=1)
    return np.where(chosen[:, None], own, normals)


def _cosines(first: Floats, second: Floats) -> Floats:
    """(c,) cosines of the angles between unit vectors (c, 3)."""
    return np.asarray(np.einsum("cx,cx->c", first, second))


def _turn(attribute: Attribute, number: Floats, mapped: MappedTarget) -> tuple[Attribute, Floats]:
    """Mix and rotate vectors to the target, and mix a number (count,) of each."""
    both = np.column_stack([np.asarray(attribute.values, dtype=np.float64), number])
    mixed = MIX[attribute.domain](replace(attribute, values=both), mapped)
    turned = np.einsum("cxy,cy->cx", rotations(mapped, attribute.domain), mixed.values[:, :3])
    return replace(mixed, values=turned), mixed.values[:, 3]


def _components(surface: Surface, domain: Domain) -> Integers:
    """(count,) number of each element's connected component."""
    at_points = surface.working.component[surface.working.vertex_of]
    if domain is Domain.POINT:
        return at_points
    at_corners = at_points[surface.corner_vertex]
    return at_corners if domain is Domain.CORNER else at_corners[surface.face_start[:-1]]


def outward_normals(surface: Surface, domain: Domain) -> Floats:
    """(count, 3) unit normals of the surface: of the vertices, also for corners, or of the faces."""
    vertices, triangles = surface.vertices, surface.triangles
    if domain is not Domain.FACE:
        normals = vertex_normals(vertices, triangles)
        return normals if domain is Domain.POINT else normals[surface.corner_vertex]
    weighted = triangle_normals(vertices, triangles) * triangle_areas(vertices, triangles)[:, None]
    return unit_vectors(segment_sum(weighted, surface.triangle_face, len(surface.face_start) - 1))
