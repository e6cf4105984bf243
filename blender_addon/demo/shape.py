# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's character, a little dragon, as a signed distance field and as quads.

Limbs and ellipsoids are blended into each other; the distance functions and the smooth minimum are Inigo
Quilez's ("Distance functions", "Smooth minimum"). Lengths are metres, the character faces -y and stands on
z = 0, and its left is +x.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.sparse import coo_array

from zoomout_core.arrays import Booleans, Floats, Integers

# The space that the character fills, with room to spare: its lowest and highest corner.
BOUNDS = np.array([[-1.0, -0.6, -0.1], [1.0, 1.1, 1.85]])


@dataclass(frozen=True)
class Limb:
    """A round limb of changing thickness along a smooth curve.

    Attributes:
        stations: x, y, z and radius at points of the curve, at least two.
        blend: width of the fillet where it joins the rest.
    """

    stations: tuple[tuple[float, float, float, float], ...]
    blend: float = 0.04

    def distance(self, points: Floats) -> Floats:
        """Signed distance (n,) of points (n, 3): the least of the cones with round ends between close stations."""
        stations = np.array(self.stations)
        if len(stations) > 2:
            curve = PchipInterpolator(np.arange(len(stations)), stations)
            stations = curve(np.linspace(0, len(stations) - 1, 3 * len(stations) - 2))
        return np.stack([_cone(points, a, b) for a, b in pairwise(stations)]).min(axis=0)

    def mirrored(self) -> Limb:
        """The same limb on the character's other side."""
        return replace(self, stations=tuple((-x, y, z, r) for x, y, z, r in self.stations))


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid.

    Attributes:
        centre: its centre.
        radii: half axes along x, y, z.
        blend: width of the fillet where it joins the rest.
    """

    centre: tuple[float, float, float]
    radii: tuple[float, float, float]
    blend: float = 0.04

    def distance(self, points: Floats) -> Floats:
        """Signed distance (n,) of points (n, 3), to first order."""
        scaled = (points - self.centre) / self.radii
        size = np.linalg.norm(scaled, axis=1)
        return size * (size - 1) / np.maximum(np.linalg.norm(scaled / self.radii, axis=1), 1e-9)

    def mirrored(self) -> Ellipsoid:
        """The same ellipsoid on the character's other side."""
        x, y, z = self.centre
        return replace(self, centre=(-x, y, z))


Solid = Limb | Ellipsoid

TORSO: list[Solid] = [
    Limb(((0, 0, 1.08, 0.09), (0, 0, 0.88, 0.12)), blend=0.08),
    Ellipsoid((0, 0, 0.82), (0.16, 0.13, 0.15), blend=0.08),
    Ellipsoid((0, -0.02, 0.60), (0.21, 0.19, 0.22), blend=0.1),
]
HEAD: list[Solid] = [
    Ellipsoid((0, -0.02, 1.23), (0.25, 0.22, 0.205), blend=0.04),
    Ellipsoid((0, -0.22, 1.15), (0.135, 0.15, 0.10), blend=0.07),  # muzzle
]
EYE_LEFT = Ellipsoid((0.115, -0.165, 1.30), (0.08, 0.065, 0.09), blend=0.012)
NOSTRIL_LEFT = Ellipsoid((0.05, -0.34, 1.185), (0.028, 0.028, 0.02), blend=0.02)
HEAD_LEFT: list[Solid] = [
    EYE_LEFT,
    NOSTRIL_LEFT,
    Ellipsoid((0.17, -0.10, 1.15), (0.075, 0.075, 0.065), blend=0.06),  # cheek
    Limb(
        ((0.16, 0.03, 1.34, 0.05), (0.25, 0.05, 1.46, 0.058), (0.33, 0.075, 1.57, 0.045), (0.385, 0.09, 1.66, 0.012)),
        blend=0.05,
    ),
]
ARM_LEFT: list[Solid] = [
    Limb(((0.11, 0, 0.88, 0.085), (0.34, 0.012, 0.81, 0.06), (0.56, 0, 0.755, 0.05)), blend=0.06),
    Ellipsoid((0.635, -0.005, 0.74), (0.08, 0.048, 0.075), blend=0.03),
    Limb(((0.66, -0.01, 0.785, 0.037), (0.725, -0.02, 0.85, 0.03)), blend=0.014),
    Limb(((0.68, -0.005, 0.742, 0.038), (0.795, -0.015, 0.752, 0.03)), blend=0.014),
    Limb(((0.66, -0.005, 0.695, 0.037), (0.762, -0.015, 0.645, 0.03)), blend=0.014),
    Limb(((0.615, -0.02, 0.77, 0.035), (0.575, -0.045, 0.865, 0.029)), blend=0.014),  # thumb
]
LEG_LEFT: list[Solid] = [
    Limb(((0.12, 0.0, 0.52, 0.13), (0.15, -0.02, 0.29, 0.092), (0.155, 0.02, 0.09, 0.07)), blend=0.06),
    Limb(((0.155, 0.035, 0.066, 0.066), (0.17, -0.10, 0.06, 0.06)), blend=0.03),
    Limb(((0.115, -0.10, 0.048, 0.047), (0.10, -0.17, 0.042, 0.041)), blend=0.015),
    Limb(((0.175, -0.11, 0.048, 0.047), (0.18, -0.195, 0.042, 0.041)), blend=0.015),
    Limb(((0.235, -0.09, 0.048, 0.047), (0.258, -0.155, 0.042, 0.039)), blend=0.015),
]
TAIL: list[Solid] = [
    Limb(
        (
            (0, 0.08, 0.50, 0.14),
            (0, 0.30, 0.37, 0.105),
            (0, 0.52, 0.30, 0.075),
            (0, 0.72, 0.34, 0.05),
            (0, 0.87, 0.47, 0.03),
            (0, 0.93, 0.60, 0.014),
        ),
        blend=0.06,
    ),
]


def both_sides(solids: list[Solid]) -> list[Solid]:
    """Solids of the left side, and their mirror images."""
    return solids + [solid.mirrored() for solid in solids]


PARTS: dict[str, list[Solid]] = {
    "torso": TORSO,
    "head": HEAD + both_sides(HEAD_LEFT),
    "arm.L": ARM_LEFT,
    "arm.R": [solid.mirrored() for solid in ARM_LEFT],
    "leg.L": LEG_LEFT,
    "leg.R": [solid.mirrored() for solid in LEG_LEFT],
    "tail": TAIL,
}
SOLIDS: list[Solid] = list(chain.from_iterable(PARTS.values()))


def distance(points: Floats, solids: Iterable[Solid] = SOLIDS) -> Floats:
    """Signed distance (n,) of points (n, 3) to a union of solids, filleted; negative inside."""
    total = np.full(len(points), np.inf)
    for solid in solids:
        near = solid.distance(points)
        overlap = np.maximum(solid.blend - np.abs(near - total), 0) / solid.blend
        total = np.minimum(near, total) - overlap**2 * solid.blend / 4
    return total


def nearest_part(points: Floats) -> NDArray[np.str_]:
    """(n,) names of the parts that the points (n, 3) belong to."""
    return np.array(list(PARTS))[np.argmin([distance(points, solids) for solids in PARTS.values()], axis=0)]


def surface_net(cell: float, solids: Sequence[Solid] = SOLIDS, bounds: Floats = BOUNDS) -> tuple[Floats, Integers]:
    """The surface of a union of solids, the character's if no others are given, as quads.

    Naive surface nets (Gibson, Constrained elastic surface nets, 1998): a vertex in each grid cell that the
    surface passes, a quad around each grid edge that it crosses; the vertices are then evened out and
    brought back onto the surface in turn.

    Args:
        cell: size of a grid cell, about the length of an edge.
        solids: what the union is made of.
        bounds: (2, 3) the lowest and the highest corner of the space that they fill, with room to spare.

    Returns:
        (n, 3) vertices and (m, 4) vertex numbers of quads, wound so that normals point outwards.
    """
    inside, origin = _occupancy(cell, solids, bounds)
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
    return _settled(vertices, faces, solids), faces


def _cone(points: Floats, start: Floats, end: Floats) -> Floats:
    """Signed distance (n,) to the hull of two spheres, each given by x, y, z and radius."""
    axis = end[:3] - start[:3]
    length = np.linalg.norm(axis)
    offset = points - start[:3]
    along = offset @ (axis / length)
    across = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - along**2, 0))
    sine = (start[3] - end[3]) / length
    cosine = np.sqrt(1 - sine**2)
    # Where on the axis the flank's normal through the point starts; beyond its ends the spheres are nearest.
    foot = np.clip(along - across * sine / cosine, 0, length)
    return np.hypot(along - foot, across) - start[3] - (end[3] - start[3]) * foot / length


def _occupancy(cell: float, solids: Sequence[Solid], bounds: Floats) -> tuple[Booleans, Floats]:
    """Which points of a grid around the solids lie inside them, and the position of the first point.

    Of the fine grid only points near the surface are worked out; the others are as their coarse neighbour.
    """
    coarse = 5
    shape = np.ceil((bounds[1] - bounds[0]) / (cell * coarse)).astype(int) + 1
    grid = bounds[0] + cell * coarse * np.moveaxis(np.indices(shape), 0, -1)
    around = distance(grid.reshape(-1, 3), solids).reshape(shape)
    inside = np.kron(around < 0, np.ones((coarse,) * 3, dtype=bool))
    block = np.indices((coarse,) * 3).reshape(3, -1).T
    near = np.argwhere(np.abs(around) < 2 * coarse * cell)
    fine = (near[:, None] * coarse + block).reshape(-1, 3)
    origin = bounds[0] - cell * (coarse // 2)
    inside[tuple(fine.T)] = distance(origin + cell * fine, solids) < 0
    return inside, origin


def _settled(vertices: Floats, faces: Integers, solids: Sequence[Solid], rounds: int = 6) -> Floats:
    """The vertices moved to the middle of their neighbours and back onto the surface, some times over."""
    n = len(vertices)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    adjacent = coo_array((np.ones(len(start)), (start, end)), shape=(n, n)).tocsr()
    count = np.asarray(adjacent.sum(axis=1), dtype=np.float64)[:, None]
    for _ in range(rounds):
        vertices = _on_surface(adjacent @ vertices / count, solids)
    return _on_surface(vertices, solids)


def _on_surface(points: Floats, solids: Sequence[Solid], step: float = 1e-4) -> Floats:
    """One Newton step of points (n, 3) onto the surface, with the slope from differences."""
    here = distance(points, solids)
    slope = np.stack([(distance(points + offset, solids) - here) / step for offset in step * np.eye(3)], axis=1)
    return points - (here / np.maximum(np.einsum("ij,ij->i", slope, slope), 0.1))[:, None] * slope
