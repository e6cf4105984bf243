# SPDX-License-Identifier: GPL-3.0-or-later
"""Extend the map between two hulls to the shells inside them.

The hulls' map moves all shells. A shell of the target with a partner on the source is registered to it by a
similarity; all others map to the nearest points of the source, outer parts to outer parts.

Lengths are at unit area of the hull.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter

import numpy as np
import scipy
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_on_triangles, closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface, surface_samples
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.overlap import leaves_in_place, overlapping
from zoomout_core.matching.components.part_borders import straighten_borders
from zoomout_core.matching.components.part_motions import fit_motions
from zoomout_core.matching.components.parts import MAX_PAIRED_PARTS, Part, Side, relation_of
from zoomout_core.matching.components.shell_registration import Shells, register_shells
from zoomout_core.matching.components.similarity_field import SimilarityField
from zoomout_core.matching.constraints import PINNING_WIDTH
from zoomout_core.matching.pair import Pair, landmark_points
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.registration.nonrigid_icp import Fit, replace_images
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.tuning import Tuning, tuned

# Points that are moved at once, which bounds the memory.
AT_ONCE = 50_000
# Samples of all parts, the nearest ones to a vertex among which another part may cover it, as a shirt covers a body,
# and the cosine of the angle to its normal below which a sample is beside it, not above.
COVERING_POINTS, COVERING_NEIGHBOURS, STRAIGHT_ABOVE = 40_000, 32, 0.7
# Tolerance of distances between the source and the moved target, at unit area, small beside `half_distance`.
APART_TOLERANCE = 0.01
# Share of a surface's area that clothes make up at least: the plates of robots, which slide over each other, are less.
COVERING_AREA = 0.1


@dataclass(frozen=True)
class ShellTuning(Tuning, set_by="characters"):
    """How shells are paired, where the others map to, and the confidence in both."""

    rivals: int = tuned(6, "shells", 1, 300)  # candidates, nearest in position and size, to register a shell to
    max_miss: float = tuned(0.3, "sizes of the source's shell", 0, 1)  # maximum residual of the registration of a pair
    max_move: float = tuned(0.17, "at unit area", 0, 1)  # maximum distance of a pair from its place by the body's map
    max_unlike: float = tuned(1.65, "1", 1, 10)  # maximum ratio of the sizes of a pair
    miss_cost: float = tuned(1.0, "1", 0, 10)  # cost of a residual of `max_miss`
    move_cost: float = tuned(1.2, "1", 0, 10)  # cost of a distance of `max_move`
    turn_cost: float = tuned(0.1, "1 / radian", 0, 10)  # cost of a rotation by one radian relative to the body's
    scale_cost: float = tuned(1.0, "1", 0, 10)  # cost of a unit logarithm of the scale relative to the body's
    max_cost: float = tuned(1.5, "1", 0, 10)  # maximum sum of these costs for a pair
    normal_weight: float = tuned(0.02, "at unit area", 0, 1)  # distance that a unit difference of normals counts as
    outside: float = tuned(0.02, "at unit area", 0, 1)  # a vertex nearer to the hull than this is on the outside
    # A part covered by another one, as a body by clothes, must be nearer by this. Covered joints show in other poses.
    cover: float = tuned(0.015, "at unit area", 0, 1)
    inner_reach: float = tuned(0.05, "at unit area", 0, 1)  # distance up to which inner vertices map to inner parts
    # Vertices in place that are nearer to a triangle lie on it, whichever side of it is outside.
    lies_on: float = tuned(0.004, "at unit area", 0, 1)
    # Where the fit of the hulls is rejected, but their map has less confidence, the fit moves shells all the same: it
    # goes along with its surroundings, while the map may have exchanged the toes of a foot.
    doubtful: float = tuned(0.3, "1", 0, 1)
    half_distance: float = tuned(0.045, "at unit area", 1e-6, 1)  # off the hulls' map that halves the confidence
    flush: float = tuned(0.015, "at unit area", 0, 1)  # a shell lies on its partner if half of it is nearer
    # Vertices farther from their shell's partner keep their image by the body's map. Below 0.15, parts of robots of
    # other builds lose their partners.
    beside: float = tuned(0.2, "at unit area", 0, 1)
    faded: float = tuned(0.01, "1", 0, 1)  # vertices stay that a landmark moves by less of its own motion
    pair_confidence: float = tuned(0.9, "1", 0, 1)  # confidence in a pair whose edges keep their lengths
    half_stretch: float = tuned(0.5, "1", 1e-6, 10)  # mean relative change of length that halves this confidence


SHELLS = ShellTuning()


@dataclass(frozen=True, eq=False)
class _Image:
    """Images of some vertices of the target on the source's working mesh."""

    triangle: Integers  # (n,) triangle numbers
    barycentric: Floats  # (n, 3) coordinates in them
    distance: Floats  # (n,) distance from the moved vertices, at unit area of the hull


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
    motion, in_place = _motion(pair, fit, confidence)
    points, normals, around = _carry(motion, target.points, target.mesh.vertex_normals)
    of_source, of_target = _outside(source, pair.source_shape), _outside(target, pair.target_shape)
    image = _beneath(points, normals, source, of_source, of_target, in_place)
    visible, may_lift = of_source & ~_find_covered(source, of_source), of_target & ~_find_covered(target, of_target)
    if not in_place:
        _uncover(image, points, normals, source, visible, may_lift)
    among = np.flatnonzero(visible[source.mesh.triangles].any(axis=1) | in_place)
    _move_to_parts(image, points, normals, of_target, among, source, target, motion, in_place)
    trust = np.clip(around, 0, 1) / (1 + (image.distance / SHELLS.half_distance) ** 2)
    ours, theirs = target.parts(points), source.parts(source.points)
    has_partner = _find_partners(pair, points, image.distance, source, target, None if in_place else of_hulls)
    partners: list[tuple[int, int]] = []
    motions: list[Similarities] = []
    # The only shell of a surface is a whole body, and cannot be the partner of a piece.
    if min(len(ours), len(theirs)) > 1:
        most = MAX_PAIRED_PARTS
        partners, motions = _pair_shells(pair, motion, ours[:most], theirs[:most], source, target)
    if partners:
        mesh, component = source.mesh, source.mesh.component[source.mesh.triangles[:, 0]]
        shells = OrientedSurface(source.points, mesh.triangles, mesh.flipped, SHELLS.normal_weight, component)
    for (i, j), similarity in zip(partners, motions, strict=True):
        part = ours[i]
        onto, stretch = _onto_partner(part, j, similarity, motion.scale, in_place, normals, shells, source, target)
        on = onto.distance < np.maximum(SHELLS.beside, image.distance[part.vertices])
        vertices = part.vertices[on]
        image.triangle[vertices], image.barycentric[vertices] = onto.triangle[on], onto.barycentric[on]
        image.distance[vertices] = onto.distance[on]
        trust[vertices] = SHELLS.pair_confidence / (1 + (stretch / SHELLS.half_stretch) ** 2)
        has_partner.target[vertices] = has_partner.source[theirs[j].vertices] = True
    surface_map = SurfaceMap(image.triangle, image.barycentric, source.mesh.triangles)
    if pair.exact_landmarks is not None:
        surface_map = _pin(surface_map, landmark_points(pair, pair.exact_landmarks), source, target, pair)
    alone = float(target.areas[image.distance > SHELLS.half_distance].sum() / target.areas.sum())
    return ShellMap(surface_map, trust, has_partner, len(partners), alone, in_place)


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


def _motion(pair: Pair, fit: Fit, confidence: Floats) -> tuple[SimilarityField, bool]:
    """The motion of the target's hull to the source's, in the frames of the hulls, and whether it stays in place."""
    source, target = pair.source_shape.proxy, pair.target_shape.proxy
    centre, size = source.frame
    bent = centre + size * fit.positions
    moves = fit.fits | ((confidence < SHELLS.doubtful) & fit.fits.any())
    images = np.where(moves[:, None], bent, fit.surface_map.interpolate(source.vertices))
    places = overlapping(pair)
    basis = pair.target_shape.basis
    if pair.source is pair.target or places is None or not leaves_in_place(images, places, basis.areas):
        return SimilarityField(target.vertices, images, confidence, basis), False
    return SimilarityField(target.vertices, places, confidence, basis), True


def _carry(motion: SimilarityField, points: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
    """`SimilarityField.carry` for any number of points."""
    pieces = np.array_split(np.arange(len(points)), 1 + len(points) // AT_ONCE)
    places, turned, confidence = zip(*(motion.carry(points[some], normals[some]) for some in pieces), strict=True)
    return np.concatenate(places), np.concatenate(turned), np.concatenate(confidence)


def _outside(side: Side, shape: ShapeAnalysis) -> Booleans:
    """(n,) which vertices of a surface's working mesh are near the hull."""
    return np.asarray(cKDTree(shape.proxy.full.vertices).query(side.points)[0] < SHELLS.outside)


def _find_covered(side: Side, outside: Booleans) -> Booleans:
    """(n,) which of the vertices near the hull (n,) are below another part, as a body is below a shirt."""
    component, triangles = side.mesh.component, side.mesh.triangles
    covered = np.zeros(len(outside), dtype=bool)
    if component.max() == 0:
        return covered
    area = np.bincount(component, side.areas)
    large = np.flatnonzero((area >= COVERING_AREA * area.sum())[component[triangles[:, 0]]])
    if not len(large):
        return covered
    samples, on = surface_samples(side.points, triangles[large], COVERING_POINTS)
    own = np.flatnonzero(outside)
    near = np.asarray(cKDTree(samples).query(side.points[own], COVERING_NEIGHBOURS)[1])
    row, column = np.nonzero(component[triangles[large[on[near]], 0]] != component[own, None])
    a, b, c = (side.points[triangles[large[on[near[row, column]]], i]] for i in range(3))
    _, below = closest_on_triangles(side.points[own[row]], a, b, c)
    depth = -np.einsum("qx,qx->q", below, side.mesh.vertex_normals[own[row]])
    distance = np.linalg.norm(below, axis=1)
    covered[own[row[(distance < SHELLS.outside) & (depth > STRAIGHT_ABOVE * distance)]]] = True
    return covered


def _beneath(
    points: Floats, normals: Floats, source: Side, of_source: Booleans, of_target: Booleans, in_place: bool
) -> _Image:
    """Closest points of the source to points (n, 3) with normals (n, 3) of the target, moved there.

    Outer vertices, by `of_source` (n_s,) and `of_target` (n,), map to outer triangles, inner vertices to inner ones.
    Surfaces that overlap in place are exact where they lie on each other: there, vertices map to any triangle, because
    the hull also covers creases, such as those of a braid.
    """
    triangles = source.mesh.triangles
    outer = of_source[triangles].any(axis=1)
    number, weights = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3))
    distance = np.zeros(len(points))

    def look(vertices: Integers, among: Integers, reach: float) -> Integers:
        """Map vertices to some triangles; returns the vertices that are farther from them than the reach."""
        if not len(vertices) or not len(among):
            return vertices
        surface = OrientedSurface(source.points, triangles[among], source.mesh.flipped[among], SHELLS.normal_weight)
        found, barycentric, apart = surface.closest(points[vertices], normals[vertices])
        near = apart <= reach
        chosen = vertices[near]
        number[chosen], weights[chosen], distance[chosen] = among[found[near]], barycentric[near], apart[near]
        return vertices[~near]

    inner, rest, every = np.flatnonzero(~of_target), np.flatnonzero(of_target), np.arange(len(triangles))
    if in_place:
        rest = look(rest, every, SHELLS.lies_on)
    rest = np.concatenate([rest, look(inner, np.flatnonzero(~outer), SHELLS.inner_reach)])
    rest = look(rest, np.flatnonzero(outer), np.inf)
    look(rest, every, np.inf)
    return _Image(number, weights, distance)


def _uncover(
    image: _Image, points: Floats, normals: Floats, source: Side, visible: Booleans, may_lift: Booleans
) -> None:
    """Move images of vertices (n,) that may be lifted from covered parts to the visible ones above, in place.

    Errors of the map are larger than the gap between a body and its clothes. The vertices are at `points` (n, 3) with
    `normals` (n, 3); `visible` (n_s,) are the source's vertices that no part covers.
    """
    triangles = source.mesh.triangles
    seen = visible[triangles].any(axis=1)
    vertices, among = np.flatnonzero(may_lift & ~seen[image.triangle]), np.flatnonzero(seen)
    if not len(vertices) or not len(among):
        return
    surface = OrientedSurface(source.points, triangles[among], source.mesh.flipped[among], SHELLS.normal_weight)
    found, barycentric, apart = surface.closest(points[vertices], normals[vertices])
    near = apart < image.distance[vertices] + SHELLS.cover
    lifted = vertices[near]
    image.triangle[lifted], image.barycentric[lifted] = among[found[near]], barycentric[near]
    image.distance[lifted] = apart[near]


def _move_to_parts(
    image: _Image,
    points: Floats,
    normals: Floats,
    movable: Booleans,
    among: Integers,
    source: Side,
    target: Side,
    motion: SimilarityField,
    in_place: bool,
) -> None:
    """Move images of vertices (n,) that are movable to the parts that are nearest, with clean borders, in place.

    The vertices are at `points` (n, 3) with `normals` (n, 3), and map to the triangles `among` (m,). Rigid parts move
    by themselves, unless the surfaces are in place.
    """
    component, triangles = source.mesh.component[source.mesh.triangles[:, 0]], source.mesh.triangles[among]
    if component.max() == 0 or not len(among):
        return
    surface = OrientedSurface(
        source.points, triangles, source.mesh.flipped[among], SHELLS.normal_weight, component[among]
    )
    part = component[image.triangle]
    usable = movable & surface.has_group(part) & (not in_place)
    motions = fit_motions(part, points, normals, usable, surface, triangles, source, target, motion)
    vertices, on, barycentric, distance = straighten_borders(
        image.triangle, image.distance, movable, motions, surface, source
    )
    image.triangle[vertices], image.barycentric[vertices] = among[on], barycentric
    image.distance[vertices] = distance


def _pair_shells(
    pair: Pair, motion: SimilarityField, ours: list[Part], theirs: list[Part], source: Side, target: Side
) -> tuple[list[tuple[int, int]], list[Similarities]]:
    """Pair shells one to one: their numbers, and the similarities that register them."""
    here = Shells.of([(target.points, target.mesh.triangles[part.triangles]) for part in ours])
    there = Shells.of([(source.points, source.mesh.triangles[part.triangles]) for part in theirs])
    flat = here.sparse.reshape(-1, 3)
    moved = _carry(motion, flat, np.zeros_like(flat))[0].reshape(here.sparse.shape)
    prior = procrustes(here.sparse, moved, None, motion.handedness)  # how the body moves each shell
    images = prior(here.centre[:, None])[:, 0]
    size = prior.scale * here.size
    apart = np.linalg.norm(images[:, None] - there.centre, axis=2)
    unlike = np.abs(np.log(size[:, None] / there.size))
    # Only pairs that regions exclude: a bonus for shared regions would pair a left shoe with a right one, both shoes.
    strangers = np.isinf(
        relation_of(
            target.members([of_target for _, of_target in pair.regions])[: len(ours)],
            source.members([of_source for of_source, _ in pair.regions])[: len(theirs)],
        )
    )
    rough = apart / SHELLS.max_move + unlike / np.log(SHELLS.max_unlike)
    # On 13 pairs of characters these two limits changed no figure: they save up to half of the registrations.
    rough[(unlike > np.log(SHELLS.max_unlike)) | (apart > SHELLS.max_move + size[:, None] / 2) | strangers] = np.inf
    rivals = np.argsort(rough, axis=1, kind="stable")[:, : SHELLS.rivals]
    i, j = np.repeat(np.arange(len(ours)), rivals.shape[1]), rivals.ravel()
    possible = np.isfinite(rough[i, j])
    i, j = i[possible], j[possible]
    if not len(i):
        return [], []
    found, miss = register_shells(here, there, i, j, prior, motion.handedness)
    miss = miss / there.size[j]
    move = np.linalg.norm(found(here.centre[i][:, None])[:, 0] - images[i], axis=1)
    cosine = (np.einsum("qij,qij->q", found.rotation, prior.rotation[i]) - 1) / 2
    cost = (
        SHELLS.miss_cost * miss / SHELLS.max_miss
        + SHELLS.move_cost * move / SHELLS.max_move
        + SHELLS.turn_cost * np.arccos(np.clip(cosine, -1, 1))
        + SHELLS.scale_cost * np.abs(np.log(found.scale / prior.scale[i]))
    )
    cost[(miss > SHELLS.max_miss) | (move > SHELLS.max_move)] = np.inf
    table = np.full((len(ours), len(theirs)), 10 * SHELLS.max_cost)
    table[i, j] = np.minimum(cost, 10 * SHELLS.max_cost)
    number = np.zeros(table.shape, dtype=np.int64)
    number[i, j] = np.arange(len(i))
    assigned = np.column_stack(scipy.optimize.linear_sum_assignment(table)).tolist()
    chosen = [(a, b) for a, b in assigned if table[a, b] <= SHELLS.max_cost]
    return chosen, [found[number[a, b] : number[a, b] + 1] for a, b in chosen]


def _onto_partner(
    part: Part,  # of the target, its points where the body's map moves them
    partner: int,  # number of its partner
    similarity: Similarities,  # that registers the one with the other
    scale: float,  # of the body against the source's, by which lengths should change
    stays: bool,  # whether the body stays in place, and with it a shell that lies on its partner there
    normals: Floats,  # (n, 3) of all vertices of the target, where the body's map turns them
    shells: OrientedSurface,  # of the source
    source: Side,  # that they are shells of
    target: Side,  # that the part is of
) -> tuple[_Image, float]:
    """A shell's image on its partner by the better of two motions, and the relative change of edge lengths.

    Rigid shells are placed by the similarity, others by the body's map.
    """
    rest = target.points[part.vertices]
    turned = target.mesh.vertex_normals[part.vertices] @ similarity.rotation[0].T
    edges, _ = unique_edges(part.corners)
    lengths = scale * np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    tried = []
    for places, facing in ((part.points, normals[part.vertices]), (similarity(rest[None])[0], turned)):
        image = _Image(*shells.closest(places, facing, np.full(len(rest), partner)))
        corners = source.points[source.mesh.triangles[image.triangle]]
        on = np.einsum("nc,ncx->nx", image.barycentric, corners)
        change = np.abs(np.linalg.norm(on[edges[:, 0]] - on[edges[:, 1]], axis=1) - lengths)
        tried.append((image, float(change.sum() / max(lengths.sum(), 1e-300))))
        if stays and np.median(image.distance) < SHELLS.flush:
            break
    return min(tried, key=itemgetter(1))
