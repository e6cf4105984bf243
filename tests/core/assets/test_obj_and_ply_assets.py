# SPDX-License-Identifier: GPL-3.0-or-later
"""OBJ and PLY files keep texture coordinates, colours and materials; data that they cannot store is reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skinned_tubes import PNG, write_tube

from zoomout_core.assets.asset import Asset, Material, from_srgb, material_numbers, on_points, to_srgb
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.outputs import OutputError
from zoomout_core.transfer.attribute import Attribute, Domain, Kind


@pytest.fixture
def made() -> Asset:
    """A quadrilateral and a triangle, with a seam between them."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0.5, 0]], dtype=float)
    surface = Surface(vertices, [[0, 1, 2, 3], [1, 4, 2]])
    uv = np.array([[0, 0], [0.5, 0], [0.5, 1], [0, 1], [0.6, 0], [1, 0.5], [0.6, 1]])
    colors = np.array([[0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1], [0.5, 0.5, 0.5, 1], [0.02, 0.2, 1, 1]])
    attributes = (
        Attribute("uv 0", Domain.CORNER, Kind.UV, uv),
        Attribute("color 0", Domain.POINT, Kind.COLOR, colors),
        material_numbers(np.array([1, 0])),
    )
    return Asset(surface, attributes, (Material("red paint", (1, 0, 0, 0.5)), Material("B", image=PNG)))


@pytest.mark.parametrize("ending", [".obj", ".ply"])
def test_obj_and_ply_round_trips_keep_data(tmp_path: Path, made: Asset, ending: str) -> None:
    notes = write_asset(made, tmp_path / f"a{ending}")
    again = read_asset(tmp_path / f"a{ending}")
    order = [1, 0] if ending == ".obj" else [0, 1]  # OBJ groups faces by material
    corners = np.concatenate([np.split(np.arange(7), [4])[face] for face in order])
    np.testing.assert_array_equal(again.surface.corner_vertex, made.surface.corner_vertex[corners])
    np.testing.assert_allclose(again.surface.vertices, made.surface.vertices)
    found = {each.name: each for each in again.attributes}
    np.testing.assert_allclose(found["uv 0"].values, made.attributes[0].values[corners], atol=1e-7)
    np.testing.assert_allclose(found["color 0"].values[:, :3], made.attributes[1].values[:, :3], atol=0.01)
    if ending == ".obj":
        assert notes == ()
        names = [again.materials[number].name for number in found["materials"].values]
        assert names == ["red paint", "B"]
        assert {material.name: material for material in again.materials} == {each.name: each for each in made.materials}
    else:
        assert notes == ("PLY files cannot store materials, which were left out: write a .glb file to keep them.",)


@pytest.mark.parametrize("ending", [".obj", ".ply", ".glb"])
def test_a_corner_without_uv_takes_that_of_its_own_island(tmp_path: Path, made: Asset, ending: str) -> None:
    # The corner of the quadrilateral at the same place is on another island.
    uv = made.attributes[0].values.copy()
    uv[4] = np.nan
    broken = replace(made.attributes[0], values=uv)
    notes = write_asset(Asset(made.surface, (broken,)), tmp_path / f"a{ending}")
    assert notes[0].startswith("1 of 7 values of 'uv 0' are not finite")
    found = read_asset(tmp_path / f"a{ending}").find("uv 0")
    assert found is not None
    np.testing.assert_allclose(found.values[-3:].mean(axis=0), uv[5:].mean(axis=0), atol=1e-6)


def test_data_that_obj_cannot_store_is_reported(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    (note,) = write_asset(read_asset(tmp_path / "tube.glb"), tmp_path / "tube.obj")
    assert note.startswith("OBJ files cannot store skin weights or shape keys, which were left out")
    assert (tmp_path / "tube_0.png").read_bytes() == PNG


def test_obj_with_negative_indices_and_missing_uvs_is_read(tmp_path: Path) -> None:
    text = "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25 0.5\nusemtl a b\nf -3/-1 2 3/1\nf 3 2 1\n"
    (tmp_path / "a.obj").write_text(text)
    asset = read_asset(tmp_path / "a.obj")
    uv = asset.find("uv 0")
    assert uv is not None
    assert uv.values.tolist() == [[0.25, 0.5], [0, 0], [0.25, 0.5], [0, 0], [0, 0], [0, 0]]
    assert asset.materials == (Material("a b"),)


def test_obj_with_comments_and_continued_lines_is_read(tmp_path: Path) -> None:
    text = "v 0 0 0 # first\nv 1 0 0\n\tv  0 1 \\\n0\nvt .5 .5 # place\nusemtl  a  b # paint\nf 1/1 2 \\\n 3 # all\n"
    (tmp_path / "a.obj").write_text(text)
    asset = read_asset(tmp_path / "a.obj")
    np.testing.assert_array_equal(asset.surface.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(asset.surface.corner_vertex, [0, 1, 2])
    np.testing.assert_array_equal(read_surface(tmp_path / "a.obj").corner_vertex, [0, 1, 2])
    assert asset.materials == (Material("a b"),)


def test_ply_vertex_uvs_become_corner_uvs(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {name}\n" for name in "xyzst")
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(header + "0 0 0 .1 .2\n1 0 0 .3 .4\n0 1 0 .5 .6\n3 2 0 1\n")
    uv = read_asset(tmp_path / "a.ply").find("uv 0")
    assert uv is not None
    np.testing.assert_allclose(uv.values, [[0.5, 0.6], [0.1, 0.2], [0.3, 0.4]])


def test_colors_convert_to_srgb_and_back(made: Asset) -> None:
    linear = np.linspace(0, 1, 30).reshape(10, 3)
    np.testing.assert_allclose(from_srgb(to_srgb(linear)), linear, atol=1e-7)
    np.testing.assert_allclose(to_srgb(np.full((1, 3), 0.214)), 0.5, atol=1e-3)
    of_corners = Attribute("c", Domain.CORNER, Kind.COLOR, np.repeat([[0.0], [1.0]], [4, 3], axis=0))
    np.testing.assert_allclose(on_points(of_corners, made.surface).ravel(), [0, 0.5, 0.5, 0, 1])


def test_unsupported_formats_and_missing_folders_are_refused(tmp_path: Path, made: Asset) -> None:
    with pytest.raises(MeshError, match=r"has no supported file extension: use \.glb"):
        write_asset(made, tmp_path / "a.fbx")
    with pytest.raises(OutputError):
        write_asset(made, tmp_path / "none" / "a.obj")
    with pytest.raises(MeshError, match="There is no file"):
        read_asset(tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())
