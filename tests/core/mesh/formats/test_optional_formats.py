# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats that need optional libraries; without them the error names the package to install."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.formats.polygons import reverse_winding

STAGE = """#usda 1.0
def Xform "World"
{
    double3 xformOp:translate = (10, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "Quad"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    }
    def Mesh "Mirrored"
    {
        float3 xformOp:scale = (-1, 1, 1)
        uniform token[] xformOpOrder = ["xformOp:scale"]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 1), (1, 0, 1), (1, 1, 1)]
    }
    def Mesh "Hidden"
    {
        token visibility = "invisible"
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 9), (1, 0, 9), (1, 1, 9)]
    }
}
"""
VTK = """# vtk DataFile Version 2.0
a triangle and a quad
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 5 double
0 0 0 1 0 0 1 1 0 0 1 0 2 0.5 0
CELLS 2 9
4 0 1 2 3
3 1 4 2
CELL_TYPES 2
9
5
"""


def test_meshes_of_a_usd_stage_are_placed_and_joined(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    path = tmp_path / "stage.usda"
    path.write_text(STAGE)
    surface = read_surface(path)
    assert np.array_equal(np.diff(surface.face_start), [4, 3])
    assert np.array_equal(surface.vertices[0], [10, 0, 0])
    assert np.array_equal(surface.vertices[5], [9, 0, 1])
    # A mirrored mesh keeps its outer side.
    a, b, c = surface.vertices[surface.corner_vertex[4:]]
    assert np.cross(b - a, c - a)[2] > 0


def test_faces_of_a_vtk_file_are_read(tmp_path: Path) -> None:
    pytest.importorskip("meshio")
    path = tmp_path / "grid.vtk"
    path.write_text(VTK)
    surface = read_surface(path)
    assert len(surface.vertices) == 5
    assert sorted(np.diff(surface.face_start)) == [3, 4]
    assert surface.area == pytest.approx(1.5)


@pytest.mark.parametrize("ending", [".usda", ".vtk"])
def test_broken_files_are_refused(tmp_path: Path, ending: str) -> None:
    pytest.importorskip("pxr" if ending == ".usda" else "meshio")
    path = tmp_path / f"broken{ending}"
    path.write_text("no mesh")
    with pytest.raises(MeshError, match="could not be"):
        read_surface(path)


@pytest.mark.parametrize(("ending", "package"), [(".usdz", "pxr"), (".msh", "meshio")])
def test_missing_packages_are_named_with_their_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    path = tmp_path / f"mesh{ending}"
    path.write_text("")
    with pytest.raises(ImportError, match=r"pip install '\.\[formats\]'"):
        read_surface(path)


def test_winding_is_reversed_face_by_face() -> None:
    assert reverse_winding(np.array([0, 1, 2, 3, 4, 5, 6]), np.array([3, 4])).tolist() == [
        2,
        1,
        0,
        6,
        5,
        4,
        3,
    ]
