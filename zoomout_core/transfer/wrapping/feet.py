# SPDX-License-Identifier: GPL-3.0-or-later
"""Where vertices of the target that is being wrapped belong on the source: their feet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.transfer.frames import on_working_mesh
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FeetTuning(Tuning, set_by="wrap"):
    """How feet are sought, and how much they count.

    Attributes:
        normal_weight: the distance that counts as much as normals that differ by a unit vector.
        robust_scale: of the weight 1 / (1 + (r / scale)^2)^2 of a foot at distance r (Geman and McClure 1987).
        most_points: vertices of the source that draw what is nearest to them, at most.
        facing: cosine of the angle between normals from which on a vertex goes all the way onto its foot.
    """

    normal_weight: float = tuned(0.03, "at unit area", 0, 10)
    robust_scale: float = tuned(0.1, "at unit area", 1e-6, 10)
    most_points: int = tuned(20_000, "points", 0, 10_000_000)
    facing: float = tuned(0.5, "1", 1e-6, 1)


FEET = FeetTuning()


class Feet:
    """The feet of the vertices of the target's working mesh, n in number, in the beginning where the map sends them.

    Positions are at unit area of the source.

    Args:
        mapped: the target on the source.
        given: (n_s,) which vertices of the source have something on the target.

    Attributes:
        images: (n, 3) where the map sends the vertices.
        places: (n, 3) where their feet are.
        triangle: (n,) the source's triangle that holds each foot.
        outwards: (n,) 1 where normals of the source and of the target, as the map turns it, agree, else -1.
    """

    def __init__(self, mapped: MappedTarget, given: Booleans, turned_normals: Floats) -> None:
        working, self._surface = mapped.target.working, mapped.whole
        source = mapped.source
        self._unit = float(np.sqrt(source.area))
        self._vertices = source.vertices / self._unit
        self._triangles, self._corners = source.triangles, working.oriented_triangles
        self._normals = source.working.vertex_normals[source.working.vertex_of]
        self._given = np.flatnonzero(given & (source.working.vertex_of >= 0))
        step = max(1, -(-len(self._given) // max(1, FEET.most_points)))
        self._given = self._given[::step]
        flipped = np.zeros(len(source.triangles), dtype=bool)
        flipped[source.working.triangle_of[source.working.flipped]] = True
        self._flipped = flipped
        self.triangle, self._barycentric = (
            on_working_mesh(working, each) for each in (mapped.surface_map.triangle, mapped.surface_map.barycentric)
        )
        self.images = on_working_mesh(working, mapped.points) / self._unit
        self.places = self.images
        agreement = np.einsum("nx,nx->n", turned_normals, self.normals)
        component = np.bincount(working.component, agreement)
        self.outwards = np.where(component < 0, -1.0, 1.0)[working.component]

    @property
    def normals(self) -> Floats:
        """(n, 3) unit normals of the source at the feet."""
        return unit_vectors(self._interpolated(self._normals))

    def walk(self, positions: Floats, some: Integers | slice = slice(None)) -> None:
        """Move the feet of some vertices (s,) to where the source is closest to positions (s, 3), along its surface."""
        self._put(*self._surface.walk(self.triangle[some], self._unit * positions)[:2], some)

    def jump(self, positions: Floats) -> None:
        """Move the feet to where the source is closest to positions (n, 3), next to normals that agree."""
        self._put(*self._search.closest(positions, self._outward_normals(positions))[:2])

    def drawn(self, positions: Floats, image_pull: Floats) -> Floats:
        """(n, 3) where vertices at positions (n, 3) are drawn.

        That is to their feet and to what of the source they are nearest to, as far as these lie near and face the same
        way, and to their images as far as is given (n,).
        """
        normals = self._outward_normals(positions)
        motion = self.places - positions
        weight = _agreement(motion, normals, self.normals)
        total, count = weight[:, None] * motion, np.ones(len(positions))
        if len(self._given):
            rows = [np.hstack([x, FEET.normal_weight * n]) for x, n in ((positions, normals), self._sought)]
            near = np.asarray(cKDTree(rows[0], balanced_tree=False, compact_nodes=False).query(rows[1])[1])
            motion = self._sought[0] - positions[near]
            weight = _agreement(motion, normals[near], self._sought[1])
            total += segment_sum(weight[:, None] * motion, near, len(total))
            count += segment_sum(weight, near, len(total))
        total += image_pull[:, None] * (self.images - positions)
        return np.asarray(positions + total / (count + image_pull)[:, None])

    def with_images(self, image_pull: Floats) -> Floats:
        """(n, 3) means of feet and images, which count as much as is given (n,)."""
        return np.asarray((self.places + image_pull[:, None] * self.images) / (1 + image_pull)[:, None])

    def facing(self, normals: Floats) -> Floats:
        """(n,) how far vertices with outward normals (n, 3) may go onto their feet, in [0, 1]."""
        return np.clip(np.einsum("nx,nx->n", normals, self.normals) / FEET.facing, 0, 1)

    def _outward_normals(self, positions: Floats) -> Floats:
        return self.outwards[:, None] * vertex_normals(positions, self._corners)

    @cached_property
    def _sought(self) -> tuple[Floats, Floats]:
        """(g, 3) vertices of the source that draw what is nearest to them, and (g, 3) their normals."""
        return self._vertices[self._given], self._normals[self._given]

    @cached_property
    def _search(self) -> OrientedSurface:
        return OrientedSurface(self._vertices, self._triangles, self._flipped, FEET.normal_weight)

    def _put(self, triangle: Integers, barycentric: Floats, some: Integers | slice = slice(None)) -> None:
        places = self.places.copy()
        self.triangle[some], self._barycentric[some] = triangle, barycentric
        places[some] = np.einsum("qc,qcx->qx", barycentric, self._vertices[self._triangles[triangle]])
        self.places = places

    def _interpolated(self, values: Floats) -> Floats:
        return np.asarray(np.einsum("nc,ncx->nx", self._barycentric, values[self._triangles[self.triangle]]))


def _agreement(motion: Floats, normals: Floats, others: Floats) -> Floats:
    """(q,) weights of motions (q, 3) between places with unit normals (q, 3) and (q, 3)."""
    robust = (1 + np.einsum("qx,qx->q", motion, motion) / FEET.robust_scale**2) ** -2
    return np.asarray(robust * np.clip(np.einsum("qx,qx->q", normals, others), 0, 1))
