# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies of blended limbs and ellipsoids, as a signed distance field and as a mesh of quads.

The distance functions and the smooth minimum are Inigo Quilez's ("Distance functions", "Smooth minimum").
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.sparse import coo_array

from zoomout_core.arrays import Booleans, Floats, Integers


@dataclass(frozen=True)
class Limb:
    """A round limb of changing thickness along a curve through at least two stations: x, y, z and radius.

    The fillet where it joins the rest has the width `blend`.
    """

    stations: tuple[tuple[float, float, float, float], ...]
    blend: float = 0.04

    def distance(self, points: Floats) -> Floats:
        """Signed distance (n,) of points (n, 3): the minimum over round cones between close stations."""
        stations = np.array(self.stations)
        if len(stations) > 2:
            curve = PchipInterpolator(np.arange(len(stations)), stations)
            stations = curve(np.linspace(0, len(stations) - 1, 3 * len(stations) - 2))
        return np.stack([_cone(points, a, b) for a, b in pairwise(stations)]).min(axis=0)

    @property
    def extent(self) -> list[Floats]:
        """Corners (3,) of boxes that contain the limb."""
        stations = np.array(self.stations)
        return [*(stations[:, :3] - stations[:, 3:]), *(stations[:, :3] + stations[:, 3:])]

    def mirrored(self) -> Limb:
        """The same limb on the other side of x = 0."""
        return replace(self, stations=tuple((-x, y, z, r) for x, y, z, r in self.stations))


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid with half axes along x, y, z; the fillet where it joins the rest has the width `blend`."""

    centre: tuple[float, float, float]
    radii: tuple[float, float, float]
    blend: float = 0.04

    def distance(self, points: Floats) -> Floats:
        """Signed distance (n,) of points (n, 3), to first order."""
        scaled = (points - self.centre) / self.radii
        size = np.linalg.norm(scaled, axis=1)
        return size * (size - 1) / np.maximum(np.linalg.norm(scaled / self.radii, axis=1), 1e-9)

    @property
    def extent(self) -> list[Floats]:
        """Corners (3,) of a box that contains the ellipsoid."""
        return [np.subtract(self.centre, self.radii), np.add(self.centre, self.radii)]

    def mirrored(self) -> Ellipsoid:
        """The same ellipsoid on the other side of x = 0."""
        x, y, z = self.centre
        return replace(self, centre=(-x, y, z))


Solid = Limb | Ellipsoid


def both_sides(solids: list[Solid]) -> list[Solid]:
    """Solids of the left side, and their mirror images."""
    return solids + [solid.mirrored() for solid in solids]


def bounds(solids: Iterable[Solid], margin: float) -> Floats:
    """(2, 3) the lowest and the highest corner of a box around solids, with a margin."""
    corners = np.array([corner for solid in solids for corner in solid.extent])
    return np.array([corners.min(axis=0) - margin, corners.max(axis=0) + margin])


def distance(points: Floats, solids: Iterable[Solid]) -> Floats:
    """Signed distance (n,) of points (n, 3) to a union of solids, filleted; negative inside."""
    total = np.full(len(points), np.inf)
    for solid in solids:
        near = solid.distance(points)
        overlap = np.maximum(solid.blend - np.abs(near - total), 0) / solid.blend
        total = np.minimum(near, total) - overlap**2 * solid.blend / 4
    return total


def surface_net(cell: float, solids: Sequence[Solid], space: Floats) -> tuple[Floats, Integers]:
    """(n, 3) vertices and (m, 4) quads, with outward normals, of the surface of a union of solids.

    Naive surface nets (Gibson, Constrained elastic surface nets, 1998): a vertex in each grid cell that the surface
    passes, a quad around each grid edge that it crosses. The vertices are then smoothed and moved back onto the surface
    in turn. Cells are about as long as an edge; the space (2, 3) is a box around the solids, with a margin.
    """
    inside, origin = _occupancy(cell, solids, space)
    windows = np.lib.stride_tricks.sliding_window_view(inside, (2, 2, 2))
    crossed = windows.any(axis=(3, 4, 5)) & ~windows.all(axis=(3, 4, 5))
    number = np.full(crossed.shape, -1)
    number[crossed] = np.arange(np.count_nonzero(crossed))
    vertices = origin + cell * (np.argwhere(crossed) + 0.5)

    quads = []
    for axis in range(3):
        side, up = np.roll(np.eye(3, dtype=int), -axis, axis=0)[1:]
        step = np.diff(inside.astype(np.int8), axis=axis)
        for direction in (-1, 1):
            edge = np.argwhere(step == direction)
            ring = [number[tuple((edge - offset).T)] for offset in (0 * up, up, side + up, side)]
            quads.append(np.stack(ring[::direction], axis=1))
    faces = np.concatenate(quads)
    return _relax(vertices, faces, solids), faces


def _cone(points: Floats, start: Floats, end: Floats) -> Floats:
    """Signed distance (n,) to the hull of two spheres, each given by x, y, z and radius."""
    axis = end[:3] - start[:3]
    length = np.linalg.norm(axis)
    offset = points - start[:3]
    along = offset @ (axis / length)
    across = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - along**2, 0))
    sine = (start[3] - end[3]) / length
    cosine = np.sqrt(1 - sine**2)
    # Where the flank's normal through the point meets the axis; beyond its ends the spheres are nearest.
    foot = np.clip(along - across * sine / cosine, 0, length)
    return np.hypot(along - foot, across) - start[3] - (end[3] - start[3]) * foot / length


def _occupancy(cell: float, solids: Sequence[Solid], space: Floats) -> tuple[Booleans, Floats]:
    """Which points of a fine grid are inside the solids, and the position of the first point.

    Distances are computed on a coarse grid first. Distances of fine points are computed only near the surface; the
    others take the side of the nearest coarse point.
    """
    coarse = 5
    shape = np.ceil((space[1] - space[0]) / (cell * coarse)).astype(int) + 1
    grid = space[0] + cell * coarse * np.moveaxis(np.indices(shape), 0, -1)
    around = distance(grid.reshape(-1, 3), solids).reshape(shape)
    inside = np.kron(around < 0, np.ones((coarse,) * 3, dtype=bool))
    block = np.indices((coarse,) * 3).reshape(3, -1).T
    near = np.argwhere(np.abs(around) < 2 * coarse * cell)
    fine = (near[:, None] * coarse + block).reshape(-1, 3)
    origin = space[0] - cell * (coarse // 2)
    inside[tuple(fine.T)] = distance(origin + cell * fine, solids) < 0
    return inside, origin


def _relax(vertices: Floats, faces: Integers, solids: Sequence[Solid]) -> Floats:
    """Move vertices to the mean of their neighbours, then back onto the surface, for some rounds."""
    n = len(vertices)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    adjacent = coo_array((np.ones(len(start)), (start, end)), shape=(n, n)).tocsr()
    count = np.asarray(adjacent.sum(axis=1), dtype=np.float64)[:, None]
    for _ in range(6):  # more hardly even out the quads
        vertices = _on_surface(adjacent @ vertices / count, solids)
    return _on_surface(vertices, solids)


def _on_surface(points: Floats, solids: Sequence[Solid], step: float = 1e-4) -> Floats:
    """One Newton step of points (n, 3) onto the surface, with the gradient by finite differences."""
    here = distance(points, solids)
    slope = np.stack([(distance(points + offset, solids) - here) / step for offset in step * np.eye(3)], axis=1)
    return points - (here / np.maximum(np.einsum("ij,ij->i", slope, slope), 0.1))[:, None] * slope
