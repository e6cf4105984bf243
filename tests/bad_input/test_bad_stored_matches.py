# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged matches in a .blend: they are reported or ignored, and matching again repairs them."""

from __future__ import annotations

import json
import zlib
from base64 import b64encode
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np
import pytest

import blender_addon
from blender_addon import api
from blender_addon.storage import stored_candidates, stored_match, stored_report, stored_symmetry
from zoomout_core.mesh.surface import MeshError

pytestmark = pytest.mark.usefixtures("quick_search")


@pytest.fixture
def pair(meshes: tuple[Path, Path]) -> Iterator[tuple[bpy.types.Object, bpy.types.Object]]:
    """Two matched objects."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    objects = []
    for path in meshes:
        bpy.ops.wm.ply_import(filepath=str(path))
        objects.append(bpy.context.object)
    for obj, name in zip(objects, ("Source", "Target"), strict=True):
        obj.name = name
    objects[0].vertex_groups.new(name="Bone").add(range(400), 1.0, "REPLACE")
    with blender_addon.registered():
        match(*objects)
        yield objects[0], objects[1]


def match(source: bpy.types.Object, target: bpy.types.Object) -> None:
    api.match_objects(bpy.context, source, target, initial="nearest")


def transfer(source: bpy.types.Object, target: bpy.types.Object) -> None:
    api.transfer_objects(bpy.context, source, target, ["vertex_groups"], initial="nearest")


def set_values(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    attribute = mesh.attributes[name]
    attribute.data.foreach_set("vector" if values.ndim == 2 else "value", values.ravel())


def replaced(mesh: bpy.types.Mesh, name: str, kind: str, domain: str) -> None:
    mesh.attributes.remove(mesh.attributes[name])
    mesh.attributes.new(name, kind, domain)


def described(mesh: bpy.types.Mesh, **changed: object) -> None:
    mesh[stored_match.PROPERTY] = json.dumps(json.loads(mesh[stored_match.PROPERTY]) | changed)


def bomb() -> str:
    """A few kilobytes that decompress to 256 MB."""
    return b64encode(zlib.compress(bytes(1 << 28))).decode()


DAMAGE = {
    "negative triangles": lambda mesh: set_values(mesh, stored_match.TRIANGLE, np.full(400, -7, np.int32)),
    "triangles of a larger mesh": lambda mesh: set_values(mesh, stored_match.TRIANGLE, np.full(400, 1 << 30, np.int32)),
    "no numbers": lambda mesh: set_values(mesh, stored_match.BARYCENTRIC, np.full((400, 3), np.nan, np.float32)),
    "points elsewhere": lambda mesh: set_values(mesh, stored_match.BARYCENTRIC, np.ones((400, 3), np.float32)),
    "another type": lambda mesh: replaced(mesh, stored_match.TRIANGLE, "FLOAT", "POINT"),
    "of corners": lambda mesh: replaced(mesh, stored_match.CONFIDENCE, "FLOAT", "CORNER"),
    "a description cut off": lambda mesh: mesh.__setitem__(stored_match.PROPERTY, mesh[stored_match.PROPERTY][:99]),
    "a description of another kind": lambda mesh: mesh.__setitem__(stored_match.PROPERTY, 7),
    "a list for a description": lambda mesh: mesh.__setitem__(stored_match.PROPERTY, "[1, 2]"),
    "nested brackets": lambda mesh: mesh.__setitem__(stored_match.PROPERTY, "[" * 100_000),
    "fields of other types": lambda mesh: described(mesh, source=3, notes="none", vertices="many"),
    "a bomb": lambda mesh: described(mesh, source_has_partner=bomb()),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_match_is_refused_or_as_good_as_none_and_matching_again_heals_it(
    pair: tuple[bpy.types.Object, bpy.types.Object], name: str
) -> None:
    source, target = pair
    DAMAGE[name](target.data)
    stored_match.description(target.data)  # as panels do
    with suppress(MeshError):
        transfer(source, target)
    match(source, target)
    transfer(source, target)
    assert target.vertex_groups.keys() == ["Bone"]


@pytest.mark.parametrize("name", stored_match.MATCH_ATTRIBUTES)
def test_entries_of_another_match_are_noticed(pair: tuple[bpy.types.Object, bpy.types.Object], name: str) -> None:
    source, target = pair
    values = stored_match.read_layer(target.data, name).attribute.values
    set_values(target.data, name, values[::-1].copy())
    with pytest.raises(MeshError, match="The match stored on 'Target' is damaged: match again"):
        transfer(source, target)


def test_a_match_of_an_earlier_version_has_no_hash_of_its_entries(
    pair: tuple[bpy.types.Object, bpy.types.Object],
) -> None:
    described(pair[1].data, entries=None)
    transfer(*pair)


@pytest.mark.parametrize("text", ["{", "[]", '{"candidates": 3, "chosen": 0}', "null", "ÿ"])
def test_other_descriptions_that_are_damaged_are_as_good_as_none(
    pair: tuple[bpy.types.Object, bpy.types.Object], text: str
) -> None:
    _, target = pair
    for store in (stored_candidates, stored_report, stored_symmetry):
        target.data[store.PROPERTY] = text
    assert stored_candidates.read(target.data) is None
    assert stored_report.transfer_report(target) is None
    assert stored_symmetry.description(target.data) is None
