# SPDX-License-Identifier: GPL-3.0-or-later
"""The surroundings of places on a body, by which a part such as a bust is compared with whole bodies of other units.

A part has another spectrum, area and other limbs than its whole, but the surroundings of a place remain the same up to
the nearest cut. They are described by four numbers for each geodesic radius, which depend on neither pose nor
rotation. Radii form a geometric series, so that another scale of the part is a shift of the series.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zoomout_core.arrays import Booleans, Floats, SingleFloats
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class SurroundingsTuning(Tuning, set_by="library"):
    """The radii of surroundings, and their comparison; lengths are those of a body at unit area."""

    smallest: float = tuned(0.03, "length", 1e-3, 1)  # first radius
    growth: float = tuned(1.3, "1", 1.01, 3)  # ratio of a radius to the one before, and of the scales of a part
    radii: int = tuned(16, "radii", 4, 100)  # number of radii; the last one is about the size of a body
    first: int = tuned(2, "radii", 0, 100)  # number of radii that are too small for the triangles of a body
    scales: int = tuned(6, "scales", 1, 100)  # number of scales of a part, from 1 downwards
    min_radii: int = tuned(3, "radii", 1, 100)  # places with fewer radii below their distance to a cut do not count
    largest: float = tuned(2.0, "1", 0, 100)  # a larger difference at a radius counts as this one


SURROUNDINGS = SurroundingsTuning()
# Number of measures of each ball, see `surroundings_of`.
FEATURES = 4


@dataclass(frozen=True, eq=False)
class PartDifference:
    """The difference of a part's surroundings from those of a whole."""

    mean: float  # mean difference over the places of the part, at its best scale
    scale: float  # that scale: the square root of the ratio of the areas of part and whole


def surroundings_of(shape: ShapeAnalysis) -> SingleFloats:
    """(d, r, 4) the balls of each radius around each distance sample: their form by four numbers.

    Half the logarithm of the area, relative to a disc; the length of the mean normal; the root of the mean squared
    distance from the centre; and twice the height of the centre above the place, along the mean normal. Both lengths
    are relative to the radius.
    """
    radii, count = _radii(), len(shape.distances)
    ring = (np.searchsorted(radii, shape.distances) + (len(radii) + 1) * np.arange(count)[:, None]).ravel()

    def integrate(values: Floats) -> Floats:
        """(d, r) the integrals of values (n,) over the balls."""
        rings = np.bincount(ring, np.tile(shape.basis.areas * values, count), count * (len(radii) + 1))
        return np.asarray(rings.reshape(count, -1)[:, :-1].cumsum(axis=1))

    points, normals = shape.mesh.vertices, shape.mesh.vertex_normals
    areas = np.maximum(integrate(np.ones(len(points))), 1e-9)

    def mean(vectors: Floats) -> Floats:
        """(d, r, 3) the means of vectors (n, 3) over the balls."""
        return np.stack([integrate(column) / areas for column in vectors.T], axis=-1)

    normal, centre = mean(normals), mean(points)
    squares = integrate(np.einsum("nx,nx->n", points, points)) / areas - np.einsum("drx,drx->dr", centre, centre)
    above = centre - points[shape.search.samples[:count], None]
    features = (
        np.log(areas / (np.pi * radii**2)) / 2,
        np.linalg.norm(normal, axis=-1),
        np.sqrt(np.maximum(squares, 0)) / radii,
        2 * np.einsum("drx,drx->dr", normal, above) / radii,
    )
    return np.stack(features, axis=-1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class PartSurroundings:
    """The surroundings of the places of a part that lacks a large piece."""

    features: SingleFloats  # (d, r, 4) see `surroundings_of`
    known: SingleFloats  # (d, r) 1 for radii below the distance to a cut, else 0
    areas: Floats  # (d,) the area of each place

    @classmethod
    def of(cls, shape: ShapeAnalysis) -> PartSurroundings:
        """Those of an analysed part."""
        part = IncompleteShape(shape)
        known = (_radii() < part.cut_distance[:, None]).astype(np.float32)
        return cls(surroundings_of(shape), known, part.areas)

    @classmethod
    def of_region(cls, shape: ShapeAnalysis, inside: Booleans) -> PartSurroundings:
        """Those of a region of an analysed shape: its vertices (n,) are known, and all others are cut off."""
        own = inside[shape.search.samples[: len(shape.distances)]]
        cut_distance = shape.distances[own][:, ~inside].min(axis=1, initial=np.inf)
        known = (_radii() < cut_distance[:, None]).astype(np.float32)
        return cls(surroundings_of(shape)[own], known, IncompleteShape(shape).areas[own])

    @cached_property
    def variation(self) -> float:
        """The mean difference of all places from their mean; 0 for a sphere, which fits any round place."""
        features, known = self.features[:, SURROUNDINGS.first :], self.known[:, SURROUNDINGS.first :]
        weights = self.areas[:, None] * known
        if not weights.any():
            return 0.0
        mean = np.einsum("dr,drf->rf", weights, features) / np.maximum(weights.sum(axis=0), 1e-9)[:, None]
        difference = np.minimum(np.abs(features - mean).sum(axis=-1), SURROUNDINGS.largest)
        return float(np.average(difference, weights=weights))

    def compare(self, whole: SingleFloats) -> PartDifference:
        """Compare them with those of a whole (e, r, 4): each place with the most similar one, at the best scale."""
        means = [self.difference(whole, step) for step in range(SURROUNDINGS.scales)]
        best = int(np.argmin(means))
        return PartDifference(means[best], SURROUNDINGS.growth**-best)

    def difference(self, whole: SingleFloats, step: int = 0) -> float:
        """The mean difference if the part is scaled down by a number of steps; infinite if too few radii are known."""
        used = slice(step + SURROUNDINGS.first, None)
        own, known = self.features[:, used], self.known[:, used]
        other = whole[:, SURROUNDINGS.first : SURROUNDINGS.first + own.shape[1]]
        total = np.zeros((len(own), len(other)), np.float32)
        for number in range(own.shape[1]):
            each = np.zeros_like(total)
            for feature in range(FEATURES):
                each += np.abs(own[:, number, None, feature] - other[:, number, feature])
            total += np.minimum(each, SURROUNDINGS.largest) * known[:, number, None]
        count = known.sum(axis=1)
        weights = self.areas * count * (count >= SURROUNDINGS.min_radii)
        if not weights.any():
            return np.inf
        return float(np.average(total.min(axis=1) / np.maximum(count, 1), weights=weights))


def _radii() -> Floats:
    return np.asarray(SURROUNDINGS.smallest * SURROUNDINGS.growth ** np.arange(SURROUNDINGS.radii))
