# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a soft object that keep their form, as given by a mask, such as buckles, plates and soles.

Each connected patch of the mask moves rigidly, and is scaled like the whole object. If each had its own scale, the
buttons of one row would differ in size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers, segment_sum
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
        weights: (n,) weight with which each point keeps its place in its part, in [0, 1].
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
        """The rigid motions nearest to positions (n, 3): positions (p, 3) and linear parts (p, 3, 3).

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

        They decay around the parts over a given length, with weights (n,) for staying in place.
        """
        held = HOLD * self.weights * form.areas
        wanted = np.zeros((len(held), offsets.shape[1]))
        wanted[self.points] = self.weights[self.points, None] * offsets
        return ScreenedSmoothing.of(staying + held, form.stiffness, length).solve(held[:, None] * wanted)

    def with_whole_parts(self, chosen: Integers) -> Integers:
        """Numbers of chosen points, and of all others of their parts."""
        touched = np.unique(self.part[np.isin(self.points, chosen)])
        return np.union1d(chosen, self.points[np.isin(self.part, touched)])

    def motions(self, chosen: Integers, positions: Floats) -> PartMotions:
        """The free motions of chosen points, which contain whole parts, at positions (n, 3)."""
        part = np.full(len(self.weights), -1)
        part[self.points] = self.part
        part = part[chosen]
        _, part[part >= 0] = np.unique(part[part >= 0], return_inverse=True)
        return PartMotions.of(self.weights[chosen], part, positions[chosen])


@dataclass(frozen=True, eq=False)
class PartMotions:
    """Small motions of points. Parts move rigidly, other points freely, and intermediate weights blend both.

    Attributes:
        weights: (c,) weight with which each point keeps its place in its part.
        part: (c,) the number of its part, -1 for none.
        arms: (c, 3) its place relative to the centre of its part.
        matrix: (3 c, d) from free motions, which are displacements of points, and a translation and a rotation of each
            part, to displacements.
    """

    weights: Floats
    part: Integers
    arms: Floats
    matrix: csr_array

    @classmethod
    def of(cls, weights: Floats, part: Integers, places: Floats) -> PartMotions:
        """The motions of points with weights (c,), in parts (c,), at places (c, 3)."""
        kept, alone = np.flatnonzero(part >= 0), np.flatnonzero(weights < 1)
        arms, count = np.zeros_like(places), int(part.max(initial=-1)) + 1
        centres = segment_sum(places[kept], part[kept], count) / np.bincount(part[kept], minlength=count)[:, None]
        arms[kept] = places[kept] - centres[part[kept]]
        axis, first = np.arange(3), 3 * len(alone)
        of_part = first + 6 * part[kept, None]
        blocks = (
            (3 * alone[:, None] + axis, 3 * np.arange(len(alone))[:, None] + axis, 1 - weights[alone, None]),
            (3 * kept[:, None] + axis, of_part + axis, weights[kept, None]),
            (
                (3 * kept[:, None] + axis)[:, None],
                (of_part + 3 + axis)[:, :, None],
                weights[kept, None, None] * np.cross(np.eye(3), arms[kept, None]),
            ),
        )
        rows, columns, shares = (
            np.concatenate([each.ravel() for each in some])
            for some in zip(*(np.broadcast_arrays(*block) for block in blocks), strict=True)
        )
        return cls(weights, part, arms, csr_array((shares, (rows, columns)), (3 * len(part), first + 6 * count)))

    def displace(self, solution: Floats) -> Floats:
        """(c, 3) displacements by free motions (d,), with finite rotations, so that parts keep their form exactly."""
        alone, kept = self.weights < 1, self.part >= 0
        moves, count = np.zeros_like(self.arms), int(alone.sum())
        moves[alone] = (1 - self.weights[alone, None]) * solution[: 3 * count].reshape(-1, 3)
        motions = solution[3 * count :].reshape(-1, 6)[self.part[kept]]
        turned = Rotation.from_rotvec(motions[:, 3:]).apply(self.arms[kept]) - self.arms[kept]
        moves[kept] += self.weights[kept, None] * (motions[:, :3] + turned)
        return moves
