# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of materials and files that break the lines of a format: OBJ and .mtl keep their faces and materials."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from malformed import OBJ
from naming import SECRET as PNG

import zoomout_core as zo
from zoomout_core.assets.asset import Asset, Material, material_numbers
from zoomout_core.mesh.surface import Surface

NAMES = {
    "a line break": "a\nf 1 2 4",
    "a line break of a typewriter": "a\rf 1 2 4",
    "both": "a\r\nf 1 2 4",
    "a form feed": "a\x0cf 1 2 4",
    "a vertical tab": "a\x0bf 1 2 4",
    "a separator of files": "a\x1cf 1 2 4",
    "a next line": "a\x85f 1 2 4",
    "a separator of lines": "a\u2028f 1 2 4",
    "a separator of paragraphs": "a\u2029f 1 2 4",
    "a backslash at the end": "a\\",
    "two backslashes at the end": "a\\\\",
    "a comment": "a # b",
    "nothing": "",
    "blanks": "  ",
    "a null character": "a\0b",
    "half a character": "a\ud800",
    "umlauts": "Gr\u00fcn \u732b \U0001f408",
    "a mark of the byte order": "\ufeffa",
    "a statement": "map_Kd /etc/passwd",
}


@pytest.mark.parametrize("name", NAMES)
def test_unusual_material_names_keep_faces_and_materials(name: str, tmp_path: Path) -> None:
    surface = Surface([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    materials = Material(NAMES[name], (1, 0, 0, 1), PNG), Material("Blue", (0, 0, 1, 1))
    asset = Asset(surface, (material_numbers(np.array([0, 1])),), materials)
    zo.write_asset(asset, tmp_path / "a.obj")
    again = zo.read_asset(tmp_path / "a.obj")
    np.testing.assert_array_equal(again.surface.corner_vertex, surface.corner_vertex)
    assert [material.color for material in again.materials] == [material.color for material in materials]
    assert [material.image for material in again.materials] == [PNG, None]
    for ending in (".glb", ".gltf"):
        zo.write_asset(asset, tmp_path / f"a{ending}")
        assert zo.read_asset(tmp_path / f"a{ending}").materials[0].image == PNG


def test_changed_material_names_are_distinct_and_reported(tmp_path: Path) -> None:
    surface = Surface([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2]] * 4)
    names = ["Skin", "Skin", "a\nb", "a b"]
    materials = tuple(Material(name, (number / 4, 0, 0, 1)) for number, name in enumerate(names))
    (note,) = zo.write_asset(Asset(surface, (material_numbers(np.arange(4)),), materials), tmp_path / "a.obj")
    assert note == "Some names of materials cannot be stored in OBJ files and were changed: Skin.001, a b, a b.001."
    again = zo.read_asset(tmp_path / "a.obj")
    assert [material.name for material in again.materials] == ["Skin", "Skin.001", "a b", "a b.001"]
    assert [material.color[0] for material in again.materials] == [0, 0.25, 0.5, 0.75]


@pytest.mark.parametrize("stem", ["a # b", "a\\", "-s 1", "a  b", "\u732b", "a%20b", "a\u2028b", "a\nb"])
def test_output_names_may_contain_any_characters(stem: str, tmp_path: Path) -> None:
    surface = Surface([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2]])
    asset = Asset(surface, (material_numbers(np.zeros(1, dtype=int)),), (Material("Red", (1, 0, 0, 1), PNG),))
    for ending in (".obj", ".gltf", ".glb"):
        path = tmp_path / f"{stem}{ending}"
        zo.write_asset(asset, path)
        again = zo.read_asset(path)
        assert again.notes == ()
        assert [(each.color, each.image) for each in again.materials] == [((1, 0, 0, 1), PNG)]


@pytest.mark.parametrize("separator", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028", "\u2029"])
def test_a_separator_in_a_comment_adds_no_faces(separator: str, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(
        f"# made by hand{separator}f 3 2 1\nv 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n", encoding="utf-8"
    )
    (tmp_path / "a.off").write_text(
        f"OFF # made by hand{separator}4 4\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n", encoding="utf-8"
    )
    header = f"ply\nformat ascii 1.0\ncomment by hand{separator}element vertex 9\nelement vertex 3\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(f"{header}0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n", encoding="utf-8")
    for ending in (".obj", ".off", ".ply"):
        np.testing.assert_array_equal(zo.read_surface(tmp_path / f"a{ending}").triangles, [[0, 1, 2]])


@pytest.mark.parametrize("locale", ["C", "en_US.ISO-8859-1"])
def test_written_files_do_not_depend_on_locale(locale: str, tmp_path: Path) -> None:
    code = """
import sys
import numpy as np
import zoomout_core as zo
from zoomout_core.assets.asset import Asset, Material, material_numbers
surface = zo.Surface([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2]])
asset = Asset(surface, (material_numbers(np.zeros(1, dtype=int)),), (Material("Gr\\u00fcn \\u732b"),))
for ending in ("obj", "gltf"):
    zo.write_asset(asset, f"{sys.argv[1]}/a.{ending}")
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    subprocess.run(
        [sys.executable, "-c", code, tmp_path], env=environment | {"LC_ALL": locale, "LANG": locale}, check=True
    )
    assert "newmtl Gr\u00fcn \u732b\n".encode() in (tmp_path / "a.mtl").read_bytes()
    assert zo.read_asset(tmp_path / "a.gltf").materials[0].name == "Gr\u00fcn \u732b"


@pytest.mark.skipif(os.name != "posix", reason="names are more restricted elsewhere")
def test_names_are_escaped_on_the_terminal(tmp_path: Path) -> None:
    code = """
import sys
from zoomout_core.__main__ import main
for path in sys.argv[1:]:
    sys.argv = ["zoomout", "info", path]
    try:
        main()
    except SystemExit:
        pass
"""
    names = "a\x1b[2J\x07", "a\x9b2J", "a\u202eylp", "a\u2028b"
    paths = []
    for number, name in enumerate(names):
        paths += [tmp_path / f"{number}.obj", tmp_path / f"{name}.obj"]  # which is missing
        paths[-2].write_text(f"{OBJ}usemtl {name}\nf 1 2 3\n", encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ran = subprocess.run([sys.executable, "-c", code, *paths], env=environment, capture_output=True)
    said = ran.stdout.decode() + ran.stderr.decode()
    assert said.count("There is no file") == len(names)
    assert said.count("vertices") == len(names)
    assert said.count("\\") >= len(names)
    assert not [character for character in said if not character.isprintable() and character != "\n"]
