# SPDX-License-Identifier: GPL-3.0-or-later
"""The criteria that rank maps: invariants of isometries, the orientation, the fit in space, and evidence.

Every isometry preserves Laplacian commutativity, geodesic distances and mean curvature; pseudo-scalars and mapped
normals change their sign if a map reverses the orientation. No criterion suffices alone: commutativity does not
distinguish a human from one turned front to back, and pseudo-scalars are noise on shapes far from isometric.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.anchors import Anchors
from zoomout_core.maps.functional_map import commutativity_error, frequency_error
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.refinement.local_rigid_alignment import Alignment, SampledPair, align_and_match
from zoomout_core.tuning import Tuning, tuned

# Name of the disagreement with positions in space, for surfaces that overlap.
IN_SPACE = "place in space"
# Name of the disagreement with shapes that stand upright in their files.
UPRIGHT = "upright"
# Axes of a file along which a shape may stand: y in formats for games, z in those for modelling and printing.
UP_AXES = [1, 2]
# Name of the energy of a finished map, which only the most likely candidates have (see `finished_maps.py`).
ENERGY = "energy"
# Name of the number of triangles that a finished map tears.
TORN = "torn"
# Weights of the disagreements in the total score, by which a map and its mirror image differ by two to four.
EVIDENCE_WEIGHTS = {
    # The sum of the landmarks' errors, and the mean distance to the images by an earlier map, at unit area.
    "landmarks": 20.0,
    "earlier map": 10.0,
    # The mean distance between samples and their images where the surfaces overlap, at unit area. Such places are
    # likely to correspond, unless a person has turned around and left each hand where the other one was.
    IN_SPACE: 3.0,
    # One minus the correlation of heights.
    "axes": 2.0,
    # One minus the agreement of heights, between 0 and 1. Files may be turned, and people lie down, so that alone it
    # makes no map 90 % certain.
    UPRIGHT: 0.5,
    # One minus the mean overlap. Regions also constrain every map, which suffices to correct flips; with a larger
    # weight, regions whose names are swapped by mistake would flip clear maps.
    "regions": 2.0,
}


# Largest contribution of the place in space to the total. It proves nothing, because a ball may have been rotated, so
# alone it must not make a map 90 % certain.
MAX_IN_SPACE = 0.5


@dataclass(frozen=True)
class ScoreTuning(Tuning, set_by="correspondence"):
    """How the criteria are computed, and their weights in the total score (see `total_score`)."""

    smooth_size: int = tuned(30, "eigenfunctions", 4, 1000)  # of maps for orientation and fit in space
    alignment_width: float = tuned(0.08, "at unit area", 0, 1)  # smooths images for the alignment
    orientation_triangles: int = tuned(2000, "triangles", 1, 10**9)  # that decide about the orientation
    place: float = tuned(2.0, "1", 0, 100)  # weight of the logarithm of the mean distance from the source
    facing: float = tuned(1.0, "1", 0, 100)  # weight of the logarithm of the mean deviation of normals
    commutativity: float = tuned(1.0, "1", 0, 100)  # weight of the logarithm of the error
    frequency: float = tuned(1.0, "1", 0, 100)  # weight of the logarithm of the error
    distance: float = tuned(0.75, "1", 0, 100)  # weight of the logarithm of the mean change of geodesic distances
    curvature: float = tuned(0.7, "1", 0, 100)  # weight of the logarithm of one minus the correlation
    # Weight of the logarithm of the energy of finished maps. On pairs left out, 84 to 89 % of the right maps are above
    # 90 % certainty with weights of 4 to 8.
    energy: float = tuned(6.0, "1", 0, 100)
    handedness: float = tuned(1.2, "1", 0, 100)  # of the correlation; from 2 on, self-symmetries of TOSCA are wrong


SCORES = ScoreTuning()


# Computes how far a map disagrees with each kind of evidence. Takes its functional map, the source sample of each
# search sample of the target, and its anchors at all vertices.
Disagreement: TypeAlias = Callable[[Floats, Integers, Anchors | None], dict[str, float]]


def no_disagreement(_map: Floats, _samples: Integers, _anchors: Anchors | None) -> dict[str, float]:
    """The disagreement of a map with no evidence."""
    return {}


def scores_of(
    functional_map: Floats,
    sample_map: Integers,
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    reverses_orientation: bool,
) -> dict[str, float]:
    """The criteria for one direction of a map: C (k_target, k_source), and the source sample (s_t,) of each target one.

    Returns:
        commutativity: of C with the Laplacians (0 for an isometry);
        frequency: mean difference of the frequencies that C couples (0);
        distance: mean change of geodesic distance between samples (0);
        curvature: mean correlation of mean curvature over several scales (1);
        handedness: mean correlation of pseudo-scalars, with their sign changed if the map reverses orientation (1).
    """
    values = source.basis.eigenvalues, target.basis.eigenvalues
    image = sample_map[: len(target.distances_between)]
    between_target = target.distances_between[:, : len(image)]
    # In two steps, rows first, this takes a fifth of the time that it takes in one.
    between_source = source.distances_between[source.nearest_distance_sample[image]].take(image, axis=1)
    sign = -1 if reverses_orientation else 1
    return {
        "commutativity": commutativity_error(functional_map, *values),
        "frequency": frequency_error(functional_map, *values),
        "distance": float(np.abs(between_target - between_source).mean()),
        "curvature": correlation(target.curvature, source.curvature[sample_map], target.weights),
        "handedness": sign * correlation(target.pseudo_scalars, source.pseudo_scalars[sample_map], target.weights),
    }


def orientation_agreement(sample_map: Integers, source: ShapeAnalysis, target: ShapeAnalysis) -> float:
    """How well a map (s_t,) of search samples keeps the outward orientation: 1 everywhere, -1 if everywhere reversed.

    Normals of the target's triangles at their images, from low-passed positions, are compared with the source's.
    """
    k = min(SCORES.smooth_size, len(target.basis.eigenvalues))
    images = source.search.samples[sample_map]
    at_samples = np.column_stack([source.mesh.vertices[images], source.mesh.vertex_normals[images]])
    smooth = target.basis.eigenvectors[:, :k] @ target.search.fit(at_samples, k)
    moved, normal = smooth[:, :3], smooth[:, 3:]
    triangles = target.mesh.oriented_triangles
    a, b, c = triangles[:: max(1, len(triangles) // SCORES.orientation_triangles)].T
    face_normal = np.cross(moved[b] - moved[a], moved[c] - moved[a])
    agreement = np.einsum("ij,ij->i", face_normal, normal[a] + normal[b] + normal[c])
    return float(agreement.sum() / max(np.abs(agreement).sum(), 1e-300))


def fit_in_space(
    sample_map: Integers, anchors: Anchors | None, mirrored: bool, source: ShapeAnalysis, target: ShapeAnalysis
) -> dict[str, float]:
    """How well the target, aligned with the source by a map (s_t,) of search samples, fits it.

    Anchors keep the map in place, at all vertices. A `mirrored` map aligns the target's mirror image.

    Returns:
        place: mean distance from the source (0 for a perfect fit);
        facing: mean of one minus the cosine between normals (0).
    """
    vertex, aligned = map_after_alignment(sample_map, anchors, mirrored, source, target)
    off = np.linalg.norm(aligned.positions - source.mesh.vertices[vertex], axis=1)
    facing = np.einsum("ij,ij->i", aligned.normals, source.mesh.vertex_normals[vertex])
    return {"place": float(target.weights @ off), "facing": float(target.weights @ (1 - facing))}


def map_after_alignment(
    sample_map: Integers, anchors: Anchors | None, mirrored: bool, source: ShapeAnalysis, target: ShapeAnalysis
) -> tuple[Integers, Alignment]:
    """A map after aligning the target with the source by it, which corrects limbs that are mirrored individually.

    Returns (s_t,) the source vertex of each search sample of the target, and these samples, aligned.
    """
    pair = SampledPair.of(source, target, target.search, anchors, mirrored)
    vertex = source.search.samples[sample_map]
    k = min(SCORES.smooth_size, len(target.basis.eigenvalues), len(source.basis.eigenvalues))
    for among in (source.sampled.samples, slice(None)):
        vertex, aligned = align_and_match(vertex, pair, k, SCORES.alignment_width, among)
    return vertex, aligned


def total_score(scores: dict[str, float]) -> float:
    """The weighted sum of the criteria and of disagreements with evidence; the lowest is the most likely map.

    The weights are those of `SCORES` and `EVIDENCE_WEIGHTS`. Errors enter by their logarithms: their size depends on
    the similarity of the shapes, but the errors of a pair's right map are smaller than those of wrong ones by a factor.

    - Commutativity and frequency: the best single criteria. They do not detect a human turned front to back.
    - Distance and curvature complement them with smaller weights: geodesic distances are independent of the basis, and
      mean curvature distinguishes front from back; its error is one minus the correlation.
    - Handedness: the correlation itself, not its logarithm, so that noise about zero, such as on shapes far from
      isometric, has little effect. A weight of 1.6 would correct two self-symmetries of humans that are turned front to
      back, but reduces the margin of right maps of pairs from 0.14 standard deviations to 0.03.
    - Place and facing: the fit in space has the largest weights, because it rejects maps that are nearly isometric by
      chance: legs mapped to arms sometimes commute with the Laplacian better than the right map does, but never fit the
      source after alignment. On generated characters this removed the flips that had a high certainty.
    - Disagreements enter linearly. Those with landmarks and with an earlier map, which the user gave, outweigh all
      criteria. Those with axes, regions and the position in space decide if the criteria leave a flip in doubt.

    The weights of the invariants need not be precise: conditional logit fits of three to nine criteria were right on 97
    to 100 % of the held-out set. Unknown criteria (place and facing before the alignment, missing evidence) are 0.
    """
    return float(
        SCORES.place * np.log(max(scores.get("place", 1), 1e-9))
        + SCORES.facing * np.log(max(scores.get("facing", 1), 1e-9))
        + SCORES.commutativity * np.log(max(scores["commutativity"], 1e-9))
        + SCORES.frequency * np.log(max(scores["frequency"], 1e-9))
        + SCORES.distance * np.log(max(scores["distance"], 1e-9))
        + SCORES.curvature * np.log(max(1 - scores["curvature"], 1e-9))
        - SCORES.handedness * scores["handedness"]
        + sum(evidence_score(name, scores.get(name, 0.0)) for name in EVIDENCE_WEIGHTS)
    )


def evidence_score(name: str, disagreement: float) -> float:
    """The contribution of a disagreement with one kind of evidence to the total score."""
    score = EVIDENCE_WEIGHTS[name] * disagreement
    return min(score, MAX_IN_SPACE) if name == IN_SPACE else score


def correlation(x: Floats, y: Floats, weights: Floats) -> float:
    """Mean over the columns of the correlation of two sets of functions (s, d), with weights (s,) that sum to one.

    The correlation of a function that is constant up to rounding is 0.
    """
    covariance: Floats = weights @ (x * y) - (weights @ x) * (weights @ y)
    variances: Floats = np.ones_like(covariance)
    for values in (x, y):
        square = weights @ values**2
        variances *= np.maximum(square - (weights @ values) ** 2, 1e-9 * square)
    return float(np.mean(covariance / np.sqrt(np.maximum(variances, 1e-300))))
