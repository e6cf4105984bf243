# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of refinements: every method from the same initial map, published maps, and the curves."""

from __future__ import annotations

import shutil
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from creatures import creature, directions, mirrored_vertex, true_vertex
from scipy.spatial import cKDTree

import zoomout_core as zo
from benchmarks import datasets
from benchmarks.__main__ import main
from benchmarks.paper import refinement, refinement_methods, refinement_settings, starts

pytestmark = pytest.mark.slow

QUICK = ("initial", "ICP")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fast methods, with few functions."""
    monkeypatch.setattr(refinement, "METHODS", {name: refinement.METHODS[name] for name in QUICK})
    monkeypatch.setattr(refinement_methods, "K_FINAL", 30)
    monkeypatch.setattr(refinement_methods, "K_FIXED", 20)
    monkeypatch.setattr(datasets, "MAX_PLACES", 100)


@pytest.fixture
def sets(data: Path, tmp_path: Path) -> Path:
    """One set with only mirrored initial maps, and one non-isometric set with a published map."""
    for name, start in (("faust_of_creatures", "WKSini_symm"), ("nonisometric_creatures", "WKSini_direct")):
        shutil.copytree(data / "creatures", tmp_path / name)
        with np.load(tmp_path / name / f"map_ini_{start.split('_')[1]}.npz") as maps:
            there = maps["a__b"]
        back = np.zeros(len(there), dtype=int)
        back[there] = np.arange(len(there))
        np.savez(tmp_path / name / f"map_{start}.npz", a__b=there, b__a=back)
    np.savez(tmp_path / "nonisometric_creatures" / "map_BIM.npz", a__b=np.where(there == 5, -1, there))
    return tmp_path


def test_each_kind_of_set_has_a_table_of_all_methods(sets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with np.load(sets / "nonisometric_creatures" / "map_WKSini_direct.npz") as maps:
        fits = [maps["a__b"], maps["b__a"]]
    monkeypatch.setattr(refinement_settings, "from_signatures", lambda *_: fits.pop(0))
    tables = refinement.run(sets, 1, None)
    near, far = tables["rows"], tables["not isometric"]
    flipped = "faust_of_creatures, flipped edges, 2 landmarks"
    assert [(row["set"], row["method"]) for row in near] == [
        *(("faust_of_creatures", method) for method in QUICK),
        *((flipped, method) for method in QUICK),
    ]
    assert [row["method"] for row in far] == [*QUICK, "BIM, published"]
    # The start is the true map, which is fitted where there are mirrored ones alone.
    for row in (near[0], far[0]):
        assert row["mean"] < 20
        assert row["failed %"] == 0
    assert near[1]["published mean"] == refinement_settings.PUBLISHED["ICP"][0]
    assert near[3]["published mean"] == refinement_settings.PUBLISHED_FLIPPED["ICP"][0]
    assert far[1]["published mean"] is None
    assert far[1]["seconds"] > 0
    assert far[0]["seconds"] is None
    # A map that lacks a vertex has an error, and no figures that need all.
    assert far[-1]["mean"] < 20
    assert far[-1]["covered %"] is None


def test_different_meshings_start_from_shot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    template, vertex = directions(400, seed=9), {}
    for seed, name in enumerate(("iso_a", "dense_b", "mc_b", "iso_b")):
        made = creature(500, seed, bend=0.4 * name.endswith("b"), asymmetry=0.3)
        trimesh.Trimesh(made.surface.vertices, made.surface.triangles, process=False).export(tmp_path / f"{name}.ply")
        vertex[name] = cKDTree(template).query(made.directions)[1]
    np.savez(tmp_path / "template_vertex.npz", **vertex)
    monkeypatch.setattr(starts, "K_SIGNATURES", 60)
    tables = refinement.run(tmp_path, None, tmp_path / "curves.png")
    # Pairs of other kinds, not all of which are used, and of other people.
    assert {(record["target"], record["source"]) for record in tables["pairs"]} == {
        ("iso_a", "dense_b"),
        ("dense_b", "iso_a"),
    }
    assert tables["rows"][0]["published mean"] == refinement_settings.PUBLISHED_RESAMPLED["initial"][0]
    assert tables["rows"][0]["mean"] < 200
    image = matplotlib.image.imread(tmp_path / "curves.png")[:, :, :3]
    assert 100 < (np.ptp(image, axis=2) > 0.3).sum() < 0.2 * image[:, :, 0].size


def test_fitted_start_distinguishes_left_from_right() -> None:
    creatures = creature(900, 0, asymmetry=0.3), creature(800, 1, bend=0.5, asymmetry=0.3)
    source, target = (each.surface for each in creatures)
    start = starts.from_signatures(source, target)
    every = np.arange(800)
    direct, mirrored = (
        zo.geodesic_error(start, source, every, truth(*creatures)).mean() for truth in (true_vertex, mirrored_vertex)
    )
    assert direct < 0.08
    assert mirrored > 0.2


def test_round_trip_error_is_measured_at_every_vertex(data: Path) -> None:
    pair = refinement.load_pair(data / "creatures", "a", "b")
    same = np.arange(len(pair.target.vertices))
    assert refinement._bijectivity(same[:, None], pair.target) == 0
    # One vertex that comes back to a neighbour misses by the edge between them.
    triangle = pair.target.triangles[0]
    other = same.copy()
    other[triangle[0]] = triangle[1]
    edge = np.linalg.norm(pair.target.vertices[triangle[0]] - pair.target.vertices[triangle[1]])
    expected = 1000 * edge / np.sqrt(pair.target.area) / len(same)
    assert refinement._bijectivity(np.column_stack([same, other]), pair.target) == pytest.approx([0, expected])


def test_a_folder_without_initial_maps_is_refused(data: Path) -> None:
    refused = CliRunner().invoke(main, ["refinement", "--data", str(data)])
    assert refused.exit_code == 1
    assert "holds nothing" in refused.output
