# SPDX-License-Identifier: GPL-3.0-or-later
"""The filter that CONTRIBUTING.md adds works."""

from __future__ import annotations

from pathlib import Path

from guide import follow


def test_the_filter_of_the_guide_works(tmp_path: Path) -> None:
    follow("A filter for MeshLab", tmp_path)
