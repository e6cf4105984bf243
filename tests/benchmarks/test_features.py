# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement may start from features in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from creatures import creature

from benchmarks import datasets
from benchmarks.__main__ import main
from benchmarks.paper import refinement, refinement_methods, starts


@pytest.fixture
def features(tmp_path: Path) -> Path:
    """The direction of each vertex of the shapes of `data`: smooth features that distinguish left from right."""
    (tmp_path / "creatures").mkdir()
    for seed, (name, bend) in enumerate((("a", 0.0), ("b", 0.9))):
        where = creature(900, seed, bend).directions
        np.save(tmp_path / "creatures" / f"{name}.npy", np.hstack([where, where**2, where * where[:, [1, 2, 0]]]))
    return tmp_path


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The initial map alone, from few functions."""
    monkeypatch.setattr(refinement, "METHODS", {"initial": refinement.METHODS["initial"]})
    monkeypatch.setattr(refinement_methods, "K_FINAL", 20)
    monkeypatch.setattr(starts, "K_SIGNATURES", 40)
    monkeypatch.setattr(datasets, "MAX_PLACES", 50)


def test_a_map_is_fitted_to_the_features(data: Path, features: Path) -> None:
    (row,) = refinement.run_features(data, features, 1, None)["rows"]
    assert (row["set"], row["pairs"]) == ("creatures, features", 1)
    assert row["mean"] < 100  # the map that exchanges left and right has 245


def test_features_must_have_a_row_for_each_vertex(data: Path, features: Path) -> None:
    call = ["refinement", "--data", str(data), "--features", str(features), "--pairs", "1"]
    np.save(features / "creatures" / "a.npy", np.ones((3, 2)))
    outcome = CliRunner().invoke(main, call)
    assert outcome.exit_code == 1
    assert "has an array of shape (3, 2), but needs a row for each of 900 vertices" in outcome.output
    (features / "creatures" / "a.npy").unlink()
    outcome = CliRunner().invoke(main, call)
    assert "holds nothing" in outcome.output
