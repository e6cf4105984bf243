# SPDX-License-Identifier: GPL-3.0-or-later
"""Match two surfaces: analyse both, generate, rank and refine maps, and extend the best one to full resolution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.matching.attempt import ATTEMPTS, Attempt, best_of
from zoomout_core.matching.components.bodies import Bodies, find_bodies, tight_bodies
from zoomout_core.matching.constraints import Constraints, check_axes, check_regions, landmark_errors
from zoomout_core.matching.hypotheses.collect import collect_hypotheses, gather_evidence, hypothesis_of_landmarks
from zoomout_core.matching.hypotheses.given import given_hypothesis
from zoomout_core.matching.match_signature import MatchArguments, check_names, with_arguments
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.pair import LandmarkError, Pair, distinct_landmarks, landmark_points
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.memory_cache import cached_working_mesh
from zoomout_core.matching.preparation.memory_need import check_memory
from zoomout_core.matching.preparation.prepare import AHEAD, prepare_shape
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.finished_maps import rank_finished
from zoomout_core.matching.ranking.rank import rank, upsample_hypothesis
from zoomout_core.matching.ranking.rotational_symmetry import self_maps, with_turned
from zoomout_core.matching.report.notes import notes_on_input, notes_on_landmarks
from zoomout_core.matching.result import MatchResult, make_result, outline
from zoomout_core.matching.retry import needs_retry, retry
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.shapes import ShapeLike, as_shape, as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.progress import Progress, listening, portion, show_outlines, stage
from zoomout_core.runtime.threads import for_each, in_one_thread, on_one_blas_thread, side_by_side

# Fractions of the progress at which each pair of bodies, a retry and the refinement begin; the last pair ends with the
# last of the first.
BODIES_BEGIN, RETRY_BEGINS, RESULT_BEGINS = (0.04, 0.5, 0.6, 0.68), 0.68, 0.75
# Minimum number of landmarks whose map is shown as a first look: fewer leave open how a shape is turned about them.
MIN_LANDMARKS_SHOWN = 3
# Fraction of the progress of a pair of bodies at which the analysis of the shapes ends.
ANALYSED = 0.8


@dataclass(frozen=True, eq=False)
class _Request:
    """Two surfaces to match.

    Attributes:
        source: the source.
        target: the target.
        known: evidence from the user.
        options: options of the match.
        notes: notes on the input, for the result.
    """

    source: Surface
    target: Surface
    known: Constraints
    options: MatchOptions
    notes: tuple[str, ...]


@with_arguments(MatchArguments)
@memory_in_words
@on_one_blas_thread
def match(
    source: ShapeLike,
    target: ShapeLike,
    options: MatchOptions | None = None,
    *,
    progress: Callable[[Progress], object] | None = None,
    **given: Any,
) -> MatchResult:
    """Find for every vertex of the target the point on the source that it corresponds to.

    Args:
        source: the surface that the map lands on; it carries the attributes. A point cloud is replaced by the surface
            reconstructed from it, `PointCloud.surface`. Arrays (vertices, faces), a mesh of another library and the
            path of a file are accepted as well, see `ShapeLike`.
        target: the surface, or the points, that the map starts from; it receives them.
        options: options of the match; keyword arguments override them.
        progress: called with the `Progress` from time to time, see `zoomout_core.progress`.
        given: options as keyword arguments; they override `options`.

    Returns:
        The most likely map, with alternatives. Its `verdict` and `notes` report what is uncertain.

    Raises:
        MeshError: a mesh cannot be matched; the message says what to do.
        ValueError: options contradict each other.

    Example:
        >>> result = zo.match(source, target, k_final=40)
        >>> result.surface_map.vertex.shape == (len(target.vertices),)
        True
    """
    if options is not None and not isinstance(options, MatchOptions):
        raise TypeError(f"{options!r} is not MatchOptions: give options by their names, such as initial='proximity'.")
    check_names(given)
    options = MatchOptions(**given) if options is None else replace(options, **given)
    with listening(progress):
        with stage("Reading the meshes", 0.0, 0.01):
            shapes = as_shape(source), as_shape(target)
            surfaces = side_by_side(lambda: _read(shapes[0]), lambda: _read(shapes[1]))
        landmarks, repeated = distinct_landmarks(options.landmarks)
        of_source, of_target = map(notes_on_input, ("source", "target"), shapes, surfaces)
        options = replace(options, landmarks=landmarks)
        return _match_surfaces(*surfaces, options, (*of_source, *of_target, *repeated))


@memory_in_words
@on_one_blas_thread
def prepare(source: Surface, target: Surface, options: MatchOptions) -> None:
    """Analyse two surfaces in one thread, ahead of their automatic match, which then finds them in the cache.

    Raises:
        MeshError: a mesh cannot be matched.
    """
    with in_one_thread():
        with stage("Reading the meshes", 0.0, 0.02):
            for surface in (source, target):
                cached_working_mesh(surface)
        sizes = [len(surface.working.vertices) for surface in (source, target)]
        check_memory(sizes, options.k_final, options.proxy_vertices)
        with stage("Finding the bodies", 0.02, 0.05):
            body, *_ = find_bodies(source, target, options.seed)
        with stage("Analyzing the shapes", 0.05, 1.0):
            for shape in _analyse(body, options, AHEAD):
                _prepare_rest(shape, turns=True)
                _ = shape.surface_vertex


def _match_surfaces(source: Surface, target: Surface, options: MatchOptions, notes: tuple[str, ...]) -> MatchResult:
    """`match` of surfaces; notes on these are passed on to the result."""
    axes, regions = check_axes(options.common_axes), check_regions(options.regions, source, target)
    known = Constraints(options.landmarks, axes, regions, upright=options.upright)
    sizes = [len(surface.working.vertices) for surface in (source, target)]
    check_memory(sizes, options.k_final, options.proxy_vertices)
    best = best_of(_attempt_bodies(_Request(source, target, known, options, notes)))
    if needs_retry(best, options):
        with portion(RETRY_BEGINS, RESULT_BEGINS):
            best = retry(best, known, options)
    _show_candidates(best.pair, best.candidates)
    with portion(RESULT_BEGINS, 1.0):
        result = make_result(best.pair, tuple(best.candidates), 0)
    if options.landmarks is None:
        return result
    errors = landmark_errors(result.surface_map, source, target, *landmark_points(result.pair, options.landmarks))
    return replace(result, notes=(*notes_on_landmarks(errors), *result.notes))


def _attempt_bodies(request: _Request) -> list[Attempt]:
    """Match pairs of bodies of two surfaces, the most promising first, until a map is certain.

    Tight hulls come last, for automatic matches of surfaces that have hulls.
    """
    source, target = request.source, request.target
    with stage("Finding the bodies", 0.01, BODIES_BEGIN[0]):
        bodies = find_bodies(source, target, request.options.seed)
    attempts: list[Attempt] = []
    tries_tight = request.options.initial == "auto" and any(body.source.is_hull for body in bodies)
    for number, (start, end) in enumerate(pairwise(BODIES_BEGIN[: len(bodies) + tries_tight + 1])):
        if number == len(bodies):
            with stage("Finding the bodies", start, start):
                bodies.append(tight_bodies(source, target, bodies[0].shares))
        try:
            with portion(start, end):
                attempts.append(_attempt(request, bodies[number]))
        except LandmarkError:  # a landmark is on a part that only another body has
            if not attempts:
                raise
        if attempts[-1].candidates[0].certainty >= ATTEMPTS.certain:
            break
    return attempts


def _attempt(request: _Request, body: Bodies) -> Attempt:
    """Match one body of the source with one of the target."""
    known, options = request.known, request.options
    automatic = options.initial in ("auto", "landmarks")
    with stage("Analyzing the shapes", 0.0, ANALYSED):
        shapes = _analyse(body, options, AHEAD if automatic else ())
    exact = options.landmarks if options.exact_landmarks else None
    pair = Pair(
        request.source,
        request.target,
        *shapes,
        k_final=options.k_final,
        step=options.step,
        exact_landmarks=exact,
        regions=known.regions,
        notes=request.notes,
        shares=body.shares,
    )
    with portion(ANALYSED, 1.0):
        return Attempt(pair, _find_candidates(pair, known, options), body.coverage)


def _analyse(
    body: Bodies, options: MatchOptions, ahead: tuple[Callable[[ShapeAnalysis], object], ...]
) -> tuple[ShapeAnalysis, ShapeAnalysis]:
    """The analyses of two bodies, and further computations on each that are done ahead."""
    settings = options.k_final, options.samples, options.seed, options.proxy_vertices, ahead
    return side_by_side(lambda: prepare_shape(body.source, *settings), lambda: prepare_shape(body.target, *settings))


def _find_candidates(pair: Pair, known: Constraints, options: MatchOptions) -> list[Candidate]:
    """Maps between two shapes, the most likely first."""
    shapes = pair.source_shape, pair.target_shape
    automatic = options.initial in ("auto", "landmarks")
    with stage("Guessing", 0.0, 0.15):
        by_landmarks = hypothesis_of_landmarks(pair, known)
        landmark_count = 0 if known.landmarks is None else len(np.asarray(known.landmarks[0]))
        if by_landmarks is not None and landmark_count >= MIN_LANDMARKS_SHOWN:
            _show(pair, [upsample_hypothesis(by_landmarks, *shapes)[1]])
        earlier = None if options.initial_map is None else given_hypothesis(pair, options.initial_map)
        evidence = gather_evidence(pair, known, earlier) if options.initial == "auto" else known
        disagreement = evidence.disagreement(pair)
        hypotheses = collect_hypotheses(pair, options.initial, evidence, disagreement, earlier, by_landmarks)
    with stage("Comparing candidates", 0.15, 0.8):
        candidates = rank(hypotheses, *shapes, disagreement, show=partial(_show, pair))
        _show_candidates(pair, candidates)
    with stage("Comparing finished maps", 0.8, 1.0):
        with portion(0.0, 0.2):
            for_each(partial(_prepare_rest, turns=automatic), shapes)
        with portion(0.2, 1.0):
            candidates = rank_finished(candidates, *shapes, pair.step)
    return with_turned(candidates, *shapes, disagreement) if automatic else candidates


def _show_candidates(pair: Pair, candidates: Sequence[Candidate]) -> None:
    """Give listeners a first look at the candidates."""
    _show(pair, [candidate.sample_map for candidate in candidates])


def _show(pair: Pair, sample_maps: Sequence[Integers]) -> None:
    """Give listeners a first look at maps (s_t,), which give the source sample of each search sample."""
    show_outlines(lambda: tuple(outline(pair, sample_map) for sample_map in sample_maps))


def _prepare_rest(shape: ShapeAnalysis, turns: bool) -> None:
    """Compute data that only stages after the candidates need, so that the first look need not wait for it."""
    if turns:
        self_maps(shape)
    if not shape.proxy.full.is_hull:
        _ = shape.proxy.place
    _ = shape.neighbourhoods


def _read(shape: Surface | PointCloud) -> Surface:
    """The surface of a shape, with its working mesh."""
    surface = as_surface(shape)
    cached_working_mesh(surface)
    return surface
