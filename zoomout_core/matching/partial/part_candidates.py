# SPDX-License-Identifier: GPL-3.0-or-later
"""Candidates for the place of a part on a whole: place landmarks, refine maps, and register the part by each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple, TypeVar

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import Moments, products
from zoomout_core.matching.partial.fragment_overlap import OVERLAP_COST, overlap_cost
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.matching.partial.landmark_maps import place_all, place_few
from zoomout_core.matching.partial.landmark_search import SEARCH, assignments, distinct, landmarks_of
from zoomout_core.matching.partial.part_registration import PART_REGISTRATION, RegisteredPart, register_part
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.partial.rigid_placements import rigid_placements
from zoomout_core.matching.ranking.scores import EVIDENCE_WEIGHTS, UP_AXES, UPRIGHT
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PartCandidateTuning(Tuning, set_by="partial"):
    """Which maps of a part are compared, and how; lengths are those of the larger shape at unit area."""

    landmarks: int = tuned(9, "landmarks", 3, 100)  # number of landmarks spread over the part
    regions: int = tuned(4, "regions", 0, 100)  # number of regions of the part that are searched for separately
    regions_of_small: int = tuned(1, "regions", 0, 100)  # the same for a small part, as the whole has regions, too
    landmarks_in_region: int = tuned(6, "landmarks", 3, 100)  # number of landmarks in each region
    extended: int = tuned(6, "assignments", 1, 1000)  # assignments with the cheapest maps, extended to all places
    same_map: float = tuned(0.05, "length", 0, 10)  # mean distance of images below which two maps are the same
    registered: int = tuned(12, "maps", 1, 1000)  # cheapest maps, by which the part is registered coarsely
    compared: int = tuned(4, "maps", 1, 1000)  # number of these by which it is registered finely
    # Number of maps of either search between two fragments that are registered again. Without this, one right map of
    # seven pairs of animals is lost (fits of -2.75 and -2.63 become -2.62 and -2.81). No third map becomes the first
    # one.
    registered_again: int = tuned(2, "maps", 0, 1000)
    surroundings: float = tuned(0.2, "length", 1e-3, 10)  # Gaussian width of surroundings that rotate together
    near_cut: float = tuned(0.02, "length", 0, 10)  # places may have no partner if their images are nearer to a cut
    facing: float = tuned(1.0, "1", 0, 100)  # weight in the cost of a map of the log mean deviation of normals
    bend: float = tuned(0.5, "1", 0, 100)  # weight of the mean distance from rotated surroundings
    distance: float = tuned(0.2, "1", 0, 100)  # weight of the mean change of geodesic distances
    unlikeness: float = tuned(0.5, "1", 0, 100)  # weight of the mean unlikeness of places
    within: float = tuned(0.7, "1", 0, 100)  # weight of the share that maps to no cut
    strain: float = tuned(0.75, "1", 0, 100)  # weight in the score of the log strain, relative to that of normals
    beyond: float = tuned(1.0, "1", 0, 100)  # weight of the share of the part that is not beyond a cut


PART_CANDIDATES = PartCandidateTuning()


@dataclass(frozen=True, eq=False)
class PartCandidate:
    """A map of a part to a region of a whole."""

    region: Region  # the part and the region, which may be the whole
    places: Integers  # (d_p,) for each place of the part that of the region
    registered: RegisteredPart  # the part, registered by it
    # Cost of the map, scores of the registered part, and its fit: the lowest is the most likely.
    scores: dict[str, float]
    start: Floats | None = None  # (n, 3) the part's vertices by the rigid placement that it was registered from, if any
    finished: RegisteredPart | None = None  # the part, registered with the nodes of a final map, if it was compared so

    @property
    def cost(self) -> float:
        """The cost by which registered parts are ordered, the lowest first: the fit, or that of two fragments."""
        return self.scores.get(OVERLAP_COST, self.scores["fit"])


class _Found(NamedTuple):
    """A map of the places of a part (d_p,) to those of a region, with its cost before the part is registered."""

    cost: float  # the lowest is the best
    region: Region
    places: Integers
    start: Floats | None = None  # (n, 3) where it places the part's vertices, if it is rigid


_Map = TypeVar("_Map", _Found, PartCandidate)


def part_candidates(
    regions: Sequence[Region], given: Sequence[Integers] = (), upright: bool = False
) -> list[PartCandidate]:
    """Maps of a part to a whole, or to regions of it, which compete, the most likely first.

    Each of two fragments has regions that the other one lacks, so that few landmarks have a partner. So fragments are
    placed rigidly, too. Costs of the two searches are not comparable, so the best maps of each are registered again and
    compared by their cost. Fragments may be likely to stand `upright` in their files.
    Maps from elsewhere compete: `given` are places of the whole (d_p,) for each place of the part.
    """
    is_small = not regions[0].is_everywhere
    sets = landmark_sets(regions[0].part, PART_CANDIDATES.regions_of_small if is_small else PART_CANDIDATES.regions)
    if not regions[0].is_between_fragments:
        return _fine_candidates(regions, sets, given=() if is_small else given)
    with portion(0.0, 0.4):
        by_landmarks = _fine_candidates(regions, sets, given=given)
    with portion(0.4, 0.8):
        placed = _placed_candidates(regions[0], upright)
    # Rough maps of two fragments are less exact than those of a part of a whole: places of either are not on the other.
    most = PART_CANDIDATES.registered_again
    with portion(0.8, 1.0):
        again = for_each(_register, by_landmarks[:most] + placed[:most])
    found = _by_cost(again + by_landmarks[most:] + placed[most:], upright)
    return _differing(found, len(found))


def _by_cost(candidates: Sequence[PartCandidate], upright: bool = False) -> list[PartCandidate]:
    """Candidates by their cost, and by the rotation of the up axis if that is evidence."""

    def cost(one: PartCandidate) -> float:
        return one.cost + (EVIDENCE_WEIGHTS[UPRIGHT] * one.scores[UPRIGHT] if upright else 0.0)

    return sorted(candidates, key=cost)


def _fine_candidates(
    regions: Sequence[Region],
    sets: Sequence[Integers],
    given: Sequence[Integers] = (),
) -> list[PartCandidate]:
    """The best of `rough_candidates`, registered finely."""
    with portion(0.0, 0.8):
        rough = rough_candidates(regions, sets, PART_CANDIDATES.registered, given)
    ahead = _differing(rough, PART_CANDIDATES.compared)  # some are the same by now
    with portion(0.8, 1.0):
        return _by_cost(for_each(_register, ahead))


def _placed_candidates(region: Region, upright: bool) -> list[PartCandidate]:
    """Maps of a part by its rigid placements on a region, registered finely, the most likely first."""
    with portion(0.0, 0.4):
        placements = rigid_placements(region.part, region.whole, upright)
    found = [_Found(_map_cost(one.places, region), region, one.places, one.positions) for one in placements]
    with portion(0.4, 0.8):
        sifted = _by_cost(for_each(_register, found), upright)
    with portion(0.8, 1.0):
        return _by_cost(for_each(_register, _differing(sifted, PART_CANDIDATES.compared)), upright)


def rough_candidates(
    regions: Sequence[Region],
    sets: Sequence[Integers],
    max_count: int,
    given: Sequence[Integers] = (),
) -> list[PartCandidate]:
    """Maps of a part to a whole, with coarse registration by the `max_count` cheapest only, the most likely first.

    Regions compete. The sets are those of landmarks by which the part is searched for. Maps (d_p,) to the first region
    may be given, too.
    """
    for region in regions:  # computed once, before several threads need it
        _ = region.unlike, region.part.unaffected, region.whole.unaffected

    def search_from(task: tuple[Region, Integers]) -> list[_Found]:
        region, landmarks = task
        return [_Found(_map_cost(places, region), region, places) for places in _search(landmarks, region)]

    tasks = [(region, landmarks) for region in regions for landmarks in sets]
    with portion(0.0, 0.5):
        found = sorted(chain(*for_each(search_from, tasks)), key=lambda one: one.cost)
    others = [_Found(_map_cost(places, regions[0]), regions[0], places) for places in given]
    ahead = _differing([*others, *_differing(found, max_count)], len(found) + len(others))
    with portion(0.5, 1.0):
        return _by_cost(for_each(_register, ahead))


def _differing(maps: Sequence[_Map], max_count: int) -> list[_Map]:
    """The first maps that differ from those before them."""
    kept: list[_Map] = []
    for one in maps:
        if len(kept) < max_count and all(images_apart(one, other) > PART_CANDIDATES.same_map for other in kept):
            kept.append(one)
    return kept


def landmark_sets(part: IncompleteShape, regions: int) -> list[Integers]:
    """Places of a part (m,) to search for: spread over all of it, and over some regions of it.

    At least one region is on the whole even if that lacks pieces, and is similar to it even if the shapes differ.
    """
    in_region, around = PART_CANDIDATES.landmarks_in_region, landmarks_of(part, regions)
    return [landmarks_of(part, PART_CANDIDATES.landmarks), *(landmarks_of(part, in_region, each) for each in around)]


def _search(landmarks: Integers, region: Region) -> list[Integers]:
    """(d_p,) the place of the whole for each place of the part, by several placements of landmarks of the part."""
    part, whole, unlike = region.part, region.whole, region.unlike
    placed = assignments(landmarks, unlike, part, whole)
    few = [place_few(landmarks, placed[i], unlike, part, whole) for i in distinct(placed, whole)]
    few.sort(key=lambda places: _map_cost(places, region))
    return [place_all(places, unlike, part, whole) for places in few[: PART_CANDIDATES.extended]]


def images_apart(one: _Found | PartCandidate, other: _Found | PartCandidate) -> float:
    """Mean distance between the images of two maps, in the unit of their regions: along one region, or across two."""
    if one.region is other.region:
        return float(one.region.whole.between[one.places, other.places].mean())
    images, others = (each.region.in_space(each.places) for each in (one, other))
    return float(np.linalg.norm(images - others, axis=1).mean() / one.region.unit)


def _map_cost(places: Integers, region: Region) -> float:
    """The cost of a map of places before the part is registered by it; the lowest is the best.

    The surroundings of each place are rotated onto their images, which fits badly for mirrored maps.
    Places with images next to a cut of the whole may have no partner, and are ignored.
    """
    part, whole = region.part, region.whole
    here, there = part.shape, whole.shape
    count = len(places)
    between, unaffected = part.between[:count, :count], part.unaffected[:count, :count]
    at, images = here.search.samples[:count], there.search.samples[places]
    points, goals = here.mesh.vertices[at], there.mesh.vertices[images]
    is_within = whole.cut_distance[places] > PART_CANDIDATES.near_cut
    around = np.exp(-((between / PART_CANDIDATES.surroundings) ** 2)) * is_within
    around /= np.maximum(around.sum(axis=1, keepdims=True), 1e-9)
    rotations = Moments.of_products(around @ products(points, goals)).rotations()
    normals = np.einsum("nij,nj->ni", rotations, here.mesh.vertex_normals[at])
    facing = 1 - np.einsum("ni,ni->n", normals, there.mesh.vertex_normals[images])
    bent = np.einsum("nij,nj->ni", rotations, points - around @ points) - (goals - around @ goals)
    weights = part.areas[:count] / part.areas[:count].sum() * is_within
    share = max(float(weights.sum()), 1e-3)
    among = whole.between[np.ix_(places, places)]
    change = np.abs(between - among)
    change[~unaffected & (between > among)] *= SEARCH.doubt
    means = {
        "facing": (weights @ facing / share, 0.01),
        "bend": (weights @ np.linalg.norm(bent, axis=1) / share, 0.003),
        "distance": (weights @ change @ weights / share**2, 0.003),
        "unlikeness": (weights @ region.unlike[np.arange(count), places] / share, 0.01),
    }
    total = sum(getattr(PART_CANDIDATES, name) * np.log(mean + floor) for name, (mean, floor) in means.items())
    return float(total - PART_CANDIDATES.within * np.log(share))


def _register(one: _Found | PartCandidate) -> PartCandidate:
    """Register the part by a map: coarsely by a map that was found, finely if it is registered already."""
    part, whole = one.region.part, one.region.whole
    start: Floats | None
    if isinstance(one, PartCandidate):
        levels, start, scores = PART_REGISTRATION.fine, one.registered.positions, one.scores
    else:
        levels = PART_REGISTRATION.coarse if one.start is None else PART_REGISTRATION.placed
        start, scores = one.start, {"cost": one.cost}
    registered = register_part(one.places, part, whole, levels, start)
    at = part.shape.search.samples[: len(part.between)]
    places = whole.shape.voronoi_cell[registered.closest.vertex[at]]
    return PartCandidate(one.region, places, registered, scores | _scores(registered, one.region), one.start)


def register_places(places: Integers, region: Region) -> PartCandidate:
    """Register the part by a map of its places (d_p,), first coarsely, then finely."""
    return _register(_register(_Found(_map_cost(places, region), region, places)))


def _scores(registered: RegisteredPart, region: Region) -> dict[str, float]:
    """The scores of a registered part, its fit (the lowest is the most likely), and its area on the whole.

    Two fragments also have a cost in which their overlap replaces the share of the part that is not beyond a cut.
    As evidence on the up direction, one minus the mean cosine between an axis along which shapes stand and its image.
    """
    areas = region.part.shape.basis.areas
    scores = registered.scores(areas)
    deformation = np.log(scores["normals"] + 0.01) + PART_CANDIDATES.strain * np.log(scores["strain"] + 0.02)
    fit = deformation - PART_CANDIDATES.beyond * np.log(max(1 - scores["beyond"], 1e-3))
    kept_up = (areas @ registered.rotations[:, UP_AXES, UP_AXES]).max() / areas.sum()
    extent = areas.sum() * (1 - scores["beyond"])
    scores |= {"fit": float(fit), "extent": float(extent), UPRIGHT: float(1 - kept_up)}
    if region.is_between_fragments:
        scores |= {OVERLAP_COST: float(deformation + overlap_cost(registered, region))}
    return scores
