# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of tools on malformed files and hard meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import robustness
from benchmarks.robustness.cases import clean, hard_meshes, malformed_files
from benchmarks.tables import write_page

pytestmark = pytest.mark.slow


def test_verdict_distinguishes_right_wrong_and_reported() -> None:
    source, target = clean()
    of = lambda answer: robustness._verdict(answer, target, source)  # noqa: E731
    assert of("crash") == "crash"
    assert of({"said": "It is empty."}) == "refused"
    assert of({"carried": target[0].tolist(), "doubts": []}) == "right"
    wrong = np.roll(target[0], 300, axis=0).tolist()
    assert of({"carried": wrong, "doubts": []}) == "silently wrong"
    assert of({"carried": wrong, "doubts": ["A note."]}) == "warned"
    assert of({"doubts": ["nothing was read"]}) == "warned"


def test_hard_meshes_keep_the_vertices_of_the_target() -> None:
    _, target = clean()
    for name, harden in hard_meshes().items():
        vertices, _ = harden(target)
        same = (vertices[: len(target[0])] == target[0]).all(axis=1)
        assert name == "no extent" or same.sum() >= len(target[0]) - 1, name


def test_files_are_read_in_separate_processes(tmp_path: Path) -> None:
    files = malformed_files()
    for name, verdict in (("vertex_zero.obj", "refused"), ("empty.stl", "refused")):
        assert robustness._read(name, files[name], tmp_path, "zoomout_core") == verdict
    assert robustness._read("empty.stl", b"", tmp_path, "pyFMaps") == "-"


def test_hanging_process_is_terminated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "SECONDS", 0.01)
    assert robustness._answer("zoomout_core", tmp_path / "missing.obj") == "hang"


def test_page_keeps_text_between_tables(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("Before.\n\n<!-- sums -->\nold\n<!-- end of sums -->\n\nAfter.\n")
    write_page({"sums": [{"tool": "ours", "right": 3}]}, page)
    text = page.read_text()
    assert text.startswith("Before.\n\n<!-- sums -->\n\n|")
    assert text.endswith("<!-- end of sums -->\n\nAfter.\n")
    assert "old" not in text
