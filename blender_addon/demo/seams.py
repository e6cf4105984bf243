# SPDX-License-Identifier: GPL-3.0-or-later
"""Seams of the demo's character, as an artist would cut it: few, out of sight, and none along a limb's outside.

Front and back of arms and legs stay joined along the outside, down to wrist and ankle. Front and back of the head are
separate islands, as are the soles. The torso opens along the spine, the tail underneath.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from zoomout_core.arrays import Booleans, Floats, Indices, Integers
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.samples.grids import triangles_of

from . import shape

# Patches with a smaller fraction of the mesh's faces are merged into their surroundings.
SMALLEST_PANEL = 0.006
FRONT, BACK, SOLE = 0, 1, 2


def seam_edges(vertices: Floats, faces: Integers, edges: Indices, face_edges: Indices) -> Booleans:
    """(e,) which edges of the character are seams.

    Args:
        vertices: (n, 3) positions.
        faces: (m, 4) vertex numbers.
        edges: (e, 2) vertex numbers.
        face_edges: (m, 4) the edges of each face.
    """
    normals = vertex_normals(vertices, triangles_of(faces))
    centre, facing = vertices[faces].mean(axis=1), normals[faces].mean(axis=1)
    name, part = np.unique(shape.nearest_part(centre), return_inverse=True)
    whole = np.isin(name[part], ("torso", "tail"))
    sole = np.char.startswith(name[part], "leg") & (facing[:, 2] < -0.5) & (centre[:, 2] < 0.1)
    side = np.where(sole, SOLE, np.where((facing[:, 1] > 0) & ~whole, BACK, FRONT))
    part, side = np.divmod(_without_strays(3 * part + side, faces), 3)

    at_edge = np.empty(len(edges), dtype=name.dtype)
    at_edge[face_edges] = name[part][:, None]
    (x, y, z), (nx, ny, nz) = vertices[edges].mean(axis=1).T, normals[edges].mean(axis=1).T
    outside = np.select(
        [np.char.startswith(at_edge, "arm"), np.char.startswith(at_edge, "leg")],
        [(nz > 0) & (np.abs(x) < 0.57), (nx * x > 0) & (z > 0.12)],
        False,
    )
    inside = np.select(
        [at_edge == "torso", at_edge == "tail", at_edge == "head"],
        [y > 0, ny > nz, (y < -0.05) & (z > 1.0) & (z < 1.12)],  # a dart under the chin lets the muzzle lie flat
        False,
    )
    between_panels = _between(3 * part + side, face_edges, len(edges))
    kept_whole = ~_between(2 * part + (side == SOLE), face_edges, len(edges)) & outside
    middle = _between((centre[:, 0] > 0).astype(int), face_edges, len(edges))
    return (between_panels & ~kept_whole) | (middle & inside)


def _between(label: Integers, face_edges: Integers, count: int) -> Booleans:
    """(count,) which edges separate faces of different labels (m,)."""
    low, high = np.full(count, label.max()), np.zeros(count, dtype=int)
    np.minimum.at(low, face_edges, label[:, None])
    np.maximum.at(high, face_edges, label[:, None])
    return low != high


def _without_strays(label: Integers, faces: Integers) -> Integers:
    """The labels (m,) of faces, where small patches take the labels of their surroundings."""
    at = coo_array((np.ones(faces.size), (np.repeat(np.arange(len(faces)), 4), faces.ravel()))).tocsr()
    shared = (at @ at.T).tocoo()  # number of vertices that two faces share: those of an edge, or one
    joined = (label[shared.row] == label[shared.col]) & (shared.data > 1)
    patches = coo_array((shared.data[joined], (shared.row[joined], shared.col[joined])), shape=shared.shape)
    _, patch = connected_components(patches, directed=False)
    stray = np.bincount(patch)[patch] < SMALLEST_PANEL * len(label)
    label = label.copy()
    while stray.any():
        votes = shared.tocsr() @ (np.eye(label.max() + 1)[label] * ~stray[:, None])
        reached = stray & votes.any(axis=1)
        label[reached] = np.argmax(votes[reached], axis=1)
        stray &= ~reached
    return label
