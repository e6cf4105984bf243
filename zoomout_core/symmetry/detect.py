# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect the symmetries of a surface in any pose: maps onto itself that preserve distances along it.

Ovsjanikov, Sun and Guibas (2008) found that such symmetries are signs and rotations of eigenfunctions; Melzi et al.
(2019, section 5.3) refine them by ZoomOut. Here they are found like maps between two surfaces, from a shape to itself,
except the identity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats, check_count
from zoomout_core.maps.functional_map import commutativity_error, orthonormality_error
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.attempt import ATTEMPTS, Attempt
from zoomout_core.matching.components.lift import lift
from zoomout_core.matching.options import check_sizes
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.memory_need import check_memory
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.rank import rank
from zoomout_core.matching.refinement.confidence import Partners, confidence_of
from zoomout_core.matching.refinement.refine import REFINEMENT, functional_map_by, refine
from zoomout_core.matching.registration.nonrigid_icp import Fit, fit_nonrigid
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import ShapeLike, as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.messages import probability
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.runtime.progress import Progress, listening, portion, stage
from zoomout_core.runtime.threads import for_each, on_one_blas_thread, side_by_side
from zoomout_core.symmetry.hypotheses import GENERATORS
from zoomout_core.symmetry.involution import involution, order_of, return_error
from zoomout_core.symmetry.ranking import SURE_SYMMETRY_CERTAINTY, is_no_part_of_identity, rank_symmetries
from zoomout_core.symmetry.self_map import K_FINAL, SAMPLES, SelfMap, bodies_of, body_shape
from zoomout_core.symmetry.sides import leftward, on_whole_surface, signed_distance

# A character in Blender faces -y, so its left is +x.
LEFT = (1.0, 0.0, 0.0)
# Fractions of the progress at which the analysis of the first body begins, that of a second one, and the rest.
START_OF_BODY = 0.02, 0.55, 0.7
# Size of the leading block of the functional map whose errors are reported beside those of the whole map.
LOW = 20
# Fraction of a body's progress that its analysis takes.
ANALYSING = 0.8

# Minimum and maximum number of compared maps that preserve the orientation, and of those that reverse it.
CANDIDATE_QUOTAS = ((1, 16), (3, 20))
# Minimum certainty of a returned symmetry, except for the most likely one.
MIN_SYMMETRY_CERTAINTY = 0.05
# Left and right are reported as unclear if images are to the left by less than this share of their distances.
MIN_LEFTWARD_SHARE = 0.2


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Symmetry(SelfMap):
    """A detected symmetry of a surface: a `SelfMap` with further properties.

    Attributes:
        functional_map: (k, k), in the basis of the main part.
        order: how many repetitions give the identity: 2 for a reflection; 0 if no small number does.
        certainty: probability, in [0, 1], that the surface has this symmetry.
        scores: the ranking scores, and `commutativity` and `orthonormality` of the functional map, also of its leading
            20 functions (`low ...`).
        return_error: mean distance between a vertex and its image after `order` repetitions, for a reflection T(T(x)),
            relative to the square root of the area.
        origin: description of how it was found.
        notes: sentences for the user.

    Example:
        >>> symmetry, *others = zo.detect_symmetry(source, k_final=30)
        >>> symmetry.sides().shape == (len(source.vertices),)
        True
    """

    functional_map: Floats
    order: int
    certainty: float
    scores: dict[str, float]
    return_error: float
    origin: str
    notes: tuple[str, ...]

    def _summary(self) -> dict[str, str]:
        return super()._summary() | {
            "certainty": probability(self.certainty),
            "order": str(self.order or "no small one"),
            "origin": self.origin,
            "notes": " ".join(self.notes) or "none",
        }


@suggest_names
@memory_in_words
@on_one_blas_thread
def detect_symmetry(
    surface: ShapeLike,
    max_count: int = 8,
    left: ArrayLike = LEFT,
    k_final: int = K_FINAL,
    step: int = 20,
    samples: int = SAMPLES,
    seed: int = 0,
    proxy_vertices: int | Literal["auto"] | None = "auto",
    *,
    progress: Callable[[Progress], object] | None = None,
) -> tuple[Symmetry, ...]:
    """Find the symmetries of a surface, in any pose and with any mesh.

    Args:
        surface: the surface or a point cloud of it. Its largest part determines the symmetry; loose parts follow, such
            as a left eye onto the right one.
        max_count: maximum number of symmetries to return.
        left: (3,) direction to the character's left in the surface's frame, which distinguishes the sides.
        k_final: size of the final functional maps; smaller on meshes with fewer vertices.
        step: growth of the functional maps per iteration.
        samples: farthest points that the iterations run on.
        seed: seed of the eigensolver.
        proxy_vertices: larger meshes are analysed by proxies of about this many vertices; "auto": as for `match`; None
            for no proxies.
        progress: called with the `Progress` now and then, see `zoomout_core.progress`.

    Returns:
        Symmetries other than the identity, the most likely first. There is a best guess unless none was found at all;
        check its `certainty`.

    Raises:
        MeshError: a mesh that cannot be analysed; the message says what to do.
        ValueError: a number or a direction is invalid.

    Example:
        >>> symmetry, *others = zo.detect_symmetry(source, k_final=30)
        >>> symmetry.reverses_orientation
        True
    """
    check_sizes(k_final, step, samples, proxy_vertices)
    check_count("max_count", max_count, 1)
    check_count("seed", seed, 0)
    to_the_left, surface = _unit_vector(left), as_surface(surface)
    check_memory([len(surface.working.vertices)], k_final, proxy_vertices)
    with listening(progress):
        best = _best_attempt(surface, k_final, step, samples, seed, proxy_vertices)
        if best is None:
            return ()
        least = MIN_SYMMETRY_CERTAINTY
        chosen = [entry for i, entry in enumerate(best.candidates[:max_count]) if i == 0 or entry.certainty >= least]
        with stage("Refining", START_OF_BODY[-1], 1.0):
            found = for_each(lambda candidate: _symmetry(best.pair, candidate, to_the_left), chosen)
    return tuple(sorted(found, key=_sort_key))


def _best_attempt(
    surface: Surface, k_final: int, step: int, samples: int, seed: int, proxy_vertices: int | Literal["auto"] | None
) -> Attempt | None:
    """The body of a surface with the most likely symmetries; None if no body has any."""
    with portion(0.0, START_OF_BODY[0]):
        bodies = bodies_of(surface, seed)
    attempts: list[Attempt] = []
    for body, start, end in zip(bodies, START_OF_BODY, START_OF_BODY[1:], strict=False):
        compared = start + ANALYSING * (end - start)
        with portion(start, compared):
            shape = body_shape(body.source, k_final, samples, seed, proxy_vertices)
        pair = Pair(surface, surface, shape, shape, k_final, step)
        with stage("Comparing candidates", compared, end):
            candidates = find_candidates(shape)
        if candidates:
            attempts.append(Attempt(pair, candidates, body.coverage))
        if candidates and candidates[0].certainty >= ATTEMPTS.certain:
            break
    # Maps that agree in most places may still differ on an arm, so candidates do not confirm each other.
    return max(attempts, key=lambda attempt: attempt.worth, default=None)


def find_candidates(shape: ShapeAnalysis) -> list[Candidate]:
    """Maps of a shape onto itself that may be symmetries, the most likely first."""
    with portion(0.0, 0.4):
        generated = for_each(lambda generate: generate(shape), GENERATORS)
    with portion(0.4, 1.0):
        candidates = rank(
            list(chain(*generated)),
            shape,
            shape,
            quotas=CANDIDATE_QUOTAS,
            clear_orientation=0.0,
            wanted=lambda sample_map, reverses: is_no_part_of_identity(sample_map, reverses, shape),
        )
    return rank_symmetries(candidates, shape)


def _symmetry(pair: Pair, candidate: Candidate, left: Floats) -> Symmetry:
    """Extend a candidate on samples to a symmetry of the whole surface."""
    shape = pair.source_shape
    order = order_of(candidate.sample_map, shape)

    def forwards() -> tuple[Fit, Floats]:
        with portion(0.0, 0.6):
            refined, functional_map = _refine(candidate.functional_map, pair, candidate.mirrored)
        with portion(0.6, 1.0):
            fit = fit_nonrigid(refined, shape, shape, candidate.mirrored)
            return fit, functional_map_by(fit.surface_map, shape, shape, functional_map.shape)

    with portion(0.0, 0.7):
        if order == 2:  # the map is its own inverse
            fit, functional_map = forwards()
            back = fit.surface_map
        else:
            (fit, functional_map), (back, _) = side_by_side(
                forwards, lambda: _refine(candidate.reverse_functional_map, pair, candidate.mirrored)
            )
    with portion(0.7, 1.0):
        return _finish(pair, candidate, fit, back, functional_map, order, left)


def _refine(functional_map: Floats, pair: Pair, mirrored: bool) -> tuple[SurfaceMap, Floats]:
    """Refine the map of a shape onto itself at all vertices, from its functional map (k, k)."""
    shape = pair.source_shape
    return refine(shape, shape, functional_map, None, mirrored, pair.k_final, pair.step, REFINEMENT.onto_itself)


def _finish(
    pair: Pair, candidate: Candidate, fit: Fit, back: SurfaceMap, functional_map: Floats, order: int, left: Floats
) -> Symmetry:
    """Make the symmetry of the whole surface from the shape fitted to its other side, and the inverse map."""
    shape, surface, reverses = pair.source_shape, pair.source, candidate.reverses_orientation
    senses = reverses, candidate.mirrored
    confidence, _ = confidence_of(fit.surface_map, back, functional_map, shape, shape, *senses)
    if order == 2:
        fit = replace(fit, surface_map=involution(fit.surface_map, shape))
    everywhere = np.ones(len(confidence), dtype=bool)
    surface_map, confidence, _, placed, notes = lift(pair, fit, confidence, Partners(everywhere, everywhere))
    distance = np.zeros(len(surface.vertices))
    on_mesh = signed_distance(fit.surface_map, shape) if reverses and order == 2 else None
    if on_mesh is not None:
        distance = on_whole_surface(on_mesh, surface_map, shape, surface)
        towards = leftward(distance, surface_map, surface, left)
        distance = -distance if towards < 0 else distance
        if abs(towards) < MIN_LEFTWARD_SHARE:
            notes = ("The axis hardly separates left from right: check the sides, or choose another axis.", *notes)
    return Symmetry(
        surface=surface,
        surface_map=surface_map,
        confidence=confidence,
        reverses_orientation=reverses,
        distance=distance,
        prepared=shape,
        functional_map=functional_map,
        order=order,
        certainty=candidate.certainty * placed,
        scores=candidate.scores | isometry_errors(functional_map, shape.basis.eigenvalues),
        return_error=return_error(surface_map, order, surface),
        origin=candidate.origin,
        notes=notes,
    )


def _sort_key(symmetry: Symmetry) -> tuple[float, float]:
    """Sort key of symmetries: certain ones first, and among these the ones that pair the most loose parts."""
    surface = symmetry.surface
    alone = (symmetry.confidence == 0)[surface.triangles].all(axis=1)
    areas = triangle_areas(surface.vertices, surface.triangles)
    return -min(symmetry.certainty, SURE_SYMMETRY_CERTAINTY), round(float(areas[alone].sum() / areas.sum()), 2)


def _unit_vector(left: ArrayLike) -> Floats:
    """(3,) a user's direction, scaled to unit length."""
    try:
        direction = np.asarray(left, dtype=float)
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not 0 < np.linalg.norm(direction) < np.inf:
        raise ValueError(f"left is {left!r}: give a direction such as (1, 0, 0).")
    return np.asarray(direction / np.linalg.norm(direction))


def isometry_errors(functional_map: Floats, eigenvalues: Floats) -> dict[str, float]:
    """Commutativity and orthonormality errors, zero for an isometry, of a map (k, k) and of its low block."""
    low = functional_map[:LOW, :LOW]
    return {
        "commutativity": commutativity_error(functional_map, eigenvalues, eigenvalues),
        "orthonormality": orthonormality_error(functional_map),
        "low commutativity": commutativity_error(low, eigenvalues, eigenvalues),
        "low orthonormality": orthonormality_error(low),
    }
