# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer landmarks from the source of a match to its target, with a confidence for each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.thin_plate import ThinPlateFit
from zoomout_core.matching.pair import on_surface
from zoomout_core.matching.ranking.mirror_image import smoother_mirror_image, warp_back
from zoomout_core.matching.registration.smooth_warp import (
    Correspondences,
    Samples,
    Warp,
    outward_normals,
    warp,
)
from zoomout_core.matching.result import MatchResult, check_result
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.triangles import area_normals, unit_vectors
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.threads import on_one_blas_thread, side_by_side
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class LandmarkTransferTuning(Tuning, set_by="specimens"):
    """Where to put landmarks, and how certain that is. The numbers were set on jaws.

    Attributes:
        smooth: largest median distance between a warp and the map for which the shapes count as solid bodies. Others,
            such as people in two poses, follow the map.
        normal_weight: the distance that counts as much as a unit difference of normals, in the search of the closest
            point.
        neighbourhood: standard deviation of the Gaussian around a landmark in which its surroundings are measured.
        half_confidence: expected error at which confidence is a half.
        bent: bending energy of a warp that halves the confidence of all landmarks.
    """

    smooth: float = tuned(0.025, "at unit area", 0, 1)
    normal_weight: float = tuned(0.02, "at unit area", 0, 1)
    neighbourhood: float = tuned(0.03, "at unit area", 1e-4, 1)
    half_confidence: float = tuned(0.005, "at unit area", 1e-6, 1)
    bent: float = tuned(0.1, "1", 1e-6, 100)


LANDMARK_TRANSFER = LandmarkTransferTuning()
# Rounding of the estimates of an error, at unit area; smaller differences do not distinguish landmarks.
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
    the map. It is more exact than the map, and distinguishes the two sides of a thin wall: a landmark on an outer
    surface arrives on the outer surface. The landmarks of other shapes, such as bodies in two poses, follow the map.

    Args:
        result: a match; its source carries the landmarks.
        points: (q, 3) points on or near the source's surface, in its frame and unit; or (q,) numbers of its vertices.

    Raises:
        TypeError: it is not a result of `match`.
        ValueError: the points are neither.
        LandmarkError: a point is not near the source's surface.

    Example:
        >>> found = zo.transfer_landmarks(result, source.vertices[[3, 90]])
        >>> found.points.shape, found.confidence.shape
        ((2, 3), (2,))
    """
    check_result(result)
    given = np.atleast_1d(np.asarray(points))
    if given.ndim == 1:
        given = result.source.vertices[vertex_numbers(given, len(result.source.vertices), "Landmarks on the source")]
    corners, weights = on_surface("source", result.source, given)
    has_partner = result.source_has_partner[corners].all(axis=1)
    source, target = result.source.working, result.target.working
    with stage("Placing landmarks"):
        normals = outward_normals(source), outward_normals(target)
        feet = _feet(source, normals[0], source.vertex_of[corners], weights)
        here, there = (Samples.of(mesh, each) for mesh, each in zip((source, target), normals, strict=True))
        known = Correspondences.of(result)
        warped, (back, mirrored) = side_by_side(
            lambda: warp(here, there, known), lambda: _look_back(result, here, there, known)
        )
    if not np.median(known.distances(warped.fit)) <= LANDMARK_TRANSFER.smooth:
        mapped = result.surface_map.preimages(result.source, result.target, given)
        places, confidence = mapped.interpolate(result.target.vertices), mapped.interpolate(result.confidence)
        return TransferredLandmarks(places, has_partner * confidence)
    images = warped.fit.deform(feet.places)
    found = _closest(target, normals[1], images, warped.fit.turn(feet.places, feet.normals))
    cycle = np.linalg.norm(back.deform(found.places) - feet.places, axis=1)
    expected = _expected_errors(warped, known, feet.places, cycle, found.agreement)
    plausible = has_partner * (not mirrored) / (1 + (back.bending_energy / LANDMARK_TRANSFER.bent) ** 2)
    confidence = plausible / (1 + (expected / LANDMARK_TRANSFER.half_confidence) ** 2)
    return TransferredLandmarks(target.to_surface(found.places), confidence)


def _look_back(result: MatchResult, here: Samples, there: Samples, known: Correspondences) -> tuple[ThinPlateFit, bool]:
    """The target warped onto the source, and whether a mirrored candidate deforms it less."""
    back = warp_back(here, there, known)
    return back, smoother_mirror_image(result, here, there, back) is not None


class _Found(NamedTuple):
    """Places (q, 3) on the target, and (q,) cosines between its normals there and the wanted ones."""

    places: Floats
    agreement: Floats


def _feet(mesh: WorkingMesh, normals: Floats, corners: Integers, weights: Floats) -> _Feet:
    """The points with weights (q, 3) at vertices (q, 3) of a mesh with normals (n, 3)."""
    places, turned = (np.einsum("qc,qcx->qx", weights, values[corners]) for values in (mesh.vertices, normals))
    return _Feet(places, unit_vectors(turned))


def _closest(mesh: WorkingMesh, normals: Floats, points: Floats, facing: Floats) -> _Found:
    """The points of a mesh closest to points (q, 3), on sides that face like unit normals (q, 3)."""
    triangles = mesh.triangles
    flipped = np.einsum("mx,mx->m", area_normals(mesh.vertices, triangles), normals[triangles].sum(axis=1)) < 0
    search = OrientedSurface(mesh.vertices, triangles, flipped, LANDMARK_TRANSFER.normal_weight)
    triangle, weights, _ = search.closest(points, facing)
    places, there = (np.einsum("qc,qcx->qx", weights, each[triangles[triangle]]) for each in (mesh.vertices, normals))
    return _Found(places, np.einsum("qx,qx->q", unit_vectors(there), facing))


def _expected_errors(warped: Warp, known: Correspondences, feet: Floats, cycle: Floats, agreement: Floats) -> Floats:
    """(q,) expected errors of landmarks, at unit area.

    Three distances estimate the error: the distance by which a second warp, from the target to the source, misses the
    start; the distance by which lower stiffness moves the place; and the distance between the map and the warp around
    the landmark. Their geometric mean is divided by the fit of the surroundings and of the normals.

    Args:
        warped: the warp of the source.
        known: the map's correspondences.
        feet: (q, 3) the landmarks on the source.
        cycle: (q,) distance by which the warp back misses them.
        agreement: (q,) cosines of the warped source's normals and the target's.
    """
    by_stiffness = np.linalg.norm(warped.fit.deform(feet) - warped.stiffer.deform(feet), axis=1)
    near = _gaussian(feet, known.points)
    # A place without correspondences nearby is as doubtful as the worst map that a warp may start from.
    by_map = (near @ known.distances(warped.fit) + LANDMARK_TRANSFER.smooth) / (near.sum(axis=1) + 1)
    estimates = np.cbrt((cycle + EXACT) * (by_stiffness + EXACT) * (by_map + EXACT))
    around = _gaussian(feet, warped.places)
    fitting = around @ warped.weight / np.maximum(around.sum(axis=1), 1e-300)
    return np.asarray(estimates / np.maximum(fitting * np.maximum(agreement, 0), MIN_SUPPORT))


def _gaussian(centres: Floats, points: Floats) -> Floats:
    """(q, n) weights of points (n, 3) around centres (q, 3)."""
    squared = ((centres[:, None] - points) ** 2).sum(axis=2)
    return np.asarray(np.exp(-squared / (2 * LANDMARK_TRANSFER.neighbourhood**2)))
