# SPDX-License-Identifier: GPL-3.0-or-later
"""Interpolate values at points, faces and corners of the target from those around its places on the source.

Numbers are mixed linearly by barycentric weights, faces by area; labels are voted on by the same weights. Numbers at
points and corners of too little confidence are filled in from around them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.transfer.attribute import Attribute, Domain
from zoomout_core.transfer.cut_mesh import cut_surface
from zoomout_core.transfer.islands import islands_of, with_lost_islands, without_specks
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.picks import Picks
from zoomout_core.transfer.potts import elect_for_faces, tally


def mix_points(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Mix values (n, ...) at vertices."""
    return _fill(attribute, mapped, mapped.surface_map.interpolate(_floats(attribute)), np.arange(len(mapped.points)))


def mix_faces(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Mix values (f, ...) of faces: means of samples over the area that a face covers."""
    values = _floats(attribute)
    samples = mapped.samples(np.arange(len(mapped.target.face_start) - 1))
    covered = coo_array(
        (samples.area, (samples.face, mapped.source.triangle_face[samples.triangle])),
        shape=(len(mapped.target.face_start) - 1, len(values)),
    ).tocsr()
    mean = (covered @ values.reshape(len(values), -1)) / covered.sum(axis=1).reshape(-1, 1)
    return _with_values(attribute, mean.reshape(-1, *values.shape[1:]))


def mix_corners(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Mix values (c, ...) at face corners, which jump where the source's values jump from face to face.

    A corner takes the nearest value on the side of its face. Filled-in values do not jump: they continue the means of
    the corners at each vertex around them.
    """
    picks = pick_corners(attribute, mapped)
    return _fill(attribute, mapped, picks.mix(_floats(attribute)), mapped.target.corner_vertex)


def pick_corners(attribute: Attribute, mapped: MappedTarget) -> Picks:
    """The corners of the source between which `mix_corners` interpolates."""
    values, target = _floats(attribute), mapped.target
    triangle = mapped.surface_map.triangle[target.corner_vertex]
    barycentric = mapped.surface_map.barycentric[target.corner_vertex]
    cut = cut_surface(mapped.source, values.reshape(len(values), -1))
    near = np.flatnonzero(mapped.near_border(cut)[target.corner_face])
    start, _ = mapped.nudge(near)
    triangle[near], barycentric[near], _ = cut.walk(start, mapped.points[target.corner_vertex[near]])
    return Picks(mapped.source.triangle_corners[triangle], barycentric)


MIX = {Domain.POINT: mix_points, Domain.FACE: mix_faces, Domain.CORNER: mix_corners}


def vote_points(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Vote on labels at vertices: the one with the largest barycentric weight."""
    return replace(attribute, values=np.asarray(attribute.values)[elect_points(attribute, mapped)])


def elect_points(attribute: Attribute, mapped: MappedTarget) -> Integers:
    """(n_t,) the vertex of the source whose label `vote_points` takes."""
    corners = mapped.surface_map.source_triangles[mapped.surface_map.triangle]
    return _heaviest(corners, _encode(attribute)[0], mapped.surface_map.barycentric)


def vote_corners(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Vote on labels at face corners, read slightly inside the face."""
    return replace(attribute, values=np.asarray(attribute.values)[elect_corners(attribute, mapped)])


def elect_corners(attribute: Attribute, mapped: MappedTarget) -> Integers:
    """(c_t,) the corner of the source whose label `vote_corners` takes."""
    triangle, barycentric = mapped.nudge(np.arange(len(mapped.target.corner_vertex)))
    return _heaviest(mapped.source.triangle_corners[triangle], _encode(attribute)[0], barycentric)


def vote_faces(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Vote on labels of faces by samples, weighted by area and confidence; in doubt borders are kept short.

    Small islands of the source are kept, and single faces beyond a border take the surrounding label.
    """
    code, distinct = _encode(attribute)
    target, island = mapped.target, islands_of(mapped.source, code)
    label_of = np.empty(island.max() + 1, dtype=np.int64)
    label_of[island] = code
    samples = mapped.samples(np.arange(len(target.face_start) - 1))
    candidates, island = tally(samples.face, island[mapped.source.triangle_face[samples.triangle]], samples.weight)
    label = label_of[island]
    chosen = elect_for_faces(candidates, mapped, lambda one, other, *_: label[one] == label[other])
    chosen = with_lost_islands(chosen, candidates, island, target)
    return replace(attribute, values=distinct[without_specks(label[chosen], island[chosen], target)])


VOTE = {Domain.POINT: vote_points, Domain.FACE: vote_faces, Domain.CORNER: vote_corners}


def _floats(attribute: Attribute) -> Floats:
    return np.asarray(attribute.values, dtype=np.float64)


def _with_values(attribute: Attribute, values: Floats) -> Attribute:
    """The attribute with new values; floats keep their precision, integers become floats."""
    dtype = np.asarray(attribute.values).dtype
    return replace(attribute, values=values.astype(dtype) if dtype.kind == "f" else values)


def _fill(attribute: Attribute, mapped: MappedTarget, values: Floats, vertex: Integers) -> Attribute:
    """The attribute with values (q, ...) at vertices (q,), after filling in those of too little confidence."""
    filling = mapped.filling
    if filling is None:
        return _with_values(attribute, values)
    flat = values.reshape(len(values), -1)
    count = np.bincount(vertex, minlength=len(mapped.points))
    sums = csr_array((np.ones(len(vertex)), (vertex, np.arange(len(vertex)))), shape=(len(count), len(vertex))) @ flat
    whole = filling.fill(sums / np.maximum(count, 1)[:, None])
    chosen = np.isin(vertex, filling.filled)
    mixed = flat.copy()
    mixed[chosen] = whole[vertex[chosen]]
    result = _with_values(attribute, mixed.reshape(values.shape))
    return replace(result, notes=(*result.notes, *filling.notes()))


def _encode(attribute: Attribute) -> tuple[Integers, NDArray[Any]]:
    """Encode values as indices (count,) into the distinct values."""
    values = np.asarray(attribute.values)
    distinct, code = np.unique(values, axis=0 if values.ndim > 1 else None, return_inverse=True)
    return code.reshape(-1), distinct


def _heaviest(elements: Integers, code: Integers, weight: Floats) -> Integers:
    """(q,) the element of three (q, 3) whose code has the largest weight (q, 3), summed over equal codes."""
    codes = code[elements]
    votes = ((codes[:, :, None] == codes[:, None, :]) * weight[:, None, :]).sum(axis=2)
    return np.asarray(elements[np.arange(len(elements)), np.argmax(votes, axis=1)])
