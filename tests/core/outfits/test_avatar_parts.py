# SPDX-License-Identifier: GPL-3.0-or-later
"""Body and worn parts of an avatar file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zoomout_core.assets.asset import MATERIALS
from zoomout_core.assets.files import read_asset
from zoomout_core.assets.stored_map import StoredMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.outfits.parts import are_of_body, hair_objects, is_hair, keep_faces, split_avatar


def test_body_and_worn_parts_are_separated_by_name(dolls: Path) -> None:
    asset = read_asset(dolls / "dressed.glb")
    body, worn = split_avatar(asset)
    assert [name for name, _ in body.objects] == ["Skin"]
    assert worn is not None
    assert [name for name, _ in worn.objects] == ["Shirt", "Trousers"]
    assert len(body.surface.vertices) + len(worn.surface.vertices) == len(asset.surface.vertices)


def test_naked_avatar_is_all_body(dolls: Path) -> None:
    asset = read_asset(dolls / "naked.glb")
    body, worn = split_avatar(asset, wears=False)
    assert worn is None
    np.testing.assert_array_equal(body.surface.vertices, asset.surface.vertices)
    with pytest.raises(MeshError, match=r"\('skin material/Skin'\): give .*, or name those of the body with --body"):
        split_avatar(asset)


def test_patterns_select_the_body(dolls: Path) -> None:
    asset = read_asset(dolls / "dressed.glb")
    body, worn = split_avatar(asset, ["SKIN*", "shirt"])
    assert [name for name, _ in body.objects] == ["Skin", "Shirt"]
    assert worn is not None
    assert [name for name, _ in worn.objects] == ["Trousers"]


def test_patterns_of_outfits_do_not_empty_other_avatars(dolls: Path) -> None:
    asset = read_asset(dolls / "dressed.glb")
    body, worn = split_avatar(asset, ["Torso*"], wears=False)
    assert [name for name, _ in body.objects] == ["Skin"]
    assert worn is not None
    assert [name for name, _ in worn.objects] == ["Shirt", "Trousers"]


def test_kept_faces_keep_their_data(dolls: Path) -> None:
    asset = read_asset(dolls / "dressed.glb")
    n = len(asset.surface.vertices)
    of_whole = StoredMap(np.zeros(n, int), np.full((n, 3), 1 / 3), np.ones(n), np.ones(n, bool), "source", ("uv",))
    asset = replace(asset, stored_map=of_whole)
    chosen = np.arange(len(asset.surface.face_start) - 1) % 2 == 0
    kept = keep_faces(asset, chosen)
    assert kept.stored_map is None
    before, after = asset.surface, kept.surface
    np.testing.assert_array_equal(after.vertices[after.triangles], before.vertices[before.triangles[chosen]])
    assert asset.skin is not None
    assert kept.skin is not None
    corners = before.triangles[chosen].ravel()
    weights = kept.skin.weights[after.triangles.ravel()] - asset.skin.weights[corners]
    assert abs(weights).max() == 0
    for name in ("materials", "normals"):
        old, new = asset.find(name), kept.find(name)
        assert old is not None
        assert new is not None
        assert len(new.values) == len(old.values) / len(chosen) * chosen.sum()


@pytest.mark.parametrize(
    ("name", "materials", "found"),
    [
        ("ShortHair", (), True),
        ("Hair001", ("Cloth",), True),
        ("Mesh", ("Hair_Front", "Hair_Back"), True),
        ("Mesh", ("Hair", "Ribbon"), False),
        ("braid01", (), True),
        ("PonyTail", (), True),
        ("HairBand", ("Hairpin",), False),
        ("Wig.001", (), True),
        ("Twintails", (), True),
        ("前髪", (), True),
        ("Mesh", ("ヘア", "三つ編み"), True),
        ("髪飾り", (), False),
        ("ヘアピン", (), False),
        ("Hairband", ("Hair",), False),
        ("Hat", ("Hair",), False),
        ("hairy_coat", (), False),
        ("MohairSweater", (), False),
        ("BraidedBelt", (), False),
        ("Chair", (), False),
        ("Mesh", (), False),
        ("Shirt", (), False),
    ],
)
def test_hair_is_recognised_by_name(name: str, materials: tuple[str, ...], *, found: bool) -> None:
    assert is_hair(name, materials) == found


def test_hair_of_a_file_is_recognised(dolls: Path) -> None:
    worn = split_avatar(read_asset(dolls / "dressed.glb")).worn
    assert worn is not None
    assert hair_objects(worn) == [False, False]
    (_, shirt), trousers = worn.objects
    assert hair_objects(replace(worn, objects=(("Hair", shirt), trousers))) == [True, False]
    last = int(np.asarray(worn.find(MATERIALS).values)[-1])  # type: ignore[union-attr]
    materials = [replace(each, name="Hair") if number == last else each for number, each in enumerate(worn.materials)]
    hair = replace(worn, materials=tuple(materials), objects=(worn.objects[0], ("Mesh", trousers[1])))
    assert hair_objects(hair) == [False, True]


def test_patterns_that_choose_nothing_or_everything_are_named() -> None:
    names = [("Skin",), ("Shirt",)]
    with pytest.raises(MeshError, match=r"--body matches none of its parts \('Skin', 'Shirt'\): correct"):
        are_of_body(names, ["Robe*"])
    with pytest.raises(MeshError, match=r"All of its parts belong to the body .* an avatar that wears something"):
        are_of_body(names, ["S*"])
    assert are_of_body(names, ["S*"], wears=False) == [True, True]
    with pytest.raises(MeshError, match=r"None of its parts is named like one of a body \('Shirt', 'Hat'\): name"):
        are_of_body([("Shirt",), ("Hat",)], ["Robe*"], wears=False)
    with pytest.raises(MeshError, match="All of its parts belong to the body"):
        are_of_body([("Skin",), ("Face",)])
    with pytest.raises(MeshError, match="name those of the body with --body"):
        are_of_body([("Thing",), ("Other",)])
