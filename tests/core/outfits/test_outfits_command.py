# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout outfits`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from click.testing import CliRunner, Result

from zoomout_core.assets.files import read_asset
from zoomout_core.cli import main
from zoomout_core.collection.collection import CollectionResult
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.report.verdict import Verdict
from zoomout_core.outfits import batch, joint_match
from zoomout_core.outfits.gltf_files import GltfFiles
from zoomout_core.transfer.rigging.joint_map import RiggedBody

pytestmark = pytest.mark.usefixtures("quick_search")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["outfits", *map(str, arguments), "--workers", "1", "--detail", "fast"])


def test_avatars_are_dressed_once(dolls: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    avatars, output = tmp_path / "avatars", tmp_path / "out"
    avatars.mkdir()
    shutil.copy(dolls / "naked.glb", avatars)
    shutil.copy(dolls / "naked.glb", avatars / "twin.glb")
    (avatars / "broken.glb").write_bytes(b"glTF")
    options = "-o", output, "--json", "--keep", "Buckle*"
    done = run(dolls / "dressed.glb", avatars, *options)
    assert done.exit_code == 3, done.output
    figures = json.loads(done.stdout)
    assert [row["avatar"] for row in figures["outfits"]] == ["naked", "twin"]
    assert (figures["matched_now"], figures["dressed_now"]) == (1, 2)  # both have the same body
    assert list(figures["failures"]) == ["broken"]
    for row in figures["outfits"]:
        assert row["verdict"]["level"] == "green"
        assert "No mesh or material of the outfit is called like 'Buckle*': nothing there was kept." in row["warnings"]
        assert max(row["inside"].values()) < 0.01
        dressed = read_asset(output / row["output"])
        assert [name for name, _ in dressed.objects] == ["Skin", "Shirt", "Trousers"]
    page = (output / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2
    assert "broken" in page
    # Existing results are kept, and missing ones are made again.
    (output / "dressed" / "twin" / "dressed.glb").unlink()
    again = json.loads(run(dolls / "dressed.glb", avatars, *options).stdout)
    assert (again["matched_now"], again["dressed_now"]) == (0, 1)
    assert again["outfits"] == figures["outfits"]
    # Without a record, files that an interrupted run wrote with other options are not taken for those of this one.
    (output / "dressed" / "twin" / "dressed.glb").unlink()
    monkeypatch.delattr(GltfFiles, "dress")
    assert "dressed on twin" in json.loads(run(dolls / "dressed.glb", avatars, *options).stdout)["failures"]
    assert [path.parent.name for path in output.glob("records/*/*.json")] == ["naked"]


class ContradictingJoints(NamedTuple):
    """Joints that contradict the match of two bodies, and map each vertex to the nearest point."""

    source: RiggedBody
    target: RiggedBody

    @classmethod
    def of(cls, source: RiggedBody, target: RiggedBody) -> ContradictingJoints:
        return cls(source, target)

    def contradict(self, _: SurfaceMap) -> bool:
        return True

    def share_on_other_limbs(self, _: SurfaceMap) -> float:
        return 0.2

    def map(self) -> SurfaceMap:
        source, target = self.source.surface, self.target.surface
        return SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles)


@pytest.mark.parametrize("level", ["green", "red"])
def test_joints_match_bodies_unless_their_shapes_do(
    level: str, dolls: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joint_match, "SharedJoints", ContradictingJoints)
    monkeypatch.setattr(CollectionResult, "verdict", lambda *_: Verdict(level, "By shape.", ""))
    done = run(dolls / "dressed.glb", dolls / "naked.glb", "-o", tmp_path / "out", "--json")
    (row,) = json.loads(done.stdout)["outfits"]
    by_joints = level == "red"
    assert (tmp_path / "out" / "by_joints" / "maps" / "dressed" / "naked.npz").is_file() == by_joints
    assert row["verdict"]["level"] == ("amber" if by_joints else "green")
    assert row["verdict"]["sentence"].startswith("The bodies were matched by their joints") == by_joints


@pytest.mark.parametrize(
    ("outfits", "reason"),
    [
        ("naked.glb", "name those of the body with --body"),
        ("missing.glb", "There is no file or folder"),
        ("scan.obj", "scan.obj is no glTF or VRM file"),
    ],
)
def test_invalid_outfits_are_reported(outfits: str, reason: str, dolls: Path, tmp_path: Path) -> None:
    (tmp_path / "scan.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    place = tmp_path if outfits == "scan.obj" else dolls
    done = run(place / outfits, dolls / "dressed.glb", "-o", tmp_path / "out")
    assert done.exit_code == 1
    assert reason in done.output
    assert not list(tmp_path.glob("out/*"))


def test_failed_run_keeps_earlier_bodies(dolls: Path, tmp_path: Path) -> None:
    bodies = tmp_path / "bodies"
    bodies.mkdir()
    (bodies / "earlier.ply").write_text("earlier")
    assert run(dolls / "naked.glb", dolls / "dressed.glb", "-o", tmp_path).exit_code == 1
    assert [path.name for path in bodies.iterdir()] == ["earlier.ply"]


def test_inputs_in_the_output_folder_are_refused(dolls: Path, tmp_path: Path) -> None:
    place = tmp_path / "dressed"
    place.mkdir()
    shutil.copy(dolls / "naked.glb", place)
    done = run(dolls / "dressed.glb", place / "naked.glb", "-o", tmp_path)
    assert done.exit_code == 1
    assert "is an input in a place of" in done.output


def test_restart_keeps_earlier_results_if_no_engine_starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = tmp_path / "out" / "records" / "avatar" / "outfit.json"
    record.parent.mkdir(parents=True)
    record.write_text("{}")
    for name in ("outfit.glb", "avatar.glb"):
        (tmp_path / name).write_bytes(b"glTF")

    def fail(*_: object) -> None:
        raise OSError("No engine.")

    monkeypatch.setattr("zoomout_core.cli.outfits_command.local_engine", fail)
    files = [str(tmp_path / name) for name in ("outfit.glb", "avatar.glb")]
    outcome = CliRunner().invoke(main, ["outfits", *files, "-o", str(tmp_path / "out"), "--restart"])
    assert (outcome.exit_code, "No engine." in outcome.output) == (1, True)
    assert record.exists()


@pytest.mark.parametrize(("option", "value"), [("--gap", "nan"), ("--gap", "inf"), ("--stiffness", "nan")])
def test_numbers_that_describe_no_fit_are_refused_before_work(
    option: str, value: str, dolls: Path, tmp_path: Path
) -> None:
    ran = run(dolls / "dressed.glb", dolls / "naked.glb", "-o", tmp_path / "out", option, value)
    assert ran.exit_code == 1
    assert f"{option[2:]} is {value}: give a" in ran.output
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("reason", "line"),
    [("s.glb is empty.", "s.glb is empty."), ("Its parts have no names.", "s: Its parts have no names.")],
)
def test_reasons_name_the_file_that_failed(reason: str, line: str) -> None:
    assert batch._naming("s", reason) == line
