# SPDX-License-Identifier: GPL-3.0-or-later
"""Several sources share a target: each transfers to its part, and the rest stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pygltflib as gltf
import pytest
from skinned_tubes import weights_of, write_tube

from zoomout_core.assets.asset import COLOR, MATERIALS, NORMALS, SHAPE_KEYS, Asset, on_corners
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.part_names import mask_of_parts
from zoomout_core.assets.transfer_asset import KINDS, transfer_asset
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.normals import outward_normals


@pytest.fixture
def target(tmp_path: Path) -> Asset:
    """A tube with its own data: two joints, the key Lean, two materials, and grey corners."""
    write_tube(tmp_path / "body.glb", parts=2)
    asset = read_asset(tmp_path / "body.glb")
    grey = Attribute("color 0", Domain.CORNER, Kind.COLOR, np.full((len(asset.surface.corner_vertex), 4), 0.5))
    return replace(asset, attributes=(*asset.attributes, grey))


@pytest.fixture
def head(tmp_path: Path) -> Asset:
    """The same tube from another file, with a rough material, its own key, and red vertices."""
    write_tube(tmp_path / "head.glb")
    file = gltf.GLTF2().load(tmp_path / "head.glb")
    file.materials[0].pbrMetallicRoughness.roughnessFactor = 0.25
    file.save(tmp_path / "head.glb")
    asset = read_asset(tmp_path / "head.glb")
    offsets = np.ones((len(asset.surface.vertices), 2, 3))
    keys = Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, offsets, ("Lean", "Smile"))
    red = Attribute("color 0", Domain.POINT, Kind.COLOR, np.tile([1.0, 0, 0], (len(offsets), 1)))
    kept = [each for each in asset.attributes if each.name not in (SHAPE_KEYS, "color 0")]
    return replace(asset, attributes=(*kept, keys, red))


def upper_half(asset: Asset) -> np.ndarray:
    height = asset.surface.vertices[:, 1]
    return np.asarray(height > height.mean(), dtype=float)


def onto_itself(asset: Asset) -> Any:
    count = len(asset.surface.vertices)
    surface_map = SurfaceMap.from_vertices(np.arange(count), asset.surface)
    return SimpleNamespace(surface_map=surface_map, confidence=np.ones(count), has_partner=None)


def test_a_second_source_transfers_to_its_part_alone(tmp_path: Path, target: Asset, head: Asset) -> None:
    mask = mask_of_parts(target, ["upp*"])
    made = transfer_asset(head, target, onto_itself(head), KINDS, mask=mask).asset
    write_asset(made, tmp_path / "out.glb")
    again = read_asset(tmp_path / "out.glb")
    assert again.skin is not None
    assert target.skin is not None
    np.testing.assert_allclose(again.skin.weights.toarray(), target.skin.weights.toarray(), atol=1e-6)
    height = again.surface.vertices[:, 1]
    upper = weights_of(height)[:, 1]
    keys, own = again.find(SHAPE_KEYS), target.find(SHAPE_KEYS)
    assert keys is not None
    assert own is not None
    assert keys.labels == ("Lean", "Smile")
    lean = (1 - upper[:, None]) * own.values[:, 0] + upper[:, None]
    np.testing.assert_allclose(keys.values[:, 0], lean, atol=1e-5)
    np.testing.assert_allclose(keys.values[:, 1], np.tile(upper[:, None], 3), atol=1e-5)
    # The materials of the second source come in full after the target's own, on whole faces.
    assert again.document is not None
    assert [each.name for each in again.materials] == ["Cloth 0", "Cloth 1", "Cloth 0 2"]
    assert again.document.gltf.materials[2].pbrMetallicRoughness.roughnessFactor == 0.25
    assert again.materials[2].image == head.materials[0].image
    numbers, before = again.find(MATERIALS), target.find(MATERIALS)
    assert numbers is not None
    assert before is not None
    of_face = upper[again.surface.corner_vertex].reshape(-1, 3).mean(axis=1)
    np.testing.assert_array_equal(np.asarray(numbers.values) == 2, of_face > 0.5)
    assert {0, 1} == set(np.asarray(numbers.values)[of_face < 0.5].tolist())
    color = again.find(f"{COLOR} 0")
    assert color is not None
    values = on_corners(color, again.surface)
    at = height[again.surface.corner_vertex]
    np.testing.assert_allclose(values[at == at.min()], 0.5, atol=0.01)
    np.testing.assert_allclose(values[at == at.max()], np.tile([1, 0, 0, 1], ((at == at.max()).sum(), 1)), atol=0.01)


@pytest.mark.parametrize("own", [None, Domain.POINT, Domain.CORNER])
def test_normals_outside_the_part_stay(target: Asset, head: Asset, own: Domain | None) -> None:
    count = {Domain.POINT: len(target.surface.vertices), Domain.CORNER: len(target.surface.corner_vertex)}
    others = tuple(each for each in target.attributes if each.name != NORMALS)
    up = np.array([0.0, 1.0, 0.0])
    if own is not None:
        others = (*others, Attribute(NORMALS, own, Kind.NORMAL, np.tile(up, (count[own], 1))))
    sideways = np.tile([1.0, 0.0, 0.0], (len(head.surface.corner_vertex), 1))
    source = replace(head, attributes=(Attribute(NORMALS, Domain.CORNER, Kind.NORMAL, sideways),))
    made = transfer_asset(
        source, replace(target, attributes=others), onto_itself(head), [NORMALS], mask=upper_half(head)
    )
    found = made.asset.find(NORMALS)
    assert found is not None
    outside = upper_half(head)[target.surface.corner_vertex] == 0
    expected = outward_normals(target.surface, Domain.CORNER) if own is None else np.tile(up, (len(outside), 1))
    np.testing.assert_allclose(on_corners(found, target.surface)[outside], expected[outside], atol=1e-6)
    assert np.abs(on_corners(found, target.surface) - expected)[~outside].max() > 0.5


def test_materials_of_a_plain_source_keep_colors_and_images(target: Asset, head: Asset) -> None:
    plain = replace(head, look=None)
    made = transfer_asset(plain, target, onto_itself(head), mask=mask_of_parts(target, ["Upper"]))
    assert made.asset.materials == (*target.materials, *head.materials)
    assert made.asset.look is None
    assert "not from glTF" in " ".join(made.notes)
    bare = replace(target, materials=(), look=None, attributes=())
    made = transfer_asset(head, bare, onto_itself(head), mask=mask_of_parts(target, ["Upper"]))
    assert (made.asset.materials, made.asset.look) == (head.materials, head.look)
    numbers = made.asset.find(MATERIALS)
    assert numbers is not None
    assert set(np.asarray(numbers.values).tolist()) == {-1, 0}


def test_a_part_is_named_by_its_joints_or_meshes(target: Asset) -> None:
    mask = mask_of_parts(target, ["Upper"])
    np.testing.assert_allclose(mask, weights_of(target.surface.vertices[:, 1])[:, 1], atol=1e-6)
    assert mask.max() == 1 > mask.min() == 0
    # Joints below belong to it.
    np.testing.assert_allclose(mask_of_parts(target, ["lower"]), 1)
    np.testing.assert_allclose(mask_of_parts(replace(target, skin=None), ["Tube"]), 1)
    with pytest.raises(MeshError, match=r"no joint or mesh 'Head': choose from 'Lower', 'Upper', 'Tube'"):
        mask_of_parts(target, ["Head"])
    with pytest.raises(MeshError, match="transfer data with joints to it first"):
        mask_of_parts(Asset(target.surface), ["Head"])


def test_a_part_keeps_its_joints(target: Asset, head: Asset) -> None:
    with pytest.raises(MeshError, match="keeps its joints and their weights: choose other data"):
        transfer_asset(head, target, onto_itself(head), ["weights"], mask=np.ones(len(target.surface.vertices)))
    with pytest.raises(ValueError, match="A mask must have a number from 0 to 1 for each"):
        transfer_asset(head, target, onto_itself(head), mask=np.ones(3))
