# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a soft object that keep their form, such as buckles, plates and soles, where a mask says so.

Each connected patch of the mask moves rigidly, and is scaled like the whole object: with a scale of its own, buttons of
one row would differ in size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST, procrustes
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.transfer.groups import label_groups

# Weight of the displacement of parts that keep their form, relative to staying.
HOLD = 1e6


@dataclass(frozen=True, eq=False)
class KeptParts:
    """The parts of a form that keep their form.

    Attributes:
        weights: (n,) how far each point keeps its place in its part, in [0, 1].
        points: (p,) the points of positive weight.
        part: (p,) the numbers of their parts, from 0.
    """

    weights: Floats
    points: Integers
    part: Integers

    @classmethod
    def of(cls, form: Form) -> KeptParts:
        """The connected patches of a form's mask."""
        points = np.flatnonzero(form.keep > 0)
        first, second = (each.astype(np.int64) for each in form.stiffness[points][:, points].nonzero())
        label = label_groups(len(points), first, second)
        return cls(form.keep, points, np.unique(label, return_inverse=True)[1].ravel())

    @property
    def count(self) -> int:
        """The number of parts."""
        return int(self.part.max(initial=-1)) + 1

    def fit_rigidly(self, form: Form, positions: Floats, scale: float = 1.0) -> tuple[Floats, Floats]:
        """(p, 3) rigid positions of the points, nearest to positions (n, 3), and (p, 3, 3) linear parts of the motions.

        The parts are scaled by a factor.
        """
        found, linear = np.empty((len(self.points), 3)), np.empty((len(self.points), 3, 3))
        for number in range(self.count):
            chosen = self.part == number
            points = self.points[chosen]
            weights = np.maximum(self.weights[points] * form.areas[points], SMALLEST)
            motion = procrustes(form.rest[points], positions[points], weights, scales=(scale, scale))
            found[chosen], linear[chosen] = motion(form.rest[points]), motion.linear
        return found, linear

    def displace(self, form: Form, offsets: Floats, staying: Floats, length: float) -> Floats:
        """(n, d) displacements of all points, from those (p, d) of parts that keep their form.

        Around the parts they fade over a length, by weights (n,) of staying.
        """
        held = HOLD * self.weights * form.areas
        wanted = np.zeros((len(held), offsets.shape[1]))
        wanted[self.points] = self.weights[self.points, None] * offsets
        return ScreenedSmoothing.of(staying + held, form.stiffness, length).solve(held[:, None] * wanted)

    def with_whole_parts(self, chosen: Integers) -> Integers:
        """Numbers of chosen points, and of all others of their parts."""
        touched = np.unique(self.part[np.isin(self.points, chosen)])
        return np.union1d(chosen, self.points[np.isin(self.part, touched)])

    def motions(self, chosen: Integers) -> csr_array:
        """(c, d) matrix from all free motions of chosen points, which contain whole parts, to their displacements.

        Parts are displaced as a whole, other points by themselves, and those of a weight between in both ways.
        """
        part = np.full(len(self.weights), -1)
        part[self.points] = self.part
        weights, part, rows = self.weights[chosen], part[chosen], np.arange(len(chosen))
        alone, together = np.flatnonzero(weights < 1), np.flatnonzero(weights > 0)
        shares = np.concatenate([1 - weights[alone], weights[together]])
        columns = np.concatenate([alone, len(chosen) + part[together]])
        _, columns = np.unique(columns, return_inverse=True)
        return csr_array((shares, (np.concatenate([rows[alone], rows[together]]), columns.ravel())))
