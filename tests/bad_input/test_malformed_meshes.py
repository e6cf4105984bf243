# SPDX-License-Identifier: GPL-3.0-or-later
"""Every entry point refuses malformed mesh files in a sentence, soon and in little memory; a batch goes on."""

from __future__ import annotations

import json
import re
from pathlib import Path
from time import process_time

import numpy as np
import pymeshlab
import pytest
from interfaces import run
from malformed import MALFORMED, OBJ, ODD_NUMBERS, TRIANGLE

import zoomout_core as zo
from meshlab_filter.commands import main
from meshlab_filter.files import load_mesh
from meshlab_filter.mesh_data import read_layer
from zoomout_core.cli import main as zoomout
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_shape

# A quad, and a triangle on its diagonal: MeshLab's search for polygons has no end.
DIAGONAL = f"{OBJ}v 0 1 0\nf 1 2 3 4\nf 1 2 3\n".encode()


@pytest.mark.parametrize("name", [*MALFORMED, *ODD_NUMBERS])
def test_core_names_malformed_file(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes((MALFORMED | ODD_NUMBERS)[name])
    start = process_time()
    with pytest.raises(MeshError, match=rf"{path}") as error:
        zo.read_surface(path)
    assert not re.search("convert to C|out of bounds|list index|cast|read \\(\\)", str(error.value))  # Python's words
    assert process_time() - start < 10


# MeshLab takes what stands before the point.
@pytest.mark.parametrize("name", [*(name for name in MALFORMED if name != "fractions.obj"), "diagonal.obj"])
def test_malformed_file_does_not_crash_meshlab(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes((MALFORMED | {"diagonal.obj": DIAGONAL})[name])
    ms = pymeshlab.MeshSet()
    with pytest.raises(MeshError):  # nothing may remain in the layer
        read_layer(ms, load_mesh(ms, path))


@pytest.mark.slow
def test_batch_continues_after_malformed_files(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    source, target = meshes
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(source))
    ms.apply_filter("compute_color_by_function_per_vertex", x="255*x", y="255*y", z="0")
    ms.save_current_mesh(str(source))
    scans = tmp_path / "scans"
    scans.mkdir()
    target.rename(scans / "m.ply")
    for name in ("short_face.off", "vertex_beyond.off", "billions_of_triangles.stl", "a_list_of_billions.ply"):
        (scans / name).write_bytes(MALFORMED[name])
    ran = run(main, "transfer", source, scans, "-o", tmp_path / "out", "--detail", "fast")
    assert ran.exit_code == 3
    rows = json.loads((tmp_path / "out" / "report.json").read_text())["targets"]
    assert [Path(row["target"]).name for row in rows if "error" not in row] == ["m.ply"]
    assert all("could not be read" in row["error"] for row in rows if "error" in row)


def test_unusual_but_valid_files_are_read(tmp_path: Path) -> None:
    for name, content in {
        "a_mark_of_the_byte_order.obj": f"\ufeff{OBJ}f 1 2 3\n",
        "counted_backwards.obj": f"{OBJ}f -3 -2 -1\n",
        "comments.off": f"OFF # of a triangle\n3 1 0 # counts\n{TRIANGLE}3 0 1 2 # the face\n",
        "windows.off": f"OFF\n3 1 0\n{TRIANGLE}3 0 1 2\n".replace("\n", "\r\n"),
    }.items():
        path = tmp_path / name
        path.write_bytes(content.encode())
        surface = zo.read_surface(path)
        np.testing.assert_array_equal(surface.triangles, [[0, 1, 2]])
        np.testing.assert_array_equal(surface.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0]])


@pytest.mark.parametrize("line", ["Kd a b c", "Kd spectral file.rfl 1", "Kd nan 0 0", "Kd 0,5 0,5 0,5", "d x"])
def test_colours_that_are_not_numbers_are_left_out(line: str, tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text(f"newmtl Red\n{line}\nnewmtl Blue\nKd 0 0 1\n")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{OBJ}usemtl Red\nf 1 2 3\nusemtl Blue\nf 1 2 3\n")
    asset = zo.read_asset(tmp_path / "a.obj")
    assert asset.notes == ("The colour of the material 'Red' is not made of numbers, and was left out.",)
    assert [each.color for each in asset.materials] == [(1, 1, 1, 1), (0, 0, 1, 1)]


@pytest.mark.parametrize("corner", ["9", "-9"])
def test_missing_texture_coordinates_are_refused(corner: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(f"{OBJ}vt 0 0\nf 1/1 2/{corner} 3/1\n")
    with pytest.raises(MeshError, match="a face refers to a texture coordinate that is none of its 1"):
        zo.read_asset(tmp_path / "a.obj")


@pytest.mark.parametrize("ending", ["obj", "ply", "stl", "off", "glb", "gltf"])
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            "version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
            "it is a pointer of Git LFS): run `git lfs pull`",
        ),
        ("<!DOCTYPE html><html>404</html>", "it is a web page): download the file again"),
    ],
)
def test_files_stored_in_place_of_a_mesh_are_recognised(content: str, said: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"mesh.{ending}"
    path.write_text(content)
    for read in (read_shape, zo.read_asset):
        with pytest.raises(MeshError, match=rf"^{path} could not be read \({re.escape(said)}"):
            read(path)


@pytest.mark.parametrize("fault", ["v 0 0 0", "v nan 0 1"])
def test_file_of_an_unusable_surface_is_named(fault: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text("v 0 0 0\nv 0 0 0\n" + fault + "\nf 1 2 3\n")
    with pytest.raises(MeshError, match=rf"^{path}: "):
        zo.read_asset(path)


def test_size_of_a_file_leaves_out_vertices_of_no_face(tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 2 0\nv nan 0 0\nf 1 2 3\n")
    assert "Size 1 x 2 x 0, area 1." in run(zoomout, "info", path).output
