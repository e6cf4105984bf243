# SPDX-License-Identifier: GPL-3.0-or-later
"""Compressed glTF files have the data of uncompressed ones, whoever wrote them."""

from __future__ import annotations

import json
import sys
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial import cKDTree
from skinned_tubes import write_tube

from zoomout_core.assets.asset import NORMALS, SHAPE_KEYS, Asset
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.gltf.compress import METHODS
from zoomout_core.cli import main
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.compression.decompress_gltf import DRACO, MESHOPT
from zoomout_core.mesh.formats.compression.draco import decode_draco
from zoomout_core.mesh.formats.compression.meshopt_attributes import decode_attributes, encode_attributes
from zoomout_core.mesh.formats.compression.meshopt_filters import decode_filter, encode_exponential, encode_octahedral
from zoomout_core.mesh.formats.compression.meshopt_indices import decode_indices, decode_triangles, encode_triangles
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.formats.glb import unpack_glb
from zoomout_core.runtime.input_files import FormatError

TABLES = json.loads((Path(__file__).parent / "meshopt_streams.json").read_text())
ROUNDED = 3e-5


@pytest.fixture(params=METHODS)
def method(request: pytest.FixtureRequest) -> str:
    if request.param == "draco":
        pytest.importorskip("DracoPy")
    return str(request.param)


@pytest.fixture
def asset(tmp_path: Path) -> Asset:
    """A tube with a skin, a morph target, an animation, two materials and a UV seam."""
    write_tube(tmp_path / "tube.glb", parts=2)
    write_asset(read_asset(tmp_path / "tube.glb"), tmp_path / "with_normals.glb")
    return read_asset(tmp_path / "with_normals.glb")


def tree_of(path: Path) -> dict:
    return dict(json.loads(unpack_glb(path.read_bytes())[0]))


@pytest.mark.parametrize("ending", [".glb", ".gltf"])
def test_a_compressed_file_has_all_data(asset: Asset, method: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"small{ending}"
    assert write_asset(asset, path, compression=method) == ()
    again = read_asset(path)
    surface, extent = asset.surface, float(np.ptp(asset.surface.vertices, axis=0).max())
    off, place = cKDTree(again.surface.vertices).query(surface.vertices)
    assert off.max() < ROUNDED * extent
    assert sorted(place) == list(range(len(surface.vertices)))
    assert {tuple(sorted(each)) for each in place[surface.triangles]} == {
        tuple(sorted(each)) for each in again.surface.triangles
    }
    assert asset.skin is not None
    assert again.skin is not None
    assert abs(again.skin.weights[place] - asset.skin.weights).max() < ROUNDED
    assert again.skin.names == asset.skin.names
    before, after = asset.find(SHAPE_KEYS), again.find(SHAPE_KEYS)
    assert before is not None
    assert after is not None
    assert after.labels == before.labels
    assert np.abs(after.values[place] - before.values).max() < ROUNDED * extent
    assert {each.name for each in again.attributes} == {each.name for each in asset.attributes}
    assert [each.name for each in again.materials] == [each.name for each in asset.materials]
    at_corners = [
        np.column_stack([each.surface.vertices[each.surface.corner_vertex] / extent, each.find("uv 0").values])
        for each in (asset, again)
    ]
    assert cKDTree(at_corners[1]).query(at_corners[0])[0].max() < 2 * ROUNDED
    assert again.document is not None
    assert asset.document is not None
    movements = [each.document.array(each.document.gltf.animations[0].samplers[0].output) for each in (asset, again)]
    np.testing.assert_array_equal(*movements)


def test_the_file_requires_the_extension_and_is_smaller(asset: Asset, method: str, tmp_path: Path) -> None:
    write_asset(asset, tmp_path / "plain.glb")
    write_asset(asset, tmp_path / "small.glb", compression=method)
    tree = tree_of(tmp_path / "small.glb")
    assert {"draco": DRACO, "meshopt": MESHOPT[0]}[method] in tree["extensionsRequired"]
    assert (tmp_path / "small.glb").stat().st_size < 0.8 * (tmp_path / "plain.glb").stat().st_size
    assert len(read_shape(tmp_path / "small.glb").vertices) == len(asset.surface.vertices)
    # A document is decompressed when it is read, so writing it again does not need the extension.
    write_asset(read_asset(tmp_path / "small.glb"), tmp_path / "again.glb")
    assert "extensionsRequired" not in tree_of(tmp_path / "again.glb")


def test_weights_still_sum_to_one(asset: Asset, method: str, tmp_path: Path) -> None:
    assert asset.skin is not None
    rng = np.random.default_rng(0)
    weights = asset.skin.weights.copy()
    weights.data = rng.random(len(weights.data))
    skinned = replace(asset, skin=replace(asset.skin, weights=weights))
    write_asset(skinned, tmp_path / "small.glb", compression=method)
    document = read_asset(tmp_path / "small.glb").document
    assert document is not None
    for primitive in document.gltf.meshes[0].primitives:
        np.testing.assert_allclose(document.array(primitive.attributes.WEIGHTS_0).sum(axis=1), 1, atol=1e-9)


@pytest.mark.parametrize("case", TABLES["attributes"], ids=lambda case: case["id"])
def test_attributes_of_the_reference_encoder_are_decoded(case: dict) -> None:
    stored = decode_attributes(b64decode(case["stream"]), case["count"], case["stride"])
    np.testing.assert_array_equal(stored, np.frombuffer(b64decode(case["raw"]), np.uint8).reshape(stored.shape))


@pytest.mark.parametrize("case", TABLES["filters"], ids=lambda case: case["id"])
def test_filters_of_the_reference_are_decoded(case: dict) -> None:
    kind = {"EXPONENTIAL": "<f4", "COLOR": "<u2"}.get(case["filter"], "<i2")
    stored, wanted = (
        np.frombuffer(b64decode(case[key]), np.uint8).reshape(-1, case["stride"]) for key in ("raw", "decoded")
    )
    found = decode_filter(stored, case["filter"]).view(kind).astype(float)
    assert np.abs(found - wanted.view(kind)).max() <= (0 if kind == "<f4" else 1)


def test_indices_of_the_reference_encoder_are_decoded() -> None:
    for case in TABLES["indices"]:
        decode = decode_triangles if case["mode"] == "TRIANGLES" else decode_indices
        raw = np.frombuffer(b64decode(case["raw"]), "<u4")
        np.testing.assert_array_equal(decode(b64decode(case["stream"]), len(raw)), raw)


@pytest.mark.parametrize("shape", [(1, 4), (17, 12), (300, 16), (1000, 256)])
def test_attributes_are_the_same_after_encoding(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    for spread in (0, 2, 20, 255):
        elements = np.cumsum(rng.integers(0, spread + 1, shape), axis=0).astype(np.uint8)
        np.testing.assert_array_equal(decode_attributes(encode_attributes(elements), *shape), elements)


def test_triangles_are_the_same_after_encoding() -> None:
    rng = np.random.default_rng(2)
    rows = np.arange(900)[:, None] + np.arange(3)
    for triangles in (rows, rows[::-1], rng.integers(0, 1 << 20, (500, 3)), np.concatenate([rows, rows])):
        found = decode_triangles(encode_triangles(triangles), triangles.size).reshape(-1, 3)
        turned = [np.roll(found, turn, axis=1) for turn in range(3)]
        assert np.any([(each == triangles).all(axis=1) for each in turned], axis=0).all()


def test_filters_round_to_the_requested_precision() -> None:
    rng = np.random.default_rng(3)
    numbers = rng.normal(size=(500, 3))
    decoded = decode_filter(encode_exponential(numbers, 2.0**-12), "EXPONENTIAL").view("<f4")
    assert 2.0**-15 < np.abs(decoded - numbers).max() <= 2.0**-13
    vectors = np.vstack([numbers / np.linalg.norm(numbers, axis=1)[:, None], np.eye(3), -np.eye(3)])
    decoded = decode_filter(encode_octahedral(vectors, 12), "OCTAHEDRAL").view("<i2")[:, :3] / 32767
    assert np.abs(decoded - vectors).max() < 1.5e-3


@pytest.mark.parametrize("cut", [1, 9, 40])
def test_damaged_streams_are_refused(cut: int) -> None:
    elements = np.arange(1600, dtype=np.uint8).reshape(100, 16)
    triangles = np.arange(300).reshape(-1, 3)
    for decode, content, size in (
        (decode_attributes, encode_attributes(elements), elements.shape),
        (decode_triangles, encode_triangles(triangles), (triangles.size,)),
    ):
        for damaged in (content[:-cut], content[cut:], content + bytes(cut), b""):
            with pytest.raises(FormatError):
                decode(damaged, *size)


def test_a_file_that_would_expand_too_far_is_refused(asset: Asset, tmp_path: Path) -> None:
    write_asset(asset, tmp_path / "large.gltf", compression="meshopt")
    tree = json.loads((tmp_path / "large.gltf").read_text())
    view = tree["bufferViews"][0]
    view["extensions"][MESHOPT[0]]["count"] = 1 << 28
    view["byteLength"] = (1 << 28) * view["extensions"][MESHOPT[0]]["byteStride"]
    (tmp_path / "large.gltf").write_text(json.dumps(tree))
    with pytest.raises(MeshError, match=r"would expand to \d+ bytes"):
        read_asset(tmp_path / "large.gltf")


def test_draco_stream_with_unexpected_counts_is_refused() -> None:
    package = pytest.importorskip("DracoPy")
    positions, triangles = np.random.default_rng(0).random((9, 3)), np.arange(9).reshape(-1, 3)
    content = package.encode(positions, triangles.astype("<u4"), preserve_order=True)
    assert len(decode_draco(content, 3, 9).points) == 9
    for sizes in ((2, 9), (3, 8), (4, 9), (3, 10)):
        with pytest.raises(FormatError):
            decode_draco(content, *sizes)


def test_a_missing_package_is_named_with_its_extra(
    asset: Asset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("DracoPy")
    write_asset(asset, tmp_path / "small.glb", compression="draco")
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(ImportError, match=r"need DracoPy: .*\[web\]"):
        read_asset(tmp_path / "small.glb")
    with pytest.raises(ImportError, match=r"need DracoPy: .*\[web\]"):
        write_asset(asset, tmp_path / "other.glb", compression="draco")
    assert not (tmp_path / "other.glb").exists()


@pytest.mark.parametrize("name", ["small.obj", "small.ply", "small.vrm"])
def test_other_formats_are_not_compressed(asset: Asset, name: str, tmp_path: Path) -> None:
    with pytest.raises(MeshError):
        write_asset(asset, tmp_path / name, compression="meshopt")
    assert not (tmp_path / name).exists()


def test_a_compressed_level_can_be_updated(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    options = ["-o", str(tmp_path), "--ratios", "0.4", "--keep-map", "--compress", "meshopt"]
    result = CliRunner().invoke(main, ["lods", str(tmp_path / "tube.glb"), *options])
    assert result.exit_code == 0, result.output
    level = tmp_path / "tube_LOD1.glb"
    assert MESHOPT[0] in tree_of(level)["extensionsUsed"]
    assert read_asset(level).stored_map is not None
    source = read_asset(tmp_path / "tube.glb")
    keys = source.find(SHAPE_KEYS)
    assert keys is not None
    others = tuple(each for each in source.attributes if each.name not in (SHAPE_KEYS, NORMALS))
    longer = replace(source, attributes=(*others, replace(keys, values=2 * np.asarray(keys.values))))
    write_asset(longer, tmp_path / "new.glb")
    update = ["update", str(tmp_path / "tube.glb"), str(tmp_path / "new.glb"), str(level)]
    result = CliRunner().invoke(main, [*update, "-o", str(tmp_path / "out.glb"), "--compress", "meshopt"])
    assert result.exit_code == 0, result.output
    before, after = (np.asarray(read_asset(path).find(SHAPE_KEYS).values) for path in (level, tmp_path / "out.glb"))
    assert np.abs(after - 2 * before).max() < 5e-3
