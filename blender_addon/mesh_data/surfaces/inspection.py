# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about a mesh: whether it has changed, and whether anything makes matching hard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from bpy.types import Mesh

from zoomout_core.arrays import Integers

from ...jobs import compute
from ..arrays import hash_of, read_array
from ..attributes.marks import read_marks
from .surfaces import Faces, read_faces, read_positions


@dataclass(frozen=True)
class MeshFacts:
    """Facts about a mesh.

    Attributes:
        content: hash that changes when a vertex moves or faces connect other vertices, see `content_hash`.
        parts: number of loose parts; vertices at equal positions count as one.
        non_manifold_edges: number of edges with more than two faces.
        marks: labels of its marks, see `read_marks`.
    """

    content: str
    parts: int
    non_manifold_edges: int
    marks: tuple[str, ...]


def content_hash(mesh: Mesh) -> str:
    """A hash of a mesh's own vertices and faces."""
    return _content(read_positions(mesh), read_faces(mesh))


async def inspect_mesh(mesh: Mesh) -> MeshFacts:
    """Inspect a mesh; it is read at once, and may be removed during the computation."""
    positions, faces = read_positions(mesh), read_faces(mesh)
    edges = read_array(mesh.edges, "vertices", np.int32, 2)
    edge_of_corner = read_array(mesh.loops, "edge_index", np.int32)
    marks = tuple(attribute.name for attribute in read_marks(mesh))

    def collect_facts() -> MeshFacts:
        faces_at_edge = np.bincount(edge_of_corner, minlength=len(edges))
        parts = _count_parts(positions, edges[faces_at_edge > 0])
        return MeshFacts(_content(positions, faces), parts, int((faces_at_edge > 2).sum()), marks)

    return await compute(collect_facts)


def _content(positions: np.ndarray, faces: Faces) -> str:
    return hash_of("", positions, faces.start, faces.corner_vertex)


def _count_parts(positions: np.ndarray, edges: Integers) -> int:
    """Number of parts that edges (e, 2) form; if there are several, vertices at equal positions are merged."""
    count = _count_components(len(positions), edges)
    if count < 2:
        return count
    _, place = np.unique(positions + np.float32(0), axis=0, return_inverse=True)  # turns -0 into 0
    return _count_components(len(positions), place.reshape(-1)[edges])


def _count_components(n: int, edges: Integers) -> int:
    used = np.unique(edges)
    graph = scipy.sparse.coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(n, n))
    return int(scipy.sparse.csgraph.connected_components(graph, directed=False)[0]) - (n - len(used))
