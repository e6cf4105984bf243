# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses from descriptors of both shapes: signatures, and pseudo-scalars, which distinguish left from right.

A functional map is fitted to the descriptors by least squares, with a penalty on entries off the diagonal (Ovsjanikov
et al. 2012): the resolvent mask of Ren et al. (2019). Each row of the map is a small linear system. With the opposite
sign of the pseudo-scalars, the same fit yields mirror images.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.maps.functional_map import resolvent_mask
from zoomout_core.maps.upsample import nearest_samples
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis, alike
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.scores import Disagreement, no_disagreement, scores_of, total_score
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class DescriptorTuning(Tuning, set_by="correspondence"):
    """Which fits are computed, and how many are refined.

    No choice of size and weights is right for all shapes; each is right for about half of nearly isometric ones.
    """

    sizes: tuple[int, ...] = tuned((8, 12, 16), "eigenfunctions", 2, 1000)  # of the functional maps
    pseudo_scalar_weights: tuple[float, ...] = tuned((0.3, 1.0, 3.0), "1", 0.001, 1000)  # against signatures
    # Weights of the resolvent mask, relative to the mean square of the descriptors' coefficients.
    mask_weights: tuple[float, ...] = tuned((0.02, 0.3), "1", 1e-6, 1000)
    same_fit: float = tuned(0.1, "1", 0, 1)  # fits are the same if images differ by less of their variance
    kept: int = tuned(5, "candidates", 1, 1000)  # fits to refine for each orientation


DESCRIPTORS = DescriptorTuning()


def descriptor_hypotheses(
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    disagreement: Disagreement = no_disagreement,  # with the known evidence
    sides: tuple[int, ...] = (1, -1),  # 1 for maps that keep the orientation, -1 for those that reverse it
) -> list[Hypothesis]:
    """The distinct fits of the best scores: some that keep the orientation, and as many that reverse it."""
    return [hypothesis for side in sides for hypothesis in _best_fits(source, target, side, disagreement)]


def _best_fits(source: ShapeAnalysis, target: ShapeAnalysis, sign: int, disagreement: Disagreement) -> list[Hypothesis]:
    available = min(len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    sizes = [size for size in DESCRIPTORS.sizes if size <= available]
    fits: list[Hypothesis] = []
    places: list[Floats] = []
    scores: list[float] = []
    for size, weight, mask_weight in product(sizes, DESCRIPTORS.pseudo_scalar_weights, DESCRIPTORS.mask_weights):
        functional_map = _fit(source, target, size, sign * weight, mask_weight)
        sample_map = nearest_samples(source.search, target.search, functional_map)
        evidence = disagreement(functional_map, sample_map, None)
        fits.append(Hypothesis(f"descriptors {size} {sign * weight:+g} {mask_weight:g}", functional_map))
        places.append(source.coordinates[sample_map])
        scores.append(total_score(scores_of(functional_map, sample_map, source, target, sign < 0) | evidence))
    same = alike(places, DESCRIPTORS.same_fit)
    kept: list[int] = []
    for i in np.argsort(scores, kind="stable"):
        if len(kept) < DESCRIPTORS.kept and not same[i, kept].any():
            kept.append(int(i))
    return [fits[i] for i in kept]


def _fit(source: ShapeAnalysis, target: ShapeAnalysis, size: int, weight: float, mask_weight: float) -> Floats:
    """(size, size) functional map; a negative weight changes the sign of the target's pseudo-scalars."""
    (bands_source, pairs_source), (bands_target, pairs_target) = source.descriptors, target.descriptors
    scale = abs(weight) * np.sqrt(bands_source.shape[1] / pairs_source.shape[1])
    F = np.hstack([bands_source[:size], scale * pairs_source[:size]])
    G = np.hstack([bands_target[:size], np.sign(weight) * scale * pairs_target[:size]])
    gram, mixed = F @ F.T, G @ F.T
    mask = resolvent_mask(source.basis.eigenvalues[:size], target.basis.eigenvalues[:size])
    mask *= mask_weight * np.trace(gram) / size
    # The constant function maps to itself, and no other function to it.
    C = np.zeros((size, size))
    C[0, 0] = 1
    systems = gram[1:, 1:] + mask[1:, 1:, None] * np.eye(size - 1)
    C[1:, 1:] = np.linalg.solve(systems, mixed[1:, 1:, None])[:, :, 0]
    return C
