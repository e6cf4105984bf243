# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses without descriptors: the first eigenfunctions correspond up to their signs (ZoomOut, section 5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class SignTuning(Tuning, set_by="correspondence"):
    """The sizes of the maps.

    Attributes:
        sizes: numbers of leading eigenfunctions that are assumed to correspond; nearly repeated ones need more than 4.
    """

    sizes: tuple[int, ...] = tuned((4, 5, 6), "eigenfunctions", 1, 12)


SIGNS = SignTuning()


def sign_hypotheses(source: ShapeAnalysis, target: ShapeAnalysis) -> list[Hypothesis]:
    """All diagonal maps diag(1, +-1, ..., +-1) of a few sizes that both bases allow."""
    available = min(len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    return [
        Hypothesis("signs of eigenfunctions " + "".join("+-"[sign < 0] for sign in signs), np.diag([1.0, *signs]))
        for k in SIGNS.sizes
        if k <= available
        for signs in product((1.0, -1.0), repeat=k - 1)
    ]
