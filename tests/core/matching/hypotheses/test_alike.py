# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps with similar images count as the same."""

from __future__ import annotations

import numpy as np

from zoomout_core.matching.hypotheses.hypothesis import alike


def test_maps_are_alike_within_a_fraction_of_the_variance() -> None:
    random = np.random.default_rng(0)
    first = random.standard_normal((50, 3)) * [3, 1, 1] + [5, 0, 0]
    places = [first + off + noise * random.standard_normal((50, 3)) for off, noise in ((0, 0), (0.5, 0), (0, 1))]
    places += [first[::-1], 0.3 * first + [3.5, 0, 0], first + np.array([0, 1.2, 0]), 3 * first]
    for tolerance in (0.02, 0.1, 0.3, 1.0):
        found = alike(places, tolerance)
        for i, one in enumerate(places):
            allowed = tolerance * ((one - one.mean(axis=0)) ** 2).sum(axis=1).mean()
            for j, other in enumerate(places):
                assert found[i, j] == (((one - other) ** 2).sum(axis=1).mean() <= allowed), (i, j, tolerance)
    assert alike(places, 0.1).diagonal().all()
