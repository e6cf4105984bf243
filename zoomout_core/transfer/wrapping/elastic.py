# SPDX-License-Identifier: GPL-3.0-or-later
"""The target as an elastic mesh: its edges, rotated and scaled, resist the goals that attract its vertices.

As-rigid-as-possible surface modelling (Sorkine and Alexa 2007), with rotations averaged along the surface, and given
scales. Positions are those of the target's working mesh, at unit area of the source.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import SuperLU

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.gradients import products_of_gradients
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing, screened_stiffness
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.mesh.triangles import unique_edges, vertex_normals
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.transfer.frames import Frames

# Minimum weight of a goal: parts without any goal would make the system singular.
MIN_PULL = 1e-6


@dataclass(frozen=True, eq=False)
class Pins:
    """Places of the working mesh that must reach given positions."""

    matrix: csr_array  # (p, n) barycentric coordinates of the places
    positions: Floats  # (p, 3) positions to reach

    @property
    def vertices(self) -> Integers:
        """(v,) the vertices of the triangles that contain the places."""
        return np.unique(self.matrix.indices)

    def on(self, rest: Floats, vertices: Floats, triangles: Integers) -> Pins:
        """The same pins on another mesh (c, 3), (m, 3) of the same rest shape (n, 3)."""
        if not len(self.positions):
            return Pins(csr_array((0, len(vertices))), self.positions)
        triangle, barycentric = closest_points(self.matrix @ rest, vertices, triangles)
        rows = np.repeat(np.arange(len(triangle)), 3)
        entries = barycentric.ravel(), (rows, triangles[triangle].ravel())
        return Pins(csr_array(entries, shape=(len(triangle), len(vertices))), self.positions)

    def enforce(self, positions: Floats) -> Floats:
        """(n, 3) positions that satisfy the pins: only corners of the places move, as little as possible."""
        if not len(self.positions):
            return positions
        missing = self.positions - self.matrix @ positions
        compliance = np.linalg.pinv((self.matrix @ self.matrix.T).toarray(), hermitian=True)
        return np.asarray(positions + self.matrix.T @ (compliance @ missing))


def neighbour_means(triangles: Integers, n: int) -> csr_array:
    """(n, n) matrix of the means over the neighbours of each of n vertices; zero without neighbours."""
    edges, _ = unique_edges(triangles)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    return csr_array((1 / np.bincount(rows, minlength=n)[rows], (rows, columns)), shape=(n, n))


@dataclass(frozen=True, eq=False)
class RestMesh:
    """The target's working mesh at rest, and its scales."""

    rest: Floats  # (n, 3) its vertices
    normals: Floats  # (n, 3) their normals
    corners: Integers  # (m, 3) its triangles, wound outwards
    stiffness: csc_array  # (n, n) stiffness of its edges
    areas: Floats  # (n,) areas of its vertices
    scales: Floats  # (n,) target length of its edges, relative to rest
    handedness: Floats  # (n,) -1 where the map mirrors it, else 1
    averaging: ScreenedSmoothing  # averages values along the surface by area, over a length at unit area

    @classmethod
    def of(cls, frames: Frames, averaged_over: float) -> RestMesh:
        """Make the rest mesh of a target with frames at all vertices, which averages over a length at unit area."""
        working, areas, stiffness = frames.mapped.target.working, frames.areas, frames.stiffness
        turns = np.linalg.det(frames.turns)
        scales = working.scale / np.sqrt(frames.mapped.source.area) / np.cbrt(np.abs(turns))
        averaging = ScreenedSmoothing.of(areas, stiffness, averaged_over)
        shape = working.vertices, working.vertex_normals, working.oriented_triangles
        return cls(*shape, stiffness, areas, scales, np.sign(turns), averaging)

    def coarsen(self, vertices: Integers, triangles: Integers) -> RestMesh:
        """The rest mesh on some of the vertices (c,), with other triangles (m, 3)."""
        rest, scales, handedness = self.rest[vertices], self.scales[vertices], self.handedness[vertices]
        stiffness, areas = mesh_laplacian(rest, triangles)
        averaging = ScreenedSmoothing.of(areas, stiffness, self.averaging.length)
        return RestMesh(rest, self.normals[vertices], triangles, stiffness, areas, scales, handedness, averaging)

    def loads(self, rotations: Floats) -> Floats:
        """(n, 3) stiffness applied to positions with the edges at rest, rotated (n, 3, 3) and scaled."""
        # The same as `turn_gradients` without assembling its matrix, which takes many times as long.
        turns = self.scales[:, None, None] * rotations
        turned = np.einsum("nij,nj->ni", turns, self.rest)
        around = (self.stiffness @ turns.reshape(-1, 9)).reshape(-1, 3, 3)
        own = np.einsum("nij,nj->ni", turns, self.stiffness @ self.rest)
        return np.asarray((own + self.stiffness @ turned - np.einsum("nij,nj->ni", around, self.rest)) / 2)


class PinnedSystem:
    """A sparse symmetric positive definite system, given by its factors, whose solutions satisfy pins."""

    def __init__(self, factors: SuperLU, pins: Pins) -> None:
        self._factors, self._pins = factors, pins
        self._answer, self._compliance = np.zeros((factors.shape[0], 0)), np.zeros((0, 0))
        if len(pins.positions):
            self._answer = self._free(pins.matrix.T.toarray())
            self._compliance = np.linalg.pinv(pins.matrix @ self._answer, hermitian=True)

    def _free(self, loads: Floats) -> Floats:
        """(n, d) solutions for loads (n, d), ignoring the pins."""
        return np.asarray(self._factors.solve(np.asfortranarray(loads)))

    def solve(self, loads: Floats) -> Floats:
        """(n, 3) solutions for loads (n, 3) that satisfy the pins with minimum energy."""
        free = self._free(loads)
        return np.asarray(free + self._answer @ (self._compliance @ (self._pins.positions - self._pins.matrix @ free)))


class Elastic:
    """The linear system of an elastic mesh whose vertices are attracted by goals.

    The goals have weights `pull` (n,) in [0, 1]; edges resist them over a length, at unit area.
    """

    def __init__(self, rest_mesh: RestMesh, pull: Floats, length: float, pins: Pins) -> None:
        self._rest_mesh = rest_mesh
        self._smoothing = ScreenedSmoothing.of(
            np.maximum(pull, MIN_PULL) * rest_mesh.areas, rest_mesh.stiffness, length
        )
        self._system = PinnedSystem(self._smoothing.factors, pins)
        self._averaging = self._smoothing if length > rest_mesh.averaging.length else rest_mesh.averaging

    def solve(self, goals: Floats, loads: Floats) -> Floats:
        """(n, 3) positions attracted by goals (n, 3), with resisting edges, see `RestMesh.loads`."""
        return self._system.solve(self._smoothing.loads(goals, loads))

    def turns(self, positions: Floats, some: Integers | slice = slice(None)) -> Floats:
        """(s, 3, 3) rotations of some vertices (s,) from rest to positions (n, 3), averaged around each vertex."""
        rest_mesh = self._rest_mesh
        products = products_of_gradients(rest_mesh.stiffness, positions, rest_mesh.rest)
        # Edges of a flat patch do not determine the rotation of its normals, so add these.
        size = rest_mesh.areas * rest_mesh.scales * rest_mesh.handedness
        normals = vertex_normals(positions, rest_mesh.corners)
        products += size[:, None, None] * normals[:, :, None] * rest_mesh.normals[:, None, :]
        # Columns stay contiguous, as the solver returns them, because rotations are computed from columns.
        averaged = np.asfortranarray(self._averaging.solve(products.reshape(-1, 9))[some]).reshape(-1, 3, 3)
        sense = rest_mesh.handedness[some, None, None]
        return sense * nearest_rotations(sense * averaged)

    def release(self, pull: Floats, vertices: Integers) -> Patch:
        """The system with other weights (n,) of the goals, at some vertices (c,); the others stay where they are."""
        weights = np.maximum(pull, MIN_PULL) * self._rest_mesh.areas
        rows = csr_array(screened_stiffness(weights, self._rest_mesh.stiffness, self._smoothing.length))[vertices]
        own = csc_array(rows[:, vertices])
        return Patch(vertices, replace(self._smoothing, weights=weights, factors=factorise(own)), rows)

    def smooth(self, values: Floats) -> Floats:
        """Values (n, d), smoothed where vertices have goals, and extrapolated where they have none."""
        return self._smoothing.smooth(values)


@dataclass(frozen=True, eq=False)
class Patch:
    """The linear system of an elastic mesh at some of its vertices; the others have given values."""

    vertices: Integers  # (c,)
    smoothing: ScreenedSmoothing  # the weights of all n vertices, and the factors of the system of the patch
    rows: csr_array  # (c, n) the rows of the system of all vertices

    def solve(self, goals: Floats, loads: Floats, positions: Floats) -> Floats:
        """(n, 3) solutions for goals (n, 3) and loads (n, 3), see `Elastic.solve`; elsewhere positions (n, 3)."""
        residual = self.smoothing.loads(goals, loads)[self.vertices] - self.rows @ positions
        solved = positions.copy()
        solved[self.vertices] += self.smoothing.solve(residual)
        return solved

    def smooth(self, values: Floats, smoothed: Floats) -> Floats:
        """(n, d) values (n, d), smoothed in the patch; elsewhere smoothed values (n, d)."""
        return self.solve(values, np.zeros_like(values), smoothed)
