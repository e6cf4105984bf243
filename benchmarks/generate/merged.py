# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets whose targets are merged where parts touch, such as a hand and a hip, as in scans and voxel models.

The union in a voxel grid joins parts that are separate on the source, as in TOPKIDS (Laehner et al. 2016).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.sparse.csgraph import dijkstra
from tqdm import tqdm

from benchmarks.datasets import pair_names
from zoomout_core.arrays import Integers
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, vertex_normals
from zoomout_core.mesh.voxel_remesh import voxel_remesh

from .folder import Pair, class_of, standing_for, write_set
from .partial import load_whole

# Voxels along the longest extent: the finest grid that merges parts is used. In coarser ones, hands become lumps.
RESOLUTIONS = (100, 80, 60)
# Depth of the hull in voxels, at which its area is that of the surface.
INSET = 0.5
# Parts are merged if the shortest path between two of PROBES vertices becomes shorter by more than this, at unit area:
# half of the way from a hand to the hip.
PROBES, SHORTCUT = 150, 0.3


def write_merged(output: Path, data: Iterable[Path], seed: int, count: int) -> None:
    """Write pairs of a merged mesh and a whole one of another pose.

    Args:
        output: folder of the set.
        data: folders of sets with `pairs.txt` and `correspondence.npz`; pairs whose target does not merge are left out.
        seed: for the order in which pairs are tried.
        count: number of pairs for each class, as far as there are.
    """
    meshes: dict[str, Surface] = {}
    correspondence: dict[str, Integers] = {}
    pairs: list[Pair] = []
    for folder in data:
        found: Counter[str] = Counter()
        unions: dict[str, Surface | None] = {}
        listed = pair_names(folder, None)
        order = np.random.default_rng([seed, *folder.name.encode()]).permutation(len(listed))
        for first, second in tqdm([listed[i] for i in order], desc=folder.name, leave=False):
            if found[class_of(first)] == count:
                continue
            whole, source = load_whole(folder, first), load_whole(folder, second)
            if first not in unions:
                unions[first] = merge(whole.surface)
            union = unions[first]
            if union is None:
                continue
            surface, places = whole.surface, whole.places
            normals = vertex_normals(surface.vertices, surface.triangles)[places]
            vertex = standing_for(surface.vertices[places], normals, union)
            known = vertex >= 0  # the others are inside
            name = f"{first}_{second}_merged"
            meshes |= {name: union, f"{name}_whole": source.surface}
            correspondence |= {name: vertex[known], f"{name}_whole": source.places[known]}
            pairs.append((name, f"{name}_whole"))
            found[class_of(first)] += 1
    write_set(output, meshes, correspondence, pairs)


def merge(surface: Surface) -> Surface | None:
    """The union of a closed surface with itself, where parts closer than a voxel merge; None if none are."""
    for resolution in RESOLUTIONS:
        vertices, triangles = voxel_remesh(surface.vertices, surface.triangles, resolution, INSET)
        if len(vertices) > len(surface.vertices):
            vertices, triangles, _ = decimate(vertices, triangles, len(surface.vertices))
        union = Surface(vertices, triangles)
        if _shortcut(surface, union) > SHORTCUT:
            return union
    return None


def _shortcut(surface: Surface, union: Surface) -> float:
    """How much shorter paths are on a union, at unit area: the largest difference between some of the vertices.

    The number of handles tells less, as a hull of voxels also has handles of a voxel.
    """
    rows = np.unique(np.linspace(0, len(surface.vertices) - 1, PROBES).astype(int))
    normals = vertex_normals(surface.vertices, surface.triangles)
    vertex = standing_for(surface.vertices[rows], normals[rows], union)
    rows, vertex = rows[vertex >= 0], vertex[vertex >= 0]
    before, after = (
        dijkstra(edge_graph(mesh.vertices, mesh.triangles), indices=at)[:, at]
        for mesh, at in ((surface, rows), (union, vertex))
    )
    return float((before - after).max() / np.sqrt(surface.area))
