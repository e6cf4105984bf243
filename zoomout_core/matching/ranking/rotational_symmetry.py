# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotational symmetries, such as the 23 rotations of a cube: the shape does not distinguish maps that differ by them.

The scores of such maps differ only by the discretisation, and the search does not find all of them. So the best map is
composed with all symmetries, and the resulting maps are equally likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.maps.upsample import nearest_samples
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import CERTAINTY
from zoomout_core.matching.ranking.rank import RANKING, with_others
from zoomout_core.matching.ranking.scores import EVIDENCE_WEIGHTS, Disagreement, total_score
from zoomout_core.runtime.once import once_per_argument

# Constants of the spiral of quaternions: the square root of 2, and the root of x^4 = x + 4 (Alexa, Super-Fibonacci
# spirals: fast, low-discrepancy sampling of SO(3), 2022).
SPIRAL = 2**0.5, 1.533751168755204288118041

# Evenly spread rotations from which the refinement starts, and an upper bound on the angle, in radians, between any
# rotation and the nearest of them.
START_ROTATIONS = 600
START_SPACING = 0.45
# Change of the second moments, relative to the largest of them, that is due to the discretisation.
MOMENT_TOLERANCE = 0.05
# Evenly spread sample points by which rotations are refined and compared, and iterations of the refinement.
REFINEMENT_POINTS = 100
REFINEMENT_ITERATIONS = 6
# Iterations after which starts are compared, as most of them have converged to the same few rotations by then, and the
# points that these iterations use.
STARTING_ITERATIONS = 2
STARTING_POINTS = 30
# Mean distance to the nearest vertices, at unit area, beyond which a start is then dropped.
MAX_START_DISTANCE = 0.05
# Weight of a squared distance along the surface against one across it.
SLIDING_WEIGHT = 0.02
# Refined rotations are examined further up to this mean distance, weighted in this way, at unit area.
MAX_MEAN_DISTANCE = 0.012
# A point is off the surface beyond this distance at unit area, or, on coarse meshes, beyond this fraction of the mean
# vertex spacing. At most this share of the area may be off, such as an edge that two meshes round differently. On 37
# remeshed solids, 97 % of the area was within 0.011 under every rotation of their groups, and none was missed. On 60
# people, animals and generated creatures, the best rotation reached 0.026.
OFF_SURFACE_DISTANCE = 0.015
OFF_SURFACE_SPACING = 0.5
MAX_OFF_SURFACE_SHARE = 0.03
# Rotations that are kept: an icosahedron has 59 besides the identity, a ball infinitely many.
MAX_ROTATIONS = 59


def with_turned(
    candidates: Sequence[Candidate], source: ShapeAnalysis, target: ShapeAnalysis, disagreement: Disagreement
) -> list[Candidate]:
    """Candidates with the best one composed with all rotational symmetries, the most likely first.

    Only evidence, such as landmarks, distinguishes the composed maps.
    """
    best, of_source, of_target = candidates[0], self_maps(source), self_maps(target)
    if not len(of_source) and not len(of_target):
        return list(candidates)
    k_target, k_source = best.functional_map.shape
    there, back = best.functional_map, best.reverse_functional_map
    if len(of_source) >= len(of_target):
        turns = of_source[:, :k_source, :k_source]
        maps, reverse_maps = there @ turns, np.swapaxes(turns, 1, 2) @ back
    else:
        turns = of_target[:, :k_target, :k_target]
        maps, reverse_maps = turns @ there, back @ np.swapaxes(turns, 1, 2)
    sample_maps = nearest_samples(source.search, target.search, maps)
    like_best = replace(
        best, origin=f"{best.origin}, turned", anchors=best.final_anchors, refined=None, distortion=None
    )
    turned = [
        replace(like_best, functional_map=functional_map, reverse_functional_map=reverse_map, sample_map=sample_map)
        for functional_map, reverse_map, sample_map in zip(maps, reverse_maps, sample_maps, strict=True)
    ]
    same = [replace(_with_evidence(one, best, disagreement), turns=1 + len(turned)) for one in (best, *turned)]
    return with_others(same, candidates, source, target)


def likely_turns(candidates: Sequence[Candidate], chosen: int) -> int:
    """Number of maps that differ from a candidate by a symmetry, itself included, with half its probability or more."""
    first = candidates[chosen]
    return 1 if first.turns == 1 else sum(one.turns > 1 and 2 * one.certainty >= first.certainty for one in candidates)


def _with_evidence(turned: Candidate, best: Candidate, disagreement: Disagreement) -> Candidate:
    """A composed map with the scores of the best one, except those of evidence.

    Anchors of a hypothesis, such as extremities, favour its own map, so all are scored without them.
    """
    scores = {name: score for name, score in best.scores.items() if name not in EVIDENCE_WEIGHTS}
    scores |= disagreement(turned.functional_map, turned.sample_map, None)
    penalty = best.scores["total"] - total_score(best.scores)
    return replace(turned, scores=scores | {"total": total_score(scores) + penalty})


@once_per_argument
def self_maps(shape: ShapeAnalysis) -> Floats:
    """(r, k, k) functional maps of a shape to itself, one for each rotational symmetry except the identity."""
    vertices, normals, moments = _in_principal_axes(shape)
    tree, points = cKDTree(vertices), vertices[shape.search.samples[:REFINEMENT_POINTS]]
    found: list[Floats] = []
    places = [points]
    for rotation in _fitting(_starts(moments), points, vertices, normals, tree):
        place = points @ rotation.T
        apart = min(np.linalg.norm(place - other, axis=1).mean() for other in places)
        if apart > CERTAINTY.another_map and len(found) < MAX_ROTATIONS:
            found.append(rotation)
            places.append(place)
    k = min(RANKING.size, shape.search.rows.shape[1])
    if not found:
        return np.zeros((0, k, k))
    turned = vertices[shape.search.samples] @ np.swapaxes(found, 1, 2)
    onto_itself = turned[_off(turned, vertices, shape) <= MAX_OFF_SURFACE_SHARE]
    image = tree.query(onto_itself)[1]
    return shape.search.fit(shape.basis.eigenvectors[image, :k], k)


def _in_principal_axes(shape: ShapeAnalysis) -> tuple[Floats, Floats, Floats]:
    """(n, 3) vertices and (n, 3) normals in the frame of the principal axes, and (3,) the second moments along these.

    The result does not depend on the orientation, and every rotational symmetry leaves the origin fixed.
    """
    areas = shape.basis.areas / shape.basis.areas.sum()
    vertices = shape.mesh.vertices - areas @ shape.mesh.vertices
    moments, axes = np.linalg.eigh((vertices * areas[:, None]).T @ vertices)
    axes[:, 0] *= np.linalg.det(axes)
    return vertices @ axes, shape.mesh.vertex_normals @ axes, moments


def _starts(moments: Floats) -> Floats:
    """(r, 3, 3) evenly spread rotations near which a rotation may preserve the second moments (3,)."""
    share = (np.arange(START_ROTATIONS) + 0.5) / START_ROTATIONS
    angles = 2 * np.pi * (np.arange(START_ROTATIONS) + 0.5)[:, None] / SPIRAL
    radii = np.sqrt(np.column_stack([share, 1 - share]))
    circles = radii[..., None] * np.stack([np.sin(angles), np.cos(angles)], axis=2)
    rotations = Rotation.from_quat(circles.reshape(-1, 4)).as_matrix()
    changed = np.linalg.norm(rotations * moments @ np.swapaxes(rotations, 1, 2) - np.diag(moments), axis=(1, 2))
    # A rotation by a small angle changes them by that angle times their difference, on both sides of the diagonal.
    most = 2**0.5 * START_SPACING * np.ptp(moments) + MOMENT_TOLERANCE * moments.max()
    return np.asarray(rotations[changed < most])


def _fitting(rotations: Floats, points: Floats, vertices: Floats, normals: Floats, tree: cKDTree) -> Floats:
    """(r, 3, 3) rotations that map points (p, 3) of a shape nearly onto it, the best first, refined from starts.

    Gauss-Newton steps reduce distances across the surface, and with a small weight those along it.
    """
    for number in range(REFINEMENT_ITERATIONS + 1):
        used = points[:STARTING_POINTS] if number < STARTING_ITERATIONS else points
        placed = used @ np.swapaxes(rotations, 1, 2)
        distance, near = map(np.asarray, tree.query(placed))
        if number == STARTING_ITERATIONS:
            chosen = _promising(rotations, distance.mean(axis=1), points)
            rotations, placed, near = rotations[chosen], placed[chosen], near[chosen]
        missed, normal = vertices[near] - placed, normals[near]
        across = np.einsum("rpx,rpx->rp", normal, missed)
        if number == REFINEMENT_ITERATIONS:
            break
        arms = np.cross(placed, normal)
        along = np.einsum("rpx,rpx->r", placed, placed)[:, None, None] * np.eye(3) - np.swapaxes(placed, 1, 2) @ placed
        slope = np.einsum("rpx,rp->rx", arms, across) + SLIDING_WEIGHT * np.cross(placed, missed).sum(axis=1)
        system = np.swapaxes(arms, 1, 2) @ arms + SLIDING_WEIGHT * along
        change = np.linalg.solve(system, slope[..., None])[..., 0]
        rotations = Rotation.from_rotvec(change).as_matrix() @ rotations
    error = np.sqrt(across**2 + SLIDING_WEIGHT * (missed**2).sum(axis=2)).mean(axis=1)
    order = np.argsort(error, kind="stable")
    return np.asarray(rotations[order[error[order] < MAX_MEAN_DISTANCE]])


def _promising(rotations: Floats, distance: Floats, points: Floats) -> Integers:
    """Numbers of the distinct rotations (r, 3, 3) that bring points (p, 3) close to a shape, the closest first.

    They are at a mean distance (r,) from the shape, and distinct if they move points to places that are apart by half
    of what makes maps different.
    """
    moments = points.T @ points / len(points)
    overlap = (rotations @ moments).reshape(-1, 9) @ rotations.reshape(-1, 9).T
    same = 2 * (np.trace(moments) - overlap) < (CERTAINTY.another_map / 2) ** 2  # the mean squared distance of places
    kept: list[int] = []
    for number in np.argsort(distance, kind="stable"):
        if distance[number] < MAX_START_DISTANCE and not same[number, kept].any():
            kept.append(int(number))
    return np.array(kept, dtype=np.int64)


def _off(turned: Floats, vertices: Floats, shape: ShapeAnalysis) -> Floats:
    """(r,) the part of a shape that is off its surface when its samples are at places (r, s, 3)."""
    triangles = shape.mesh.triangles
    triangle, barycentric = SurfaceSearch(vertices, triangles).closest(turned.reshape(-1, 3))
    nearest = np.einsum("qc,qcx->qx", barycentric, vertices[triangles[triangle]]).reshape(turned.shape)
    off = max(OFF_SURFACE_DISTANCE, OFF_SURFACE_SPACING / len(vertices) ** 0.5)
    return np.asarray((np.linalg.norm(nearest - turned, axis=2) > off) @ shape.weights)
