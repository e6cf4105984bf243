# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of binding: a posed character is bound to its rig, and follows it like its source."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import binding
from benchmarks.binding import cases, pictures
from benchmarks.characters import game

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pictures")


@pytest.fixture(scope="module")
def tables(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict]]:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"CELL": 0.05, "BOUND_IN": 1, "TAKEN": 1, "FEWEST": 1200}.items():
            patch.setattr(cases, name, value)
        patch.setattr(game, "VOXEL", 0.03)
        patch.setattr(pictures, "SQUARE", 32)
        patch.setattr(pictures, "SAMPLES", 1)
        return binding.run(tmp_path_factory.mktemp("data"), None, folder)


def test_every_method_is_measured_on_both_meshes(tables: dict[str, list[dict]]) -> None:
    ways = {"true weights", "Bind to Rig", "Bind to Rig, true map", "weights alone", "Data Transfer"}
    assert {(row["mesh"], row["way"]) for row in tables["rows"]} == {
        (mesh, way) for mesh in ("isotropic", "voxels") for way in ways
    }
    assert len(tables["cases"]) == len(tables["rows"]) == 10
    assert all(row["cases"] == 1 for row in tables["rows"])


def test_bound_target_follows_rig_better_than_weights_alone(tables: dict[str, list[dict]]) -> None:
    found = {(row["mesh"], row["way"]): row for row in tables["rows"]}
    for mesh, true, most in (("isotropic", 0.05, 0.2), ("voxels", 0.3, 0.4)):
        assert found[mesh, "true weights"]["surface"] < true
        assert found[mesh, "Bind to Rig"]["surface"] < most
        assert found[mesh, "Bind to Rig, true map"]["place"] < 2 * most
        for way in ("weights alone", "Data Transfer"):
            assert found[mesh, way]["surface"] > 2
            assert found[mesh, way]["as good"] == 0
        assert found[mesh, "true weights"]["as good"] == 1


def test_pictures_are_drawn(tables: dict[str, list[dict]], folder: Path) -> None:
    assert tables
    assert sorted(file.name for file in folder.iterdir()) == [
        "character_pose_0_isotropic.png",
        "character_pose_0_voxels.png",
    ]
    assert all(file.stat().st_size > 300 for file in folder.iterdir())
