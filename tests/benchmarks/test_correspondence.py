# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of correspondences has every pair, distinguishes flips from other failures, and writes its records."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import correspondence
from benchmarks.__main__ import main
from benchmarks.correspondence import OURS, Map, _calibration, _records, _rows
from benchmarks.datasets import TEMPLATE, PairOfParts, load_pair, pair_names, sets_in
from benchmarks.tuning.ablation import NEUTRAL
from zoomout_core.matching.ranking.scores import total_score

pytestmark = pytest.mark.slow

Tables = dict[str, list[dict]]


@pytest.fixture(scope="module")
def outcome(data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """The output of the command with all its options, and its output folder."""
    folder = tmp_path_factory.mktemp("outcome")
    arguments = ["correspondence", "--data", data, "--json", folder / "tables.json", "--ablate", "--pictures", folder]
    outcome = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert outcome.exit_code == 0, outcome.output
    return outcome.output, folder


@pytest.fixture(scope="module")
def tables(outcome: tuple[str, Path]) -> Tables:
    return json.loads((outcome[1] / "tables.json").read_text())


def test_pairs_are_taken_in_both_directions_and_spread_evenly(tmp_path: Path) -> None:
    (tmp_path / "pairs.txt").write_text("a b\nc d\n\ne f\nf e\n")
    assert pair_names(tmp_path, None) == [("a", "b"), ("c", "d"), ("e", "f"), ("f", "e"), ("b", "a"), ("d", "c")]
    assert pair_names(tmp_path, 2) == [("a", "b"), ("d", "c")]
    assert len(pair_names(tmp_path, 100)) == 6


def test_sets_in_finds_only_complete_sets(tmp_path: Path) -> None:
    for name, files in {
        "whole": ("pairs.txt", "correspondence.npz"),
        "parts": ("pairs.txt", "truth.npz"),
        "alone": ("correspondence.npz",),
        "template": (TEMPLATE,),
    }.items():
        (tmp_path / name).mkdir()
        for file in files:
            (tmp_path / name / file).touch()
    assert [folder.name for folder in sets_in(tmp_path)] == ["template", "whole"]
    assert sets_in(tmp_path / "whole") == [tmp_path / "whole"]


def test_each_method_has_a_row_over_the_pairs_that_it_knows(tables: Tables) -> None:
    rows = {row["method"]: row for row in tables["rows"]}
    assert {name: row["pairs"] for name, row in rows.items()} == {
        OURS: 2,
        "ini_direct": 1,
        "ini_direct + zoomout": 1,
        "ini_symm": 1,
    }
    assert [rows[name]["success %"] for name in rows] == [100, 100, 100, 0]
    assert rows["ini_direct"]["mean"] < 20
    assert rows["ini_direct"]["seconds"] is None
    assert rows["ini_direct + zoomout"]["seconds"] > 0
    assert 0 <= rows[OURS]["turned over %"] < 30
    assert 60 < rows[OURS]["covered %"] <= 100
    assert -1 <= rows[OURS]["rank correlation"] <= 1


def test_record_describes_every_map(tables: Tables) -> None:
    ours = [record for record in tables["pairs"] if record["method"] == OURS]
    assert [(record["target"], record["source"]) for record in ours] == [("a", "b"), ("b", "a")]
    for record in ours:
        assert record["right"]
        assert not record["flip"]
        assert record["symmetric error"] > 3 * record["error"]
        assert record["origin"]


def test_calibration_counts_every_map_once(tables: Tables) -> None:
    for name in ("all", "creatures"):
        rows = [row for row in tables["calibration"] if row["set"] == name]
        assert sum(row["maps"] for row in rows) == 2
        assert sum(row["flips"] or 0 for row in rows) == 0


# --- parts --------------------------------------------------------------------------------------------------------


def guessed(method: str, pair: PairOfParts) -> tuple[Any, Map]:
    """The true map, except for cuts, which are mapped to one place with nothing reported missing."""
    lost = pair.kind == "cuts"
    masks = np.ones(len(pair.target.vertices), dtype=bool), pair.region | lost
    result = SimpleNamespace(
        has_partner=masks[0],
        source_has_partner=masks[1],
        source_share_without_partner=pair.source.share_of_area(~masks[1]),
    )
    vertex = np.zeros_like(pair.truth) if lost else np.maximum(pair.truth, 0)
    return result, Map(method, vertex, {"seconds": 2.0, "certainty": 0.1 if lost else 0.95})


def test_each_kind_of_parts_has_a_row_beside_published_figures(parts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correspondence, "_match", guessed)
    tables = correspondence.run(parts, None, False, None)
    rows = {row["set"]: row for row in tables["parts"]}
    assert {name: row["pairs"] for name, row in rows.items()} == {"cuts": 2, "holes": 1, "both cut, other species": 1}
    assert [row["success %"] for row in rows.values()] == [0, 100, 100]
    cuts, holes, both = rows.values()
    assert (cuts["PFM's mean"], cuts["trained"]) == (97, "20 to 33")
    assert (holes["PFM's mean"], both["PFM's mean"]) == (232, None)
    assert cuts["mean"] > 100
    assert (holes["mean"], holes["certainty"], holes["seconds"]) == (0, 0.95, 2)
    assert (holes["overlap on source"], holes["of right ones"], holes["share off by %"]) == (1, 1, 0)
    # All vertices are predicted to have a partner: the union is the whole.
    missing = [record["missing %"] for record in tables["pairs"] if record["set"] == "cuts"]
    assert cuts["overlap on source"] == pytest.approx(1 - np.mean(missing) / 100)
    assert cuts["share off by %"] == pytest.approx(np.mean(missing))
    assert cuts["of right ones"] is None
    assert both["overlap on target"] == pytest.approx(2 / 3, abs=0.05)
    assert sum(row["maps"] for row in tables["calibration"] if row["set"] == "all") == 4
    assert [len(correspondence.run(parts, 1, False, None)["pairs"])] == [3]


def test_a_part_is_matched_drawn_and_shown(parts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correspondence, "part_names", lambda *_: ["holes_a_00"])
    monkeypatch.setattr(correspondence, "PARTS", {"holes": "holes"})
    arguments = ["correspondence", "--data", parts / "partial", "--pictures", tmp_path]
    outcome = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert outcome.exit_code == 0, outcome.output
    assert "overlap on source" in outcome.output
    assert "holes" in outcome.output
    assert matplotlib.image.imread(tmp_path / "partial.png").shape[1] > 500


@pytest.mark.parametrize(("method", "right", "flip"), [("direct", True, False), ("symm", False, True)])
def test_a_map_that_exchanges_left_and_right_counts_as_a_flip(data: Path, method: str, right: bool, flip: bool) -> None:
    folder = data / "creatures"
    pair = load_pair(folder, "a", "b")
    with np.load(folder / f"map_ini_{method}.npz") as maps:
        vertex = maps["a__b"]
    entry = Map(OURS, vertex, {"certainty": 1.0}, np.linspace(0, 1, len(vertex)))
    (record,) = _records("creatures", pair, [entry])
    assert (record["right"], record["flip"]) == (right, flip)
    announced = [row for row in _calibration([record]) if row["maps"]]
    assert [(row["right %"], row["flips"]) for row in announced] == [(100 * right, flip)] * 2


def test_confidence_is_rated_by_rank_correlation_with_error(data: Path) -> None:
    pair = load_pair(data / "creatures", "a", "b")
    # Right on one half of the known places, wrong on the other, and it is known which.
    vertex = np.full(len(pair.target.vertices), pair.source_vertex[0])
    half = np.arange(len(pair.target_vertex)) < len(pair.target_vertex) // 2
    vertex[pair.target_vertex[half]] = pair.source_vertex[half]
    error = pair.errors(vertex[:, None])[:, 0]
    confidence = np.ones(len(vertex))
    confidence[pair.target_vertex] = 1 / (1 + error)
    (record,) = _records("creatures", pair, [Map(OURS, vertex, {}, confidence)])
    assert record["rank correlation"] == pytest.approx(1, abs=1e-3)  # equal errors may differ by rounding
    assert record["trusted and right %"] == 100
    assert record["not trusted %"] == pytest.approx(100 * (error > 1).mean())


def test_images_that_are_missing_do_not_count(data: Path) -> None:
    pair = load_pair(data / "creatures", "a", "b")
    vertex = np.full(len(pair.target.vertices), -1)
    vertex[pair.target_vertex[:10]] = pair.source_vertex[:10]
    errors = pair.errors(vertex[:, None])
    assert np.isnan(errors[:, 0]).sum() == len(errors) - len(np.unique(pair.target_vertex[:10]))
    (row,) = _rows(_records("creatures", pair, [Map("sparse", vertex)]))
    assert row["mean"] == 0


def test_every_stage_is_left_out_in_turn(tables: Tables) -> None:
    rows = {row["method"]: row for row in tables["ablation"]}
    left_out = {"extremities", "descriptors", "signs", "turns", "anchors", "the reverse map", *NEUTRAL}
    assert set(rows) == {"all", *(f"without {name}" for name in left_out)}
    assert {row["pairs"] for row in rows.values()} == {2}
    assert rows["all"]["success %"] == 100


def test_neutral_scores_leave_their_criterion_out_of_the_total() -> None:
    neutral = {name: score for scores in NEUTRAL.values() for name, score in scores.items()}
    assert total_score(neutral) == 0
    scores = dict.fromkeys(neutral, 0.5)
    for left_out in NEUTRAL.values():
        alone = neutral | dict.fromkeys(left_out, 0.5)
        assert total_score(alone) == pytest.approx(total_score(scores) - total_score(scores | left_out))
        assert total_score(alone) != 0


def test_the_worst_pairs_are_drawn_in_colour(outcome: tuple[str, Path]) -> None:
    image = matplotlib.image.imread(outcome[1] / "creatures.png")[:, :, :3]
    assert (np.ptp(image, axis=2) > 0.3).mean() > 0.02


def test_all_tables_but_that_of_single_pairs_are_printed(outcome: tuple[str, Path]) -> None:
    for column in ("ini_direct + zoomout", "announced %", "without signs"):
        assert column in outcome[0]
    assert "origin" not in outcome[0]


def test_a_folder_without_sets_is_refused_in_one_sentence(tmp_path: Path) -> None:
    outcome = CliRunner().invoke(main, ["correspondence", "--data", str(tmp_path)])
    assert outcome.exit_code != 0
    assert outcome.output.strip().splitlines()[-1].startswith("Error: ")
    assert "holds nothing" in outcome.output
