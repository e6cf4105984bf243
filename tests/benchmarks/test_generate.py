# SPDX-License-Identifier: GPL-3.0-or-later
"""Recorded correspondences of generated sets are right for all proportions, poses and meshes."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree
from typing import NamedTuple

import bpy  # noqa: F401  before pymeshlab, after which it could not be imported
import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from creatures import creature
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from benchmarks.datasets import load_pair, pair_names
from benchmarks.generate import characters
from benchmarks.generate.__main__ import main
from benchmarks.generate.bodies import (
    PosedMesh,
    Template,
    build_template,
    draw_individual,
    draw_pose,
    is_ball,
    posed_mesh,
)
from benchmarks.generate.folder import standing_for, write_set
from benchmarks.generate.kinds import KINDS
from benchmarks.generate.partial import CHANGES, write_partial
from benchmarks.generate.remeshed import write_remeshed
from benchmarks.generate.remeshing import REMESHINGS
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, unique_edges

pytestmark = pytest.mark.slow


class People(NamedTuple):
    template: Template
    naked: PosedMesh
    dressed: PosedMesh


@pytest.fixture(scope="module")
def people() -> People:
    """Two individuals of a coarse biped, one pose each."""
    template = build_template(KINDS["biped"], cell=0.02)
    random = np.random.default_rng(1)
    individuals = [draw_individual(template, random, 1.0, dressed) for dressed in (False, True)]
    return People(template, *(posed_mesh(template, individual, random) for individual in individuals))


@pytest.fixture(scope="module")
def partial(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set with every kind of change to one shape."""
    folder = tmp_path_factory.mktemp("partial")
    copytree(data / "creatures", folder / "whole")
    (folder / "whole" / "pairs.txt").write_text("a b\n" * len(CHANGES))
    write_partial(folder / "changed", [folder / "whole"], 0, len(CHANGES))
    return folder / "changed"


def alike(first: Surface, first_vertices: np.ndarray, second: Surface, second_vertices: np.ndarray) -> float:
    """Correlation of geodesic distances between corresponding vertices of two surfaces."""
    picked = np.linspace(0, len(first_vertices) - 1, 60).astype(int)
    distances = [
        dijkstra(edge_graph(mesh.vertices, mesh.triangles), indices=vertices[picked])[:, vertices[picked]].ravel()
        for mesh, vertices in ((first, first_vertices), (second, second_vertices))
    ]
    return float(np.corrcoef(distances)[0, 1])


def borders(surface: Surface) -> int:
    """The number of boundary loops of a connected surface without handles."""
    edges, _ = unique_edges(surface.triangles)
    return 2 - (len(surface.vertices) - len(edges) + len(surface.triangles))


def test_character_is_one_closed_body_with_eyes_and_clothes(people):
    sizes = [np.bincount(mesh.surface.components) for mesh in (people.naked, people.dressed)]
    assert len(sizes[0]) == 3
    assert len(sizes[1]) >= 5
    assert sizes[0][0] != sizes[1][0]
    for mesh, size in zip((people.naked, people.dressed), sizes, strict=True):
        assert 3000 < size[0] < 9000
        body = mesh.surface.triangles[mesh.surface.components[mesh.surface.triangles[:, 0]] == 0]
        assert is_ball(Surface(mesh.surface.vertices, body))


def test_places_and_mirror_images_correspond_across_poses(people):
    naked, dressed = people.naked, people.dressed
    known = (naked.places >= 0) & (dressed.places >= 0) & (dressed.mirrored >= 0)
    assert known.mean() > 0.9
    first = naked.surface, naked.places[known]
    assert alike(*first, dressed.surface, dressed.places[known]) > 0.97
    assert alike(*first, dressed.surface, dressed.mirrored[known]) > 0.97
    assert alike(*first, dressed.surface, np.roll(dressed.places[known], known.sum() // 2)) < 0.5


def test_the_mirror_image_of_a_place_is_the_place_of_the_mirror_image(people):
    rest, mesh = people.template.surface.vertices, people.naked
    opposite = cKDTree(rest).query(rest * (-1, 1, 1))[1]
    known = (mesh.mirrored >= 0) & (mesh.places[opposite] >= 0)
    points = mesh.surface.vertices
    off = np.linalg.norm(points[mesh.mirrored] - points[mesh.places[opposite]], axis=1)[known]
    assert np.quantile(off, 0.99) < 0.05
    across = np.linalg.norm(points[mesh.mirrored] - points[mesh.places], axis=1)
    assert across[known & (np.abs(rest[:, 0]) > 0.5)].min() > 0.3


def test_builds_are_symmetric_reproducible_and_exaggerated(people):
    modest, same, stylised = (
        draw_individual(people.template, np.random.default_rng(5), exaggeration, False) for exaggeration in (1, 1, 2)
    )
    assert modest.traits.std() > 0.05
    assert (modest.traits == same.traits).all()
    assert np.allclose(stylised.traits, 2 * modest.traits)
    assert modest.scale["thigh.L"] == modest.scale["thigh.R"]


@pytest.mark.parametrize("name", KINDS)
def test_poses_stay_in_reach_and_differ_between_the_sides(name):
    kind = KINDS[name]
    bones = {row.name for row in kind.bones}
    assert set(kind.reach) <= bones
    pose = draw_pose(kind, np.random.default_rng(0))
    assert max(abs(angle) for angles in pose.values() for angle in angles) > 20
    for bone, reach in kind.reach.items():
        for side in {bone, bone.replace(".L", ".R")}:
            x, y, z = pose[side]
            angles = (x, -y, -z) if side.endswith(".R") else (x, y, z)
            assert all(low <= angle <= high for angle, (low, high) in zip(angles, reach, strict=True))
        if bone.endswith(".L"):
            assert pose[bone] != pose[bone.replace(".L", ".R")]


def test_is_ball_requires_one_closed_piece_without_handles():
    ball = trimesh.creation.icosphere(1)
    torus = trimesh.creation.torus(1.0, 0.3)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation([5, 0, 0])])
    assert is_ball(Surface(ball.vertices, ball.faces))
    for other in (torus, two):
        assert not is_ball(Surface(other.vertices, other.faces))
    assert not is_ball(Surface(ball.vertices, ball.faces[1:]))


def test_a_set_of_characters_is_read_by_the_benchmark(tmp_path, monkeypatch):
    monkeypatch.setattr(characters, "POSES", "a")
    characters.write_characters(tmp_path, 3, 1, ["hand"])
    ((target, source), (again, _)) = pair_names(tmp_path, None)
    assert target.split("_")[0] == "hand"
    assert again == source
    pair = load_pair(tmp_path, target, source)
    assert len(pair.target.vertices) != len(pair.source.vertices)
    assert alike(pair.target, pair.target_vertex, pair.source, pair.source_vertex) > 0.97
    assert pair.mirrored_vertex is None


def test_stylised_pairs_are_those_of_the_most_different_builds(people):
    random = np.random.default_rng(1)
    cast = {f"biped_{i}": draw_individual(people.template, random, 1.0, False) for i in range(4)}
    difference = [np.linalg.norm(cast[a[:-1]].traits - cast[b[:-1]].traits) for a, b in characters.all_pairs(cast)]
    assert difference == sorted(difference, reverse=True)
    assert len(difference) == 6 * len(characters.POSES) ** 2


def test_remeshed_shape_keeps_surface_and_correspondence(tmp_path):
    meshes = {f"beast{i}": creature(3000, seed=0, bend=0.5 * i).surface for i in range(2)}
    write_set(tmp_path / "data", meshes, {}, [])
    write_remeshed(tmp_path / "set", [tmp_path / "data"], 0, 100)
    pairs = pair_names(tmp_path / "set", None)
    assert len(pairs) == 2 * 2 * 2 * len(REMESHINGS)
    for name, mesh in meshes.items():
        for how in REMESHINGS:
            pair = load_pair(tmp_path / "set", f"{name}_{how}", name)
            assert 0.2 < len(pair.target.vertices) / len(mesh.vertices) < 0.5
            offset = pair.target.vertices[pair.target_vertex] - pair.source.vertices[pair.source_vertex]
            assert np.linalg.norm(offset, axis=1).max() < 0.04 * np.sqrt(mesh.area)
    mates = load_pair(tmp_path / "set", "beast0_isotropic", "beast1")
    assert alike(mates.target, mates.target_vertex, mates.source, mates.source_vertex) > 0.97


@pytest.mark.parametrize("change", CHANGES)
def test_unchanged_part_stays_and_changed_part_is_marked(change, data, partial):
    name = f"a_b_{change}"
    pair = load_pair(partial, name, f"{name}_whole")
    with np.load(partial / "partial.npz") as alone:
        gained, lost = alone[name], alone[f"{name}_whole"]
    original = load_pair(data / "creatures", "a", "b")
    away = cKDTree(original.target.vertices).query(pair.target.vertices)[0]
    assert away[~gained].max() < 1e-5
    assert not gained.any() or away[gained].max() > 0.1
    assert not gained[pair.target_vertex].any()
    assert not lost[pair.source_vertex].any()
    known = {tuple(pair) for pair in np.stack([original.target_vertex, original.source_vertex], axis=1).tolist()}
    before = cKDTree(original.target.vertices).query(pair.target.vertices[pair.target_vertex])[1]
    assert {(int(a), int(b)) for a, b in zip(before, pair.source_vertex, strict=True)} <= known


@pytest.mark.parametrize("change", ["limb", "end"])
def test_severed_limb_leaves_one_border_and_is_marked(change, partial):
    pair = load_pair(partial, f"a_b_{change}", f"a_b_{change}_whole")
    assert pair.target.components.max() == 0
    assert borders(pair.target) == 1
    with np.load(partial / "partial.npz") as alone:
        assert 0 < alone[f"a_b_{change}_whole"].mean() < 0.4


@pytest.mark.parametrize("change", ["tail", "horns"])
def test_grown_part_keeps_mesh_closed_and_is_marked(change, partial):
    pair = load_pair(partial, f"a_b_{change}", f"a_b_{change}_whole")
    assert is_ball(pair.target)
    with np.load(partial / "partial.npz") as alone:
        assert alone[f"a_b_{change}"].mean() > 0.02


def test_holes_are_open(partial):
    assert borders(load_pair(partial, "a_b_holes", "a_b_holes_whole").target) > 2


def test_places_stay_on_their_side_of_a_thin_sheet():
    box = trimesh.creation.box((1, 1, 0.002)).subdivide().subdivide().subdivide()
    mesh = Surface(box.vertices, box.faces)
    top = np.abs(box.vertices[:, :2]).max(axis=1) < 0.45
    top &= box.vertices[:, 2] > 0
    up = np.tile((0, 0, 1.0), (top.sum(), 1))
    # Nearer to the lower side than to the upper.
    found = standing_for(box.vertices[top] - 0.0018 * up, up, mesh)
    assert (found == np.flatnonzero(top)).all()
    assert (standing_for(box.vertices[top] + 3 * up, up, mesh) == -1).all()


def test_command_requires_source_meshes(tmp_path):
    outcome = CliRunner().invoke(main, ["partial", "--output", str(tmp_path)])
    assert outcome.exit_code != 0
    assert "--data" in outcome.output
