# SPDX-License-Identifier: GPL-3.0-or-later
"""Spring bones and their colliders are copied to avatars of both versions of VRM, in the axes of their bones."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_append_gltf import hat_of
from vrm_files import BONES, HAIR, replace_tree, tree_of, write_avatar
from vrm_validator import faults

from zoomout_core.assets.files import read_asset
from zoomout_core.assets.gltf.append import NewJoint, append_to_gltf
from zoomout_core.assets.gltf.springs import Partner, copy_springs
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.mesh.formats.gltf_document import Document

HEAD = 1 + list(BONES).index("head")
VERSIONS = list(product((0, 1), (0, 1)))
PLACE, RADIUS = np.array([0.1, 0.2, 0.3]), 0.05
# From the axes of a bone to those of its partner: turned, of twice the size, and elsewhere.
AXES = np.eye(4)
AXES[:3, :3] = 2 * nearest_rotations(np.arange(9.0).reshape(3, 3) % 5)
AXES[:3, 3] = 1, -2, 3


def as_lists(values: Any) -> Any:
    """Offsets of VRM 0 as places in the axes of glTF; those of VRM 1 as they are."""
    return [values["x"], values["y"], -values["z"]] if isinstance(values, dict) else values


def tree(version: int, names: tuple[tuple[str, int], ...]) -> dict[str, Any]:
    """A document of a version without springs, whose nodes have names and parents."""
    nodes: list[dict[str, Any]] = [
        {"name": name, "matrix": np.eye(4).ravel().tolist()} | ({"children": below} if below else {})
        for at, (name, _) in enumerate(names)
        for below in [[child for child, (_, parent) in enumerate(names) if parent == at]]
    ]
    for node in nodes:
        node["matrix"][13] = -0.1
    return {"nodes": nodes, "extensions": {"VRM": {}} if version == 0 else {"VRMC_vrm": {}}}


def springs(version: int, node: int = 0, chain: tuple[int, ...] = (1, 2)) -> dict[str, Any]:
    """A document of a version with a chain of nodes that collides with a sphere of another one."""
    if version == 0:
        x, y, z = PLACE.tolist()
        animation = {
            "colliderGroups": [
                {"node": node, "colliders": [{"offset": {"x": x, "y": y, "z": -z}, "radius": RADIUS}]},
                {"node": node, "colliders": []},
            ],
            "boneGroups": [
                {
                    "comment": "Tail",
                    "stiffiness": 0.7,
                    "gravityPower": 0.2,
                    "gravityDir": {"x": 0, "y": -0.8, "z": 0.6},
                    "dragForce": 0.3,
                    "hitRadius": 0.02,
                    "center": -1,
                    "bones": [chain[0]],
                    "colliderGroups": [1, 0],
                }
            ],
        }
        return {"extensions": {"VRM": {"secondaryAnimation": animation}}}
    values = {"stiffness": 0.7, "gravityPower": 0.2, "gravityDir": [0, -0.8, 0.6], "dragForce": 0.3, "hitRadius": 0.02}
    return {
        "extensions": {
            "VRMC_springBone": {
                "colliders": [{"node": node, "shape": {"sphere": {"offset": PLACE.tolist(), "radius": RADIUS}}}],
                "colliderGroups": [{"colliders": [0]}],
                "springs": [
                    {"name": "Tail", "joints": [{"node": each, **values} for each in chain], "colliderGroups": [0]}
                ],
            }
        }
    }


def spring_of(made: dict[str, Any]) -> dict[str, Any]:
    """The values, with their names in VRM 1, and colliders (node, place, radius) of the only chain."""
    if "VRM" in made["extensions"]:
        animation = made["extensions"]["VRM"]["secondaryAnimation"]
        (chain,) = animation["boneGroups"]
        values = chain | {"stiffness": chain["stiffiness"], "name": chain["comment"]}
        values["gravityDir"] = list(chain["gravityDir"].values())
        groups = [animation["colliderGroups"][each] for each in chain["colliderGroups"]]
        parts = [(each["node"], part) for each in groups for part in each["colliders"]]
        near = [(node, as_lists(part["offset"]), part["radius"]) for node, part in parts]
    else:
        given = made["extensions"]["VRMC_springBone"]
        (spring,) = given["springs"]
        values = spring["joints"][0] | {"name": spring["name"]}
        numbers = [number for each in spring["colliderGroups"] for number in given["colliderGroups"][each]["colliders"]]
        touched = [given["colliders"][each] for each in numbers]
        near = [(each["node"], *each["shape"]["sphere"].values()) for each in touched]
    return {name: values[name] for name in ("name", "stiffness", "gravityPower", "dragForce", "gravityDir")} | {
        "hitRadius": values["hitRadius"],
        "colliders": near,
    }


NODES = (("Hips", -1), ("Tail 1", 0), ("Tail 2", 1))
COPIES = {1: Partner(1, np.diag([3, 3, 3, 1])), 2: Partner(2, np.diag([3, 3, 3, 1]))}


@pytest.mark.parametrize(("given", "wanted"), VERSIONS)
def test_colliders_take_the_axes_and_size_of_the_partner(given: int, wanted: int) -> None:
    made = tree(wanted, NODES)
    assert copy_springs(made, springs(given), COPIES, {0: Partner(0, AXES)}) == []
    found = spring_of(made)
    ((node, place, radius),) = found["colliders"]
    assert (node, radius) == (0, pytest.approx(2 * RADIUS))
    np.testing.assert_allclose(place, AXES[:3, :3] @ PLACE + AXES[:3, 3])
    assert found["hitRadius"] == pytest.approx(3 * 0.02)


@pytest.mark.parametrize(("given", "wanted"), VERSIONS)
def test_chains_swing_alike_in_both_versions(given: int, wanted: int) -> None:
    made = tree(wanted, NODES)
    copy_springs(made, springs(given), COPIES, {0: Partner(0)})
    found = spring_of(made)
    assert [found[name] for name in ("name", "stiffness", "gravityPower", "dragForce")] == ["Tail", 0.7, 0.2, 0.3]
    # Avatars of the two versions face opposite directions.
    np.testing.assert_allclose(found["gravityDir"], [0, -0.8, 0.6 if given == wanted else -0.6], atol=1e-12)


@pytest.mark.parametrize(("given", "wanted"), [(0, 1), (1, 0)])
def test_files_with_converted_springs_are_valid(given: int, wanted: int, tmp_path: Path) -> None:
    outfit, path, output = (tmp_path / f"{name}.vrm" for name in ("outfit", "avatar", "output"))
    write_avatar(outfit, given)
    write_avatar(path, wanted)
    document = Document(path)
    first, step = len(document.gltf.nodes), np.eye(4)
    step[1, 3] = -0.1
    joints = [NewJoint(f"Hair {at}", first + at - 1 if at else HEAD, step, HAIR + at) for at in range(3)]
    notes = append_to_gltf(document, joints, hat_of(read_asset(outfit)), output, {HEAD: Partner(HEAD)})
    assert not any("spring" in note for note in notes)
    assert faults(output) == []
    extensions = tree_of(output)["extensions"]
    if wanted == 0:
        assert extensions["VRM"]["secondaryAnimation"]["boneGroups"][-1]["bones"] == [first]
    else:
        assert [each["node"] for each in extensions["VRMC_springBone"]["springs"][-1]["joints"]] == list(
            range(first, first + 4)
        )
        # As in VRM 0, the last node swings with an end 7 cm beyond it.
        worlds, parents = Document(output).worlds()
        assert parents[first + 3] == first + 2
        np.testing.assert_allclose(worlds[first + 3, :3, 3] - worlds[first + 2, :3, 3], [0, -0.07, 0], atol=1e-9)


def test_every_branch_of_a_chain_swings_once() -> None:
    nodes = (("Hips", -1), ("Root", 0), ("Left", 1), ("Right", 1), ("Left tip", 2))
    copies = {number: Partner(number) for number in range(1, 5)}
    made = tree(1, nodes)
    copy_springs(made, springs(0), copies, {})
    given = made["extensions"]["VRMC_springBone"]["springs"]
    assert [[joint["node"] for joint in each["joints"]] for each in given] == [[1, 2, 4, 5], [3, 6]]
    # Empty tables are not valid.
    assert set(made["extensions"]["VRMC_springBone"]) == {"specVersion", "springs"}
    # In VRM 0, the root has all of them.
    back = tree(0, nodes)
    branches = springs(1, chain=(1, 2, 4))
    branches["extensions"]["VRMC_springBone"]["springs"].append({"joints": [{"node": 3}]})
    copy_springs(back, branches, copies, {})
    assert [each["bones"] for each in back["extensions"]["VRM"]["secondaryAnimation"]["boneGroups"]] == [[1]]


@pytest.mark.parametrize("roots", [[1, 1], [1, 2], [2, 1]])
def test_nodes_of_overlapping_chains_swing_once(roots: list[int]) -> None:
    made, given = tree(1, NODES), springs(0)
    (chains,) = given["extensions"]["VRM"]["secondaryAnimation"]["boneGroups"]
    given["extensions"]["VRM"]["secondaryAnimation"]["boneGroups"] = [{**chains, "bones": [root]} for root in roots]
    copy_springs(made, given, COPIES, {})
    found = made["extensions"]["VRMC_springBone"]["springs"]
    assert [[joint["node"] for joint in each["joints"]] for each in found] == [[1, 2, 3]]


def test_branches_with_a_common_root_become_one_chain() -> None:
    made, given = tree(0, (("Hips", -1), ("Root", 0), ("Left", 1), ("Right", 1))), springs(1)
    branch = {"joints": [{"node": 1}, {"node": 3}]}
    given["extensions"]["VRMC_springBone"]["springs"].append(branch)
    copy_springs(made, given, {number: Partner(number) for number in (1, 2, 3)}, {})
    assert [each["bones"] for each in made["extensions"]["VRM"]["secondaryAnimation"]["boneGroups"]] == [[1]]


@pytest.mark.parametrize("version", [0, 1])
def test_springs_of_the_avatar_keep_their_numbers(version: int) -> None:
    made = tree(version, NODES)
    copy_springs(made, springs(version), COPIES, {0: Partner(0)})
    one, groups = spring_of(made), "colliderGroups"
    copy_springs(made, springs(version), COPIES, {0: Partner(0, AXES)})
    rows = made["extensions"]["VRM"]["secondaryAnimation"] if version == 0 else made["extensions"]["VRMC_springBone"]
    table = "boneGroups" if version == 0 else "springs"
    both = rows[table]
    for chain, place in zip(both, (PLACE, AXES[:3, :3] @ PLACE + AXES[:3, 3]), strict=True):
        rows[table] = [chain]
        ((_, found, _),) = spring_of(made)["colliders"]
        np.testing.assert_allclose(found, place)
    rows[table] = both[:1]
    assert spring_of(made) == one
    assert len(rows[groups]) == 2 * (2 - version)


def test_thin_capsules_become_few_spheres() -> None:
    made, given = tree(0, NODES), springs(1)
    given["extensions"]["VRMC_springBone"]["colliders"][0]["shape"] = {
        "capsule": {"offset": [0, 0, 0], "radius": 0, "tail": [0, 0, 1]}
    }
    copy_springs(made, given, COPIES, {0: Partner(0)})
    assert len(spring_of(made)["colliders"]) < 50


def test_ends_of_chains_have_no_values() -> None:
    made, given = tree(0, NODES), springs(1)
    given["extensions"]["VRMC_springBone"]["springs"][0]["joints"][-1] = {"node": 2}
    assert copy_springs(made, given, COPIES, {0: Partner(0)}) == []


def test_capsules_become_spheres_along_them() -> None:
    made, given = tree(0, NODES), springs(1)
    given["extensions"]["VRMC_springBone"]["colliders"][0]["shape"] = {
        "capsule": {"offset": [0, 0, 0], "radius": 0.1, "tail": [0, 0, 0.2]}
    }
    assert copy_springs(made, given, COPIES, {0: Partner(0)}) == []
    assert [place for _, place, _ in spring_of(made)["colliders"]] == [[0, 0, 0], [0, 0, 0.1], [0, 0, 0.2]]


def test_losses_in_version_0_are_reported() -> None:
    made, given = tree(0, NODES), springs(1, chain=(1, 2, 2))
    rows = given["extensions"]["VRMC_springBone"]
    rows["springs"][0]["joints"][1]["stiffness"] = 0.1
    rows["colliders"][0]["extensions"] = {"VRMC_springBone_extended_collider": {"shape": {"plane": {}}}}
    notes = copy_springs(made, given, COPIES, {0: Partner(0)})
    assert notes == [
        "Each chain of spring bones has the values of its first joint, because VRM 0 has one set for all.",
        "Colliders that are not spheres or capsules were left out, because VRM 0 has only spheres.",
    ]
    assert spring_of(made)["colliders"] == []


def test_planes_turn_with_the_partner() -> None:
    made, given = tree(1, NODES), springs(1)
    plane = {"offset": PLACE.tolist(), "normal": [0, 0, 1]}
    given["extensions"]["VRMC_springBone"]["colliders"][0]["extensions"] = {
        "VRMC_springBone_extended_collider": {"shape": {"plane": plane}}
    }
    copy_springs(made, given, COPIES, {0: Partner(0, AXES)})
    (collider,) = made["extensions"]["VRMC_springBone"]["colliders"]
    found = collider["extensions"]["VRMC_springBone_extended_collider"]["shape"]["plane"]
    np.testing.assert_allclose(found["normal"], AXES[:3, 2] / 2)
    np.testing.assert_allclose(found["offset"], AXES[:3, :3] @ PLACE + AXES[:3, 3])


@pytest.mark.parametrize("wanted", [0, 1])
@pytest.mark.parametrize("value", [None, "far", [1, 2], {"x": "far"}])
def test_offsets_that_are_no_vectors_count_as_zero(value: object, wanted: int) -> None:
    made, given = tree(wanted, NODES), springs(0)
    given["extensions"]["VRM"]["secondaryAnimation"]["colliderGroups"][0]["colliders"][0]["offset"] = value
    copy_springs(made, given, COPIES, {0: Partner(0, AXES)})
    ((_, place, _),) = spring_of(made)["colliders"]
    np.testing.assert_allclose(place, AXES[:3, 3])


def test_outfits_without_springs_add_none(tmp_path: Path) -> None:
    write_avatar(tmp_path / "outfit.vrm", 0)
    given = tree_of(tmp_path / "outfit.vrm")
    del given["extensions"]["VRM"]["secondaryAnimation"]
    replace_tree(tmp_path / "outfit.vrm", given)
    made = tree(1, NODES)
    assert copy_springs(made, tree_of(tmp_path / "outfit.vrm"), COPIES, {}) == []
    assert "VRMC_springBone" not in made["extensions"]
