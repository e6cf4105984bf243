# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF files that contradict the specification are refused in a sentence, at once and in little memory."""

from __future__ import annotations

import json
import re
from pathlib import Path
from time import process_time

import pytest
from broken_gltf import BROKEN, content_of, document
from interfaces import assert_refused, run

import zoomout_core as zo
from zoomout_core.cli import main
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_shape


def test_the_document_itself_is_read(tmp_path: Path) -> None:
    path = tmp_path / "whole.gltf"
    path.write_bytes(content_of(document()))
    for surface in (read_shape(path), zo.read_asset(path).surface):
        assert isinstance(surface, zo.Surface)
        assert surface.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


@pytest.mark.parametrize("read", [read_shape, zo.read_asset])
@pytest.mark.parametrize("name", BROKEN)
def test_broken_gltf_is_refused_in_one_sentence(name: str, read: object, tmp_path: Path) -> None:
    tree = document()
    BROKEN[name](tree)
    path = tmp_path / "broken.gltf"
    path.write_bytes(content_of(tree))
    start = process_time()
    with pytest.raises(MeshError, match=rf"^{path} [^\n]*\.$") as error:
        read(path)
    assert not re.search("broadcast|reshape|shape mismatch", str(error.value))  # words of numpy
    assert process_time() - start < 10


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "its JSON is damaged in line 1, column 1"),
        (b"{", "its JSON is damaged in line 1, column 2"),
        (b"[]", "the file is \\[\\], not an object"),
        (b"null", "the file is null, not an object"),
        (b'{"nodes": ' + b"[" * 100_000, "nested too deeply"),
        (b"\xff\xfe\x00", "its JSON is not UTF-8 text"),
        (b"glTF\x01\0\0\0\x0c\0\0\0", "its version is 1"),
        (b"glTF\x02\0\0\0\xff\0\0\0", "it ends too early"),
        (b"glTF\x02\0\0\0\x0c\0\0\0", "it has no JSON"),
        (b"glTF\x02\0\0\0\x18\0\0\0\xff\xff\xff\xffJSON{}  ", "it ends too early"),
    ],
)
def test_non_gltf_content_is_refused_in_one_sentence(content: bytes, why: str, tmp_path: Path) -> None:
    for ending in (".gltf", ".glb"):
        path = tmp_path / f"broken{ending}"
        path.write_bytes(content)
        for read in (read_shape, zo.read_asset):
            with pytest.raises(MeshError, match=rf"{path} could not be read \([^\n]*{why}"):
                read(path)


def test_command_refuses_broken_gltf(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "broken.gltf"
    tree = document()
    BROKEN["a cycle of two nodes"](tree)
    path.write_text(json.dumps(tree))
    assert_refused(run(main, "info", path), "some of its nodes are their own ancestors")
    assert_refused(run(main, "transfer", path, meshes[1], "-o", tmp_path / "out.glb"), "their own ancestors")
    assert not (tmp_path / "out.glb").exists()


@pytest.mark.parametrize("extras", [1, "text", [1, 2], True, {"targetNames": 5}, {"targetNames": [1, None]}])
def test_extras_of_any_type_are_accepted(extras: object, tmp_path: Path) -> None:
    tree = document()
    tree["meshes"][0]["extras"] = extras
    tree["nodes"][2]["extras"] = extras
    path = tmp_path / "free.gltf"
    path.write_bytes(content_of(tree))
    asset = zo.read_asset(path)
    assert zo.write_asset(asset, tmp_path / "again.glb") == ()
    assert len(zo.read_asset(tmp_path / "again.glb").surface.triangles) == 1


def test_coordinates_beyond_float32_are_refused(tmp_path: Path) -> None:
    surface = zo.Surface([[0.0, 0, 0], [1e50, 0, 0], [0, 1e50, 0]], [[0, 1, 2]])
    for ending in (".glb", ".gltf"):
        with pytest.raises(MeshError, match="too large for the single floats of glTF: check"):
            zo.write_asset(zo.Asset(surface), tmp_path / f"a{ending}")
    assert not list(tmp_path.iterdir())
