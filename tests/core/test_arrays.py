# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums over segments."""

import numpy as np

from zoomout_core.arrays import segment_sum


def test_values_of_a_segment_are_summed_and_empty_segments_are_zero() -> None:
    segment = np.array([2, 0, 2])
    assert segment_sum(np.array([1.0, 2.0, 4.0]), segment, 5).tolist() == [2, 0, 5, 0, 0]
    values = np.array([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]])
    assert segment_sum(values, segment).tolist() == [[2, 20], [0, 0], [5, 50]]
