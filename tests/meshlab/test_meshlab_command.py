# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m meshlab_filter`, which reads and writes files."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pymeshlab
import pytest
from click.testing import CliRunner
from creature import SOURCE_POSE, TARGET_POSE, chart_of, creature, rest_of, write_textured_obj
from PIL import Image

import zoomout_core
from meshlab_filter.catalogue import CATALOGUE
from meshlab_filter.commands import main
from meshlab_filter.filters import matches
from zoomout_core.assets.asset import Asset, Material, material_numbers
from zoomout_core.assets.files import write_asset
from zoomout_core.matching.report.verdict import judge
from zoomout_core.messages import message, warning

pytestmark = pytest.mark.usefixtures("remember_matches")

SIZE = 14.2**0.5


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A textured source with scalars in PLY, another in OBJ, and a target without data."""
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
def test_output_has_texture_coordinates_and_textures(files, tmp_path, name):
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
    assert ("OBJ files cannot store vertex_scalar" in ran.output) == name.endswith("obj")
    assert "Mean confidence" in ran.output
    assert "Without a partner: " in ran.output


def test_a_match_that_is_probably_wrong_is_written_only_by_force(files, tmp_path, monkeypatch):
    monkeypatch.setattr(matches, "notes_on_parts", lambda *_: (message("Parts."), warning("One is silent.")))
    monkeypatch.setattr(zoomout_core.MatchResult, "verdict", judge(0.1))
    folder, _ = files
    arguments = folder / "creature.ply", folder / "target.ply", "-o", tmp_path / "result.ply"
    ran = run(*arguments)
    assert ran.exit_code == 1
    assert "give --force" in ran.output
    assert not (tmp_path / "result.ply").exists()
    ran = run(*arguments, "--force")
    assert ran.exit_code == 0, ran.output
    assert "Red: The match is probably wrong" in ran.output
    assert "\nWarning: One is silent.\n" in ran.output
    assert "\nParts.\n" in ran.output


@pytest.mark.slow
def test_match_accepts_landmarks_detail_and_seed(files, tmp_path):
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
        ("nothing.obj", "target.ply", "a.ply", "nothing.obj: check the path"),
        ("creature.obj", "creature.mtl", "a.ply", "creature.mtl could not be read"),
        ("target.ply", "creature.obj", "a.ply", "none of the attributes"),
        ("creature.obj", "target.ply", "nowhere/out", "no folder"),
        ("nothing.obj", "target.ply", "out", "nothing.obj: check the path"),
    ],
)
def test_an_error_is_one_sentence_and_nothing_is_written(files, tmp_path, source, target, output, sentence):
    folder, _ = files
    ran = run(folder / source, folder / target, "-o", tmp_path / output)
    assert ran.exit_code == 1
    (line,) = [line for line in ran.output.splitlines() if line.startswith("Error:")]
    assert sentence in line
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def scans(files, tmp_path):
    """A folder of two targets, a file that is not a mesh, and notes."""
    folder, _ = files
    scans = tmp_path / "scans"
    scans.mkdir()
    shutil.copy(folder / "target.ply", scans / "first.ply")
    ms = pymeshlab.MeshSet()
    ms.add_mesh(creature(0.12, TARGET_POSE).mesh())
    ms.save_current_mesh(str(scans / "second.off"))
    (scans / "broken.ply").write_text("ply\nformat ascii 1.0\n")
    (scans / "notes.txt").write_text("to do")
    return scans


def test_failed_target_does_not_stop_the_batch(files, scans, tmp_path, monkeypatch):
    folder, target = files
    monkeypatch.chdir(tmp_path)  # relative names still mean the same after a file that cannot be read
    out = Path("out")
    ran = run(folder / "creature.ply", "scans", "-o", out, "--detail", "fast")
    assert ran.exit_code == 3
    images = {"back.png", "front.png"}
    assert {path.name for path in out.iterdir()} == {"first.ply", "second.ply", "report.json", *images}
    for name, made in (("first.ply", target), ("second.ply", creature(0.12, TARGET_POSE))):
        ms = pymeshlab.MeshSet()
        ms.load_new_mesh(str(out / name))
        check_texture(ms.current_mesh(), made)
        assert set(ms.current_mesh().textures()) == images
    assert "2 of 3 targets written" in ran.output
    assert "3/3 Transferring" in ran.stderr
    (failure,) = [line for line in ran.stderr.splitlines() if "failed." in line]
    assert failure.startswith(f"{Path('scans', 'broken.ply')}: failed. ")
    broken, first, second = json.loads((out / "report.json").read_text())["targets"]
    assert (set(broken), broken["status"]) == ({"target", "status", "error"}, "failed")
    assert "could not be read" in broken["error"]
    assert first["output"] == str(out / "first.ply")
    assert 0 < second["mean_confidence"] <= 1
    assert 0 <= second["share_without_partner"] <= 1
    assert 0 <= second["source_share_without_partner"] <= 1
    assert "texcoord" in second["transferred"]


def test_notes_name_source_parts_by_their_materials(tmp_path):
    made = creature(0.14, SOURCE_POSE)
    body = zoomout_core.Surface(made.vertices, made.faces)
    lump = zoomout_core.Surface(body.vertices * 0.3 + body.vertices[body.vertices[:, 2].argmax()], body.triangles)
    left = body.vertices[body.triangles].mean(axis=1)[:, 0] > body.vertices[:, 0].mean()
    number = np.concatenate([left, np.full(len(left), 2)])
    colors = ((1.0, 0, 0, 1), (0, 1.0, 0, 1), (0, 0, 1.0, 1))
    materials = tuple(map(Material, ("Skin", "Shirt", "Hat"), colors))
    both = Asset(zoomout_core.Surface.joined([body, lump]), (material_numbers(number),), materials)
    write_asset(both, tmp_path / "source.obj")
    write_asset(Asset(body), tmp_path / "target.ply")
    ran = run(tmp_path / "source.obj", tmp_path / "target.ply", "-o", tmp_path / "out.ply", "--detail", "fast")
    assert ran.exit_code == 0, ran.output
    assert "Share of the target's area by part of the source: 'S" in ran.output
    assert "Almost nothing arrives from 'Hat'." in ran.output


def test_batch_fails_if_every_target_fails(files, scans, tmp_path):
    folder, _ = files
    ran = run(folder / "creature.ply", scans / "broken.ply", scans / "notes.txt", "-o", tmp_path / "out")
    assert ran.exit_code == 1
    assert "0 of 2 targets written" in ran.output
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["report.json"]


def test_the_format_of_the_files_in_a_folder_can_be_chosen(files, tmp_path):
    folder, target = files
    out = tmp_path / "out"
    ran = run(folder / "creature.obj", folder / "target.ply", "-o", out, "--format", "obj", "--detail", "fast")
    assert ran.exit_code == 0, ran.output
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(out / "target.obj"))
    check_texture(ms.current_mesh(), target)


@pytest.mark.slow
def test_different_textures_of_one_name_do_not_overwrite_each_other(tmp_path):
    """The source has colours only, so each target keeps its textures."""
    ms = pymeshlab.MeshSet()
    made = creature(0.15, SOURCE_POSE)
    ms.add_mesh(made.mesh(v_color_matrix=np.column_stack([0.5 + made.rest / 6, np.ones(len(made.rest))])))
    ms.save_current_mesh(str(tmp_path / "source.ply"))
    targets = []
    for name in ("one", "other"):
        folder = tmp_path / name
        folder.mkdir()
        write_textured_obj(folder, creature(0.17, TARGET_POSE))
        (folder / "creature.obj").rename(folder / f"{name}.obj")
        targets.append(folder / f"{name}.obj")
    out = tmp_path / "out"
    ran = run(tmp_path / "source.ply", *targets, "-o", out, "--detail", "fast")
    assert ran.exit_code == 0, ran.output
    Image.new("RGB", (32, 16), "red").save(tmp_path / "other" / "back.png")
    ran = run(tmp_path / "source.ply", *targets, "-o", tmp_path / "again", "--detail", "fast")
    assert ran.exit_code == 3
    assert "different texture back.png" in ran.stderr
    assert (tmp_path / "again" / "back.png").read_bytes() == (out / "back.png").read_bytes()
    assert not (tmp_path / "again" / "other.ply").exists()


@pytest.mark.parametrize(
    ("targets", "output", "sentence"),
    [
        (["scans"], "a.ply", "one file for 3 targets"),
        (["scans/first.ply", "again/first.obj"], "out", "would both be written to"),
        (["scans/first.ply"], "scans", "could overwrite it"),
        (["again"], "out", "contains no meshes: check"),
    ],
)
def test_unwritable_output_is_refused_before_matching(files, scans, tmp_path, targets, output, sentence):
    folder, _ = files
    (tmp_path / "again").mkdir()
    before = sorted(tmp_path.rglob("*"))
    ran = run(folder / "creature.ply", *(tmp_path / target for target in targets), "-o", tmp_path / output)
    assert ran.exit_code == 1
    assert sentence in ran.output
    assert "%" not in ran.output
    assert sorted(tmp_path.rglob("*")) == before


def test_filters_are_listed_searched_and_described():
    listed = CliRunner().invoke(main, ["list"])
    assert [line.partition(":")[0] for line in listed.output.splitlines()] == list(CATALOGUE)
    found = CliRunner().invoke(main, ["search", "Holes", "close"])
    assert found.output == "meshing_close_holes\n"
    none = CliRunner().invoke(main, ["search", "nothing-like-it"])
    assert none.exit_code == 1
    assert none.output == "Error: No filter name contains nothing-like-it: try other words, or fewer.\n"
    described = CliRunner().invoke(main, ["describe", "compute_laplacian_eigenfunctions"])
    assert described.output.startswith(CATALOGUE["compute_laplacian_eigenfunctions"].meaning)
    assert "functions : int = 20" in described.output
    assert CliRunner().invoke(main, ["describe", "nothing"]).exit_code == 1


def test_samples_require_an_empty_folder(tmp_path):
    (tmp_path / "character.obj").write_text("mine")
    ran = CliRunner().invoke(main, ["samples", str(tmp_path)])
    assert ran.exit_code == 1
    assert ran.output == f"Error: {tmp_path} is not empty: give a new folder.\n"
    assert [path.name for path in tmp_path.iterdir()] == ["character.obj"]


def test_it_runs_as_a_module():
    ran = subprocess.run(
        [sys.executable, "-m", "meshlab_filter", "--version"], check=True, capture_output=True, text=True
    )
    assert ran.stdout == f"python -m meshlab_filter, version {zoomout_core.__version__}\n"
