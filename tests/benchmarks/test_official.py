# SPDX-License-Identifier: GPL-3.0-or-later
"""Test lists are read in each layout, measured as the protocol says, resumed, and reported from records alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import write_off

import zoomout_core as zo
from benchmarks.__main__ import main
from benchmarks.curves import THRESHOLDS
from benchmarks.official import measure as measuring
from benchmarks.official import page as pages
from benchmarks.official import records as recording
from benchmarks.official.lists import MAPS, NONE, TEMPLATE, OfficialList, _truth, lists_in
from benchmarks.official.measure import Setting, distances, measure, overlap
from benchmarks.stored import read
from benchmarks.tables import Record
from zoomout_core.samples.grids import grid

# A flat strip of two rows, which is as long as 3 and as wide as 1.
STRIP = grid(np.arange(4.0), np.arange(2.0))
EVERY = np.arange(len(STRIP.vertices))
FAR_END, UNIT = len(EVERY) - 1, 100 / np.sqrt(3)
PROTOCOL: Record = {
    "protocol": "both ways.",
    "published": {
        "axiomatic": [{"method": "Old", "x100": 6.1, "source": "A paper"}],
        "trained": [{"method": "Good", "x100": 1.5}, {"method": "Worse", "x100": 3.0}],
        "source": "Another paper",
    },
}
Match = Callable[..., Any]


def make_list(folder: Path, pairs: str, truth: dict[str, Any] | None = None, shapes: str = "a b c") -> OfficialList:
    """A set of strips in the layout of the official lists."""
    (folder / "shapes").mkdir(parents=True)
    for name in shapes.split():
        write_off(folder / "shapes" / f"{name}.off", STRIP)
    (folder / "pairs.txt").write_text(pairs)
    (folder / "protocol.json").write_text(json.dumps(PROTOCOL))
    if truth is not None:
        np.savez(folder / "truth.npz", **truth)
    return OfficialList.load(folder)


@pytest.fixture
def match_to(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Any]]:
    """Replaces `zo.match` by a map to given source vertices, and returns the list of its calls."""

    def install(vertex: Any, has_partner: Any = None, certainty: float = 0.97) -> list[Any]:
        calls: list[Any] = []

        def match(source: zo.Surface, target: zo.Surface) -> Any:
            calls.append((source, target))
            there = np.ones(len(target.vertices), dtype=bool) if has_partner is None else has_partner
            surface_map = zo.SurfaceMap.from_vertices(vertex, source)
            return SimpleNamespace(surface_map=surface_map, certainty=certainty, has_partner=there)

        monkeypatch.setattr(zo, "match", match)
        return calls

    return install


# --- layouts ------------------------------------------------------------------------------------------------------


def test_templates_correspond_entry_by_entry(tmp_path: Path) -> None:
    chosen = make_list(tmp_path / "set", "a b\n\nb a\n", {"a": [0, -1, 2, 3], "b": [5, 6, -1, 7], "c": [1]})
    assert (chosen.truth_kind, chosen.pairs) == (TEMPLATE, (("a", "b"), ("b", "a")))
    assert [places.tolist() for places in chosen.places("a", "b")] == [[0, 3], [5, 7]]
    with pytest.raises(ValueError, match="same length for a and c"):
        chosen.places("a", "c")


def test_distributed_files_count_from_one(tmp_path: Path) -> None:
    for folder, name, content in [
        ("off", "a.off", ""),
        ("corres", "a.vts", "1\n3\n0\n"),
        ("corres", "b.vts", "2\n4\n1\n"),
    ]:
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_text(content)
    (tmp_path / "pairs.txt").write_text("a b")
    (chosen,) = lists_in(tmp_path)
    assert chosen.shape_file("a") == tmp_path / "off" / "a.off"
    assert [places.tolist() for places in chosen.places("a", "b")] == [[0, 2], [1, 3]]
    assert chosen.protocol == {}
    with pytest.raises(ValueError, match=r"no shape b\.off"):
        chosen.shape_file("b")


def test_a_truth_may_be_a_map_for_each_pair(tmp_path: Path) -> None:
    image = [3, -1, 2]
    chosen = make_list(tmp_path / "set", "a b\ncut\n", {"a__b": image, "cut": image})
    assert chosen.truth_kind == MAPS
    for pair in chosen.pairs:
        assert [places.tolist() for places in chosen.places(*pair)] == [[0, 2], [3, 2]]
    assert chosen.pairs[1] == ("cut_target", "cut_source")
    with pytest.raises(ValueError, match="no b__a"):
        chosen.image("b", "a")


def test_a_set_may_have_no_truth(tmp_path: Path) -> None:
    assert make_list(tmp_path / "missing", "a b").truth_kind == NONE
    assert make_list(tmp_path / "empty", "a b", {}).truth_kind == NONE


def test_a_larger_sample_has_the_smaller_one() -> None:
    names = [str(number) for number in range(20)]
    chosen = OfficialList(Path(), tuple((a, b) for a in names for b in names))
    few, more = chosen.sample(20), chosen.sample(40)
    assert more[:20] == few
    # Evenly spread, they would be the 20 pairs of a shape with itself.
    assert sum(a == b for a, b in few) < 5
    assert chosen.sample(None) == chosen.sample(400) == list(chosen.pairs)


def test_invalid_sets_are_refused_in_a_sentence(tmp_path: Path) -> None:
    def said(*arguments: str) -> str:
        outcome = CliRunner().invoke(main, ["official", "--data", str(tmp_path), *arguments])
        assert outcome.exit_code == 1
        return outcome.output

    assert "has no set: a set is a folder with pairs.txt" in said()
    make_list(tmp_path / "set", "a b")
    (tmp_path / "set" / "pairs.txt").write_text("a b c")
    assert "has the line 'a b c': write the names of target and source" in said()
    (tmp_path / "set" / "pairs.txt").write_text("\n")
    assert "has no pairs" in said()
    assert "has no set 'other': it has set" in said("--set", "other")


# --- measures -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [0, 100])
def test_distances_run_along_edges_at_unit_area(tmp_path: Path, kept: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "MAX_KEPT", kept)
    apart = zo.Surface.joined([STRIP, STRIP.with_vertices(STRIP.vertices + np.array([9, 0, 0]))])
    write_off(tmp_path / "apart.off", apart)
    found = distances(tmp_path / "apart.off", np.array([2, 0, 9]), np.array([0, 0, 2]))
    # The strips are not connected: the vertex farthest from the second column is in the last one.
    assert found * np.sqrt(6) == pytest.approx([1, 0, found[2] * np.sqrt(6)])
    assert 2 <= found[2] * np.sqrt(6) <= 3


def test_shapes_are_rotated_and_scaled_reproducibly() -> None:
    source, target = Setting(rotate=True, scale=True).place(STRIP, STRIP, 7)
    again = Setting(rotate=True, scale=True).place(STRIP, STRIP, 7)
    assert (source.vertices == again[0].vertices).all()
    assert (target.vertices == again[1].vertices).all()
    assert source.area == pytest.approx(STRIP.area)
    factor = np.sqrt(target.area / STRIP.area)
    assert factor != pytest.approx(1)
    assert not np.allclose(factor * source.vertices, target.vertices)  # rotated otherwise
    assert Setting().place(STRIP, STRIP, 7) == (STRIP, STRIP)
    factors = [np.sqrt(Setting(scale=True).place(STRIP, STRIP, seed)[1].area / STRIP.area) for seed in range(50)]
    assert 0.5 <= min(factors) < 0.6
    assert 1.7 < max(factors) <= 2


def test_the_error_is_over_all_vertices_that_have_a_partner(tmp_path: Path, match_to: Match) -> None:
    truth = np.where(EVERY < 4, EVERY, -1)
    chosen = make_list(tmp_path / "set", "a b", {"a__b": truth})
    match_to(np.maximum(EVERY - 2, 0), has_partner=EVERY < 6)
    record = measure(chosen, "a", "b", Setting())
    # Vertices 2 and 3 are one column off; 1 is at 0, which is one row off.
    assert record["error"] == pytest.approx(UNIT * 3 / 4)
    assert record["curve"][0] == 0.25
    assert record["IoU"] == pytest.approx(4 / 6)
    assert record["certainty"] == 0.97
    assert record["seconds"] > 0


def test_overlap_counts_vertices() -> None:
    one, other = np.array([True, True, False, False]), np.array([True, False, True, False])
    assert overlap(one, other) == pytest.approx(1 / 3)
    assert overlap(one | True, other | True) == 1
    assert overlap(one & False, other & False) == 0


def test_without_truth_a_map_is_compared_with_others(tmp_path: Path, match_to: Match) -> None:
    chosen = make_list(tmp_path / "set", "a b\nb c\n", {})
    calls = match_to(EVERY)
    record = measure(chosen, "a", "b", Setting())
    assert [record[name] for name in pages.AGREEMENTS] == [0, 0, 0, 0]
    assert record["distortion"] == 0
    (source, target), turned, scaled, mirrored, *_ = calls
    assert len(calls) == 6
    for other in turned, scaled, mirrored:
        assert not np.allclose(other[1].vertices, target.vertices)
    assert (mirrored[0].vertices == source.vertices * [-1, 1, 1]).all()
    assert (mirrored[0].triangles[:, 0] == source.triangles[:, 2]).all()
    # A map that moves everything by a column: three of them, one after the other, arrive at the end of the strip.
    match_to(np.minimum(EVERY + 2, FAR_END - 1 + EVERY % 2))
    record = measure(chosen, "a", "b", Setting())
    assert record["cycle"] == pytest.approx(UNIT * (3 + 2 + 1) / 4)
    assert record["distortion"] > 0


# --- records ------------------------------------------------------------------------------------------------------


def test_an_interrupted_run_is_resumed(tmp_path: Path, match_to: Match, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = make_list(tmp_path / "set", "a b\nb a\na a\n", dict.fromkeys("abc", EVERY))
    calls = match_to(EVERY)
    recording.run([chosen], Setting(), 1, tmp_path / "records", 1)
    assert len(calls) == 1
    path = tmp_path / "records" / "set.jsonl"
    path.write_text(path.read_text() + '{"target": "b", "sour')
    recording.run([chosen], Setting(), None, tmp_path / "records", 1)
    assert len(calls) == 3
    assert {(record["target"], record["source"]) for record in read(path)} == set(chosen.pairs)
    recording.run([chosen], Setting(rotate=True), 1, tmp_path / "records", 1)
    assert len(calls) == 4
    monkeypatch.setattr(recording, "code_version", lambda *_: "other")
    recording.run([chosen], Setting(), 2, tmp_path / "records", 1)
    ((name, about, records),) = recording.sets_in(tmp_path / "records")
    assert (name, about["pairs"], about["self-pairs"]) == ("set", 3, 1)
    assert [record["code"] for record in records] == ["other", "other"]


def test_a_pair_without_a_map_is_recorded_as_failed(tmp_path: Path, match_to: Match) -> None:
    chosen = make_list(tmp_path / "set", "a b\na c\n", {"a": [0], "b": [99], "c": [0]})
    match_to(EVERY)
    recording.run([chosen], Setting(), None, tmp_path, 1)
    ((_, about, records),) = recording.sets_in(tmp_path)
    assert "The truth of b" in records[0]["failed"]
    (row,) = pages.rows_of("set", about, records)
    assert (row["pairs"], row["no map"], row["success %"]) == (2, 1, 50)
    assert pages.tables(tmp_path)["set, wrong"][0]["no map"] == records[0]["failed"]
    np.savez(tmp_path / "set" / "truth.npz", a=[0], b=[0], c=[0])
    _truth.cache_clear()
    recording.run([chosen], Setting(), None, tmp_path, 1)
    ((_, about, records),) = recording.sets_in(tmp_path)
    (row,) = pages.rows_of("set", about, records)
    assert (row["pairs"], row["no map"], row["success %"]) == (2, None, 100)


# --- tables and the page ------------------------------------------------------------------------------------------


def about(**changes: Any) -> Record:
    return {"protocol": PROTOCOL, "pairs": 4, "truth": TEMPLATE, "is far": False, "made with": "2 cores"} | changes


def record(target: str, source: str, error: float, certainty: float = 0.5, setting: str = "as is") -> Record:
    return {
        "code": "1f",
        "target": target,
        "source": source,
        "setting": setting,
        "error": error,
        "certainty": certainty,
        "seconds": error,
        "processor seconds": 1.0,
        "flipped %": 1.0,
        "curve": [0.5] * len(THRESHOLDS),
    }


def test_means_include_and_exclude_self_pairs() -> None:
    records = [record("a", "a", 0.0), record("a", "b", 3.0, 0.95), record("b", "a", 9.0, 0.92)]
    (row,) = pages.rows_of("set", about(), records)
    assert (row["pairs"], row["of"], row["error"], row["without self-pairs"], row["median"]) == (3, 4, 4, 6, 3)
    assert row["success %"] == pytest.approx(200 / 3)
    assert (row["certain"], row["certain and wrong"], row["seconds"]) == (2, 1, 3)
    (far,) = pages.rows_of("set", about(**{"is far": True}), records)
    assert (far["success %"], far["certain and wrong"]) == (100, 0)


def test_settings_are_averaged_if_their_pairs_are_equal() -> None:
    records = [record("a", "b", float(number), setting=name) for number, name in enumerate(pages.SETTINGS)]
    rows = pages.rows_of("set", about(), records)
    assert [row["input"] for row in rows] == [*pages.SETTINGS, "all four"]
    assert (rows[-1]["error"], rows[-1]["of"]) == (1.5, 16)
    assert len(pages.rows_of("set", about(), [*records, record("b", "a", 1.0)])) == 4


def test_shape_excluded_by_papers_has_a_row_without_it() -> None:
    rows = pages.rows_of("SHREC19_r", about(), [record("1", "40", 7.0), record("1", "2", 3.0)])
    assert [(row["input"], row["error"]) for row in rows] == [("as is", 5), ("as is, without shape 40", 3)]


def test_the_page_follows_its_records(tmp_path: Path) -> None:
    folder, page = tmp_path / "results", tmp_path / "results.md"

    def written(**changes: Any) -> str:
        (folder / "FAUST.json").write_text(json.dumps(about(**changes)))
        pages.write(folder, page)
        return page.read_text()

    folder.mkdir()
    records = [record("a", "b", 2.0), record("b", "a", 9.0, 0.95)]
    (folder / "FAUST.jsonl").write_text("\n".join(json.dumps(each) for each in records))
    text = written()
    assert "*List*: both ways." in text
    assert "A random sample of the list is measured: 2 of 4 pairs as is." in text
    assert "1.5 (Good)" in text
    assert "6.1 (Old)" in text
    assert "![Share of vertices up to each error](results/FAUST.png)" in text
    assert (folder / "FAUST.png").is_file()
    methods = [row["method"] for row in pages.tables(folder)["FAUST, published"]]
    assert methods == ["Good", "Worse", "zo.match, as is", "Old"]
    ((wrong),) = pages.tables(folder)["FAUST, wrong"]
    assert (wrong["target"], wrong["certainty"]) == ("b", 0.95)
    assert "All 2 pairs of the list are measured." in written(pairs=2)
    assert "published methods" not in written(protocol={})


def test_pairs_measured_beside_other_processes_have_no_seconds(tmp_path: Path) -> None:
    records = [record("a", "b", 2.0) | {"load": 0.5}, record("b", "a", 9.0) | {"load": pages.MAX_LOAD + 0.1}]
    (row,) = pages.rows_of("set", about(), records)
    assert (row["error"], row["seconds"]) == (5.5, 2)
    (tmp_path / "set.json").write_text(json.dumps(about()))
    (tmp_path / "set.jsonl").write_text("\n".join(map(json.dumps, records)))
    pages.write(tmp_path, tmp_path / "page.md")
    assert "threads ran for each core: 1 of them." in (tmp_path / "page.md").read_text()


def test_methods_with_only_published_overlap_are_sorted_by_it() -> None:
    published = {"mIoU_trained": [{"method": "B", "mIoU": 70.0}, {"method": "A", "mIoU": 80.0}], "source": "A paper"}
    rows = [{"input": "as is", "error": 5.0, "mIoU": 75.0}]
    standing = pages._standing({"protocol": {"published": published}}, rows)
    assert [(row["method"], row["kind"]) for row in standing] == [
        ("A", "trained"),
        ("zo.match, as is", "nothing trained"),
        ("B", "trained"),
    ]
    assert pages._best(standing[:1]) == {"best trained": "mIoU 80 (A)"}
    unknown = {"method": "C", "kind": "axiomatic", "error": 2.0, "mIoU": None}
    assert pages._best([*standing[:1], standing[2], unknown]) == {"best trained": "mIoU 80 (A)"}


def test_a_set_without_truth_has_figures_of_agreement(tmp_path: Path) -> None:
    agreeing = dict.fromkeys(pages.AGREEMENTS, 1.0) | {"distortion": 2.0, "certainty": 0.95, "flipped %": 2.0}
    lost = agreeing | {"cycle": 30.0, "flipped %": 98.0}
    base = {"code": "1f", "setting": "as is", "seconds": 1.0}
    records = [base | {"target": "a", "source": "b"} | agreeing, base | {"target": "b", "source": "a"} | lost]
    (row,) = pages.rows_of("set", about(truth=NONE), records)
    assert (row["cycle"], row["turned"], row["all agree %"], row["distortion"]) == (15.5, 1, 50, 2)
    assert (row["turned over"], row["certain"], row["certain, not all agree"]) == (1, 2, 1)
    (tmp_path / "set.json").write_text(json.dumps(about(truth=NONE)))
    (tmp_path / "set.jsonl").write_text("\n".join(map(json.dumps, records)))
    pages.write(tmp_path, tmp_path / "page.md")
    assert "certain, not all agree" in (tmp_path / "page.md").read_text()


def test_documentation_page_is_up_to_date() -> None:
    docs = Path(__file__).parents[2] / "docs"
    assert pages.as_page(docs / "results") == (docs / "results.md").read_text()


def run_command(data: Path, folder: Path, *options: str) -> Record:
    """The only row of a set, from the command with one pair, whose page and records are in a folder."""
    arguments = ["official", "--data", str(data), "--pairs", "1", "--page", str(folder / "results.md"), *options]
    outcome = CliRunner().invoke(main, [*arguments, "--json", str(folder / "tables.json")])
    assert outcome.exit_code == 0, outcome.output
    tables = json.loads((folder / "tables.json").read_text())
    name = tables["sets"][0]["set"]
    (row,) = tables[name]
    assert f"## {name}" in (folder / "results.md").read_text()
    assert len((folder / "results" / f"{name}.jsonl").read_text().splitlines()) == 1
    return row


def test_the_command_measures_reports_and_writes_the_page(tmp_path: Path, match_to: Match) -> None:
    make_list(tmp_path / "set", "a b", {"a": EVERY, "b": EVERY})
    match_to(EVERY)
    row = run_command(tmp_path, tmp_path, "--rotate", "--scale", "--workers", "1")
    assert (row["input"], row["pairs"], row["error"]) == ("turned and scaled", 1, 0)
    page = tmp_path / "results.md"
    before = page.read_text()
    page.unlink()
    assert CliRunner().invoke(main, ["official", "--page", str(page)]).exit_code == 0
    assert page.read_text() == before


@pytest.mark.slow
def test_processes_share_the_pairs(tmp_path: Path, data: Path) -> None:
    row = run_command(data, tmp_path, "--rotate", "--workers", "2")
    assert (row["input"], row["success %"]) == ("turned", 100)
    assert row["error"] < 8


ALL = {"a": EVERY, "b": EVERY}
BAD_FILES: dict[str, tuple[str, bytes, str]] = {
    "pairs that are no text": ("pairs.txt", b"\xff\xfea", "is not a text file in UTF-8: save it as one"),
    "a truth that is no archive": ("truth.npz", b"junk", "it is not an .npz file, or it is damaged"),
    "an empty truth": ("truth.npz", b"", "it is not an .npz file, or it is damaged"),
    "a protocol that is no JSON": ("protocol.json", b"{", "is not valid JSON in line 1: correct it"),
    "a protocol that is a list": ("protocol.json", b"[]", "must be a JSON object"),
    "published figures in a list": ("protocol.json", b'{"published": [1]}', "must be a JSON object"),
}
BAD_TRUTHS: dict[str, tuple[dict[str, Any], str]] = {
    "other names": ({"x": EVERY}, "no lists of the same length"),
    "no partner at all": ({"a": -EVERY - 1, "b": EVERY}, "no partner for any vertex of a on b"),
    "numbers beyond the shape": ({"a": EVERY + 90, "b": EVERY}, "must be vertex numbers from 0 to 7"),
    "a map of another shape": ({"a__b": EVERY[:3]}, "has 3 entries, but the shape 8 vertices"),
    "fractions": ({"a": EVERY + 0.5, "b": EVERY}, "not a list of whole numbers"),
    "not numbers": ({"a": EVERY * np.nan, "b": EVERY}, "not a list of whole numbers"),
    "words": ({"a": np.array(["x"] * len(EVERY)), "b": EVERY}, "not a list of whole numbers"),
    "tables": ({"a": np.zeros((8, 2)), "b": np.zeros((8, 2))}, "not a list of whole numbers"),
}


def official(folder: Path, *more: object) -> Any:
    """Run the command on the sets in a folder."""
    page = folder.parent / "page.md"
    options = ["--data", folder, "--page", page, "--workers", 1, *more]
    return CliRunner().invoke(main, ["official", *map(str, options)])


def refusal(ran: Any) -> str:
    """The sentence with which a command failed."""
    assert ran.exit_code == 1, ran.output
    assert isinstance(ran.exception, SystemExit)
    (line,) = [line for line in ran.output.splitlines() if line.startswith("Error: ")]
    return line


@pytest.mark.parametrize("name", BAD_FILES)
def test_damaged_files_of_a_set_are_named(name: str, tmp_path: Path) -> None:
    make_list(tmp_path / "sets" / "SET", "a b\n", ALL)
    file, content, why = BAD_FILES[name]
    (tmp_path / "sets" / "SET" / file).write_bytes(content)
    said = refusal(official(tmp_path / "sets"))
    assert f"SET/{file}" in said
    assert why in said


def test_a_folder_in_place_of_a_file_is_named(tmp_path: Path) -> None:
    make_list(tmp_path / "sets" / "SET", "a b\n", ALL)
    for name in ("truth.npz", "pairs.txt"):
        (tmp_path / "sets" / "SET" / name).unlink()
        (tmp_path / "sets" / "SET" / name).mkdir()
        _truth.cache_clear()
        assert "it is a folder, not a file" in refusal(official(tmp_path / "sets"))


@pytest.mark.parametrize("name", BAD_TRUTHS)
def test_a_truth_that_does_not_fit_its_pair_is_no_measurement(name: str, tmp_path: Path, match_to: Match) -> None:
    match_to(EVERY)
    truth, why = BAD_TRUTHS[name]
    make_list(tmp_path / "sets" / "SET", "a b\n", truth)
    assert why in refusal(official(tmp_path / "sets"))
    assert not any("error" in record for record in read(tmp_path / "page" / "SET.jsonl"))


def test_pairs_that_cannot_be_measured_fail_the_command_after_the_others(tmp_path: Path, match_to: Match) -> None:
    match_to(EVERY)
    make_list(tmp_path / "sets" / "SET", f"a b\na missing\na {'x' * 300}\n", ALL)
    ran = official(tmp_path / "sets")
    assert "Pairs that could not be measured: 2. The first: SET/a/missing: " in refusal(ran)
    assert "has no shape missing.off" in ran.output
    assert (tmp_path / "page.md").is_file()
    assert sum("error" in record for record in read(tmp_path / "page" / "SET.jsonl")) == 1


def test_records_that_are_no_records_are_passed_over_or_named(tmp_path: Path, match_to: Match) -> None:
    match_to(EVERY)
    make_list(tmp_path / "sets" / "SET", "a b\n", ALL)
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "SET.jsonl").write_text('[1]\n3\n{"code": "x", "tar')
    assert official(tmp_path / "sets").exit_code == 0
    (tmp_path / "page" / "OTHER.jsonl").write_text((tmp_path / "page" / "SET.jsonl").read_text())
    assert "OTHER.json about the records beside it: measure the set again" in refusal(official(tmp_path / "sets"))
    (tmp_path / "elsewhere").write_text("")
    ran = official(tmp_path / "sets", "--records", tmp_path / "elsewhere")
    assert "is a file" in ran.output
    assert ran.exit_code == 2
