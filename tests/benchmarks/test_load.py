# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of the cost of transfers along a known map has a row for every kind of data."""

from __future__ import annotations

import pytest

from benchmarks.transfer import load
from blender_addon.demo import Size

pytestmark = pytest.mark.slow

KEYS, GROUPS = 3, 40


def test_every_kind_is_transferred_and_timed() -> None:
    rows = load.run(Size(cell=0.05, voxel=0.04, target_vertices=1500), GROUPS, KEYS)["rows"]
    counts = {row["kind"]: row["count"] for row in rows}
    assert counts["uv_maps"] == 3
    assert counts["vertex_groups"] == GROUPS
    assert counts["shape_keys"] == KEYS
    assert {"color_attributes", "edges", "all"} <= counts.keys()
    assert all(row["seconds"] > 0 for row in rows)
