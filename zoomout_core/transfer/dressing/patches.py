# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of a surface around places beside it, with Gaussian weights.

The surface is sampled at several densities, so that a wide patch needs no more samples than a small one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_on_triangles
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.runtime.threads import threads
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PatchTuning(Tuning, set_by="outfits"):
    """How densely patches are sampled.

    Attributes:
        samples: number of samples of the surface for the smallest patches; each further set has a quarter of the
            previous one.
        sets: number of sets of samples.
        neighbours: number of samples of a patch.
        reach: maximum standard deviation for using a set, relative to the distance between its neighbouring samples.
    """

    samples: int = tuned(20_480, "points", 100, 10_000_000)
    sets: int = tuned(5, "sets", 1, 10)
    neighbours: int = tuned(40, "points", 1, 1000)
    reach: float = tuned(1.3, "1", 0.1, 10)


PATCHES = PatchTuning()


class PatchesOfSet(NamedTuple):
    """The patches around some places, of samples of one set."""

    set: int  # number of the set
    which: Integers  # (p,) numbers of the places
    near: Integers  # (p, k) samples of the set
    weights: Floats  # (p, k) their weights, which sum to one


class Patches:
    """A surface of unit area, with vertices (n, 3) and triangles (m, 3), sampled for patches."""

    def __init__(self, vertices: Floats, triangles: Integers) -> None:
        self.sets = [
            Samples.of(vertices, triangles, max(1, PATCHES.samples // 4**number)) for number in range(PATCHES.sets)
        ]

    def distances(self, places: Floats) -> Floats:
        """(q,) distances of places (q, 3) from the surface."""
        return np.asarray(self.sets[0].tree.query(places, workers=threads())[0])

    def around(self, places: Floats, width: Floats) -> Iterator[PatchesOfSet]:
        """The patches around places (q, 3), with weights of a standard deviation (q,)."""
        last = np.zeros(len(places), dtype=np.int64)
        for number, samples in enumerate(self.sets[:-1]):
            last[width > PATCHES.reach * samples.spacing] = number + 1
        for number, samples in enumerate(self.sets):
            which = np.flatnonzero(last == number)
            if len(which):
                yield PatchesOfSet(number, which, *samples.around(places[which], width[which]))

    def means(self, places: Floats, width: Floats) -> csr_array:
        """(q, n) matrix of the means, over patches around places (q, 3), of values at the vertices."""
        rows, columns, entries = list[Integers](), list[Integers](), list[Floats]()
        for patches in self.around(places, width):
            samples = self.sets[patches.set]
            shares = patches.weights[:, :, None] * samples.barycentric[patches.near]
            rows.append(np.repeat(patches.which, shares[0].size))
            columns.append(samples.corners[patches.near].ravel())
            entries.append(shares.ravel())
        index = np.concatenate(rows), np.concatenate(columns)
        return csr_array((np.concatenate(entries), index), shape=(len(places), self.sets[0].count))


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of a surface, which represent equal areas."""

    places: Floats  # (s, 3) positions
    corners: Integers  # (s, 3) vertices of their triangles
    barycentric: Floats  # (s, 3) weights of these vertices
    tree: cKDTree  # search tree of the positions
    count: int  # number of vertices of the surface

    @classmethod
    def of(cls, vertices: Floats, triangles: Integers, count: int) -> Samples:
        """Sample a surface."""
        places, triangle = surface_samples(vertices, triangles, count)
        corners = triangles[triangle]
        barycentric, _ = closest_on_triangles(places, *vertices[corners].transpose(1, 0, 2))
        return cls(places, corners, barycentric, cKDTree(places), len(vertices))

    @property
    def spacing(self) -> float:
        """The distance between neighbours, at unit area."""
        return float(len(self.places) ** -0.5)

    def interpolate(self, values: Floats) -> Floats:
        """(s, d) values at the samples, from those (n, d) at the vertices."""
        return np.einsum("sc,scd->sd", self.barycentric, values[self.corners])

    def around(self, places: Floats, width: Floats) -> tuple[Integers, Floats]:
        """(q, k) numbers and (q, k) weights of the samples around places (q, 3), for a standard deviation (q,)."""
        count = min(PATCHES.neighbours, len(self.places))
        found = self.tree.query(places, count, workers=threads())
        distance, near = (np.asarray(each).reshape(len(places), count) for each in found)
        weights = np.exp((distance[:, :1] ** 2 - distance**2) / (2 * width[:, None] ** 2))
        return near, weights / weights.sum(axis=1, keepdims=True)
