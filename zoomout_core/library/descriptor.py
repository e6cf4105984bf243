# SPDX-License-Identifier: GPL-3.0-or-later
"""Descriptors of bodies that hardly depend on pose, mesh and unit. Thousands are compared within a second.

They consist of the spectrum of the Laplacian (Shape-DNA; Reuter, Wolter and Peinecke 2006), the geodesic distances
between the tips of limbs, the volume, and the distribution of mean curvature.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.matching.hypotheses.extremities import cheapest_pairings, extremities
from zoomout_core.matching.preparation.analysis import ANALYSIS, ShapeAnalysis
from zoomout_core.tuning import Tuning, tuned

# Number of quantiles of a distribution.
QUANTILES = 33
# Volumes and eigenvalues are clamped to this minimum, at unit area, before their logarithm is computed.
SMALLEST = 1e-12


@dataclass(frozen=True)
class DescriptorTuning(Tuning, set_by="library"):
    """The features of a descriptor, and the differences that equal one unit."""

    eigenvalues: int = tuned(39, "eigenvalues", 1, 1000)  # after the first, which is zero
    tips: int = tuned(7, "tips", 3, 12)  # maximum number of limbs compared, the most persistent first
    unpaired: float = tuned(0.5, "1", 0, 10)  # cost of the persistence of a tip without a partner
    # Differences that equal one unit: the medians over all pairs of a query and an asset.
    spectrum: float = tuned(0.17, "logarithm", 1e-3, 10)  # mean difference of logarithms of eigenvalues
    limbs: float = tuned(0.54, "at unit area", 1e-3, 10)  # cost of the best pairing of tips
    volume: float = tuned(0.24, "logarithm", 1e-3, 10)  # difference of logarithms of volumes
    curvature: float = tuned(0.044, "1", 1e-3, 10)  # mean difference of quantiles of mean curvature


DESCRIPTOR = DescriptorTuning()


class Difference(NamedTuple):
    """The differences of two descriptors, each in units of `DescriptorTuning`."""

    spectrum: float
    limbs: float
    volume: float
    curvature: float

    @property
    def total(self) -> float:
        """The sum; about 1 for a body in another pose, and 4 for two bodies of a mixed library."""
        return float(sum(self))


@dataclass(frozen=True, eq=False)
class Descriptor:
    """Invariants by which bodies are compared, at unit area."""

    spectrum: Floats  # (k,) logarithms of the eigenvalues after the first
    between: Floats  # (m, m) geodesic distances between tips, the most persistent first
    average: Floats  # (m,) average geodesic distance of each tip to the surface
    persistence: Floats  # (m,) persistence of each tip
    volume: Floats  # () logarithm of the enclosed volume
    curvature: Floats  # (q, t) quantiles of mean curvature on several scales

    def as_arrays(self) -> dict[str, Any]:
        """Arrays that `from_arrays` reads."""
        return dict(vars(self))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> Descriptor:
        """A descriptor of arrays; raises KeyError if one is missing, and ValueError if their sizes contradict."""
        made = cls(**{name: np.asarray(arrays[name], np.float64) for name in cls.__dataclass_fields__})
        m, scales = made.persistence.size, len(ANALYSIS.curvature_times)
        shapes = (
            made.spectrum.shape[1:],
            made.between.shape,
            made.average.shape,
            made.volume.shape,
            made.curvature.shape,
        )
        if shapes != ((), (m, m), (m,), (), (QUANTILES, scales)):
            raise ValueError("its arrays contradict each other")
        return made


def describe(shape: ShapeAnalysis) -> Descriptor:
    """The descriptor of an analysed body."""
    tips, mesh = extremities(shape), shape.mesh
    count = DESCRIPTOR.tips
    corners = mesh.vertices[mesh.oriented_triangles]
    volume = np.einsum("mx,mx->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return Descriptor(
        np.log(np.maximum(shape.basis.eigenvalues[1 : DESCRIPTOR.eigenvalues + 1], SMALLEST)),
        tips.between[:count, :count],
        tips.average_distance[:count],
        tips.persistence[:count],
        np.log(max(abs(volume), SMALLEST)),
        np.quantile(shape.curvature, np.linspace(0, 1, QUANTILES), axis=0),
    )


def compare(one: Descriptor, other: Descriptor) -> Difference:
    """Compare two descriptors; the order does not matter."""
    count = min(len(one.spectrum), len(other.spectrum))
    return Difference(
        float(np.abs(one.spectrum[:count] - other.spectrum[:count]).mean()) / DESCRIPTOR.spectrum,
        _limb_difference(one, other) / DESCRIPTOR.limbs,
        float(abs(one.volume - other.volume)) / DESCRIPTOR.volume,
        float(np.abs(one.curvature - other.curvature).mean()) / DESCRIPTOR.curvature,
    )


def _limb_difference(one: Descriptor, other: Descriptor) -> float:
    """The cost of the best pairing of two shapes' tips, in which at most one tip of the smaller set is unpaired."""
    fewer, more = sorted((one, other), key=lambda each: len(each.persistence))
    single = (np.abs(fewer.average[:, None] - more.average) + np.abs(fewer.persistence[:, None] - more.persistence)) / 2
    mutual = np.abs(fewer.between[:, None, :, None] - more.between[None, :, None, :])
    full = len(fewer.persistence)
    costs = []
    for size in range(max(full - 1, min(full, 3)), full + 1):
        left, right = (pairing[0] for pairing in cheapest_pairings(single, mutual, size))
        pairs = mutual[left[:, None], right[:, None], left, right].sum() / max(size * (size - 1), 1)
        alone = sum(
            each.persistence.sum() - each.persistence[used].sum() for each, used in ((fewer, left), (more, right))
        )
        costs.append(single[left, right].mean() + pairs + DESCRIPTOR.unpaired * alone)
    return float(min(costs))
