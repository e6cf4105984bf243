# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats that other libraries read: they open no file outside the folder, and instances multiply in bounds."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from time import process_time

import pytest

import zoomout_core as zo
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.xml_instances import check_instances

MODEL = '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>{}</resources>{}</model>'
SHOWN = '<visual_scene id="s"><instance_node url="#n39"/></visual_scene>'
SCENE = f"<COLLADA><library_nodes>{{}}</library_nodes>{SHOWN}</COLLADA>"
LAYERS = {
    "a layer": "(subLayers = [@{name}@])",
    "a reference": 'def "A" (references = @{name}@</M>)\n{{\n}}',
    "a payload": 'def "A" (payload = @{name}@</M>)\n{{\n}}',
}
MESH = """#usda 1.0
def Mesh "M"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
}
"""


@pytest.mark.parametrize("name", ["../other.usda", "{there}/other.usda", "link.usda", "other.usda"])
@pytest.mark.parametrize("how", LAYERS)
def test_layers_outside_the_folder_are_refused(
    how: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "other.usda").write_text(MESH)
    folder = tmp_path / "stage"
    folder.mkdir()
    (folder / "link.usda").symlink_to(tmp_path / "other.usda")
    monkeypatch.chdir(tmp_path)  # where USD looks, too
    path = folder / "a.usda"
    path.write_text("#usda 1.0\n" + LAYERS[how].format(name=name.format(there=tmp_path)) + "\n")
    with pytest.raises(MeshError, match=r"outside its folder|contains no faces"):
        zo.read_surface(path)
    (folder / "mesh.usda").write_text(MESH)
    path.write_text("#usda 1.0\n" + LAYERS[how].format(name="./mesh.usda") + "\n")
    assert len(zo.read_surface(path).triangles) == 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
def test_a_layer_that_is_a_pipe_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    os.mkfifo(tmp_path / "pipe.usda")
    (tmp_path / "a.usda").write_text("#usda 1.0\n(subLayers = [@./pipe.usda@])\n")
    with pytest.raises(MeshError, match="is a pipe, a device or a socket"):
        zo.read_surface(tmp_path / "a.usda")


@pytest.mark.parametrize("leaf", [MESH.partition("\n")[2], 'def Xform "M"\n{\n}\n'])
def test_nested_usd_instances_are_bounded(leaf: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    text = "#usda 1.0\n" + leaf.replace('"M"', '"M0"')
    for level in range(1, 41):
        copies = "".join(
            f'def "{name}" (\ninstanceable = true\nreferences = </M{level - 1}>\n)\n{{\n}}\n' for name in "ab"
        )
        text += f'def Xform "M{level}"\n{{\n{copies}}}\n'
    (tmp_path / "a.usda").write_text(text)
    start = process_time()
    with pytest.raises(MeshError, match=r"The instances of .* have more than 33554432 points"):
        zo.read_surface(tmp_path / "a.usda")
    assert process_time() - start < 20


@pytest.mark.parametrize(
    "line", ["*INCLUDE, INPUT=/etc/hosts", "*include,input=b.inp", "*Include, a=b.inp, INPUT=../b.inp"]
)
def test_abaqus_includes_are_refused(line: str, tmp_path: Path) -> None:
    pytest.importorskip("meshio")
    (tmp_path / "a.inp").write_text(f"*NODE\n1, 0, 0, 0\n{line}\n")
    with pytest.raises(MeshError, match="includes other files, which are not read: merge them"):
        zo.read_surface(tmp_path / "a.inp")


@pytest.mark.parametrize(
    ("kind", "name", "why"),
    [
        ("Binary", "data.bin", "has its data in binary files"),
        ("Binary", "/etc/hosts", "has its data in binary files"),
        ("HDF", "/etc/hosts:/data", "outside its folder"),
        ("HDF", "../data.h5:/data", "outside its folder"),
        ("HDF", "none.h5:/data", "There is no file"),
    ],
)
def test_xdmf_references_to_other_files_are_refused(kind: str, name: str, why: str, tmp_path: Path) -> None:
    pytest.importorskip("meshio")
    item = f'<DataItem Format="{kind}" Dimensions="3 3" DataType="Float">{name}</DataItem>'
    (tmp_path / "a.xdmf").write_text(f"<Xdmf><Domain><Grid><Geometry>{item}</Geometry></Grid></Domain></Xdmf>")
    with pytest.raises(MeshError, match=why):
        zo.read_surface(tmp_path / "a.xdmf")


def of_components(number: int, *parts: int) -> str:
    """An object of a 3MF file that consists of others."""
    return f'<object id="{number}"><components>{"".join(map(component, parts))}</components></object>'


def component(number: int) -> str:
    return f'<component objectid="{number}"/>'


def of_nodes(number: int, *parts: int) -> str:
    """A node of a COLLADA file that consists of others."""
    return f'<node id="n{number}">{"".join(map(instance, parts))}</node>'


def instance(number: int) -> str:
    return f'<instance_node url="#n{number}"/>'


GRAPHS = {
    "doubled": [(number, number - 1, number - 1) for number in range(1, 40)],
    "a cycle": [(number, number % 39 + 1) for number in range(1, 40)],
    "itself": [(39, 39)],
}


@pytest.mark.parametrize("name", GRAPHS)
def test_nested_xml_instances_are_bounded(name: str, tmp_path: Path) -> None:
    objects = "".join(of_components(*each) for each in GRAPHS[name])
    with zipfile.ZipFile(tmp_path / "a.3mf", "w") as archive:
        archive.writestr("3D/3dmodel.model", MODEL.format(objects, '<build><item objectid="39"/></build>'))
    scene = SCENE.format("".join(of_nodes(*each) for each in GRAPHS[name]))
    (tmp_path / "a.dae").write_text(scene)
    with zipfile.ZipFile(tmp_path / "a.zae", "w") as archive:
        archive.writestr("a.dae", scene)
    start = process_time()
    for ending in (".3mf", ".dae", ".zae"):
        with pytest.raises(MeshError, match=r"it has more than 10000 instances|is an instance of itself"):
            zo.read_surface(tmp_path / f"a{ending}")
    assert process_time() - start < 2


def test_usual_instances_are_read() -> None:
    many = "".join(of_nodes(number, 39) for number in range(1000, 5000))
    check_instances(SCENE.format(f'<node id="n39"><node/><node/></node>{many}').encode())
    check_instances(b"<COLLADA>")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.vtk", "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 3 float\n0 0\n"),
        ("b.vtk", "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nSHAPES 3\n"),
        ("a.mesh", "MeshVersionFormatted 1\nDimension 3\nVertices\n3\n0 0 zero 1\n"),
        ("a.msh", "$MeshFormat\n9.9 0 8\n$EndMeshFormat\n"),
        ("a.vtu", "<VTKFile><UnstructuredGrid/></VTKFile>"),
        ("a.usda", "#usda 1.0\ndef Mesh {{{\n"),
    ],
)
def test_damaged_files_raise_one_sentence_and_print_nothing(
    name: str, content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pxr" if name.endswith(".usda") else "meshio")
    (tmp_path / name).write_text(content)
    with pytest.raises(MeshError) as raised:
        zo.read_surface(tmp_path / name)
    opened = "could not be opened as USD" if name.endswith(".usda") else "could not be read (its content is damaged"
    assert opened in str(raised.value)
    assert not any(capsys.readouterr())
