# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypotheses without descriptors: the first eigenfunctions correspond up to their signs (ZoomOut, section 5.1)."""

from __future__ import annotations

from itertools import product

import numpy as np

from zoomout_core.matching.hypotheses.hypothesis import Hypothesis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis

# Numbers of leading eigenfunctions that are assumed to correspond; nearly repeated ones need more than 4.
SIZES = 4, 5, 6


def sign_hypotheses(source: ShapeAnalysis, target: ShapeAnalysis) -> list[Hypothesis]:
    """All diagonal maps diag(1, +-1, ..., +-1) of a few sizes that both bases allow."""
    available = min(len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    return [
        Hypothesis("signs of eigenfunctions " + "".join("+-"[sign < 0] for sign in signs), np.diag([1.0, *signs]))
        for k in SIZES
        if k <= available
        for signs in product((1.0, -1.0), repeat=k - 1)
    ]
