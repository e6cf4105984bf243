# SPDX-License-Identifier: GPL-3.0-or-later
"""Match a part with a whole: candidates, and the map by registering the part on the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.maps.zoomout_sizes import slanted_sizes
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.curvature import CURVATURE, curvature_agreement, curvature_score
from zoomout_core.matching.partial.gaps import GAPS, gap_area
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale
from zoomout_core.matching.partial.part_candidates import PartCandidate, part_candidates
from zoomout_core.matching.partial.part_registration import PART_REGISTRATION, RegisteredPart, register_part
from zoomout_core.matching.partial.region import REGION, Region, find_regions, is_small
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import certainty_of_part
from zoomout_core.matching.ranking.scores import EVIDENCE_WEIGHTS, UPRIGHT, Disagreement, no_disagreement
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.registration.correspondences import Surroundings
from zoomout_core.matching.registration.nonrigid_icp import NONRIGID_SCHEDULE, Fit, Level
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PartMatchTuning(Tuning, set_by="partial"):
    """When to search for a part; lengths are those of the larger shape at unit area."""

    # Maps of wholes below it are tried as parts. At .8, a person with missing pieces keeps its map as a whole, with a
    # certainty of .88 and an error of 68 (x 1000). As a part it has .96 and 22. The other 27 pairs with cuts, holes and
    # missing pieces stay the same.
    uncertain: float = tuned(0.95, "probability", 0, 1)
    # Minimum certainty of a part. Whole dinosaurs of other species have a certainty of 3 % both ways; nine of ten limbs
    # are right as wholes, and two or four as parts.
    likely: float = tuned(0.15, "probability", 0, 1)
    # Ratio of the areas above which the map of whole shapes is kept if both methods find the same map. It is more exact
    # then (a fighting body: 21 against 28), but less exact if much is missing (two people, both cut: 73 against 29).
    nearly_whole: float = tuned(0.8, "1", 0, 1)
    # Ratio of the scales of two shapes beyond which their units differ: a hand is 7 to 10 times smaller than its body,
    # and a foot 5 to 7.
    largest_ratio: float = tuned(11.0, "1", 1, 1000)
    # Number of maps of two fragments as wholes that compete with those found by landmarks.
    as_wholes: int = tuned(3, "maps", 0, 100)
    residual: float = tuned(0.03, "length", 0, 10)  # a place of the part has no partner beyond this distance
    # Lag in score up to which candidates are finished, to compare their curvature: on average 2.3 of 4.4 candidates.
    finished_margin: float = tuned(0.5, "1", 0, 100)
    near_cut: float = tuned(0.05, "length", 0, 10)  # a part may end where one of its cuts is nearer
    # Two fragments share the area within this distance of each other, except where it is nearest to a cut, smoothed by
    # a diffusion length. On 17 right maps of 20 pairs of cut animals, the mean IoU with the area that they share
    # rises from .63 to .69.
    residual_of_fragments: float = tuned(0.06, "length", 0, 10)
    smooth_overlap: float = tuned(0.03, "length", 0, 1)  # see `residual_of_fragments`


PART_MATCH = PartMatchTuning()
# The schedules for the map of two fragments, for one that is placed rigidly, and before it. Vertices without a partner
# are not attracted at all. Even a small weight would pull all of them onto the other fragment, where they hide the true
# partners.
PLACED_SCHEDULE = tuple(level._replace(min_weight=0.0) for level in PART_REGISTRATION.placed)
FRAGMENT_SCHEDULE = tuple(level._replace(min_weight=0.0) for level in NONRIGID_SCHEDULE)


def may_be_part(pair: Pair) -> bool:
    """Whether pieces may be missing on either shape of a pair."""
    shapes = pair.source_shape, pair.target_shape
    if any(shape.proxy.full.is_hull for shape in shapes):
        return False
    return any(np.isfinite(IncompleteShape(shape).cut_distance).any() for shape in shapes)


def sizes_differ(pair: Pair) -> bool:
    """Whether one shape of a pair is as small beside the other as a hand or a foot, if their units are the same."""
    return _ratio(pair) ** -2 < REGION.small and not units_differ(pair)


def units_differ(pair: Pair) -> bool:
    """Whether the shapes of a pair are of such different size that their units cannot be the same."""
    return _ratio(pair) > PART_MATCH.largest_ratio


def _ratio(pair: Pair) -> float:
    """The larger scale of the two shapes over the smaller one."""
    scales = [shape.proxy.full.scale for shape in (pair.source_shape, pair.target_shape)]
    return max(scales) / min(scales)


def in_one_unit(pair: Pair) -> Pair:
    """The pair with its shapes in one unit, in which the larger one has unit area."""
    shapes = pair.source_shape, pair.target_shape
    unit = max(shape.proxy.full.scale for shape in shapes)
    source, target = (at_scale(shape, shape.proxy.full.scale / unit) for shape in shapes)
    return replace(pair, source_shape=source, target_shape=target)


def part_of(pair: Pair) -> tuple[ShapeAnalysis, ShapeAnalysis]:
    """The smaller shape of a pair, which is tried as the part, and the other."""
    source, target = pair.source_shape, pair.target_shape
    is_target = target.basis.areas.sum() <= source.basis.areas.sum()
    return (target, source) if is_target else (source, target)


def are_fragments(pair: Pair) -> bool:
    """Whether large pieces may be missing on both shapes of a pair."""
    return all(IncompleteShape(shape).is_fragment for shape in (pair.source_shape, pair.target_shape))


def match_part(
    pair: Pair, disagreement: Disagreement = no_disagreement, given: Sequence[Integers] = (), upright: bool = False
) -> list[Candidate]:
    """Candidates for a pair in one unit, the most likely first; given maps (d_p,) of the part's places compete.

    Two fragments may be likely to stand `upright` in their files; a small part, such as a hand, may point anywhere.
    """
    part, whole = part_of(pair)
    regions: list[Region] = []
    if is_small(part, whole):
        with portion(0.0, 0.2):
            regions = find_regions(part, whole)
    if not regions:  # faces of a soup reach across all regions
        regions = [Region.everywhere(IncompleteShape(part), IncompleteShape(whole))]
    upright = upright and regions[0].is_everywhere
    with portion(0.2, 0.9):
        found = part_candidates(regions, given, upright)
    candidates = sorted((_candidate(one, pair, disagreement, upright) for one in found), key=_total)
    # Fragments of other species differ in curvature, which costs 3 of 59 % of mIoU (16 pairs of PARTIALSMAL).
    if regions[0].is_everywhere and not regions[0].is_between_fragments:
        with portion(0.9, 1.0):
            candidates = _by_curvature(candidates, pair)
    return [replace(each, certainty=certainty_of_part(each, candidates)) for each in candidates]


def _total(candidate: Candidate) -> float:
    return candidate.scores["total"]


def _by_curvature(candidates: Sequence[Candidate], pair: Pair) -> list[Candidate]:
    """Candidates in the order of their totals, to which the agreement of curvature of their finished maps is added.

    Those far behind are not finished, and their curvature counts as the worst known one.
    """
    count = sum(_total(one) - _total(candidates[0]) < PART_MATCH.finished_margin for one in candidates)
    known = for_each(lambda one: _finish(one, pair), candidates[:count])
    worst = min((one.scores[CURVATURE] for one in known), default=0.0)
    known += [replace(one, scores=one.scores | {CURVATURE: worst}) for one in candidates[count:]]
    totals = [_total(one) + curvature_score(one.scores) for one in known]
    scored = (replace(one, scores=one.scores | {"total": total}) for one, total in zip(known, totals, strict=True))
    return sorted(scored, key=_total)


def _finish(candidate: Candidate, pair: Pair) -> Candidate:
    """A candidate with its part registered as for the final map, the agreement of curvature, and the gaps.

    The mean agreement before and after is less noisy: a fine registration also bends a wrong map until features meet.
    """
    assert candidate.part_match is not None
    one = candidate.part_match
    part, whole = one.region.part, one.region.whole
    finished, shapes = _register_finally(one, pair), (part.shape, whole.shape)
    agreement = np.mean([curvature_agreement(each, *shapes) for each in (one.registered, finished)])
    closest, covered = _on_part(finished, *shapes, PART_MATCH.residual)
    missed = gap_area(covered, part.cut_distance_of_vertices[closest.vertex], whole, PART_MATCH.near_cut)
    scores = candidate.scores | {CURVATURE: float(agreement), GAPS: missed}
    return replace(candidate, part_match=replace(one, finished=finished), scores=scores)


def places_of(candidate: Candidate, pair: Pair) -> Integers:
    """(d_p,) the whole's place for each place of the part, by a map of both shapes of a pair as wholes."""
    part, whole = part_of(pair)
    image = candidate.sample_map if part is pair.target_shape else _reverse(candidate.sample_map, pair.source_shape)
    return whole.nearest_distance_sample[image[: len(part.distances)]]


def _reverse(sample_map: Integers, source: ShapeAnalysis) -> Integers:
    """(s_s,) for each search sample of the source the target's sample, of a map (s_t,), with the nearest image."""
    samples = source.mesh.vertices[source.search.samples]
    return np.asarray(cKDTree(samples[sample_map]).query(samples)[1])


@dataclass(frozen=True, eq=False)
class PartFit:
    """The map between a part and a whole, on the meshes of both."""

    fit: Fit  # from the target's mesh to the source's
    back: SurfaceMap  # from the source's mesh to the target's
    partners: Partners  # which of their vertices have a partner


def fit_part(pair: Pair, candidate: Candidate) -> PartFit:
    """Register the part of a pair in one unit to the whole by a candidate."""
    assert candidate.part_match is not None
    part, whole = part_of(pair)
    one = candidate.part_match
    region = one.region
    in_region = one.finished if one.finished is not None else _register_finally(one, pair)
    registered = region.to_whole(in_region)
    residual = PART_MATCH.residual_of_fragments if region.is_between_fragments else PART_MATCH.residual * region.unit
    of_part = (registered.residual < residual) & (registered.agreement > 0) & registered.is_near
    on_part, of_whole = _on_part(registered, part, whole, residual)
    of_whole &= region.contains
    if region.is_between_fragments:
        on_cut = region.part.cut_distance_of_vertices[on_part.vertex] == 0
        of_part, of_whole = _majority(of_part & ~registered.on_cut, part), _majority(of_whole & ~on_cut, whole)
    if part is pair.target_shape:
        fit = Fit(registered.closest, registered.positions, registered.rotations, of_part)
        return PartFit(fit, on_part, Partners(of_part, of_whole))
    return PartFit(Fit.of_map(on_part), registered.closest, Partners(of_whole, of_part))


def _majority(chosen: Booleans, shape: ShapeAnalysis) -> Booleans:
    """(n,) whether most of the surroundings of each vertex are chosen (n,)."""
    share = shape.basis.smoothed(chosen[:, None].astype(np.float64), PART_MATCH.smooth_overlap**2)[:, 0]
    return np.asarray(share > 0.5)


def _register_finally(one: PartCandidate, pair: Pair) -> RegisteredPart:
    """The part of a pair, registered with its region for the final map."""
    region, start = one.region, None
    schedule: Sequence[Level] = NONRIGID_SCHEDULE
    if region.is_between_fragments:
        start = one.registered.positions if one.start is None else one.start
        schedule = FRAGMENT_SCHEDULE if one.start is None else (*PLACED_SCHEDULE, *FRAGMENT_SCHEDULE)
    return register_part(one.places, region.part, region.whole, schedule, start)


def _on_part(
    registered: RegisteredPart, part: ShapeAnalysis, whole: ShapeAnalysis, residual: float
) -> tuple[SurfaceMap, Booleans]:
    """The closest points of a bent part to the vertices of the whole, and (n,) whether these are near."""
    positions, normals = whole.mesh.vertices, whole.mesh.vertex_normals
    found = Surroundings.deform(part, registered.positions, registered.normals).closest(positions, normals)
    distance = np.linalg.norm(found.interpolate(registered.positions) - positions, axis=1)
    facing = np.einsum("nx,nx->n", found.interpolate(registered.normals), normals) > 0
    return found, (distance < residual) & facing


def _candidate(one: PartCandidate, pair: Pair, disagreement: Disagreement, upright: bool) -> Candidate:
    """The map of a part as a candidate of the pair; its certainty is computed once all rivals are known."""
    source, target = pair.source_shape, pair.target_shape
    part, whole = part_of(pair)
    bent = one.region.to_whole(one.registered).positions[part.search.samples]
    still = whole.mesh.vertices[whole.search.samples]
    from_target, onto_source = (still, bent) if part is source else (bent, still)
    sample_map = np.asarray(cKDTree(onto_source).query(from_target)[1])
    most = min(len(shape.basis.eigenvalues) for shape in (source, target))
    k_target, k_source = slanted_sizes(source.basis, target.basis, k_final=min(pair.k_final, most))[-1]
    back = _reverse(sample_map, source)
    functional_map = target.search.fit(source.search.rows[sample_map, :k_source], k_target)
    reverse = source.search.fit(target.search.rows[back, :k_target], k_source)
    against = disagreement(functional_map, sample_map, None)
    if upright:
        against |= {UPRIGHT: one.scores[UPRIGHT]}
    total = one.cost + sum(EVIDENCE_WEIGHTS[name] * value for name, value in against.items())
    return Candidate(
        origin="one shape as a part of the other",
        reverses_orientation=False,
        mirrored=False,
        functional_map=functional_map,
        reverse_functional_map=reverse,
        sample_map=sample_map,
        anchors=None,
        final_anchors=None,
        certainty=0.0,
        scores=one.scores | against | {"total": total},
        part_match=one,
    )
