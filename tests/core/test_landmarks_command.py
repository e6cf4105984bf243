# SPDX-License-Identifier: GPL-3.0-or-later
"""`zoomout landmarks` places a template's landmarks on other meshes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from specimens import grow, hollow

from zoomout_core.cli import main
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.landmark_files import LandmarkSet, read_landmark_file, write_landmark_file
from zoomout_core.matching.report.verdict import judge
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.surface import Surface
from zoomout_core.spectral.sampling import farthest_points

pytestmark = pytest.mark.usefixtures("remember_matches")
NAMES = tuple("abcdefgh")


@pytest.fixture(scope="module")
def numbers() -> np.ndarray:
    return farthest_points(hollow(900, 0).vertices[:900], 30)[22:]  # not at the tips of thin limbs


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, numbers: np.ndarray) -> Path:
    """A template with its landmarks, and a target with a broken vertex."""
    folder = tmp_path_factory.mktemp("specimens")
    template, target = hollow(900, 0), hollow(800, 1)
    write_shape(template, folder / "template.ply")
    grown = Surface(grow(target.vertices), target.triangles)
    write_shape(grown, folder / "target.ply")
    lines = (folder / "target.ply").read_text().splitlines()
    row = lines.index("end_header") + 1 + 1111
    lines[row] = "nan nan nan"
    (folder / "target.ply").write_text("\n".join([*lines, ""]))
    points = template.vertices[numbers]
    write_landmark_file(LandmarkSet(NAMES, points), folder / "marks.csv")
    write_landmark_file(LandmarkSet(NAMES, points * [-1, -1, 1], system="RAS"), folder / "marks.mrk.json")
    (folder / "vertices.csv").write_text("".join(f"{number}\n" for number in numbers))
    return folder


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["landmarks", *map(str, arguments), "--detail", "fast", "--cache", "off"])
    return result.exit_code, result.stdout + (result.stderr if result.exit_code else "")


def test_landmarks_are_written_with_a_confidence_and_a_verdict(
    folder: Path, numbers: np.ndarray, tmp_path: Path
) -> None:
    code, said = run(folder / "template.ply", folder / "marks.csv", folder / "target.ply", "-o", tmp_path / "out.csv")
    assert code == 0, said
    assert said.startswith(("Green: ", "Amber: "))
    assert "1 vertex of the target is not a number" in said
    found = read_landmark_file(tmp_path / "out.csv")
    truth = grow(hollow(900, 0).vertices[numbers])
    assert found.names == NAMES
    assert np.median(np.linalg.norm(found.points - truth, axis=1)) < 0.1
    heading = (tmp_path / "out.csv").read_text().splitlines()[0]
    assert heading == "name,x,y,z,confidence"


@pytest.mark.slow
def test_output_keeps_format_and_coordinate_system(folder: Path, tmp_path: Path) -> None:
    given = folder / "template.ply", folder / "marks.mrk.json"
    code, said = run(*given, folder / "target.ply", folder / "none.ply", "-o", tmp_path / "out", "--json")
    assert code == 3
    report = json.loads(said.partition("\n}")[0] + "\n}")
    assert report == json.loads((tmp_path / "out" / "report.json").read_text())
    good, bad = report["targets"]
    assert "There is no file" in bad["error"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["report.json", "target.mrk.json"]
    found = read_landmark_file(tmp_path / "out" / "target.mrk.json")
    assert (found.names, found.system) == (NAMES, "RAS")
    assert [row["position"] for row in good["landmarks"]] == found.points.tolist()
    code, _ = run(folder / "template.ply", folder / "marks.csv", folder / "target.ply", "-o", tmp_path / "lps.csv")
    assert found.points * [-1, -1, 1] == pytest.approx(read_landmark_file(tmp_path / "lps.csv").points)


@pytest.mark.slow
def test_vertex_landmarks_stay_vertices_unless_a_format_is_given(folder: Path, tmp_path: Path) -> None:
    given = folder / "template.ply", folder / "vertices.csv", folder / "target.ply"
    assert run(*given, "-o", tmp_path / "out.csv")[0] == 0
    vertices = read_landmark_file(tmp_path / "out.csv").vertices
    assert vertices is not None
    assert (vertices < 800).all()  # on the outer wall
    assert run(*given, "-o", tmp_path / "out", "--format", "fcsv")[0] == 0
    found = read_landmark_file(tmp_path / "out" / "target.fcsv")
    body = hollow(800, 1)
    triangle, _ = closest_points(found.points, grow(body.vertices), body.triangles)
    assert (body.triangles[triangle] == vertices[:, None]).any(axis=1).all()


@pytest.mark.slow
def test_landmarks_on_a_mirror_image_are_placed_with_a_note(folder: Path, numbers: np.ndarray, tmp_path: Path) -> None:
    body, mirror = hollow(800, 1), np.array([-1.0, 1, 1])
    write_shape(Surface(mirror * grow(body.vertices), body.triangles[:, ::-1]), tmp_path / "mirrored.ply")
    given = folder / "template.ply", folder / "marks.csv", tmp_path / "mirrored.ply", "-o", tmp_path / "out.csv"
    code, said = run(*given)
    assert code == 0, said
    assert "The target seems to be a mirror image of the template" in said
    truth = mirror * grow(hollow(900, 0).vertices[numbers])
    found = read_landmark_file(tmp_path / "out.csv")
    assert np.median(np.linalg.norm(found.points - truth, axis=1)) < 0.1


@pytest.mark.slow
def test_probably_wrong_match_is_refused_without_force(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zoomout_core.matching.result.MatchResult.verdict", judge(0.1))
    given = folder / "template.ply", folder / "marks.csv", folder / "target.ply", "-o", tmp_path / "out.csv"
    code, said = run(*given)
    assert code == 1
    assert "--force" in said
    assert not (tmp_path / "out.csv").exists()
    code, said = run(*given, "--force")
    assert code == 0
    assert said.startswith("Red: ")


def test_uncertain_match_is_reported_as_amber(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoomout_core.matching.result.MatchResult.certainty", 0.8)
    code, said = run(folder / "template.ply", folder / "marks.csv", folder / "target.ply", "-o", tmp_path / "out.csv")
    assert code == 0
    assert said.startswith("Amber: The match may be wrong: it is 80% certain.")


@pytest.mark.parametrize(
    ("marks", "output", "sentence"),
    [
        ("none.csv", "out.csv", "There is no file"),
        ("template.ply", "out.csv", "not a file of landmarks"),
        ("marks.csv", "out.txt", "not a file of landmarks"),
        ("far.csv", "out.csv", "away from its surface"),
        ("marks.csv", "marks.csv", "marks.csv"),
    ],
)
def test_bad_input_is_refused_and_inputs_are_unchanged(folder: Path, marks: str, output: str, sentence: str) -> None:
    (folder / "far.csv").write_text("a,900,0,0\n")
    before = (folder / "marks.csv").read_bytes()
    code, said = run(folder / "template.ply", folder / marks, folder / "target.ply", "-o", folder / output)
    assert code == 1
    assert sentence in said
    assert (folder / "marks.csv").read_bytes() == before
