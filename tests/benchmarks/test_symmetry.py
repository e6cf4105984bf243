# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of symmetries uses the sets' known places, and distinguishes right from wrong."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

from benchmarks.paper import symmetry, symmetry_refinement
from benchmarks.paper.mirroring import by_position, in_order_of
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain, Kind

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tables(data: Path) -> Iterator[dict]:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"SETS": ("creatures",), "MAX_SHAPES": 1, "K_SIGNATURES": 60, "K_FIXED": 20}.items():
            patch.setattr(symmetry_refinement, name, value)
        patch.setattr(symmetry_refinement, "FINAL", 40)
        yield symmetry.run(data, None, False, None)


def test_symmetries_are_measured_beside_the_truth(tables: dict) -> None:
    ours, best, truth = tables["rows"]
    assert (ours["method"], ours["shapes"], ours["success %"]) == (symmetry.OURS, 2, 100)
    assert 0 < best["median"] < 60
    assert ours["median"] < 60
    assert ours["seconds after it"] > 0
    # A mirrored creature is isometric to itself but for its mesh: the truth is as exact as that.
    assert truth["median"] == 0
    assert 0 < truth["distortion"] < ours["distortion"] + 20


def test_reversing_start_is_refined_by_each_method(tables: dict) -> None:
    rows = {row["method"]: row for row in tables["refined"]}
    assert list(rows) == list(symmetry_refinement.PUBLISHED)
    assert rows["BIM"]["published SCAPE"] == 133
    assert rows["BIM"]["mean"] is None
    start = rows[symmetry_refinement.START]
    for method in (symmetry_refinement.ZOOMOUT, symmetry_refinement.SAMPLED, symmetry_refinement.BCICP):
        assert rows[method]["shapes"] == 1
        assert rows[method]["mean"] < start["mean"]
        assert rows[method]["seconds"] > 0
    assert rows[symmetry_refinement.ZOOMOUT]["mean"] < 60


def test_criteria_are_compared_on_all_shapes(tables: dict) -> None:
    shares = {row["criterion"]: row["creatures"] for row in tables["criteria"]}
    blocks = {f"{low}{name}" for low in ("", "low ") for name in ("commutativity", "orthonormality")}
    assert blocks | {"any", "total"} <= set(shares)
    assert max(shares.values()) == shares["any"] == 100
    assert min(shares.values()) >= 0


def test_a_folder_without_mirrored_places_makes_no_table(tmp_path: Path) -> None:
    assert symmetry.run(tmp_path, None, False, None) == {"rows": []}


def test_mirroring_by_position_takes_the_nearest_vertex() -> None:
    square = Surface([[-1, 0, 0], [1, 0, 0], [1, 0, 1], [-1, 0, 1.1]], [[0, 1, 2], [0, 2, 3]])
    values = csr_array(np.array([[0.0], [1], [0.5], [0]]))
    weights = Attribute("Weights", Domain.POINT, Kind.WEIGHT, values, ("Arm.L",))
    found = by_position(square, weights)
    assert found.labels == ("Arm.L", "Arm.R")
    np.testing.assert_array_equal(found.values.toarray(), [[0, 1], [1, 0], [0.5, 0], [0, 0.5]])
    reordered = in_order_of(("Arm.R", "Tail", "Arm.L"), found).toarray()
    np.testing.assert_array_equal(reordered, found.values.toarray()[:, [1, 0, 0]] * [1, 0, 1])
