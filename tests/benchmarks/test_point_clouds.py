# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds as source and target, drawn from meshes or from a set; kinds of meshes matched with each other."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from creatures import creature, directions
from scipy.spatial import cKDTree

import zoomout_core as zo
from benchmarks.datasets import PairOfMeshes, load_pair
from benchmarks.paper import discretisation, point_clouds

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set with a common template: two people, each as a mesh and as a cloud."""
    folder = tmp_path_factory.mktemp("people")
    template, vertex = directions(600, seed=9), {}
    for person, bend in (("a", 0.0), ("b", 0.9)):
        for seed, kind in enumerate(("iso", "cloud")):
            shape = creature(900, seed, bend)
            mesh = trimesh.Trimesh(shape.surface.vertices, shape.surface.triangles, process=False)
            made = mesh if kind == "iso" else trimesh.PointCloud(mesh.vertices)
            made.export(folder / f"{kind}_{person}.ply")
            vertex[f"{kind}_{person}"] = cKDTree(template).query(shape.directions)[1]
    np.savez(folder / "template_vertex.npz", **vertex)
    return folder


@pytest.fixture
def matched(monkeypatch: pytest.MonkeyPatch) -> None:
    """A replacement of matches: maps to person b are right, the others wrong, and all have full certainty."""

    def outcome(pair: PairOfMeshes) -> tuple[SimpleNamespace, np.ndarray]:
        known = pair.source.vertices[pair.source_vertex]
        assert len(known) > 100
        return SimpleNamespace(certainty=0.95), np.full(3, 10.0 if pair.source_name.endswith("b") else 200.0)

    for module in (point_clouds, discretisation):
        monkeypatch.setattr(module, "match", outcome)


@pytest.mark.usefixtures("matched")
def test_clouds_match_meshes_and_each_other(people: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_clouds, "_methods", lambda pair, _: {"initial": np.zeros(len(pair.target.vertices), int)})
    tables = point_clouds.run(people, None)
    found = {row["direction"]: (row["pairs"], row["right"], row["certain and wrong"]) for row in tables["match"]}
    assert found == dict.fromkeys(("cloud to cloud", "cloud to mesh", "mesh to cloud"), (2, 1, 1))
    rows = {row["method"]: row for row in tables["rows"]}
    assert rows["initial"]["published mean"] == point_clouds.PUBLISHED["initial"][0]
    assert rows["initial"]["seconds"] is None
    assert rows[point_clouds.MATCH]["mean error"] == 105
    assert len(point_clouds.run(people, 3)["pairs"]) == 3 * 2


def test_maps_of_clouds_are_refined(people: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_clouds, "K_FINAL", 40)
    monkeypatch.setattr(point_clouds, "K_SIGNATURES", 60)
    right = SimpleNamespace(certainty=1.0), np.zeros(3)
    monkeypatch.setattr(point_clouds, "match", lambda _: right)
    made = point_clouds._methods

    def quick(pair: PairOfMeshes, seed: int) -> dict[str, object]:
        methods = made(pair, seed)
        return {name: methods[name] for name in ("initial", "ICP20", "ZoomOut*")}

    monkeypatch.setattr(point_clouds, "_methods", quick)
    tables = point_clouds.run(people, 1, tmp_path / "curves.png")
    error = {row["method"]: row["mean error"] for row in tables["rows"]}
    assert error["ZoomOut*"] < error["initial"] < 200
    assert (tmp_path / "curves.png").is_file()


def test_points_are_sampled_only_from_tosca(data: Path) -> None:
    assert point_clouds.run(data, None)["rows"] == []


def test_sampled_points_lie_on_their_meshes(data: Path) -> None:
    pair = load_pair(data / "creatures", "a", "b")
    found = dict(point_clouds._pairs(pair, 0, sampled=True))
    assert list(found) == list(point_clouds.DIRECTIONS)
    drawn = found["cloud to cloud"]
    for surface, vertex, whole, known in (
        (drawn.target, drawn.target_vertex, pair.target, pair.target_vertex),
        (drawn.source, drawn.source_vertex, pair.source, pair.source_vertex),
    ):
        assert len(surface.vertices) == point_clouds.POINTS
        apart = np.linalg.norm(surface.vertices[vertex] - whole.vertices[known], axis=1)
        assert np.median(apart) < 0.03 * np.sqrt(whole.area)
    assert found["cloud to mesh"].source is pair.source
    assert found["mesh to cloud"].target is pair.target


@pytest.mark.usefixtures("matched")
def test_each_kind_of_mesh_has_a_row_against_each_kind(people: Path) -> None:
    tables = discretisation.run(people, None, people / "curves.png")
    assert (people / "curves.png").is_file()
    assert tables["rows"] == [{"target": kind, "cloud": 105.0, "iso": 105.0} for kind in ("cloud", "iso")]
    assert tables["right"] == [{"target": kind, "cloud": "1/2", "iso": "1/2"} for kind in ("cloud", "iso")]


def test_a_match_is_measured_at_known_places(data: Path) -> None:
    pair = load_pair(data / "creatures", "a", "b")
    result, errors = discretisation.match(pair)
    own = 1000 * zo.geodesic_error(result.surface_map, pair.source, pair.target_vertex, pair.source_vertex)
    assert errors.mean() == pytest.approx(own.mean(), rel=0.2)
