# SPDX-License-Identifier: GPL-3.0-or-later
"""Islands of a bone on a target: patches cut off from the region that the bone moves, where the source has one region.

A patch of the forearm's weights on the hip follows the arm in every pose. The source distinguishes islands from regions
that are apart on purpose, such as the two sleeves that a single bone moves.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.transfer.groups import label_groups
from zoomout_core.transfer.rigging.skinning import strongest

# Largest area of an island relative to that of the region that it is cut off from: otherwise it is unknown which of two
# is right.
MAX_ISLAND = 0.25


def find_islands(
    surface_map: SurfaceMap, source: Surface, source_weights: csr_array, target: Surface, weights: csr_array
) -> Integers:
    """(n_t,) the number of the island of a bone that each vertex of a target is on, -1 for none.

    Regions of the target's weights (n_t, b) are compared with those of the source's (n_s, b) along the map.
    """
    bone, region = _regions(target, weights)
    _, of_source = _regions(source, source_weights)
    areas = target.vertex_areas
    part = target.components
    count = int(region.max()) + 1
    area = np.bincount(region, areas, count)
    first = np.zeros(count, dtype=np.int64)
    first[region[::-1]] = np.arange(len(region))[::-1]
    label = of_source[surface_map.vertex]
    # The region of the source that most of the area of each region comes from.
    image = strongest(csr_array((areas, (region, label)), shape=(count, int(label.max()) + 1)))
    # Regions of one bone on one part that come from one region of the source.
    key = np.stack([bone[first], part[first], image])
    _, group = np.unique(key, axis=1, return_inverse=True)
    largest = np.zeros(int(group.max()) + 1)
    np.maximum.at(largest, group.ravel(), area)
    island = (bone[first] >= 0) & (part[first] >= 0) & (area < MAX_ISLAND * largest[group.ravel()])
    return np.where(island[region], region, -1)


def _regions(surface: Surface, weights: csr_array) -> tuple[Integers, Integers]:
    """(n,) the bone that moves each vertex most, -1 for none, and (n,) the number of its connected region."""
    weights, mesh, n = csr_array(weights), surface.working, len(surface.vertices)
    bone = np.where(np.diff(weights.indptr) > 0, strongest(weights), -1)
    edges, _ = unique_edges(surface.triangles)
    alike = edges[bone[edges[:, 0]] == bone[edges[:, 1]]]
    used = np.flatnonzero(mesh.vertex_of >= 0)
    member = np.empty(len(mesh.vertices), dtype=np.int64)
    member[mesh.vertex_of[used]] = used
    welded = np.stack([used, member[mesh.vertex_of[used]]], axis=1)  # borders that coincide
    links = np.concatenate([alike, welded[bone[welded[:, 0]] == bone[welded[:, 1]]]])
    return bone, label_groups(n, *links.T)
