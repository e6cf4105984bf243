# SPDX-License-Identifier: GPL-3.0-or-later
"""The two sides of a match: the input surfaces and the analyses of their main parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats, Integers, to_array
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import MAX_COORDINATE, measurable, vertex_numbers
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import as_message, message

if TYPE_CHECKING:
    from zoomout_core.matching.preparation.analysis import ShapeAnalysis

REPEATED = "Landmark {number} is the same pair as landmark {original}: it counts once."
# Distance, at unit area, up to which a landmark is at the nearest vertex: rounding in single precision. No closest
# point is searched then, which would take longer than the rest of a first look at cached shapes.
ON_SURFACE = 1e-6
# A landmark is rejected if it is farther than this from its surface, at unit area.
MAX_LANDMARK_DISTANCE = 0.05
# A landmark on a loose part is on the main part if that is within this distance, at unit area: lashes touch the lids.
MAX_JOINT_DISTANCE = 1e-3


class LandmarkError(MeshError):
    """A landmark that cannot be used.

    Attributes:
        role: the surface that it should be on, "source" or "target".
        number: its index in the list.
        fault: the problem and its solution, as the rest of a sentence about it.
    """

    def __init__(self, role: str, number: int, fault: str) -> None:
        super().__init__(f"Landmark {{number}} on the {role}, {{fault}}", number=number, fault=as_message(fault))
        self.role, self.number, self.fault = role, number, fault


@dataclass(frozen=True, eq=False)
class Pair:
    """Two surfaces with the analyses of their main parts."""

    source: Surface  # the surface that the map lands on
    target: Surface  # the surface that the map starts from
    source_shape: ShapeAnalysis  # the source's main part
    target_shape: ShapeAnalysis  # the target's main part
    k_final: int  # size of the final functional map
    step: int  # growth of the functional map in an iteration
    exact_landmarks: tuple[ArrayLike, ArrayLike] | None = None  # which the final map has to meet
    regions: Sequence[tuple[Integers, Integers]] = ()  # source and target vertices that correspond as sets
    notes: tuple[str, ...] = ()  # sentences for the user about the two surfaces, for any map
    shares: Floats = field(default_factory=lambda: np.ones(1))  # (c,) of the source's outside, by component


def positions_of_part(surface: Surface, shape: ShapeAnalysis) -> Floats:
    """(n, 3) the vertices of a shape's part in the surface's own frame and unit."""
    part = shape.proxy.full
    if part.is_hull:
        return part.to_surface(part.vertices)
    # Bit-equal to the surface's own: two surfaces in one place are in one place here, too.
    return surface.vertices[part.surface_vertex]


def target_in_space(pair: Pair) -> Floats:
    """(n, 3) the vertices of the target's part, where it is in space, in the frame of the source's part."""
    return pair.source_shape.proxy.full.from_surface(positions_of_part(pair.target, pair.target_shape))


def landmark_points(pair: Pair, landmarks: tuple[ArrayLike, ArrayLike]) -> tuple[Floats, Floats]:
    """(m, 3) and (m, 3) corresponding points of the source and of the target, in their own frames and units."""
    arrays = (np.atleast_1d(np.asarray(given)) for given in landmarks)
    source, target = (
        surface.vertices[array] if array.ndim == 1 else array.astype(float)
        for surface, array in zip((pair.source, pair.target), arrays, strict=True)
    )
    return source, target


def distinct_landmarks(
    landmarks: tuple[ArrayLike, ArrayLike] | None,
) -> tuple[tuple[ArrayLike, ArrayLike] | None, tuple[str, ...]]:
    """Landmarks without repeated pairs, and notes on the repetitions.

    Raises:
        MeshError: two of them contradict each other.
    """
    if landmarks is None or len(landmarks) != 2:
        return landmarks, ()
    both = source, target = tuple(np.atleast_1d(to_array(given, "Landmarks")) for given in landmarks)
    usable = all(given.ndim <= 2 and given.dtype.kind in "iuf" for given in both)
    if not usable or not 0 < len(source) == len(target):
        return landmarks, ()  # `landmarks_on_parts` raises the error
    same = [(given[:, None] == given).reshape(len(given), len(given), -1).all(axis=2) for given in both]
    for (role, here), (other, there) in permutations(zip(("source", "target"), same, strict=True)):
        first, second = (np.argwhere(np.triu(here & ~there, 1)).tolist() or [(0, 0)])[0]
        if first < second:
            raise MeshError(
                f"Landmarks {{first}} and {{second}} are at the same point on the {role}, but at different points on "
                f"the {other}: remove one of them.",
                first=first,
                second=second,
            )
    original = np.argmax(same[0], axis=1)
    again = np.flatnonzero(original < np.arange(len(original)))
    if not len(again):
        return landmarks, ()
    notes = tuple(message(REPEATED, number=one, original=original[one]) for one in again)
    return (np.delete(source, again, axis=0), np.delete(target, again, axis=0)), notes


def landmarks_on_parts(pair: Pair, landmarks: tuple[ArrayLike, ArrayLike]) -> tuple[Integers, Integers]:
    """Landmarks as vertices of the shapes' meshes.

    Args:
        pair: the two surfaces.
        landmarks: places on the source and on the target. Each is vertex numbers (m,), or points (m, 3) in the
            surface's own frame and unit, which are projected to the surface.

    Raises:
        ValueError: the arrays are neither vertices nor points, or their lengths differ.
        LandmarkError: a landmark is not on the main part, or not on the surface.
    """
    if len(landmarks) != 2 or (isinstance(landmarks, np.ndarray) and landmarks.shape[1:] == (2,)):
        raise ValueError(
            "Give landmarks as two lists, one of the source and one of the target, instead of a list of pairs."
        )
    source = _on_part("source", pair.source, pair.source_shape, landmarks[0])
    target = _on_part("target", pair.target, pair.target_shape, landmarks[1])
    if len(source) != len(target):
        raise ValueError(
            f"There are {len(source)} source and {len(target)} target landmarks: give one on each side for every pair."
        )
    return source, target


def _on_part(role: str, surface: Surface, shape: ShapeAnalysis, given: ArrayLike) -> Integers:
    """(m,) the vertices of the shape's mesh that are nearest to landmarks on the surface."""
    array = np.atleast_1d(to_array(given, f"Landmarks on the {role}"))
    if array.size == 0:
        raise ValueError(f"There are no landmarks on the {role}: give some, or leave them out on both sides.")
    if array.ndim == 2:
        corners, barycentric = on_surface(role, surface, array)
        corners, barycentric = _prefer_main_part(surface, shape, array, corners, barycentric)
    else:
        corners = vertex_numbers(array, len(surface.vertices), f"Landmarks on the {role}")[:, None]
        barycentric = np.ones(corners.shape)
    on_part = shape.proxy.full.vertex_of[corners]
    astray = np.flatnonzero((on_part < 0).any(axis=1))
    if len(astray):
        fault = message("at vertex {vertex}, is not on its main part: move it.", vertex=corners[astray[0], 0])
        raise LandmarkError(role, int(astray[0]), fault)
    places = np.einsum("mc,mcx->mx", barycentric, shape.proxy.full.vertices[on_part])
    return np.asarray(scipy.spatial.cKDTree(shape.proxy.vertices).query(places)[1])


def _prefer_main_part(
    surface: Surface, shape: ShapeAnalysis, points: Floats, corners: Integers, barycentric: Floats
) -> tuple[Integers, Floats]:
    """The places (m, 3) of points (m, 3) in triangles, moved to the main part where that is equally near."""
    on_part = shape.proxy.full.vertex_of >= 0
    other = np.flatnonzero(~on_part[corners].all(axis=1))
    triangles = surface.triangles[on_part[surface.triangles].all(axis=1)]
    if not len(other) or not len(triangles):
        return corners, barycentric
    triangle, weights = closest_points(points[other], surface.vertices, triangles)
    off = np.einsum("mc,mcx->mx", weights, surface.vertices[triangles[triangle]]) - points[other]
    there = np.linalg.norm(off, axis=1) < MAX_JOINT_DISTANCE * np.sqrt(surface.area)
    corners[other[there]], barycentric[other[there]] = triangles[triangle[there]], weights[there]
    return corners, barycentric


def on_surface(role: str, surface: Surface, points: Floats) -> tuple[Integers, Floats]:
    """Vertices (m, 3) of the triangles closest to points (m, 3), and (m, 3) barycentric coordinates in them.

    Raises:
        ValueError: these are not finite points.
        LandmarkError: a point is not near the surface.
    """
    if points.shape[1] != 3 or points.dtype.kind not in "iuf" or not np.isfinite(points).all():
        raise ValueError(
            f"Landmarks on the {role} must be vertex numbers (m,) or finite points (m, 3), not {points.dtype} of "
            f"shape {points.shape}."
        )
    near = np.where(measurable(points)[:, None], points, MAX_COORDINATE)  # or squares overflow
    unit = float(np.sqrt(surface.area))
    triangle, barycentric = closest_points(near, surface.vertices, surface.triangles, ON_SURFACE * unit)
    corners = surface.triangles[triangle]
    distance = np.linalg.norm(np.einsum("mc,mcx->mx", barycentric, surface.vertices[corners]) - near, axis=1)
    off = np.flatnonzero(distance > MAX_LANDMARK_DISTANCE * unit)
    if len(off):
        fault = message(
            "at {point}, is {distance:.3g} away from its surface: give points in the mesh's own coordinates and units.",
            point=points[off[0]].tolist(),
            distance=distance[off[0]],
        )
        raise LandmarkError(role, int(off[0]), fault)
    return corners, barycentric
