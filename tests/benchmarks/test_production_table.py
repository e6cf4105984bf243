# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of live links measures each kind of data."""

from benchmarks import production


def test_each_kind_of_data_is_linked_and_equals_the_operator() -> None:
    rows = production.run(cell=0.04, voxel=0.03, vertices=2000)["link"]
    assert [row["data"] for row in rows] == list(production.KINDS)
    assert all(row["layers"] and row["follows %"] > 40 for row in rows)
    assert max(row["difference"] for row in rows) < 1e-5
