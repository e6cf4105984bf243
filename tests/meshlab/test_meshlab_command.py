"""`python -m meshlab_filter` from files to files."""

import subprocess
import sys

import numpy as np
import pymeshlab
import pytest
from click.testing import CliRunner
from creature import SOURCE_POSE, TARGET_POSE, chart_of, creature, rest_of, write_textured_obj

from meshlab_filter.__main__ import main

SIZE = 14.2**0.5


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A textured source with scalars in PLY, another in OBJ, and a target without anything."""
    folder = tmp_path_factory.mktemp("files")
    source, target = creature(0.08, SOURCE_POSE), creature(0.1, TARGET_POSE)
    write_textured_obj(folder, source)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "creature.obj"))
    ms.apply_filter("compute_scalar_by_function_per_vertex", q="vi")
    ms.save_current_mesh(str(folder / "creature.ply"))
    ms.add_mesh(target.mesh())
    ms.save_current_mesh(str(folder / "target.ply"))
    return folder, target


def run(*arguments):
    return CliRunner().invoke(main, ["transfer", *map(str, arguments)])


def check_texture(mesh, target):
    uv = mesh.wedge_tex_coord_matrix()
    error = np.linalg.norm(rest_of(uv) - target.rest[mesh.face_matrix().ravel(), :2], axis=1) / SIZE
    assert error.mean() < 0.03
    upper, _ = chart_of(target.rest[mesh.face_matrix()].mean(axis=1))
    assert np.mean((uv.reshape(-1, 3, 2)[:, :, 0] > 0.5) == upper[:, None]) > 0.9


@pytest.mark.parametrize("name", ["result.ply", "result.obj"])
def test_the_output_has_the_texture_coordinates_and_its_textures_beside_it(files, tmp_path, name):
    folder, target = files
    ran = run(folder / "creature.ply", folder / "target.ply", "-o", tmp_path / name)
    assert ran.exit_code == 0, ran.output
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(tmp_path / name))
    assert ms.current_mesh().vertex_number() == len(target.rest)
    check_texture(ms.current_mesh(), target)
    assert sorted(ms.current_mesh().textures()) == ["back.png", "front.png"]
    assert (tmp_path / "back.png").is_file()
    assert (tmp_path / "front.png").is_file()
    assert ("OBJ cannot hold vertex_scalar" in ran.output) == name.endswith("obj")
    assert "Mean confidence" in ran.output


def test_the_options_of_the_match_are_understood(files, tmp_path):
    folder, target = files
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "creature.obj"))
    places = np.array([[1.9, 0.6, 0.7], [0.7, 2.1, 0.1], [0.4, -1.7, -0.1], [-1.7, 1.5, 0], [-2.3, -0.7, 0.3]])
    source = creature(0.08, SOURCE_POSE)
    ids = [np.argmin(np.linalg.norm(made.rest[:, None] - places, axis=2), axis=0) for made in (source, target)]
    (tmp_path / "pairs.txt").write_text("\n".join(f"{a} {b}" for a, b in zip(*ids, strict=True)))
    options = ["--landmarks", tmp_path / "pairs.txt", "--detail", "fast", "--seed", "3"]
    ran = run(folder / "creature.obj", folder / "target.ply", "-o", tmp_path / "a.ply", *options)
    assert ran.exit_code == 0, ran.output
    ms.load_new_mesh(str(tmp_path / "a.ply"))
    check_texture(ms.current_mesh(), target)


@pytest.mark.parametrize(
    ("source", "target", "output", "sentence"),
    [
        ("creature.obj", "target.ply", "a.stl", "choose .ply or .obj"),
        ("creature.obj", "target.ply", "nowhere/a.ply", "no folder"),
        ("nothing.obj", "target.ply", "a.ply", "nothing.obj could not be read"),
        ("creature.obj", "creature.mtl", "a.ply", "creature.mtl could not be read"),
        ("target.ply", "creature.obj", "a.ply", "none of the attributes"),
    ],
)
def test_an_error_is_one_sentence_and_nothing_is_written(files, tmp_path, source, target, output, sentence):
    folder, _ = files
    ran = run(folder / source, folder / target, "-o", tmp_path / output)
    assert ran.exit_code == 1
    (line,) = [line for line in ran.output.splitlines() if line.startswith("Error:")]
    assert sentence in line
    assert list(tmp_path.iterdir()) == []


def test_it_runs_as_a_module():
    ran = subprocess.run(
        [sys.executable, "-m", "meshlab_filter", "transfer", "--help"], check=True, capture_output=True, text=True
    )
    assert "python -m meshlab_filter transfer" in ran.stdout
