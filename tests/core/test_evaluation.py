# SPDX-License-Identifier: GPL-3.0-or-later
"""Quality measures of a map match their definitions, and `zoomout evaluate` prints them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result
from creatures import Creature, creature, true_vertex

import zoomout_core as zo
from zoomout_core.cli import main
from zoomout_core.evaluation import coverage, distance_distortion, edge_distortion, flipped_share
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas


@pytest.fixture(scope="module")
def small() -> Creature:
    return creature(800, seed=0)


@pytest.fixture(scope="module")
def other() -> Creature:
    return creature(700, seed=1, bend=0.9)


def identity(surface: Surface) -> zo.SurfaceMap:
    return zo.SurfaceMap.from_vertices(np.arange(len(surface.vertices)), surface)


def test_errors_of_several_maps_equal_those_of_each(small: Creature, other: Creature) -> None:
    truth = true_vertex(small, other)
    maps = np.column_stack([truth, np.roll(truth, 1), np.zeros_like(truth)])
    known = np.arange(len(truth)), truth
    together = zo.geodesic_error(maps, small.surface, *known)
    for i in range(3):
        np.testing.assert_array_equal(together[:, i], zo.geodesic_error(maps[:, i], small.surface, *known))
    assert (together[:, 0] == 0).all()


def test_geodesic_error_is_edge_path_length_over_root_area() -> None:
    # A strip of four squares of side 2, split by diagonals: area 16, root 4.
    along = np.arange(0.0, 10, 2)
    vertices = np.concatenate([[(x, y, 0) for x in along] for y in (0, 2)])
    strip = zo.Surface(vertices, [(i, i + 1, i + 6, i + 5) for i in range(4)])
    left_below, right_below, left_above, right_above = 0, 4, 5, 9
    images = np.full(10, left_below)
    truth = np.array([left_below, right_below, left_above, right_above])
    error = zo.geodesic_error(images, strip, np.arange(4), truth)
    diagonal = {tuple(sorted(pair)) for face in strip.triangles for pair in zip(face, np.roll(face, 1), strict=True)}
    shortcut = 2 * np.sqrt(2) if (0, 6) in diagonal else 4.0
    np.testing.assert_allclose(error, [0, 8 / 4, 2 / 4, (6 + shortcut) / 4])
    np.testing.assert_allclose(zo.geodesic_error(images, zo.Surface(9 * vertices, strip.triangles), [3], [9]), error[3])


def test_invalid_vertex_numbers_are_refused(small: Creature, other: Creature) -> None:
    truth, every = true_vertex(small, other), np.arange(700)
    with pytest.raises(ValueError, match="target_vertex, which comes before source_vertex, must be vertex numbers"):
        zo.geodesic_error(truth, small.surface, every + 1, truth)
    with pytest.raises(ValueError, match="source_vertex must be vertex numbers from 0"):
        zo.geodesic_error(truth, small.surface, every, truth + len(small.surface.vertices))
    with pytest.raises(ValueError, match="700 target vertices and 699 source vertices"):
        zo.geodesic_error(truth, small.surface, every, truth[1:])


def test_geodesic_error_accepts_a_result_and_a_mesh_path(small: Creature, other: Creature, tmp_path: Path) -> None:
    result = zo.match_by_proximity(small.surface, other.surface)
    truth, every = true_vertex(small, other), np.arange(700)
    errors = zo.geodesic_error(result.surface_map, small.surface, every, truth)
    zo.write_asset(zo.Asset(small.surface), tmp_path / "source.ply")
    of_file = zo.geodesic_error(result, tmp_path / "source.ply", target_vertex=every, source_vertex=truth)
    np.testing.assert_allclose(of_file, errors, atol=1e-6)


def test_identity_has_no_flips_gaps_or_distortion(small: Creature) -> None:
    surface = small.surface
    assert flipped_share(identity(surface), surface, surface) < 0.01
    assert coverage(identity(surface), surface) == pytest.approx(1)
    assert edge_distortion(identity(surface), surface, surface) == 0


def test_distance_distortion_ignores_scale_and_detects_scatter(small: Creature) -> None:
    surface, vertex = small.surface, np.arange(len(small.surface.vertices))
    larger = Surface(3 * surface.vertices, surface.triangles)
    assert distance_distortion(vertex, vertex, surface, larger) == pytest.approx(0, abs=1e-12)
    scattered = np.random.default_rng(0).permutation(vertex)
    apart = zo.geodesic_error(scattered, surface, vertex, vertex)
    assert distance_distortion(scattered, vertex, surface, surface) > apart.mean() / 4


@pytest.mark.parametrize("inside_out", [False, True])
def test_mirror_image_is_flipped_everywhere(small: Creature, inside_out: bool) -> None:
    surface = small.surface
    # The mirror image; its winding makes no difference.
    triangles = surface.triangles if inside_out else surface.triangles[:, ::-1]
    mirror = Surface(surface.vertices * [-1, 1, 1], triangles)
    assert flipped_share(identity(mirror), mirror, surface) > 0.99


def test_flipped_share_is_the_area_of_flipped_triangles(small: Creature) -> None:
    surface = small.surface
    triangle = np.argmax(triangle_areas(surface.vertices, surface.triangles))
    a, b, _ = surface.triangles[triangle]
    vertex = np.arange(len(surface.vertices))
    vertex[[a, b]] = b, a
    around = np.isin(surface.triangles, [a, b]).any(axis=1)
    area = triangle_areas(surface.vertices, surface.triangles)
    share = flipped_share(zo.SurfaceMap.from_vertices(vertex, surface), surface, surface)
    before = flipped_share(identity(surface), surface, surface)
    assert area[triangle] / area.sum() <= share - before <= area[around].sum() / area.sum()


def test_coverage_is_the_area_of_faces_around_images(small: Creature) -> None:
    surface = small.surface
    area = triangle_areas(surface.vertices, surface.triangles)
    at_corner = zo.SurfaceMap.from_vertices(np.full(5, 7), surface)
    inside = zo.SurfaceMap(np.array([3]), np.full((1, 3), 1 / 3), surface.triangles)
    for surface_map, corners in ((at_corner, [7]), (inside, surface.triangles[3])):
        adjoining = np.isin(surface.triangles, corners).any(axis=1)
        assert coverage(surface_map, surface) == pytest.approx(area[adjoining].sum() / area.sum())


def test_edge_distortion_is_one_if_collapsed_and_ignores_scale(small: Creature) -> None:
    surface = small.surface
    collapsed = zo.SurfaceMap.from_vertices(np.zeros(len(surface.vertices), dtype=int), surface)
    assert edge_distortion(collapsed, surface, surface) == pytest.approx(1)
    larger = Surface(1000 * surface.vertices, surface.triangles)
    assert edge_distortion(identity(larger), larger, surface) < 1e-20


@pytest.fixture(scope="module")
def files(small: Creature, other: Creature, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two meshes, the true maps between them, and the true pairs."""
    folder = tmp_path_factory.mktemp("maps")
    for name, shape in (("source", small), ("target", other)):
        mesh = trimesh.Trimesh(shape.surface.vertices, shape.surface.triangles, process=False)
        mesh.export(folder / f"{name}.off", digits=12)
    truth = true_vertex(small, other)
    zo.SurfaceMap.from_vertices(truth, small.surface).save(folder / "map.npz")
    zo.SurfaceMap.from_vertices(true_vertex(other, small), other.surface).save(folder / "back.npz")
    np.savetxt(folder / "truth.txt", np.column_stack([truth, np.arange(len(truth))]), fmt="%d")
    (folder / "beyond.txt").write_text("0 0\n800 1\n")
    (folder / "none.npz").write_text("")
    return folder


def evaluate(folder: Path, map_file: str, *options: str) -> Result:
    named = [str(folder / name) if "." in name else name for name in (map_file, "source.off", "target.off", *options)]
    return CliRunner().invoke(main, ["evaluate", *named])


def test_evaluate_prints_the_available_measures(files: Path) -> None:
    alone = evaluate(files, "map.npz")
    assert alone.exit_code == 0, alone.output
    assert [line.split(":")[0] for line in alone.output.splitlines()] == ["Flipped", "Covered", "Edge distortion"]
    beside = evaluate(files, "map.npz", "--truth", "truth.txt", "--reverse", "back.npz")
    assert beside.exit_code == 0, beside.output
    assert beside.output.startswith(
        "Error at 700 of 700 ground-truth points: mean 0.0, median 0.0, 95th percentile 0.0."
    )
    assert "Round-trip error" in beside.output


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("none.npz",), "contains no map"),
        (("truth.txt",), "contains no map"),
        (("back.npz",), "maps 800 vertices"),
        (("map.npz", "--reverse", "map.npz"), "map.npz"),
        (("map.npz", "--truth", "beyond.txt"), "but 800 is not"),
        (("map.npz", "--truth", "source.off"), "is not a list of ground-truth pairs (line 1)"),
    ],
)
def test_evaluate_reports_mismatches_in_one_sentence(files: Path, arguments: tuple[str, ...], sentence: str) -> None:
    outcome = evaluate(files, *arguments)
    assert outcome.exit_code != 0
    assert outcome.output.startswith("Error: ")
    assert outcome.output.strip().count("\n") == 0
    assert sentence in outcome.output
