# SPDX-License-Identifier: GPL-3.0-or-later
"""Every reader reads damaged files or refuses them in a sentence; other results are findings."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from fuzz import cases, fault_of, run
from fuzz_readers import Reader, readers

from zoomout_core.mesh.errors import MeshError

SEED = 20261123


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("count", [500, 2000])
def test_broken_files_are_read_or_refused_in_a_sentence(tmp_path: Path, count: int) -> None:
    ends, findings = run(count, SEED, tmp_path / "kept")
    assert not findings
    assert sum(ends.values()) >= count
    assert min(ends["read"], ends["refused"]) > count / 10
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("name", readers())
def test_fuzz_samples_are_read_and_damages_are_reproducible(tmp_path: Path, name: str) -> None:
    reader = readers()[name]
    for sample in reader.samples:
        (tmp_path / f"a{reader.ending}").write_bytes(sample)
        assert fault_of(reader, tmp_path / f"a{reader.ending}") == ("read", "")
    twice = [list(cases(name, reader, 10, 3)) for _ in range(2)]
    assert twice[0] == twice[1]
    assert list(cases(name, reader, 10, 4)) != twice[0]
    assert all(each not in reader.samples for each in twice[0][:1]) or len(set(twice[0])) > 1


def test_unexpected_outcome_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(sentence: str) -> Reader:
        def read(_: Path) -> None:
            raise MeshError(sentence)

        return Reader(".off", read, (b"OFF",))

    def busy(_: Path) -> None:
        begin = time.process_time()
        while time.process_time() - begin < 0.02:
            pass

    def crashes(_: Path) -> None:
        raise IndexError("list index out of range")

    assert fault_of(refuses("The file is broken: export it again."), tmp_path) == ("refused", "")
    assert fault_of(refuses("broken"), tmp_path) == ("finding", "is no sentence: 'broken'")
    assert fault_of(Reader(".off", crashes, ()), tmp_path) == ("finding", "IndexError: list index out of range")
    monkeypatch.setattr("fuzz.MAX_SECONDS", 0.01)
    assert fault_of(Reader(".off", busy, ()), tmp_path)[0] == "finding"
    monkeypatch.setattr("fuzz.readers", lambda: {"one": Reader(".off", crashes, (b"OFF 1",))})
    ends, findings = run(3, 0, tmp_path / "kept")
    assert ends == {"finding": 3}
    assert findings[0].startswith("one 0: IndexError")
    assert len(list((tmp_path / "kept").iterdir())) == 3
