# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a mesh names are read only in its folder, or in folders that the user allows, and only if regular."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import pytest
from broken_gltf import DATA, content_of, document
from interfaces import contents, run
from naming import CLIMBING, SECRET, make_pipe, with_image, with_library

import zoomout_core as zo
from zoomout_core.assets.files import inputs_of
from zoomout_core.cli import main
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.named_files import check_named_files
from zoomout_core.runtime.input_files import OutsideError, beside, read_whole

ESCAPED = {
    "climbing, escaped": "%2e%2e/secret.png",
    "climbing, all escaped": "%2E%2E%2Fsecret.png",
    "absolute, escaped": "%2F{there}/secret.png",
    "a file's address": "file://{there}/secret.png",
    "with a null character": "..%00/secret.png",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a mesh, with links that lead out of it, beside a file that must stay private."""
    (tmp_path / "secret.png").write_bytes(SECRET)
    made = tmp_path / "mesh"
    (made / "textures").mkdir(parents=True)
    (made / "link").symlink_to(tmp_path)
    (made / "link.png").symlink_to(tmp_path / "secret.png")
    return made


def assert_private(path: Path) -> None:
    """Assert that a mesh is read without the private image, with a note, and that hosts may not read it at all."""
    asset = zo.read_asset(path)
    (note,) = asset.notes
    assert "is outside the folder of the file" in note
    out = path.parent.parent / "out"
    out.mkdir()
    for ending in (".glb", ".gltf", ".obj"):
        zo.write_asset(asset, out / f"a{ending}")
    assert not [name for name, content in contents(out).items() if SECRET in content or b"iVBORw0KGgo" in content]
    with pytest.raises(MeshError, match=r"refers to .*, which is outside its folder, and is not read: move it"):
        check_named_files(path)


@pytest.mark.parametrize("name", [*CLIMBING, *ESCAPED])
def test_images_of_gltf_stay_private(name: str, folder: Path) -> None:
    there = str(folder.parent)
    assert_private(with_image(folder, (CLIMBING | ESCAPED)[name].format(there=there)))


@pytest.mark.parametrize("name", CLIMBING)
def test_images_of_obj_stay_private(name: str, folder: Path) -> None:
    assert_private(with_library(folder, "a.mtl", CLIMBING[name].format(there=folder.parent)))


@pytest.mark.parametrize("name", CLIMBING)
def test_materials_of_obj_stay_private(name: str, folder: Path) -> None:
    library = CLIMBING[name].format(there=folder.parent).replace(".png", ".mtl")
    (folder / "link.mtl").symlink_to(folder.parent / "secret.mtl")
    (folder.parent / "secret.mtl").write_text("newmtl Red\nKd 0.123 0 0\n")
    path = with_library(folder, library, "none.png")
    asset = zo.read_asset(path)
    assert asset.materials[0].color == (1, 1, 1, 1)
    assert "outside the folder" in asset.notes[0]
    with pytest.raises(MeshError, match="outside its folder"):
        check_named_files(path)


@pytest.mark.parametrize("name", [*CLIMBING, *ESCAPED])
def test_buffers_of_gltf_stay_private(name: str, folder: Path) -> None:
    (folder.parent / "secret.png").write_bytes(DATA)
    tree = document()
    tree["buffers"][0]["uri"] = (CLIMBING | ESCAPED)[name].format(there=folder.parent)
    (folder / "a.gltf").write_bytes(content_of(tree))
    for read in (zo.read_surface, zo.read_asset, check_named_files):
        with pytest.raises(MeshError, match=r"a\.gltf refers to .*, which is outside its folder"):
            read(folder / "a.gltf")


def test_further_folders_are_allowed_by_an_option(folder: Path, meshes: tuple[Path, Path]) -> None:
    there = folder.parent
    for path in (with_image(folder, "../secret.png"), with_library(folder, "a.mtl", str(there / "secret.png"))):
        asset = zo.read_asset(path, [there])
        assert asset.notes == ()
        assert asset.materials[0].image == SECRET
        check_named_files(path, [there])
        ran = run(main, "info", path)
        assert "outside the folder of the file" in ran.output
        assert "outside" not in run(main, "info", path, "--allow-folder", there).output
        with pytest.raises(OutsideError):
            beside("../secret.png", folder, [there / "other"])


def test_usual_names_are_found(folder: Path) -> None:
    (folder / "textures" / "skin of a cat.png").write_bytes(SECRET)
    for name in ("textures/skin of a cat.png", "./textures/skin of a cat.png", "textures\\skin of a cat.png"):
        assert zo.read_asset(with_library(folder, "a.mtl", name)).materials[0].image == SECRET
        assert zo.read_asset(with_image(folder, name.replace(" ", "%20"))).materials[0].image == SECRET
    assert zo.read_asset(with_library(folder, "a.mtl", "-s 1 1 1 link.png")).materials[0].image is None


def test_a_missing_image_is_a_note(folder: Path) -> None:
    for path in (with_image(folder, "none.png"), with_library(folder, "a.mtl", "none.png")):
        asset = zo.read_asset(path)
        (note,) = asset.notes
        assert note.startswith("The image 'none.png' could not be opened")
        zo.write_asset(asset, folder / "again.glb")
        again = zo.read_asset(folder / "again.glb")
        assert again.notes == ()
        assert again.materials[0].name == "Red"


def test_only_images_are_copied(folder: Path) -> None:
    (folder / "private.txt").write_text("password")
    for path in (with_image(folder, "private.txt"), with_library(folder, "a.mtl", "private.txt")):
        asset = zo.read_asset(path)
        (note,) = asset.notes
        assert "not an image of a known type" in note
        assert asset.materials[0].image is None


def test_a_missing_image_does_not_end_a_transfer(folder: Path, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    surface = zo.read_surface(meshes[0])
    lines = [f"v {x} {y} {z}" for x, y, z in surface.vertices]
    lines += [f"f {' '.join(map(str, each))}" for each in surface.triangles + 1]
    (folder / "a.mtl").write_text("newmtl Red\nKd 1 0 0\nmap_Kd ../secret.png\n")
    (folder / "a.obj").write_text("\n".join(["mtllib a.mtl", "usemtl Red", *lines]) + "\n")
    (tmp_path / "out").mkdir()
    output = tmp_path / "out" / "a.glb"
    ran = run(main, "transfer", folder / "a.obj", meshes[1], "-o", output, "--detail", "fast", "--force")
    assert ran.exit_code == 0, ran.output
    assert "The image '../secret.png' is outside the folder of the file, and was not read." in ran.output
    assert SECRET not in output.read_bytes()
    assert zo.read_asset(output).materials[0].color == (1, 0, 0, 1)


# --- pipes, devices and sockets -----------------------------------------------------------------------------


def make_socket(path: Path) -> None:
    before = Path.cwd()
    os.chdir(path.parent)  # addresses of sockets are short
    try:
        socket.socket(socket.AF_UNIX).bind(path.name)
    finally:
        os.chdir(before)


def make_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


SPECIAL = {"a pipe": make_pipe, "a socket": make_socket, "a device": make_device}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no such files")
@pytest.mark.parametrize("name", SPECIAL)
@pytest.mark.parametrize("ending", [".obj", ".off", ".ply", ".stl", ".glb", ".gltf", ".usda", ".vtk", ".3mf"])
def test_special_files_are_not_opened(name: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    SPECIAL[name](path)
    start = perf_counter()
    for read in (zo.read_surface, zo.read_asset, check_named_files):
        with pytest.raises(MeshError, match="is a pipe, a device or a socket: save its content to a file"):
            read(path)
    with pytest.raises(OSError, match="a pipe, a device or a socket"):
        read_whole(path)
    assert inputs_of(path) == [path]
    assert perf_counter() - start < 2


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no such files")
@pytest.mark.parametrize("make", [make_pipe, make_socket])
def test_special_files_that_a_mesh_names_are_not_opened(make: Callable[[Path], None], folder: Path) -> None:
    make(folder / "a.png")
    make(folder / "special.mtl")
    start = perf_counter()
    for path in (
        with_image(folder, "a.png"),
        with_library(folder, "a.mtl", "a.png"),
        with_library(folder, "special.mtl", ""),
    ):
        (note,) = zo.read_asset(path).notes
        assert "a pipe, a device or a socket" in note
        with pytest.raises(MeshError, match="which is not a file: remove it"):
            check_named_files(path)
    tree = document()
    tree["buffers"][0]["uri"] = "a.png"
    (folder / "a.gltf").write_bytes(json.dumps(tree).encode())
    for read in (zo.read_surface, zo.read_asset):
        with pytest.raises(MeshError, match="a pipe, a device or a socket"):
            read(folder / "a.gltf")
    assert perf_counter() - start < 2


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no such files")
def test_pipes_are_refused_as_maps_and_landmarks(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.npz"
    os.mkfifo(pipe)
    for option in ("--landmarks", "--initial", "--earlier-map"):
        ran = run(main, "match", *meshes, "-o", tmp_path / "out.npz", option, pipe)
        assert ran.exit_code
        assert "pipe" in ran.output
        assert "Traceback" not in ran.output
