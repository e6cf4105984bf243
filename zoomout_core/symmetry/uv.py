# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror UV maps across a symmetry: one side takes the other's layout, beside it or over it.

The layout of the losing side is read from the winning one through the symmetry, so both overlap. Each piece is then
moved to the previous place of its faces in the atlas by the best similarity (Umeyama 1991), mirrored or not, so that it
has its own texels. An island that crosses the symmetry line is not torn: corners shared with the winning side stay in
place.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np
from scipy.sparse import coo_array

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.procrustes import Moments
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.symmetry.mirror import Direction, mirror, own_share_of
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.transfer import Attribute, Domain
from zoomout_core.transfer.cut_mesh import cut_surface

# Where the losing side's layout goes: to its earlier place, or over that of the winning side.
Layout: TypeAlias = Literal["own", "over"]
LAYOUTS = ("own", "over")

# Weight of corners shared with the winning side, in the fit that moves an island.
SHARED_CORNER_WEIGHT = 100.0
# Minimum ratio of an island's mean square extent to that of its new layout; below it, the island had no place.
MIN_EXTENT_RATIO = 1e-6


def symmetrise_uv(
    attribute: Attribute, symmetry: SelfMap, direction: Direction = "left_to_right", layout: Layout = "own"
) -> Attribute:
    """Make the layout of a UV map the same on both sides, or exchange the layouts.

    Args:
        attribute: a UV map of the symmetry's surface.
        symmetry: a symmetry of the surface.
        direction: "left_to_right", "right_to_left" or "exchange"; two layouts have no mean.
        layout: "own": each island that receives a layout is moved to the earlier place of its faces, rotated, scaled or
            mirrored. "over": it is placed over the giving side, so that both sides share their texels, or exchange
            them.

    Raises:
        MeshError: the direction needs two sides, but the symmetry has none, or the direction is "average".
        ValueError: the layout is unknown.
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout is {layout!r}: give one of {', '.join(LAYOUTS)}.")
    if direction == "average":
        raise MeshError(
            "'{name}' is a UV map, which cannot be averaged: copy the left or the right side.", name=attribute.name
        )
    losing = own_share_of(Domain.CORNER, symmetry, direction) < 0.5
    other = mirror(attribute, symmetry)
    before, mirrored_uv = np.asarray(attribute.values, dtype=np.float64), np.asarray(other.values, dtype=np.float64)
    if layout == "own":
        mirrored_uv = _at_own_places(before, mirrored_uv, losing, symmetry.surface)
    values = np.where(losing[:, None], mirrored_uv, before)
    return replace(other, values=values.astype(np.asarray(attribute.values).dtype))


def _at_own_places(before: Floats, mirrored_uv: Floats, losing: Booleans, surface: Surface) -> Floats:
    """Move each piece of UVs (c, 2) over the winning side to the former place of most of it."""
    own = cut_surface(surface, before)
    island = own.island[surface.corner_face]
    piece = cut_surface(surface, np.column_stack([mirrored_uv, losing])).island[surface.corner_face]
    # A corner's share of the area of the triangles it belongs to, on the losing side.
    areas = np.repeat(triangle_areas(surface.vertices, surface.triangles), 3)
    area = segment_sum(areas, surface.triangle_corners.ravel(), len(surface.corner_vertex)) * losing
    at_home = island == _most(piece, island, area)[piece]
    winners = np.zeros(own.cut_vertex.max() + 1, dtype=bool)
    winners[own.cut_vertex[~losing]] = True
    shared = winners[own.cut_vertex] & losing & at_home
    weight = area * at_home * np.where(shared, SHARED_CORNER_WEIGHT, 1.0)
    moved, placed = _fit_groups(mirrored_uv, before, piece, weight)
    moved = np.where((placed[piece] & losing)[:, None], moved, mirrored_uv)
    kept = shared & placed[piece]
    moved[kept] = before[kept]
    return moved


def _fit_groups(start: Floats, end: Floats, group: Integers, weight: Floats) -> tuple[Floats, Booleans]:
    """Move points (c, 2) of each group (c,) by the best similarity; also returns which groups have one."""
    count = int(group.max()) + 1
    total = np.maximum(segment_sum(weight, group, count), 1e-300)

    def mean(values: Floats) -> Floats:
        return segment_sum(weight[:, None] * values.reshape(len(values), -1), group, count) / total[:, None]

    centre, end_centre = mean(start), mean(end)
    x, y = start - centre[group], end - end_centre[group]
    covariance = mean(y[:, :, None] * x[:, None]).reshape(-1, 2, 2)
    spread, end_spread = mean((x**2).sum(axis=1))[:, 0], mean((y**2).sum(axis=1))[:, 0]
    found = Moments(centre, end_centre, covariance, spread).similarities(None)
    return found[group](start[:, None])[:, 0], end_spread > MIN_EXTENT_RATIO * spread


def _most(group: Integers, label: Integers, weight: Floats) -> Integers:
    """The label with the most weight in each group, for items (c,) with a group, a label and a weight each."""
    votes = coo_array((weight, (group, label)), shape=(group.max() + 1, label.max() + 1)).tocsr()
    return np.asarray(votes.argmax(axis=1)).ravel()
