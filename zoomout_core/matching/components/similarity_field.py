# SPDX-License-Identifier: GPL-3.0-or-later
"""The motion of a body to its image as a field of similarities, which also moves everything around it.

At every vertex of the body, a similarity is fitted to its surroundings (Umeyama, Least-squares estimation of
transformation parameters between two point patterns, 1991). Blended, these move any point and bend long parts (Sumner,
Schmid and Pauly, Embedded deformation for shape manipulation, 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import Moments, products
from zoomout_core.spectral.eigenbasis import SpectralBasis

# Diffusion lengths over which neighbourhoods are pooled, at unit area; points farther from the body use longer ones.
POOLING_LENGTHS = (0.04, 0.1, 0.25)
# Nearest vertices of the body whose similarities are blended at a point.
BLENDED_NEIGHBOURS = 12
# Points that are moved at once, which bounds the memory.
AT_ONCE = 50_000
# Largest factor between a local scale and the body's median: maps shrink or stretch places by mistake.
MAX_SCALE_RATIO = 2.0


@dataclass(frozen=True, eq=False)
class SimilarityField:
    """The motion of a body to its image."""

    places: Floats  # (n, 3) vertices of the body's mesh, in a frame in which its area is one
    images: Floats  # (n, 3) their images
    confidence: Floats  # (n,) confidence in the images
    basis: SpectralBasis  # of the body's mesh

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.places)

    @cached_property
    def handedness(self) -> float:
        """-1 if the body maps to its mirror image, else 1."""
        return self._moments[0].handedness

    @cached_property
    def scale(self) -> float:
        """Median scale of narrow surroundings: wider ones of a body that bends seem to grow or shrink."""
        moments = self._moments[0]
        return float(np.median(moments.scale(self.handedness)))

    @cached_property
    def _moments(self) -> list[Moments]:
        """Those of the surroundings of each vertex, for each of the widths."""
        local = products(self.places, self.images)
        return [Moments.of_products(self.basis.smoothed(local, width**2)) for width in POOLING_LENGTHS]

    def rotations(self, points: Floats) -> Floats:
        """(q, 3, 3) rotations, mirrored if the body is, of the surroundings of points (q, 3)."""
        near = np.reshape(self._tree.query(points)[1], len(points))
        return self._moments[1].rotations(self.handedness)[near]

    def transform(self, points: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
        """Move points (q, 3) around the body, and turn directions (q, 3); returns both, and (q,) confidence."""
        count = min(BLENDED_NEIGHBOURS, len(self.places))
        distance, near = (np.reshape(part, (len(points), count)) for part in self._tree.query(points, count))
        weights = (1 - distance / (distance[:, -1:] * (1 + 1e-3) + 1e-300)) ** 2
        weights /= weights.sum(axis=1, keepdims=True)
        start = np.arange(0, near.size + 1, count)
        blend = csr_array((weights.ravel(), near.ravel(), start), shape=(len(points), len(self.places)))
        widths = np.log(POOLING_LENGTHS)
        level = np.interp(np.log(np.maximum(distance[:, 0], 1e-300)), widths, np.arange(len(widths)))
        affine = np.zeros((len(points), 12))
        for i, moments in enumerate(self._moments):
            share = np.maximum(1 - np.abs(level - i), 0)
            rows = np.flatnonzero(share)
            if len(rows):
                affine[rows] += share[rows, None] * (blend[rows] @ affine_maps(moments, self.handedness))
        return *transform_points(affine, points, normals), blend @ self.confidence


def transform_in_blocks(motion: SimilarityField, points: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
    """`SimilarityField.transform` for any number of points (n, 3), in blocks that bound the memory."""
    pieces = np.array_split(np.arange(len(points)), 1 + len(points) // AT_ONCE)
    places, turned, confidence = zip(*(motion.transform(points[some], normals[some]) for some in pieces), strict=True)
    return np.concatenate(places), np.concatenate(turned), np.concatenate(confidence)


def affine_maps(moments: Moments, handedness: float) -> Floats:
    """(m, 12) the similarities of patches, of scales near the typical one: linear part, row by row, and translation."""
    typical = np.median(moments.scale(handedness))
    scales = typical / MAX_SCALE_RATIO, typical * MAX_SCALE_RATIO
    found = moments.similarities(handedness, scales)
    return np.hstack([found.linear.reshape(-1, 9), found.translation])


def transform_points(affine: Floats, points: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Points (q, 3) and directions (q, 3), each moved by an affine map of its own (q, 12)."""
    linear = affine[:, :9].reshape(-1, 3, 3)
    turned = np.einsum("qij,qj->qi", linear, normals)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    unit = np.divide(turned, length, out=np.zeros_like(turned), where=length > 0)
    return np.einsum("qij,qj->qi", linear, points) + affine[:, 9:], unit
