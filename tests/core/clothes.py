# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated creatures in clothes: garments, eyes and buttons as loose parts, with the true correspondence of each.

A garment is a shell above a region of the creature's skin, with its own mesh. It is cut at rest and bent
with the creature. Sleeves bend with their arms, so only a map of the whole body predicts where they end up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from creatures import directions
from scipy.spatial import cKDTree

from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.samples.creatures import at_rest, posed
from zoomout_core.samples.spheres import outward_hull
from zoomout_core.spectral.sampling import farthest_points

# Candidate directions per vertex of a garment.
DENSITY = 25

Region = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Piece:
    """A loose part at rest.

    Attributes:
        name: name of the part, the same on every creature that wears it.
        points: (n, 3) vertices at rest.
        triangles: (m, 3).
        keys: (n, 3) identify the place of each vertex on the part, independently of the mesh.
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray
    keys: np.ndarray


@dataclass(frozen=True)
class Clothed:
    """A creature with loose parts.

    Attributes:
        surface: body and parts as one mesh.
        keys: (n, 3) the place of each vertex on its part.
        parts: the vertices of each part by its name; the body is "skin".
        names: (f,) the name of the part that each face belongs to.
    """

    surface: Surface
    keys: np.ndarray
    parts: dict[str, np.ndarray]
    names: np.ndarray = field(repr=False)


def shirt(sleeve: float = 2.6) -> Region:
    """The torso and the arms as far out as `sleeve`."""
    return lambda rest: (rest[:, 2] > -0.75) & (rest[:, 2] < 0.95) & (np.abs(rest[:, 0]) < sleeve)


def jacket(rest: np.ndarray) -> np.ndarray:
    """A shirt with shorter sleeves that is open along the front."""
    return shirt(2.0)(rest) & ~((np.abs(rest[:, 0]) < 0.15) & (rest[:, 1] < 0))


def trousers(rest: np.ndarray) -> np.ndarray:
    """The hips and the legs down to the ankles, with a hole for the tail."""
    return (rest[:, 2] < -0.55) & (rest[:, 2] > -3.2) & (rest[:, 1] < 0.75) & (np.abs(rest[:, 0]) < 1.6)


def sleeve(side: int) -> Region:
    """One sleeve of the shirt."""
    return lambda rest: shirt()(rest) & (side * rest[:, 0] > 0.95)


def bodice(rest: np.ndarray) -> np.ndarray:
    """The shirt without its sleeves."""
    return shirt()(rest) & (np.abs(rest[:, 0]) < 1.0)


def shell(name: str, region: Region, offset: float, count: int, seed: int) -> Piece:
    """A garment with open borders, `offset` above a region of the skin, with `count` evenly spaced vertices."""
    everywhere = directions(DENSITY * count, seed)
    inside = region(at_rest(everywhere))
    where = everywhere[inside][farthest_points(at_rest(everywhere[inside]), count)]
    # The hull also closes the openings: include skin outside the region, then drop the triangles that use it.
    triangles = outward_hull(np.vstack([where, everywhere[~inside][::DENSITY]]))
    triangles = triangles[(triangles < len(where)).all(axis=1)]
    triangles = triangles[region(at_rest(unit_vectors(where[triangles].sum(axis=1))))]
    used, compact = np.unique(triangles, return_inverse=True)
    return Piece(name, at_rest(where[used]) + offset * skin_normals(where[used]), compact.reshape(-1, 3), where[used])


def ball(name: str, above: np.ndarray, radius: float, height: float, count: int, seed: int) -> Piece:
    """A small ellipsoid above the skin in a direction (3,) from the centre: an eye, a button."""
    where = directions(count, seed)
    above = above[None] / np.linalg.norm(above)
    centre = at_rest(above) + height * skin_normals(above)
    return Piece(name, centre + radius * where * [1, 0.8, 1.25], outward_hull(where), where)


def dress(pieces: list[Piece], count: int = 4000, seed: int = 0, bend: float = 0.0) -> Clothed:
    """A creature of `count` vertices with some pieces, all bent together."""
    where = directions(count, seed)
    body = Piece("skin", at_rest(where), outward_hull(where), where)
    everything = [body, *pieces]
    first = np.cumsum([0] + [len(piece.points) for piece in everything])
    points = posed(np.vstack([piece.points for piece in everything]), bend)
    triangles = [piece.triangles + start for piece, start in zip(everything, first[:-1], strict=True)]
    names = np.repeat([piece.name for piece in everything], [len(piece.triangles) for piece in everything])
    parts = {piece.name: np.arange(*first[i : i + 2]) for i, piece in enumerate(everything)}
    keys = np.vstack([piece.keys for piece in everything])
    return Clothed(Surface(points, np.vstack(triangles)), keys, parts, names)


def true_vertices(source: Clothed, target: Clothed, name: str, source_name: str | None = None) -> np.ndarray:
    """The source vertex whose place is nearest to that of each vertex of a target's part."""
    partner = source.parts[source_name or name]
    return partner[cKDTree(source.keys[partner]).query(target.keys[target.parts[name]])[1]]


def skin_normals(where: np.ndarray) -> np.ndarray:
    """(n, 3) outward unit normals of the skin at directions (n, 3), by central differences."""
    helper = np.eye(3)[np.argmin(np.abs(where), axis=1)]
    u = unit_vectors(np.cross(where, helper))
    v = np.cross(where, u)
    along = [at_rest(unit_vectors(where + 1e-5 * axis)) - at_rest(unit_vectors(where - 1e-5 * axis)) for axis in (u, v)]
    return unit_vectors(np.cross(along[0], along[1]))
