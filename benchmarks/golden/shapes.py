# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes of the cases of `golden`: those of files, and generated ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

import zoomout_core as zo
from zoomout_core import samples
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.samples.grids import grid_faces
from zoomout_core.samples.spheres import outward_hull

Shape: TypeAlias = zo.Surface | zo.PointCloud

# Number of vertices of generated shapes.
USUAL, SMALL, TINY = 2500, 1000, 150


def read(path: Path) -> Shape:
    """The shape in a file of the sets."""
    if path.suffix == ".glb":
        return zo.read_asset(path).surface
    return zo.read_point_cloud(path) if path.stem.startswith("cloud") else zo.read_surface(path)


def creature(
    count: int = USUAL, seed: int = 0, bend: float = 0.0, asymmetry: float = 0.3, without: int | None = None
) -> zo.Surface:
    """A creature, by default with longer left limbs."""
    return samples.creature(count, seed, bend, asymmetry, without).surface


def true_map(source_seed: int = 0, target_seed: int = 1, count: int = USUAL) -> Integers:
    """(n_t,) the source vertex of each vertex of a creature of the same size."""
    return samples.true_vertex(samples.creature(count, source_seed), samples.creature(count, target_seed))


def round_shape(radius: Callable[[Floats], Floats], count: int = USUAL, seed: int = 0) -> zo.Surface:
    """An irregular mesh of a star-shaped surface, given its radius in each direction."""
    where = samples.directions(count, seed)
    return zo.Surface(where * radius(where)[:, None], outward_hull(where))


def solid(normals: ArrayLike) -> Callable[[Floats], Floats]:
    """The radius of a solid with faces at unit distance in some directions and the opposite ones."""
    towards = unit_vectors(np.asarray(normals, dtype=float))
    return lambda where: 1 / np.abs(where @ towards.T).max(axis=1)


CUBE = solid(np.eye(3))
BOX = solid([[1.0, 0, 0], [0.0, 1, 0], [0.0, 0, 1], [1.0, 1, 0.3]])
_PHI = (1 + 5**0.5) / 2
ICOSAHEDRON = solid(
    np.array(
        [[a, b, c] for a in (1, -1) for b in (1, -1) for c in (1, -1)]
        + [np.roll([0, sign / _PHI, _PHI], turn).tolist() for sign in (1, -1) for turn in range(3)]
    )
)


def gear(where: Floats) -> Floats:
    """The radius of a star with five arms, which has rotations but no reflections."""
    angle = np.arctan2(where[:, 1], where[:, 0])
    return 1 + (1 - where[:, 2] ** 2) * (0.5 * np.cos(5 * angle) + 0.3 * np.sin(10 * angle)) + 0.3 * where[:, 2]


def egg(where: Floats) -> Floats:
    """The radius of a body without extremities and with three different axes."""
    return np.asarray(1 / np.linalg.norm(where / [1.0, 1.5, 2.1], axis=1) * (1 + 0.1 * where[:, 2]))


def torus(columns: int = 48, rows: int = 24) -> zo.Surface:
    """A torus of quads."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    around, across = 2 * np.pi * i / columns, 2 * np.pi * j / rows
    ring = 2 + np.cos(across) * (1 + 0.2 * np.cos(around))
    points = np.column_stack([ring * np.cos(around), ring * np.sin(around), np.sin(across)])
    return zo.Surface(points, grid_faces(columns, rows, (True, True)))


def keep_faces(surface: zo.Surface, inside: Callable[[Floats], Any]) -> zo.Surface:
    """The faces of a surface whose corners are all selected."""
    triangles = surface.triangles[np.asarray(inside(surface.vertices))[surface.triangles].all(axis=1)]
    used, compact = np.unique(triangles, return_inverse=True)
    return zo.Surface(surface.vertices[used], compact.reshape(-1, 3))


def shirt(seed: int, count: int = SMALL) -> zo.Surface:
    """A shell above the body and the arms of a creature at rest."""
    skin = creature(count, seed, asymmetry=0)
    above = skin.vertices + 0.06 * vertex_normals(skin.vertices, skin.triangles)
    shell = zo.Surface(above, skin.triangles)
    return keep_faces(shell, lambda points: (np.abs(points[:, 2]) < 0.85) & (np.abs(points[:, 0]) < 2.2))


def clothe(seed: int, bend: float) -> zo.Surface:
    """A creature with loose parts: a shirt, eyes and buttons."""
    balls = [((-0.3, -0.55, 1.3), 0.12), ((0.3, -0.55, 1.3), 0.12), ((0, -0.85, 0.3), 0.06), ((0, -0.85, -0.1), 0.06)]
    loose = [round_shape(lambda where: np.ones(len(where)), 80, seed + number) for number in range(len(balls))]
    placed = [
        ball.with_vertices(radius * unit_vectors(ball.vertices) + at)
        for ball, (at, radius) in zip(loose, balls, strict=True)
    ]
    everything = zo.Surface.joined([creature(USUAL, seed, asymmetry=0), shirt(seed + 20), *placed])
    return everything.with_vertices(samples.posed(everything.vertices, bend))


def scale(surface: zo.Surface, factor: float) -> zo.Surface:
    """Convert a surface to another unit."""
    return surface.with_vertices(factor * surface.vertices)


def landmarks(count: int = USUAL) -> tuple[Integers, Integers]:
    """Vertices at the tips of the limbs of the creatures 0 and 1."""
    ends = unit_vectors(samples.LIMBS)
    of_source, of_target = ((samples.directions(count, seed) @ ends.T).argmax(axis=0) for seed in (0, 1))
    return of_source, of_target


def regions() -> list[tuple[Integers, Integers]]:
    """The vertices of each limb of the creatures 0 and 1."""
    of_source, of_target = (samples.limb_weights(samples.directions(USUAL, seed))[:, 1:] > 0.5 for seed in (0, 1))
    return [(np.flatnonzero(a), np.flatnonzero(b)) for a, b in zip(of_source.T, of_target.T, strict=True)]


def creatures() -> tuple[zo.Surface, zo.Surface]:
    """Two creatures, the second of which bends its limbs."""
    return creature(seed=0), creature(seed=1, bend=0.6)


def cloud(surface: zo.Surface, normals: bool) -> zo.PointCloud:
    """The vertices of a surface as a point cloud, with or without normals."""
    points = surface.vertices
    return zo.PointCloud(points, vertex_normals(points, surface.triangles) if normals else None)


def arm_and_whole() -> tuple[zo.Surface, zo.Surface]:
    """A creature, and the half of another one with its left arm."""
    return creature(), keep_faces(creature(4000, 1), lambda points: points[:, 0] > 0.2)
