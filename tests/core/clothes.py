# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated creatures in clothes: garments, eyes and buttons as loose parts, with the true correspondence of each.

A garment is a shell above a region of the creature's skin, with a mesh of its own. It is cut at rest and bent
with the creature, so that sleeves bend with their arms and nothing less than the body's whole map tells where
they have gone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from creatures import directions
from scipy.spatial import ConvexHull, cKDTree

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples import LENGTHS, LIMBS, SHARPNESS, posed
from zoomout_core.spectral.sampling import farthest_points

# Directions to choose from, for each vertex of a garment.
DENSITY = 25

Region = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Piece:
    """A loose part at rest.

    Attributes:
        name: of the part, the same on every creature that wears it.
        points: (n, 3) at rest.
        triangles: (m, 3).
        keys: (n, 3) what stands for the place of each vertex on the part, whatever the mesh.
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
    """A sleeve of the shirt alone."""
    return lambda rest: shirt()(rest) & (side * rest[:, 0] > 0.95)


def bodice(rest: np.ndarray) -> np.ndarray:
    """The shirt without its sleeves."""
    return shirt()(rest) & (np.abs(rest[:, 0]) < 1.0)


def shell(name: str, region: Region, offset: float, count: int, seed: int) -> Piece:
    """A garment of `count` even vertices over a region of the skin, so far above it, with open borders."""
    everywhere = directions(DENSITY * count, seed)
    inside = region(skin(everywhere))
    where = everywhere[inside][farthest_points(skin(everywhere[inside]), count)]
    # A hull closes every opening, if only with what lies in it: that is left out again.
    triangles = _hull(np.vstack([where, everywhere[~inside][::DENSITY]]))
    triangles = triangles[(triangles < len(where)).all(axis=1)]
    triangles = triangles[region(skin(_unit(where[triangles].sum(axis=1))))]
    used, compact = np.unique(triangles, return_inverse=True)
    return Piece(name, skin(where[used]) + offset * skin_normals(where[used]), compact.reshape(-1, 3), where[used])


def ball(name: str, above: np.ndarray, radius: float, height: float, count: int, seed: int) -> Piece:
    """A small ellipsoid above the skin in a direction (3,) from the centre: an eye, a button."""
    where = directions(count, seed)
    above = above[None] / np.linalg.norm(above)
    centre = skin(above) + height * skin_normals(above)
    return Piece(name, centre + radius * where * [1, 0.8, 1.25], _hull(where), where)


def dress(pieces: list[Piece], count: int = 4000, seed: int = 0, bend: float = 0.0) -> Clothed:
    """A creature of `count` vertices with some pieces, all of it bent."""
    where = directions(count, seed)
    body = Piece("skin", skin(where), _hull(where), where)
    everything = [body, *pieces]
    first = np.cumsum([0] + [len(piece.points) for piece in everything])
    points = posed(np.vstack([piece.points for piece in everything]), bend)
    triangles = [piece.triangles + start for piece, start in zip(everything, first[:-1], strict=True)]
    names = np.repeat([piece.name for piece in everything], [len(piece.triangles) for piece in everything])
    parts = {piece.name: np.arange(*first[i : i + 2]) for i, piece in enumerate(everything)}
    keys = np.vstack([piece.keys for piece in everything])
    return Clothed(Surface(points, np.vstack(triangles)), keys, parts, names)


def true_vertices(source: Clothed, target: Clothed, name: str, source_name: str | None = None) -> np.ndarray:
    """The source vertex at, or nearest to, the place of each vertex of a target's part."""
    counterpart = source.parts[source_name or name]
    return counterpart[cKDTree(source.keys[counterpart]).query(target.keys[target.parts[name]])[1]]


def skin(where: np.ndarray) -> np.ndarray:
    """(n, 3) places of directions (n, 3) on the creature at rest."""
    axes = LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True)
    radius = 1 + np.exp(SHARPNESS * (where @ axes.T - 1)) @ LENGTHS
    return where * radius[:, None] * [1, 0.7, 1]


def skin_normals(where: np.ndarray) -> np.ndarray:
    """(n, 3) outward unit normals there, by differences."""
    helper = np.eye(3)[np.argmin(np.abs(where), axis=1)]
    u = np.cross(where, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(where, u)
    along = [skin(_unit(where + 1e-5 * axis)) - skin(_unit(where - 1e-5 * axis)) for axis in (u, v)]
    return _unit(np.cross(along[0], along[1]))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _hull(where: np.ndarray) -> np.ndarray:
    """(m, 3) triangles over directions, wound outwards."""
    triangles = ConvexHull(where).simplices
    a, b, c = (where[triangles[:, i]] for i in range(3))
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) > 0
    return np.where(outward[:, None], triangles, triangles[:, ::-1])
