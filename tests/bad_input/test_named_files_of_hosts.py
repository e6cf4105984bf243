# SPDX-License-Identifier: GPL-3.0-or-later
"""MeshLab and Blender, which follow any name in a file, are not given files that lead out of their folder."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import pymeshlab
import pytest
from interfaces import assert_refused, contents, run
from naming import CLIMBING, SECRET, make_pipe, with_image, with_library

import blender_addon
from blender_addon.scene.files import open_scene, save_scene
from meshlab_filter.commands import main
from meshlab_filter.files import load_mesh
from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.outputs import OutputError

REFUSED = r"refers to .*, which is outside its folder, and is not read: move it beside the file"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a mesh, beside a file that must stay private."""
    (tmp_path / "secret.png").write_bytes(SECRET)
    made = tmp_path / "mesh"
    made.mkdir()
    (made / "link").symlink_to(tmp_path)
    (made / "link.png").symlink_to(tmp_path / "secret.png")
    (made / "textures").mkdir()
    return made


def with_comment(folder: Path, name: str) -> Path:
    """Write a PLY file with the name of a texture."""
    text = f"ply\nformat ascii 1.0\ncomment TextureFile {name}\nelement vertex 3\n"
    text += "".join(f"property float {axis}\n" for axis in "xyz")
    text += "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n"
    (folder / "a.ply").write_text(text)
    return folder / "a.ply"


def with_element(folder: Path, name: str) -> Path:
    """Write a COLLADA file with the name of an image."""
    (folder / "a.dae").write_text(f"<COLLADA><image><init_from>{name}</init_from></image></COLLADA>")
    return folder / "a.dae"


def assert_refused_by_meshlab(path: Path) -> None:
    meshes = pymeshlab.MeshSet()
    with pytest.raises(MeshError, match=REFUSED):
        load_mesh(meshes, path)
    assert meshes.mesh_number() == 0


@pytest.mark.parametrize("name", CLIMBING)
def test_meshlab_is_given_no_outside_files(name: str, folder: Path) -> None:
    given = CLIMBING[name].format(there=folder.parent)
    paths = [with_library(folder, "a.mtl", given), with_comment(folder, given), with_element(folder, given)]
    for path in (*paths, with_image(folder, given)):
        assert_refused_by_meshlab(path)


@pytest.mark.parametrize("name", CLIMBING)
def test_blender_is_given_no_outside_files(name: str, folder: Path) -> None:
    given = CLIMBING[name].format(there=folder.parent)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with blender_addon.registered():
        for path in (with_library(folder, "a.mtl", given), with_image(folder, given)):
            with pytest.raises(MeshError, match=REFUSED):
                open_scene(bpy.context, path)
            assert not bpy.data.images


@pytest.mark.parametrize(
    "statement",
    [
        "a.png /etc/hostname",
        "-o 1 1 1 /etc/hostname",
        "/etc/hostname a.png",
        "a.png \\\n/etc/hostname",
        "/etc/hostname # a",
    ],
)
def test_every_word_of_a_statement_is_checked(statement: str, folder: Path) -> None:
    assert_refused_by_meshlab(with_library(folder, "a.mtl", statement))
    (folder / "b.obj").write_text(f"mtllib {statement}\nv 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    assert_refused_by_meshlab(folder / "b.obj")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
def test_hosts_do_not_wait_for_pipes(folder: Path) -> None:
    make_pipe(folder / "a.png")
    for path in (with_library(folder, "a.mtl", "a.png"), with_comment(folder, "a.png"), with_image(folder, "a.png")):
        with pytest.raises(MeshError, match="which is not a file: remove it"):
            load_mesh(pymeshlab.MeshSet(), path)
        with pytest.raises(MeshError, match="which is not a file: remove it"):
            open_scene(bpy.context, path)


def test_blender_does_not_overwrite_materials_of_an_input(folder: Path) -> None:
    path = with_library(folder, "b.mtl", "none.png")
    (folder / "a.mtl").rename(folder / "b.mtl")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with blender_addon.registered():
        open_scene(bpy.context, path)
        before = contents(folder)
        with pytest.raises(OutputError, match=r"b\.mtl is an input, and would be overwritten"):
            save_scene(folder / "b.obj", [folder / "b.mtl"])
        assert contents(folder) == before
        save_scene(folder / "c.obj", [folder / "b.mtl"])
    assert contents(folder).items() > before.items()


def test_meshlab_does_not_overwrite_materials_of_an_input(
    meshes: tuple[Path, Path], folder: Path, tmp_path: Path
) -> None:
    script = tmp_path / "script.mlx"
    script.write_text("<!DOCTYPE FilterScript>\n<FilterScript>\n</FilterScript>\n")
    path = with_library(folder, "b.obj.mtl", "none.png")
    (folder / "a.mtl").rename(folder / "b.obj.mtl")
    before = contents(folder)
    assert_refused(run(main, "run", script, path, "-o", folder / "b.obj"), "b.obj.mtl is an input, and would be")
    assert contents(folder) == before
    ran = run(main, "run", script, path, "-o", folder / "b.obj", "--in-place")
    assert ran.exit_code == 0, ran.output
