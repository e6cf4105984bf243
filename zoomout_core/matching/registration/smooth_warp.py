# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp the space around the source so that its surface coincides with the target's.

Bones, teeth and other solid bodies differ by smooth deformations of space, which move the two sides of a thin wall
alike. A thin-plate spline therefore places points more exactly than a map that is computed along the surface, and does
not confuse the sides. The spline is first fitted to the map's correspondences. Robust weights ignore regions that the
map sends elsewhere. It is then fitted to closest points with compatible normals, in both directions. Distances across
the surface count most, so that surfaces may slide into place (Chen and Medioni, Object modelling by registration of
multiple range images, 1992).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.thin_plate import ThinPlateBasis, ThinPlateFit
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.triangles import triangle_areas, unit_vectors
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import advance
from zoomout_core.spectral.sampling import farthest_points
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class WarpTuning(Tuning, set_by="specimens"):
    """Parameters of warps, tuned on jaws.

    Attributes:
        centres: number of centres of the spline.
        points: number of samples of each surface among which closest points are searched.
        residuals: number of residuals from each surface.
        correspondences: number of the map's correspondences that the spline starts from.
        first_rounds: fits with robust weights to these.
        rounds: fits to closest points with each stiffness.
        first_stiffness: factor of the bending energy in the fits to correspondences.
        stiffness: the same for each of the successive fits to closest points.
        sliding: weight of a squared distance along the surface against one across it.
        normal_weight: the distance that equals a unit difference of normals.
    """

    centres: int = tuned(150, "points", 4, 2000)
    points: int = tuned(10_000, "points", 100, 1_000_000)
    residuals: int = tuned(2500, "points", 100, 100_000)
    correspondences: int = tuned(3000, "points", 100, 100_000)
    first_rounds: int = tuned(8, "rounds", 1, 100)
    rounds: int = tuned(3, "rounds", 1, 100)
    first_stiffness: float = tuned(1e-4, "1", 0, 10)
    stiffness: tuple[float, ...] = tuned((1e-3, 3e-4, 1e-4), "1", 0, 10)
    sliding: float = tuned(0.05, "1", 0, 1)
    normal_weight: float = tuned(0.05, "at unit area", 0, 1)


WARP = WarpTuning()
# Enough to distinguish smooth warps from others, and for the inverse direction.
ROUGH_WARP = replace(WARP, centres=60, points=4000, residuals=1000, rounds=2)
# Correspondences with less confidence are excluded, if enough remain.
MIN_CONFIDENCE = 0.2
# Scales of Cauchy's weights, in medians of the residuals.
CAUCHY_SCALE, ICP_SCALE = 1.5, 6.0
# Smallest cosine between compatible normals.
COMPATIBLE = 0.5
# Smallest share of the area of a component that may be a cavity: loose flecks of a scan are smaller.
MIN_CAVITY = 0.01
# Smallest scale of residuals, at unit area: below it, all fit exactly.
EXACT = 1e-5


class Samples(NamedTuple):
    """Points on a surface.

    Attributes:
        points: (s, 3) positions that represent equal areas.
        normals: (s, 3) unit normals that point out of the material.
    """

    points: Floats
    normals: Floats

    @classmethod
    def of(cls, mesh: WorkingMesh, normals: Floats) -> Samples:
        """Samples of a mesh with normals (n, 3) at its vertices."""
        points, on = surface_samples(mesh.vertices, mesh.triangles, WARP.points)
        corners = mesh.triangles[on]
        weights, _ = closest_on_triangles(points, *(mesh.vertices[corners[:, i]] for i in range(3)))
        return cls(points, unit_vectors(np.einsum("sc,scx->sx", weights, normals[corners])))

    def thin(self, count: int) -> Samples:
        """Choose at most `count` of them, evenly spread."""
        chosen = evenly(len(self.points), count)
        return Samples(self.points[chosen], self.normals[chosen])

    def rows(self) -> Floats:
        """(s, 6) coordinates for searches of near points with similar normals."""
        return np.hstack([self.points, WARP.normal_weight * self.normals])


@dataclass(frozen=True, eq=False)
class Warp:
    """A surface warped onto another one, each in the frame of its working mesh.

    Attributes:
        fit: the deformation.
        stiffer: the deformation of the first stiffness, which differs from it where the bending energy matters.
        places: (r, 3) places on the surface with a residual.
        weight: (r,) the weights of the residuals in [0, 1].
    """

    fit: ThinPlateFit
    stiffer: ThinPlateFit
    places: Floats
    weight: Floats


def outward_normals(mesh: WorkingMesh) -> Floats:
    """(n, 3) unit vertex normals that point out of the material.

    A closed component inside another one is the wall of a cavity: its normals point into the cavity.
    """
    normals = mesh.vertex_normals.copy()
    corners = mesh.vertices[mesh.oriented_triangles]
    component = mesh.component[mesh.triangles[:, 0]]
    outer = corners[component == 0]
    area = np.bincount(component, triangle_areas(mesh.vertices, mesh.triangles))
    for number in 1 + np.flatnonzero(area[1:] > MIN_CAVITY * area.sum()):
        if winding_number(mesh.vertices[np.argmax(mesh.component == number)], outer) > 0.5:
            normals[mesh.component == number] *= -1
    return normals


def winding_number(point: Floats, corners: Floats) -> float:
    """The winding number of triangles (m, 3, 3) around a point (3,), from their solid angles (Van Oosterom 1983)."""
    a, b, c = np.moveaxis(corners - point, 1, 0)
    of_a, of_b, of_c = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    volume = np.einsum("mx,mx->m", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("mx,mx->m", u, v) for u, v in ((a, b), (b, c), (c, a)))
    solid_angle = 2 * np.arctan2(volume, of_a * of_b * of_c + ab * of_c + bc * of_a + ca * of_b)
    return float(solid_angle.sum() / (4 * np.pi))


class Correspondences(NamedTuple):
    """Points of one surface and their partners on another, some of which may be wrong.

    Attributes:
        points: (c, 3) positions.
        partners: (c, 3) positions on the other surface.
        trust: (c,) weights in [0, 1].
    """

    points: Floats
    partners: Floats
    trust: Floats

    @classmethod
    def of(cls, result: MatchResult) -> Correspondences:
        """Points of the source and their partners on the target, in the frames of the working meshes."""
        source, target = result.source.working, result.target.working
        known = result.has_partner & (target.vertex_of >= 0)
        confident = known & (result.confidence > MIN_CONFIDENCE)
        vertices = np.flatnonzero(confident if confident.sum() > WARP.centres else known)
        vertices = vertices[evenly(len(vertices), WARP.correspondences)]
        points = source.from_surface(result.surface_map.interpolate(result.source.vertices)[vertices])
        partners = target.from_surface(result.target.vertices[vertices])
        return cls(points, partners, np.maximum(result.confidence[vertices], MIN_CONFIDENCE))

    @classmethod
    def of_candidate(cls, result: MatchResult, number: int) -> Correspondences:
        """The few known correspondences of a candidate whose map is not computed yet."""
        at, images = result.outline(number)
        points = result.source.working.from_surface(result.source.vertices[images])
        partners = result.target.working.from_surface(result.target.vertices[at])
        return cls(points, partners, np.ones(len(at)))

    def swap(self) -> Correspondences:
        """The same correspondences, from the other surface."""
        return Correspondences(self.partners, self.points, self.trust)

    def distances(self, fit: ThinPlateFit) -> Floats:
        """(c,) distances between the partners and the images of the points by a deformation."""
        return np.asarray(np.linalg.norm(fit.deform(self.points) - self.partners, axis=1))


def warp(here: Samples, there: Samples, known: Correspondences, how: WarpTuning = WARP) -> Warp:
    """Warp a surface onto another one.

    Args:
        here: samples of the surface that is warped.
        there: samples of the other one.
        known: correspondences to start from.
        how: the numbers of centres, residuals and rounds, and the stiffness.
    """
    basis = ThinPlateBasis(here.points[farthest_points(here.points, how.centres)])
    fit = stiffer = _fit_to_correspondences(known, basis, how)
    rows, inverse, tree = basis.at(here.points), basis.inverse_distances(here.points), cKDTree(there.rows())
    of_here, of_there = (evenly(len(each.points), how.residuals) for each in (here, there))
    schedule = np.repeat(how.stiffness, how.rounds)
    for number, stiffness in enumerate(schedule.tolist()):
        advance(number / len(schedule))
        if number == how.rounds:
            stiffer = fit
        moved = Samples(rows @ fit.coefficients, fit.turn(here.points, here.normals, inverse))
        towards = np.asarray(tree.query(moved.rows()[of_here])[1])
        back = np.asarray(cKDTree(moved.rows()).query(there.rows()[of_there])[1])
        at, goal = np.concatenate([of_here, back]), np.concatenate([towards, of_there])
        normals = there.normals[goal]
        distance = np.linalg.norm(there.points[goal] - moved.points[at], axis=1)
        compatible = np.einsum("rx,rx->r", normals, moved.normals[at]) > COMPATIBLE
        weight = compatible / (1 + (distance / (ICP_SCALE * np.median(distance) + EXACT)) ** 2) ** 2
        across = (1 - how.sliding) * np.einsum("ri,rj->rij", normals, normals) + how.sliding * np.eye(3)
        weights = weight[:, None, None] * across
        fit = ThinPlateFit.of(basis, rows[at], there.points[goal], weights, stiffness * len(at))
    return Warp(fit, stiffer, here.points[at], weight)


def _fit_to_correspondences(known: Correspondences, basis: ThinPlateBasis, how: WarpTuning) -> ThinPlateFit:
    """The deformation fitted to correspondences, robustly."""
    rows, weight = basis.at(known.points), known.trust
    for _ in range(how.first_rounds):
        fit = ThinPlateFit.of(basis, rows, known.partners, weight, how.first_stiffness * len(rows))
        residual = np.linalg.norm(rows @ fit.coefficients - known.partners, axis=1)
        weight = known.trust / (1 + (residual / (CAUCHY_SCALE * np.median(residual) + EXACT)) ** 2)
    return fit


def evenly(count: int, most: int) -> Integers:
    """At most `most` of the numbers below `count`, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
