# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of an animal that is cut and touches another thing, and the table of their maps."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import write_off
from creatures import creature, directions
from scipy.spatial import ConvexHull, cKDTree

from benchmarks.__main__ import main
from benchmarks.paper import clutter
from zoomout_core.mesh.surface import Surface

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def animals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two poses of one class, and a shape of another class."""
    folder = tmp_path_factory.mktemp("data") / "tosca_r"
    folder.mkdir()
    places, known = directions(1200, seed=9), {}
    for seed, (name, bend) in enumerate({"beast0": 0.0, "beast1": 0.5, "other0": 0.9}.items()):
        made = creature(1500, seed, bend, asymmetry=0.3)
        write_off(folder / f"{name}.off", made.surface)
        known[name] = known[f"{name}.sym"] = cKDTree(made.directions).query(places)[1]
    np.savez(folder / "correspondence.npz", **known)
    return folder.parent


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coarse scenes and few functions."""
    for name, value in {"RESOLUTION": 70, "VERTICES": 1500, "K_FINAL": 40, "K_FIXED": 25, "K_INITIAL": 15}.items():
        monkeypatch.setattr(clutter, name, value)


def ball(count: int, radius: float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Surface:
    points = directions(count, seed=0)
    return Surface(radius * points + centre, ConvexHull(points).simplices)


def test_scenes_take_each_class_in_turn(animals: Path) -> None:
    folder = animals / "tosca_r"
    assert clutter.chosen_animals(folder, 2) == [("beast0", "beast1", "other0")] * 2


def test_two_things_are_moved_until_they_touch() -> None:
    ball_points = ball(2000, 1.0).vertices
    apart = clutter.touching(ball_points, ball_points, 0)
    assert apart == pytest.approx(2, abs=0.1)


def test_scene_is_union_of_both_shapes_cut_at_the_plane() -> None:
    stretched = Surface(ball(1500, 1.0).vertices * [2, 0.8, 1], ball(1500, 1.0).triangles)
    scene = clutter.union_and_cut(stretched, ball(1500, 0.5, (9, 9, 9)))
    assert scene.working.component.max() == 0
    # The cut is at 70 % of the extent of 4, from -2; without it 2 would be reached.
    assert scene.vertices[:, 0].max() == pytest.approx(0.8, abs=0.1)
    # The other thing has its area and is beside it, along the axis of the smallest extent.
    assert scene.vertices[:, 1].max() - 0.8 > 1.0


def test_the_potential_is_zero_at_matches_and_one_far_from_them() -> None:
    sphere = ball(800, 1.0)
    pole = int(sphere.vertices[:, 2].argmax())
    values = clutter.potential(sphere, np.array([pole]), 0.3)
    assert values[pole] == 0
    assert values[sphere.vertices[:, 2].argmin()] > 0.99
    # At one standard deviation, 1 - exp(-1/2); paths along edges are a little longer than the arc.
    ring = np.abs(np.arccos(sphere.vertices @ sphere.vertices[pole]) - 0.3) < 0.04
    assert values[ring].mean() == pytest.approx(1 - np.exp(-0.5), abs=0.08)
    assert clutter.potential(sphere, np.array([pole, pole]), 0.3)[ring].max() < values[ring].min()


def test_a_model_is_found_in_its_scene(animals: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scene = clutter.make_scene(animals / "tosca_r", "beast0", "beast1", "other0")
    assert 0.3 < (scene.truth >= 0).mean() < 0.95
    np.testing.assert_array_equal(scene.truth[scene.matches[:, 0]], scene.matches[:, 1])
    methods = {name: clutter.METHODS[name] for name in ("initial, from the matches", "LMH", "PFM", "ZoomOut")}
    monkeypatch.setattr(clutter, "METHODS", methods)
    tables = clutter.run(animals, 1, tmp_path / "scenes.png")
    rows = {row["method"]: row for row in tables["rows"]}
    assert list(rows) == list(methods)
    assert rows["ZoomOut"]["mean"] < 100
    assert rows["ZoomOut"]["covered %"] > rows["LMH"]["covered %"]
    image = matplotlib.image.imread(tmp_path / "scenes.png")[:, :, :3]
    assert (np.ptp(image, axis=2) > 0.3).mean() > 0.01


def test_pictured_model_has_colours_of_the_scene(animals: Path) -> None:
    scene = clutter.make_scene(animals / "tosca_r", "beast0", "beast1", "other0")
    shown = clutter._views(scene, {"zo": np.zeros(len(scene.truth), dtype=int)})
    assert [view.caption for view in shown[1:]] == ["truth", "zo"]
    first, unseen = np.flatnonzero(scene.truth >= 0)[0], scene.truth < 0
    np.testing.assert_array_equal(shown[1].colour[first], shown[0].colour[scene.truth[first]])
    np.testing.assert_array_equal(shown[1].colour[unseen], clutter.GREY)
    np.testing.assert_array_equal(shown[0].colour[~scene.region], clutter.GREY)


def test_a_folder_without_animals_is_refused(tmp_path: Path) -> None:
    refused = CliRunner().invoke(main, ["clutter", "--data", str(tmp_path)])
    assert refused.exit_code == 1
    assert "holds nothing" in refused.output
