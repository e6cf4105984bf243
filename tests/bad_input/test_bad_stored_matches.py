# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged matches in a .blend: they are reported or ignored, and matching again repairs them."""

from __future__ import annotations

import json
import zlib
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

import blender_addon
from blender_addon import api
from blender_addon.storage import stored_candidates, stored_match, stored_report, stored_symmetry
from blender_addon.ui.panels.result import ZOOMOUT_PT_result
from blender_addon.ui.panels.transfer import ZOOMOUT_PT_report
from zoomout_core.mesh.errors import MeshError


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
    "others of a number": lambda mesh: described(mesh, others=5),
    "others of numbers": lambda mesh: described(mesh, others=[5]),
    "others without a size": lambda mesh: described(mesh, others=[{"name": "Source", "fingerprint": "0"}]),
    "others under a name": lambda mesh: described(mesh, others={"name": "Source"}),
    "no sizes": lambda mesh: described(mesh, size={}),
    "a size of one number": lambda mesh: described(mesh, size={"source": [400], "target": [400]}),
    "sizes in words": lambda mesh: described(mesh, size={"source": "many", "target": "few"}),
    "no hashes": lambda mesh: described(mesh, content={}),
    "hashes of numbers": lambda mesh: described(mesh, content={"source": 1, "target": 2}),
    "nothing mirrored": lambda mesh: described(mesh, mirrored={}),
    "mirrored in words": lambda mesh: described(mesh, mirrored={"source": "no", "target": "no"}),
    "notes of numbers": lambda mesh: described(mesh, notes=[1, None]),
    "notes that are nested": lambda mesh: described(mesh, notes=[["note"]]),
    "settings of a list": lambda mesh: described(mesh, settings=[1]),
    "one share without a partner": lambda mesh: described(mesh, without_partner=[0.5]),
    "shares in words": lambda mesh: described(mesh, without_partner=["none", "none"]),
    "torn by a number": lambda mesh: described(mesh, torn=5),
    "a mask of a list": lambda mesh: described(mesh, source_has_partner=[True]),
    "a verdict of another kind": lambda mesh: described(mesh, verdict={"level": []}),
    "a bomb": lambda mesh: described(mesh, source_has_partner=bomb()),
}
# The damage that the description does not reveal.
IN_VALUES = ("negative triangles", "triangles of a larger mesh", "no numbers", "points elsewhere")


class Layout:
    """A layout that takes everything that panels draw."""

    def __getattr__(self, _: str) -> Any:
        return Layout()

    def __call__(self, *_: object, **__: object) -> Layout:
        return Layout()

    def panel(self, *_: object, **__: object) -> tuple[Layout, Layout]:
        return Layout(), Layout()


class Context:
    """Blender's context, with a sidebar of some width."""

    region = SimpleNamespace(width=300)
    style = SimpleNamespace(widget=SimpleNamespace(points=11.0))
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0), ui_styles=[style])

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


def draw_panels() -> None:
    """Draw the panels that show what is stored on the active mesh, as Blender does at each redraw."""
    for panel in (ZOOMOUT_PT_result, ZOOMOUT_PT_report):
        if panel.poll(Context()):
            panel.draw(SimpleNamespace(layout=Layout()), Context())


@pytest.mark.parametrize("name", DAMAGE)
def test_matching_again_repairs_a_damaged_match(pair: tuple[bpy.types.Object, bpy.types.Object], name: str) -> None:
    source, target = pair
    DAMAGE[name](target.data)
    draw_panels()
    if name in IN_VALUES:
        with pytest.raises(MeshError, match="The match stored on 'Target' is damaged: match again"):
            transfer(source, target)
        assert not target.vertex_groups
        match(source, target)
    transfer(source, target)  # of other damage, it matches again itself
    weights = [target.vertex_groups["Bone"].weight(vertex) for vertex in range(400)]
    np.testing.assert_allclose(weights, 1, atol=1e-3)


@pytest.mark.parametrize("name", stored_match.MATCH_ATTRIBUTES)
def test_entries_of_another_match_are_noticed(pair: tuple[bpy.types.Object, bpy.types.Object], name: str) -> None:
    source, target = pair
    values = stored_match.read_layer(target.data, name).attribute.values
    set_values(target.data, name, values[::-1].copy())
    with pytest.raises(MeshError, match="The match stored on 'Target' is damaged: match again"):
        transfer(source, target)


def test_match_of_an_earlier_version_needs_no_hash(
    pair: tuple[bpy.types.Object, bpy.types.Object],
) -> None:
    described(pair[1].data, entries=None)
    transfer(*pair)


@pytest.mark.parametrize("text", ["{", "[]", '{"candidates": 3, "chosen": 0}', "null", "ÿ"])
def test_damaged_descriptions_are_ignored(pair: tuple[bpy.types.Object, bpy.types.Object], text: str) -> None:
    _, target = pair
    for store in (stored_candidates, stored_report, stored_symmetry):
        target.data[store.PROPERTY] = text
    assert stored_candidates.read(target.data) is None
    assert stored_report.transfer_report(target) is None
    assert stored_symmetry.description(target.data) is None
    draw_panels()


CANDIDATES: dict[str, dict[str, object]] = {
    "a number beyond the last": {"chosen": 99},
    "a number below the first": {"chosen": -1},
    "a fraction": {"chosen": 0.5},
    "a word": {"chosen": "first"},
    "none": {"candidates": []},
    "numbers": {"candidates": [1, 2]},
    "no colours": {"candidates": [{"number": 0, "certainty": 1.0, "mirrored": False}]},
    "too much": {"candidates": [{"number": 0, "certainty": 1.0, "mirrored": False, "colors": "", "more": 1}]},
    "a flat box": {"box": [1.0, 1.0]},
    "a box in words": {"box": "large"},
    "points cut off": {"points": "AAAA"},
    "vertices of numbers": {"vertices": [1, 2]},
}


@pytest.mark.parametrize("name", CANDIDATES)
def test_damaged_candidate_list_is_ignored(pair: tuple[bpy.types.Object, bpy.types.Object], name: str) -> None:
    mesh, colors = pair[1].data, np.zeros((3, 3), np.uint8)
    listed = stored_candidates.ListedCandidate(0, 1.0, False, colors)
    listing = stored_candidates.CandidateList("key", 0, np.arange(3), np.zeros((3, 3)), np.ones(3), (listed,))
    stored_candidates.write(mesh, listing)
    assert stored_candidates.read(mesh) is not None
    mesh[stored_candidates.PROPERTY] = json.dumps(json.loads(mesh[stored_candidates.PROPERTY]) | CANDIDATES[name])
    assert stored_candidates.read(mesh) is None
    draw_panels()


REPORTS: dict[str, dict[str, object]] = {
    "others of a number": {"others": 5},
    "written numbers": {"written": {"vertex_groups": 5}},
    "notes of a number": {"notes": 5},
    "vertices in words": {"vertices": "many"},
    "bound to a number": {"bound": 5},
    "bound to nothing": {"bound": {}},
    "a mask of a list": {"stretched": []},
}


@pytest.mark.parametrize("name", REPORTS)
def test_damaged_report_is_ignored(pair: tuple[bpy.types.Object, bpy.types.Object], name: str) -> None:
    transfer(*pair)
    target = pair[1]
    assert stored_report.transfer_report(target) is not None
    target.data[stored_report.PROPERTY] = json.dumps(json.loads(target.data[stored_report.PROPERTY]) | REPORTS[name])
    assert stored_report.transfer_report(target) is None
    draw_panels()


def test_report_with_unknown_data_is_shown(
    pair: tuple[bpy.types.Object, bpy.types.Object],
) -> None:
    transfer(*pair)
    text = pair[1].data[stored_report.PROPERTY]
    pair[1].data[stored_report.PROPERTY] = json.dumps(json.loads(text) | {"written": {"grooms": ["hair"]}})
    assert stored_report.transfer_report(pair[1]) is not None
    draw_panels()
