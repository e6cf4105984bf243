# SPDX-License-Identifier: GPL-3.0-or-later
"""Islands of faces with one label: keep small ones of the source in a vote, and remove specks that it lacks.

A vote keeps borders short, and so drops islands of about a face's size, which an artist may have made on purpose. The
noise of a map leaves single faces beyond a border. Faces that share a vertex belong together.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array

from zoomout_core.arrays import Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths, triangle_areas
from zoomout_core.transfer.cut_mesh import adjacent_edges
from zoomout_core.transfer.groups import first_of_each, label_groups
from zoomout_core.transfer.potts import Candidates

# Minimum area covered by an island that no face elected, relative to a face, for the face to receive it.
MIN_COVER = 0.5


def islands_of(surface: Surface, label: Integers) -> Integers:
    """(f,) number of each face's island, which joins neighbours of the same label (f,)."""
    vertex = surface.working.vertex_of[surface.corner_vertex]
    vertex = np.where(vertex >= 0, vertex, len(surface.vertices) + surface.corner_vertex)
    _, meeting = np.unique(vertex * (label.max() + 1) + label[surface.corner_face], return_inverse=True)
    meeting = meeting.reshape(-1) + len(label)
    group = label_groups(int(meeting.max()) + 1, surface.corner_face, meeting)
    return np.unique(group[: len(label)], return_inverse=True)[1].reshape(-1)


def with_lost_islands(chosen: Integers, candidates: Candidates, island: Integers, target: Surface) -> Integers:
    """The chosen candidates (f,), in which each lost island gets the face that it covers best.

    Args:
        chosen: the elected candidate of each face.
        candidates: the k candidates.
        island: (k,) the source's island of each.
        target: the surface whose faces choose.
    """
    area = np.bincount(target.triangle_face, triangle_areas(target.vertices, target.triangles))
    covered = np.bincount(island, candidates.share * area[candidates.face])
    faces_of = np.bincount(island[chosen], minlength=len(covered))
    lost = np.flatnonzero(faces_of[island] == 0)
    best = lost[first_of_each(island[lost], -candidates.share[lost])]
    face = candidates.face[best]
    # No island loses its only face to another.
    fit = (covered[island[best]] >= MIN_COVER * area[face]) & (faces_of[island[chosen[face]]] > 1)
    best = best[fit]
    result = chosen.copy()
    result[candidates.face[best]] = best
    return result


def without_specks(label: Integers, island: Integers, surface: Surface) -> Integers:
    """Labels (f,) of faces, where single faces take that of their neighbours if their island is elsewhere.

    The islands (f,) are the source's, which the labels come from.
    """
    own = islands_of(surface, label)
    speck = (np.bincount(own)[own] == 1) & (np.bincount(island)[island] > 1)
    if not speck.any():
        return label
    first, second = adjacent_edges(surface)
    length = edge_lengths(surface.vertices[surface.corner_vertex], first)
    face, other = surface.corner_face[first[:, 0]], surface.corner_face[second[:, 0]]
    face, other, length = np.concatenate([face, other]), np.concatenate([other, face]), np.tile(length, 2)
    mine = speck[face] & ~speck[other]
    # Vote on the neighbours' labels by the length of the edges.
    votes = coo_array((length[mine], (face[mine], label[other[mine]])), shape=(len(label), label.max() + 1))
    votes = votes.tocsr().tocoo()
    most = first_of_each(votes.row, -votes.data)
    result = label.copy()
    result[votes.row[most]] = votes.col[most]
    return result
