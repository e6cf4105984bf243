# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks that contradict each other, are repeated, or are invalid are named in a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from creatures import creature
from doors import assert_refused, run

import zoomout_core as zo
from zoomout_core.cli import main

SOURCE = creature(300).surface
OPTIONS: dict[str, Any] = {"k_final": 20, "samples": 60, "initial": "landmarks"}
POINT = SOURCE.vertices
CONTRADICTORY = {
    "a source vertex twice": (([3, 90, 3], [4, 91, 120]), "Landmarks 0 and 2 are at the same point on the source"),
    "a target vertex twice": (([3, 90, 150], [4, 91, 91]), "Landmarks 1 and 2 are at the same point on the target"),
    "a source point twice": (
        (POINT[[3, 90, 3]], POINT[[4, 91, 120]]),
        "Landmarks 0 and 2 are at the same point on the",
    ),
    "points against a vertex": (
        (POINT[[3, 90, 150]], [4, 4, 91]),
        "Landmarks 0 and 1 are at the same point on the",
    ),
    "beside one that stands twice": (([3, 3, 3], [4, 4, 5]), "Landmarks 0 and 2 are at the same point on the source"),
}
WRONG = {
    "more of the source": (([3, 90, 150], [4, 91]), "give one on each side for every pair"),
    "of words": ((["a", "b"], [1, 2]), "andmarks"),
    "not finite": ((POINT[[3, 90]] * np.nan, [4, 91]), "finite"),
    "negative": (([-3, 90], [4, 91]), "-3"),
    "far too large": (([3, 3000], [4, 91]), "3000"),
    "none": (([], []), "no landmarks"),
    "two pairs": ([(3, 4), (90, 91)], "looks like a list of pairs"),
    "two pairs of points": ([(POINT[3], POINT[4]), (POINT[90], POINT[91])], "looks like a list of pairs"),
    "three pairs": ([(3, 4), (90, 91), (150, 120)], "looks like a list of pairs"),
    "a table of two pairs": (np.array([[3, 4], [90, 91]]), "looks like a list of pairs"),
    "a table of pairs": (np.array([[3, 4], [90, 91], [150, 120]]), "looks like a list of pairs"),
}


@pytest.mark.parametrize("case", CONTRADICTORY | WRONG)
def test_landmarks_that_cannot_be_right_are_named(case: str) -> None:
    landmarks, sentence = (CONTRADICTORY | WRONG)[case]
    with pytest.raises(ValueError, match=sentence):
        zo.match(SOURCE, SOURCE, landmarks=landmarks, **OPTIONS)


def test_a_pair_that_stands_there_twice_counts_once_and_that_is_said() -> None:
    once = zo.match(SOURCE, SOURCE, landmarks=([3, 90, 150], [3, 90, 150]), **OPTIONS)
    twice = zo.match(SOURCE, SOURCE, landmarks=([3, 90, 3, 150], [3, 90, 3, 150]), **OPTIONS)
    np.testing.assert_array_equal(once.surface_map.triangle, twice.surface_map.triangle)
    assert "Landmark 2 is the same pair as landmark 0: it counts once." in twice.notes
    assert not any("same pair" in note for note in once.notes)


def test_landmarks_that_contradict_the_map_are_noted() -> None:
    ends = [int(SOURCE.vertices[:, axis].argmax()) for axis in range(3)]
    options = {**OPTIONS, "initial": "auto"}
    right = zo.match(SOURCE, SOURCE, landmarks=(ends, ends), **options)
    assert not any("contradicts" in note for note in right.notes)
    wrong = zo.match(SOURCE, SOURCE, landmarks=(ends, np.roll(ends, 1)), **options)
    assert "The map contradicts" in wrong.notes[0]
    assert "of the 3 landmarks" in wrong.notes[0]


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        ("3 4\n90 91\n3 120\n", "Landmarks 0 and 2"),
        ("3 4\n90 91\n150 91\n", "Landmarks 1 and 2"),
        ("3\n", "not a list of landmarks (line 1)"),
        ("# source and target\n\n3 4\n90 x\n", "not a list of landmarks (line 4)"),
    ],
)
def test_the_command_names_them(meshes: tuple[Path, Path], lines: str, sentence: str) -> None:
    listed = meshes[0].with_name("landmarks.txt")
    listed.write_text(lines)
    output = meshes[0].with_name("map.npz")
    assert_refused(run(main, "match", *meshes, "--landmarks", listed, "-o", output), sentence)
    assert not output.exists()
