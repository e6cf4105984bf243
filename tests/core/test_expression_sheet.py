# SPDX-License-Identifier: GPL-3.0-or-later
"""A contact sheet shows source and target alike, at any place, rotation and size of the target."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zoomout_core import drawing, expression_sheet
from zoomout_core.arrays import Bytes, Floats
from zoomout_core.expression_sheet import GAP, HEIGHT, LINE, WIDTH, Head, draw_sheet, face_axes
from zoomout_core.samples.spheres import ball

# Where each key moves a head whose front is at -y, and how.
KEYS = {
    "jawOpen": ((0.0, -0.8, -0.6), (0, 0, -0.3)),
    "smileLeft": ((0.5, -0.8, -0.2), (0.1, 0, 0.2)),
    "smileRight": ((-0.5, -0.8, -0.2), (-0.1, 0, 0.2)),
    "browUp": ((0.0, -0.7, 0.7), (0, -0.3, 0.1)),
}


@pytest.fixture(autouse=True)
def _draw_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "SAMPLES", 1)


def head(count: int = 1500, seed: int = 0) -> Head:
    """A ball with four keys; every seed is another mesh."""
    made = ball(1.0, count=count, seed=seed)
    keys = {}
    for name, (place, offset) in KEYS.items():
        near = np.exp(-12 * ((made.vertices - np.array(place) / np.linalg.norm(place)) ** 2).sum(axis=1))
        keys[name] = np.where(near < 0.01, 0, near)[:, None] * np.array(offset)
    return Head(made.vertices, made.triangles, keys)


def place(other: Head, rotation: Floats, scale: float = 1.0) -> Head:
    keys = {name: scale * offsets @ rotation.T for name, offsets in other.keys.items()}
    return Head(scale * other.vertices @ rotation.T + [3, 1, 2], other.triangles, keys)


def blank(text: str, height: int, width: int) -> Bytes:
    """Draw the length of the text as a line."""
    picture = np.full((height, width, 3), 200, np.uint8)
    picture[:, : len(text)] = 0
    return picture


def tiles(sheet: Bytes) -> list[tuple[Bytes, Bytes, Bytes]]:
    """The label, the source's and the target's picture of each place for a tile, row by row."""
    height, width = LINE + HEIGHT + GAP, 2 * WIDTH + GAP
    found = []
    for top in range(GAP, sheet.shape[0] - height + 1, height):
        for left in range(GAP, sheet.shape[1] - width + 1, width):
            tile = sheet[top : top + height, left : left + width]
            pictures = tile[LINE : LINE + HEIGHT]
            found.append((tile[:LINE, : 2 * WIDTH], pictures[:, :WIDTH], pictures[:, WIDTH : 2 * WIDTH]))
    return found


def difference(one: Bytes, other: Bytes) -> float:
    return float(np.abs(one.astype(float) - other).mean())


def test_rotated_and_scaled_target_is_drawn_like_the_source() -> None:
    source, rotation = head(), Rotation.from_rotvec([0.4, 1.9, -0.8]).as_matrix()
    sheet = draw_sheet(source, place(head(1300, seed=3), rotation, 0.01), {}, blank)
    drawn = tiles(sheet)[: 1 + len(KEYS)]
    for _, left, right in drawn:
        assert difference(left, right) < 6
        assert difference(left, np.full_like(left, 247)) > 40  # there is something
    at_rest, *moved = drawn
    assert min(difference(at_rest[1], left) for _, left, _ in moved) > 0.5
    assert [int((label[0, :, 0] == 0).sum()) for label, *_ in moved] == [len(name) for name in KEYS]


def test_marked_vertices_are_red_and_missing_keys_are_labelled() -> None:
    source, target = head(), head(1300, seed=3)
    lacking = Head(target.vertices, target.triangles, {name: target.keys[name] for name in list(KEYS)[1:]})
    marks = {"browUp": np.linalg.norm(target.keys["browUp"], axis=1) > 0.1}
    drawn = tiles(draw_sheet(source, lacking, marks, blank))
    red = [int(((right[:, :, 0] > 90) & (right[:, :, 1] < 50)).sum()) for *_, right in drawn]
    assert [number for number, count in enumerate(red) if count] == [4]
    assert (drawn[1][0][0, :, 0] == 0).sum() == len("jawOpen (missing)")
    assert difference(drawn[1][2], drawn[0][2]) == 0


@pytest.mark.parametrize("angle", [0.0, 1.0, -2.5])
def test_the_front_is_where_the_keys_move(angle: float) -> None:
    turn = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    axes = face_axes(place(head(), turn))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) > 0
    assert 0.9 < axes[2] @ turn @ [0, -1, 0] < 0.96  # seen from a little to its side
    np.testing.assert_allclose(axes[1], [0, 0, 1])


def test_heads_without_common_or_without_moving_keys_are_drawn() -> None:
    source, target = head(300), head(250, seed=1)
    source = Head(source.vertices, source.triangles, {"jawOpen": source.keys["jawOpen"]})
    for keys in ({}, {"other": target.keys["jawOpen"]}, {"jawOpen": 0 * target.keys["jawOpen"]}):
        assert draw_sheet(source, Head(target.vertices, target.triangles, keys), {}, blank).shape[2] == 3


def test_only_what_a_key_changes_is_drawn_and_the_picture_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    source, drawn = head(), []

    def draw_triangles(*arguments: Any) -> Bytes:
        drawn.append(arguments[3] * arguments[4])
        return drawing.draw_triangles(*arguments)

    monkeypatch.setattr(expression_sheet, "draw_triangles", draw_triangles)
    marks = {"browUp": np.linalg.norm(source.keys["jawOpen"], axis=1) > 0.1}  # not where it moves the head
    at_rest, *pictures = tiles(draw_sheet(source, source, marks, blank))[: 1 + len(KEYS)]
    assert drawn[:2] == [WIDTH * HEIGHT] * 2
    assert 0 < min(drawn) < max(drawn[2:]) < WIDTH * HEIGHT
    for (name, offsets), (_, left, right) in zip(source.keys.items(), pictures, strict=True):
        moved = Head(source.vertices + offsets, source.triangles, {})
        whole = replace(expression_sheet._View.of(source), head=moved)
        np.testing.assert_array_equal(left, whole.at_rest)
        np.testing.assert_array_equal(right, whole.draw("", marks.get(name)))
    assert difference(at_rest[1], pictures[0][1]) > 0
