# SPDX-License-Identifier: GPL-3.0-or-later
"""Assets transfer to a mesh in any pose, which is then bound to the joints at rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from skinned_tubes import LENGTH, PNG, tube, weights_of, write_tube

from zoomout_core import samples
from zoomout_core.assets.asset import SHAPE_KEYS, Asset
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.report.verdict import RED, Verdict
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.rigging.rest_pose import REST, correct_by_bones
from zoomout_core.transfer.rules import map_target
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("remember_matches")


def finer_tube() -> Surface:
    """The tube with other rings and sides, closed along its seam."""
    positions, _, triangles = tube(31, 20)
    _, first, number = np.unique(np.round(positions, 9), axis=0, return_index=True, return_inverse=True)
    return Surface(positions[first], number.ravel()[triangles])


def match_at_rest(source: Asset, at_rest: np.ndarray) -> Any:
    """A match of points at rest to their closest points on the source, with full confidence."""
    assert source.skin is not None
    triangles = source.surface.triangles
    surface_map = SurfaceMap(*closest_points(at_rest, source.skin.rest, triangles), triangles)
    return SimpleNamespace(surface_map=surface_map, confidence=np.ones(len(at_rest)), has_partner=None)


def bend_points(points: np.ndarray, angle: float) -> np.ndarray:
    """Pose points by the two joints; the upper one rotates about z."""
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    joint = np.array([0, LENGTH / 2, 0])
    upper = weights_of(points[:, 1])[:, 1:]
    return (1 - upper) * points + upper * ((points - joint) @ turn.T + joint)


def posed_creature() -> tuple[Asset, samples.Creature, Surface]:
    """A rigged creature, a mesh of it with another topology, and that in another pose."""
    source, made = samples.character(2000), samples.creature(1500, 1)
    made = samples.Creature(made.surface.with_vertices(made.surface.vertices @ samples.UPRIGHT.T), made.directions)
    return source, made, samples.in_stance(made)


@pytest.mark.parametrize("stands", ["as the source", "bent otherwise, elsewhere"])
def test_target_moves_like_the_source(tmp_path: Path, stands: str) -> None:
    write_tube(tmp_path / "tube.glb", 0.1, bend=0.7, parts=2)
    source, made = read_asset(tmp_path / "tube.glb"), finer_tube()
    assert source.skin is not None
    seen = (
        bend_points(made.vertices, 0.7)
        if stands == "as the source"
        else 2 * bend_points(made.vertices, -0.4) + [5, 1, 0]
    )
    match = match_at_rest(source, 10 * made.vertices)
    carried = transfer_asset(source, Asset(made.with_vertices(seen)), match)
    write_asset(carried.asset, tmp_path / "out.glb")
    again = read_asset(tmp_path / "out.glb")
    assert again.skin is not None
    # The rest shape is the generated one, in the frame of the armature.
    off = np.linalg.norm(again.skin.rest[:, None] - 10 * made.vertices, axis=2).min(axis=1)
    assert np.median(off) < 0.01 * 10 * LENGTH
    assert off.max() < 0.05 * 10 * LENGTH
    np.testing.assert_allclose(again.skin.inverse_bind, source.skin.inverse_bind)
    expected = weights_of(again.skin.rest[:, 1] / 10)
    assert np.abs(again.skin.weights.toarray() - expected).mean() < 0.02
    assert bool(carried.notes) == (stands != "as the source")
    assert again.materials == source.materials
    keys = again.find(SHAPE_KEYS)
    assert keys is not None
    low = again.skin.rest[:, 1] < 0.25 * 10 * LENGTH
    np.testing.assert_allclose(keys.values[low, 0, 0], again.skin.rest[low, 1] / 10 / LENGTH, atol=0.05)


def test_attributes_follow_the_map_that_the_joints_correct() -> None:
    source, made, target = posed_creature()
    assert source.skin is not None
    heights = Attribute("color", Domain.POINT, Kind.COLOR, np.tile(source.skin.rest[:, 2:], 4))
    source = replace(source, attributes=(heights,))
    match = match_at_rest(source, made.surface.vertices + np.array([0, 0, 0.05]))
    errors = []
    for given, kinds in ((replace(source, skin=None), ["color"]), (source, ["color"]), (source, ["color", "weights"])):
        transferred = transfer_asset(given, Asset(target), match, kinds)
        found = transferred.asset.find("color")
        errors.append(np.median(np.abs(found.values[:, 0] - made.surface.vertices[:, 2])))
    assert max(errors[1:]) < 0.3 * errors[0]
    assert transferred.mapped is not None
    assert transferred.mapped.surface_map is not match.surface_map
    match.meet_landmarks = lambda surface_map: match.surface_map
    bent = transfer_asset(source, Asset(target), match, ["color"]).mapped
    assert bent is not None
    assert bent.surface_map is match.surface_map
    del match.meet_landmarks
    match.verdict = Verdict(RED, "It is probably wrong.", "")
    for kinds in (["color"], ["color", "weights"]):
        uncorrected = transfer_asset(source, Asset(target), match, kinds).mapped
        assert uncorrected is not None
        assert uncorrected.surface_map is match.surface_map


def test_few_vertices_suffice_to_correct_the_map() -> None:
    source, made, target = posed_creature()
    assert source.skin is not None
    mapped = map_target(match_at_rest(source, made.surface.vertices + np.array([0, 0, 0.05])), source.surface, target)
    rigged = source.surface.with_vertices(source.skin.rest), source.skin.weights, source.skin.parents
    corrected = correct_by_bones(mapped, *rigged)
    with retune(REST, coarse=300):
        by_few = correct_by_bones(mapped, *rigged)
    before, after, of_few = (
        np.linalg.norm(each.surface_map.interpolate(source.skin.rest) - made.surface.vertices, axis=1).mean()
        for each in (mapped, corrected, by_few)
    )
    assert after < 0.3 * before
    assert of_few < 1.2 * after


def test_limbs_in_another_pose_are_weighted_by_area() -> None:
    source, made, target = posed_creature()
    limbs = samples.limb_weights(made.directions)[:, 0] < 0.5
    assert limbs.mean() < 0.1 < target.share_of_area(limbs)
    match = match_at_rest(source, made.surface.vertices)
    carried = transfer_asset(source, Asset(target), match, ("weights",))
    assert "moved to the rest pose. If it was at rest, transfer again with --shape" in " ".join(carried.notes)


def test_target_keeps_data_of_other_kinds(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    source, made = read_asset(tmp_path / "tube.glb"), finer_tube()
    own = Attribute("color 0", Domain.POINT, Kind.COLOR, np.full((len(made.vertices), 4), 0.25))
    old = Attribute("uv 1", Domain.CORNER, Kind.UV, np.zeros((len(made.corner_vertex), 2)))
    carried = transfer_asset(source, Asset(made, (own, old)), match_at_rest(source, made.vertices), ["uv"])
    assert [each.name for each in carried.asset.attributes] == ["color 0", "uv 0"]
    assert carried.asset.skin is None
    assert carried.asset.materials == ()
    assert carried.received == ("uv 0",)
    with pytest.raises(MeshError, match="The source has no color: check which file is the source"):
        transfer_asset(source, Asset(made), match_at_rest(source, made.vertices), ["color"])


def test_replaced_data_of_the_target_is_reported(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb", parts=2)
    source = read_asset(tmp_path / "tube.glb")
    assert source.skin is not None
    match = match_at_rest(source, source.skin.rest)
    replaced = transfer_asset(source, source, match)
    assert "The target's own 2 materials, 2 joints, 1 animation were replaced." in replaced.notes
    assert not any("replaced" in note for note in transfer_asset(source, source, match, ["uv"]).notes)


def test_unselected_materials_are_not_copied(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    source, made = read_asset(tmp_path / "tube.glb"), finer_tube()
    carried = transfer_asset(source, Asset(made), match_at_rest(source, made.vertices), ["uv", "weights"])
    write_asset(carried.asset, tmp_path / "out.glb")
    again = read_asset(tmp_path / "out.glb")
    assert again.materials == ()
    assert again.skin is not None
    assert PNG not in (tmp_path / "out.glb").read_bytes()


def test_materials_are_copied_in_full_and_target_nodes_kept(tmp_path: Path) -> None:
    for name in ("source", "target"):
        write_tube(tmp_path / f"{name}.glb", parts=2)
    source, target = read_asset(tmp_path / "source.glb"), read_asset(tmp_path / "target.glb")
    assert source.document is not None
    source.document.gltf.materials[1].doubleSided = True
    source.document.gltf.materials[1].pbrMetallicRoughness.roughnessFactor = 0.25
    carried = transfer_asset(source, target, match_at_rest(source, target.surface.vertices), ["materials"])
    write_asset(carried.asset, tmp_path / "out.glb")
    again = read_asset(tmp_path / "out.glb")
    assert again.document is not None
    material = again.document.gltf.materials[1]
    assert (material.doubleSided, material.pbrMetallicRoughness.roughnessFactor) == (True, 0.25)
    assert again.materials == source.materials
    assert [node.name for node in again.document.gltf.nodes] == ["Armature", "Lower", "Upper", "Tube"]
    assert again.document.gltf.animations != []
    # A target without nodes receives none.
    carried = transfer_asset(
        source, Asset(target.surface), match_at_rest(source, target.surface.vertices), ["materials"]
    )
    write_asset(carried.asset, tmp_path / "out.glb")
    plain = read_asset(tmp_path / "out.glb").document
    assert plain is not None
    assert plain.gltf.materials[1].doubleSided
    assert len(plain.gltf.nodes) == 1


def test_target_shape_keys_of_other_names_are_kept(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    target = read_asset(tmp_path / "tube.glb")
    offsets = np.full((len(target.surface.vertices), 2, 3), 0.5)
    keys = Attribute(SHAPE_KEYS, Domain.POINT, Kind.OFFSET, offsets, ("Grow", "Lean"))
    source = Asset(target.surface, (keys,))
    surface_map = SurfaceMap(
        *closest_points(target.surface.vertices, source.surface.vertices, source.surface.triangles),
        source.surface.triangles,
    )
    match: Any = SimpleNamespace(surface_map=surface_map, confidence=np.ones(len(offsets)), has_partner=None)
    found = transfer_asset(source, target, match, [SHAPE_KEYS]).asset.find(SHAPE_KEYS)
    assert found is not None
    assert found.labels == ("Lean", "Grow")
    np.testing.assert_allclose(found.values, 0.5, atol=0.05)
    assert transfer_asset(source, Asset(target.surface), match).asset.find(SHAPE_KEYS).labels == ("Grow", "Lean")  # type: ignore[union-attr]


def test_target_keeps_joints_and_materials_if_the_source_has_none(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb", 0.1, bend=0.5)
    target, made = read_asset(tmp_path / "tube.glb"), finer_tube()
    assert target.skin is not None
    colors = Attribute("color 0", Domain.POINT, Kind.COLOR, np.full((len(made.vertices), 4), 0.25))
    onto = SurfaceMap(*closest_points(0.1 * target.skin.rest, made.vertices, made.triangles), made.triangles)
    match: Any = SimpleNamespace(surface_map=onto, confidence=np.ones(len(target.skin.rest)), has_partner=None)
    received = transfer_asset(Asset(made, (colors,)), target, match).asset
    write_asset(received, tmp_path / "out.glb")
    again = read_asset(tmp_path / "out.glb")
    assert again.skin is not None
    assert again.materials == target.materials
    np.testing.assert_allclose(again.surface.vertices.max(axis=0), target.surface.vertices.max(axis=0), atol=1e-5)
    assert again.find("color 0") is not None
    with pytest.raises(ValueError, match="shape is 'posed': give automatic"):
        transfer_asset(Asset(made, (colors,)), target, match, shape="posed")
