# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses for round shapes: eigenfunctions of one eigenvalue are known up to a turn among themselves.

Where the first eigenvalues come in pairs, as on a vase, a table or a ring, no choice of signs finds the right map.
Nor can anything else where the shape is truly symmetric; its turned images then show how uncertain any map is.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.linalg import block_diag

from zoomout_core.arrays import Floats
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis

# Consecutive eigenvalues whose relative difference is smaller count as repeated.
REPEATED_EIGENVALUE_GAP = 0.03
# Evenly spaced angles by which a pair of repeated eigenfunctions is rotated.
ROTATION_ANGLES = 8
# Eigenfunctions, after the constant one, among which such a pair is searched.
LEADING_EIGENFUNCTIONS = 4


def rotation_hypotheses(source: ShapeAnalysis, target: ShapeAnalysis) -> list[Hypothesis]:
    """Turns and mirrored turns of the first pair, with all signs of what comes before; none without a pair."""
    leading = LEADING_EIGENFUNCTIONS
    values = source.basis.eigenvalues[: leading + 1], target.basis.eigenvalues[: leading + 1]
    if min(len(values[0]), len(values[1])) <= leading:
        return []
    relative = REPEATED_EIGENVALUE_GAP
    repeated = np.all([np.diff(ascending)[1:] < relative * ascending[1:-1] for ascending in values], axis=0)
    if not repeated.any():
        return []
    before = int(np.argmax(repeated))  # functions between the constant one and the pair
    hypotheses = []
    for signs in product((1.0, -1.0), repeat=before):
        for angle, mirror in product(np.arange(ROTATION_ANGLES) * 2 * np.pi / ROTATION_ANGLES, (1, -1)):
            origin = f"a turn of repeated eigenfunctions by {np.degrees(angle):.0f} degrees" + ", mirrored" * (
                mirror < 0
            )
            hypotheses.append(Hypothesis(origin, block_diag(np.diag([1.0, *signs]), turn(angle, mirror))))
    return hypotheses


def turn(angle: float, mirror: int) -> Floats:
    """(2, 2) turn of the plane by an angle, mirrored where `mirror` is -1."""
    return np.array([[np.cos(angle), -mirror * np.sin(angle)], [np.sin(angle), mirror * np.cos(angle)]])
