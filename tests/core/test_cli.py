# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout` works on files and reports each error in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result
from creatures import Creature, mirrored_vertex, true_vertex

import zoomout_core as zo
from zoomout_core.cli import SUMMARIES, demo_command, main
from zoomout_core.runtime.threads import threads

pytestmark = pytest.mark.usefixtures("remember_matches")


@pytest.fixture(scope="module")
def files(resting: Creature, bent: Creature, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    for name, creature in (("source", resting), ("target", bent)):
        mesh = trimesh.Trimesh(creature.surface.vertices, creature.surface.triangles, process=False)
        mesh.export(folder / f"{name}.ply")
    return folder


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_match_writes_the_map_and_prints_a_report(files: Path, resting: Creature, bent: Creature) -> None:
    outcome = run("match", files / "source.ply", files / "target.ply", "-o", files / "map.npz")
    assert outcome.exit_code == 0, outcome.output
    for fact in (
        "The match is",
        "Mean confidence",
        "Flipped: ",
        "Without a partner: ",
        "Candidate 0 of ",
    ):
        assert fact in outcome.output
    with np.load(files / "map.npz") as file:
        arrays = {"triangle", "barycentric", "vertex", "confidence", "functional_map"}
        assert set(file.files) == {*arrays, "has_partner", "source_has_partner"}
        assert file["has_partner"].shape == (len(bent.directions),)
        assert file["source_has_partner"].shape == (len(resting.directions),)
        error = zo.geodesic_error(
            file["vertex"], resting.surface, np.arange(len(bent.directions)), true_vertex(resting, bent)
        )
    assert error.mean() < 0.03


def test_first_look_is_written_before_the_map(files: Path, resting: Creature, bent: Creature) -> None:
    meshes, early = (files / "source.ply", files / "target.ply"), files / "first_look.npz"
    outcome = run("match", *meshes, "-o", files / "later.npz", "--first-look", early)
    assert outcome.exit_code == 0, outcome.output
    assert early.stat().st_mtime_ns < (files / "later.npz").stat().st_mtime_ns
    with np.load(early) as file:
        vertices, images = file["target"], file["source"]
    assert images.shape[1:] == vertices.shape
    off = resting.surface.vertices[images[0]] - resting.surface.vertices[true_vertex(resting, bent)[vertices]]
    assert np.linalg.norm(off, axis=1).mean() / np.sqrt(resting.surface.area) < 0.06
    nearest = run("match", *meshes, "-o", files / "none.npz", "--initial", "nearest", "--first-look", early)
    assert "--first-look has no effect with --initial nearest" in nearest.output
    wrong = run("match", *meshes, "-o", files / "none.npz", "--first-look", files / "look.txt")
    assert "does not end in .npz" in wrong.output


def test_initial_nearest_writes_a_proximity_map(files: Path) -> None:
    meshes = files / "source.ply", files / "target.ply"
    asked = "-o", files / "nearest.npz", "--initial", "nearest"
    outcome = run("match", *meshes, *asked, "--max-distance", "0.05", "--max-angle", "45")
    assert outcome.exit_code == 0, outcome.output
    with np.load(files / "nearest.npz") as file:
        assert set(file.files) == {"triangle", "barycentric", "vertex", "confidence"}
        expected = zo.match_by_proximity(*(zo.read_surface(mesh) for mesh in meshes), 0.05, 45)
        np.testing.assert_array_equal(file["confidence"], expected.confidence)
        np.testing.assert_array_equal(file["triangle"], expected.surface_map.triangle)
    for note in expected.notes:
        assert note in outcome.output
    refused = run("match", *meshes, *asked, "--common-axis", "z")
    assert refused.exit_code == 2
    assert "--common-axis has no effect with --initial nearest" in refused.output


def test_file_without_faces_is_matched_as_a_point_cloud(files: Path, resting: Creature) -> None:
    trimesh.PointCloud(resting.surface.vertices).export(files / "cloud.ply")
    meshes = files / "source.ply", files / "cloud.ply"
    outcome = run("match", *meshes, "-o", files / "cloud.npz", "--initial", "nearest")
    assert outcome.exit_code == 0, outcome.output
    with np.load(files / "cloud.npz") as file:
        assert (file["vertex"] == np.arange(len(resting.directions))).mean() > 0.99
    outcome = run("evaluate", files / "cloud.npz", *meshes)
    assert outcome.exit_code == 0, outcome.output
    assert "Flipped: " in outcome.output


@pytest.mark.slow
def test_match_starts_from_landmarks_or_an_earlier_map(files: Path, resting: Creature, bent: Creature) -> None:
    tips = np.array([bent.directions @ axis for axis in ([1, 0.1, 0.35], [-1, 0.1, 0.35])]).argmax(1)
    pairs = np.column_stack([mirrored_vertex(resting, bent)[tips], tips])
    np.savetxt(files / "pairs.txt", pairs, fmt="%d")
    meshes = files / "source.ply", files / "target.ply"
    outcome = run("match", *meshes, "-o", files / "turned.npz", "--landmarks", files / "pairs.txt")
    assert outcome.exit_code == 0, outcome.output
    outcome = run("match", *meshes, "-o", files / "again.npz", "--initial", files / "turned.npz")
    assert outcome.exit_code == 0, outcome.output
    turned, again = (zo.SurfaceMap.load(files / f"{name}.npz", resting.surface) for name in ("turned", "again"))
    places = [surface_map.interpolate(resting.surface.vertices)[tips] for surface_map in (turned, again)]
    for found in places:
        distance = np.linalg.norm(found - resting.surface.vertices[pairs[:, 0]], axis=1)
        assert (distance / np.sqrt(resting.surface.area) < 0.3).all()


def test_evidence_options_are_passed_to_the_match(
    files: Path, resting: Creature, bent: Creature, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, Any] = {}

    def spy(source: zo.Surface, target: zo.Surface, **options: Any) -> None:
        seen.update(options)
        raise zo.MeshError("Enough.")

    monkeypatch.setattr("zoomout_core.cli.match_command.match_shapes", spy)
    truth = true_vertex(resting, bent)
    zo.SurfaceMap.from_vertices(truth, resting.surface).save(files / "known.npz")
    points = resting.surface.vertices[truth[:3]], bent.surface.vertices[:3]
    np.savetxt(files / "points.txt", np.hstack(points), header="source and target", fmt="%.17g")
    meshes = files / "source.ply", files / "target.ply", "-o", files / "none.npz"
    evidence = "--landmarks", files / "points.txt", "--exact-landmarks", "--earlier-map", files / "known.npz"
    assert (
        "Enough."
        in run(
            "match",
            *(*meshes, *evidence, "--common-axis", "Z", "--common-axis", "0,-2,0", "--no-upright", "--partial", "off"),
        ).output
    )
    assert not seen["upright"]
    assert (seen["initial"], seen["exact_landmarks"], seen["partial"]) == ("auto", True, "off")
    np.testing.assert_array_equal(seen["common_axes"], [[0, 0, 1], [0, -1, 0]])
    np.testing.assert_array_equal(seen["landmarks"], points)
    np.testing.assert_array_equal(seen["initial_map"], truth)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nothing.ply", "target.ply"), "nothing.ply"),
        (("source.ply", "target.ply", "--initial", "magic"), "magic"),
        (("source.ply", "broken.ply"), "broken.ply"),
        (("source.ply", "target.ply", "--initial", "broken.ply"), "contains no map"),
        (("source.ply", "target.ply", "--landmarks", "broken.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--landmarks", "empty.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--landmarks", "fractions.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--landmarks", "triples.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--landmarks", "mixed.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--initial", "landmarks"), "--landmarks FILE"),
        (("source.ply", "target.ply", "--exact-landmarks"), "--landmarks FILE"),
        (("source.ply", "target.ply", "--earlier-map", "broken.ply"), "contains no map"),
        (("source.ply", "target.ply", "--earlier-map", "broken.ply", "--initial", "proximity"), "--initial auto"),
        (("source.ply", "target.ply", "--common-axis", "z", "--initial", "proximity"), "--initial auto"),
        (("source.ply", "target.ply", "--common-axis", "up"), "--common-axis is 'up'"),
        (("source.ply", "target.ply", "--common-axis", "0,0"), "--common-axis is '0,0'"),
        (("source.ply", "target.ply", "--common-axis", "0,0,0"), "--common-axis is '0,0,0'"),
        (("source.ply", "target.ply", "-o", "map"), "does not end in .npz"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_match_reports_invalid_input_in_one_sentence(files: Path, arguments: tuple[str, ...], sentence: str) -> None:
    for name, text in {
        "broken": "ply\nthis is not a mesh\n",
        "empty": "",
        "fractions": "0.5 1\n",
        "triples": "0 1 2\n",
        "mixed": "0 0 0 1 1 1\n0 1\n",
    }.items():
        (files / f"{name}.ply").write_text(text)
    named = [files / name if name.endswith(".ply") else name for name in arguments]
    outcome = run("match", "-o", files / "none.npz", *named)
    assert outcome.exit_code != 0
    assert outcome.output.startswith("Error: ")
    assert outcome.output.strip().count("\n") == 0
    assert sentence in outcome.output
    assert not (files / "none.npz").exists()


def test_demo_without_the_extension_reports_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_command, "extension_module", lambda _: None)
    outcome = run("demo", "-o", tmp_path / "demo")
    assert (outcome.exit_code, "run `make demo`" in outcome.output) == (1, True)
    assert not (tmp_path / "demo").exists()


def test_symmetry_writes_map_and_sides_and_lists_candidates(files: Path, bent: Creature) -> None:
    outcome = run("symmetry", files / "target.ply", "-o", files / "own.npz", "--left", "-x", "--detail", "fast")
    assert outcome.exit_code == 0, outcome.output
    assert "1. A reflection, with a probability of" in outcome.output
    with np.load(files / "own.npz") as file:
        arrays = {"triangle", "barycentric", "vertex", "confidence", "functional_map", "distance", "side"}
        assert set(file.files) == arrays
        clear = np.abs(bent.directions[:, 0]) > 0.15
        np.testing.assert_array_equal(file["side"][clear], -np.sign(bent.directions[clear, 0]))
        known = np.arange(len(bent.directions)), mirrored_vertex(bent, bent)
        assert zo.geodesic_error(file["vertex"], bent.surface, *known).mean() < 0.04
    for wrong, sentence in (("--left=up", "--left is 'up'"), ("--candidate=99", "no candidate 99")):
        outcome = run("symmetry", files / "target.ply", "-o", files / "none.npz", "--detail", "fast", wrong)
        assert outcome.exit_code != 0
        assert sentence in outcome.output
        assert not (files / "none.npz").exists()


@pytest.mark.parametrize("command", SUMMARIES)
def test_threads_option_applies_to_any_command(command: str) -> None:
    try:
        assert run("--threads", 3, command, "--help").exit_code == 0
        assert threads() == 3
    finally:
        zo.set_threads(None)
    assert run("--threads", 0, command).exit_code == 2


def test_commands_report_their_results_as_json(files: Path) -> None:
    source, target = files / "source.ply", files / "target.ply"
    meshes = source, target, "-o", files / "json.npz"
    matched = json.loads(run("match", *meshes, "--initial", "nearest", "--json").stdout)
    assert matched["output"] == str(files / "json.npz")
    assert 0 <= matched["share_with_partner"] <= 1
    (files / "truth.txt").write_text("0 0\n1 1\n")
    judged = json.loads(
        run("evaluate", files / "json.npz", *meshes[:2], "--truth", files / "truth.txt", "--json").stdout
    )
    assert judged["places"] == 2
    assert set(judged["error"]) == {"mean", "median", "percentile_95"}
    assert judged["covered"] > 0
    held = json.loads(run("info", source, "--json").stdout)
    assert held["vertices"] == len(zo.read_surface(source).vertices)
    assert (held["parts"], held["border_edges"], held["joints"]) == (1, 0, [])


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("match", "missing.ply", "target.ply", "-o", "none.npz"), 1, "There is no file"),
        (("match", "source.ply", "target.ply", "-o", "none.npz", "--landmarks", "missing.txt"), 1, "There is no file"),
        (("evaluate", "missing.npz", "source.ply", "target.ply"), 1, "There is no file"),
        (("match", "source.ply", "target.ply", "-o", "none.npz", "--cache", "source.ply"), 1, "cannot be written to"),
        (("info", "missing.ply"), 1, "There is no file"),
        (("info", "missing.ply", "--colour"), 2, "No such option"),
        (("match", "source.ply", "target.ply", "-o", "none.npz", "--initial", "magic"), 2, "--initial is 'magic'"),
        (("match", "source.ply", "target.ply", "-o", "none.npz", "--detail", "high"), 2, "'high' is not one of"),
        (("match", "source.ply", "target.ply", "-o", "none.npz", "--common-axis", "up"), 2, "--common-axis is 'up'"),
        (("symmetry", "source.ply", "-o", "none.npz", "--left", "up"), 2, "--left is 'up'"),
        (("transfer", "source.ply", "target.ply", "-o", "none.glb", "--kinds", "bones"), 2, "--kinds is 'bones'"),
        (("transfer", "missing.ply", "target.ply", "-o", "none.glb"), 1, "There is no file"),
    ],
)
def test_errors_have_consistent_exit_codes_and_json(
    files: Path, arguments: tuple[str, ...], code: int, sentence: str
) -> None:
    named = [files / name if "." in name else name for name in arguments]
    plain, as_json = run(*named), run(*named, "--json")
    assert (plain.exit_code, as_json.exit_code) == (code, code)
    assert sentence in plain.stderr
    assert sentence in json.loads(as_json.stdout)["error"]


def test_info_describes_a_file_or_reports_its_error(files: Path) -> None:
    said = run("info", files / "source.ply").output
    assert "loose parts: 1, border edges: 0." in said
    wrong = run("info", files / "broken.ply")
    assert wrong.exit_code == 1
    assert "broken.ply" in wrong.output
