# SPDX-License-Identifier: GPL-3.0-or-later
"""A UV map as charts: the surface cut open at its seams, and the resulting islands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import inner_products
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.transfer.cut_mesh import CUT_TOLERANCE, CutSurface, adjacent_edges, are_joined, cut_surface

# Maximum slope of UVs that are continued beyond a border, relative to the mean of their island.
MAX_SLOPE = 4.0


@dataclass(frozen=True, eq=False)
class Chart:
    """A UV map of the source, cut at its seams."""

    cut: CutSurface  # the source, cut open
    uv: Floats  # (c, 2) values at its corners
    density: Floats  # (islands,) mean UV length per unit of length
    lower: Floats  # (islands, 2) lower bounds of each island's UDIM tile, infinite where it spans several
    upper: Floats  # (islands, 2) upper bounds of the same

    def at(self, triangle: Integers, barycentric: Floats) -> Floats:
        """(q, 2) UVs at points of the source."""
        return np.einsum("qc,qcx->qx", barycentric, self.uv[self.cut.surface.triangle_corners[triangle]])

    def beyond(self, triangle: Integers, barycentric: Floats, points: Floats) -> tuple[Floats, Floats]:
        """Continue UVs to points (q, 3) beyond an island, from the triangle closest to each.

        Returns:
            (q, 2) UVs, kept within the tile of their island, and (q, 3) barycentric coordinates that give them if they
            are within it.
        """
        surface = self.cut.surface
        a, b, c = (surface.vertices[surface.triangles[triangle, i]] for i in range(3))
        uv_a, uv_b, uv_c = (self.uv[surface.triangle_corners[triangle, i]] for i in range(3))
        ab, ac = b - a, c - a
        offset = points - np.einsum("qc,qcx->qx", barycentric, np.stack([a, b, c], axis=1))
        ob, oc, bb, bc, cc = inner_products(offset, ab, ac, axis=-1)
        determinant = bb * cc - bc * bc
        proper = determinant > 1e-12 * bb * cc
        scale = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=proper)
        along_ab, along_ac = scale * (cc * ob - bc * oc), scale * (bb * oc - bc * ob)
        step = along_ab[:, None] * (uv_b - uv_a) + along_ac[:, None] * (uv_c - uv_a)
        island = self.cut.triangle_island[triangle]
        longest = MAX_SLOPE * self.density[island] * np.linalg.norm(offset, axis=1)
        length = np.linalg.norm(step, axis=1)
        shortened = np.minimum(1, np.divide(longest, length, out=np.ones_like(length), where=length > 0))[:, None]
        continued = barycentric + shortened * np.stack([-along_ab - along_ac, along_ab, along_ac], axis=1)
        uv = self.at(triangle, barycentric) + shortened * step
        return np.clip(uv, self.lower[island], self.upper[island]), continued


def chart_of(source: Surface, uv: Floats) -> Chart:
    """Cut the source, with UVs (c, 2) at its corners, at its actual seams, and measure its islands."""
    cut = cut_surface(source, uv)
    count = int(cut.island.max()) + 1
    area = np.bincount(cut.triangle_island, triangle_areas(source.vertices, source.triangles), minlength=count)
    covered = np.bincount(cut.triangle_island, np.abs(signed_areas(uv[source.triangle_corners])), minlength=count)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, cut.island[source.corner_face], uv)
    np.maximum.at(high, cut.island[source.corner_face], uv)
    tile = np.floor(low + CUT_TOLERANCE)
    inside = high <= tile + 1 + CUT_TOLERANCE
    return Chart(
        cut=cut,
        uv=uv,
        density=np.sqrt(np.divide(covered, area, out=np.zeros(count), where=area > 0)),
        lower=np.where(inside, np.minimum(tile, low), -np.inf),
        upper=np.where(inside, np.maximum(tile + 1, high), np.inf),
    )


def uv_seams(surface: Surface, uv: Floats) -> Booleans:
    """(e,) the edges of a surface at which its atlas (c, 2) is cut open, without the surface's borders."""
    first, second = adjacent_edges(surface)
    apart = ~are_joined(uv, first, second)
    ends = np.sort(surface.corner_vertex[np.concatenate([first[apart], second[apart]])], axis=1)
    low, high = np.sort(surface.edges, axis=1).T
    n = len(surface.vertices)
    return np.isin(low * n + high, ends[:, 0] * n + ends[:, 1])


def signed_areas(uv: Floats) -> Floats:
    """(m,) areas of UV triangles (m, 3, 2), negative where wound clockwise."""
    ab, ac = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return np.asarray(0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]), dtype=np.float64)
