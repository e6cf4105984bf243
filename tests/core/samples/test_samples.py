# SPDX-License-Identifier: GPL-3.0-or-later
"""The sample meshes are complete and differ only in pose and triangulation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import zoomout_core as zo
from zoomout_core import samples
from zoomout_core.cli import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("samples") / "new"
    done = CliRunner().invoke(main, ["sample", str(place), "--json"], catch_exceptions=False)
    assert [Path(name).name for name in json.loads(done.output)["files"]] == ["character.glb", "scan.ply", "truth.txt"]
    return place


def test_character_has_materials_skin_and_animation(folder: Path) -> None:
    found = zo.read_asset(folder / "character.glb")
    assert {each.name for each in found.attributes} == {"uv 0", "color 0", "normals", "materials"}
    assert [material.name for material in found.materials] == ["Body", "Limbs"]
    assert found.skin is not None
    assert found.skin.names == ("Body", *samples.NAMES)
    np.testing.assert_allclose(found.skin.rest, found.surface.vertices, atol=1e-6)
    for number, name in enumerate(samples.NAMES, start=1):
        tip = samples.UPRIGHT @ samples.LIMBS[number - 1]
        farthest = (found.surface.vertices @ tip).argmax()
        assert found.skin.weights.toarray()[farthest].argmax() == number, name
    assert found.document is not None
    assert [each.name for each in found.document.gltf.animations] == ["Wave"]


def test_limbs_are_sampled_by_area_and_uvs_continue_across_the_seam(folder: Path) -> None:
    made = samples.scan()
    limb = samples.limb_weights(made.directions)[:, 0] < 0.5
    assert limb.mean() == pytest.approx(made.surface.share_of_area(limb), rel=0.2)
    found = zo.read_asset(folder / "character.glb").find("uv 0")
    assert found is not None
    across = np.ptp(np.asarray(found.values).reshape(-1, 3, 2)[:, :, 0], axis=1)
    assert (across > 0.5).sum() <= 4  # at the poles, where all longitudes meet


def test_truth_file_pairs_corresponding_vertices(folder: Path) -> None:
    pairs = np.loadtxt(folder / "truth.txt", dtype=int)
    source, target = zo.read_surface(folder / "character.glb"), zo.read_surface(folder / "scan.ply")
    assert len(pairs) > 300
    # The body does not move, so corresponding points are close.
    body = np.flatnonzero(samples.limb_weights(samples.scan().directions)[pairs[:, 1], 0] > 0.999)
    apart = np.linalg.norm(source.vertices[pairs[body, 0]] - target.vertices[pairs[body, 1]], axis=1)
    assert len(body) > 50
    assert np.quantile(apart, 0.99) < 0.15
    # The limbs move.
    assert np.linalg.norm(source.vertices[pairs[:, 0]] - target.vertices[pairs[:, 1]], axis=1).max() > 1


def test_folder_that_cannot_be_created_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = CliRunner().invoke(main, ["sample", str(tmp_path / "file" / "in")])
    assert done.exit_code == 1
    assert done.output.startswith("Error: ")
