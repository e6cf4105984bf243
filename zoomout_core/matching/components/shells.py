# SPDX-License-Identifier: GPL-3.0-or-later
"""Extend the map between two hulls to the shells inside them.

The map of the hulls moves all shells. A shell of the target with a partner on the source is registered to it by a
similarity. Other shells map to the nearest points of the source, outer parts to outer parts.

Lengths are at unit area of the hull.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.overlap import leaves_in_place, overlapping
from zoomout_core.matching.components.part_motions import MovedTarget
from zoomout_core.matching.components.parts import MAX_PAIRED_PARTS, Part, Side
from zoomout_core.matching.components.shell_images import (
    SHELL_IMAGES,
    Image,
    find_beneath,
    find_beyond,
    find_caps,
    find_covered,
    map_onto_partner,
    move_to_parts,
    near_hull,
    uncover,
)
from zoomout_core.matching.components.shell_pairs import pair_shells
from zoomout_core.matching.components.similarity_field import SimilarityField, transform_in_blocks
from zoomout_core.matching.constraints import PINNING_WIDTH
from zoomout_core.matching.pair import Pair, landmark_points
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.registration.nonrigid_icp import Fit, replace_images
from zoomout_core.tuning import Tuning, tuned

# Tolerance of distances between the source and the moved target, at unit area, small beside `half_distance`.
APART_TOLERANCE = 0.01


@dataclass(frozen=True)
class ShellTuning(Tuning, set_by="characters"):
    """The motion of shells, and the confidence in their images."""

    # Where the fit of the hulls was rejected, but their map has less confidence than this, the fit moves shells anyway.
    # The fit follows its surroundings, whereas the map may have exchanged the toes of a foot.
    doubtful: float = tuned(0.3, "1", 0, 1)
    half_distance: float = tuned(0.045, "at unit area", 1e-6, 1)  # off the hulls' map that halves the confidence
    # Vertices farther from their shell's partner keep their image by the body's map. Below 0.15, parts of robots of
    # other builds lose their partners.
    beside: float = tuned(0.2, "at unit area", 0, 1)
    faded: float = tuned(0.01, "1", 0, 1)  # vertices that a landmark moves by a smaller share of its motion stay
    pair_confidence: float = tuned(0.9, "1", 0, 1)  # confidence in a pair whose edges keep their lengths
    half_stretch: float = tuned(0.5, "1", 1e-6, 10)  # mean relative change of length that halves this confidence
    whole: float = tuned(0.95, "1", 0, 1)  # minimum share of its surface's area that makes a shell nearly all of it


SHELLS = ShellTuning()


@dataclass(frozen=True, eq=False)
class ShellMap:
    """The map of two surfaces' shells."""

    surface_map: SurfaceMap  # between the working meshes
    confidence: Floats  # (n,) of the target's working vertices
    partners: Partners  # which vertices of the working meshes have a partner
    paired: int  # number of the target's shells that are registered to their partners
    alone: float  # the part of the target's area that is far from the source after the motion
    in_place: bool  # whether the two surfaces overlap, and are not moved


def map_shells(pair: Pair, fit: Fit, confidence: Floats, of_hulls: Partners) -> ShellMap:
    """Map the shells of two surfaces, given the map between their hulls, its confidence (n,) and its partners."""
    source = Side.of(pair.source, pair.source_shape.proxy.full)
    target = Side.of(pair.target, pair.target_shape.proxy.full)
    motion, in_place = _motion(pair, fit, confidence, target)
    points, normals, around = transform_in_blocks(motion, target.points, target.mesh.vertex_normals)
    moved = MovedTarget(points, normals, motion, in_place)
    image = _map_outsides(pair, moved, source, target)
    confidence = np.clip(around, 0, 1) / (1 + (image.distance / SHELLS.half_distance) ** 2)
    has_partner = _find_partners(pair, points, image.distance, source, target, None if in_place else of_hulls)
    paired = _map_pairs(image, confidence, has_partner, pair, moved, source, target)
    surface_map = SurfaceMap(image.triangle, image.barycentric, source.mesh.triangles)
    if pair.exact_landmarks is not None:
        surface_map = _pin(surface_map, landmark_points(pair, pair.exact_landmarks), source, target, pair)
    alone = float(target.areas[image.distance > SHELLS.half_distance].sum() / target.areas.sum())
    return ShellMap(surface_map, confidence, has_partner, paired, alone, in_place)


def _map_outsides(pair: Pair, moved: MovedTarget, source: Side, target: Side) -> Image:
    """The images of all vertices, those of outer parts on visible outer parts."""
    points, normals, _, in_place = moved
    of_source, of_target = near_hull(source, pair.source_shape), near_hull(target, pair.target_shape)
    image = find_beneath(points, normals, source, of_source, of_target, in_place)
    visible, may_lift = of_source & ~find_covered(source, of_source), of_target & ~find_covered(target, of_target)
    if not in_place:
        uncover(image, points, normals, source, visible, may_lift)
    among = np.flatnonzero(visible[source.mesh.triangles].any(axis=1) | in_place)
    move_to_parts(image, moved, of_target, among, source, target)
    return image


def _map_pairs(
    image: Image,
    confidence: Floats,
    has_partner: Partners,
    pair: Pair,
    moved: MovedTarget,
    source: Side,
    target: Side,
) -> int:
    """Move the images of shells onto their partners, in place, with confidence (n,); returns the number of pairs."""
    points, _, motion, in_place = moved
    ours, theirs = target.parts(points), source.parts(source.points)
    # A single shell is a whole body, and cannot be the partner of a piece.
    if min(len(ours), len(theirs)) <= 1:
        return 0
    most = MAX_PAIRED_PARTS
    partners, motions = pair_shells(pair, motion, ours[:most], theirs[:most], source, target)
    if partners and _is_one_skin(partners, ours, theirs, target, source):
        partners, motions = partners[1:], motions[1:]
    if not partners:
        return 0
    mesh, component = source.mesh, source.mesh.component[source.mesh.triangles[:, 0]]
    shells = OrientedSurface(source.points, mesh.triangles, mesh.flipped, SHELL_IMAGES.normal_weight, component)
    margin = SHELL_IMAGES.cover if in_place else SHELLS.half_distance  # errors of the body's map
    for (i, j), similarity in zip(partners, motions, strict=True):
        part = ours[i]
        onto, stretch = map_onto_partner(part, j, similarity, moved, shells, source, target)
        on = onto.distance < np.maximum(SHELLS.beside, image.distance[part.vertices])
        on &= ~find_beyond(image, onto, part, j, component, margin)
        vertices = part.vertices[on]
        image.triangle[vertices], image.barycentric[vertices] = onto.triangle[on], onto.barycentric[on]
        image.distance[vertices] = onto.distance[on]
        confidence[vertices] = SHELLS.pair_confidence / (1 + (stretch / SHELLS.half_stretch) ** 2)
        has_partner.target[vertices] = has_partner.source[theirs[j].vertices] = True
    return len(partners)


def _is_one_skin(
    partners: Sequence[tuple[int, int]], ours: Sequence[Part], theirs: Sequence[Part], target: Side, source: Side
) -> bool:
    """Whether the first pair is one skin beside debris, and a piece of the source, such as a body below clothes.

    Remeshing by voxels leaves specks beside a skin, most of them without a partner. The skin is then nearly all of the
    target, shows all parts of the source, and is the partner of none.
    """
    if partners[0][0] != 0:
        return False
    (skin, *others), all_of_target = [target.areas[ours[i].vertices].sum() for i, _ in partners], target.areas.sum()
    partner = source.areas[theirs[partners[0][1]].vertices].sum()
    is_whole = skin >= SHELLS.whole * all_of_target and partner < SHELLS.whole * source.areas.sum()
    return bool(is_whole and sum(others) < (all_of_target - skin) / 2)


def _find_partners(
    pair: Pair, points: Floats, distance: Floats, source: Side, target: Side, of_hulls: Partners | None
) -> Partners:
    """Which vertices of the working meshes are near the other surface after the target is moved to `points` (n, 3).

    `distance` (n,) is that from there to the images on the source. If the hulls move the target, vertices near a place
    of a hull without a partner, by `of_hulls`, have none either.
    """
    on_target = closest_points(source.points, points, target.mesh.triangles, APART_TOLERANCE)
    nearest = SurfaceMap(*on_target, target.mesh.triangles)
    apart = np.linalg.norm(nearest.interpolate(points) - source.points, axis=1)
    near = Partners(distance <= SHELLS.half_distance, apart <= SHELLS.half_distance)
    if of_hulls is None:
        return near
    for side, shape, on_hull, found in (
        (target, pair.target_shape, of_hulls.target, near.target),
        (source, pair.source_shape, of_hulls.source, near.source),
    ):
        found &= on_hull[cKDTree(shape.proxy.vertices).query(side.points)[1]]
    return near


def _pin(between: SurfaceMap, landmarks: tuple[Floats, Floats], source: Side, target: Side, pair: Pair) -> SurfaceMap:
    """Deform a map between working meshes so that each landmark lands on its partner.

    The displacements decay with a Gaussian of the distance on the target. Landmarks are places (m, 3) of the source and
    (m, 3) of the target, in the surfaces' frames and units.
    """
    goals = pair.source_shape.proxy.full.from_surface(landmarks[0])
    vertex = np.asarray(cKDTree(target.points).query(pair.target_shape.proxy.full.from_surface(landmarks[1]))[1])
    images = between.interpolate(source.points)
    distance = np.linalg.norm(target.points[:, None] - target.points[vertex], axis=2)
    kernel = np.exp(-((distance / PINNING_WIDTH) ** 2))
    moves = np.linalg.lstsq(kernel[vertex], goals - images[vertex], rcond=None)[0]
    bent = np.flatnonzero(kernel.max(axis=1) > SHELLS.faded)
    triangles = source.mesh.triangles
    found = closest_points(images[bent] + kernel[bent] @ moves, source.points, triangles)
    return replace_images(between, bent, SurfaceMap(*found, triangles))


def _motion(pair: Pair, fit: Fit, confidence: Floats, side: Side) -> tuple[SimilarityField, bool]:
    """The motion of the target's hull to the source's, in the frames of the hulls, and whether it stays in place.

    Where the hull closes an opening of the target's `side`, such as the waist of a bust, its map does not count.
    """
    source, target = pair.source_shape.proxy, pair.target_shape.proxy
    centre, size = source.frame
    bent = centre + size * fit.positions
    moves = fit.fits | ((confidence < SHELLS.doubtful) & fit.fits.any())
    images = np.where(moves[:, None], bent, fit.surface_map.interpolate(source.vertices))
    places = overlapping(pair)
    basis = pair.target_shape.basis
    if pair.source is not pair.target and places is not None:
        rotations = SimilarityField(places, images, confidence, basis).rotations(places)
        areas = np.where(find_caps(target.vertices, side), 0, basis.areas)
        if leaves_in_place(images, places, areas, rotations):
            return SimilarityField(target.vertices, places, confidence, basis), True
    return SimilarityField(target.vertices, images, confidence, basis), False
