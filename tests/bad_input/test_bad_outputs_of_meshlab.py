# SPDX-License-Identifier: GPL-3.0-or-later
"""The command lines of `meshlab_filter`: outputs that are inputs, and outputs that cannot be written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymeshlab
import pytest
from click.testing import Result
from interfaces import Limit, assert_refused, contents
from interfaces import run as run_command
from PIL import Image

from meshlab_filter.commands import main
from meshlab_filter.files import save_beside, texture_files

NOTHING = "<!DOCTYPE FilterScript><FilterScript></FilterScript>"


def run(*arguments: str | Path) -> Result:
    return run_command(main, *arguments)


@pytest.fixture
def coloured(meshes: tuple[Path, Path]) -> tuple[Path, Path]:
    """The source with colours, and the target."""
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(meshes[0]))
    ms.apply_filter("compute_color_by_function_per_vertex", x="255*x", y="255*y", z="0")
    ms.save_current_mesh(str(meshes[0]))
    return meshes


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "nothing.mlx"
    path.write_text(NOTHING)
    return path


def test_an_output_that_is_an_input_is_refused(coloured: tuple[Path, Path], script: Path, tmp_path: Path) -> None:
    source, target = coloured
    before = contents(tmp_path)
    for command in (
        ("transfer", source, target, "-o", source),
        ("transfer", source, target, "-o", target),
        ("run", script, target, "-o", target),
        ("run", script, source, target, "-o", source),
    ):
        assert_refused(run(*command), "is an input, and would be overwritten")
        assert contents(tmp_path) == before
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / target.name).symlink_to(target)
    assert_refused(run("transfer", source, target, "-o", folder), "is an input, and would be overwritten")
    assert contents(tmp_path)[target.name] == before[target.name]


def test_in_place_overwrites_the_target(coloured: tuple[Path, Path], tmp_path: Path) -> None:
    source, target = coloured
    ran = run("transfer", source, target, "-o", target, "--in-place", "--detail", "fast")
    assert ran.exit_code == 0, ran.output
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(target))
    assert ms.current_mesh().has_vertex_color()
    assert {path.name for path in tmp_path.iterdir()} == {"source.ply", "target.ply"}


@pytest.mark.parametrize("ending", ["ply", "obj", "off", "stl"])
def test_full_disk_keeps_the_existing_file(
    meshes: tuple[Path, Path], script: Path, tmp_path: Path, size_limit: Limit, ending: str
) -> None:
    out = tmp_path / f"out.{ending}"
    out.write_text("before")
    before = contents(tmp_path)
    with size_limit(4096):
        ran = run("run", script, meshes[0], "-o", out)
    assert_refused(ran, f"out.{ending} could not be written")
    assert contents(tmp_path) == before


def test_unwritable_report_keeps_the_existing_one(
    coloured: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "report.json").write_text("before")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert_refused(
        run("transfer", *coloured, "-o", folder, "--detail", "fast"), "report.json could not be written (No space"
    )
    assert (folder / "report.json").read_bytes() == b"before"


def textured(folder: Path, color: str) -> Path:
    """A triangle with a texture, in its own folder."""
    folder.mkdir()
    Image.new("RGB", (8, 8), color).save(folder / "skin.png", compress_level=0)
    mesh = pymeshlab.Mesh(np.eye(3), [[0, 1, 2]], w_tex_coords_matrix=[[0, 0], [1, 0], [0, 1]])
    ms = pymeshlab.MeshSet()
    ms.add_mesh(mesh)
    ms.save_current_mesh(str(folder / "mesh.ply"))
    content = (folder / "mesh.ply").read_bytes()
    (folder / "mesh.ply").write_bytes(content.replace(b"comment", b"comment TextureFile skin.png\ncomment", 1))
    return folder / "mesh.ply"


def test_input_textures_are_neither_rewritten_nor_replaced(tmp_path: Path) -> None:
    red, blue = textured(tmp_path / "red", "red"), textured(tmp_path / "blue", "blue")
    ms = pymeshlab.MeshSet()
    inputs = {}
    for path in (blue, red):
        ms.load_new_mesh(str(path))
        inputs |= texture_files(ms.current_mesh(), path)
    before = contents(tmp_path)
    assert set(inputs) == {path.parent / "skin.png" for path in (red, blue)}
    save_beside(ms, red.with_name("new.ply"), inputs, {})  # beside its own picture
    assert contents(tmp_path).items() >= before.items()
    with pytest.raises(ValueError, match=r"The texture skin\.png would overwrite the input image"):
        save_beside(ms, blue.with_name("new.ply"), inputs, {})
    assert contents(tmp_path / "blue") == contents(tmp_path / "blue") | {
        name.removeprefix("blue/"): content for name, content in before.items() if name.startswith("blue/")
    }
    assert not blue.with_name("new.ply").exists()
    save_beside(ms, blue.with_name("new.ply"), inputs, {}, in_place=True)
    with Image.open(blue.with_name("skin.png")) as picture:
        assert picture.convert("RGB").getpixel((0, 0)) == (255, 0, 0)
