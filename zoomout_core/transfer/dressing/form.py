# SPDX-License-Identifier: GPL-3.0-or-later
"""The form of a worn object, at unit area of the body that wears it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from zoomout_core.arrays import Floats, Integers, segment_sum
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.shapes import place_unused
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.spectral.laplacian import mesh_laplacian

# Minimum length of a line, as a share of the longest one.
SHORTEST = 1e-6


class Lines:
    """Points connected by lines, such as strands of hair.

    Args:
        vertices: (n, 3) positions.
        edges: (e, 2) vertex numbers.

    Raises:
        MeshError: there are no points, coordinates are not finite, or numbers are out of range.

    Example:
        >>> strand = zo.Lines(source.vertices[:3], [(0, 1), (1, 2)])
        >>> len(strand.vertices)
        3
    """

    def __init__(self, vertices: ArrayLike, edges: ArrayLike) -> None:
        self.vertices: Floats = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
        self.edges: Integers = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
        if not len(self.vertices):
            raise MeshError("The lines have no points: leave them out.")
        if not np.isfinite(self.vertices).all():
            raise MeshError("Some points of the lines have coordinates that are not finite: remove them.")
        if self.edges.size and not (self.edges.min() >= 0 and self.edges.max() < len(self.vertices)):
            raise MeshError(
                "An edge of the lines has no point among the {count}: correct the edges.", count=len(self.vertices)
            )


@dataclass(frozen=True, eq=False)
class Form:
    """The form of a worn object."""

    places: Floats  # (n_v, 3) its vertices
    number: Integers  # (n_v,) the point of each vertex, -1 for an unconnected one
    rest: Floats  # (n, 3) its points: vertices of a surface, merged at coincident borders
    stiffness: csc_array  # (n, n) stiffness of their connections; rows sum to zero
    areas: Floats  # (n,) areas of the points; lengths for lines
    triangles: Integers  # (m, 3) triangles between them; none for lines
    component: Integers  # (n,) the number of each point's connected component
    keep: Floats  # (n,) weight with which each point keeps its place in the form around it, in [0, 1]

    @classmethod
    def of(cls, worn: Surface | Lines, unit: float, keep: Floats | None = None) -> Form:
        """Make the form of a surface or of lines, in a unit, with a mask (n_v,) of its vertices; zero if not given."""
        places = worn.vertices / unit
        mask = np.zeros(len(places)) if keep is None else keep
        if isinstance(worn, Lines):
            return cls(places, np.arange(len(places)), places, *_of_lines(places, worn.edges), mask)
        working = worn.working
        stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
        rest, areas = working.to_surface(working.vertices) / unit, areas * worn.area / unit**2
        corners, component = working.oriented_triangles, working.component
        number, of_points = working.vertex_of, np.zeros(len(rest))
        np.maximum.at(of_points, number[number >= 0], mask[number >= 0])
        return cls(places, number, rest, csc_array(stiffness), areas, corners, component, of_points)

    @property
    def first(self) -> Integers:
        """(n,) the first vertex of each point."""
        vertices = np.empty(len(self.rest), dtype=np.int64)
        used = np.flatnonzero(self.number >= 0)[::-1]
        vertices[self.number[used]] = used
        return vertices

    def between(self, chosen: Integers) -> Integers:
        """(m, 3) the triangles between chosen points."""
        return self.triangles[np.isin(self.triangles, chosen).all(axis=1)]

    def probes(self, chosen: Integers, fine: float) -> csr_array:
        """(p, n) matrix that maps positions to the places to test.

        These are the chosen points, the midpoints of edges between them that are longer than `fine`, and the centres of
        triangles with such an edge.
        """
        n, triangles = len(self.rest), self.between(chosen)
        edges, edge_of = unique_edges(triangles)
        is_long = np.linalg.norm(self.rest[edges[:, 0]] - self.rest[edges[:, 1]], axis=1) > fine
        edges, triangles = edges[is_long], triangles[is_long[edge_of].any(axis=1)]
        columns = [chosen, edges.ravel(), triangles.ravel()]
        counts = np.repeat([1, 2, 3], [len(chosen), len(edges), len(triangles)])
        rows = np.repeat(np.arange(len(counts)), counts)
        shares = np.repeat([1, 1 / 2, 1 / 3], [len(each) for each in columns])
        return csr_array((shares, (rows, np.concatenate(columns))), shape=(len(counts), n))


def place_worn(worn: Sequence[Surface | Lines]) -> list[Surface | Lines]:
    """Worn objects without unusable positions of vertices that no face uses, see `place_unused`."""
    return [place_unused(each) if isinstance(each, Surface) else each for each in worn]


def read_masks(worn: Sequence[Surface | Lines], keep: Sequence[ArrayLike | None] | None) -> list[Floats | None]:
    """For each object the weights (n_v,) of its vertices that keep their form; None without any.

    Raises:
        ValueError: their number or a length does not match the objects, or some are not in [0, 1].
    """
    if keep is None:
        return [None] * len(worn)
    if len(keep) != len(worn):
        raise ValueError(f"keep has {len(keep)} masks: give one, or None, for each of the {len(worn)} objects.")
    masks = [None if mask is None else np.asarray(mask, dtype=np.float64) for mask in keep]
    for each, mask in zip(worn, masks, strict=True):
        if mask is not None and (mask.shape != each.vertices.shape[:1] or not ((mask >= 0) & (mask <= 1)).all()):
            raise ValueError(
                f"a mask in keep has the shape {mask.shape}, or numbers out of range: give ({len(each.vertices)},) "
                "numbers from 0 to 1."
            )
    return masks


def _of_lines(places: Floats, edges: Integers) -> tuple[csc_array, Floats, Integers, Integers]:
    """Stiffness, lengths, triangles and components of lines."""
    n = len(places)
    length = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)
    length = np.maximum(length, max(SHORTEST * length.max(initial=0), SMALLEST))
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    weights = csc_array((np.tile(1 / length, 2), (rows, columns)), shape=(n, n))
    of_points = segment_sum(np.tile(length / 2, 2), rows, n)
    # A point without a line has the same weight as the others.
    of_points = np.where(of_points > 0, of_points, of_points[of_points > 0].mean() if len(edges) else 1.0)
    component = connected_components(weights, directed=False)[1]
    stiffness = csc_array(diags_array(weights.sum(axis=0)) - weights)
    return stiffness, of_points, np.zeros((0, 3), dtype=np.int64), component.astype(np.int64)
