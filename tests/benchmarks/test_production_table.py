# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of live links and of levels of detail measure each kind of data, and each level."""

import numpy as np
import pytest

from benchmarks import production


@pytest.mark.slow
def test_each_kind_of_data_is_linked_and_equals_the_operator() -> None:
    tables = production.run(cell=0.04, voxel=0.03, vertices=2000, detailed=0.04)
    rows = tables["link"]
    assert [row["data"] for row in rows] == list(production.KINDS)
    assert all(row["layers"] and row["follows %"] > 40 for row in rows)
    assert max(row["difference"] for row in rows) < 1e-5
    levels = tables["lods"]
    assert [row["share"] for row in levels] == list(np.repeat(production.RATIOS, 2))
    assert all(0 < row["rest %"] < row["posed %"] < 2 for row in levels)
