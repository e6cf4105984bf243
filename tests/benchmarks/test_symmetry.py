"""The table of symmetries is made from what the shapes say, and knows right from wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

from benchmarks import symmetry
from benchmarks.mirroring import by_position, in_order_of
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain, Kind


@pytest.fixture(scope="module")
def tables(data: Path) -> dict:
    return symmetry.run(data, None, False, None)


def test_symmetries_are_measured_beside_the_truth_and_the_published(tables: dict) -> None:
    ours, best, truth, *published = tables["rows"]
    assert (ours["method"], ours["shapes"], ours["success %"]) == (symmetry.OURS, 2, 100)
    assert 0 < best["median"] < 60
    assert ours["median"] < 60
    assert ours["seconds after it"] > 0
    # A mirrored creature is isometric to itself but for its mesh: the truth is as exact as that.
    assert truth["median"] == 0
    assert 0 < truth["distortion"] < ours["distortion"] + 20
    assert {row["method"] for row in published} == set(symmetry.PUBLISHED)
    assert all(row["shapes"] is None for row in published)


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
