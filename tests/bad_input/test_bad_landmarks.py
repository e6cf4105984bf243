# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks that contradict each other, are repeated, or are invalid are named in a sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from creatures import creature
from interfaces import assert_refused, run

import zoomout_core as zo
from zoomout_core.cli import main
from zoomout_core.landmark_files import LandmarkSet, read_landmark_file, write_landmark_file
from zoomout_core.matching import retry
from zoomout_core.mesh.errors import MeshError
from zoomout_core.text_arguments import read_landmarks

SEARCH_AGAIN = retry._with_more_guesses  # which tests of bad input leave out
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


def test_repeated_pair_counts_once_with_a_note() -> None:
    once = zo.match(SOURCE, SOURCE, landmarks=([3, 90, 150], [3, 90, 150]), **OPTIONS)
    twice = zo.match(SOURCE, SOURCE, landmarks=([3, 90, 3, 150], [3, 90, 3, 150]), **OPTIONS)
    np.testing.assert_array_equal(once.surface_map.triangle, twice.surface_map.triangle)
    assert "Landmark 2 is the same pair as landmark 0: it counts once." in twice.notes
    assert not any("same pair" in note for note in once.notes)


def test_landmarks_that_contradict_the_map_are_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "_with_more_guesses", SEARCH_AGAIN)
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
def test_command_names_invalid_landmarks(meshes: tuple[Path, Path], lines: str, sentence: str) -> None:
    listed = meshes[0].with_name("landmarks.txt")
    listed.write_text(lines)
    output = meshes[0].with_name("map.npz")
    assert_refused(run(main, "match", *meshes, "--landmarks", listed, "-o", output), sentence)
    assert not output.exists()


# --- files of `zoomout landmarks` -------------------------------------------------------------------------------


def markups(*points: Any, **changed: Any) -> str:
    return json.dumps({"markups": [{"coordinateSystem": "LPS", "controlPoints": list(points)} | changed]})


def at(position: Any) -> str:
    return markups({"label": "Nasion", "position": position})


COLUMNS = "# CoordinateSystem = LPS\n# columns = id,x,y,z,label\n"
BROKEN = {
    ".csv": {
        "A,1,2,3mm\nB,4,5,6": "'3mm' is not a number",
        "A,1,2,3o\n": "'3o' is not a number",
        "A;1;2;3\nB;4;5;6": "separate entries by commas",
        "A\t1\t2\t3\nB\t4\t5\t6": "separate entries by commas",
        "A;0,1;0,2;0,3\nB;0,1;0,2;0,3": "is not a number",
        "5\n" + "9" * 40: "is not the number of a vertex",
        "5\n" + "9" * 5000: "is not the number of a vertex",
        "5\n3.5": "'3.5' is not the number of a vertex",
        "5\n1_0": "'1_0' is not the number of a vertex",
        "A,1,2,3\nB,1_0,2,3": "'1_0' is not a number",
        "A,5\nB,six": "'six' is not the number of a vertex",
        "A,1,2,3\n1,2,3": "its lines have 3 and 4 entries",
        "name,x,y,z,confidence\nA,1,2,3": "its lines have 4 and 5 entries",
        '"A,1,2,3\nB,4,5,6': "a quotation mark is not closed",
    },
    ".mrk.json": {
        "[" * 100_000: "it is nested too deeply",
        f'{{"a": {"[" * 700}{"]" * 700}, "markups": []}}': "it is nested too deeply",
        "null": "its markups are not a list of objects",
        "7": "its markups are not a list of objects",
        '{"markups": "abc"}': "its markups are not a list of objects",
        '{"markups": [null]}': "its markups are not a list of objects",
        markups(controlPoints=None): "its controlPoints are not a list of objects",
        markups(None): "its controlPoints are not a list of objects",
        markups({"label": "Nasion"}): "the position of 'Nasion' is not a list of three numbers",
        at([1, 2]): "the position of 'Nasion' is not a list of three numbers",
        at([[1, 2, 3]]): "the position of 'Nasion' is not a list of three numbers",
        at([True, False, True]): "the position of 'Nasion' is not a list of three numbers",
        at([10**400, 0, 0]): "the position of 'Nasion' is not a list of three numbers",
        at([1, 2, 3]).replace("LPS", "XYZ"): "its coordinate system is 'XYZ', not LPS or RAS",
    },
    ".fcsv": {
        COLUMNS.replace("LPS", "XYZ") + "1,1,2,3,A": "its coordinate system is 'XYZ', not LPS or RAS",
        COLUMNS.replace("label", "lobel") + "1,1,2,3,A": "it has no column label",
        COLUMNS.replace("x,y,z", "a,b,c") + "1,1,2,3,A": "it has no column x and y and z",
        COLUMNS + "1,1,2,3,A\n2,1,2": "a line has 3 entries instead of 5",
        COLUMNS + "1,1,two,3,A": "'two' is not a number",
    },
}


@pytest.mark.parametrize(("ending", "text"), [(ending, text) for ending, texts in BROKEN.items() for text in texts])
def test_broken_landmark_files_raise_one_sentence(ending: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / f"broken{ending}"
    path.write_text(text)
    with pytest.raises(
        MeshError, match=rf"^{path} could not be read as landmarks \([^\n]*\): check its format\.$"
    ) as error:
        read_landmark_file(path)
    assert BROKEN[ending][text] in str(error.value)


NAMES = ["#1", "a\nb", "a\n#b", 'a,"b"', "a\u2028b", "a\x0cb", "", "Gr\u00fcn"]


@pytest.mark.parametrize("ending", BROKEN)
def test_landmark_names_survive_a_round_trip(ending: str, tmp_path: Path) -> None:
    names = tuple(name or "F-7" for name in NAMES) if ending != ".csv" else tuple(NAMES)
    points = np.arange(24.0).reshape(-1, 3)
    write_landmark_file(LandmarkSet(names, points, confidence=np.ones(8)), tmp_path / f"a{ending}")
    again = read_landmark_file(tmp_path / f"a{ending}")
    assert again.names == names
    np.testing.assert_array_equal(again.points, points)


@pytest.mark.parametrize(
    "text",
    ["name,z,y,x\nA,3,2,1", "x,y,z,name\n1,2,3,A", "id,x,y,z,note,w\nA,1,2,3,b,5", "\ufeff# made by hand\nA,1,2,3\n"],
)
def test_headings_give_the_order(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    found = read_landmark_file(tmp_path / "a.csv")
    assert found.names == ("A",)
    assert found.points.tolist() == [[1, 2, 3]]


def test_lone_surrogate_in_name_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "a.mrk.json").write_text(at([1, 2, 3]).replace("Nasion", "\\ud800"))
    write_landmark_file(read_landmark_file(tmp_path / "a.mrk.json"), tmp_path / "b.mrk.json")
    assert read_landmark_file(tmp_path / "b.mrk.json").names == ("?",)


@pytest.mark.parametrize("far", [1e80, 1e160, 1e300, 1e308])
def test_huge_landmark_coordinates_are_refused(far: float, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="away from its surface: give points"):
        zo.match(SOURCE, SOURCE, landmarks=([[far, 0, 0]], [1]), **OPTIONS)
    (tmp_path / "l.csv").write_text(f"A,{far},0,0\n")
    ran = run(main, "landmarks", meshes[0], tmp_path / "l.csv", meshes[1], "-o", tmp_path / "out.csv")
    assert_refused(ran, "away from its surface: give points")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252"])
def test_pairs_in_common_encodings_are_read(encoding: str, tmp_path: Path) -> None:
    (tmp_path / "pairs.txt").write_bytes("3 4\n50 51 # Ohr, gr\u00fcn\n".encode(encoding))
    assert [each.tolist() for each in read_landmarks(str(tmp_path / "pairs.txt"))] == [[3, 50], [4, 51]]


def test_utf_16_pairs_are_refused(tmp_path: Path) -> None:
    (tmp_path / "pairs.txt").write_bytes("3 4\n50 51\n".encode("utf-16"))
    with pytest.raises(MeshError, match="save it as plain text in UTF-8"):
        read_landmarks(str(tmp_path / "pairs.txt"))
