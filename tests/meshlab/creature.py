# SPDX-License-Identifier: GPL-3.0-or-later
"""The samples' character with five different limbs, in various poses and meshes with known rest positions.

Two of its meshes, remeshed independently and posed differently, correspond by their rest positions.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from meshlab_filter.samples import (
    CHARACTER,
    CHARACTER_POSE,
    OTHER_POSE,
    Sample,
    chart_of,
    coordinates,
    sample,
    write_obj,
)

__all__ = ["SOURCE_POSE", "STRAIGHT", "TARGET_POSE", "chart_of", "coordinates", "creature", "rest_of"]

STRAIGHT = np.zeros(5)
SOURCE_POSE, TARGET_POSE = CHARACTER_POSE, OTHER_POSE


def creature(edge: float, pose: np.ndarray) -> Sample:
    """The posed creature with triangles of a given edge length."""
    return _make(edge, tuple(pose))


@cache
def _make(edge: float, pose: tuple[float, ...]) -> Sample:
    return sample(CHARACTER, edge, np.array(pose))


def rest_of(uv: np.ndarray) -> np.ndarray:
    """(n, 2) x and y at rest from texture coordinates."""
    return np.column_stack([10 * (uv[:, 0] % 0.5) - 2.5, 5 * uv[:, 1] - 2])


def write_textured_obj(folder: Path, made: Sample) -> None:
    """Write creature.obj, with its material file and the textures `front.bmp` and `back.png`."""
    random = np.random.default_rng(0)
    for name, width in (("front.bmp", 16), ("back.png", 32)):
        Image.fromarray(random.integers(0, 255, (16, width, 3), dtype=np.uint8)).save(folder / name)
    write_obj(folder / "creature.obj", made, ("front.bmp", "back.png"))
