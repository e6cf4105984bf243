# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles have the names of their objects and materials, or those of their loose parts."""

from __future__ import annotations

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.mesh.named_parts import name_parts
from zoomout_core.samples.spheres import ball

SPHERE = ball(1.0)
COUNT = len(SPHERE.triangles)
TWO = zo.Surface.joined([SPHERE, zo.Surface(0.5 * SPHERE.vertices + [0, 0, 2], SPHERE.triangles)])
OBJECT = np.repeat([0, 1], COUNT)


def labels(*arguments: object, **named: object) -> list[str]:
    """The label of each triangle of two spheres."""
    parts = name_parts(TWO, *arguments, **named)  # type: ignore[arg-type]
    return [parts.names[number].label for number in parts.number]


def test_materials_are_named_if_an_object_has_several() -> None:
    material = np.arange(2 * COUNT) % 2
    material[COUNT:] = 0
    assert labels(["Body", "Hat"], OBJECT, ["Skin", "Shirt"], material) == (
        ["Body: Skin", "Body: Shirt"] * (COUNT // 2) + ["Hat"] * COUNT
    )
    parts = name_parts(TWO, ["Body", "Hat"], OBJECT, ["Skin", "Shirt"], material)
    assert parts.names[-1] == ("Hat", "Hat", "Skin")


def test_name_of_a_single_object_is_left_out() -> None:
    found = labels(["Character"], 0, ["Skin", "Shirt"], OBJECT)
    assert found == ["Skin"] * COUNT + ["Shirt"] * COUNT
    assert labels(["Character"], 0, ["Skin"], 0) == ["Character"] * 2 * COUNT
    assert set(labels(["Character"], 0, ["Skin"], OBJECT - 1)) == {"Character", "Skin"}


def test_objects_of_equal_names_are_one_part() -> None:
    parts = name_parts(TWO, ["Body", "Body"], OBJECT, ["Skin", "Skin"], OBJECT)
    assert [each.label for each in parts.names] == ["Body"]


def test_unnamed_loose_parts_are_numbered() -> None:
    assert labels() == ["part 0"] * COUNT + ["part 1"] * COUNT
    assert labels(materials=["Skin"], material_of=np.where(OBJECT == 0, 0, -1)) == ["Skin"] * COUNT + ["part 1"] * COUNT


def test_the_loose_parts_of_named_objects_are_not_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(zo.Surface, "components")
    assert labels(["Body", "Hat"], OBJECT) == ["Body"] * COUNT + ["Hat"] * COUNT
