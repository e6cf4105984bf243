# SPDX-License-Identifier: GPL-3.0-or-later
"""A second source gives its joints and weights to a part of a target that has its own joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from skinned_tubes import LENGTH, weights_of, write_tube
from test_keep_rest import onto_itself

from zoomout_core.assets.asset import WEIGHTS, Asset
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.part_names import mask_of_parts
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.errors import MeshError

# The source is this much larger than the target.
SIZE = 3.0
# Where the third joint of the source is, relative to the length of the tube, and what it moves begins.
PLACE = 0.85
NAMES = ("Lower", "Upper", "Jaw")


def of_jaw(height: np.ndarray) -> np.ndarray:
    """(n,) weights of the third joint at heights, relative to the length."""
    return np.clip((height - PLACE + 0.1) / 0.2, 0, 1)


def read_target(path: Path, scale: float = 1.0, bend: float = 0.0) -> Asset:
    write_tube(path, scale, bend)
    return read_asset(path)


def read_source(path: Path, names: tuple[str, ...] = NAMES) -> Asset:
    """A larger tube at rest, with a third joint above the others."""
    write_tube(path)
    asset = read_asset(path)
    assert asset.skin is not None
    rest = SIZE * asset.skin.rest
    jaw = of_jaw(asset.skin.rest[:, 1] / LENGTH)[:, None]
    weights = np.column_stack([(1 - jaw) * asset.skin.weights.toarray(), jaw])
    bind = np.tile(np.eye(4), (3, 1, 1))
    bind[:, 1, 3] = -SIZE * LENGTH * np.array([0, 0.5, PLACE])
    skin = replace(
        asset.skin,
        nodes=np.array([1, 2, 2]),
        names=names,
        parents=np.array([-1, 0, 1]),
        inverse_bind=bind,
        transforms=np.tile(np.eye(4), (3, 1, 1)),
        rest=rest,
        linear=np.tile(np.eye(3), (len(rest), 1, 1)),
        weights=csr_array(weights),
    )
    return replace(asset, surface=asset.surface.with_vertices(rest), skin=skin)


def give_part(source: Asset, target: Asset, path: Path, part: str = "Upper") -> Asset:
    """Move the rig of a source into a part of a target, and read the written file."""
    mask = mask_of_parts(target, [part])
    made = transfer_asset(source, target, onto_itself(source), [WEIGHTS], move_rig=True, mask=mask)
    write_asset(made.asset, path)
    return read_asset(path)


def turn_joint(asset: Asset, name: str) -> np.ndarray:
    """(n, 3) vertices after a quarter turn of a joint about z, from its pose in the file."""
    assert asset.skin is not None
    assert asset.document is not None
    joint = asset.skin.names.index(name)
    worlds, below = asset.document.worlds()[0][asset.skin.nodes], [joint]
    for number, above in enumerate(asset.skin.parents.tolist()):
        if above in below:
            below.append(number)
    turn = np.eye(4)
    turn[:2, :2] = [[0, -1], [1, 0]]
    place = np.eye(4)
    place[:3, 3] = worlds[joint, :3, 3]
    worlds[below] = place @ turn @ np.linalg.inv(place) @ worlds[below]
    matrices = (worlds @ asset.skin.inverse_bind)[:, :3]
    return transform_points(blend_matrices(matrices, asset.skin.weights), asset.skin.rest)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_joints_of_a_part_are_added_in_their_places_and_move_it(tmp_path: Path, scale: float) -> None:
    target = read_target(tmp_path / "body.glb", scale)
    again = give_part(read_source(tmp_path / "head.glb"), target, tmp_path / "out.glb")
    assert again.skin is not None
    assert again.document is not None
    assert again.skin.names == NAMES
    assert again.skin.parents.tolist() == [-1, 0, 1]
    heights = again.document.worlds()[0][again.skin.nodes, 1, 3]
    np.testing.assert_allclose(heights, LENGTH * np.array([0, 0.5, PLACE]), atol=0.01 * LENGTH)
    seen = again.surface.vertices
    np.testing.assert_allclose(seen, target.surface.vertices, atol=1e-5)
    moved, height = turn_joint(again, "Jaw"), seen[:, 1] / LENGTH
    np.testing.assert_allclose(moved[height < 0.7], seen[height < 0.7], atol=1e-5)
    joint = np.array([0, heights[2], 0])
    top = seen[height > 0.99] - joint
    np.testing.assert_allclose(moved[height > 0.99] - joint, top @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-4)
    # The joints that both have move what they moved before.
    jaw, upper = of_jaw(height), weights_of(seen[:, 1])
    expected = np.column_stack([upper[:, 0], (1 - jaw) * upper[:, 1], jaw])
    np.testing.assert_allclose(again.skin.weights.toarray(), expected, atol=1e-4)


def test_a_target_that_is_saved_in_a_pose_keeps_it(tmp_path: Path) -> None:
    target = read_target(tmp_path / "body.glb", bend=0.7)
    again = give_part(read_source(tmp_path / "head.glb"), target, tmp_path / "out.glb")
    np.testing.assert_allclose(again.surface.vertices, target.surface.vertices, atol=1e-5)


def test_a_joint_elsewhere_of_the_same_name_is_not_shared(tmp_path: Path) -> None:
    target = read_target(tmp_path / "body.glb")
    source = read_source(tmp_path / "head.glb", ("Root", "Upper", "Lower"))
    again = give_part(source, target, tmp_path / "out.glb")
    assert again.skin is not None
    assert again.skin.names == ("Lower", "Upper", "Lower 2")
    # Weights of the source's root, which is not shared, go to the target's own joints.
    height = again.surface.vertices[:, 1]
    jaw, upper = of_jaw(height / LENGTH), weights_of(height)[:, 1]
    added, shared = upper * jaw, upper * (1 - jaw) * upper
    own = (1 - added - shared)[:, None] * np.column_stack([1 - upper, upper])
    expected = np.column_stack([own[:, 0], own[:, 1] + shared, added])
    np.testing.assert_allclose(again.skin.weights.toarray(), expected, atol=1e-4)


def test_joints_without_shared_ones_hang_from_the_joint_that_moves_the_part(tmp_path: Path) -> None:
    target = read_target(tmp_path / "body.glb")
    again = give_part(read_source(tmp_path / "head.glb", ("a", "b", "c")), target, tmp_path / "out.glb")
    assert again.skin is not None
    parent = dict(zip(again.skin.names, again.skin.parents.tolist(), strict=True))
    assert again.skin.names == ("Lower", "Upper", "b", "c")
    assert (parent["b"], parent["c"]) == (1, 2)


def test_a_part_receives_joints_only_beside_joints_of_its_own(tmp_path: Path) -> None:
    target, source = read_target(tmp_path / "body.glb"), read_source(tmp_path / "head.glb")
    mask = mask_of_parts(target, ["Upper"])
    for bare, given in ((replace(target, skin=None), source), (target, replace(source, skin=None))):
        with pytest.raises(MeshError, match=r"no weights|no joints to move|need a rigged source, and a rigged glTF"):
            transfer_asset(given, bare, onto_itself(source), [WEIGHTS], move_rig=True, mask=mask)


@pytest.mark.parametrize("damaged", ["source", "target", "source without a part"])
def test_joints_that_are_scaled_to_nothing_are_named(damaged: str, tmp_path: Path) -> None:
    source, target = read_source(tmp_path / "source.glb"), read_target(tmp_path / "target.glb")
    skin = target.skin if damaged == "target" else source.skin
    assert skin is not None
    skin.inverse_bind[1] = np.diag([1, 0, 1, 1])
    mask = None if "without" in damaged else mask_of_parts(target, ["Upper"])
    with pytest.raises(MeshError, match="The joint Upper is scaled to nothing"):
        transfer_asset(source, target, onto_itself(source), [WEIGHTS], move_rig=True, mask=mask)
