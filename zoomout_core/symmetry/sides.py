# SPDX-License-Identifier: GPL-3.0-or-later
"""The two sides of a mirror symmetry, and the line between them.

Every place left of the line is closer to any other place on the left than to that place's mirror image, because the
part of a path beyond the line can be reflected without making it longer. So differences of geodesic distances
distinguish the sides, and change sign on the line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from zoomout_core.arrays import Booleans, Floats, Integers
    from zoomout_core.maps.surface_map import SurfaceMap
    from zoomout_core.matching.preparation.analysis import ShapeAnalysis
    from zoomout_core.mesh.surface import Surface

# Gaussian width, at unit area, over which samples vote on the side of a vertex.
VOTING_WIDTH = 0.1
# Diffusion length, at unit area, for smoothing the signed distance, so that the line does not follow the map's noise.
SMOOTHING_WIDTH = 0.02
# Share of the differences of distances that may contradict a division into two sides.
MAX_CONTRADICTION = 0.2
# A shell is on one side if that side's area exceeds the other's by a larger share of the shell's area than this.
MIN_ONE_SIDED_SHARE = 0.5
# Distance from the line, relative to the square root of the area, over which a split of displacements fades from one
# side to the other.
BLEND = 0.05


@dataclass(frozen=True, eq=False)
class Line:
    """The zero set of a function on a surface."""

    edges: Integers  # (p, 2) vertices of the edge that contains each point
    points: Floats  # (p, 3) on the surface's edges
    segments: Integers  # (s, 2) numbers of points that are connected across a triangle

    @property
    def polylines(self) -> list[Integers]:
        """The connected curves as point numbers in order; a closed curve ends with its first point."""
        beside: dict[int, list[int]] = {}
        for a, b in self.segments.tolist():
            beside.setdefault(a, []).append(b)
            beside.setdefault(b, []).append(a)
        curves = []
        # Open curves first, from their ends.
        for start in sorted(beside, key=lambda point: len(beside[point]) != 1):
            curve = [start]
            while beside[curve[-1]]:
                following = beside[curve[-1]].pop()
                beside[following].remove(curve[-1])
                curve.append(following)
            if len(curve) > 1:
                curves.append(np.array(curve))
        return curves


def signed_distance(there: SurfaceMap, shape: ShapeAnalysis) -> Floats | None:
    """(n,) distance along the surface of each vertex from the line of a mirror symmetry, positive on one side.

    The symmetry is a map of the shape's mesh, and distances are at unit area. Near the line they are half the distance
    between a vertex and its image. Beyond about a tenth of the square root of the area they are about constant. None if
    the symmetry does not divide the surface in two.
    """
    here = shape.distances.T
    images = there.interpolate(here)
    nearer = images - here  # (n, d) how much closer each vertex is to each sample than its image is
    samples = shape.sampled.samples[: len(shape.distances)]
    mutual = nearer[samples]
    mutual = (mutual + mutual.T) / 2
    side_of_sample = np.sign(np.linalg.eigh(mutual)[1][:, -1])
    agreement = side_of_sample @ mutual @ side_of_sample / max(np.abs(mutual).sum(), 1e-300)
    if agreement < 1 - 2 * MAX_CONTRADICTION:
        return None
    closest = np.minimum(here, images)
    weights = np.exp(-(((closest - closest.min(axis=1, keepdims=True)) / VOTING_WIDTH) ** 2))
    distance = (weights * nearer * side_of_sample).sum(axis=1) / weights.sum(axis=1) / 2
    antisymmetric = (distance - there.interpolate(distance)) / 2
    return shape.basis.smoothed(antisymmetric[:, None], SMOOTHING_WIDTH**2)[:, 0]


def on_whole_surface(on_mesh: Floats, surface_map: SurfaceMap, shape: ShapeAnalysis, surface: Surface) -> Floats:
    """(n,) the signed distance of all vertices of a surface from the line, in the surface's unit.

    The distance `on_mesh` (n_mesh,) is that of the shape, its main part or the hull around it, at unit area. Loose
    parts are on the side of the nearby body: paired parts as a whole, self-paired ones vertex by vertex.
    """
    full = shape.proxy.full
    inside = full.vertex_of >= 0
    distance = np.zeros(len(surface.vertices))
    distance[inside] = full.scale * shape.proxy.place.interpolate(on_mesh)[full.vertex_of[inside]]
    if full.is_hull:
        return _of_shells(distance, surface_map, surface)
    loose = np.flatnonzero(~inside & (surface.components > 0))
    if len(loose):
        body = np.flatnonzero(inside)
        near = body[scipy.spatial.cKDTree(surface.vertices[body]).query(surface.vertices[loose])[1]]
        apart = np.linalg.norm(surface.vertices[loose] - surface_map.interpolate(surface.vertices)[loose], axis=1)
        side = np.sign(distance[near])
        component = surface.components[loose]
        elsewhere = surface.components[surface_map.vertex[loose]] != component
        if elsewhere.any():
            side[elsewhere] = np.sign(np.bincount(component[elsewhere], distance[near[elsewhere]]))[
                component[elsewhere]
            ]
        distance[loose] = side * apart / 2
    return distance


def _of_shells(around: Floats, surface_map: SurfaceMap, surface: Surface) -> Floats:
    """(n,) signed distances of the vertices of shells, from those of the hull around them (n,); opposite at images.

    A shell that is mapped to others and is mostly on one side is assigned to that side as a whole.
    """
    distance = (around - surface_map.interpolate(around)) / 2
    component, mass = surface.components, surface.vertex_areas
    used = component >= 0
    elsewhere = component[surface_map.vertex] != component
    area, gone, lean = (
        np.bincount(component[used], (mass * share)[used]) for share in (1.0, elsewhere, np.sign(distance))
    )
    whole = (gone > area / 2) & (np.abs(lean) > MIN_ONE_SIDED_SHARE * area)
    moved = used & whole[component]
    distance[moved] = np.sign(lean)[component[moved]] * np.abs(distance[moved])
    return distance


def leftward(distance: Floats, surface_map: SurfaceMap, surface: Surface, left: Floats) -> float:
    """How consistently places on the positive side are left of their images: 1 if all are, -1 if all are right of them.

    The sign of the distance (n,) from the line distinguishes the sides; `left` (3,) is a unit vector.
    """
    mass = surface.vertex_areas
    used = mass > 0
    offset = (surface.vertices - surface_map.interpolate(surface.vertices))[used]
    share = mass[used] * np.sign(distance[used])
    return float(share @ (offset @ left)) / max(float(mass[used] @ np.linalg.norm(offset, axis=1)), 1e-300)


def zero_line(values: Floats, surface: Surface) -> Line:
    """The line where a function (n,) on a surface's vertices, linear on triangles, changes sign."""
    triangles = surface.triangles
    positive: Booleans = values > 0
    crossed = triangles[(positive[triangles].sum(axis=1) % 3) > 0]
    sides = np.stack([crossed, np.roll(crossed, -1, axis=1)], axis=2)  # (c, 3, 2)
    cut = positive[sides[..., 0]] != positive[sides[..., 1]]
    ends = np.sort(sides[cut], axis=1)  # two cut sides of each triangle, one after the other
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    a, b = values[edges].T
    share = (a / (a - b))[:, None]
    points = (1 - share) * surface.vertices[edges[:, 0]] + share * surface.vertices[edges[:, 1]]
    return Line(edges.reshape(-1, 2), points.reshape(-1, 3), number.reshape(-1, 2))
