# SPDX-License-Identifier: GPL-3.0-or-later
"""Refine a candidate to a map between the meshes of two shapes: ZoomOut, then non-rigid registration both ways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.part_match import PartFit, fit_part
from zoomout_core.matching.partial.region import is_small
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.finished_maps import refine_candidate
from zoomout_core.matching.refinement.confidence import Partners, confidence_of, local_distortion, partners_by_cycle
from zoomout_core.matching.refinement.distorted_regions import (
    Placement,
    find_placements,
    move_regions,
    move_regions_back,
)
from zoomout_core.matching.refinement.extremity_pins import pin_extremities
from zoomout_core.matching.refinement.refine import REFINEMENT, functional_map_by, refine
from zoomout_core.matching.registration.both_ways import average_both_ways
from zoomout_core.matching.registration.nonrigid_icp import Fit, fit_nonrigid
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import side_by_side

# The fraction of the progress after which the registrations in both directions are averaged.
AVERAGING = 0.8


class DenseMap(NamedTuple):
    """The map of a candidate between the shapes' meshes."""

    fit: Fit  # of the target to the source
    partners: Partners  # which vertices have a partner
    functional_map: Floats  # (k_target, k_source)
    confidence: Floats  # (n_t,) of the target's vertices
    flipped: float  # the part of the target's area, in [0, 1], that the map flips


def dense_map(pair: Pair, candidate: Candidate) -> DenseMap:
    """Refine a candidate on all vertices of the shapes' meshes."""
    return _map_of_wholes(pair, candidate) if candidate.part_match is None else _map_of_part(pair, candidate)


def _map_of_wholes(pair: Pair, candidate: Candidate) -> DenseMap:
    """The map of the whole target, by ZoomOut and by non-rigid registration."""
    source, target = pair.source_shape, pair.target_shape

    def forwards() -> tuple[Fit, tuple[int, ...], list[Placement]]:
        with portion(0.0, 0.6):
            refined, functional_map = refine_candidate(candidate, source, target, pair.k_final, pair.step)
        placements = _placements(refined, candidate, source, target)
        refined = move_regions(refined, placements, source, target, candidate.mirrored)
        with portion(0.6, 1.0):
            return fit_nonrigid(refined, source, target, candidate.mirrored), functional_map.shape, placements

    def backwards() -> SurfaceMap:
        how = candidate.mirrored, min(pair.k_final, REFINEMENT.max_functions_back), pair.step
        swapped = None if candidate.final_anchors is None else candidate.final_anchors.swap()
        back, _ = refine(target, source, candidate.reverse_functional_map, swapped, *how)
        _ = source.proxy.search  # the map back ends first: there is time to prepare what the lift needs
        return back

    with portion(0.0, AVERAGING):
        (fit, size, placements), back = side_by_side(forwards, backwards)
    back = move_regions_back(back, placements, source, target, candidate.mirrored)
    pinned = pin_extremities(fit.surface_map, back, source, target)
    with portion(AVERAGING, 1.0):
        if pinned is not None:
            stretched, pins = pinned
            with portion(0.0, 0.0):  # few maps are registered twice
                fit = fit_nonrigid(stretched, source, target, candidate.mirrored, pins)
        fit = average_both_ways(fit, source, target, candidate.mirrored)
    functional_map = functional_map_by(fit.surface_map, source, target, size)
    senses = candidate.reverses_orientation, candidate.mirrored
    measured = confidence_of(fit.surface_map, back, functional_map, source, target, *senses)
    return DenseMap(fit, partners_by_cycle(fit.surface_map, back, source, target), functional_map, *measured)


def _placements(
    refined: SurfaceMap, candidate: Candidate, source: ShapeAnalysis, target: ShapeAnalysis
) -> list[Placement]:
    """New poses of the regions that a candidate's map distorts; none if the user's landmarks keep it in place."""
    if candidate.final_anchors is not None:
        return []
    distortion = candidate.distortion
    if distortion is None:
        distortion = local_distortion(refined, source, target, candidate.mirrored)
    return find_placements(refined, distortion, source, target, candidate.mirrored)


def _map_of_part(pair: Pair, candidate: Candidate) -> DenseMap:
    """The map between a part and a whole, in either direction, by registering the part."""
    source, target = pair.source_shape, pair.target_shape
    found = fit_part(pair, candidate)
    fit = found.fit
    there = fit.surface_map
    functional_map = functional_map_by(there, source, target, candidate.functional_map.shape)
    known = found.partners.target
    confidence, flipped = confidence_of(there, found.back, functional_map, source, target, has_partner=known)
    if is_small(source, target):
        confidence, flipped = _confidence_by_part(found, source, target, functional_map.shape)
    # Between the bases of both at unit area, as of all maps.
    functional_map *= np.sqrt(source.basis.areas.sum() / target.basis.areas.sum())
    return DenseMap(fit, found.partners, functional_map, confidence, flipped)


def _confidence_by_part(
    found: PartFit, source: ShapeAnalysis, target: ShapeAnalysis, size: tuple[int, ...]
) -> tuple[Floats, float]:
    """`confidence_of` the map of a whole to a small part, computed from the map of the part.

    All of the whole maps to the part, so the rest of it would outweigh the place of the part.
    """
    there, known = found.fit.surface_map, found.partners.source
    functional_map = functional_map_by(found.back, target, source, size[::-1])
    of_part, flipped = confidence_of(found.back, there, functional_map, target, source, has_partner=known)
    return found.partners.target * there.interpolate(of_part), flipped
