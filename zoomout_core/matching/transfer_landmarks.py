# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer landmarks from the source of a match to its target, with a confidence for each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.matching.pair import on_surface
from zoomout_core.matching.registration.smooth_warp import (
    WARP,
    Correspondences,
    Samples,
    Warp,
    outward_normals,
    warp,
)
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.surface import vertex_numbers
from zoomout_core.mesh.triangles import area_normals, unit_vectors
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class LandmarkTuning(Tuning, set_by="specimens"):
    """Where to put landmarks, and how sure that is. The numbers were set on jaws.

    Attributes:
        smooth: largest median distance between a warp and the map for which the shapes count as solid bodies. Others,
            such as people in two poses, follow the map.
        normal_weight: the distance that counts as much as a unit difference of normals, in the search of the closest
            point.
        neighbourhood: standard deviation of the Gaussian around a landmark in which its fit is measured.
        error_scale: expected error per unit of the indicators.
        half_confidence: expected error at which confidence is a half: twice the median error.
    """

    smooth: float = tuned(0.01, "at unit area", 0, 1)
    normal_weight: float = tuned(0.02, "at unit area", 0, 1)
    neighbourhood: float = tuned(0.03, "at unit area", 1e-4, 1)
    error_scale: float = tuned(1.6, "1", 0, 100)
    half_confidence: float = tuned(0.004, "at unit area", 1e-6, 1)


LANDMARKS = LandmarkTuning()
# Rounding of the indicators of an error, at unit area, below which they do not tell landmarks apart.
EXACT = 3e-4
# Smallest support of a place by its surroundings, so that errors stay finite.
MIN_SUPPORT = 0.05


class TransferredLandmarks(NamedTuple):
    """Places of landmarks on the target.

    Attributes:
        points: (q, 3) on the target's surface, in its frame and unit.
        confidence: (q,) in [0, 1]; below 0.5 a place should be checked.

    Example:
        >>> points, confidence = zo.transfer_landmarks(result, [3, 90])
        >>> points.shape
        (2, 3)
    """

    points: Floats
    confidence: Floats


class _Feet(NamedTuple):
    """Landmarks on a working mesh: their places (q, 3), and the unit normals (q, 3) there."""

    places: Floats
    normals: Floats


@on_one_blas_thread
def transfer_landmarks(result: MatchResult, points: ArrayLike) -> TransferredLandmarks:
    """Find the places of landmarks on the target of a match.

    Solid bodies, such as bones and teeth, are warped onto each other by a smooth deformation of space that starts from
    the map. It is more exact than the map, and keeps apart the two sides of a thin wall: a landmark on an outer surface
    arrives on the outer surface. The landmarks of other shapes, such as bodies in two poses, follow the map.

    Args:
        result: a match; its source carries the landmarks.
        points: (q, 3) points on or near the source's surface, in its frame and unit; or (q,) numbers of its vertices.

    Raises:
        ValueError: these are neither.
        LandmarkError: a point is not near the source's surface.

    Example:
        >>> found = zo.transfer_landmarks(result, source.vertices[[3, 90]])
        >>> found.points.shape, found.confidence.shape
        ((2, 3), (2,))
    """
    given = np.atleast_1d(np.asarray(points))
    if given.ndim == 1:
        given = result.source.vertices[vertex_numbers(given, len(result.source.vertices), "Landmarks on the source")]
    corners, _ = on_surface("source", result.source, given)
    has_partner = result.source_has_partner[corners].all(axis=1)
    source, target = result.source.working, result.target.working
    with stage("Placing landmarks"):
        normals = outward_normals(source), outward_normals(target)
        feet = _feet(source, normals[0], source.from_surface(given))
        here, there = (
            Samples.of(mesh, each, WARP.points) for mesh, each in zip((source, target), normals, strict=True)
        )
        known = Correspondences.of(result)
        warped = warp(here, there, known)
    mapped = result.surface_map.preimages(result.source, result.target, given)
    by_map = target.from_surface(mapped.interpolate(result.target.vertices))
    off = np.linalg.norm(warped.fit.deform(known.points) - known.partners, axis=1)
    if not np.median(off) <= LANDMARKS.smooth:
        confidence = mapped.interpolate(result.confidence)
        return TransferredLandmarks(target.to_surface(by_map), has_partner * confidence)
    images = warped.fit.deform(feet.places)
    found = _closest(target, normals[1], images, warped.fit.turn(feet.places, feet.normals))
    from_map = np.linalg.norm(found.places - by_map, axis=1)
    expected = _expected_errors(warped, feet.places, from_map, found.agreement)
    return TransferredLandmarks(
        target.to_surface(found.places), has_partner / (1 + (expected / LANDMARKS.half_confidence) ** 2)
    )


class _Found(NamedTuple):
    """Places (q, 3) on the target, and (q,) cosines of its normals there and those that were sought."""

    places: Floats
    agreement: Floats


def _feet(mesh: WorkingMesh, normals: Floats, points: Floats) -> _Feet:
    """The points of a mesh closest to points (q, 3)."""
    triangle, weights = closest_points(points, mesh.vertices, mesh.triangles)
    corners = mesh.triangles[triangle]
    places, turned = (np.einsum("qc,qcx->qx", weights, values[corners]) for values in (mesh.vertices, normals))
    return _Feet(places, unit_vectors(turned))


def _closest(mesh: WorkingMesh, normals: Floats, points: Floats, facing: Floats) -> _Found:
    """The points of a mesh closest to points (q, 3), on sides that face like unit normals (q, 3)."""
    triangles = mesh.triangles
    flipped = np.einsum("mx,mx->m", area_normals(mesh.vertices, triangles), normals[triangles].sum(axis=1)) < 0
    search = OrientedSurface(mesh.vertices, triangles, flipped, LANDMARKS.normal_weight)
    triangle, weights, _ = search.closest(points, facing)
    places, there = (np.einsum("qc,qcx->qx", weights, each[triangles[triangle]]) for each in (mesh.vertices, normals))
    return _Found(places, np.einsum("qx,qx->q", unit_vectors(there), facing))


def _expected_errors(warped: Warp, feet: Floats, from_map: Floats, agreement: Floats) -> Floats:
    """(q,) expected errors of landmarks, at unit area.

    Two indicators are estimates of an error: the distance from the place by the map, and the distance that less
    stiffness moved it. Their geometric mean is scaled by how freely the data let the place slide, and divided by how
    well surroundings and normals fit.

    Args:
        warped: the warp of the source.
        feet: (q, 3) the landmarks on the source.
        from_map: (q,) distances between their places by the warp and by the map.
        agreement: (q,) cosines of the warped source's normals and the target's.
    """
    by_stiffness = np.linalg.norm(warped.fit.deform(feet) - warped.stiffer.deform(feet), axis=1)
    squared = ((feet[:, None] - warped.places) ** 2).sum(axis=2)
    near = np.exp(-squared / (2 * LANDMARKS.neighbourhood**2))
    fitting = near @ warped.weight / np.maximum(near.sum(axis=1), 1e-300)
    support = np.maximum(fitting * np.maximum(agreement, 0), MIN_SUPPORT)
    indicators = np.sqrt((from_map + EXACT) * (by_stiffness + EXACT))
    return np.asarray(LANDMARKS.error_scale * indicators * warped.fit.deviations(feet) / support)
