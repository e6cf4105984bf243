# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums over segments, and rows."""

import numpy as np
import pytest

from zoomout_core.arrays import all_in_row, any_in_row, row_norms, segment_sum, take_rows


def test_segments_are_summed_and_empty_ones_are_zero() -> None:
    segment = np.array([2, 0, 2])
    assert segment_sum(np.array([1.0, 2.0, 4.0]), segment, 5).tolist() == [2, 0, 5, 0, 0]
    values = np.array([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]])
    assert segment_sum(values, segment).tolist() == [[2, 20], [0, 0], [5, 50]]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("columns", [1, 2, 3, 7])
def test_row_norms_equal_those_of_numpy_exactly(columns: int, dtype: type) -> None:
    vectors = np.random.default_rng(0).standard_normal((500, columns)).astype(dtype)
    found = row_norms(vectors)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.linalg.norm(vectors, axis=1))


@pytest.mark.parametrize("columns", [1, 2, 3, 10])
def test_masks_are_combined_like_those_of_numpy(columns: int) -> None:
    chosen = np.random.default_rng(0).random((40, 5, columns)) < 0.6
    np.testing.assert_array_equal(any_in_row(chosen), chosen.any(axis=-1))
    np.testing.assert_array_equal(all_in_row(chosen), chosen.all(axis=-1))


def test_taken_rows_have_the_shape_of_the_indices() -> None:
    values, numbers = np.arange(12.0).reshape(4, 3), np.array([[3, 0], [1, -1]])
    np.testing.assert_array_equal(take_rows(values, numbers), values[numbers])
