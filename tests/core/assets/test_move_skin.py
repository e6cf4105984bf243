# SPDX-License-Identifier: GPL-3.0-or-later
"""The joints of a skin move into a mesh of other proportions, which then plays the source's animations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
from skinned_tubes import LENGTH, weights_of, write_tube
from test_transfer_asset import bend_points, finer_tube, match_at_rest

from zoomout_core.assets.asset import WEIGHTS, Asset
from zoomout_core.assets.check_rig import check_rig
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.gltf.move_skin import CUBIC
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_document import VRM_0, Document
from zoomout_core.mesh.surface import Surface

# The proportions of the target: longer and thinner.
BUILD = np.array([0.8, 1.5, 0.8])
SCALE = 0.1
UPPER = 2


@pytest.fixture
def source(tmp_path: Path) -> Asset:
    write_tube(tmp_path / "tube.glb", SCALE)
    return read_asset(tmp_path / "tube.glb")


def move(source: Asset, seen: np.ndarray, path: Path, **options: Any) -> Asset:
    """Transfer to a target of other triangles at positions (n, 3), with its rig, and read the written file."""
    made = finer_tube()
    match = match_at_rest(source, made.vertices / SCALE)
    written = transfer_asset(source, Asset(made.with_vertices(seen)), match, move_rig=True, **options).asset
    write_asset(written, path)
    return read_asset(path)


def heights_of_joints(asset: Asset) -> np.ndarray:
    """(b,) heights of joints at rest, in the unit of the scene."""
    assert asset.skin is not None
    return np.linalg.inv(asset.skin.inverse_bind)[:, 1, 3] * SCALE


def play(asset: Asset, path: str) -> np.ndarray:
    """(n, 3) the vertices at the last keyframe of the upper joint's rotation or translation."""
    assert asset.skin is not None
    assert asset.document is not None
    document, skin = asset.document.copy(), asset.skin
    (animation,) = document.gltf.animations
    for channel in animation.channels:
        if channel.target.path == path:
            sampler = animation.samplers[channel.sampler]
            values = document.array(sampler.output)
            last = values[-2 if sampler.interpolation == CUBIC else -1]
            setattr(document.gltf.nodes[channel.target.node], path, last.tolist())
    matrices = (document.worlds()[0][skin.nodes] @ skin.inverse_bind)[:, :3]
    return transform_points(blend_matrices(matrices, skin.weights), skin.rest)


def nearest_distances(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(n,) distances of places from the nearest true ones, as vertices are merged and sorted in files."""
    return np.linalg.norm(found[:, None] - truth, axis=2).min(axis=1)


def test_joints_fit_the_target_and_vertices_stay(source: Asset, tmp_path: Path) -> None:
    seen = finer_tube().vertices * BUILD
    again = move(source, seen, tmp_path / "out.glb")
    np.testing.assert_allclose(heights_of_joints(again), [0, 0.5 * 1.5 * LENGTH], atol=0.03 * LENGTH)
    assert nearest_distances(again.surface.vertices, seen).max() < 0.02 * LENGTH
    assert nearest_distances(again.skin.rest * SCALE, seen).max() < 0.02 * LENGTH


def test_animations_play_about_the_moved_joints(source: Asset, tmp_path: Path) -> None:
    again = move(source, finer_tube().vertices * BUILD, tmp_path / "out.glb")
    angle = 2 * np.arctan2(0.6, 0.8)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    joint = np.array([0, 0.5 * 1.5 * LENGTH, 0])
    rest = again.surface.vertices
    upper = weights_of(rest[:, 1] / 1.5)[:, 1:]
    expected = (1 - upper) * rest + upper * ((rest - joint) @ turn.T + joint)
    off = np.linalg.norm(play(again, "rotation") - expected, axis=1)
    assert off.mean() < 0.02 * LENGTH


def test_animations_are_compared_with_those_of_the_source(source: Asset) -> None:
    made = finer_tube()
    match = match_at_rest(source, made.vertices / SCALE)
    target = Asset(made.with_vertices(made.vertices * BUILD))
    still = transfer_asset(source, target, match, [WEIGHTS])
    moved = transfer_asset(source, target, match, [WEIGHTS], move_rig=True)
    assert not still.motions
    (motion,) = moved.motions
    assert not motion.faults
    assert moved.notes[-1].startswith("The action plays as on the source")
    lowered = moved.asset.document.copy()
    lowered.gltf.nodes[moved.asset.skin.nodes[0]].translation = [0, -1 / SCALE, 0]
    (motion,) = check_rig(source, replace(moved.asset, document=lowered), match.surface_map)
    assert motion.sinking == pytest.approx(1 / (1.5 * LENGTH / 2), rel=0.1)


def test_a_posed_target_keeps_its_size_and_is_taken_to_rest(source: Asset, tmp_path: Path) -> None:
    seen = 2 * bend_points(finer_tube().vertices, -0.4) + [5, 1, 0]
    again = move(source, seen, tmp_path / "out.glb")
    np.testing.assert_allclose(heights_of_joints(again), [0, LENGTH], atol=0.06 * LENGTH)
    truth = 2 * finer_tube().vertices
    assert np.median(nearest_distances(again.skin.rest * SCALE, truth)) < 0.03 * LENGTH


@pytest.mark.parametrize("interpolation", ["LINEAR", CUBIC])
def test_animated_translations_scale_with_the_target(tmp_path: Path, interpolation: str) -> None:
    write_tube(tmp_path / "tube.glb", SCALE)
    document = Document(tmp_path / "tube.glb")
    (animation,) = document.gltf.animations
    start, lifted, still = [0, LENGTH / 2 / SCALE, 0], [0, (LENGTH / 2 + 1) / SCALE, 0], [0, 0, 0]
    keys = [start, lifted] if interpolation == "LINEAR" else [still, start, still, still, lifted, still]
    output = document.add_array(np.array(keys, "<f4"))
    times = animation.samplers[0].input
    animation.samplers.append(pygltflib.AnimationSampler(input=times, output=output, interpolation=interpolation))
    target = pygltflib.AnimationChannelTarget(node=UPPER, path="translation")
    animation.channels.append(pygltflib.AnimationChannel(sampler=2, target=target))
    source = read_asset(tmp_path / "tube.glb")
    source = replace(source, document=document)
    again = move(source, 2 * finer_tube().vertices, tmp_path / "out.glb")
    rest = again.surface.vertices
    top = rest[:, 1] > 0.8 * rest[:, 1].max()
    np.testing.assert_allclose(
        (play(again, "translation") - rest)[top], np.tile([0, 2, 0], (top.sum(), 1)), atol=0.06 * LENGTH
    )
    if interpolation == CUBIC:
        moved = again.document.array(again.document.gltf.animations[0].samplers[-1].output)
        np.testing.assert_allclose(moved[[0, 2, 3, 5]], 0, atol=1e-5)


@pytest.mark.parametrize("is_vrm_0", [False, True])
def test_joints_rotate_with_the_surface_except_in_vrm_0(source: Asset, tmp_path: Path, is_vrm_0: bool) -> None:
    if is_vrm_0:
        source.document.gltf.extensions = {VRM_0: {}}
    made = finer_tube()
    match = match_at_rest(source, made.vertices / SCALE)
    target = Asset(made.with_vertices(bend_points(made.vertices, 0.2)))
    skin = transfer_asset(source, target, match, [WEIGHTS], "keep shape", move_rig=True).asset.skin
    lower, upper = np.linalg.inv(skin.inverse_bind)[:, :3, :3]
    assert (np.abs(upper - lower).max() < 0.02) == is_vrm_0


def test_nodes_between_joints_keep_their_transforms(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb", SCALE)
    document = Document(tmp_path / "tube.glb")
    nodes = document.gltf.nodes
    nodes.append(pygltflib.Node(name="Twist", children=[UPPER], translation=[0, LENGTH / 4 / SCALE, 0]))
    nodes[1].children, nodes[UPPER].translation = [4], None
    nodes[UPPER].matrix = np.block([[np.eye(3), np.zeros((3, 1))], [0, LENGTH / 4 / SCALE, 0, 1]]).ravel().tolist()
    first = read_asset(tmp_path / "tube.glb")
    source = replace(first, document=document)
    again = move(source, finer_tube().vertices * BUILD, tmp_path / "out.glb")
    np.testing.assert_allclose(heights_of_joints(again), [0, 0.5 * 1.5 * LENGTH], atol=0.03 * LENGTH)
    assert again.document.gltf.nodes[4].translation == nodes[4].translation
    assert nearest_distances(again.surface.vertices, finer_tube().vertices * BUILD).max() < 0.02 * LENGTH


def test_source_is_not_modified(source: Asset, tmp_path: Path) -> None:
    before = source.document.gltf.to_json()
    move(source, finer_tube().vertices * BUILD, tmp_path / "out.glb")
    assert source.document.gltf.to_json() == before


def test_skin_without_a_document_can_be_moved(source: Asset) -> None:
    alone = replace(source, document=None, nodes=(), look=None)
    made = finer_tube()
    match = match_at_rest(source, made.vertices / SCALE)
    moved = transfer_asset(alone, Asset(made.with_vertices(made.vertices * BUILD)), match, move_rig=True).asset
    np.testing.assert_allclose(heights_of_joints(moved), [0, 0.5 * 1.5 * LENGTH], atol=0.03 * LENGTH)


@pytest.mark.parametrize(("share", "idle"), [(1.0, 0), (0.2, 1)], ids=["whole", "part"])
def test_joints_that_move_nothing_in_a_part_are_noted(source: Asset, share: float, idle: int) -> None:
    made = finer_tube()
    below = made.vertices[made.triangles][:, :, 1].max(axis=1) <= share * LENGTH
    kept, corners = np.unique(made.triangles[below], return_inverse=True)
    part = Surface(made.vertices[kept] * BUILD, corners.reshape(-1, 3))
    match = match_at_rest(source, made.vertices[kept] / SCALE)
    notes = transfer_asset(source, Asset(part), match, move_rig=True).notes
    assert sum("The joint 'Upper' moves nothing" in note for note in notes) == idle


def test_a_source_without_joints_is_refused(source: Asset) -> None:
    made = finer_tube()
    match = match_at_rest(source, made.vertices / SCALE)
    with pytest.raises(MeshError, match="no joints to move"):
        transfer_asset(replace(source, skin=None), Asset(made), match, move_rig=True)
