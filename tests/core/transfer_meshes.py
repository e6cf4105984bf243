# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes over a parameter rectangle and maps that keep the parameters: a formula gives the exact transfer.

A point has parameters (a, b): a goes once around an axis, b along the profile or around it too. Data that is linear
in the parameters on the source must have the same formula at the target's corners, for any topology of the target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.grids import grid_faces
from zoomout_core.samples.spheres import outward_hull


@dataclass(frozen=True)
class Sheet:
    """A mesh over parameters.

    Attributes:
        surface: the mesh.
        parameters: (n, 2) parameters of the vertices, in [0, 1) along a periodic direction.
        corners: (c, 2) parameters of the corners, continuous within each face.
    """

    surface: Surface
    parameters: np.ndarray
    corners: np.ndarray

    @property
    def middles(self) -> np.ndarray:
        """(f, 2) mean parameters of each face."""
        start = self.surface.face_start
        return np.add.reduceat(self.corners, start[:-1]) / np.diff(start)[:, None]


def torus(parameters: np.ndarray) -> np.ndarray:
    a, b = 2 * np.pi * parameters.T
    ring = 2 + np.cos(b)
    return np.stack([ring * np.cos(a), ring * np.sin(a), np.sin(b)], axis=1)


def tube(parameters: np.ndarray) -> np.ndarray:
    a, b = 2 * np.pi * parameters[:, 0], parameters[:, 1]
    return np.stack([np.cos(a), np.sin(a), 4 * b], axis=1)


def plate(columns: int, rows: int, *, width: float = 1.0, height: float = 1.0, jitter: float = 0.0) -> Surface:
    """A flat grid of quads from the origin, whose inner vertices are moved by up to `jitter` cells."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij"))
    inner = (i > 0) & (i < columns) & (j > 0) & (j < rows)
    move = jitter * np.random.default_rng(0).uniform(-1, 1, (len(i), 2)) * inner[:, None]
    place = (np.stack([i, j], axis=1) + move) / [columns, rows] * [width, height]
    return Surface(np.column_stack([place, np.zeros(len(place))]), grid_faces(columns, rows))


def sheet(
    shape: Callable[[np.ndarray], np.ndarray],
    columns: int,
    rows: int,
    *,
    jitter: float = 0.0,
    twist: float = 0.0,
    sides: int = 4,
    seed: int = 0,
) -> Sheet:
    """A grid of quads, of triangles with random diagonals, or of hexagons.

    Args:
        shape: maps parameters (n, 2) to points (n, 3).
        columns: number of cells along a.
        rows: number of cells along b.
        jitter: greatest displacement of vertices, in cells.
        twist: amplitude of the sway of lines of constant a, in turns.
        sides: sides of each face: 3, 4 or 6.
        seed: seed of the random choices.
    """
    random = np.random.default_rng(seed)
    open_ended = shape is tube
    lines = rows + 1 if open_ended else rows
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(lines), indexing="ij"))
    move = jitter * random.uniform(-1, 1, (len(i), 2))
    if open_ended:
        move[(j == 0) | (j == rows), 1] = 0
    place = np.stack(
        [(i + move[:, 0]) / columns + twist * np.sin(2 * np.pi * j / rows), (j + move[:, 1]) / rows], axis=1
    )

    first = (i % (2 if sides == 6 else 1) == 0) & (j < rows)
    i, j = i[first], j[first]
    outline = [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)] if sides == 6 else [(0, 0), (1, 0), (1, 1), (0, 1)]
    faces = np.stack([(i + right) % columns * lines + (j + up) % lines for right, up in outline], axis=1)
    turns = np.stack([np.stack([(i + right) // columns, (j + up) // lines], axis=1) for right, up in outline], axis=1)
    corners = place[faces] + turns
    if sides == 3:
        one, other = [[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]
        split = np.where(random.random((len(faces), 1, 1)) < 0.5, [one], [other])
        every = np.arange(len(faces))[:, None, None]
        faces, corners = faces[every, split].reshape(-1, 3), corners[every, split]
    wrapped = np.stack([place[:, 0] % 1, place[:, 1] if open_ended else place[:, 1] % 1], axis=1)
    return Sheet(Surface(shape(place), faces), wrapped, corners.reshape(-1, 2))


def permute(mesh: Sheet, seed: int = 0) -> tuple[Sheet, np.ndarray]:
    """The same mesh with its vertices in another order, and (n,) the old number of each."""
    order = np.random.default_rng(seed).permutation(len(mesh.parameters))
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    old = mesh.surface
    surface = Surface.from_corners(old.vertices[order], number[old.corner_vertex], old.face_start, old.triangle_corners)
    return replace(mesh, surface=surface, parameters=mesh.parameters[order]), order


def split_at_faces(surface: Surface) -> tuple[Surface, np.ndarray]:
    """The mesh with separate vertices for every face, and (n,) the original vertex of each."""
    corners = np.arange(len(surface.corner_vertex))
    vertices = surface.vertices[surface.corner_vertex]
    return Surface.from_corners(vertices, corners, surface.face_start, surface.triangle_corners), surface.corner_vertex


def nearest_map(points: np.ndarray, source: Surface) -> SurfaceMap:
    """The map that sends each target vertex to the source point closest to its entry in points (n, 3)."""
    return SurfaceMap(*closest_points(points, source.vertices, source.triangles), source.triangles)


def identity(surface: Surface) -> SurfaceMap:
    return SurfaceMap.from_vertices(np.arange(len(surface.vertices)), surface)


def true_map(source: Sheet, columns: int, rows: int, parameters: np.ndarray) -> SurfaceMap:
    """The map of points with parameters (n, 2) onto a source sheet of columns by rows quads."""
    column, row = np.floor(parameters * [columns, rows] + 1e-9).astype(int).T
    cell = column % columns * rows + np.minimum(row, rows - 1)
    surface = source.surface
    triangle, barycentric = 2 * cell, np.full((len(cell), 3), -np.inf)
    for candidate in (2 * cell, 2 * cell + 1):
        corners = source.corners[surface.triangle_corners[candidate]]
        point = parameters + np.round(corners.mean(axis=1) - parameters)
        edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        b, c = np.linalg.solve(edges, (point - corners[:, 0])[:, :, None])[:, :, 0].T
        weights = np.stack([1 - b - c, b, c], axis=1)
        better = weights.min(axis=1) > barycentric.min(axis=1)
        triangle[better], barycentric[better] = candidate[better], weights[better]
    assert barycentric.min() > -1e-6
    barycentric = np.clip(barycentric, 0, None)
    return SurfaceMap(triangle, barycentric / barycentric.sum(axis=1, keepdims=True), surface.triangles)


def sphere(directions: np.ndarray) -> Surface:
    """The convex hull of points on the unit sphere."""
    return Surface(directions, outward_hull(directions))


def globe(columns: int, rows: int) -> tuple[Surface, np.ndarray]:
    """A unit sphere by longitude and latitude, and its UVs (c, 2): one island, one seam, fans at the poles."""
    turn, height = np.meshgrid(np.arange(columns) / columns, np.arange(1, rows) / rows)
    angle, polar = 2 * np.pi * turn.ravel(), np.pi * height.ravel()
    ring = np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], axis=1)
    vertices = np.concatenate([[[0, 0, 1]], ring, [[0, 0, -1]]])
    faces: list[list[int]] = []
    uvs: list[tuple[float, float]] = []

    def vertex(row: int, column: int) -> int:
        return 1 + (row - 1) * columns + column % columns

    for column in range(columns):
        left, middle, right = column / columns, (column + 0.5) / columns, (column + 1) / columns
        faces.append([0, vertex(1, column), vertex(1, column + 1)])
        uvs += [(middle, 1), (left, 1 - 1 / rows), (right, 1 - 1 / rows)]
        for row in range(1, rows - 1):
            faces.append(
                [vertex(r, c) for r, c in ((row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1))]
            )
            high, low = 1 - row / rows, 1 - (row + 1) / rows
            uvs += [(left, high), (left, low), (right, low), (right, high)]
        faces.append([len(vertices) - 1, vertex(rows - 1, column + 1), vertex(rows - 1, column)])
        uvs += [(middle, 0), (right, 1 / rows), (left, 1 / rows)]
    return Surface(vertices, faces), np.array(uvs)
