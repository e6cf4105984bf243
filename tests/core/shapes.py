# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated shapes of many kinds whose true correspondence is known for any pose and mesh.

A shape is a smooth union of rods. Marching tetrahedra mesh its surface at rest, on a grid whose rotation depends on
the seed. The place of a vertex at rest identifies it across meshes. A pose bends each limb along an arc.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise, permutations

import fast_simplification
import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.arcs import bend_along_arc

# Blending length of the smooth union.
BLEND = 0.08
# Grid cells per radius of the thinnest rod.
RESOLUTION = 1.8
# The grid makes SURPLUS times the requested vertices; decimation then evens them out.
SURPLUS = 2

Chain = list[tuple[float, float, float, float]]


@dataclass(frozen=True)
class Figure:
    """The rods of a shape.

    Attributes:
        body: chains of points with radii (x, y, z, r), each a row of rods; they do not move.
        limbs: groups of chains; each group bends along the line of its first chain.
        kept: tells which places (n, 3) remain after the shape is cut open; None for a closed shape.
    """

    body: tuple[Chain, ...]
    limbs: tuple[tuple[Chain, ...], ...] = ()
    kept: Callable[[np.ndarray], np.ndarray] | None = None


@dataclass(frozen=True)
class Shaped:
    """A mesh and the places (n, 3) of its vertices at rest."""

    surface: Surface
    places: np.ndarray


def limb(start: tuple[float, float, float], end: tuple[float, float, float], thick: float, thin: float) -> Chain:
    """A straight limb that tapers towards its end."""
    return [(*start, thick), (*end, thin)]


def _ring(radius: float, thick: float, thin: float, count: int = 24) -> Chain:
    turn = np.linspace(0, 2 * np.pi, count + 1)
    width = (thick + thin) / 2 + (thick - thin) / 2 * np.cos(turn)
    return list(zip(radius * np.cos(turn), radius * np.sin(turn), 0 * turn, width, strict=True))


def _handle(x: float, low: float, high: float) -> Chain:
    turn = np.linspace(-np.pi / 2, np.pi / 2, 9)
    middle, size = (low + high) / 2, (high - low) / 2
    side = np.sign(x)
    return [(x + 0.6 * side * float(np.cos(t)), 0.0, middle + size * float(np.sin(t)), 0.13) for t in turn]


# No extremities and no symmetry: only one map is right.
STONE = Figure(([(0, 0, 0, 0.8), (0.9, 0.1, 0, 0.55)], [(0, 0, 0, 0.8), (0.1, 0.7, 0.25, 0.6)], [(0, 0, 0.3, 0.8)] * 2))
TORUS = Figure((_ring(1.0, 0.35, 0.35),))
LOPSIDED_TORUS = Figure((_ring(1.0, 0.5, 0.25), [(0.2, 0.95, 0.25, 0.42)] * 2))
TABLE = Figure(
    tuple([(-0.75, y, 0, 0.2), (0.75, y, 0, 0.2)] for y in np.linspace(-0.75, 0.75, 6)),
    tuple((limb((x, y, 0), (x, y, -1.6), 0.17, 0.17),) for x in (-0.75, 0.75) for y in (-0.75, 0.75)),
)
VASE = Figure(
    (
        [(0, 0, z, r) for z, r in ((-1, 0.5), (-0.4, 0.75), (0.2, 0.6), (0.8, 0.3), (1.2, 0.4))],
        _handle(0.5, -0.5, 0.7),
        _handle(-0.5, -0.5, 0.7),
    )
)
HAND = Figure(
    tuple([(x, 0, -0.55, 0.24), (1.12 * x, 0, 0.45, 0.24)] for x in (-0.45, -0.15, 0.15, 0.45)),
    (
        (limb((-0.52, 0, 0.4), (-0.8, 0, 1.45), 0.2, 0.15),),
        (limb((-0.18, 0, 0.4), (-0.27, 0, 1.8), 0.2, 0.15),),
        (limb((0.18, 0, 0.4), (0.25, 0, 1.9), 0.2, 0.15),),
        (limb((0.52, 0, 0.4), (0.75, 0, 1.7), 0.2, 0.15),),
        (limb((0.4, 0, -0.4), (1.45, -0.25, 0.2), 0.26, 0.17),),
        (limb((0, 0, -0.5), (0, 0, -1.8), 0.36, 0.32),),
    ),
)


def _both(chain: Chain) -> tuple[tuple[Chain], tuple[Chain]]:
    """A limb of the left side and its mirror image."""
    return (chain,), ([(-x, y, z, r) for x, y, z, r in chain],)


_LEGS = (
    *_both(limb((0.3, -0.8, 0), (0.45, -0.9, -1.6), 0.24, 0.15)),
    *_both(limb((0.3, 0.9, 0), (0.45, 1.1, -1.7), 0.28, 0.16)),
)
# Four legs, two arms, a head with two horns, a tail: nine extremities.
CENTAUR = Figure(
    ([(0, -0.7, 0, 0.42), (0, 0.8, 0, 0.46)], [(0, -0.8, 0, 0.38), (0, -1.0, 1.1, 0.36), (0, -1.05, 1.75, 0.3)]),
    (
        *_LEGS,
        *_both(limb((0.25, -1.0, 1.0), (1.6, -1.2, 0.8), 0.2, 0.14)),
        *_both(limb((0.12, -1.0, 1.85), (0.5, -0.8, 2.7), 0.16, 0.12)),
        (limb((0, 1.1, 0.1), (0, 2.4, 0.2), 0.2, 0.13),),
    ),
)
ONE_ARMED_CENTAUR = replace(CENTAUR, limbs=CENTAUR.limbs[:5] + CENTAUR.limbs[6:])
# Eight legs, an abdomen, and a head with two feelers.
SPIDER = Figure(
    ([(0, -0.35, 0, 0.42), (0, 0.4, 0, 0.4)], [(0, 0.4, 0, 0.4), (0, 1.5, 0.25, 0.55)]),
    tuple(
        side
        for y, reach, length in ((-0.45, -1.5, 1.7), (-0.12, -0.5, 1.5), (0.2, 0.5, 1.5), (0.5, 1.5, 1.9))
        for side in _both([(0.3, y, 0, 0.17), (length, y + reach, 0.3, 0.12)])
    )
    + _both(limb((0.15, -0.6, 0), (0.4, -1.5, 0.35), 0.15, 0.11)),
)
# A head with a nose and ears, open at the neck.
HEAD = Figure(
    (
        [(0, 0, 0.3, 0.8), (0, -0.15, -0.1, 0.65)],
        [(0, 0.1, 0, 0.42), (0, 0.15, -1.3, 0.42)],
        [(0, -0.75, 0.15, 0.12), (0, -0.95, -0.05, 0.16)],
        [(0.8, 0.05, 0.2, 0.13), (0.95, 0.15, 0.35, 0.13)],
        [(-0.8, 0.05, 0.2, 0.13), (-0.95, 0.15, 0.35, 0.13)],
    ),
    kept=lambda places: places[:, 2] > -1.0,
)


def shape(figure: Figure, count: int = 3000, seed: int = 0, bend: float = 0.0) -> Shaped:
    """Mesh a figure.

    Args:
        figure: rods of the shape.
        count: approximate number of vertices.
        seed: seed of the mesh; the surface is the same for every seed.
        bend: bending angle of the limbs, in radians from root to tip.
    """
    random = np.random.default_rng(seed)
    turn = np.linalg.qr(random.standard_normal((3, 3)))[0]
    low, high, cell = _extent(figure, turn)
    points, triangles = _meshed(lambda p: _depth(figure, p @ turn.T), low, high, cell)
    if len(points) < SURPLUS * count:
        cell *= (len(points) / (1.2 * SURPLUS * count)) ** 0.5
        points, triangles = _meshed(lambda p: _depth(figure, p @ turn.T), low, high, cell)
    points, triangles = fast_simplification.simplify(points, triangles, target_count=2 * count)
    places = points.astype(float) @ turn.T
    if np.linalg.det(turn) < 0:
        triangles = triangles[:, ::-1]
    if figure.kept is not None:
        triangles = triangles[figure.kept(places[triangles].mean(axis=1))]
    used, triangles = np.unique(triangles, return_inverse=True)
    places = places[used]
    return Shaped(Surface(_posed(figure, places, bend), triangles.reshape(-1, 3)), places)


def sheet(count: int = 2000, seed: int = 0) -> Shaped:
    """A letter F cut out of a plane, triangulated irregularly."""
    random = np.random.default_rng(seed)
    squares = np.array([[0, 0], [0, 1], [0, 2], [0, 3], [0, 4], [1, 4], [2, 4], [1, 2]])
    m = max(2, round((count / len(squares)) ** 0.5))
    steps = np.stack(np.meshgrid(np.arange(m + 1), np.arange(m + 1), indexing="ij"), axis=-1)
    cells = np.concatenate([(steps[:-1, :-1] + m * square).reshape(-1, 2) for square in squares])
    corners = cells[:, None] + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    lattice, quads = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    quads = quads.reshape(-1, 4)
    inner = np.bincount(quads.ravel()) == 4
    points = lattice + random.uniform(-0.3, 0.3, lattice.shape) * inner[:, None]
    other = random.random(len(quads)) < 0.5
    quads[other] = np.roll(quads[other], 1, axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    places = np.column_stack([points / m, np.zeros(len(points))])
    return Shaped(Surface(places @ np.linalg.qr(random.standard_normal((3, 3)))[0], triangles), places)


def truth(source: Shaped, target: Shaped) -> np.ndarray:
    """(n_t,) the source vertex nearest to each target vertex's place."""
    return np.asarray(cKDTree(source.places).query(target.places)[1])


def _chains(figure: Figure) -> list[Chain]:
    return [*figure.body, *(chain for group in figure.limbs for chain in group)]


def _extent(figure: Figure, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Corners of a rotated figure's bounding box, and the cell size of the grid."""
    knots = np.concatenate([np.array(chain, dtype=float) for chain in _chains(figure)])
    centres, radii = knots[:, :3] @ turn, knots[:, 3:] + BLEND
    return (centres - radii).min(axis=0), (centres + radii).max(axis=0), float(knots[:, 3].min() / RESOLUTION)


def _depth(figure: Figure, points: np.ndarray) -> np.ndarray:
    """(n,) smoothed distance below a figure's surface, negative outside."""
    return _joined(np.stack([_below(chain, points) for chain in _chains(figure)]))


def _joined(depths: np.ndarray) -> np.ndarray:
    most = depths.max(axis=0)
    return np.asarray(most + BLEND * np.log(np.exp((depths - most) / BLEND).sum(axis=0)))


def _below(chain: Chain, points: np.ndarray) -> np.ndarray:
    """(n,) distance below the surface of a row of rods."""
    depth = np.full(len(points), -np.inf)
    for start, end in pairwise(chain):
        a, b = np.array(start), np.array(end)
        axis = b[:3] - a[:3]
        along = np.clip((points - a[:3]) @ axis / max(axis @ axis, 1e-9), 0, 1)
        radius = a[3] + along * (b[3] - a[3])
        depth = np.maximum(depth, radius - np.linalg.norm(points - a[:3] - along[:, None] * axis, axis=1))
    return depth


def _meshed(
    depth: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """The surface where a function is zero, by marching tetrahedra: points and triangles wound outwards."""
    axes = [np.arange(a - cell, b + 2 * cell, cell) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    number = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    grid = grid.reshape(-1, 3)
    value = depth(grid)
    value[value == 0] = 1e-12
    tetrahedra = []
    for order in permutations(np.eye(3, dtype=int)):  # paths along a cube's edges between opposite corners
        path = np.cumsum([np.zeros(3, dtype=int), *order], axis=0)
        block = [number[tuple(slice(c, size - 1 + c) for c, size in zip(at, number.shape, strict=True))] for at in path]
        tetrahedra.append(np.stack([part.ravel() for part in block], axis=1))
    tetrahedra = np.concatenate(tetrahedra)
    # Inner corners come first: one or three of them give a triangle, two give a quadrilateral.
    tetrahedra = np.take_along_axis(tetrahedra, np.argsort(-value[tetrahedra], axis=1), axis=1)
    inside = (value[tetrahedra] > 0).sum(axis=1)
    cuts = {1: [((0, 1), (0, 2), (0, 3))], 3: [((0, 3), (1, 3), (2, 3))]}
    cuts[2] = [((0, 2), (0, 3), (1, 3)), ((0, 2), (1, 3), (1, 2))]
    edges, inner = [], []
    for count, triangles in cuts.items():
        found = tetrahedra[inside == count]
        for triangle in triangles:
            edges.append(found[:, np.array(triangle)])
            inner.append(grid[found[:, 0]])
    edge = np.sort(np.concatenate(edges), axis=2).reshape(-1, 2)
    edge, vertex = np.unique(edge, axis=0, return_inverse=True)
    start, end = value[edge[:, 0]], value[edge[:, 1]]
    points = grid[edge[:, 0]] + (start / (start - end))[:, None] * (grid[edge[:, 1]] - grid[edge[:, 0]])
    triangles = vertex.reshape(-1, 3)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), np.concatenate(inner) - a) > 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return points, triangles


def _posed(figure: Figure, points: np.ndarray, bend: float) -> np.ndarray:
    """Bend the limbs, each in its own direction."""
    if bend == 0:
        return points
    depths = [_joined(np.stack([_below(chain, points) for chain in figure.body]))]
    depths += [_joined(np.stack([_below(chain, points) for chain in group])) for group in figure.limbs]
    nearness = np.exp(np.maximum((np.array(depths) - np.max(depths, axis=0)) / BLEND, -50))
    nearness /= nearness.sum(axis=0)
    moved = points.copy()
    for number, group in enumerate(figure.limbs):
        start, end = np.array(group[0][0][:3]), np.array(group[0][-1][:3])
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        towards = np.cross(along, [np.cos(2.4 * number), np.sin(2.4 * number), 0.4])
        towards /= np.linalg.norm(towards)
        s, t = np.maximum((points - start) @ along, 0), (points - start) @ towards
        along_arc, across = bend_along_arc(t, s * bend / length, length / bend)
        shift = (along_arc - s)[:, None] * along
        shift += (across - t)[:, None] * towards
        moved += nearness[number + 1][:, None] * shift
    return moved
