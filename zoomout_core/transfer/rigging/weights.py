# SPDX-License-Identifier: GPL-3.0-or-later
"""Skin weights: each vertex mixes a few of many groups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import interpolation_matrix
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.messages import message, plural
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.groups import group_starts
from zoomout_core.transfer.inpaint import MIN_WEIGHT, filling
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.skinning import row_of
from zoomout_core.transfer.rigging.weight_islands import find_islands

# Weights that sum to one up to rounding are meant to.
SUM_TOLERANCE = 0.01
# Edges over which a group fades out towards vertices where a limit drops it. If vertices with 13 to 29 smooth groups
# are limited to four, 3 reduces the larger steps between neighbours (99th percentile) by 16 to 37 %, for 6 to 23 % more
# error. Fading further gains little.
FADING_EDGES = 3
# Smallest mean change of the weights of an island, summed over groups, for which it is filled in.
MIN_ISLAND_CHANGE = 0.5
# Smallest number of its vertices; single ones are noise of the weights.
MIN_ISLAND = 3


def mix_weights(
    attribute: Attribute,
    mapped: MappedTarget,
    *,
    normalised: ArrayLike | None = None,
    limit: int | None = None,
    sums: ArrayLike | None = None,
    room: ArrayLike = np.inf,
) -> Attribute:
    """Weights (n, groups) at vertices, sparse throughout.

    Weights below 1e-4 are dropped. Each vertex keeps the `limit` largest weights of the `normalised` groups. They are
    scaled to sum to one where the source's do, and elsewhere to keep their sum, as far as there is `room`. Other groups
    are mixed only. Vertices without any weight stay without. Vertices of too little confidence are filled in, and so
    are islands of the `normalised` groups, see `find_islands`.

    Args:
        attribute: values are a sparse (n_s, groups) array.
        mapped: the target on the source.
        normalised: (groups,) mask, or column numbers, of the groups that share a vertex among them: those
            that deform and are not locked. All, when not given.
        limit: how many of these a vertex may have; the most that one has on the source, when not given. Where it
            is less than that, groups fade out, see `limit_weights`.
        sums: (n_s,) sums of the groups that share a vertex on the source, including those that are locked on the
            target. None for the sums of the `normalised` groups.
        room: (n_t,) or a number: what locked groups leave of each vertex of the target.

    Raises:
        MeshError: the limit is below one, or `normalised`, `sums` or `room` does not fit the groups or vertices.
    """
    weights = csr_array(attribute.values)
    weights = weights.astype(np.promote_types(weights.dtype, np.float64))
    negative = int((weights.data < 0).sum())
    weights.data = np.maximum(weights.data, 0)
    shared = _column_mask(normalised, weights.shape[1])
    if limit is not None and limit < 1:
        raise MeshError(f"A limit of {limit} weights per vertex leaves none: give 1 or more.")
    mixing = mixing_matrix(mapped)
    mixed = csr_array(mixing @ weights)
    own_sums = weights @ shared.astype(float)
    source_sums = own_sums if sums is None else _each(sums, len(mapped.source.vertices), "sums")
    both_sums = mixing @ np.stack([source_sums, own_sums], axis=1)
    notes = attribute.notes
    if negative:
        notes += (message("{layer}: {count:,} negative weights count as 0.", layer=attribute.name, count=negative),)
    if mapped.filling is not None:
        mixed, both_sums = mapped.filling.fill_weights(mixed), mapped.filling.fill(both_sums, following=True)
        notes += mapped.filling.notes(following=True)
    if shared.any():
        mixed, found = _fill_islands(mixed, weights, shared, mapped)
        notes += found
    mixed.data[mixed.data < MIN_WEIGHT] = 0
    mixed.eliminate_zeros()
    max_count = _max_count(weights, shared)
    if limit is None or limit >= max_count:
        _keep_largest(mixed, shared, limit or max_count)
    else:
        limit_weights(mixed, mapped.target, shared, limit)
    wanted = np.where(np.abs(both_sums[:, 0] - 1) < SUM_TOLERANCE, 1.0, both_sums[:, 1])
    without = _rescale(mixed, shared, np.minimum(wanted, _each(room, len(wanted), "room")))
    mixed.sort_indices()
    if without:
        notes += (
            message(
                "{layer}: locked groups leave no weight for other groups on {without:,} of {count:,} "
                "vertices: reduce or unlock them.",
                layer=attribute.name,
                without=without,
                count=len(wanted),
            ),
        )
    return replace(attribute, values=mixed.astype(attribute.values.dtype), notes=notes)


def _max_count(weights: csr_array, shared: Booleans) -> int:
    """The largest number of the shared groups, a mask (groups,), that a vertex has."""
    counted = shared[weights.indices] & (weights.data >= MIN_WEIGHT)
    return int(np.bincount(row_of(weights)[counted], minlength=1).max())


def limit_weights(weights: csr_array, surface: Surface, shared: Booleans, limit: int) -> None:
    """Keep only the `limit` largest of the shared groups, a mask (groups,), at each vertex, in place; sums stay.

    A group that is among the largest at one vertex and not at the next one would make a step there. It fades out
    over some edges instead.
    """
    sums = weights @ shared.astype(float)
    dropped = _keep_largest(weights, shared, limit)
    if dropped.nnz == 0:
        return
    near = _neighbours(surface)
    kept = csr_array((np.arange(1, weights.nnz + 1), weights.indices, weights.indptr), shape=weights.shape)
    share = np.ones(weights.nnz)
    for edges in range(1, FADING_EDGES + 1):
        dropped = csr_array(near @ dropped)
        dropped.data[:] = 1
        reached = kept.multiply(dropped).data - 1
        share[reached] = np.minimum(share[reached], edges / (FADING_EDGES + 1))
    weights.data *= share
    _rescale(weights, shared, sums)


def rename_groups(weights: Attribute, names: Mapping[str, str]) -> Attribute:
    """Weights with new names by the old ones; groups that get the same name are added up."""
    renamed = [names.get(label, label) for label in weights.labels]
    labels = tuple(dict.fromkeys(renamed))
    if len(labels) == len(renamed):
        return replace(weights, labels=labels)
    column = np.array([labels.index(name) for name in renamed])
    joining = csr_array(
        (np.ones(len(column), weights.values.dtype), (np.arange(len(column)), column)), (len(column), len(labels))
    )
    return replace(weights, values=csr_array(weights.values @ joining), labels=labels)


def sum_to_one(weights: Any) -> bool:
    """Whether weights (n, groups) sum to one on every vertex, as those that deform a whole mesh do."""
    return bool((np.abs(weights.sum(axis=1) - 1) < SUM_TOLERANCE).all())


def _each(values: ArrayLike, count: int, name: str) -> Floats:
    """(count,) values of vertices, of an array or a single number."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), (count,)):
        raise MeshError(f"`{name}` has the shape {array.shape}: give one number for each of {count} vertices.")
    return np.broadcast_to(array, count)


def _column_mask(columns: ArrayLike | None, count: int) -> Booleans:
    mask = np.ones(count, dtype=bool)
    if columns is None:
        return mask
    chosen = np.asarray(columns)
    if chosen.dtype == bool and chosen.shape == mask.shape:
        return chosen
    if chosen.dtype == bool or (chosen.size and not (chosen.min() >= 0 and chosen.max() < count)):
        raise MeshError(f"`normalised` must be a mask or numbers of the {count} groups.")
    mask[:] = False
    mask[chosen.astype(np.int64)] = True
    return mask


def _fill_islands(
    mixed: csr_array, weights: csr_array, shared: Booleans, mapped: MappedTarget
) -> tuple[csr_array, tuple[str, ...]]:
    """Fill in islands of bones from their surroundings: the weights (n_t, groups), and a note if there are any."""
    columns = np.flatnonzero(shared)
    of_source, of_target = csr_array(weights[:, columns]), csr_array(mixed[:, columns])
    island = find_islands(mapped.surface_map, mapped.source, of_source, mapped.target, of_target)
    on_island = island >= 0
    if not on_island.any() or on_island.all():
        return mixed, ()
    filled = filling(mapped.target, ~on_island).fill_weights(of_target)
    # Where two bones move a place alike, the stronger one changes to and fro along their border.
    change = np.asarray(abs(filled - of_target).sum(axis=1)).ravel()
    members = np.bincount(island[on_island])
    clear = np.bincount(island[on_island], change[on_island]) > MIN_ISLAND_CHANGE * np.maximum(members, 1)
    on_island &= (clear & (members >= MIN_ISLAND))[island]
    if not on_island.any():
        return mixed, ()
    count = int(on_island.sum())
    note = plural(
        count,
        "{count} stray weight, far from the rest of its bone, was replaced.",
        "{count:,} stray weights, far from the rest of their bone, were replaced.",
    )
    here = diags_array(on_island.astype(np.float64))
    places = csr_array((np.ones(len(columns)), (np.arange(len(columns)), columns)), shape=(len(columns), len(shared)))
    return csr_array(mixed + here @ (csr_array(filled - of_target) @ places)), (note,)


def mixing_matrix(mapped: MappedTarget) -> Any:
    """(n_t, n_s) sparse: row i holds the barycentric weights of target vertex i."""
    surface_map = mapped.surface_map
    corners = surface_map.source_triangles[surface_map.triangle]
    return interpolation_matrix(corners, surface_map.barycentric, len(mapped.source.vertices))


def _neighbours(surface: Surface) -> csr_array:
    """(n, n) which vertices of a surface are at most an edge apart, where borders that coincide are one."""
    working = surface.working
    edges, _ = unique_edges(working.triangles)
    count, places = len(surface.vertices), len(working.vertices)
    rows, columns = np.concatenate([edges, edges[:, ::-1], np.tile(np.arange(places)[:, None], 2)]).T
    adjacent = csr_array((np.ones(len(rows), np.int32), (rows, columns)), shape=(places, places))
    used = np.flatnonzero(working.vertex_of >= 0)
    place = csr_array((np.ones(len(used), np.int32), (used, working.vertex_of[used])), shape=(count, places))
    near = csr_array(place @ adjacent @ place.T)
    near.data[:] = 1
    return near


def _keep_largest(weights: csr_array, shared: Booleans, limit: int) -> csr_array:
    """Drop all but the largest weights of each row in the shared columns; the first of equals stay.

    Returns:
        A one for each weight that was dropped.
    """
    rows = row_of(weights)
    counts = shared[weights.indices]
    crowded = np.bincount(rows[counts], minlength=weights.shape[0]) > limit
    entries = np.flatnonzero(counts & crowded[rows])
    entries = entries[np.lexsort((weights.indices[entries], -weights.data[entries], rows[entries]))]
    row = rows[entries]
    begin = group_starts(row)
    rank = np.arange(len(row)) - np.repeat(begin, np.diff(begin, append=len(row)))
    out = entries[rank >= limit]
    dropped = csr_array((np.ones(len(out), np.int32), (rows[out], weights.indices[out])), shape=weights.shape)
    weights.data[out] = 0
    weights.eliminate_zeros()
    return dropped


def _rescale(weights: Any, shared: Booleans, wanted: Floats) -> int:
    """Scale the shared columns in place, so that each row has a wanted sum; sums below `MIN_WEIGHT` become zero.

    Returns:
        How many rows lose their weights because nothing is wanted.
    """
    rows = row_of(weights)
    counts = shared[weights.indices]
    kept = np.bincount(rows[counts], weights.data[counts], minlength=weights.shape[0])
    wanted = np.where(wanted < MIN_WEIGHT, 0, wanted)
    factor = np.divide(wanted, kept, out=np.ones(len(kept)), where=kept > 0)
    weights.data[counts] *= factor[rows[counts]]
    weights.eliminate_zeros()
    return int(((kept > 0) & (wanted == 0)).sum())
