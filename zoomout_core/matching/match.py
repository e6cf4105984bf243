"""From two surfaces to a dense map: prepare both, guess, refine and rank, bring the best to full resolution."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from operator import attrgetter
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ANALYSIS, ShapeAnalysis
from zoomout_core.matching.attempt import ATTEMPTS, Attempt, agree, best_of, confirmed
from zoomout_core.matching.components.bodies import Bodies, bodies_steps, tight_bodies_steps
from zoomout_core.matching.components.lift import lifted
from zoomout_core.matching.components.overlap import overlapping
from zoomout_core.matching.confidence import Partners, confidence_of, partners_by_cycle
from zoomout_core.matching.constraints import CONSTRAINTS, Constraints, checked_axes, checked_regions, pinned
from zoomout_core.matching.hypotheses.descriptors import descriptor_hypotheses
from zoomout_core.matching.hypotheses.extremities import (
    extremities,
    extremity_hypotheses,
    has_extremities,
    more_extremity_hypotheses,
)
from zoomout_core.matching.hypotheses.given import given_hypothesis, proximity_hypothesis
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.hypotheses.landmarks import landmark_hypothesis
from zoomout_core.matching.hypotheses.rotations import rotation_hypotheses
from zoomout_core.matching.hypotheses.signs import sign_hypotheses
from zoomout_core.matching.memory_cache import kept_analysis_steps, kept_working_mesh
from zoomout_core.matching.memory_need import check_memory
from zoomout_core.matching.options import Initial, MatchOptions
from zoomout_core.matching.pair import LandmarkError, Pair, distinct_landmarks, landmarks_on_parts, surface_vertices
from zoomout_core.matching.partial.part_match import (
    PART_MATCH,
    PartFit,
    in_one_unit,
    may_be_part,
    part_fit_steps,
    part_match_steps,
    part_of,
    sizes_differ,
    too_coarse,
    units_differ,
)
from zoomout_core.matching.partial.region import REGION, is_small
from zoomout_core.matching.partial.unknown_scale import UNKNOWN_SCALE, at_unknown_scale_steps, times_as_large
from zoomout_core.matching.proxy import proxy_size
from zoomout_core.matching.ranking import CERTAINTY, Candidate, rank_steps, with_others
from zoomout_core.matching.refinement import REFINEMENT, dense_steps
from zoomout_core.matching.registration.nonrigid_icp import Fit, fit_steps
from zoomout_core.matching.rotational_symmetry import (
    certainty_but_for_turns,
    likely_turns,
    self_maps,
    with_turned,
)
from zoomout_core.matching.scores import Disagreement
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import ShapeLike, as_shape, as_surface
from zoomout_core.mesh.surface import PointCloud, Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.stepping import Progress, Steps, drain, scaled, spread, within
from zoomout_core.runtime.threads import for_each, in_background, on_one_blas_thread, side_by_side
from zoomout_core.tuning import Tuning, tuned

Result = TypeVar("Result")

UNSURE = (
    "This map is right with a probability of {:.0%} only: check that no sides are swapped, and try another candidate "
    "or add landmarks if they are."
)
NOT_RECOGNISED = (
    "The shapes were not recognised (a probability of {:.0%}): add a few landmarks, or place one over the other in the "
    "same pose and start from proximity."
)
TURNED = (
    "The shape looks the same when it is turned: at least {} maps are as good as this one, which is right with a "
    "probability of {:.0%} only; try another candidate, or add landmarks that tell them apart."
)
OTHER_UNITS = "The two are of very different size: if one is a part of the other, bring both to one unit."
RESCALED = "The two seem to be in different units: matched as if the target were {:.3g} times as large as it is."
TOO_COARSE = "One of the two has too few vertices to be tried as a part of the other, or to have one: subdivide it."
# The fractions of the progress at which each body is begun, at which a part is placed, and at which this is done; and
# the fraction of each body that analysing the shapes takes, and that of what follows that placing a part takes.
PARTS_OF_PROGRESS, ANALYSING, PLACING = (0.04, 0.5, 0.6, 0.68, 0.75), 0.8, 0.7


@dataclass(frozen=True)
class NoteTuning(Tuning, set_by="judgement"):
    """Which maps come with a note.

    Attributes:
        sure: certainty below which a map is said to be unsure.
        lost: certainty below which the shapes are said not to be recognised.
        folds: share of the target's area above which it is said to be turned over.
        without_partner: share of either surface's area above which it is said to have no partner.
        rounding: how far apart coordinates are, over the length of an edge, from which on they are said to be coarse:
            then maps were a thousandth of the square root of the area off, and five where it was 0.9.
    """

    sure: float = tuned(0.9, "probability", 0, 1)
    lost: float = tuned(0.1, "probability", 0, 1)
    folds: float = tuned(0.05, "1", 0, 1)
    without_partner: float = tuned(0.03, "1", 0, 1)
    rounding: float = tuned(0.2, "edge lengths", 0, 10)


NOTES = NoteTuning()


# To have another kind of guess tried, add a function of the two shapes, and of what tells how far a map disagrees with
# what is known.
GUESSES: tuple[Callable[[ShapeAnalysis, ShapeAnalysis, Disagreement], list[Hypothesis]], ...] = (
    extremity_hypotheses,
    descriptor_hypotheses,
)
# Tried where these lead to no map that is likely.
MORE_GUESSES: tuple[Callable[[ShapeAnalysis, ShapeAnalysis, Disagreement], list[Hypothesis]], ...] = (
    more_extremity_hypotheses,
)
# What guesses need of each shape alone, so that it may be worked out for both at once, and is kept with them.
ANALYSES: tuple[Callable[[ShapeAnalysis], object], ...] = (
    extremities,
    attrgetter("descriptors"),
    attrgetter("pseudo_scalars"),
    attrgetter("curvature"),
    attrgetter("surroundings"),
    self_maps,
)


@dataclass(frozen=True, eq=False)
class MatchResult:
    """A map from the target to the source, and what else is known about it.

    Attributes:
        surface_map: for every target vertex a point on the source surface.
        confidence: (n_t,) in [0, 1]; 0 where the map was not computed but carried over from nearby.
        has_partner: (n_t,) whether there is something on the source that a vertex of the target corresponds to. What
            has none, such as a tail that the source lacks, lies where its surroundings do. True where no face is.
        source_has_partner: (n_s,) the same of the source's vertices.
        functional_map: (k_target, k_source) between the bases of the main parts.
        candidates: all maps that were found, the most likely first.
        chosen: the number of the candidate that this result is made from.
        notes: what a user should know, a sentence each.
        pair: what other candidates are made from.
        placed: the part of the target's area, in [0, 1], for which there is something on the source.
    """

    surface_map: SurfaceMap
    confidence: Floats
    has_partner: Booleans
    source_has_partner: Booleans
    functional_map: Floats
    candidates: tuple[Candidate, ...]
    chosen: int
    notes: tuple[str, ...]
    pair: Pair
    placed: float

    @property
    def certainty(self) -> float:
        """Probability that the map as a whole is right: no side swapped, nothing turned front to back.

        It is of all of the target, and falls with the part of it for which nothing was found.
        """
        return self.candidates[self.chosen].certainty * self.placed

    @property
    def share_without_partner(self) -> float:
        """The part of the target's area, in [0, 1], to which nothing on the source corresponds."""
        return self.pair.target.share_of_area(~self.has_partner)

    @property
    def source_share_without_partner(self) -> float:
        """The part of the source's area, in [0, 1], to which nothing on the target corresponds."""
        return self.pair.source.share_of_area(~self.source_has_partner)

    def outline(self, candidate: int) -> tuple[Integers, Integers]:
        """Where a candidate leads, roughly, before its full map is worked out.

        Returns:
            (s,) some vertices of the target's main part, the same for all candidates, and (s,) a vertex of the source
            for each of them.
        """
        source, target = self.pair.source_shape, self.pair.target_shape
        images = source.search.samples[self.candidates[candidate].sample_map]
        return surface_vertices(target, target.search.samples), surface_vertices(source, images)

    def use(self, candidate: int) -> MatchResult:
        """The result of another candidate, by its number."""
        return drain(self.use_steps(candidate))

    @memory_in_words
    @on_one_blas_thread
    def use_steps(self, candidate: int) -> Steps[MatchResult]:
        """The same, stepped."""
        if not 0 <= candidate < len(self.candidates):
            raise ValueError(f"There is no candidate {candidate}: they are numbered 0 to {len(self.candidates) - 1}.")
        return _result_steps(self.pair, self.candidates, candidate, 0.0)


def match(source: ShapeLike, target: ShapeLike, options: MatchOptions | None = None, **given: Any) -> MatchResult:
    """Find for every vertex of the target the point on the source that it corresponds to.

    Args:
        source: the surface that the map lands on; it carries the attributes. Of a point cloud it is the surface that
            is reconstructed from it, `PointCloud.surface`. Arrays (vertices, faces), a mesh of another library and the
            path of a file do as well, see `ShapeLike`.
        target: the surface, or the points, that the map starts from; it receives them.
        options: how to match them, see `MatchOptions`.
        given: the same as keyword arguments, or what of the options is to be different.

    Returns:
        The most likely map with the alternatives. Its `notes` say what is uncertain.

    Raises:
        MeshError: a mesh that cannot be matched; the message says what to do.
        ValueError: options that do not fit together.
    """
    return drain(match_steps(source, target, options, **given))


@memory_in_words
@on_one_blas_thread
def match_steps(
    source: ShapeLike, target: ShapeLike, options: MatchOptions | None = None, **given: Any
) -> Steps[MatchResult]:
    """`match` as a generator that yields `Progress` and returns the result."""
    if options is not None and not isinstance(options, MatchOptions):
        raise TypeError(f"{options!r} is not MatchOptions: give options by their names, such as initial='proximity'.")
    options = MatchOptions(**given) if options is None else replace(options, **given)
    yield Progress(0.0, "Reading the meshes")
    source, target = as_shape(source), as_shape(target)
    reading = side_by_side(_reading_steps(source), _reading_steps(target))
    surfaces = yield from spread(reading, 0.0, 0.01, "Reading the meshes")
    notes = [
        note
        for role, shape, surface in zip(("source", "target"), (source, target), surfaces, strict=True)
        for note in (*_notes_on_cloud(role, shape, surface), *_notes_on_rounding(role, surface))
    ]
    landmarks, given_twice = distinct_landmarks(options.landmarks)
    options = replace(options, landmarks=landmarks)
    return (yield from _surfaces_steps(*surfaces, options, (*notes, *given_twice)))


def _surfaces_steps(
    source: Surface, target: Surface, options: MatchOptions, notes: tuple[str, ...]
) -> Steps[MatchResult]:
    """`match_steps` of surfaces that are read, of which some notes are to be made."""
    axes, paired = checked_axes(options.common_axes), checked_regions(options.regions, source, target)
    sizes = [len(surface.working.vertices) for surface in (source, target)]
    check_memory(sizes, options.k_final, options.proxy_vertices)
    bodies = yield from spread(bodies_steps(source, target, options.seed), 0.01, 0.04, "Finding the bodies")
    known = Constraints(options.landmarks, axes, paired)
    exact = options.landmarks if options.exact_landmarks else None
    ahead = ANALYSES if options.initial in ("auto", "landmarks") else ()

    def attempt_steps(body: Bodies) -> Steps[Attempt]:
        analysing = (prepared_steps(analysed_steps(part, options), ahead) for part in (body.source, body.target))
        shapes = yield from spread(side_by_side(*analysing), 0.0, ANALYSING, "Analysing the shapes")
        pair = Pair(source, target, *shapes, options.k_final, options.step, exact, paired, notes)
        finding = _candidates_steps(pair, options.initial, known, options.initial_map)
        candidates = yield from within(finding, ANALYSING, 1.0)
        return Attempt(pair, candidates, body.coverage)

    attempts: list[Attempt] = []
    most = len(bodies) + (options.initial == "auto" and any(body.source.is_skin for body in bodies))
    for number, (start, end) in enumerate(pairwise(PARTS_OF_PROGRESS[: most + 1])):
        if number == len(bodies):
            tight = tight_bodies_steps(source, target)
            bodies.append((yield from spread(tight, start, start, "Finding the bodies")))
        try:
            attempts.append((yield from within(attempt_steps(bodies[number]), start, end)))
        except LandmarkError:  # on a part that another body has, and this one has not
            if not attempts:
                raise
        if attempts[-1].candidates[0].certainty >= ATTEMPTS.sure:
            break
    best = best_of(attempts)
    unsure = certainty_but_for_turns(best.candidates) < PART_MATCH.unsure or sizes_differ(best.pair)
    if options.initial in ("auto", "landmarks") and unsure:
        best = yield from within(_second_steps(best, known, options), *PARTS_OF_PROGRESS[-2:])
    return (yield from _result_steps(best.pair, tuple(best.candidates), 0, PARTS_OF_PROGRESS[-1]))


def analysed_steps(part: WorkingMesh, options: MatchOptions) -> Generator[float, None, ShapeAnalysis]:
    """Prepare one side of a match, a connected part of unit area, or take it as it was prepared before."""
    functions = max(options.k_final, ANALYSIS.fewest_functions)
    size = proxy_size(len(part.vertices), options.proxy_vertices)
    return (yield from kept_analysis_steps(part, functions, options.samples, options.seed, size))


def _second_steps(first: Attempt, known: Constraints, options: MatchOptions) -> Steps[Attempt]:
    """What is gone on with where the first attempt is unsure: the map of a part, or one of more guesses."""
    if options.partial == "auto" and may_be_part(first.pair):
        if too_coarse(first.pair):
            first = replace(first, pair=_with_note(first.pair, TOO_COARSE))
        else:
            second = yield from within(_part_attempt_steps(first, known), 0.0, PLACING)
            if second is not first:
                return second
            if units_differ(first.pair):
                first = replace(first, pair=_with_note(first.pair, OTHER_UNITS))
    if options.initial == "auto" and certainty_but_for_turns(first.candidates) < CERTAINTY.unlikely:
        return (yield from within(_more_steps(first, known, options.initial_map), PLACING, 1.0))
    return first


def _with_note(pair: Pair, note: str) -> Pair:
    return replace(pair, notes=(*pair.notes, note))


def _part_attempt_steps(whole: Attempt, known: Constraints) -> Steps[Attempt]:
    """An attempt at the same pair, or the one by which one shape is a part of the other, where this is surer.

    First in the unit that both are given in, if that may be one, and at any scale where this leads to no likely map.
    """
    best, other_units = whole, units_differ(whole.pair)
    if not other_units:
        pair = in_one_unit(whole.pair)
        candidates = yield from spread(part_match_steps(pair, known.disagreement(pair)), 0.0, 0.3, "Placing a part")
        best = _as_part(whole, pair, candidates, PART_MATCH.likely)
    if best.candidates[0].certainty >= UNKNOWN_SCALE.likely:
        return best
    looking = at_unknown_scale_steps(whole.pair, known.disagreement)
    found = yield from spread(looking, 0.3, 1.0, "Finding the scale of a part")
    if found is None:
        return best
    pair, candidates = found
    times, likely = times_as_large(pair), PART_MATCH.likely
    if abs(np.log(times)) > np.log(UNKNOWN_SCALE.one_unit):
        pair, likely = _with_note(pair, RESCALED.format(times)), UNKNOWN_SCALE.likely
    rescaled = _as_part(whole, pair, candidates, likely)
    surer = best is not whole and best.candidates[0].certainty >= rescaled.candidates[0].certainty
    return best if surer or rescaled is whole else rescaled


def _as_part(whole: Attempt, pair: Pair, candidates: Sequence[Candidate], likely: float) -> Attempt:
    """An attempt at a pair as two wholes, or the one by which one shape is a part of the other, where this is surer.

    Args:
        whole: the attempt at two wholes.
        pair: its pair with both shapes in one unit.
        candidates: for this pair with one shape as a part.
        likely: certainty below which no shape is taken for a part.
    """
    # The certainty of the map of two wholes knows nothing of their sizes.
    of_whole = certainty_but_for_turns(whole.candidates) * (REGION.as_wholes if is_small(*part_of(pair)) else 1)
    if not candidates or candidates[0].certainty <= max(likely, of_whole):
        return whole
    part = Attempt(pair, candidates, whole.coverage)
    areas = [shape.basis.areas.sum() for shape in (pair.source_shape, pair.target_shape)]
    if min(areas) >= PART_MATCH.nearly_whole * max(areas) and agree(whole, part):
        return confirmed(whole, candidates[0].certainty)
    return part


def _more_steps(attempt: Attempt, known: Constraints, initial_map: SurfaceMap | ArrayLike | None) -> Steps[Attempt]:
    """An attempt with the candidates of more guesses beside its own."""
    pair = attempt.pair
    shapes = pair.source_shape, pair.target_shape
    evidence = _evidence(pair, known, None if initial_map is None else given_hypothesis(pair, initial_map))
    disagreement = evidence.disagreement(pair)
    guessing = for_each(lambda guess: guess(*shapes, disagreement), MORE_GUESSES)
    guesses = yield from spread(guessing, 0.0, 0.3, "Guessing again")
    hypotheses = _held(list(chain.from_iterable(guesses)), evidence.anchors(pair))
    found = yield from spread(rank_steps(hypotheses, *shapes, disagreement), 0.3, 1.0, "Comparing candidates")
    candidates = with_others(attempt.candidates, found, *shapes)
    return replace(attempt, candidates=with_turned(candidates, *shapes, disagreement))


def _evidence(pair: Pair, known: Constraints, earlier: Hypothesis | None) -> Constraints:
    """All that is known of the map of a pair."""
    return replace(known, earlier=_images(pair, earlier), standing=_standing(pair))


def _candidates_steps(
    pair: Pair, initial: Initial, evidence: Constraints, initial_map: SurfaceMap | ArrayLike | None
) -> Steps[list[Candidate]]:
    """Maps between two shapes, the most likely first."""
    yield Progress(0.0, "Guessing")
    earlier = None if initial_map is None else given_hypothesis(pair, initial_map)
    if initial == "auto":
        evidence = _evidence(pair, evidence, earlier)
    disagreement = evidence.disagreement(pair)
    guessing = _hypotheses_steps(pair, initial, evidence, disagreement, earlier)
    ahead_of_carrying = in_background(lambda: _prepare_carrying(pair))
    hypotheses, _ = yield from spread(side_by_side(guessing, ahead_of_carrying), 0.0, 0.15, "Guessing")
    ranking = rank_steps(hypotheses, pair.source_shape, pair.target_shape, disagreement)
    candidates = yield from spread(ranking, 0.15, 1.0, "Comparing candidates")
    if initial not in ("auto", "landmarks"):
        return candidates
    return with_turned(candidates, pair.source_shape, pair.target_shape, disagreement)


def _prepare_carrying(pair: Pair) -> None:
    """Have what carrying the map over to all vertices needs worked out."""
    if not pair.target_shape.proxy.full.is_skin:
        _ = pair.target_shape.proxy.place, pair.source_shape.proxy.place
    _ = pair.source_shape.neighbourhoods


def prepared_steps(
    steps: Generator[float, None, Result], ahead: tuple[Callable[[Result], object], ...]
) -> Generator[float, None, Result]:
    """What steps return, when it has been asked for what will be needed of it."""
    result = yield from steps
    for prepare in ahead:
        yield 0.97
        prepare(result)
    return result


def _reading_steps(shape: Surface | PointCloud) -> Generator[float, None, Surface]:
    """The surface of a shape, with its working mesh, in a single step."""
    yield from ()
    surface = as_surface(shape)
    kept_working_mesh(surface)
    return surface


def _notes_on_cloud(role: str, shape: Surface | PointCloud, surface: Surface) -> tuple[str, ...]:
    """What points alone do not tell."""
    if not isinstance(shape, PointCloud):
        return ()
    left_out = int((surface.working.vertex_of < 0).sum())
    notes = (
        (
            shape.normals is None and not surface.working.sides_are_known,
            f"Nothing tells the outer side of the {role}, an open point cloud without normals: this map may be the "
            "mirror image of the right one; compare the other candidates.",
        ),
        (
            left_out > NOTES.without_partner * len(shape.points),
            f"{left_out} of the {role}'s points are on no part of the surface that runs through the others: noise, or "
            "another density.",
        ),
    )
    return tuple(text for true, text in notes if true)


def _notes_on_rounding(role: str, surface: Surface) -> tuple[str, ...]:
    """What is lost of coordinates so far from the origin that single precision hardly tells them apart."""
    coarse = surface.rounding / np.sqrt(2 * surface.area / len(surface.triangles))
    if coarse < NOTES.rounding:
        return ()
    return (
        f"The {role} lies so far from its origin that its coordinates are rounded by {coarse:.0%} of an edge: move it "
        "to the origin in the program that made it.",
    )


def _result_steps(pair: Pair, candidates: tuple[Candidate, ...], chosen: int, start: float) -> Steps[MatchResult]:
    candidate = candidates[chosen]
    refining = _part_steps if candidate.part_match is not None else _whole_steps
    refined = yield from spread(refining(pair, candidate), start, 0.95, "Refining")
    carrying = in_background(lambda: lifted(pair, refined.fit, refined.confidence, refined.partners))
    whole = yield from spread(carrying, 0.95, 1.0, "Carrying over to all vertices")
    notes = (*_notes_on_rest(pair, whole.partners), *whole.notes, *pair.notes)
    if refined.over > NOTES.folds:
        notes = (
            f"The map turns over {refined.over:.0%} of the target's surface, where the two shapes differ too much: "
            "confidence is low there.",
            *notes,
        )
    certainty = candidate.certainty * whole.placed
    if certainty < NOTES.sure:
        turns = likely_turns(candidates, chosen)
        unsure = (UNSURE if certainty >= NOTES.lost else NOT_RECOGNISED).format(certainty)
        recognised = certainty_but_for_turns(candidates) * whole.placed >= NOTES.lost
        notes = (TURNED.format(turns, certainty) if turns > 1 and recognised else unsure, *notes)
    return MatchResult(
        whole.surface_map,
        whole.confidence,
        *whole.partners,
        refined.functional_map,
        candidates,
        chosen,
        notes,
        pair,
        whole.placed,
    )


class Refined(NamedTuple):
    """The map of a candidate between the shapes' meshes.

    Attributes:
        fit: of the target to the source.
        partners: which vertices have one.
        functional_map: (k_target, k_source).
        confidence: (n_t,) of the target's vertices.
        over: the part of the target's area, in [0, 1], that the map turns over.
    """

    fit: Fit
    partners: Partners
    functional_map: Floats
    confidence: Floats
    over: float


def _whole_steps(pair: Pair, candidate: Candidate) -> Generator[float, None, Refined]:
    """The map of all of the target, by eigenfunctions and by bending it; yields the fraction done."""
    source, target = pair.source_shape, pair.target_shape
    how = candidate.mirrored, pair.k_final, pair.step
    swapped = None if candidate.final_anchors is None else candidate.final_anchors.swapped()
    refining = dense_steps(source, target, candidate.functional_map, candidate.final_anchors, *how)
    forwards = fitted_steps(refining, source, target, candidate.mirrored)
    fewer = candidate.mirrored, min(pair.k_final, REFINEMENT.most_functions_back), pair.step
    refining_back = dense_steps(target, source, candidate.reverse_functional_map, swapped, *fewer)
    # The map back ends first: there is time to prepare what carrying over needs.
    backwards = prepared_steps(refining_back, (lambda _: source.proxy.search,))
    (fit, functional_map), (back, _) = yield from side_by_side(forwards, backwards)
    if pair.exact_landmarks is not None and not target.proxy.full.is_skin:
        fit = Fit.unfitted(pinned(fit.surface_map, pair, pair.exact_landmarks))
    measured = confidence_of(fit.surface_map, back, functional_map, source, target, candidate.reverses_orientation)
    return Refined(fit, partners_by_cycle(fit.surface_map, back, source, target), functional_map, *measured)


def _part_steps(pair: Pair, candidate: Candidate) -> Generator[float, None, Refined]:
    """The map of a part and a whole, either way, by bending the part; yields the fraction done."""
    source, target = pair.source_shape, pair.target_shape
    found = yield from part_fit_steps(pair, candidate)
    fit = found.fit
    if pair.exact_landmarks is not None:
        fit = Fit.unfitted(pinned(fit.surface_map, pair, pair.exact_landmarks))
    there = fit.surface_map
    k_target, k_source = candidate.functional_map.shape
    images = there.interpolate(source.basis.eigenvectors[:, :k_source])
    functional_map = target.basis.coefficients(images)[:k_target]
    known = found.partners.target
    confidence, over = confidence_of(there, found.back, functional_map, source, target, False, known)
    if is_small(source, target):
        confidence, over = _confidence_by_part(pair, found, (k_target, k_source))
    # Between the bases of both at unit area, as of all maps.
    functional_map *= np.sqrt(source.basis.areas.sum() / target.basis.areas.sum())
    return Refined(fit, found.partners, functional_map, confidence, over)


def _confidence_by_part(pair: Pair, found: PartFit, size: tuple[int, int]) -> tuple[Floats, float]:
    """`confidence_of` the map of a whole to a small part, as told by the map of the part.

    What the rest of the whole does, all of which goes to the part as well, would outweigh the part's own place.
    """
    (k_target, k_source), source, target = size, pair.source_shape, pair.target_shape
    images = found.back.interpolate(target.basis.eigenvectors[:, :k_target])
    functional_map = source.basis.coefficients(images)[:k_source]
    has_partner = found.partners.source
    of_part, over = confidence_of(found.back, found.fit.surface_map, functional_map, target, source, False, has_partner)
    return found.partners.target * found.fit.surface_map.interpolate(of_part), over


def fitted_steps(
    refining: Generator[float, None, tuple[SurfaceMap, Floats]],
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    mirrored: bool,
) -> Generator[float, None, tuple[Fit, Floats]]:
    """A refined map with the target bent onto the source by it, and the functional map of what comes of that."""
    refined, functional_map = yield from scaled(refining, 0.0, 0.6)
    fit = yield from scaled(fit_steps(refined, source, target, mirrored), 0.6, 1.0)
    k_target, k_source = functional_map.shape
    images = fit.surface_map.interpolate(source.basis.eigenvectors[:, :k_source])
    return fit, target.basis.coefficients(images)[:k_target]


def _notes_on_rest(pair: Pair, partners: Partners) -> tuple[str, ...]:
    """What is said about parts that only one of the two surfaces has."""
    notes = (
        (pair.target, partners.target, "target seems to have no partner on the source: confidence is low there."),
        (pair.source, partners.source, "source seems to have no partner on the target: nothing was matched to it."),
    )
    shares = ((surface.share_of_area(~has_partner), text) for surface, has_partner, text in notes)
    return tuple(f"About {share:.0%} of the {text}" for share, text in shares if share > NOTES.without_partner)


def _hypotheses_steps(
    pair: Pair, initial: Initial, evidence: Constraints, disagreement: Disagreement, earlier: Hypothesis | None
) -> Generator[float, None, list[Hypothesis]]:
    """What the match may begin with; yields the fraction done."""
    source, target = pair.source_shape, pair.target_shape
    if initial == "given" and earlier is not None:
        return [earlier]
    if initial == "proximity":
        return [proximity_hypothesis(pair)]
    guesses = yield from for_each(lambda guess: guess(source, target, disagreement), GUESSES)
    hypotheses = [*chain.from_iterable(guesses), *rotation_hypotheses(source, target)]
    if not (has_extremities(source) and has_extremities(target)):
        # They are many, and on 40 pairs of shapes with extremities they added no success.
        hypotheses += sign_hypotheses(source, target)
    if evidence.standing is not None:
        hypotheses.insert(0, proximity_hypothesis(pair))
    if earlier is not None:
        hypotheses.insert(0, earlier)
    anchors = evidence.anchors(pair)
    if evidence.landmarks is not None:
        by_landmarks = landmark_hypothesis(source, target, *landmarks_on_parts(pair, evidence.landmarks))
        assert by_landmarks.anchors is not None
        hypotheses.insert(0, replace(by_landmarks, anchors=None))
        anchors = by_landmarks.anchors.scaled(CONSTRAINTS.landmarks_over_guesses).and_those(anchors)
    return _held(hypotheses, anchors)


def _held(hypotheses: list[Hypothesis], anchors: Anchors | None) -> list[Hypothesis]:
    """Hypotheses that places which are known hold there to the end, whatever they begin with."""
    if anchors is None:
        return hypotheses
    held = [anchors.and_those(guess.anchors) for guess in hypotheses]
    return [replace(guess, anchors=both, final_anchors=both) for guess, both in zip(hypotheses, held, strict=True)]


def _images(pair: Pair, earlier: Hypothesis | None) -> Integers | None:
    """(s,) vertex of the source's shape for each search sample of the target, by an earlier map."""
    if earlier is None:
        return None
    source, target = pair.source_shape, pair.target_shape
    return nearest(*coordinates(target.search.rows, source.basis.eigenvectors, earlier.functional_map, None))


def _standing(pair: Pair) -> Floats | None:
    """(s, 3) where the target's search samples are, in the frame of the source's part; None if that tells nothing."""
    places = None if pair.source is pair.target else overlapping(pair)
    return None if places is None else places[pair.target_shape.search.samples]
