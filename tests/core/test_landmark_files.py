# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of landmarks keep names, positions, coordinate system and all else that Slicer writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.landmark_files import FORMATS, LandmarkSet, read_landmark_file, write_landmark_file

POINTS = np.array([[1.5, -2.25, 3.0], [0.1, 0.2, -1e-7]])
MARKUPS = {
    "@schema": "https://example.org/markups-schema-v1.0.3.json#",
    "markups": [
        {
            "type": "Fiducial",
            "coordinateSystem": "RAS",
            "controlPoints": [
                {"id": "1", "label": "crown", "description": "old", "position": POINTS[0].tolist(), "locked": True},
                {"id": "2", "label": "lost", "position": None, "positionStatus": "undefined"},
                {"id": "3", "label": "brow", "description": "", "position": POINTS[1].tolist()},
            ],
            "display": {"color": [0.4, 1.0, 1.0]},
        }
    ],
}
FCSV = """# Markups fiducial file version = 4.11
# CoordinateSystem = {system}
# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
1,1.5,-2.25,3.0,0,0,0,1,1,1,0,crown,,
2,0.1,0.2,-1e-7,0,0,0,1,1,1,0,"brow, left",,
"""


def read(folder: Path, name: str, text: str) -> LandmarkSet:
    (folder / name).write_text(text, encoding="utf-8")
    return read_landmark_file(folder / name)


@pytest.mark.parametrize("ending", FORMATS)
def test_landmarks_survive_a_round_trip(tmp_path: Path, ending: str) -> None:
    made = LandmarkSet(("crown", "brow, left"), POINTS, system="LPS", confidence=np.array([0.9, 0.25]))
    write_landmark_file(made, tmp_path / f"a{ending}")
    again = read_landmark_file(tmp_path / f"a{ending}")
    assert again.names == made.names
    assert again.points.tolist() == POINTS.tolist()
    assert again.system == ("" if ending == ".csv" else "LPS")
    assert "0.250" in (tmp_path / f"a{ending}").read_text()


def test_other_entries_of_slicers_file_are_kept(tmp_path: Path) -> None:
    found = read(tmp_path, "in.mrk.json", json.dumps(MARKUPS))
    assert (found.names, found.system) == (("crown", "brow"), "RAS")
    write_landmark_file(found.move(POINTS + 1, np.array([1.0, 0.5]), np.arange(2)), tmp_path / "out.mrk.json")
    (markup,) = json.loads((tmp_path / "out.mrk.json").read_text())["markups"]
    first, lost, second = markup["controlPoints"]
    assert (first["position"], first["description"]) == ((POINTS[0] + 1).tolist(), "confidence 1.000")
    assert first["locked"] is True
    assert lost == MARKUPS["markups"][0]["controlPoints"][1]  # type: ignore[index]
    assert second["description"] == "confidence 0.500"
    assert (markup["coordinateSystem"], markup["display"]) == ("RAS", {"color": [0.4, 1.0, 1.0]})


@pytest.mark.parametrize(("number", "system"), [("0", "RAS"), ("1", "LPS"), ("LPS", "LPS"), ("RAS", "RAS")])
def test_fcsv_coordinate_system_is_a_number_or_a_name(tmp_path: Path, number: str, system: str) -> None:
    found = read(tmp_path, "a.fcsv", FCSV.format(system=number))
    assert (found.system, found.names) == (system, ("crown", "brow, left"))
    assert found.points.tolist() == POINTS.tolist()


@pytest.mark.parametrize(
    ("text", "names", "first"),
    [
        ("name,x,y,z\na,1,2,3\nb,4,5,6\n", ("a", "b"), [1, 2, 3]),
        ("a,1,2,3\n# a comment\n\nb,4,5,6\n", ("a", "b"), [1, 2, 3]),
        ("x,y,z\n1,2,3\n4,5,6\n", ("", ""), [1, 2, 3]),
        ("1,2,3\n", ("",), [1, 2, 3]),
        ("name,vertex\na,7\n", ("a",), 7),
        ("7\n12\n", ("", ""), 7),
    ],
)
def test_csv_has_positions_or_vertices_with_optional_names(
    tmp_path: Path, text: str, names: tuple[str, ...], first: object
) -> None:
    found = read(tmp_path, "a.csv", text)
    assert found.names == names
    assert (found.points if found.vertices is None else found.vertices)[0].tolist() == first


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.csv", "", "contains no landmarks"),
        ("a.csv", "name,x,y,z\n", "contains no landmarks"),
        ("a.csv", "a,1,2,3\nb,4,5\n", "its lines have 3 and 4 entries"),
        ("a.csv", "a,1,2,3,4\n", "its lines have 5 entries"),
        ("a.csv", "a,1,two,3\n", "could not be read as landmarks"),
        ("a.csv", "a,1,nan,3\n", "not finite"),
        ("a.csv", "1.5\n", "could not be read as landmarks"),
        ("a.mrk.json", "{", "could not be read as landmarks"),
        ("a.mrk.json", "[]", "could not be read as landmarks"),
        ("a.mrk.json", '{"markups": []}', "contains no landmarks"),
        ("a.mrk.json", '{"markups": [{"controlPoints": [{"position": [1, 2]}]}]}', "could not be read as landmarks"),
        ("a.fcsv", FCSV.format(system="XYZ"), "could not be read as landmarks"),
        ("a.fcsv", "1,2\n", "could not be read as landmarks"),
        ("a.txt", "1,2,3", "not a file of landmarks"),
    ],
)
def test_bad_landmark_files_are_refused(tmp_path: Path, name: str, text: str, sentence: str) -> None:
    with pytest.raises(zo.MeshError, match=sentence):
        read(tmp_path, name, text)


def test_missing_landmark_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(zo.MeshError, match="There is no file"):
        read_landmark_file(tmp_path / "none.csv")
