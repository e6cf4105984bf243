# SPDX-License-Identifier: GPL-3.0-or-later
"""Animations of glTF files are played like in other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib
import pytest
from skinned_tubes import write_tube

from zoomout_core.assets.gltf.play import length_of, play
from zoomout_core.mesh.formats.gltf_document import Document

UPPER = 2


@pytest.fixture
def document(tmp_path: Path) -> Document:
    write_tube(tmp_path / "tube.glb")
    return Document(tmp_path / "tube.glb")


def animate(document: Document, path: str, values: list[list[float]], interpolation: str | None) -> None:
    """Replace the animation by one of the upper joint, with keyframes at 0 and 2 seconds."""
    times = document.add_array(np.array([[0.0], [2.0]]))
    sampler = pygltflib.AnimationSampler(
        input=times, output=document.add_array(np.array(values)), interpolation=interpolation
    )
    target = pygltflib.AnimationChannelTarget(node=UPPER, path=path)
    channel = pygltflib.AnimationChannel(sampler=0, target=target)
    document.gltf.animations = [pygltflib.Animation(samplers=[sampler], channels=[channel])]


def local(document: Document, *times: float) -> np.ndarray:
    """(f, 4, 4) transforms of the upper joint relative to its parent."""
    (animation,) = document.gltf.animations
    worlds, parent = play(document, animation, np.array(times)), document.worlds()[1]
    return np.linalg.inv(worlds[:, parent[UPPER]]) @ worlds[:, UPPER]


@pytest.mark.parametrize(
    ("interpolation", "halfway"), [("LINEAR", 1.0), (None, 1.0), ("STEP", 0.0), ("CUBICSPLINE", 1.0 + 2 * (3 - 1) / 8)]
)
def test_translations_are_interpolated(document: Document, interpolation: str | None, halfway: float) -> None:
    values = [[0.0, 0, 0], [2.0, 0, 0]]
    if interpolation == "CUBICSPLINE":  # with slopes of 3 behind the first keyframe, and 1 before the second
        values = [[9.0, 0, 0], values[0], [3.0, 0, 0], [1.0, 0, 0], values[1], [9.0, 0, 0]]
    animate(document, "translation", values, interpolation)
    assert length_of(document, document.gltf.animations[0]) == 2
    places = local(document, -1, 0, 1, 2, 3)[:, 0, 3]
    np.testing.assert_allclose(places, [0, 0, halfway, 2, 2], atol=1e-6)


def test_rotations_are_interpolated_along_the_shorter_arc(document: Document) -> None:
    angle = np.radians(80)  # of half the turn
    animate(document, "rotation", [[0, 0, 0, 1], [0, 0, -np.sin(angle), -np.cos(angle)]], "LINEAR")
    turned = local(document, 0.5)[0]
    assert np.degrees(np.arctan2(turned[1, 0], turned[0, 0])) == pytest.approx(40, abs=1e-4)


@pytest.mark.parametrize("values", [[[np.nan, 0, 0, 1]] * 2, [[0, 0, 0, 0]] * 2, [[0, 0, 1, 0]]], ids=str)
def test_damaged_keyframes_are_not_played(document: Document, values: list[list[float]]) -> None:
    animate(document, "rotation", values, "LINEAR")
    np.testing.assert_allclose(local(document, 1.0)[0, :3, :3], np.eye(3), atol=1e-6)
