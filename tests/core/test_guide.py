# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of CONTRIBUTING.md work: its additions to the core run."""

from __future__ import annotations

from pathlib import Path

import pytest
from guide import follow


@pytest.mark.parametrize("section", ["A kind of attribute", "A hypothesis"])
def test_steps_of_the_guide_work(section: str, tmp_path: Path) -> None:
    follow(section, tmp_path)
