# SPDX-License-Identifier: GPL-3.0-or-later
"""The report lists the parts of the source by the names of their faces, and those that provide almost nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.matching.report.part_report import notes_on_parts, part_figures, without_shares
from zoomout_core.mesh.named_parts import NamedParts, name_parts
from zoomout_core.samples.spheres import ball

NAMES = ["Skin", "Shirt", "Hat", "Skin"]  # of materials


def body_and_hat() -> zo.Surface:
    """A sphere of two materials in one component, and a smaller sphere above it."""
    sphere = ball(1.0)
    return zo.Surface.joined([sphere, zo.Surface(0.5 * sphere.vertices + [0, 0, 1.2], sphere.triangles)])


def material_of(source: zo.Surface) -> Integers:
    """The upper half of the body is skin, of two slots, the lower one a shirt."""
    height, to_left = source.vertices[source.triangles].mean(axis=1)[:, ::2].T[::-1]
    material = np.where(height > 0, np.where(to_left > 0, 0, 3), 1)
    material[len(material) // 2 :] = 2
    return material


def parts_of(source: zo.Surface) -> NamedParts:
    return name_parts(source, materials=NAMES, material_of=material_of(source))


def make_match(source: zo.Surface, triangle: Integers, uncertain: tuple[int, ...] = ()) -> Any:
    """A match of the body's vertices with the first corners of triangles."""
    target = ball(1.0)
    barycentric = np.tile([1.0, 0, 0], (len(triangle), 1))
    return SimpleNamespace(
        source=source,
        target=target,
        surface_map=zo.SurfaceMap(triangle, barycentric, source.triangles),
        pair=SimpleNamespace(shares=np.array([0.8, 0.2])),
        uncertain=np.array(uncertain, dtype=int),
    )


def test_shares_follow_the_faces_used_not_component_names() -> None:
    source = body_and_hat()
    parts = parts_of(source)
    shirt = np.flatnonzero(material_of(source) == 1)[:1]
    result = make_match(source, np.repeat(shirt, len(ball(1.0).vertices)))
    figures = {each["part"]: each for each in part_figures(result, parts)}
    np.testing.assert_allclose(figures["Shirt"]["arrived"], 1)
    assert figures["Skin"]["arrived"] == figures["Hat"]["arrived"] == 0
    assert (figures["Hat"]["name"], figures["Hat"]["material"]) == (None, "Hat")
    visible = [figures[name]["visible"] for name in ("Skin", "Shirt", "Hat")]
    np.testing.assert_allclose(visible, [0.4, 0.4, 0.2], atol=0.05)
    notes = notes_on_parts(result, parts)
    assert notes == (
        "Share of the target's area by part of the source: 'Shirt' 100.0%.",
        "Almost nothing arrives from 'Skin', 'Hat'.",
    )
    # A report on a transfer repeats only the warning.
    assert without_shares(notes) == list(notes[1:])


def test_all_parts_of_a_right_map_are_listed_without_a_warning() -> None:
    source = body_and_hat()
    count = len(ball(1.0).vertices)
    triangle = np.linspace(0, len(source.triangles) - 1, count).astype(int)
    (shares,) = notes_on_parts(make_match(source, triangle), parts_of(source))
    assert all(f"'{name}' " in shares for name in NAMES)
    # The verdict doubts a loose part, although its material arrives elsewhere.
    material = material_of(source)
    material[material == 2] = 0
    doubtful = notes_on_parts(
        make_match(source, triangle[triangle < len(source.triangles) // 2].repeat(2)[:count], (1,)),
        name_parts(source, materials=NAMES, material_of=material),
    )
    assert doubtful[1:] == ("The target receives little reliable data from loose parts of 'Skin'.",)


def test_a_source_that_is_matched_as_a_single_part_has_no_list() -> None:
    source = body_and_hat()
    result = make_match(source, np.zeros(len(ball(1.0).vertices), dtype=int))
    result.pair.shares = np.ones(1)
    assert notes_on_parts(result, parts_of(source)) == ()
    assert part_figures(result, parts_of(source)) == []
