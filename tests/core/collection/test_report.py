# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a collection: one direction for each pair, correct numbers, and no statements about skipped steps."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from zoomout_core.collection.collection import CollectionResult
from zoomout_core.collection.cycles import Agreement
from zoomout_core.collection.pair_map import PairName, PairRecord
from zoomout_core.collection.report import figures_of_collection, lines_of_collection, page_of
from zoomout_core.collection.shapes import Item

PAIRS = [PairName("hero", name) for name in ("ape", "bear")] + [PairName("ape", "bear")]


def collection(count: int = 3, certainty: float = 0.5, changed: int | None = None) -> CollectionResult:
    """A collection of three shapes and some pairs, the first of which takes another candidate than its first."""
    record = PairRecord("key", certainty, 0.8, 0.1, 0.0, 0.0, candidates=2, notes=("A note.",))
    records = dict.fromkeys(PAIRS[:count], record)
    agreement = None
    if changed is not None:
        numbers = {pair: int(place < changed) for place, pair in enumerate(PAIRS)}
        before = dict.fromkeys(PAIRS, 0.05)
        after = dict.fromkeys(PAIRS, 0.02 if changed else 0.05)
        agreement = Agreement(numbers, {}, {}, before, after, dict.fromkeys(PAIRS, certainty))
    items = {name: Item(name, Path(f"{name}.ply")) for name in ("hero", "ape", "bear")}
    return CollectionResult(Path("out"), items, records, {str(PAIRS[0]): "It is empty."}, agreement, {}, count)


@pytest.mark.parametrize(("count", "words"), [(1, "1 pair"), (2, "2 pairs"), (3, "3 pairs")])
def test_numbers_and_nouns_agree(count: int, words: str) -> None:
    first, *_ = lines_of_collection(collection(count))
    assert first == f"Matched {words} of 3 shapes, {count} of them in this run; 1 failed."
    assert f"All {count} pairs" in page_of(collection(count), {}) or count == 1
    assert "1 pairs" not in page_of(collection(count), {})


def test_pairs_are_written_from_source_to_target_everywhere() -> None:
    result = collection(changed=1)
    page = page_of(result, {"ape": b"png"})
    assert "hero to ape" in page
    assert not re.search("(ape|bear) to hero", page + "".join(lines_of_collection(result)))
    assert "<td>hero</td><td>ape</td>" in page
    assert figures_of_collection(result)["cycles"]["changed"] == [{"source": "hero", "target": "ape"}]


def test_report_describes_the_outcome_of_cycles() -> None:
    without, same, other = (page_of(collection(changed=changed), {}) for changed in (None, 0, 1))
    assert "cycles" not in without.partition("look at first")[2].partition("<table>")[0]
    assert "no other candidates close them better" in same
    assert "before and after" not in same
    assert "0.050 →" not in same
    assert "and by 0.020 with other candidates for hero to ape" in other
    assert "before and after other candidates were chosen" in other
    assert "0.050 → 0.020" in other


def test_both_tables_scroll() -> None:
    assert page_of(collection(), {}).count('<div class="scroll"><table>') == 2
