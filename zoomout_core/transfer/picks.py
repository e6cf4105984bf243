# SPDX-License-Identifier: GPL-3.0-or-later
"""The elements of the source from which each element of a target takes its value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class Picks:
    """Three elements of the source, and their weights, for each of q elements of the target, all of one domain."""

    elements: Integers  # (q, 3) numbers of points, faces or corners of the source
    weights: Floats  # (q, 3) which sum to one; some are negative where values are continued beyond a border

    @staticmethod
    def single(elements: Integers) -> Picks:
        """One element (q,) for each."""
        return Picks(np.repeat(elements[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(elements), 1)))

    def mix(self, values: Floats) -> Floats:
        """(q, ...) the values, from those (count, ...) of the source."""
        return np.einsum("qk,qk...->q...", self.weights, values[self.elements])
