"""Hypotheses for round shapes: eigenfunctions of one eigenvalue are known up to a turn among themselves.

Where the first eigenvalues come in pairs, as on a vase, a table or a ring, no choice of signs finds the right map.
Nor can anything else where the shape is truly symmetric; its turned images then show how uncertain any map is.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import block_diag

from zoomout_core.arrays import Floats
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class RotationTuning(Tuning, set_by="judgement"):
    """Which eigenvalues are repeated, and which rotations are tried.

    Attributes:
        same_eigenvalue: eigenvalues that differ by a smaller part count as one.
        angles: evenly spread rotations.
        leading: eigenfunctions, without the constant one, among which a pair is sought.
    """

    same_eigenvalue: float = tuned(0.03, "1", 0, 1)
    angles: int = tuned(8, "rotations", 1, 360)
    leading: int = tuned(4, "eigenfunctions", 2, 100)


ROTATIONS = RotationTuning()


def rotation_hypotheses(source: ShapeAnalysis, target: ShapeAnalysis) -> list[Hypothesis]:
    """Turns and mirrored turns of the first pair, with all signs of what comes before; none without a pair."""
    leading = ROTATIONS.leading
    values = source.basis.eigenvalues[: leading + 1], target.basis.eigenvalues[: leading + 1]
    if min(len(values[0]), len(values[1])) <= leading:
        return []
    relative = ROTATIONS.same_eigenvalue
    repeated = np.all([np.diff(ascending)[1:] < relative * ascending[1:-1] for ascending in values], axis=0)
    if not repeated.any():
        return []
    before = int(np.argmax(repeated))  # functions between the constant one and the pair
    hypotheses = []
    for signs in product((1.0, -1.0), repeat=before):
        for angle, mirror in product(np.arange(ROTATIONS.angles) * 2 * np.pi / ROTATIONS.angles, (1, -1)):
            origin = f"a turn of repeated eigenfunctions by {np.degrees(angle):.0f} degrees" + ", mirrored" * (
                mirror < 0
            )
            hypotheses.append(Hypothesis(origin, block_diag(np.diag([1.0, *signs]), turn(angle, mirror))))
    return hypotheses


def turn(angle: float, mirror: int) -> Floats:
    """(2, 2) turn of the plane by an angle, mirrored where `mirror` is -1."""
    return np.array([[np.cos(angle), -mirror * np.sin(angle)], [np.sin(angle), mirror * np.cos(angle)]])
