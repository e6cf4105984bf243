"""The target laid over the source in space, so that no limb is reflected and nothing folds without need.

The Laplacian cannot tell an arm from the same arm mirrored along its own axis, and ZoomOut settles for either by
chance: distances stay small, but the arm's inside lands outside. Space can tell. A limb that is carried over
turned, not mirrored, onto the smoothed place that its map gives it keeps its sense; the closest points of the
source to it, with normals that agree, start the next round. In the spirit of Smooth Shells (Eisenberger, Laehner
and Cremers 2020), which aligns smoothed shapes and spectra in turns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.zoomout import SampledBasis
from zoomout_core.matching.analysis import ShapeAnalysis

# Eigenfunctions that images are smoothed by.
IMAGE_FUNCTIONS = 100
# What a sample's surroundings say of its turn, against what its neighbours' turns say: limbs say nothing of the
# turn about their own axis, and take it from the body.
COHERENCE = 0.3
# Blended so many times, matrices have only the length of rotations; then they are made rotations, and so forth.
BLENDINGS, RELAXATIONS = 3, 3
# Diffusion length, at unit area, that makes one field of the samples' turns.
BLEND = 0.05
# A blend whose determinant is a larger part of its cubed norm becomes a rotation in so many steps, to single precision.
CLEAR_BLEND, NEWTON_STEPS = 0.05, 5
# A normal that is off by a right angle weighs as much as a place that is off by this, at unit area.
NORMAL_WEIGHT = 0.1


@dataclass(frozen=True, eq=False)
class Alignment:
    """A target laid over its source, in the source's frame, at unit area.

    Attributes:
        positions: (n_t, 3) of the target's vertices.
        normals: (n_t, 3) their outward normals, turned along.
    """

    positions: Floats
    normals: Floats

    def facing(self, normals: Floats, source: ShapeAnalysis, target: ShapeAnalysis) -> Alignment:
        """The same with its normals turned to the side of those at the images (n, 3), where sides are not known."""
        if sides_are_known(source, target) or np.einsum("nx,nx->", self.normals, normals) >= 0:
            return self
        return Alignment(self.positions, -self.normals)


def sides_are_known(source: ShapeAnalysis, target: ShapeAnalysis) -> bool:
    """Whether outside and inside can be told on both shapes; a cloth may bend either way."""
    return source.mesh.sides_are_known and target.mesh.sides_are_known


def align(images: Floats, target: ShapeAnalysis, width: float, mirrored: bool, at: Integers | None = None) -> Alignment:
    """Carry the target over to smoothed images, each of its places turned rigidly.

    Args:
        images: (k, 3) coefficients, in the target's basis, of the images of its vertices.
        target: the shape that the map starts from.
        width: diffusion length, at unit area, over which images are smoothed; what is thinner than it takes its
            position across from the target itself.
        mirrored: lay the target's mirror image, for maps that reverse the orientation.
        at: (n,) lay these vertices only.
    """
    rows: Integers | slice = slice(None) if at is None else at
    eigenvectors, eigenvalues, k = target.basis.eigenvectors, target.basis.eigenvalues, len(images)
    sense = np.array([-1.0, 1, 1]) if mirrored else np.ones(3)
    damping = np.exp(-(width**2) * eigenvalues[:k, None])
    both = damping * np.hstack([target.position_coefficients[:k] * sense, images])
    samples = target.search.samples[: len(target.distances)]
    here, there = np.hsplit(eigenvectors[samples, :k] @ both, 2)
    turns = _turns(here, there, target)
    centres, image_centres = np.hsplit(eigenvectors[rows, :k] @ both, 2)
    blending = np.exp(-(BLEND**2) * eigenvalues[:, None])
    field = eigenvectors[rows] @ (blending * (target.cell_coefficients @ turns.reshape(-1, 9)))
    rotations = _rotations_of_blends(field.reshape(-1, 3, 3))
    vertices, normals = target.mesh.vertices[rows] * sense, target.mesh.vertex_normals[rows] * sense
    offsets, normals = np.einsum("nij,cnj->cni", rotations, np.stack([vertices - centres, normals]))
    return Alignment(image_centres + offsets, normals)


def align_and_match(
    vertex: Integers,
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    sampled: SampledBasis,
    anchors: Anchors | None,
    k: int,
    width: float,
    mirrored: bool,
    among: Integers | slice = slice(None),
    weight: float = 1.0,
) -> tuple[Integers, Alignment]:
    """One round on samples: lay the target by a map, and find the nearest vertices in spectrum and space.

    Args:
        vertex: (s,) the source vertex of each of the target's samples.
        source: the shape that the map lands on.
        target: the shape that the map starts from.
        sampled: the target's basis at the samples.
        anchors: at the source's vertices and the target's samples.
        k: size of the functional map.
        width: see `lay`.
        mirrored: see `lay`.
        among: the source vertices to choose from.
        weight: of places in space, beside eigenfunctions.

    Returns:
        (s,) the next source vertices, and the laid samples.
    """
    count = min(IMAGE_FUNCTIONS, sampled.rows.shape[1])
    laid = align(sampled.fit(source.mesh.vertices[vertex], count), target, width, mirrored, sampled.samples)
    laid = laid.facing(source.mesh.vertex_normals[vertex], source, target)
    functional_map = sampled.fit(source.basis.eigenvectors[vertex, :k], k)
    anchors = None if anchors is None else Anchors(anchors.source[among], anchors.target)
    pair = coordinates(sampled.rows, source.basis.eigenvectors[among], functional_map, anchors)
    found = nearest(*beside_places(*pair, laid, source, k, weight, among))
    return np.arange(len(source.mesh.vertices))[among][found], laid


def beside_places(
    queries: Floats,
    embedded: Floats,
    laid: Alignment,
    source: ShapeAnalysis,
    k: int,
    weight: float,
    at: Integers | slice = slice(None),
) -> tuple[Floats, Floats]:
    """Spectral coordinates (n_t, d) and (n_s, d) with the places and normals in space appended, in their scale.

    Those of the source are of its vertices `at`.

    An error in place changes the first k eigenfunctions, at unit area, by their eigenvalues' sum / 2 times its
    square: that makes the two comparable.
    """
    scale = np.sqrt(weight * source.basis.eigenvalues[:k].sum() / 2)
    normal_scale = scale * NORMAL_WEIGHT
    return (
        np.hstack([queries, scale * laid.positions, normal_scale * laid.normals]),
        np.hstack([embedded, scale * source.mesh.vertices[at], normal_scale * source.mesh.vertex_normals[at]]),
    )


def _turns(here: Floats, there: Floats, target: ShapeAnalysis) -> Floats:
    """(d, 3, 3) rotations of the surroundings of the target's distance samples, from smoothed places to images.

    The surroundings' best rotation onto their images (Kabsch) where these have extent in all directions; along
    limbs, which have extent along their axis only, that and the turn of the neighbours nearer to the body.
    """
    weights, near = target.surroundings
    moments: Floats = (weights @ _products(there, here)).reshape(-1, 3, 3)
    moments -= _products(weights @ there, weights @ here).reshape(-1, 3, 3)
    extent = np.linalg.svd(moments, compute_uv=False)
    moments /= np.maximum(extent[:, 0], 1e-300)[:, None, None]
    turns = _spread_from_body(moments, extent[:, 1] / np.maximum(extent[:, 0], 1e-300), near)
    mean = near / near.sum(axis=1, keepdims=True)
    for _ in range(RELAXATIONS):
        blended = turns.reshape(-1, 9)
        for _ in range(BLENDINGS):
            blended = moments.reshape(-1, 9) + COHERENCE * mean @ blended
            blended *= np.sqrt(3) / np.maximum(np.linalg.norm(blended, axis=1, keepdims=True), 1e-300)
        turns = nearest_rotations(blended.reshape(-1, 3, 3))
    return turns


def _products(a: Floats, b: Floats) -> Floats:
    """(n, 9) the outer products of the rows of two arrays (n, 3)."""
    return np.asarray((a[:, :, None] * b[:, None]).reshape(-1, 9))


def _spread_from_body(moments: Floats, reliable: Floats, near: Booleans) -> Floats:
    """(d, 3, 3) first rotations, from the most reliable one outwards, each continuing a neighbour's."""
    root = int(np.argmax(np.where(np.linalg.det(moments) > 0, reliable, 0)))
    turns = nearest_rotations(moments)
    done = np.zeros(len(moments), dtype=bool)
    done[root] = True
    while True:
        reached = np.flatnonzero(near[:, done].any(axis=1) & ~done)
        if not len(reached):
            return turns
        parent = np.argmax(np.where(near[reached] & done, reliable, -1), axis=1)
        turns[reached] = nearest_rotations(moments[reached] + COHERENCE * turns[parent])
        done[reached] = True


def _rotations_of_blends(matrices: Floats) -> Floats:
    """(n, 3, 3) the same for many blends of rotations: polar factors by Newton's method (Higham 1986).

    What no rotation prevails in is left to the singular value decomposition, which takes several times as long.
    """
    size = np.linalg.norm(matrices, axis=(1, 2))
    clear = np.linalg.det(matrices) > CLEAR_BLEND * size**3
    rotations = np.empty_like(matrices)
    rotations[~clear] = nearest_rotations(matrices[~clear])
    rows = np.ascontiguousarray(np.moveaxis(matrices[clear] * np.sqrt(3) / size[clear, None, None], 0, -1))
    for _ in range(NEWTON_STEPS):
        a, b, c = rows
        cofactors = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)])
        rows = (rows + cofactors / (a * cofactors[0]).sum(axis=0)) / 2
    rotations[clear] = np.moveaxis(rows, -1, 0)
    return rotations


def _cross(x: Floats, y: Floats) -> Floats:
    """(3, n) cross products of vectors given by their coordinates (3, n)."""
    return np.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])
