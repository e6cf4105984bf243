# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of dolls for the tests of outfits."""

from __future__ import annotations

from pathlib import Path

import pytest
from dolls import write_doll


@pytest.fixture(scope="session")
def dolls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dressed creature, `dressed.glb`, and a wider naked one, `naked.glb`."""
    folder = tmp_path_factory.mktemp("dolls")
    write_doll(folder / "dressed.glb", is_dressed=True, seed=1)
    write_doll(folder / "naked.glb", is_dressed=False, seed=2, wide=1.15, prefix="J_")
    return folder
