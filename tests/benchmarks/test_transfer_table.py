# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of transfers: sources with all kinds of data, targets with a known truth, and their figures."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import write_off
from creatures import creature

from benchmarks import transfer
from benchmarks.transfer import cases, methods, regions
from zoomout_core.mesh.triangles import unique_edges

pytestmark = pytest.mark.slow

WAYS = ("true map", "proximity, aligned", "Data Transfer, aligned", "MeshLab")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict]]:
    data = tmp_path_factory.mktemp("data")
    (data / "faust_r").mkdir()
    write_off(data / "faust_r" / "creature.off", creature(600, 0).surface)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cases, "CELL", 0.07)
        patch.setattr(cases, "ISLANDS", 6)
        patch.setattr(transfer, "WAYS", {name: methods.WAYS[name] for name in WAYS})
        return transfer.run(data, None)


def test_every_method_is_measured_in_both_poses(tables: dict[str, list[dict]]) -> None:
    assert {(row["shape"], row["pose"], row["way"]) for row in tables["pairs"]} == {
        (shape, pose, way) for shape in ("character", "creature") for pose in ("same", "other") for way in WAYS
    }
    assert all(row["shapes"] == 2 for row in tables["rows"])


def test_true_map_leaves_only_discretisation_error(tables: dict[str, list[dict]]) -> None:
    for row in tables["pairs"]:
        if row["way"] == "true map":
            assert row["uv median"] < 1e-3
            assert row["weights"] < 1e-3
            assert row["not 1"] == 0
            assert row["color"] < 1e-3
            assert row["materials"] > 0.9
            # Where limbs bend, a coarse mesh does not tell by how much; offsets taken as they are err by 0.6.
            posed = {"character": 0.1, "creature": 0.4}[row["shape"]]
            assert row["keys"] < (0.05 if row["pose"] == "same" else posed)


def test_spatial_methods_work_only_in_the_same_pose(tables: dict[str, list[dict]]) -> None:
    rows = {(row["pose"], row["way"]): row for row in tables["rows"]}
    for way in ("proximity, aligned", "Data Transfer, aligned", "MeshLab"):
        assert rows["same", way]["weights"] < 0.1 < rows["other", way]["weights"]
    assert rows["same", "MeshLab"]["color"] < rows["other", "MeshLab"]["color"]
    assert rows["same", "MeshLab"]["uv median"] is None


def test_seams_cut_every_region_into_a_disc() -> None:
    surface = creature(600, 0).surface
    vertices, triangles = surface.vertices, surface.triangles
    region = regions.faces_of(regions.regions(vertices, triangles, 8), triangles)
    seam = regions.islands(vertices, triangles, region)
    _, edge_of = unique_edges(triangles)
    for number in range(8):
        inside = triangles[region == number]
        opened = seam[edge_of[region == number]]
        # Cut open, edges on a seam count once for each side; so do corners, once for each fan between seams.
        edge_count = len(np.unique(edge_of[region == number][~opened])) + opened.sum()
        assert _fans(inside, opened) - edge_count + len(inside) == 1


def _fans(triangles: np.ndarray, opened: np.ndarray) -> int:
    """The number of corners after joining triangles at the sides that are not cut."""
    parent = np.arange(triangles.size).reshape(triangles.shape)
    at: dict[tuple[int, int], tuple[int, int]] = {}
    for i, row in enumerate(triangles.tolist()):
        for side in range(3):
            if not opened[i, side]:
                a, b = row[side], row[(side + 1) % 3]
                if (b, a) in at:
                    j, other = at[b, a]
                    for mine, theirs in (
                        (parent[i, side], parent[j, (other + 1) % 3]),
                        (parent[i, (side + 1) % 3], parent[j, other]),
                    ):
                        parent[parent == mine] = theirs
                at[a, b] = (i, side)
    return len(np.unique(parent))


def test_rigid_motion_is_recovered() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    motion = cases.rigid_motion(points, points @ turn.T + [1, 2, 3])
    np.testing.assert_allclose(motion[:3, :3], turn, atol=1e-9)
    np.testing.assert_allclose(motion[:3, 3], [1, 2, 3], atol=1e-9)
