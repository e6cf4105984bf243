# SPDX-License-Identifier: GPL-3.0-or-later
"""Valid but unusually large options work."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import creature, true_vertex

import zoomout_core as zo

SOURCE, TARGET = creature(520), creature(480, seed=1)


@pytest.mark.slow
def test_match_accepts_more_functions_than_samples() -> None:
    result = zo.match(SOURCE.surface, TARGET.surface, k_final=1000, samples=20)
    truth = true_vertex(SOURCE, TARGET)
    assert zo.geodesic_error(result.surface_map, SOURCE.surface, np.arange(len(truth)), truth).mean() < 0.03
    assert len(result.use(1).confidence) == len(truth)


@pytest.mark.slow
def test_symmetry_accepts_more_functions_than_search_samples() -> None:
    assert zo.detect_symmetry(SOURCE.surface, k_final=450)[0].certainty > 0.5
