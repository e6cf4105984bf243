# SPDX-License-Identifier: GPL-3.0-or-later
"""What CONTRIBUTING.md says is true: the filter that it adds works."""

from __future__ import annotations

from pathlib import Path

from guide import follow


def test_the_filter_of_the_guide_works(tmp_path: Path) -> None:
    follow("A filter for MeshLab", tmp_path)
