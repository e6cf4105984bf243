# SPDX-License-Identifier: GPL-3.0-or-later
"""`zoomout update` carries changes of a source to assets derived from it, and nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from creatures import creature
from scipy.sparse import csr_array
from skinned_tubes import write_tube

import zoomout_core as zo
from zoomout_core.assets.asset import SHAPE_KEYS, Asset
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.lods import with_fewer_weights
from zoomout_core.assets.stored_map import digest_of, same_triangles, stored_map_from
from zoomout_core.assets.update_asset import changed_kinds, update_asset
from zoomout_core.cli import main
from zoomout_core.mesh.errors import MeshError
from zoomout_core.samples import character, scan
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

pytestmark = pytest.mark.usefixtures("remember_matches")


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, list(map(str, arguments)))
    return result.exit_code, result.stdout + (result.stderr if result.exit_code else "")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sample character, `old.glb`, and `scan.glb`, transferred from it with its map."""
    folder = tmp_path_factory.mktemp("update")
    write_asset(character(2000), folder / "old.glb")
    write_asset(Asset(scan(2000).surface), folder / "scan.ply")
    code, said = run(
        "transfer",
        folder / "old.glb",
        folder / "scan.ply",
        "-o",
        folder / "scan.glb",
        "--keep-map",
        "--detail",
        "fast",
        "--cache",
        "off",
    )
    assert code == 0, said
    return folder


def edit(old: Asset) -> Asset:
    """The same character with a higher atlas, one more key, and weights of one joint given to another."""
    attributes = []
    for each in old.attributes:
        if each.name == "uv 0":
            each = replace(each, values=np.asarray(each.values) * 0.5 + 0.25)
        attributes.append(each)
    keys = old.find(SHAPE_KEYS)
    lift = np.tile([0.0, 0.0, 0.1], (len(old.surface.vertices), 1, 1))
    if keys is None:
        attributes.append(Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, lift, ("lift",)))
    else:
        values = np.concatenate([keys.values, lift], axis=1)
        attributes = [each for each in attributes if each is not keys]
        attributes.append(replace(keys, values=values, labels=(*keys.labels, "lift")))
    assert old.skin is not None
    weights = csr_array(old.skin.weights).tolil()
    weights[:, [1]] = weights[:, [1]] + weights[:, [2]]
    weights[:, [2]] = 0
    return replace(old, attributes=tuple(attributes), skin=replace(old.skin, weights=csr_array(weights)))


def test_update_transfers_changes_and_keeps_the_rest(made: Path, tmp_path: Path) -> None:
    old = read_asset(made / "old.glb")
    write_asset(edit(old), tmp_path / "new.glb")
    code, said = run(
        "update", made / "old.glb", tmp_path / "new.glb", made / "scan.glb", "-o", tmp_path / "scan.glb", "--json"
    )
    assert code == 0, said
    report = json.loads(said)
    assert report["changed"] == ["uv", "shape keys", "weights"]
    assert report["targets"][0]["transferred"] == ["uv 0", "shape keys", "skin weights"]

    before, after = read_asset(made / "scan.glb"), read_asset(tmp_path / "scan.glb")
    assert before.skin is not None
    assert after.skin is not None
    order = same_order(before, after)
    np.testing.assert_allclose(after.skin.rest[order], before.skin.rest, atol=1e-6)
    first, second = before.skin.weights.toarray(), after.skin.weights.toarray()[order]
    # Where a vertex had as many joints as it may have, one more fits now.
    assert np.abs(second[:, 1] - first[:, 1] - first[:, 2]).mean() < 0.01
    assert second[:, 2].max() < 1e-6
    keys = after.find(SHAPE_KEYS)
    assert keys is not None
    assert "lift" in keys.labels
    lift = np.asarray(keys.values)[:, keys.labels.index("lift")]
    assert np.linalg.norm(lift, axis=1).mean() > 0.05
    uvs = [asset.find("uv 0") for asset in (before, after)]
    low, high = [np.sort(np.asarray(uv.values), axis=0) for uv in uvs if uv is not None]
    assert np.abs(np.median(high, axis=0) - (np.median(low, axis=0) * 0.5 + 0.25)).max() < 0.02
    # It can be updated again, from the new source.
    assert after.stored_map is not None
    assert after.stored_map.source == digest_of(read_asset(tmp_path / "new.glb").surface)


def test_an_update_keeps_the_limit_of_weights(made: Path) -> None:
    old = read_asset(made / "old.glb")
    updated = update_asset(old, edit(old), with_fewer_weights(read_asset(made / "scan.glb"), 2)).asset
    assert updated.skin is not None
    assert np.diff(csr_array(updated.skin.weights).indptr).max() == 2


def test_a_limit_of_weights_that_the_source_had_itself_is_kept(tmp_path: Path) -> None:
    """A limit of levels by which no vertex lost a joint, until the new source has more of them."""
    old = character(600)
    assert old.skin is not None
    old = with_fewer_weights(old, 2)
    write_asset(old, tmp_path / "old.glb")
    options = "-o", tmp_path, "--ratios", 0.5, "--max-weights", 2, "--keep-map"
    code, said = run("lods", tmp_path / "old.glb", *options)
    assert code == 0, said
    before, level = (read_asset(tmp_path / f"{name}.glb") for name in ("old", "old_LOD1"))
    assert before.skin is not None
    count = len(before.skin.names)
    spread = csr_array(before.skin.weights @ (0.6 * np.eye(count) + 0.4 / count))
    now = with_fewer_weights(replace(before, skin=replace(before.skin, weights=spread)), 4)
    updated = update_asset(before, now, level).asset
    assert updated.skin is not None
    assert np.diff(csr_array(updated.skin.weights).indptr).max() == 2
    assert updated.stored_map is not None
    assert updated.stored_map.max_weights == 2


@pytest.mark.parametrize("limit", [0, -1, 2.5, True, "2"])
def test_a_damaged_limit_of_weights_is_ignored(limit: object) -> None:
    rows = np.array([[0, 0.2, 0.2, 1.0]])
    stored = stored_map_from(rows, {"source": "", "kinds": [], "max_weights": limit})
    assert stored is not None
    assert stored.max_weights is None


def test_updates_keep_own_edits_of_what_did_not_change(made: Path) -> None:
    old, derived = read_asset(made / "old.glb"), read_asset(made / "scan.glb")
    first, keys = edit(old), np.zeros((len(derived.surface.vertices), 2, 3))
    uv, own = derived.find("uv 0"), np.array(keys)
    assert uv is not None
    own[:, 0] = 0.3
    attributes = (
        *derived.attributes,
        replace(uv, name="uv 1"),
        Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, own, ("smile", "lift")),
    )
    assert derived.skin is not None
    painted = np.tile(np.eye(len(derived.skin.names))[-2:].mean(axis=0), (len(own), 1))
    skin = replace(derived.skin, weights=csr_array(painted))
    mine = replace(derived, attributes=attributes, skin=skin)
    stored = mine.stored_map
    assert stored is not None
    mine = replace(mine, stored_map=replace(stored, kinds=(*stored.kinds, SHAPE_KEYS)))

    updated = update_asset(with_keys(old, smile=0.1), with_keys(first, smile=0.1), mine).asset
    found = {each.name: each for each in updated.attributes}
    np.testing.assert_array_equal(found["uv 1"].values, uv.values)
    assert np.abs(np.asarray(found["uv 0"].values) - uv.values).max() > 0.1
    assert found[SHAPE_KEYS].labels == ("smile", "lift")
    np.testing.assert_array_equal(found[SHAPE_KEYS].values[:, 0], own[:, 0])
    assert np.linalg.norm(found[SHAPE_KEYS].values[:, 1], axis=1).mean() > 0.05
    assert updated.skin is not None
    weights = updated.skin.weights.toarray()
    kept = (weights == painted).all(axis=1)
    assert 0.3 < kept.mean() < 0.95
    assert derived.skin.weights.toarray()[kept, 2].max() < 0.01
    assert weights[~kept, 2].max() < 1e-6


def with_keys(asset: Asset, **lifts: float) -> Asset:
    """An asset with keys that lift everything, before those that it has."""
    offsets = np.zeros((len(asset.surface.vertices), len(lifts), 3))
    offsets[:, :, 2] = list(lifts.values())
    labels, own = tuple(lifts), asset.find(SHAPE_KEYS)
    if own is not None:
        offsets, labels = np.concatenate([offsets, own.values], axis=1), (*labels, *own.labels)
    others = tuple(each for each in asset.attributes if each is not own)
    return replace(asset, attributes=(*others, Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, offsets, labels)))


def test_data_that_the_source_lost_stays_and_is_noted(made: Path) -> None:
    old, derived = read_asset(made / "old.glb"), read_asset(made / "scan.glb")
    bare = replace(old, attributes=tuple(each for each in old.attributes if each.name != "uv 0"))
    updated = update_asset(old, bare, derived)
    assert updated.asset.find("uv 0") is derived.find("uv 0")
    assert [str(note) for note in updated.notes] == ["The source no longer has uv 0: the updated file still does."]


def test_changed_weights_need_the_same_joints(made: Path) -> None:
    old = read_asset(made / "old.glb")
    with pytest.raises(MeshError, match="joints of the source have changed"):
        update_asset(old, edit(old), replace(read_asset(made / "scan.glb"), skin=None))


def test_files_in_a_folder_with_a_dot_keep_their_format(made: Path, tmp_path: Path) -> None:
    write_asset(edit(read_asset(made / "old.glb")), tmp_path / "new.glb")
    write_asset(read_asset(made / "scan.glb"), tmp_path / "scan.gltf")
    (tmp_path / "levels.v1").mkdir()
    code, said = run(
        "update", made / "old.glb", tmp_path / "new.glb", tmp_path / "scan.gltf", "-o", tmp_path / "levels.v1"
    )
    assert code == 0, said
    assert read_asset(tmp_path / "levels.v1" / "scan.gltf").stored_map is not None


def same_order(before: Asset, after: Asset) -> np.ndarray:
    """(n,) the vertex of the second asset at the rest place of each of the first."""
    assert before.skin is not None
    assert after.skin is not None
    distance = np.linalg.norm(before.skin.rest[:, None] - after.skin.rest[None], axis=2)
    assert distance.min(axis=1).max() < 1e-5
    return np.argmin(distance, axis=1)


def test_stored_map_survives_the_file(made: Path) -> None:
    old, scan = read_asset(made / "old.glb"), read_asset(made / "scan.glb")
    stored = scan.stored_map
    assert stored is not None
    assert stored.source == digest_of(old.surface)
    assert len(stored.triangle) == len(scan.surface.vertices)
    assert old.skin is not None
    assert scan.skin is not None
    rest = old.surface.with_vertices(old.skin.rest)
    places = stored.on(rest).surface_map.interpolate(rest.vertices)
    assert np.linalg.norm(places - scan.skin.rest, axis=1).mean() < 0.05 * np.sqrt(rest.area)


def test_triangles_are_found_after_reordering_and_splitting() -> None:
    surface = creature(300).surface
    random = np.random.default_rng(0)
    order, shift = random.permutation(len(surface.triangles)), random.integers(0, 3, len(surface.triangles))
    corners = surface.triangles[order][np.arange(len(order))[:, None], (np.arange(3) + shift[:, None]) % 3]
    split = zo.Surface(surface.vertices[corners.ravel()], np.arange(corners.size).reshape(-1, 3))
    triangle, position = same_triangles(surface, split)
    np.testing.assert_array_equal(order[triangle], np.arange(len(order)))
    there = split.vertices[np.take_along_axis(split.triangles[triangle], position, axis=1)]
    np.testing.assert_array_equal(there, surface.vertices[surface.triangles])


def test_unchanged_data_is_not_transferred(made: Path, tmp_path: Path) -> None:
    old = read_asset(made / "old.glb")
    assert changed_kinds(old, old, ["uv", "materials", "weights", "shape keys", "color"]) == []
    code, said = run("update", made / "old.glb", made / "old.glb", made / "scan.glb", "-o", tmp_path / "out.glb")
    assert code == 1
    assert "there is nothing to update" in said


@pytest.mark.parametrize("paint", [False, True])
def test_pose_of_the_file_does_not_count_as_a_change(paint: bool, tmp_path: Path) -> None:
    """In the pose of the file, shape keys rotate with the joints, also by new weights."""
    write_tube(tmp_path / "straight.glb")
    write_tube(tmp_path / "bent.glb", bend=1.0)
    before, now = read_asset(tmp_path / "straight.glb"), read_asset(tmp_path / "bent.glb")
    if paint:
        assert now.skin is not None
        weights = csr_array(now.skin.weights[:, [1, 0]])
        write_asset(replace(now, skin=replace(now.skin, weights=weights)), tmp_path / "painted.glb")
        now = read_asset(tmp_path / "painted.glb")
    assert changed_kinds(before, now, ["uv", "shape keys", "weights"]) == (["weights"] if paint else [])


def test_impossible_updates_are_reported(made: Path, tmp_path: Path) -> None:
    old = read_asset(made / "old.glb")
    write_asset(edit(old), tmp_path / "new.glb")
    code, said = run("update", made / "old.glb", tmp_path / "new.glb", made / "old.glb", "-o", tmp_path / "out.glb")
    assert code == 1
    assert "stores no map of its source" in said
    assert old.skin is not None
    taller = old.skin.rest * np.where(old.skin.rest[:, [1]] > 0.5, [1, 1.2, 1], 1)
    for name, asset in (("taller", old), ("edited", edit(old))):
        assert asset.skin is not None
        write_asset(replace(asset, skin=replace(asset.skin, rest=taller)), tmp_path / f"{name}.glb")
    sources = tmp_path / "taller.glb", tmp_path / "edited.glb"
    code, said = run("update", *sources, made / "scan.glb", "-o", tmp_path / "out.glb")
    assert code == 1
    assert "is of another source" in said
    code, said = run("update", made / "old.glb", sources[1], made / "scan.glb", "-o", tmp_path / "out.glb")
    assert code == 1
    assert "The shape of the source was edited" in said
    assert not (tmp_path / "out.glb").exists()


def test_a_map_is_stored_in_gltf_only(made: Path, tmp_path: Path) -> None:
    code, said = run("transfer", made / "old.glb", made / "scan.ply", "-o", tmp_path / "out.ply", "--keep-map")
    assert code == 2
    assert "--keep-map needs an output in glTF" in said
