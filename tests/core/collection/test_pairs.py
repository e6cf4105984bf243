# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection of the pairs of a collection to match."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zoomout_core.collection.pair_map import PairName
from zoomout_core.collection.pairs import all_pairs, pairs_of_neighbours, pairs_with_template, read_pairs
from zoomout_core.mesh.errors import MeshError

NAMES = ["a", "b", "c", "d"]


def test_a_template_is_the_source_of_all_others() -> None:
    assert pairs_with_template("b", NAMES) == [PairName("b", name) for name in ("a", "c", "d")]


def test_all_pairs_are_listed_once() -> None:
    found = all_pairs(NAMES)
    assert len(found) == 6
    assert len({frozenset(pair) for pair in found}) == 6


def test_neighbours_have_similar_spectra_and_all_are_connected() -> None:
    # Two groups of three; spectra differ by a factor of two between groups, and hardly within a group.
    spectra = {
        f"{group}{number}": group * np.arange(60.0) * (1 + 0.01 * number) for group in (1, 2) for number in range(3)
    }
    found = pairs_of_neighbours(spectra, 1)
    across = [pair for pair in found if pair.source[0] != pair.target[0]]
    assert across == [PairName("12", "20")]
    assert {name for pair in found for name in pair} == set(spectra)
    assert len(found) == 5


def test_number_of_neighbours_may_exceed_the_collection() -> None:
    assert pairs_of_neighbours({"a": np.arange(60.0)}, 4) == []
    found = pairs_of_neighbours({name: np.arange(60.0) for name in NAMES}, 10)
    assert sorted(found) == sorted(all_pairs(NAMES))


def test_pair_files_accept_names_with_or_without_suffix(tmp_path: Path) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text("a b  # a comment\n\nc.off d.ply\na b\n")
    assert read_pairs(path, NAMES) == [PairName("a", "b"), PairName("c", "d")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a\n", "line 1: give two names"),
        ("a b\na x\n", "line 2: the collection has no shape named 'x': correct"),
        ("a a.off\n", "paired with itself"),
        ("# none\n", "contains no pairs"),
    ],
)
def test_invalid_pair_files_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text(text)
    with pytest.raises(MeshError, match=said):
        read_pairs(path, NAMES)


def test_pair_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"There is no file .*missing\.txt: check the path"):
        read_pairs(tmp_path / "missing.txt", NAMES)
    with pytest.raises(MeshError, match="is a folder: give a file"):
        read_pairs(tmp_path, NAMES)
    (tmp_path / "image.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MeshError, match="is not a list of pairs: save it as plain text in UTF-8"):
        read_pairs(tmp_path / "image.txt", NAMES)
