"""The table of what a transfer costs once the map is known: every kind of data is there, and its steps add up."""

from __future__ import annotations

import pytest

from benchmarks.transfer import load
from blender_addon.demo import Size

KEYS, GROUPS = 3, 40


def test_every_kind_is_carried_and_timed() -> None:
    rows = load.run(Size(cell=0.05, voxel=0.04, target_vertices=1500), GROUPS, KEYS)["rows"]
    counts = {row["kind"]: row["count"] for row in rows}
    assert counts["uv_maps"] == 3
    assert counts["vertex_groups"] == GROUPS
    assert counts["shape_keys"] == KEYS
    assert {"color_attributes", "edges", "all"} <= counts.keys()
    *kinds, together, waited = rows
    for row in kinds:
        steps = [row[step] for step in ("read", "transfer", "write") if row[step] is not None]
        assert row["seconds"] == pytest.approx(sum(steps))
    assert together["seconds"] == pytest.approx(sum(row["seconds"] for row in kinds))
    assert waited["count"] == together["count"]
    assert waited["seconds"] > 0
