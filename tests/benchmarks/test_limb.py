# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of a limb with a seam: every row shows a limb in the colours of the checker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.transfer import picture
from blender_addon.demo import Size

pytestmark = pytest.mark.slow


def test_every_row_shows_a_limb_with_its_checker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "SAMPLES", 2)
    picture.draw(tmp_path / "limb.png", Size(cell=0.035, voxel=0.03, target_vertices=1500), width=120)
    pixels = np.asarray(Image.open(tmp_path / "limb.png").convert("RGB"), dtype=float)
    saturation = np.ptp(pixels, axis=2)
    for row in np.array_split(saturation, 4):
        assert 0.1 < (row > 40).mean() < 0.6
