# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of parts: every method on every pair, slow ones on few, and the figures of a map."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.datasets import PairOfParts, kind_of_part, part_names
from benchmarks.paper import partial
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few functions, and one pair for slow methods."""
    monkeypatch.setattr(partial, "K", 40)
    monkeypatch.setattr(partial, "K_INITIAL", 10)
    monkeypatch.setattr(partial, "K_BASIS", 45)
    monkeypatch.setattr(partial, "FEW", 1)
    monkeypatch.setattr(partial, "PLACES", 150)


def test_each_kind_has_a_row_for_each_method(parts: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    chosen = ("initial", "PFM", "ZoomOut", "ZoomOut after PFM")
    slow = partial.Method(lambda part: np.where(np.arange(len(part.truth)) % 2, part.truth, -1), is_slow=True)
    methods = {name: partial.METHODS[name] for name in chosen} | {"CPD": slow}
    monkeypatch.setattr(partial, "METHODS", methods)
    tables = partial.run(parts, None, tmp_path / "curves.png")
    rows = {(row["set"], row["method"]): row for row in tables["rows"]}
    assert list(rows) == [(kind, name) for kind in ("cuts", "holes") for name in ("initial", "PFM", "ZoomOut",
                          "ZoomOut after PFM", "CPD")]  # fmt: skip
    assert [rows["cuts", name]["pairs"] for name in methods] == [2, 1, 2, 1, 1]
    for kind in ("cuts", "holes"):
        # The time includes its start, and computations that both need.
        assert rows[kind, "ZoomOut after PFM"]["seconds"] > rows[kind, "PFM"]["seconds"] > 0
    # Slow methods are compared with ZoomOut on the same pair.
    errors = {record["pair"]: record["error"] for record in tables["pairs"] if record["method"] == "ZoomOut"}
    assert rows["cuts", "PFM"]["ZoomOut there"] == errors["cut_a_00"]
    assert rows["cuts", "ZoomOut"]["ZoomOut there"] == rows["cuts", "ZoomOut"]["mean"]
    assert rows["cuts", "PFM"]["published s"] == 70
    assert rows["holes", "PFM"]["published s"] is None
    # Every second place has its true image, and the others none.
    half = next(record for record in tables["pairs"] if record["method"] == "CPD")
    assert half["error"] == 0
    assert half["curve"][-1] == pytest.approx(0.5, abs=0.1)
    assert matplotlib.image.imread(tmp_path / "curves.png").shape[1] > 1000


def test_pairs_are_those_of_the_known_kinds_evenly_spread(parts: Path) -> None:
    assert part_names(parts / "partial", None, partial.KINDS) == ["cut_a_00", "cut_a_01", "holes_a_00"]
    assert part_names(parts / "partial", 2, partial.KINDS) == ["cut_a_00", "holes_a_00"]


def test_map_is_measured_by_errors_and_coverage() -> None:
    """A strip of 10 squares, and a part that belongs to its left half."""
    points = np.array([[x, y, 0] for x in range(11) for y in range(2)], dtype=float)
    corner = 2 * np.arange(10)[:, None]
    strip = Surface(points, np.concatenate([corner + np.array([0, 2, 1]), corner + np.array([1, 2, 3])]))
    truth = np.append(np.arange(12), -1)
    pair = PairOfParts("cut_00", strip, strip, truth)
    np.testing.assert_array_equal(np.flatnonzero(pair.region), range(14))
    exact = partial.figures(truth, pair)
    assert (exact["error"], exact["covered %"]) == (0, 100)
    one_off = partial.figures(truth + 2, pair)
    assert one_off["error"] == pytest.approx(1000 / np.sqrt(10))
    in_one_place = partial.figures(np.zeros(13, dtype=int), pair)
    # Only a corner's triangle, of the region's 6.5 squares by vertices, has all three vertices reached.
    assert 0 < in_one_place["covered %"] < 25


def test_a_folder_without_parts_is_refused(data: Path) -> None:
    refused = CliRunner().invoke(main, ["partial", "--data", str(data)])
    assert refused.exit_code == 1
    assert "holds nothing" in refused.output


def test_pairs_of_other_sets_are_named() -> None:
    with pytest.raises(MeshError, match="The pair cat_1 is of no known kind: begin its name with cut"):
        kind_of_part("cat_1")
