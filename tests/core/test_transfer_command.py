# SPDX-License-Identifier: GPL-3.0-or-later
"""`zoomout transfer` writes the target with all attributes of the source."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pygltflib
import pytest
from click.testing import CliRunner
from creatures import creature, true_vertex
from skinned_tubes import write_tube

import zoomout_core as zo
from zoomout_core.assets.asset import Asset, Material, material_numbers
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.cli import main
from zoomout_core.matching.report.verdict import judge
from zoomout_core.samples.characters import write_samples
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

pytestmark = pytest.mark.usefixtures("remember_matches")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A coloured creature, and another mesh of it in a bent pose."""
    folder = tmp_path_factory.mktemp("creatures")
    made, other = creature(900, asymmetry=0.3), creature(800, seed=1, bend=0.3, asymmetry=0.3)
    colors = np.clip(0.5 + 0.5 * made.directions, 0, 1)
    attributes = (
        Attribute("color 0", Domain.POINT, Kind.COLOR, colors),
        material_numbers((made.directions[made.surface.triangles[:, 0], 2] > 0).astype(int)),
    )
    write_asset(Asset(made.surface, attributes, (Material("low"), Material("high"))), folder / "source.glb")
    write_asset(Asset(other.surface), folder / "target.ply")
    return folder / "source.glb", folder / "target.ply"


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["transfer", *map(str, arguments), "--detail", "fast", "--cache", "off"])
    return result.exit_code, result.stdout + (result.stderr if result.exit_code else "")


def test_colours_and_materials_are_transferred(files: tuple[Path, Path], tmp_path: Path) -> None:
    code, said = run(*files, "-o", tmp_path / "out.glb", "--json")
    assert code == 0, said
    (report,) = json.loads(said)["targets"]
    assert report["transferred"] == ["color 0", "normals", "materials"][::2]
    assert report["certainty"] > 0.5
    again = read_asset(tmp_path / "out.glb")
    made, other = creature(900, asymmetry=0.3), creature(800, seed=1, bend=0.3, asymmetry=0.3)
    true = np.clip(0.5 + 0.5 * made.directions[true_vertex(made, other)], 0, 1)
    colors = again.find("color 0")
    assert colors is not None
    at = again.surface.vertices[again.surface.corner_vertex]
    nearest = np.argmin(np.linalg.norm(at[:, None] - other.surface.vertices, axis=2), axis=1)
    assert np.abs(colors.values[:, :3] - true[nearest]).mean() < 0.1
    assert [material.name for material in again.materials] == ["low", "high"]


def test_failed_target_does_not_stop_the_others_of_a_folder(files: tuple[Path, Path], tmp_path: Path) -> None:
    targets = tmp_path / "targets"
    targets.mkdir()
    (targets / "good.ply").write_bytes(files[1].read_bytes())
    (targets / "torn.obj").write_text("v 0 0 0\nf 1 2 3\n")
    (targets / "notes.txt").write_text("no mesh")
    code, said = run(files[0], targets, "-o", tmp_path / "out", "--format", "obj")
    assert code == 3
    assert "1 of 2 targets written" in said
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["good.mtl", "good.obj", "report.json"]
    rows = json.loads((tmp_path / "out" / "report.json").read_text())["targets"]
    assert rows[0]["transferred"] == ["color 0", "materials"]
    assert "torn.obj" in rows[1]["error"]


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("-o", "{folder}/out.fbx"), 1, "has no supported file extension"),
        (("-o", "{target}"), 1, "is an input, and would be overwritten"),
        (("-o", "{folder}/out.glb", "--kinds", "bones"), 2, "--kinds is 'bones': choose from uv, color"),
        (("-o", "{folder}/out.glb", "--kinds", "weights"), 1, "The source has no weights"),
    ],
)
def test_invalid_options_are_reported_and_nothing_is_written(
    files: tuple[Path, Path], tmp_path: Path, arguments: tuple[str, ...], code: int, sentence: str
) -> None:
    before = files[1].read_bytes()
    ended, said = run(*files, *(each.format(folder=tmp_path, target=files[1]) for each in arguments))
    assert ended == code
    assert sentence in said
    assert "Traceback" not in said
    assert files[1].read_bytes() == before
    assert not list(tmp_path.iterdir())


def test_probably_wrong_match_is_written_only_with_force(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zo.MatchResult, "verdict", judge(0.1))
    code, said = run(*files, "-o", tmp_path / "out.glb")
    assert code == 1
    assert "probably wrong" in said
    assert "--force" in said
    assert "Other candidates: --candidate 1 to " in said
    assert "100%" not in said
    code, said = run(*files, "-o", tmp_path / "out.glb", "--json")
    (report,) = json.JSONDecoder().raw_decode(said)[0]["targets"]  # the progress bar follows
    assert (code, report["status"], report["verdict"]["level"]) == (1, "refused", "red")
    assert "output" not in report
    assert not (tmp_path / "out.glb").exists()
    code, said = run(*files, "-o", tmp_path / "out.glb", "--force")
    assert code == 0, said
    assert "Red: The match is probably wrong" in said
    assert "The other candidates are --candidate 1 to " in said
    assert (tmp_path / "out.glb").exists()


def test_report_lists_parts_by_object_and_material(tmp_path: Path) -> None:
    made = creature(400)
    top = made.surface.vertices[np.argmax(made.surface.vertices[:, 2])]
    lump = zo.Surface(made.surface.vertices * 0.3 + top, made.surface.triangles)
    # The body is one loose part of two materials.
    left = made.surface.vertices[made.surface.triangles].mean(axis=1)[:, 0] > 0.2
    number = np.concatenate([left, np.full(len(left), 2)])
    names = "Skin", "Shirt", "Hat"
    both = Asset(zo.Surface.joined([made.surface, lump]), (material_numbers(number),), tuple(map(Material, names)))
    files = tmp_path / "source.glb", tmp_path / "target.ply"
    write_asset(both, files[0])
    write_asset(Asset(made.surface), files[1])
    arguments = "match", *map(str, files), "-o", str(tmp_path / "map.npz"), "--detail", "fast"
    said = CliRunner().invoke(main, arguments).stdout
    assert "\nShare of the target's area by part of the source: 'Skin' " in said
    silent = "Almost nothing arrives from 'Hat'."
    assert f"\nWarning: {silent}" in said
    code, said = run(*files, "-o", tmp_path / "out.glb", "--json")
    assert code == 0, said
    (report,) = json.loads(said)["targets"]
    assert silent in report["warnings"]
    assert set(report["warnings"]) < set(report["notes"])
    parts = {part["material"]: part for part in report["parts"]}
    assert {part["part"] for part in parts.values()} == set(names)
    assert {part["name"] for part in parts.values()} == {"source"}
    # The listed shares are those of the faces that the map uses.
    stored, areas = read_asset(files[0]), made.surface.vertex_areas  # faces are grouped by material
    material = stored.find("materials")
    assert material is not None
    used = material.values[stored.surface.triangle_face[np.load(tmp_path / "map.npz")["triangle"]]]
    arrived = [parts[name]["arrived"] for name in names]
    np.testing.assert_allclose(arrived, np.bincount(used, areas, 3) / areas.sum(), atol=1e-9)
    assert min(arrived[:2]) > 0.2


def test_blend_source_is_referred_to_the_collection_command(files: tuple[Path, Path], tmp_path: Path) -> None:
    code, said = run(tmp_path / "hero.blend", files[1], "-o", tmp_path / "out.glb")
    assert code == 1
    assert "use `zoomout collection`" in said


@pytest.fixture(scope="module")
def expressive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A creature with four expression keys in one of many spellings, and one of its own."""
    made = creature(400).surface
    labels = ("Face_browInnerUp_L", "Face_browInnerUp_R", "Face_jawOpen", "Face_eyeBlink_L", "Face_ears")
    values = np.zeros((len(made.vertices), len(labels), 3))
    for column in range(len(labels)):
        values[:, column, column % 3] = np.maximum(0, made.vertices[:, 2]) * (column + 1) / 10
    offsets = Attribute("shape keys", Domain.POINT, Kind.OFFSET, values, labels)
    path = tmp_path_factory.mktemp("expressive") / "source.glb"
    write_asset(Asset(made, (offsets,)), path)
    return path


def test_morph_targets_are_renamed_and_missing_ones_listed(expressive: Path, tmp_path: Path) -> None:
    write_asset(Asset(creature(350, seed=1).surface), tmp_path / "target.ply")
    arguments = expressive, tmp_path / "target.ply", "-o", tmp_path / "out.glb", "--key-names", "arkit"
    code, said = run(*arguments, "--json")
    assert code == 0, said
    (report,) = json.loads(said)["targets"]
    assert report["key_names"]["sources"] == ["arkit"]
    assert report["key_names"]["renamed"] == {"Face_jawOpen": "jawOpen", "Face_eyeBlink_L": "eyeBlinkLeft"}
    assert report["key_names"]["composed"] == {"browInnerUp": ["Face_browInnerUp_L", "Face_browInnerUp_R"]}
    assert len(report["key_names"]["missing"]) == 49
    offsets = read_asset(tmp_path / "out.glb").find("shape keys")
    assert offsets is not None
    assert offsets.labels == (
        *("Face_browInnerUp_L", "Face_browInnerUp_R", "jawOpen", "eyeBlinkLeft", "Face_ears", "browInnerUp"),
    )
    assert np.abs(offsets.values[:, 5]).max() > 0.01
    np.testing.assert_allclose(offsets.values[:, 5], offsets.values[:, 0] + offsets.values[:, 1], atol=1e-6)
    code, said = run(*arguments)
    assert "Renamed 2 shape keys to the spelling of ARKit." in said
    assert "Missing of the 52 keys of ARKit: eyeBlinkRight, " in said


def test_key_names_without_morph_targets_are_refused(
    files: tuple[Path, Path], expressive: Path, tmp_path: Path
) -> None:
    for source, more in ((files[0], ()), (expressive, ("--kinds", "shape-keys,color", "--force"))):
        code, said = run(source, files[1], "-o", tmp_path / "out.glb", "--key-names", "vrm1", *more)
        assert (code, "--key-names has no morph targets of" in said) == ((1, True) if not more else (0, False)), said
    code, said = run(expressive, files[1], "-o", tmp_path / "out.glb", "--key-names", "vrm1", "--kinds", "color")
    assert code == 1


def test_rig_is_moved_into_the_target(files: tuple[Path, Path], tmp_path: Path) -> None:
    source = write_samples(tmp_path)[0]
    taller = creature(700, seed=3)
    seen = taller.surface.with_vertices(taller.surface.vertices * [2.0, 2.0, 3.0])
    write_asset(Asset(seen), tmp_path / "tall.ply")
    code, said = run(source, tmp_path / "tall.ply", "-o", tmp_path / "out.glb", "--move-rig", "--force", "--json")
    assert code == 0, said
    assert json.loads(said)["options"]["move_rig"] is True
    assert [motion["sliding"] < 0.1 for motion in json.loads(said)["targets"][0]["motions"]] == [True]
    again, before = read_asset(tmp_path / "out.glb"), read_asset(source)
    assert again.skin is not None
    assert before.skin is not None
    assert again.skin.names == before.skin.names
    assert np.abs(again.skin.inverse_bind - before.skin.inverse_bind).max() > 0.1
    code, said = run(files[0], files[1], "-o", tmp_path / "out.glb", "--move-rig")
    assert (code, "--move-rig has no joints of" in said) == (1, True), said


def test_a_part_of_the_target_receives_data_alone(files: tuple[Path, Path], tmp_path: Path) -> None:
    target = tmp_path / "body.glb"
    own = zo.read_surface(files[1])
    green = Attribute("color 0", Domain.POINT, Kind.COLOR, np.tile([0.0, 1, 0], (len(own.vertices), 1)))
    write_asset(Asset(own, (green,)), target)
    code, said = run(files[0], target, "-o", tmp_path / "out.glb", "--only", "BODY", "--kinds", "color")
    assert code == 0, said
    color = read_asset(tmp_path / "out.glb").find("color 0")
    assert color is not None
    assert np.ptp(color.values[:, 0]) > 0.5
    for arguments, reason in (
        (["--only", "Head"], "The target has no joint or mesh 'Head': choose from 'body'."),
        (["--only", "body", "--keep-map"], "--only works without --keep-map"),
        (["--only", "body", "--move-rig"], "--move-rig has no joints of"),
        (["--only", "body", "--kinds", "weights"], "A part of a target keeps its joints and their weights"),
    ):
        code, said = run(files[0], target, "-o", tmp_path / "none.glb", *arguments)
        assert code in (1, 2)
        assert reason in said


def test_a_part_receives_the_joints_of_a_second_source(tmp_path: Path) -> None:
    body, head = tmp_path / "body.glb", tmp_path / "head.glb"
    write_tube(body)
    write_tube(head)
    file = pygltflib.GLTF2().load(head)
    file.nodes[2].name = "Jaw"
    file.save(head)
    code, said = run(head, body, "-o", tmp_path / "out.glb", "--only", "Upper", "--move-rig", "--kinds", "weights")
    assert code == 0, said
    assert "Transferred: skin weights." in said
    assert "Added below Upper: 1 joint of the source, such as Jaw." in said
    again = read_asset(tmp_path / "out.glb")
    assert again.skin is not None
    assert again.skin.names == ("Lower", "Upper", "Jaw")
    assert again.skin.weights[:, [2]].max() > 0.9
    # Without --move-rig, a part keeps its weights, which are not named then.
    code, said = run(head, body, "-o", tmp_path / "out.glb", "--only", "Upper", "--kinds", "shape-keys,weights")
    assert (code, "Transferred: shape keys.\n" in said) == (0, True), said
    assert read_asset(tmp_path / "out.glb").skin.names == ("Lower", "Upper")
