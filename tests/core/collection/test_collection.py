# SPDX-License-Identifier: GPL-3.0-or-later
"""Match a collection from files to consistent maps and a report."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from creatures import Creature, creature, true_vertex
from skinned_tubes import write_tube

import zoomout_core as zo
from zoomout_core.assets.asset import Asset, Material, material_numbers
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.transfer_asset import KINDS
from zoomout_core.cli import main
from zoomout_core.collection import run as run_module
from zoomout_core.collection import tasks
from zoomout_core.collection.collection import match_collection
from zoomout_core.collection.engine import Done, InThisProcess, Task
from zoomout_core.collection.pair_map import CandidateMaps, PairName, load_candidate_maps
from zoomout_core.collection.report import figures_of_collection, lines_of_collection, page_of
from zoomout_core.collection.shapes import Item
from zoomout_core.collection.tasks import Prepared, place_of_map
from zoomout_core.collection.transfer_records import PairTransfer
from zoomout_core.collection.transfer_template import transfer_template
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.preparation import memory_cache
from zoomout_core.matching.presets import DETAIL
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.messages import is_warning
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

pytestmark = pytest.mark.usefixtures("few_candidates")

FAST = MatchOptions(**DETAIL["fast"])  # type: ignore[arg-type]
# Seeds and poses of four meshes of one creature.
POSES = {"a": (0, 0.0), "b": (1, 0.5), "c": (2, 0.8), "d": (3, 0.3)}


def make_creature(name: str, count: int = 450) -> Creature:
    seed, bend = POSES[name]
    return creature(count, seed=seed, bend=bend, asymmetry=0.3)


def colors_of(surface: zo.Surface) -> Attribute:
    return Attribute("color 0", Domain.POINT, Kind.COLOR, np.clip(0.5 + surface.vertices, 0, 1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four creatures, and a broken file."""
    place = tmp_path_factory.mktemp("shapes")
    for name in POSES:
        write_shape(make_creature(name).surface, place / f"{name}.ply")
    (place / "broken.off").write_text("no mesh")
    return place


@pytest.fixture(scope="module")
def matched(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> zo.CollectionResult:
    files = sorted(folder.iterdir())
    output = tmp_path_factory.mktemp("results")
    return match_collection(files, output, neighbours=3, options=FAST, cache=output / "cache")


def test_every_map_is_right_and_a_broken_file_fails_alone(matched: zo.CollectionResult) -> None:
    assert set(matched.records) == {PairName(*pair) for pair in ("ab", "ac", "ad", "bc", "bd", "cd")}
    assert list(matched.failures) == ["broken"]
    for source, target in matched.records:
        true = true_vertex(make_creature(source), make_creature(target))
        found = matched.surface_map(source, target).vertex
        places = make_creature(source).surface.vertices
        assert np.median(np.linalg.norm(places[found] - places[true], axis=1)) < 0.3
    assert matched.agreement is not None
    assert max(matched.agreement.after.values()) < 0.1


def test_cache_folder_of_the_process_is_unchanged(matched: zo.CollectionResult) -> None:
    assert memory_cache._folder is None
    assert list((matched.folder / "cache").rglob("*.npz"))


def test_existing_results_are_not_recomputed(matched: zo.CollectionResult, folder: Path) -> None:
    files = sorted(folder.glob("*.ply"))
    before = {path: path.stat().st_mtime_ns for path in matched.folder.rglob("*.npz")}
    again = match_collection(files, matched.folder, neighbours=3, options=FAST)
    assert again.matched == 0
    assert again.seconds_of_shapes == {}
    assert again.records == matched.records
    assert {path: path.stat().st_mtime_ns for path in matched.folder.rglob("*.npz")} == before


def test_missing_or_damaged_maps_are_recomputed(matched: zo.CollectionResult, folder: Path) -> None:
    files = sorted(folder.glob("*.ply"))
    lost, damaged = (matched.folder / place_of_map(PairName(*pair)) for pair in ("ab", "cd"))
    whole = np.load(lost)["barycentric"]
    lost.unlink()
    damaged.write_bytes(damaged.read_bytes()[:1000])
    again = match_collection(files, matched.folder, neighbours=3, options=FAST)
    assert again.matched == 2
    assert np.array_equal(np.load(lost)["barycentric"], whole)


def test_progress_is_reported_and_a_cancelled_run_resumes(
    matched: zo.CollectionResult, folder: Path, tmp_path: Path
) -> None:
    def listen(latest: zo.Progress) -> None:
        if latest.stage == "Matching 1 of 2":
            raise zo.Cancelled

    told: list[zo.Progress] = []
    files, pairs = [folder / f"{name}.ply" for name in "abc"], [("a", "b"), ("b", "c")]
    with pytest.raises(zo.Cancelled):
        match_collection(files, tmp_path, pairs=pairs, options=FAST, progress=listen)
    first = tmp_path / place_of_map(PairName("a", "b"))
    assert [path for path in tmp_path.rglob("*") if path.is_file() and "maps" in path.parts] == [first]
    whole = np.load(matched.folder / place_of_map(PairName("a", "b")))
    assert np.array_equal(np.load(first)["barycentric"], whole["barycentric"])
    result = match_collection(files, tmp_path, pairs=pairs, options=FAST, progress=told.append)
    assert (list(result.records), result.matched) == ([PairName(*pair) for pair in pairs], 1)
    fractions = [one.fraction for one in told]
    assert fractions == sorted(fractions)
    titles = list(dict.fromkeys(one.stage for one in told if one.stage))
    assert titles == [f"Matching {number} of 2" for number in range(3)]


def test_workers_without_file_access_receive_the_files(
    folder: Path, tmp_path: Path, matched: zo.CollectionResult
) -> None:
    class Elsewhere(InThisProcess):
        def sees(self, paths: object) -> bool:
            return False

        def as_completed(self, tasks: Sequence[Task]) -> Iterator[Done]:
            for done in super().as_completed(tasks):
                if isinstance(done.result, Prepared):
                    sent[done.result.name] = [name for name in done.result.content if name.startswith("cache")]
                yield done

    zo.forget_shapes()  # shapes in memory would not be stored again
    sent: dict[str, list[str]] = {}
    files = [folder / "a.ply", folder / "b.ply"]
    found = match_collection(files, tmp_path, template=files[0], options=FAST, engine=Elsewhere())
    assert {name: len(prepared) for name, prepared in sent.items()} == {"a": 1, "b": 1}  # each sends its own
    assert memory_cache._folder is None
    assert list(found.records) == [PairName("a", "b")]
    one, two = (np.load(place / place_of_map(PairName("a", "b"))) for place in (matched.folder, tmp_path))
    assert np.array_equal(one["barycentric"], two["barycentric"])


@pytest.mark.parametrize("others", [True, False])
def test_wrong_map_is_replaced_and_the_choice_is_kept(
    folder: Path, matched: zo.CollectionResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, others: bool
) -> None:
    wrong = PairName("b", "d")
    for made_before in ("shapes", "maps"):
        shutil.copytree(matched.folder / made_before, tmp_path / made_before)

    def with_a_wrong_one(path: Path) -> CandidateMaps:
        """Load the maps of a file; for one pair, insert a wrong map before the right one or replace it."""
        maps = load_candidate_maps(path)
        if path != (tmp_path / place_of_map(wrong)).resolve():
            return maps
        shifted = [np.roll(each[0], len(each[0]) // 2) for each in (maps.forward, maps.backward)]
        kept = 1 if others else 0
        return CandidateMaps(
            *(np.vstack([new, each[:kept]]) for new, each in zip(shifted, (maps.forward, maps.backward), strict=True)),
            np.array([0.9, 0.05][: kept + 1]),
            np.zeros(kept + 1, dtype=bool),
        )

    monkeypatch.setattr(run_module, "load_candidate_maps", with_a_wrong_one)
    files = sorted(folder.glob("*.ply"))
    found = match_collection(files, tmp_path, pairs="all", options=FAST)
    assert found.agreement is not None
    assert found.agreement.changed == [wrong]
    assert found.matched == 1
    assert found.agreement.before[wrong] > found.agreement.after[wrong]
    record = found.records[wrong]
    assert (record.candidate, record.through in ("a", "c")) == ((1, False) if others else (0, True))
    if not others:  # the map through another shape is right
        true = true_vertex(make_creature("b"), make_creature("d"))
        places = make_creature("b").surface.vertices
        images = places[found.surface_map(*wrong).vertex]
        assert np.median(np.linalg.norm(images - places[true], axis=1)) < 0.3
    assert match_collection(files, tmp_path, pairs="all", options=FAST).matched == 0


@pytest.mark.slow
def test_surfaces_and_clouds_in_memory_are_matched() -> None:
    shapes = {"body": make_creature("a").surface, "cloud": PointCloud(make_creature("b", 900).surface.vertices)}
    found = match_collection(shapes, template="body", options=FAST)
    assert list(found.records) == [PairName("body", "cloud")]
    assert len(found.surface_map("body", "cloud").vertex) == 900


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ({}, "one of a template"),
        ({"template": "a", "neighbours": 2}, "one of a template"),
        ({"template": "x"}, "The collection has no shape named x"),
        ({"pairs": [("a", "x")]}, "The collection has no shape named x"),
    ],
)
def test_invalid_choices_of_pairs_are_refused(
    folder: Path, tmp_path: Path, choice: dict[str, object], said: str
) -> None:
    with pytest.raises(MeshError, match=said):
        match_collection(sorted(folder.iterdir()), tmp_path / "out", **choice)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


def test_landmarks_need_a_single_pair(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a single pair"):
        match_collection(
            sorted(folder.iterdir()), tmp_path, neighbours=2, options=MatchOptions(landmarks=([0, 1], [0, 1]))
        )


def test_page_shows_every_shape(matched: zo.CollectionResult) -> None:
    page = page_of(matched, {"a": b"png"})
    for name in POSES:
        assert f"<b>{name}</b>" in page
    assert page.count("data:image/png;base64") == 1
    assert "broken" in page
    assert "$" not in page
    assert all(0 <= matched.trust(pair) <= 1 for pair in matched.records)


def test_verdict_of_a_pair_depends_on_its_faults_and_cycles(matched: zo.CollectionResult) -> None:
    pair = PairName("a", "b")
    flawless = {"certainty": 0.99, "low_confidence": 0.0, "share_without_partner": 0.0, "doubtful_vertices": 0.0}
    records = {each: replace(record, **flawless) for each, record in matched.records.items()}
    sure = replace(matched, records=records, agreement=None)
    assert "Verdicts: 6 green." in lines_of_collection(sure)
    torn = replace(sure, records={**records, pair: replace(records[pair], torn=0.05)})
    assert torn.verdict(pair).level == "amber"
    assert "Verdicts: 5 green, 1 amber (check these first)." in lines_of_collection(torn)
    assert figures_of_collection(torn)["verdicts"] == {"green": 5, "amber": 1, "red": 0}
    doubtful = replace(sure, records={**records, pair: replace(records[pair], doubtful_vertices=0.6)})
    assert "60% of the target's vertices" in doubtful.verdict(pair).sentence
    wrong = replace(sure, records={**records, pair: replace(records[pair], certainty=0.2)})
    assert wrong.verdict(pair).level == "red"
    assert 'class="red"' in page_of(wrong, {})
    agreement = matched.agreement
    assert agreement is not None
    open_cycles = replace(sure, agreement=replace(agreement, after={**agreement.after, pair: 1.0}))
    assert open_cycles.verdict(pair).level == "amber"


@pytest.mark.parametrize("force", [False, True])
def test_unlikely_maps_transfer_nothing_unless_forced(
    matched: zo.CollectionResult, tmp_path: Path, force: bool
) -> None:
    surface = make_creature("a").surface
    write_asset(Asset(surface, (colors_of(surface),)), tmp_path / "a.glb")
    pair = PairName("a", "b")
    doubted = replace(
        matched,
        items={**matched.items, "a": Item("a", tmp_path / "a.glb")},
        records={pair: replace(matched.records[pair], certainty=0.1)},
        agreement=None,
        failures={},
    )
    received = transfer_template(doubted, "a", KINDS, "glb", InThisProcess(), force=force)
    assert list(received) == (["b"] if force else [])
    assert (matched.folder / "meshes" / "b.glb").exists() == force
    if not force:
        assert "give --force" in doubted.failures["transfer to b"]


def test_command_transfers_a_template_to_all_and_reports(folder: Path, tmp_path: Path) -> None:
    template = creature(700, asymmetry=0.3)
    colors = np.clip(0.5 + 0.5 * template.directions, 0, 1)
    write_asset(
        Asset(template.surface, (Attribute("color 0", Domain.POINT, Kind.COLOR, colors),)), tmp_path / "hero.glb"
    )
    arguments = ["collection", folder / "b.ply", folder / "broken.off", "-o", tmp_path / "out", "--template"]
    arguments += [tmp_path / "hero.glb", "--transfer", "--workers", "1", "--detail", "fast", "--json"]
    result = CliRunner().invoke(main, list(map(str, arguments)))
    assert result.exit_code == 3, result.stdout + result.stderr
    said = json.loads(result.stdout)
    assert [(pair["source"], pair["target"]) for pair in said["pairs"]] == [("hero", "b")]
    assert list(said["failures"]) == ["broken"]
    assert json.loads((tmp_path / "out" / "report.json").read_text()) == said
    assert "<b>b</b>" in (tmp_path / "out" / "report.html").read_text()
    assert read_asset(tmp_path / "out" / "meshes" / "b.glb").find("color 0") is not None
    assert not (tmp_path / "out" / "cache").exists()


@pytest.fixture(scope="module")
def tubes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A tube with joints and an animation, and a folder with a larger one without joints."""
    place = tmp_path_factory.mktemp("tubes")
    write_tube(place / "hero.glb")
    surface = zo.read_surface(place / "hero.glb")
    (place / "scans").mkdir()
    write_shape(surface.with_vertices(surface.vertices * 3), place / "scans" / "large.ply")
    return place / "hero.glb", place / "scans"


def test_template_s_rig_moves_into_every_mesh_once(tubes: tuple[Path, Path], tmp_path: Path) -> None:
    hero, scans = tubes
    arguments = ["collection", scans, "-o", tmp_path / "out", "--template", hero, "--transfer", "--force", "--json"]
    arguments += ["--workers", 1, "--detail", "fast", "--no-pictures"]
    said = []
    for more in ([], ["--move-rig"], ["--move-rig"]):
        written = tmp_path / "out" / "meshes" / "large.glb"
        before = written.stat().st_mtime_ns if written.exists() else 0
        result = CliRunner().invoke(main, [*map(str, arguments), *more])
        assert result.exit_code == 0, result.stdout + result.stderr
        said.append((written.stat().st_mtime_ns != before, json.loads(result.stdout), read_asset(written)))
    (_, stays, kept), (again, moves, moved), (thrice, resumed, _) = said
    assert (again, thrice) == (True, False)
    assert resumed["transferred"] == moves["transferred"]
    assert resumed["motions"] == moves["motions"]
    assert len(moves["motions"]["large"]) == 1
    assert "motions" not in stays
    source = read_asset(hero)
    assert source.skin is not None
    assert moved.skin is not None
    assert kept.skin is not None
    apart = [np.linalg.norm(np.linalg.inv(each.skin.inverse_bind)[-1, :3, 3]) for each in (source, kept, moved)]
    np.testing.assert_allclose(np.divide(apart[1:], apart[0]), [1, 3], rtol=0.1)
    assert "<h2>Transferred</h2>" in (tmp_path / "out" / "report.html").read_text()


def test_transfer_that_was_interrupted_is_repeated(
    tubes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hero, output, record = tubes[0], tmp_path / "large.glb", tmp_path / "large.json"
    surface = zo.read_surface(hero)
    zo.SurfaceMap.from_vertices(np.arange(len(surface.vertices)), surface).save(tmp_path / "map.npz")

    def rig(move_rig: bool) -> float:
        paths = hero, tubes[1] / "large.ply", tmp_path / "map.npz", output
        tasks.transfer_pair(PairTransfer(*paths, ("weights",), record, move_rig))
        return float(np.ptp(read_asset(output).surface.vertices, axis=0).max())

    size = rig(True)
    with monkeypatch.context() as patch:
        patch.delattr(tasks, "write_outcome")
        with pytest.raises(NameError):
            rig(False)
    assert rig(True) == pytest.approx(size)
    assert rig(False) < 0.5 * size


def test_moving_a_rig_needs_joints(folder: Path, tmp_path: Path) -> None:
    arguments = ["collection", folder, "-o", tmp_path / "out", "--template", folder / "a.ply", "--move-rig"]
    for more in ([], ["--transfer", "--kinds", "uv"]):
        result = CliRunner().invoke(main, [*map(str, arguments), *more])
        assert (result.exit_code, "--move-rig moves the joints" in result.stderr) == (2, True)
    surface = zo.read_surface(folder / "a.ply")
    write_asset(Asset(surface, (colors_of(surface),)), tmp_path / "hero.glb")
    arguments[5] = tmp_path / "hero.glb"
    result = CliRunner().invoke(main, [*map(str, arguments), "--transfer"])
    assert (result.exit_code, "--move-rig has no joints of" in result.stderr) == (1, True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--all-pairs", "--neighbours", "3"], "Give only one"),
        (["--transfer"], "choose it with --template"),
        (["--output", __file__], "is a file: name a folder"),
        (["--output", "/no/such/place/out"], "There is no folder"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "leave out --workers"),
    ],
)
def test_command_refuses_conflicting_options(folder: Path, tmp_path: Path, arguments: list[str], said: str) -> None:
    result = CliRunner().invoke(main, ["collection", str(folder), "-o", str(tmp_path / "out"), *arguments])
    assert result.exit_code == (1 if "--output" in arguments else 2)
    assert said in result.stderr


@pytest.mark.parametrize(
    ("pairs", "said"),
    [
        ("some", "pairs is 'some': give 'all', or a list of pairs"),
        (7, "pairs is 7: give 'all', or a list of pairs"),
        ([(0, 1)], r"A pair is \(0, 1\): give the names"),
        ([7], "A pair is 7: give the names"),
        (["ab"], "A pair is 'ab': give the names"),
        ((each for each in [("a", "b", "c")]), r"A pair is \('a', 'b', 'c'\): give the names"),
        ([("a", "other")], "has no shape named other: give its file name"),
    ],
)
def test_pairs_that_are_no_names_are_refused(folder: Path, tmp_path: Path, pairs: Any, said: str) -> None:
    with pytest.raises(MeshError, match=said):
        match_collection(sorted(folder.iterdir()), tmp_path / "out", pairs=pairs, options=FAST)


def test_the_cache_of_a_collection_must_be_a_folder(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    arguments = ["collection", folder, "-o", tmp_path / "out", "--cache", tmp_path / "file"]
    result = CliRunner().invoke(main, [*map(str, arguments)])
    assert (result.exit_code, "file cannot be written to: choose another folder." in result.stderr) == (1, True)
    assert not (tmp_path / "out").exists()


def test_notes_of_a_pair_list_parts_of_the_source_by_name(tmp_path: Path) -> None:
    body = creature(400).surface
    lump = zo.Surface(body.vertices * 0.3 + body.vertices[body.vertices[:, 2].argmax()], body.triangles)
    left = body.vertices[body.triangles].mean(axis=1)[:, 0] > 0.2
    number = np.concatenate([left, np.full(len(left), 2)])
    materials = tuple(map(Material, ("Skin", "Shirt", "Hat")))
    files = tmp_path / "source.obj", tmp_path / "target.ply"
    write_asset(Asset(zo.Surface.joined([body, lump]), (material_numbers(number),), materials), files[0])
    write_shape(body, files[1])
    result = match_collection(files, tmp_path / "out", pairs=[("source", "target")], options=FAST)
    (record,) = result.records.values()
    shares, silent, *_ = record.notes
    assert shares.startswith("Share of the target's area by part of the source: 'S")
    assert "'Skin' " in shares
    assert "'Shirt' " in shares
    assert silent == "Almost nothing arrives from 'Hat'."
    assert is_warning(silent)
    assert not is_warning(shares)
    (row,) = figures_of_collection(result)["pairs"]
    assert row["warnings"][0] == silent
    assert f"Warning: {escape(silent)}" in page_of(result, {})
