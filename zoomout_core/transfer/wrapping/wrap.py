# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrap: the source's shape on the target's topology, along a map between them; and the inverse of a match."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, check_fractions
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import ShapeLike, as_placed_surface, place_unused
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals
from zoomout_core.messages import message, plural
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.runtime.progress import Progress, advance, listening, portion, stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.blend import mask_of
from zoomout_core.transfer.rules import Match, map_target
from zoomout_core.transfer.wrapping.cage import cage_of
from zoomout_core.transfer.wrapping.elastic import Pins
from zoomout_core.transfer.wrapping.fit import Fit
from zoomout_core.transfer.wrapping.loose_parts import moves_as_a_whole, with_loose_parts
from zoomout_core.transfer.wrapping.projections import PROJECTION
from zoomout_core.transfer.wrapping.unfold import Unfolding

# Fractions of the progress at the end of reading the map, fitting and unfolding.
READ, FITTED, UNFOLDED = 0.15, 0.75, 0.97
# Fraction of the progress of `reverse_match` at the end of wrapping.
TURNED_ROUND = 0.9


@dataclass(frozen=True, eq=False)
class Wrapped:
    """A target with the source's shape.

    Attributes:
        vertices: (n_t, 3) positions of its vertices, in the source's frame and unit.
        turned_over: number of its triangles that face against their rotated surroundings.
        notes: sentences for the user.

    Example:
        >>> zo.wrap(result, source, target).vertices.shape == target.vertices.shape
        True
    """

    vertices: Floats
    turned_over: int
    notes: tuple[str, ...]


@suggest_names
@memory_in_words
@on_one_blas_thread
def wrap(
    result: Match | SurfaceMap,
    source: ShapeLike,
    target: ShapeLike,
    *,
    smoothness: float = 0.5,
    detail: float = 1.0,
    mask: ArrayLike | None = None,
    landmarks: tuple[ArrayLike, ArrayLike] | None = None,
    subdivided: bool = False,
    progress: Callable[[Progress], object] | None = None,
) -> Wrapped:
    """Give the target's topology the source's shape.

    Vertices are on the source, edges flow evenly, and no face flips. Parts without a partner on the source keep their
    form and follow their surroundings. Loose parts, such as eyes and teeth, rotate and scale as a whole.

    Args:
        result: the match, or only its map, of each target vertex to a point of the source.
        source: the surface with the shape.
        target: the surface that receives it.
        smoothness: how evenly edges flow, in [0, 1]. At 0 vertices stay near their images; at 1 faces keep their form
            as far as the source's surface allows.
        detail: how far to follow the source's detail, from 0 for its coarse form only, with the target's own detail, to
            1 for its surface.
        mask: (n_t,) how far each vertex is wrapped, in [0, 1]; the others keep their form and move along. All, when not
            given.
        landmarks: places on the source and on the target, either vertex numbers (m,) or points (m, 3), which are
            projected to the surface. The target's are moved exactly to the source's.
        subdivided: whether the target is the cage of a subdivision surface (Catmull and Clark 1978). If so, its limit
            surface is fitted to the source, and landmarks are places on the limit surface.
        progress: called with the `Progress`, see `zoomout_core.progress`.

    Raises:
        MeshError: the map is of other surfaces, or no part of the target would be wrapped.
        ValueError: a number is out of its range, or landmarks do not come in pairs.

    Example:
        >>> wrapped = zo.wrap(result, source, target)
        >>> wrapped.vertices.shape == target.vertices.shape
        True
    """
    check_fractions(smoothness=smoothness, detail=detail)
    source, target = as_placed_surface(source), as_placed_surface(target)
    mapped, unit = map_target(result, source, target), float(np.sqrt(source.area))
    weight = mask_of(mask, target)
    mapped = replace(mapped, confidence=mapped.confidence * weight)
    if mapped.has_partner is not None:
        weight = weight * mapped.has_partner
    if not weight.any():
        if mask is None:
            raise MeshError("The target cannot be wrapped, because no vertex has a partner: match again.")
        raise MeshError(
            "No part of the target can be wrapped, because no vertex has both a partner and a weight in the mask: "
            "change the mask, or match again."
        )
    # A bare map lacks it.
    given: Booleans | None = getattr(result, "source_has_partner", None)
    given = np.ones(len(source.vertices), dtype=bool) if given is None else given
    places = _places_of_landmarks(landmarks, source, target)
    pins = _pins(places, target.working.vertex_of[places[0]], len(target.working.vertices), unit)

    with listening(progress), stage("Wrapping"):
        with portion(0, READ):
            fit = Fit(mapped, weight, given, pins, smoothness)
        with portion(READ, FITTED):
            fit.run()
        unfolding = Unfolding(fit)
        with portion(FITTED, UNFOLDED):
            found = unfolding.run()
        advance(UNFOLDED)
        if detail < 1:
            form = fit.form()
            found = form + detail * (found - form)
        turned_over = int(unfolding.turned_triangles(found).sum())
        found = unit * _on_surface(fit, pins.enforce(with_loose_parts(fit, found)), target)
        if subdivided:
            number = target.working.vertex_of
            on_source = np.where(moves_as_a_whole(fit.working, fit.weight), 0.0, fit.weight)[number]
            on_source[number < 0] = 0
            at_limit = _pins(places, places[0], len(found), 1.0)
            found = cage_of(mapped, found, fit.projections.triangle[number], on_source, detail, at_limit)
    return Wrapped(found, turned_over, _notes(fit, turned_over))


@dataclass(frozen=True, eq=False)
class ReversedMatch:
    """The inverse of a match, from each source vertex to a point of the target; see `MatchResult`."""

    surface_map: SurfaceMap
    confidence: Floats
    has_partner: Booleans | None
    source_has_partner: Booleans | None


def reverse_match(result: Match | SurfaceMap, source: Surface, target: Surface) -> ReversedMatch:
    """Invert a match: the map from the source to the target.

    Each vertex of the source takes the closest point of the wrapped target with an agreeing normal.

    Raises:
        MeshError: the map is of other surfaces, or nothing corresponds.
    """
    source, target = place_unused(source), place_unused(target)
    with portion(0, TURNED_ROUND):
        wrapped = wrap(result, source, target)
    with stage("Inverting the match", TURNED_ROUND, 1):
        surface_map = _nearest_on(wrapped.vertices, result, source, target)
        if isinstance(result, SurfaceMap):
            return ReversedMatch(surface_map, np.ones(len(source.vertices)), None, None)
        confidence = surface_map.interpolate(np.asarray(result.confidence))
    return ReversedMatch(surface_map, confidence, getattr(result, "source_has_partner", None), result.has_partner)


def _nearest_on(wrapped: Floats, result: Match | SurfaceMap, source: Surface, target: Surface) -> SurfaceMap:
    """The map of source vertices to the target, wrapped onto the source at positions (n_t, 3)."""
    surface_map = result if isinstance(result, SurfaceMap) else result.surface_map
    outwards = surface_map.interpolate(_vertex_normals(source))
    working = target.working
    corners = target.triangles[working.triangle_of]
    agreement = np.einsum("mx,mx->m", area_normals(wrapped, corners), outwards[corners].sum(axis=1))
    component = working.component[working.triangles[:, 0]]
    inwards = np.zeros(len(target.triangles), dtype=bool)
    inwards[working.triangle_of] = (np.bincount(component, agreement) < 0)[component]
    unit = np.sqrt(source.area)
    search = OrientedSurface(wrapped / unit, target.triangles, inwards, PROJECTION.normal_weight)
    triangle, barycentric, _ = search.closest(source.vertices / unit, _vertex_normals(source))
    return SurfaceMap(triangle, barycentric, target.triangles)


def _vertex_normals(surface: Surface) -> Floats:
    """(n, 3) outward unit normals."""
    return surface.working.vertex_normals[surface.working.vertex_of]


# Landmarks: (m, 3) vertices of the target and (m, 3) their weights, and (m, 3) where they are on the source.
Landmarks: TypeAlias = tuple[Integers, Floats, Floats]


def _places_of_landmarks(given: tuple[ArrayLike, ArrayLike] | None, source: Surface, target: Surface) -> Landmarks:
    if given is None:
        return np.empty((0, 3), dtype=np.int64), np.empty((0, 3)), np.empty((0, 3))
    if len(given) != 2:
        raise ValueError(f"landmarks has {len(given)} lists: give two, of places on the source and on the target.")
    of_source, of_target = given
    (corners, weights), on_target = _places("source", source, of_source), _places("target", target, of_target)
    if len(corners) != len(on_target[0]):
        raise ValueError(
            f"There are {len(corners)} source and {len(on_target[0])} target landmarks: give one on each side for "
            "every pair."
        )
    return *on_target, np.einsum("mc,mcx->mx", weights, source.vertices[corners])


def _pins(landmarks: Landmarks, vertices: Integers, n: int, unit: float) -> Pins:
    """Landmarks as places on a mesh of n vertices, in which the target's triangles have other vertex numbers (m, 3).

    Positions are in a unit of the source's.
    """
    _, weights, there = landmarks
    rows = np.repeat(np.arange(len(there)), 3)
    matrix = csr_array((weights.ravel(), (rows, vertices.ravel())), shape=(len(there), n))
    matrix.eliminate_zeros()
    return Pins(matrix, there / unit)


def _places(role: str, surface: Surface, given: ArrayLike) -> tuple[Integers, Floats]:
    """(m, 3) vertices and (m, 3) weights of landmarks, see `wrap`."""
    array = np.atleast_1d(np.asarray(given))
    if array.ndim == 1:
        array = surface.vertices[vertex_numbers(array, len(surface.vertices), f"Landmarks on the {role}")]
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise ValueError(f"Landmarks on the {role} must be vertex numbers (m,) or finite points (m, 3).")
    triangle, barycentric = closest_points(array.astype(np.float64), surface.vertices, surface.triangles)
    return surface.triangles[triangle], barycentric


def _on_surface(fit: Fit, positions: Floats, target: Surface) -> Floats:
    """(n_t, 3) positions of all vertices of the target; a vertex without a face follows the nearest one with a face."""
    number = target.working.vertex_of
    found = positions[number]
    unused = np.flatnonzero(number < 0)
    if len(unused):
        places = target.working.from_surface(target.vertices[unused])
        near = np.asarray(cKDTree(fit.rest_mesh.rest).query(places)[1])
        offset = np.einsum("nij,nj->ni", fit.turns[near], places - fit.rest_mesh.rest[near])
        found[unused] = positions[near] + fit.rest_mesh.scales[near, None] * offset
    return found


def _notes(fit: Fit, turned_over: int) -> tuple[str, ...]:
    """Sentences for the user."""
    kept = fit.weight == 0
    parts = len(np.unique(fit.working.component[moves_as_a_whole(fit.working, fit.weight)]))
    counted = (
        plural(
            int(kept.sum()),
            "1 vertex without a partner, or outside the mask, keeps its place among its neighbors.",
            "{count:,} vertices without a partner, or outside the mask, keep their shape.",
        ),
        message("Loose parts that follow as rigid pieces: {count}.", count=parts),
        plural(
            turned_over,
            "1 triangle is folded over: place landmarks there, or increase Smoothness.",
            "{count:,} triangles are folded over: place landmarks there, or increase Smoothness.",
        ),
    )
    return tuple(note for note in counted if note.values["count"])
