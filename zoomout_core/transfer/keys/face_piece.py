# SPDX-License-Identifier: GPL-3.0-or-later
"""Deform a part of the source's face onto the target.

Its displacement u minimises the bending energy of a discrete thin plate (Botsch and Kobbelt, An intuitive framework for
real-time freeform modeling, 2004) and the distances to the target,

    b u^T L A^-1 L u + sum_i a_i |P_i (x_i + u_i - q_i)|^2,

where L is the stiffness, A the areas, q the closest points with similar normals, and P weighs distances along the
surface less than those across it (Chen and Medioni 1992). Guides attract features, and keep them apart.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import SuperLU
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, row_norms
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.maps.surface_map import SurfaceMap, interpolation_matrix
from zoomout_core.mesh.triangles import unit_vectors, vertex_areas, vertex_normals
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.transfer.frames import on_working_mesh
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FaceRegistrationTuning(Tuning, set_by="faces"):
    """How the face of a source is deformed. All lengths are relative to the square root of its area, about 25 cm.

    Attributes:
        bending: factor of the bending energy in each round. The first round aligns features above about 14 mm, the last
            one those above 1.5 mm. Rounds that end at 1e-8 give the same errors of keys, but tear a half more edges. A
            further round at 1e-10 tears as many, and leaves larger gaps between closed lids.
        first_bending: factor of the bending energy of the deformation that the map implies. It smooths the map's
            errors over 2 cm.
        normal_weight: distance equivalent to a unit difference of normals in the search for closest points. Larger
            values align bumps and folds that two persons do not share. Half of it matches lids better and lips worse.
        side_weight: distance equivalent to a unit difference of the sides of the mouth in that search.
        rim_weight: weight of the attraction between a vertex on the rim of a lid or lip and the corresponding place on
            the target. Five times as much gives similar errors on the heads used for tuning, but enlarges the largest
            gap between lids by a sixth.
        iterations: conjugate gradient steps of a round.
        moved: the face consists of the vertices that keys move by more than this share of the largest motion.
    """

    bending: tuple[float, ...] = tuned((1e-5, 1e-7, 1e-9), "at unit area", 1e-12, 1)
    first_bending: float = tuned(1e-4, "at unit area", 1e-12, 1)
    normal_weight: float = tuned(0.05, "at unit area", 0, 10)
    side_weight: float = tuned(0.05, "at unit area", 0, 10)
    rim_weight: float = tuned(4.0, "mean areas of vertices", 0, 1000)
    iterations: int = tuned(15, "steps", 1, 1000)
    moved: float = tuned(0.02, "1", 0, 1)


FACE_REGISTRATION = FaceRegistrationTuning()
SLIDING = 0.1  # weight of a squared distance along the surface against one across it
COMPATIBLE = 0.3  # smallest cosine between normals of partners
OUTLIER = 6.0  # scale of robust weights, in medians of the distances
SOLVED = 1e-3  # share of the first residual at which conjugate gradients end
MARGIN = 0.1  # around the vertices that keys move: the face is registered along with its surroundings
# A face with fewer vertices has no details to register. Images farther than this from the target, or from the map's
# images, are wrong.
MIN_VERTICES, NEAR, MAX_CHANGE = 500, 0.01, 0.1
# If less than this share of the face's area is registered, target and source differ too much, and the map is kept.
MIN_REGISTERED = 0.8


@dataclass(frozen=True, eq=False)
class FacePiece:
    """A part of the source around what keys move, and the part of the target that is mapped to it.

    Both are in the coordinates of the source's part.
    """

    mesh: WorkingMesh  # n vertices, of unit area
    vertices: Integers  # (t,) vertices of the target's working mesh
    places: Floats  # (t, 3) their positions
    triangles: Integers  # (m, 3) between them, wound outwards
    images: csr_array  # (t, n) interpolates from the source's part to the map's images

    @classmethod
    def of(cls, moved: Booleans, component: int, mapped: MappedTarget) -> FacePiece | None:
        """The surroundings of the moved vertices, of all (n_s,), in a component; None if they are too coarse."""
        source, target = mapped.source.working, mapped.target.working
        inside = source.component == component
        moved = moved & inside
        if not moved.any():
            return None
        reach = MARGIN * np.sqrt(vertex_areas(source.vertices, source.triangles)[moved].sum())
        inside &= cKDTree(source.vertices[moved]).query(source.vertices, distance_upper_bound=reach)[0] < reach
        if not inside[source.triangles].all(axis=1).any():
            return None
        mesh, _ = source.piece(inside)

        number = np.full(len(mapped.source.triangles), -1)
        number[mesh.triangle_of] = np.arange(len(mesh.triangles))
        image = on_working_mesh(target, number[mapped.surface_map.triangle])
        weights = on_working_mesh(target, mapped.surface_map.barycentric)
        chosen = image >= 0
        kept = chosen[target.oriented_triangles].all(axis=1)
        vertices = np.unique(target.oriented_triangles[kept])
        if min(len(vertices), len(mesh.vertices)) < MIN_VERTICES:
            return None
        renumbered = np.full(len(chosen), -1)
        renumbered[vertices] = np.arange(len(vertices))
        images = interpolation_matrix(mesh.triangles[image[vertices]], weights[vertices], len(mesh.vertices))
        own = target.vertices[vertices]
        places = procrustes(own, images @ mesh.vertices)(own)
        return cls(mesh, vertices, places, renumbered[target.oriented_triangles[kept]], images)

    def register(self, mapped: MappedTarget, guides: Guides) -> MappedTarget | None:
        """The target with images on the deformed part of the source; None if this differs too much."""
        triangle, barycentric, found = self.locate(self.deform(guides), guides)
        if self.areas @ found < MIN_REGISTERED * self.areas.sum():
            return None
        number = np.full(len(mapped.target.working.vertices), -1)
        number[self.vertices[found]] = np.flatnonzero(found)
        vertex_of = mapped.target.working.vertex_of
        at = np.where(vertex_of >= 0, number[vertex_of], -1)
        changed = np.flatnonzero(at >= 0)
        old = mapped.surface_map
        triangles, weights = old.triangle.copy(), old.barycentric.copy()
        triangles[changed], weights[changed] = self.mesh.triangle_of[triangle[at[changed]]], barycentric[at[changed]]
        return replace(mapped, surface_map=SurfaceMap(triangles, weights, old.source_triangles))

    @cached_property
    def normals(self) -> Floats:
        """Outward unit normals (t, 3) of the target."""
        return vertex_normals(self.places, self.triangles)

    @cached_property
    def areas(self) -> Floats:
        """Areas (t,) of the target's vertices."""
        return vertex_areas(self.places, self.triangles)

    @cached_property
    def _energy_and_areas(self) -> tuple[csc_array, Floats]:
        """(n, n) the bending energy of the source's part, and (n,) areas of its vertices."""
        stiffness, areas = mesh_laplacian(self.mesh.vertices, self.mesh.triangles)
        areas = np.maximum(areas, 1e-3 * areas.mean())  # bounds the energy of slivers
        return csc_array(stiffness @ diags_array(1 / areas) @ stiffness), areas

    @cached_property
    def first_displacement(self) -> Floats:
        """The smooth displacement (n, 3) that the map implies."""
        missed = self.places - self.images @ self.mesh.vertices
        weighted = csc_array(self.images.T @ diags_array(self.areas))
        bending = FACE_REGISTRATION.first_bending * self._energy_and_areas[0]
        factors = factorise(csc_array(bending + weighted @ self.images))
        return np.asarray(factors.solve(np.asfortranarray(weighted @ missed)))

    def deform(self, guides: Guides) -> Floats:
        """Positions (n, 3) of the vertices on the target."""
        mesh, displacement, pins = self.mesh, self.first_displacement, guides.pins
        energy, areas = self._energy_and_areas
        unflipped = np.zeros(len(self.triangles), dtype=bool)
        there = _searchable(self.places, self.triangles, unflipped, guides.there)
        for factor, rounds in Counter(FACE_REGISTRATION.bending).items():
            bending = csc_array(factor * energy)
            factors = factorise(csc_array(bending + diags_array(areas / 2 + pins.weight)))
            for _ in range(rounds):
                places = mesh.vertices + displacement
                normals = vertex_normals(places, mesh.oriented_triangles)
                triangle, weights, distance = there.closest(places, normals, traits=guides.here)
                corners = self.triangles[triangle]
                goals, facing = (
                    np.einsum("nc,ncx->nx", weights, values[corners]) for values in (self.places, self.normals)
                )
                facing = unit_vectors(facing)
                agree = np.einsum("nx,nx->n", facing, normals) > COMPATIBLE
                scale = OUTLIER * np.median(distance) + 1e-6
                weight = areas * agree / (1 + (distance / scale) ** 2) ** 2
                data = _Residuals(weight, facing, pins)
                start = data.towards(goals, places) - bending @ displacement
                displacement = displacement + _solve(bending, data, factors, start)
        return np.asarray(mesh.vertices + displacement)

    def locate(self, moved: Floats, guides: Guides) -> tuple[Integers, Floats, Booleans]:
        """The target's vertices on the face with moved vertices (n, 3).

        Returns triangles (t,), barycentric coordinates (t, 3), and a mask (t,) of the vertices that were found.
        """
        mesh = self.mesh
        here = _searchable(moved, mesh.triangles, mesh.flipped, guides.here)
        triangle, weights, distance = here.closest(self.places, self.normals, traits=guides.there)
        corners = mesh.triangles[triangle]
        normals = vertex_normals(moved, mesh.oriented_triangles)
        agree = np.einsum("tc,tcx,tx->t", weights, normals[corners], self.normals) > 0
        change = row_norms(np.einsum("tc,tcx->tx", weights, mesh.vertices[corners]) - self.images @ mesh.vertices)
        return triangle, weights, agree & (distance < NEAR) & (change < MAX_CHANGE)


@dataclass(frozen=True, eq=False)
class Guides:
    """Constraints that keep features of a face in place while it is deformed."""

    pins: Pins
    here: Floats  # (n, 1) sides of the mouth at the source's vertices, as lengths; see `sides_of_mouth`
    there: Floats  # (t, 1) at the target's

    @classmethod
    def none(cls, piece: FacePiece) -> Guides:
        """No guides."""
        pins = Pins.of(np.empty(0, dtype=np.int64), np.empty((0, 3)), piece.mesh, np.zeros(3))
        return cls(pins, np.zeros((len(piece.mesh.vertices), 1)), np.zeros((len(piece.places), 1)))


@dataclass(frozen=True, eq=False)
class Pins:
    """Places that attract vertices, as seen along a direction."""

    weight: Floats  # (n,)
    goals: Floats  # (n, 3)
    direction: Floats  # (3,)

    @classmethod
    def of(cls, chosen: Integers, shifts: Floats, mesh: WorkingMesh, direction: Floats) -> Pins:
        """Attract some vertices (c,) of a mesh by their positions after shifts (c, 3)."""
        weight, goals = np.zeros(len(mesh.vertices)), mesh.vertices.copy()
        weight[chosen] = FACE_REGISTRATION.rim_weight / len(mesh.vertices)  # the mesh is of unit area
        goals[chosen] += shifts
        return cls(weight, goals, direction)

    def of_values(self, values: Floats) -> Floats:
        """The product (n, 3) of the quadratic form with values (n, 3)."""
        along = np.outer(values @ self.direction, self.direction)
        return np.asarray(self.weight[:, None] * (values - along))


@dataclass(frozen=True, eq=False)
class _Residuals:
    """The quadratic form of the distances from goals, mainly across the surface, and from pins."""

    weight: Floats  # (n,)
    normals: Floats  # (n, 3)
    pins: Pins

    def of(self, values: Floats) -> Floats:
        """Its product (n, 3) with values (n, 3)."""
        return self._across(values) + self.pins.of_values(values)

    def towards(self, goals: Floats, places: Floats) -> Floats:
        """The forces (n, 3) on positions (n, 3) towards goals (n, 3) on the surface, and towards the pins."""
        return self._across(goals - places) + self.pins.of_values(self.pins.goals - places)

    def _across(self, values: Floats) -> Floats:
        across = np.einsum("nx,nx->n", values, self.normals)[:, None] * self.normals
        return np.asarray(self.weight[:, None] * (SLIDING * values + (1 - SLIDING) * across))


def _searchable(vertices: Floats, triangles: Integers, flipped: Booleans, traits: Floats) -> OrientedSurface:
    """Triangles (m, 3) for searches of closest points with similar normals and traits (n, 1) of the vertices (n, 3)."""
    of_triangles = traits[triangles].mean(axis=1)
    return OrientedSurface(vertices, triangles, flipped, FACE_REGISTRATION.normal_weight, traits=of_triangles)


def _solve(bending: csc_array, data: _Residuals, factors: SuperLU, right: Floats) -> Floats:
    """Solve the normal equation with the right side (n, 3) by preconditioned conjugate gradients."""
    solution, residual = np.zeros_like(right), right
    direction = preconditioned = factors.solve(np.asfortranarray(residual))
    product = first = float((residual * preconditioned).sum())
    for _ in range(FACE_REGISTRATION.iterations):
        if product <= SOLVED**2 * first:
            break
        image = bending @ direction + data.of(direction)
        step = product / float((direction * image).sum())
        solution, residual = solution + step * direction, residual - step * image
        preconditioned = factors.solve(np.asfortranarray(residual))
        before, product = product, float((residual * preconditioned).sum())
        direction = preconditioned + product / before * direction
    return solution
