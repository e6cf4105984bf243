# SPDX-License-Identifier: GPL-3.0-or-later
"""Projects of MeshLab's desktop program, and a watched folder that it saves to."""

import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pymeshlab
import pytest
from click.testing import CliRunner
from creature import SOURCE_POSE, TARGET_POSE, creature, write_textured_obj

from meshlab_filter.commands import main
from meshlab_filter.project import ProjectMesh, read_project, write_project
from meshlab_filter.script import read_script
from meshlab_filter.trial import fault_of_file
from meshlab_filter.watch import Watch, watch

pytestmark = pytest.mark.usefixtures("remember_matches")

# As MeshLab 2022.02 saves it: two meshes, of which the second stands aside.
DESKTOP = Path(__file__).with_name("desktop.mlp")
ASIDE = np.array([[1, 0, 0, 5.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
MERGE = '<!DOCTYPE FilterScript><FilterScript><filter name="generate_by_merging_visible_meshes"/></FilterScript>'
PLAIN = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
)
PLAIN += "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def run(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Files saved by the desktop program: a textured character, its retopology, and the project."""
    folder = tmp_path_factory.mktemp("saved")
    write_textured_obj(folder, creature(0.15, SOURCE_POSE))
    (folder / "creature.obj").rename(folder / "character.obj")
    ms = pymeshlab.MeshSet()
    ms.add_mesh(creature(0.17, TARGET_POSE).mesh())
    ms.save_current_mesh(str(folder / "retopology.ply"))
    shutil.copy(DESKTOP, folder / "desktop.mlp")
    return folder


@pytest.fixture
def folder(saved, tmp_path):
    shutil.copytree(saved, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_a_project_of_the_desktop_program_is_read(tmp_path):
    shutil.copy(DESKTOP, tmp_path)
    first, second = read_project(tmp_path / "desktop.mlp")
    assert (first.label, first.path) == ("character.obj", tmp_path / "character.obj")
    assert (second.label, second.path) == ("retopology.ply", tmp_path / "retopology.ply")
    np.testing.assert_array_equal(first.transform, np.eye(4))
    np.testing.assert_array_equal(second.transform, ASIDE)
    assert first.visible


def test_project_round_trip_opens_in_meshlab(folder):
    meshes = [
        ProjectMesh('the "first" & best', folder / "retopology.ply", ASIDE / 3 + np.eye(4), visible=False),
        ProjectMesh("character", folder / "character.obj", np.eye(4)),
    ]
    write_project(folder / "own.mlp", meshes)
    for read, written in zip(read_project(folder / "own.mlp"), meshes, strict=True):
        assert (read.label, read.path, read.visible) == (written.label, written.path, written.visible)
        np.testing.assert_array_equal(read.transform, written.transform)
    ms = pymeshlab.MeshSet()
    ms.load_project(str(folder / "own.mlp"))
    assert [mesh.label() for mesh in ms] == [mesh.label for mesh in meshes]
    np.testing.assert_allclose(ms.mesh(0).transform_matrix(), meshes[0].transform, atol=1e-6)


def test_moved_project_finds_meshes_beside_it(folder):
    """MeshLab 2022 writes paths relative to the former folder."""
    text = (folder / "desktop.mlp").read_text().replace('filename="', 'filename="characters/')
    (folder / "desktop.mlp").write_text(text)
    assert [mesh.path for mesh in read_project(folder / "desktop.mlp")] == [
        folder / "character.obj",
        folder / "retopology.ply",
    ]
    (folder / "character.obj").unlink()
    assert read_project(folder / "desktop.mlp")[0].path == folder / "characters" / "character.obj"


def test_a_script_runs_on_the_meshes_of_a_project_as_they_are_placed(folder):
    (folder / "merge.mlx").write_text(MERGE)
    ran = run("run", folder / "merge.mlx", folder / "desktop.mlp", "-o", folder / "merged.ply")
    assert ran.exit_code == 0, ran.output
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "merged.ply"))
    source, target = creature(0.15, SOURCE_POSE).vertices, creature(0.17, TARGET_POSE).vertices + ASIDE[:3, 3]
    np.testing.assert_allclose(ms.current_mesh().vertex_matrix(), np.vstack([source, target]), atol=1e-5)
    before = (folder / "retopology.ply").read_bytes()
    ran = run("run", folder / "merge.mlx", folder / "desktop.mlp", "-o", folder / "retopology.ply")
    assert ran.exit_code == 1
    assert "is an input, and would be overwritten" in ran.output
    assert (folder / "retopology.ply").read_bytes() == before


ENTITIES = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("not valid XML", "Line 1 of .* is not valid XML: "),
        ("", "Line 1 of .* is not valid XML: no element found"),
        ("<FilterScript/>", "Line 1 of .* has a FilterScript instead of a MeshLabProject: give a .mlp file"),
        ("<MeshLabProject><MeshGroup/></MeshLabProject>", "has no mesh: add one and save it again"),
        ("<MeshLabProject><MeshGroup>\n<MLMesh label='new'/></MeshGroup></MeshLabProject>", "Line 2 .* 'new' has no"),
        (
            "<MeshLabProject><MeshGroup><MLMesh filename='a.ply'><MLMatrix44>1 2</MLMatrix44></MLMesh></MeshGroup>"
            "</MeshLabProject>",
            "'a.ply' has an invalid matrix",
        ),
        (f'<!DOCTYPE a [<!ENTITY e0 "ha">{ENTITIES}]><MeshLabProject>&e9;</MeshLabProject>', "declares the entity e0"),
        ('<!DOCTYPE a [<!ENTITY f SYSTEM "file:///etc/passwd">]><MeshLabProject/>', "declares the entity f: remove it"),
    ],
)
def test_invalid_project_is_refused_in_a_sentence(tmp_path, text, sentence):
    path = tmp_path / "broken.mlp"
    path.write_text(text)
    with pytest.raises(ValueError, match=sentence) as refusal:
        read_project(path)
    assert "\n" not in str(refusal.value)


def test_a_script_that_declares_entities_is_refused(tmp_path):
    path = tmp_path / "bomb.mlx"
    path.write_text(f'<!DOCTYPE FilterScript [<!ENTITY e0 "ha">{ENTITIES}]><FilterScript>&e9;</FilterScript>')
    with pytest.raises(ValueError, match="declares the entity e0"):
        read_script(path)


# --- watching -----------------------------------------------------------------------------------------------


def test_saved_project_is_processed_once(folder):
    ran = run("watch", folder, "--once", "--interval", 0.1, "--detail", "fast")
    assert ran.exit_code == 0, ran.output
    assert "desktop.mlp was saved." in ran.stdout
    assert "retopology_zoomout.ply: Transferred: texcoord." in ran.stdout
    source, target, made = read_project(folder / "desktop_zoomout.mlp")
    assert (source.visible, target.visible, made.visible) == (True, False, True)
    np.testing.assert_array_equal(made.transform, ASIDE)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(made.path))
    assert ms.current_mesh().has_wedge_tex_coord()
    assert set(ms.current_mesh().textures()) == {"front.png", "back.png"}
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    again = run("watch", folder, "--once", "--interval", 0.1)
    assert (again.exit_code, again.stdout) == (0, "")
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


@pytest.fixture
def looks(tmp_path):
    """A folder watched for a script, checked by `next`, and the list of inputs that would be processed."""
    (tmp_path / "merge.mlx").write_text(MERGE)
    worked = []
    (tmp_path / "in").mkdir()
    work = Watch(tmp_path / "in", script=tmp_path / "merge.mlx")
    return tmp_path / "in", watch(work, lambda path: worked.append(path.name), 0), worked


def test_nothing_is_read_while_it_is_being_written(looks):
    folder, look, worked = looks
    mesh = folder / "a.ply"
    for part in (100, 150, 200):
        mesh.write_text(PLAIN[:part])
        next(look)
    mesh.write_text(PLAIN)
    next(look)
    assert worked == []
    next(look)
    assert worked == ["a.ply"]
    next(look)
    mesh.write_text(PLAIN + " ")
    next(look)
    assert worked == ["a.ply"]
    next(look)
    assert worked == ["a.ply", "a.ply"]


def test_a_project_waits_for_its_meshes(looks):
    folder, look, worked = looks
    write_project(folder / "p.mlp", [ProjectMesh(name, folder / f"{name}.ply", np.eye(4)) for name in "ab"])
    next(look)
    next(look)
    for name, text in (("a", PLAIN), ("b", PLAIN[:100]), ("b", PLAIN[:150]), ("b", PLAIN)):
        (folder / f"{name}.ply").write_text(text)
        next(look)
    assert worked == []
    next(look)
    assert worked == ["p.mlp"]  # its meshes are not work of their own
    os.utime(folder / "b.ply", ns=(1, 1))
    next(look)
    next(look)
    assert worked == ["p.mlp", "p.mlp"]


def test_file_saved_during_work_is_processed_again(tmp_path):
    (tmp_path / "merge.mlx").write_text(MERGE)
    mesh = tmp_path / "a.ply"
    mesh.write_text(PLAIN)
    worked = []

    def process(path):
        worked.append(path.name)
        if len(worked) == 1:
            mesh.write_text(PLAIN + "  ")

    for _ in watch(Watch(tmp_path, script=tmp_path / "merge.mlx"), process, 0, once=True):
        assert len(worked) <= 2
    assert worked == ["a.ply", "a.ply"]


def test_unchanged_sound_file_is_not_tried_again(tmp_path, monkeypatch):
    """The trial before reading is skipped; that of a broken file is repeated, since it may succeed later."""
    tried = []
    run = subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda command, **options: (tried.append(1), run(command, **options))[1])
    sound, broken = tmp_path / "a.ply", tmp_path / "b.ply"
    sound.write_text(PLAIN)
    broken.write_text(PLAIN[:100])
    assert [fault_of_file(sound, gltf=False) for _ in range(3)] == [""] * 3
    assert len(tried) == 1
    assert all(fault_of_file(broken, gltf=False) for _ in range(2))
    assert len(tried) == 3
    sound.write_text(PLAIN[:100])
    assert fault_of_file(sound, gltf=False)


def test_results_sources_and_other_files_are_passed_over(looks):
    folder, look, worked = looks
    for name in ("a_zoomout.ply", "b.ply.0123abcd.part.ply", "notes.txt", "c.stl"):
        (folder / name).write_text(PLAIN)
    next(look)
    next(look)
    assert worked == ["c.stl"]
    shutil.copy(folder / "notes.txt", folder / "d.ply")
    assert [path.name for path in Watch(folder, source=folder / "c.stl").inputs()] == ["d.ply"]
    assert Watch(folder).inputs() == []


def test_failed_file_is_reported_and_others_continue(tmp_path):
    (tmp_path / "merge.mlx").write_text(MERGE)
    (tmp_path / "a.ply").write_text(PLAIN[:100])
    (tmp_path / "b.ply").write_text(PLAIN)
    ran = run("watch", tmp_path, "--once", "--interval", 0.1, "--script", tmp_path / "merge.mlx")
    assert ran.exit_code == 3
    (failure,) = [line for line in ran.stderr.splitlines() if "failed." in line]
    assert failure.startswith(f"a.ply: failed. {tmp_path / 'a.ply'} could not be read")
    assert (tmp_path / "b_zoomout.ply").is_file()
    assert not (tmp_path / "a_zoomout.ply").exists()


def test_a_project_of_one_mesh_has_nothing_to_transfer_to(folder):
    write_project(folder / "desktop.mlp", read_project(folder / "desktop.mlp")[:1])
    ran = run("watch", folder, "--once", "--interval", 0.1)
    assert ran.exit_code == 1
    assert "desktop.mlp: failed. The project desktop.mlp has only one mesh" in ran.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
def test_ctrl_c_ends_watch_with_one_line(tmp_path):
    command = [sys.executable, "-u", "-m", "meshlab_filter", "watch", str(tmp_path)]
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # background processes may ignore it
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, preexec_fn=heard) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == f"Watching {tmp_path}; press Ctrl-C to stop.\n"
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert said.strip() == f"No longer watching {tmp_path}: 0 files were worked on."


def test_a_single_check_reports_a_project_whose_mesh_is_missing(tmp_path):
    (tmp_path / "incomplete.mlp").write_text(
        '<MeshLabProject><MeshGroup><MLMesh label="a" filename="gone.ply"/><MLMesh label="b" filename="b.ply"/>'
        "</MeshGroup></MeshLabProject>"
    )
    ran = run("watch", tmp_path, "--once", "--interval", 0.1)
    assert ran.exit_code == 1
    assert "incomplete.mlp: failed. " in ran.output
    assert "gone.ply" in ran.output
