# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that CONTRIBUTING.md adds works."""

from pathlib import Path

from guide import follow


def test_the_operator_of_the_guide_works(tmp_path: Path):
    follow("An operator for Blender", tmp_path)
