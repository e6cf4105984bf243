# SPDX-License-Identifier: GPL-3.0-or-later
"""`zoomout find` finds the sources of a folder of targets, transfers from them, and resumes."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pygltflib
import pytest
from click.testing import CliRunner
from scipy.sparse import csr_array
from skinned_tubes import write_tube

import zoomout_core as zo
from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.cli import main
from zoomout_core.collection.transfer_records import PairTransfer, TransferOutcome
from zoomout_core.colors import place_colors
from zoomout_core.library import find_all as batch
from zoomout_core.library import transfers
from zoomout_core.library.bodies import Body, bodies_of
from zoomout_core.library.found import FoundSource, FoundSources
from zoomout_core.library.library import Library
from zoomout_core.library.pictures import draw_bound, draw_colored
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.samples import creature
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

pytestmark = pytest.mark.usefixtures("quick_search", "coarse_hulls")


@pytest.fixture(scope="module")
def bodies() -> dict[str, Body]:
    return bodies_of(creature(500, seed=2).surface)


@pytest.fixture
def folders(tmp_path: Path, bodies: dict[str, Body], monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A prepared library of one coloured creature, and a folder with another mesh of it and a broken file.

    Each search finds the creature at once.
    """
    library, scans = tmp_path / "library", tmp_path / "scans"
    library.mkdir()
    scans.mkdir()
    hero = creature(500, seed=2).surface
    color = Attribute(
        "color 0",
        Domain.POINT,
        Kind.COLOR,
        np.column_stack([place_colors(hero.vertices, hero.vertices), np.ones(len(hero.vertices))]),
    )
    write_asset(Asset(hero, (color,)), library / "hero.glb")
    write_shape(creature(600, seed=3).surface, scans / "scan.ply")
    (scans / "broken.obj").write_text("v 0 0\nf 1 2 3\n")
    monkeypatch.setattr("zoomout_core.library.library.bodies_of", lambda _: bodies)
    Library(library).prepare()
    best = FoundSource(library / "hero.glb", 0.4, 0.97, 0.06)
    monkeypatch.setattr(batch, "search", lambda *_: FoundSources((best,), best.path, ""))
    return library, scans


def run(*arguments: object) -> tuple[int, dict]:
    outcome = CliRunner().invoke(main, ["find", *map(str, arguments), "--json"])
    return outcome.exit_code, json.loads(outcome.stdout)


def test_folder_of_targets_receives_data_and_resumes(
    folders: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library, scans = folders
    out = tmp_path / "out"
    arguments = scans, "--library", library, "-o", out, "--transfer", "--force"
    code, report = run(*arguments)
    assert code == 3, report
    assert list(report["failures"]) == ["broken"]
    (row,) = report["targets"]
    assert (row["output"], row["source"]) == ("targets/scan.glb", str(library / "hero.glb"))
    made = read_asset(out / row["output"])
    (color,) = (each for each in made.attributes if each.kind is Kind.COLOR)
    assert np.ptp(color.values[:, :3], axis=0).min() > 0.5
    page = (out / "report.html").read_text(encoding="utf-8")
    assert (page.count("data:image/png;base64,"), "broken" in page) == (1, True)
    # An interrupted run resumes; results that are missing, or were made of other files, are made again.
    monkeypatch.setattr(batch, "search", None)
    assert run(*arguments)[1]["new"] == 0
    (out / row["output"]).unlink()
    with pytest.raises(TypeError):
        CliRunner().invoke(main, ["find", *map(str, arguments)], catch_exceptions=False)
    assert not (out / "records" / "scan.json").exists()  # its files may be those of other options


def test_bound_target_is_drawn_in_the_pose_of_its_joints() -> None:
    source = creature(300, seed=2).surface
    count, turn = len(source.vertices), np.diag([-1.0, -1, 1, 1])
    match = SimpleNamespace(
        source=source,
        target=source.with_vertices(source.vertices[:, [1, 0, 2]]),
        surface_map=SurfaceMap.from_vertices(np.arange(count), source),
    )
    joint = {"nodes": np.zeros(1, int), "names": ("Root",), "parents": np.array([-1]), "inverse_bind": np.eye(4)[None]}
    weights = csr_array(np.ones((count, 1)))
    rest = source.vertices * [-1, -1, 1]
    skin = Skin(**joint, transforms=turn[None], rest=rest, linear=np.tile(np.eye(3), (count, 1, 1)), weights=weights)
    expected = draw_colored(source, place_colors(source.vertices, source.vertices))
    np.testing.assert_array_equal(draw_bound(match, skin), expected)


def test_unsuitable_source_fails_only_its_target(
    folders: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library, scans = folders
    arguments = scans / "scan.ply", "--library", library, "-o", tmp_path / "out"
    code, report = run(*arguments, "--move-rig", "--force")
    assert code == 1
    assert "has no joints to move" in report["failures"]["scan"]
    best = FoundSource(library / "hero.blend", 0.4, 0.97, 0.06)
    monkeypatch.setattr(batch, "search", lambda *_: FoundSources((best,), best.path, ""))
    monkeypatch.setenv("ZOOMOUT_BLENDER", "missing")
    assert "There is no program missing" in run(*arguments, "--transfer")[1]["failures"]["scan"]
    assert not (tmp_path / "out" / "targets").exists()


@pytest.mark.parametrize(("option", "moves"), [("--transfer", False), ("--move-rig", True)])
def test_blender_transfers_from_its_own_files(
    folders: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, moves: bool
) -> None:
    library, scans = folders
    pack = library / "pack.blend"
    pack.touch()
    best = FoundSource(pack / "Collection" / "Hero", 0.4, 0.97, 0.06)
    monkeypatch.setattr(batch, "search", lambda *_: FoundSources((best,), best.path, ""))
    read: list[tuple[Path, str, bool]] = []

    def read_item(path: Path, role: str, output: Path, known: bool, _: str | None) -> None:
        read.append((path, role, known))
        write_shape(zo.read_surface(library / "hero.glb" if role == "source" else path), output)

    def transfer_pair_through_blender(transfer: PairTransfer, program: str | None) -> TransferOutcome:
        assert (transfer.source, transfer.target, program) == (best.path, scans / "scan.ply", None)
        zo.SurfaceMap.load(transfer.map_file, zo.read_surface(library / "hero.glb"))
        assert transfer.move_rig is moves
        transfer.output.parent.mkdir(parents=True)
        transfer.output.write_text("written by Blender")
        return TransferOutcome(("Blender said this.",))

    drawn: list[np.ndarray] = []
    draw_pair = batch.draw_pair
    monkeypatch.setattr(batch, "draw_pair", lambda result: drawn.append(result.source.vertices) or draw_pair(result))
    monkeypatch.setattr(transfers, "read_item", read_item)
    monkeypatch.setattr(transfers, "transfer_pair_through_blender", transfer_pair_through_blender)
    code, report = run(scans / "scan.ply", "--library", library, "-o", tmp_path / "out", option, "--force")
    assert not report["failures"]
    (row,) = report["targets"]
    assert (code, row["output"], row["source"]) == (0, "targets/scan.blend", str(best.path))
    assert "Blender said this." in row["notes"]
    # Blender's z axis is up, and y in pictures.
    np.testing.assert_allclose(drawn[0], zo.read_surface(library / "hero.glb").vertices[:, [0, 2, 1]] * [1, 1, -1])
    assert read == [(best.path, "source", True), (scans / "scan.ply", "target", True)]


def test_source_of_a_part_gives_its_joints_to_the_written_target(
    folders: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library, scans = folders
    body, head = library / "body.glb", library / "head.glb"
    for path in (body, head):
        write_tube(path)
    file = pygltflib.GLTF2().load(head)
    file.nodes[2].name = "Jaw"
    file.save(head)
    write_shape(zo.read_surface(body), scans / "scan.ply")
    part = zo.FoundPart(head, body, "Upper", ("Upper",), 0.99, 0.95)
    best = FoundSource(body, 0.4, 0.97, 0.06)
    monkeypatch.setattr(batch, "search", lambda *_: FoundSources((best,), best.path, "", part))
    arguments = scans / "scan.ply", "--library", library, "-o", tmp_path / "out"
    code, report = run(*arguments, "--move-rig", "--parts", "--force")
    assert (code, report["failures"]) == (0, {})
    assert any(
        note.startswith("The joint Upper and all below it have the data") for note in report["targets"][0]["notes"]
    )
    skin = read_asset(tmp_path / "out" / "targets" / "scan.glb").skin
    assert skin is not None
    assert skin.names == ("Lower", "Upper", "Jaw")
    # Without --parts it is only proposed, as it is if its match is wrong.
    report = run(*arguments, "--move-rig", "--force")[1]
    assert str(part.sentence) in report["targets"][0]["notes"]
    monkeypatch.setattr(transfers, "check_verdict", lambda *_: None)
    red = zo.Verdict("red", "It is wrong.", "")
    monkeypatch.setattr(zo.MatchResult, "verdict", property(lambda _: red))
    report = run(*arguments, "--move-rig", "--parts")[1]
    assert any("was not used for the joint Upper" in note for note in report["targets"][0]["notes"])
    skin = read_asset(tmp_path / "out" / "targets" / "scan.glb").skin
    assert skin is not None
    assert skin.names == ("Lower", "Upper")
    assert CliRunner().invoke(main, ["find", *map(str, arguments), "--parts"]).exit_code == 2


def test_rejected_source_is_pictured_with_the_reason(
    folders: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library, scans = folders
    monkeypatch.setattr(batch, "search", lambda *_: FoundSources((), library / "hero.glb", "Nothing fits."))
    code, report = run(scans / "scan.ply", "--library", library, "-o", tmp_path / "out", "--transfer")
    assert code == 1
    assert report["targets"][0]["verdict"]["sentence"] == "Nothing fits."
    assert (tmp_path / "out" / "pictures" / "scan.png").is_file()
    assert not (tmp_path / "out" / "targets").exists()


def test_several_targets_need_an_output_folder_apart_from_inputs(folders: tuple[Path, Path], tmp_path: Path) -> None:
    library, scans = folders
    assert run(scans, "--library", library)[0] == 2
    inside = tmp_path / "out" / "targets"
    inside.mkdir(parents=True)
    write_shape(creature(300).surface, inside / "a.ply")
    code, report = run(inside / "a.ply", "--library", library, "-o", tmp_path / "out")
    assert code == 1
    assert "in a place of" in report["error"]
