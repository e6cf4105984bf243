# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of a whole from which a small part, such as a hand, may have been cut.

Samples of the whole are too coarse for a hand. Each region has the size of the part and is analysed on the mesh of the
whole. Both are compared in a unit in which the part has a typical area.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale, unlikeness
from zoomout_core.matching.partial.landmark_search import landmarks_of
from zoomout_core.matching.partial.part_registration import RegisteredPart
from zoomout_core.matching.preparation.analysis import ANALYSIS, ShapeAnalysis, analyse
from zoomout_core.matching.registration.correspondences import Surroundings
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class RegionTuning(Tuning, set_by="small_parts"):
    """The size of small parts, and the regions of a whole in which they are searched."""

    # Area of a part, relative to that of the whole, below which regions are searched for it. Hands have 1 to 2 %, feet
    # 2 to 5 %. Heads and arms, 6 to 10 %, are found without regions as well.
    small: float = tuned(0.07, "1", 0, 1)
    part_area: float = tuned(0.4, "area", 0.01, 1)  # area of the part in the unit in which it is compared with a region
    max_count: int = tuned(6, "regions", 1, 1000)  # maximum number of regions
    # Distance between the centres of regions, relative to the extent of the part: the largest distance from its tip,
    # the landmark farthest from cuts.
    apart: float = tuned(0.7, "1", 0.1, 10)
    radius: float = tuned(1.35, "1", 1, 10)  # radius of a region, relative to that extent
    vertices: int = tuned(3000, "vertices", 100, 100_000)  # approximate maximum size of a region's proxy
    functions: int = tuned(10, "eigenfunctions", 2, 1000)  # of a region, which are only needed for its area
    # Weight of the certainty of the map of whole shapes, relative to that of a small part. Hands match whole bodies
    # with a certainty of up to 77 %; bodies of the size of hands match parts of others with at most 8 %.
    as_wholes: float = tuned(0.5, "1", 0, 1)


REGION = RegionTuning()


@dataclass(frozen=True, eq=False)
class Region:
    """A part, and a region of a whole in which it may be, in a separate unit."""

    part: IncompleteShape  # the part
    whole: IncompleteShape  # the region
    of_part: ShapeAnalysis  # the part in the unit of the pair
    of_whole: ShapeAnalysis  # the whole in the unit of the pair
    vertex: Integers | None = None  # (n,) nearest in the whole's mesh to each of the region's; None if equal

    @classmethod
    def everywhere(cls, part: IncompleteShape, whole: IncompleteShape) -> Region:
        """All of the whole, in the pair's own unit."""
        return cls(part, whole, part.shape, whole.shape)

    @cached_property
    def unlike(self) -> Floats:
        """(d_p, d_r) `unlikeness` of the part's places and the region's."""
        return unlikeness(self.part, self.whole)

    @property
    def is_everywhere(self) -> bool:
        """Whether it is all of the whole."""
        return self.vertex is None

    @property
    def is_between_fragments(self) -> bool:
        """Whether large pieces may be missing on both shapes, and no smaller region of the whole is compared."""
        return self.is_everywhere and self.part.is_fragment and self.whole.is_fragment

    @property
    def unit(self) -> float:
        """Its unit of length, in that of the pair."""
        return self.part.shape.proxy.full.scale / self.of_part.proxy.full.scale

    @property
    def contains(self) -> Booleans:
        """(n,) which vertices of the whole's mesh are in it."""
        inside = np.zeros(len(self.of_whole.mesh.vertices), dtype=bool)
        inside[slice(None) if self.vertex is None else self.vertex] = True
        return inside

    def in_space(self, places: Integers) -> Floats:
        """(q, 3) positions of places (q,) of the region, in the unit of the pair."""
        region = self.whole.shape
        points = region.mesh.vertices[region.search.samples[places]]
        return points if self.vertex is None else self._in_pair(points)

    def _in_pair(self, points: Floats) -> Floats:
        """(q, 3) points given in the frame of the region, in that of the whole in the pair."""
        return self.of_whole.proxy.from_surface(self.whole.shape.proxy.to_surface(points))

    def to_whole(self, registered: RegisteredPart) -> RegisteredPart:
        """A part that is bent onto the region, bent onto the whole, on the meshes and in the unit of the pair."""
        if self.vertex is None:
            return registered
        positions = self._in_pair(registered.positions)
        near = self.vertex[registered.closest.vertex]
        mesh = self.of_whole.mesh
        closest = SurfaceMap(*Surroundings.of(self.of_whole).surface.closest(positions, near), mesh.triangles)
        return replace(registered, positions=positions, closest=closest, residual=registered.residual * self.unit)


def is_small(part: ShapeAnalysis, whole: ShapeAnalysis) -> bool:
    """Whether to search for a part, in one unit with the whole, in regions."""
    return bool(part.basis.areas.sum() < REGION.small * whole.basis.areas.sum())


def find_regions(part: ShapeAnalysis, whole: ShapeAnalysis) -> list[Region]:
    """Regions of a whole in which a small part, in the same unit, may be, the most promising first."""
    scale = np.sqrt(REGION.part_area / part.basis.areas.sum())
    here, there = (IncompleteShape(at_scale(each, scale)) for each in (part, whole))
    tip = landmarks_of(here, 1)[0]
    extent = here.between[tip].max()
    chosen: list[int] = []
    for place in np.argsort(unlikeness(here, there)[tip], kind="stable"):
        if len(chosen) < REGION.max_count and (there.between[place, chosen] >= REGION.apart * extent).all():
            chosen.append(int(place))
    inside = there.shape.distances[chosen] < REGION.radius * extent
    inside = inside[[bool(each[whole.mesh.triangles].all(axis=1).any()) for each in inside]]
    return for_each(lambda each: _region(here, there, part, whole, each), list(inside))


def _region(
    part: IncompleteShape, whole: IncompleteShape, of_part: ShapeAnalysis, of_whole: ShapeAnalysis, inside: Booleans
) -> Region:
    """The region of some vertices (n,) of the whole's mesh."""
    proxy = of_whole.proxy
    mesh, vertices = proxy.full.piece(inside[proxy.merged])
    shape = analyse(mesh, REGION.functions, ANALYSIS.distance_samples, 0, REGION.vertices)
    region = IncompleteShape(at_scale(shape, mesh.scale / whole.shape.proxy.full.scale))
    return Region(part, region, of_part, of_whole, proxy.merged[vertices[shape.proxy.full_vertex]])
