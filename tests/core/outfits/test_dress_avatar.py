# SPDX-License-Identifier: GPL-3.0-or-later
"""Clothes of one avatar on another one: place, keys and joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dolls import CHAIN, HEIGHTS, KEY
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import SHAPE_KEYS, Asset
from zoomout_core.assets.files import read_asset
from zoomout_core.assets.gltf.append import append_to_gltf
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.matching.report.verdict import AMBER, GREEN, Verdict
from zoomout_core.mesh.surface import Surface
from zoomout_core.outfits import rigged_avatar
from zoomout_core.outfits.check import REST, SPREAD, SWING, check_outfit
from zoomout_core.outfits.dress_avatar import DressedAvatar, dress_avatar
from zoomout_core.outfits.dress_file import DressedFile, OutfitName, dress_file
from zoomout_core.outfits.gltf_files import GltfFiles
from zoomout_core.outfits.parts import AvatarParts, keep_faces, split_avatar
from zoomout_core.outfits.pictures import HEIGHT, WIDTH, draw_outfit
from zoomout_core.outfits.rigged_avatar import complete_avatar
from zoomout_core.transfer.dressing.joint_alignment import JointPairs
from zoomout_core.transfer.dressing.missing_skin import PLACED_BY_BONES, PLACED_BY_SHAPE
from zoomout_core.transfer.dressing.posed_contact import POSED_CONTACT
from zoomout_core.transfer.rigging import humanoid, joint_map
from zoomout_core.tuning import retune

WIDER = np.array([1.15, 1, 1])


@pytest.fixture(scope="module")
def parts(dolls: Path) -> AvatarParts:
    return split_avatar(read_asset(dolls / "dressed.glb"))


@pytest.fixture(scope="module")
def target(dolls: Path) -> Asset:
    return split_avatar(read_asset(dolls / "naked.glb"), wears=False).body


@pytest.fixture(scope="module")
def dressed(parts: AvatarParts, target: Asset) -> DressedAvatar:
    assert parts.worn is not None
    return dress_avatar(parts.body.surface.vertices * WIDER, parts.body, parts.worn, target)


def test_joints_of_both_avatars_place_the_clothes(
    parts: AvatarParts, target: Asset, dressed: DressedAvatar, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = list[JointPairs]()

    def align(body: Surface, shape: Floats, skin: Surface, joints: JointPairs) -> Floats:
        given.append(joints)
        return shape + np.array([0, 0, 5])

    monkeypatch.setattr(rigged_avatar, "align_joints", align)
    assert parts.worn is not None
    assert target.skin is not None
    alike = replace(target, skin=replace(target.skin, names=tuple(HEIGHTS)))
    found = dress_avatar(parts.body.surface.vertices * WIDER, parts.body, parts.worn, alike)
    moved = found.clothes.surface.vertices - dressed.clothes.surface.vertices
    np.testing.assert_allclose(moved.mean(axis=0), [0, 0, 5], atol=0.1)
    (joints,) = given
    # Partners by name.
    np.testing.assert_allclose(joints.before, joints.after, atol=1e-6)
    assert joints.parents.tolist() == [-1, 0, 1]
    np.testing.assert_allclose(joints.weights.sum(axis=1), 1, atol=1e-6)


def test_clothes_grow_with_the_body(parts: AvatarParts, dressed: DressedAvatar) -> None:
    assert parts.worn is not None
    off = np.linalg.norm(dressed.clothes.surface.vertices - parts.worn.surface.vertices * WIDER, axis=1)
    assert off.mean() < 0.02  # of a height of 6
    assert dressed.notes == ("3 joints of the outfit were added to the avatar.",)


def test_parts_selected_by_patterns_keep_their_shape(parts: AvatarParts, target: Asset) -> None:
    assert parts.worn is not None
    kept = dress_avatar(
        parts.body.surface.vertices * WIDER, parts.body, parts.worn, target, keep=["SHIRT mat*", "Buckle*"]
    )
    assert kept.notes[0] == "No mesh or material of the outfit is called like 'Buckle*': nothing there was kept."
    start = np.cumsum([0, *(count for _, count in parts.worn.objects)])
    for number, (name, _) in enumerate(parts.worn.objects):
        some = slice(start[number], start[number + 1])
        rest, moved = parts.worn.surface.vertices[some], kept.clothes.surface.vertices[some]
        bent = np.linalg.norm(procrustes(rest, moved)(rest) - moved, axis=1).max()
        assert (bent < 1e-3) == (name == "Shirt")


def test_objects_named_like_hair_are_fitted_as_hair(parts: AvatarParts, dressed: DressedAvatar, target: Asset) -> None:
    assert parts.worn is not None
    (_, count), trousers = parts.worn.objects
    hair = replace(parts.worn, objects=(("Hair", count), trousers))
    found = dress_avatar(parts.body.surface.vertices * WIDER, parts.body, hair, target)
    off = np.linalg.norm(found.clothes.surface.vertices - dressed.clothes.surface.vertices, axis=1)
    assert off[:count].mean() > 3 * off[count:].mean()


def test_clothes_have_the_keys_of_the_body(dressed: DressedAvatar) -> None:
    keys = dressed.clothes.find(SHAPE_KEYS)
    assert keys is not None
    assert keys.labels == (KEY,)
    expected = 0.2 * dressed.clothes.surface.vertices * [1, 0, 0]
    assert np.linalg.norm(keys.values[:, 0] - expected, axis=1).mean() < 0.2 * np.linalg.norm(expected, axis=1).mean()


@pytest.mark.parametrize("is_target_bare", [False, True])
def test_joints_of_hidden_skin_have_partners(
    parts: AvatarParts, target: Asset, is_target_bare: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Avatars often lack the skin below clothes, so that joints such as those of legs move clothes alone."""
    monkeypatch.setattr(humanoid, "MIN_BONES", len(HEIGHTS))
    worn = parts.worn
    assert worn is not None
    assert worn.skin is not None
    assert target.skin is not None
    alike = replace(target, skin=replace(target.skin, names=tuple(HEIGHTS)))
    avatar = without_head(alike) if is_target_bare else alike
    assert worn.skin.weights[:, [2]].nnz
    found = dress_avatar(parts.body.surface.vertices * WIDER, without_head(parts.body), worn, avatar)
    assert [joint.name for joint in found.joints] == list(CHAIN)
    assert found.clothes.skin is not None
    assert found.clothes.skin.weights[:, [2]].nnz
    assert found.notes == ("3 joints of the outfit were added to the avatar.",)


def test_clothes_are_placed_by_bones_where_their_avatar_has_no_skin(
    parts: AvatarParts, target: Asset, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (humanoid, joint_map):
        monkeypatch.setattr(module, "MIN_BONES", len(HEIGHTS))
    assert complete_avatar(parts) == (parts.body, None)
    surface, worn = parts.body.surface, parts.worn
    assert worn is not None
    assert target.skin is not None
    head = keep_faces(parts.body, surface.vertices[surface.triangles][:, :, 1].min(axis=1) > HEIGHTS["Head"])
    body, clothed = complete_avatar(AvatarParts(head, worn))
    assert clothed is not None
    assert clothed.skin == len(head.surface.vertices) < len(body.surface.vertices)
    assert body.skin is not None
    assert not body.skin.weights[:, len(HEIGHTS) :].nnz  # the outfit's own joints move no skin
    alike = replace(target, skin=replace(target.skin, names=tuple(HEIGHTS)))
    shape = body.surface.vertices * WIDER
    shape[clothed.skin :] += [0, 0, 3]  # a map of skin is wrong there
    made = dress_avatar(shape, body, worn, alike, clothed=clothed)
    assert [joint.name for joint in made.joints] == list(CHAIN)
    assert made.missing_skin is not None
    assert made.missing_skin.template == PLACED_BY_BONES
    off = np.linalg.norm(made.clothes.surface.vertices - worn.surface.vertices * WIDER, axis=1)
    assert off.mean() < 0.2  # of a height of 6
    unknown = replace(target, skin=replace(target.skin, names=("A", "B", "C")))
    by_shape = dress_avatar(shape, body, worn, unknown, clothed=clothed)
    assert by_shape.missing_skin is not None
    assert by_shape.missing_skin.template == PLACED_BY_SHAPE


@pytest.mark.parametrize("level", [GREEN, AMBER])
def test_a_doubtful_verdict_names_missing_skin(
    level: str, parts: AvatarParts, target: Asset, dressed: DressedAvatar, tmp_path: Path
) -> None:
    class Files(GltfFiles):
        def dress(self, outfit: Path, avatar: Path, map_file: Path, output: Path) -> DressedFile:
            output.touch()
            triangles = target.surface.triangles, dressed.clothes.surface.triangles
            return DressedFile(checked, triangles, dressed.clothes.objects, 0, (), "No skin.")

    assert parts.worn is not None
    checked = check_outfit(parts.body.surface, parts.worn.surface, dressed, target)
    assert checked.verdict.level == GREEN
    names = [tmp_path / name for name in ("outfit.glb", "avatar.glb", "map.npz")]
    for path in names:
        path.touch()
    verdict = Verdict(level, "The match.", "")
    worn, _ = dress_file(*names, tmp_path / "out", OutfitName("outfit", "avatar"), Files(), verdict)
    assert worn.sentence == ("The match. No skin." if level == AMBER else "The match.")


def without_head(body: Asset) -> Asset:
    """A body whose joint of the head moves nothing."""
    assert body.skin is not None
    weights = body.skin.weights.toarray()
    weights[:, 1] += weights[:, 2]
    weights[:, 2] = 0
    return replace(body, skin=replace(body.skin, weights=csr_array(weights)))


def test_clothes_are_bound_to_the_joints_of_the_avatar(
    parts: AvatarParts, dressed: DressedAvatar, target: Asset
) -> None:
    skin = dressed.clothes.skin
    assert skin is not None
    assert parts.worn is not None
    assert parts.worn.skin is not None
    assert skin.names == ("J_Hips", "J_Spine", "J_Head", *CHAIN)
    # The joints have the same order here, and the bodies the same weights. Close cloth gets those of the skin.
    assert abs(skin.weights - parts.worn.skin.weights).sum(axis=1).mean() < 0.02
    own = skin.weights[:, 3:]
    assert abs(own - parts.worn.skin.weights[:, 3:]).max() < 1e-6
    assert target.document is not None
    world = [target.document.worlds()[0][0]]
    for joint, name in zip(dressed.joints, CHAIN, strict=True):
        world.append(world[-1] @ joint.matrix)
        assert np.linalg.norm(world[-1][:3, 3] - CHAIN[name] * WIDER) < 0.1
    assert [joint.parent for joint in dressed.joints] == [0, 4, 5]  # the node of the skin is before the new ones


def test_written_avatar_contains_the_clothes(dressed: DressedAvatar, target: Asset, tmp_path: Path) -> None:
    assert target.document is not None
    assert append_to_gltf(target.document, dressed.joints, dressed.clothes, tmp_path / "out.glb") == ()
    again = read_asset(tmp_path / "out.glb")
    assert [name for name, _ in again.objects] == ["Skin", "Shirt", "Trousers"]
    count = len(target.surface.vertices)
    np.testing.assert_array_equal(again.surface.vertices[:count], target.surface.vertices)
    np.testing.assert_allclose(again.surface.vertices[count:], dressed.clothes.surface.vertices, atol=1e-5)
    assert [material.name for material in again.materials] == ["skin material", "shirt material", "trousers material"]
    keys = again.find(SHAPE_KEYS)
    assert keys is not None
    assert keys.labels == (KEY,)


def test_clothes_stay_outside_of_the_skin_in_poses(parts: AvatarParts, dressed: DressedAvatar, target: Asset) -> None:
    assert parts.worn is not None
    with retune(POSED_CONTACT, depth=0.0):
        still = dress_avatar(parts.body.surface.vertices * WIDER, parts.body, parts.worn, target)
    moved = np.linalg.norm(dressed.clothes.surface.vertices - still.clothes.surface.vertices, axis=1)
    assert 1e-3 < moved.max() < 0.2  # of a height of 6
    assert dressed.clothes.skin is not None
    np.testing.assert_allclose(dressed.clothes.skin.rest, dressed.clothes.surface.vertices, atol=1e-6)


def test_an_avatar_without_joints_is_dressed(parts: AvatarParts, target: Asset) -> None:
    assert parts.worn is not None
    shape = parts.body.surface.vertices * WIDER
    made = dress_avatar(shape, parts.body, parts.worn, replace(target, skin=None))
    assert made.clothes.skin is None
    assert made.joints == ()
    checked = check_outfit(parts.body.surface, parts.worn.surface, made, replace(target, skin=None))
    assert checked.inside.keys() == {REST}


def test_clothes_without_joints_follow_the_body(parts: AvatarParts, target: Asset) -> None:
    assert parts.worn is not None
    shape = parts.body.surface.vertices * WIDER
    bare = replace(parts.body, skin=None), replace(parts.worn, skin=None)
    made = dress_avatar(shape, *bare, target)
    assert made.clothes.skin is not None
    assert target.skin is not None
    high = np.argmax(made.clothes.surface.vertices[:, 1])
    at = np.interp(made.clothes.surface.vertices[high, 1], [-0.5, 0.3, 1.2], [0, 1, 2])
    assert abs(made.clothes.skin.weights[[high]].toarray()[0] @ [0, 1, 2] - at) < 0.1


def test_check_detects_cloth_inside_the_skin(parts: AvatarParts, dressed: DressedAvatar, target: Asset) -> None:
    assert parts.worn is not None
    before = parts.body.surface, parts.worn.surface
    checked = check_outfit(*before, dressed, target)
    assert list(checked.inside) == [REST, SWING, SPREAD]
    assert max(checked.inside.values()) < 0.01
    assert checked.verdict.level == "green"
    cloth = dressed.clothes.surface
    shrunk = replace(dressed, clothes=replace(dressed.clothes, surface=cloth.with_vertices(0.9 * cloth.vertices)))
    wrong = check_outfit(*before, shrunk, target)
    assert wrong.inside[REST] > 0.4
    assert wrong.verdict.level == "amber"
    assert "of the cloth is in the skin." in wrong.verdict.line
    longer = parts.worn.surface.with_vertices(cloth.vertices / 2.5)
    assert "stretched to more than twice" in check_outfit(before[0], longer, dressed, target).verdict.line


def test_the_picture_shows_each_pose(parts: AvatarParts, dressed: DressedAvatar, target: Asset) -> None:
    assert parts.worn is not None
    checked = check_outfit(parts.body.surface, parts.worn.surface, dressed, target)
    triangles = target.surface.triangles, dressed.clothes.surface.triangles
    image = draw_outfit(checked, triangles, [count for _, count in dressed.clothes.objects])
    assert image.shape == (HEIGHT, 4 * WIDTH, 3)
    tiles = np.split(image, 4, axis=1)
    assert all((tile != tile[0, 0]).any() for tile in tiles)
    turned = draw_outfit(checked, triangles, [count for _, count in dressed.clothes.objects], 180.0)
    np.testing.assert_array_equal(turned[:, :WIDTH], image[:, WIDTH : 2 * WIDTH])
