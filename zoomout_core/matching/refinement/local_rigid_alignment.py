# SPDX-License-Identifier: GPL-3.0-or-later
"""Align the target with the source in space by local rotations, so that no limb is reflected.

The Laplacian does not distinguish an arm from its mirror image along its axis, and ZoomOut converges to either of them.
Distances stay small, but the inner side of the arm is mapped to the outer one. Positions in space resolve this: a limb
moved to the smoothed images of its map by rotations, without reflection, keeps its orientation. The closest points of
the source with compatible normals start the next round. This follows Smooth Shells (Eisenberger, Laehner and Cremers
2020), which alternates between aligning smoothed shapes and spectra.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import Moments, nearest_rotations, products
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.affine_maps import mirror_factors
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class RigidAlignmentTuning(Tuning, set_by="correspondence"):
    """How rotations are fitted, and the weights of positions in space."""

    image_functions: int = tuned(100, "eigenfunctions", 4, 1000)  # eigenfunctions for smoothing images
    # Weight of the neighbours' rotations relative to a sample's own. A limb does not determine the rotation about its
    # own axis, and takes it from the body.
    coherence: float = tuned(0.3, "1", 0, 10)
    averagings: int = tuned(3, "rounds", 0, 100)  # of a sample with its neighbours, as matrices
    relaxations: int = tuned(3, "rounds", 0, 100)  # number of rounds of this
    blend_width: float = tuned(0.05, "at unit area", 0, 1)  # diffusion length that blends samples' rotations
    normal_weight: float = tuned(0.1, "at unit area", 0, 1)  # distance that equals a unit difference of normals


RIGID_ALIGNMENT = RigidAlignmentTuning()


@dataclass(frozen=True, eq=False)
class Alignment:
    """A target aligned with its source, in the source's frame, at unit area."""

    positions: Floats  # (n_t, 3) of the target's vertices
    normals: Floats  # (n_t, 3) their outward normals, rotated with them

    def facing(self, normals: Floats, source: ShapeAnalysis, target: ShapeAnalysis) -> Alignment:
        """The same alignment, with normals flipped to agree with those at the images (n, 3) if sides are not known."""
        if sides_are_known(source, target) or np.einsum("nx,nx->", self.normals, normals) >= 0:
            return self
        return Alignment(self.positions, -self.normals)


def sides_are_known(source: ShapeAnalysis, target: ShapeAnalysis) -> bool:
    """Whether the outer side of both shapes is known. That of a cloth is not, because it may bend either way."""
    return source.mesh.sides_are_known and target.mesh.sides_are_known


def align(images: Floats, target: ShapeAnalysis, width: float, mirrored: bool, at: Integers | None = None) -> Alignment:
    """Move the target to smoothed images, the surroundings of each vertex by a rotation.

    Images are given by their coefficients (k, 3) in the target's basis. They are smoothed over the diffusion length
    `width`, at unit area, so that thinner parts keep the target's own cross-section. `mirrored` aligns the target's
    mirror image, and `at` (n,) are the only vertices to align.
    """
    rows: Integers | slice = slice(None) if at is None else at
    eigenvectors, eigenvalues, k = target.basis.eigenvectors, target.basis.eigenvalues, len(images)
    sense = mirror_factors(mirrored)
    damping = np.exp(-(width**2) * eigenvalues[:k, None])
    both = damping * np.hstack([target.position_coefficients[:k] * sense, images])
    samples = target.search.samples[: len(target.distances)]
    here, there = np.hsplit(eigenvectors[samples, :k] @ both, 2)
    turns = _turns(here, there, target)
    centres, image_centres = np.hsplit(eigenvectors[rows, :k] @ both, 2)
    blending = np.exp(-(RIGID_ALIGNMENT.blend_width**2) * eigenvalues[:, None])
    field = eigenvectors[rows] @ (blending * (target.cell_coefficients @ turns.reshape(-1, 9)))
    rotations = nearest_rotations(field.reshape(-1, 3, 3))
    vertices, normals = target.mesh.vertices[rows] * sense, target.mesh.vertex_normals[rows] * sense
    offsets, normals = np.einsum("nij,cnj->cni", rotations, np.stack([vertices - centres, normals]))
    return Alignment(image_centres + offsets, normals)


@dataclass(frozen=True, eq=False)
class SampledPair:
    """A pair of shapes whose maps are refined at samples of the target."""

    source: ShapeAnalysis
    target: ShapeAnalysis
    sampled: SampledBasis  # the target's basis at the samples
    anchors: Anchors | None  # at the source's vertices and the target's samples
    mirrored: bool  # the maps are of the target's mirror image

    @classmethod
    def of(
        cls,
        source: ShapeAnalysis,
        target: ShapeAnalysis,
        sampled: SampledBasis,
        anchors: Anchors | None,  # at all vertices
        mirrored: bool,
    ) -> SampledPair:
        at_samples = None if anchors is None else Anchors(anchors.source, anchors.target[sampled.samples])
        return cls(source, target, sampled, at_samples, mirrored)


def align_and_match(
    vertex: Integers, pair: SampledPair, k: int, width: float, among: Integers | slice = slice(None), weight: float = 1
) -> tuple[Integers, Alignment]:
    """One round on samples: align the target by a map, and find nearest vertices in spectral and spatial coordinates.

    Args:
        vertex: (s,) the source vertex of each of the target's samples.
        pair: the shapes.
        k: size of the functional map.
        width: see `align`.
        among: the source vertices to choose from.
        weight: weight of positions in space, beside eigenfunctions.

    Returns:
        (s,) the next source vertices, and the aligned samples.
    """
    source, target, sampled = pair.source, pair.target, pair.sampled
    count = min(RIGID_ALIGNMENT.image_functions, sampled.rows.shape[1])
    aligned = align(sampled.fit(source.mesh.vertices[vertex], count), target, width, pair.mirrored, sampled.samples)
    aligned = aligned.facing(source.mesh.vertex_normals[vertex], source, target)
    functional_map = sampled.fit(source.basis.eigenvectors[vertex, :k], k)
    anchors = None if pair.anchors is None else Anchors(pair.anchors.source[among], pair.anchors.target)
    coordinates_of_both = coordinates(sampled.rows, source.basis.eigenvectors[among], functional_map, anchors)
    found = nearest(*beside_places(*coordinates_of_both, aligned, source, k, weight, among))
    return np.arange(len(source.mesh.vertices))[among][found], aligned


def beside_places(
    queries: Floats,
    embedded: Floats,
    aligned: Alignment,
    source: ShapeAnalysis,
    k: int,
    weight: float,
    at: Integers | slice = slice(None),
) -> tuple[Floats, Floats]:
    """Append scaled positions and normals to spectral coordinates (n_t, d), and (n_s, d) of the source's vertices `at`.

    At unit area, an error of position changes the first k eigenfunctions by its square times half the sum of their
    eigenvalues. This defines the common scale.
    """
    scale = np.sqrt(weight * source.basis.eigenvalues[:k].sum() / 2)
    normal_scale = scale * RIGID_ALIGNMENT.normal_weight
    return (
        np.hstack([queries, scale * aligned.positions, normal_scale * aligned.normals]),
        np.hstack([embedded, scale * source.mesh.vertices[at], normal_scale * source.mesh.vertex_normals[at]]),
    )


def _turns(here: Floats, there: Floats, target: ShapeAnalysis) -> Floats:
    """(d, 3, 3) rotations of the surroundings of the target's distance samples, from smoothed positions to images.

    This is the best rotation of the surroundings onto their images (Kabsch) if these extend in all directions. Limbs
    extend only along their axis, so they also use the rotation of the neighbours nearer to the body.
    """
    weights, near = target.surroundings
    moments = Moments.of_products(weights @ products(here, there)).cross
    extent = np.linalg.svd(moments, compute_uv=False)
    moments /= np.maximum(extent[:, 0], 1e-300)[:, None, None]
    turns = _spread_from_body(moments, extent[:, 1] / np.maximum(extent[:, 0], 1e-300), near)
    mean = near / near.sum(axis=1, keepdims=True)
    for _ in range(RIGID_ALIGNMENT.relaxations):
        blended = turns.reshape(-1, 9)
        for _ in range(RIGID_ALIGNMENT.averagings):
            blended = moments.reshape(-1, 9) + RIGID_ALIGNMENT.coherence * mean @ blended
            blended *= np.sqrt(3) / np.maximum(np.linalg.norm(blended, axis=1, keepdims=True), 1e-300)
        turns = nearest_rotations(blended.reshape(-1, 3, 3))
    return turns


def _spread_from_body(moments: Floats, reliable: Floats, near: Booleans) -> Floats:
    """(d, 3, 3) initial rotations, propagated from the most reliable one to neighbours."""
    root = int(np.argmax(np.where(np.linalg.det(moments) > 0, reliable, 0)))
    turns = np.empty_like(moments)
    turns[root] = nearest_rotations(moments[root])
    done = np.zeros(len(moments), dtype=bool)
    done[root] = True
    reached = np.array([root])
    while True:
        # The relation is symmetric, and neighbours of earlier ones are done.
        reached = np.flatnonzero(near[reached].any(axis=0) & ~done)
        if not len(reached):
            turns[~done] = nearest_rotations(moments[~done])
            return turns
        parent = np.argmax(np.where(near[reached] & done, reliable, -1), axis=1)
        turns[reached] = nearest_rotations(moments[reached] + RIGID_ALIGNMENT.coherence * turns[parent])
        done[reached] = True
