# SPDX-License-Identifier: GPL-3.0-or-later
"""A coarse copy of a mesh, on which long-range deformations are computed in a fraction of the time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers, row_norms
from zoomout_core.geometry.embedded_surface import Neighbourhoods, project_to_embedding
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.triangles import have_three_corners


@dataclass(frozen=True, eq=False)
class Coarsening:
    """A decimated copy of a mesh, whose vertices are some of the mesh's."""

    vertices: Integers  # (c,) vertices of the mesh
    triangles: Integers  # (m, 3) triangles on these
    found: Integers  # (f,) the mesh's vertices that have a place on the copy: no small component that vanished
    triangle: Integers  # (f,) the triangle of each place
    barycentric: Floats  # (f, 3) the place in it

    @classmethod
    def of(cls, vertices: Floats, triangles: Integers, count: int) -> Coarsening:
        """Decimate a mesh of consistently wound triangles (m, 3) on vertices (n, 3) to about `count` vertices.

        The place of a vertex is the closest point near the vertex that it was merged into, so that vertices of touching
        limbs stay on their own limb.
        """
        points, coarse, merged = decimate(vertices, triangles, count)
        # Each group of merged vertices is represented by the one nearest to their new position.
        order = np.lexsort((row_norms(vertices - points[merged]), merged))
        groups, first = np.unique(merged[order], return_index=True)
        nearest = np.full(len(points), -1)
        nearest[groups] = order[first]
        coarse = coarse[have_three_corners(coarse) & (nearest[coarse] >= 0).all(axis=1)]
        used = np.unique(coarse)
        number = np.full(len(points), -1)
        number[used] = np.arange(len(used))
        coarse, chosen, merged = number[coarse], nearest[used], number[merged]
        found = np.flatnonzero(merged >= 0)
        around = Neighbourhoods(coarse, len(chosen), edges=0)
        return cls(
            chosen, coarse, found, *project_to_embedding(vertices[found], vertices[chosen], around, merged[found])
        )

    def lift(self, rest: Floats, moved: Floats, linear: Floats, elsewhere: Floats) -> Floats:
        """(n, 3) positions of vertices (n, 3) that move with their places on the copy.

        Args:
            rest: (n, 3) the mesh at rest.
            moved: (c, 3) positions of the copy's vertices.
            linear: (c, 3, 3) rotations and scales there.
            elsewhere: (n, 3) positions of vertices without a place.
        """
        corners = self.triangles[self.triangle]
        off = rest[self.found, None] - rest[self.vertices[corners]]
        bent = moved[corners] + np.einsum("fcij,fcj->fci", linear[corners], off)
        lifted = elsewhere.copy()
        lifted[self.found] = np.einsum("fc,fcx->fx", self.barycentric, bent)
        return lifted
