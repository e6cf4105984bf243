# SPDX-License-Identifier: GPL-3.0-or-later
"""The reason why a file cannot be read is in the words of its format, not in those of Python and its libraries."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from fuzz import INTERNAL

import zoomout_core as zo

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{}end_header\n{}"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"
CORNERS = "0 0 0\n1 0 0\n0 1 0\n"

REASONS = {
    "a letter in OBJ": ("a.obj", "v 1 a 2\n" + SQUARE + "f 1 2 3\n", "the line 'v 1 a 2' lacks one of its numbers"),
    "a short line of OBJ": ("a.obj", "v 1 2\n" + SQUARE + "f 1 2 3\n", "the line 'v 1 2' lacks one of its numbers"),
    "a letter in a face": ("a.obj", SQUARE + "f 1 2 three\n", "'three' is not a whole number"),
    "a fraction in a face": ("a.obj", SQUARE + "f 1 2 3.5/1\n", "'3.5' is not a whole number"),
    "OFF without counts": ("a.off", "OFF\n", "it does not declare its numbers of vertices and faces"),
    "OFF with a single count": ("a.off", "OFF\n3\n", "it does not declare its numbers of vertices and faces"),
    "OFF with a count below zero": ("a.off", "OFF\n3 -1\n", "it does not declare its numbers of vertices and faces"),
    "OFF with a count in words": ("a.off", "OFF\nthree 1 0\n", "'three' is not a whole number"),
    "OFF that ends within its vertices": ("a.off", "OFF\n4 0 0\n0 0 0\n1 0 0\n0 1 0\n", "it ends too early"),
    "OFF that ends within its faces": ("a.off", f"OFF\n3 2 0\n{CORNERS}3 0 1 2\n", "it ends too early"),
    "a letter in OFF": ("a.off", f"OFF\n3 1 0\n{CORNERS}3 0 1 x\n", "the line '3 0 1 x' lacks one of its numbers"),
    "a letter in PLY": ("a.ply", PLY.format(FACES, CORNERS + "3 0 1 two\n"), "'two' is not a number"),
    "PLY that ends too early": ("a.ply", PLY.format(FACES, CORNERS), "it ends too early"),
    "PLY with a count below zero": (
        "a.ply",
        PLY.format(FACES.replace("1", "-1"), CORNERS),
        "its header declares -1 elements",
    ),
    "PLY with a count in words": (
        "a.ply",
        PLY.format(FACES.replace("1", "one"), CORNERS + "3 0 1 2\n"),
        "'one' is not a whole number",
    ),
    "PLY with an unknown type": (
        "a.ply",
        PLY.format(FACES.replace("uchar", "byte"), CORNERS + "3 0 1 2\n"),
        "its header has the line 'property list byte int vertex_indices'",
    ),
    "PLY with a short line": (
        "a.ply",
        PLY.format("element\n" + FACES, CORNERS + "3 0 1 2\n"),
        "its header has the line 'element'",
    ),
    "PLY with a property of nothing": (
        "a.ply",
        "ply\nformat ascii 1.0\nproperty float x\nend_header\n",
        "its header has the line 'property float x'",
    ),
    "glTF that is no JSON": ("a.gltf", '{"asset": {"version": "2.0"},,}', "its JSON is damaged in line 1, column 30"),
    "glTF in another encoding": ("a.gltf", b'{"asset": {"generator": "\xe9"}}', "its JSON is not UTF-8 text"),
    "glTF with damaged data": (
        "a.gltf",
        json.dumps({"asset": {"version": "2.0"}, "buffers": [{"byteLength": 4, "uri": "data:;base64,AAAAA"}]}),
        "its embedded data is damaged",
    ),
    "glTF with data in letters that do not exist": (
        "a.gltf",
        json.dumps({"asset": {"version": "2.0"}, "buffers": [{"byteLength": 4, "uri": "data:;base64,Ä"}]}),
        "its embedded data is damaged",
    ),
    "XYZ that is something else": ("a.xyz", "a b c\nd e f\n", "its content is damaged, or of another format"),
}


@pytest.mark.parametrize("name", REASONS)
@pytest.mark.parametrize("read", [zo.read_surface, zo.read_asset])
def test_error_gives_reason_in_terms_of_the_format(name: str, read: object, tmp_path: Path) -> None:
    file, content, reason = REASONS[name]
    path = tmp_path / file
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(zo.MeshError) as raised:
        read(path)  # type: ignore[operator]
    assert str(raised.value).startswith(f"{path} could not be read ({reason}): check that the file is complete")
    assert not INTERNAL.search(str(raised.value))


def test_a_file_without_content_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(b"solid\nendsolid\n")
    with pytest.raises(zo.MeshError, match=r"a\.stl contains neither faces nor points: check that it is a mesh file"):
        zo.read_surface(tmp_path / "a.stl")
