# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged or exchanged cache files of prepared shapes are ignored, and the map is the same."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo

SOURCE, TARGET = (creature(300, seed=seed).surface for seed in (0, 1))
NUMBERS = {"k_final": 20, "samples": 60, "initial": "proximity"}


def matched(k_final: int = 20) -> zo.SurfaceMap:
    zo.forget_shapes()
    return zo.match(SOURCE, TARGET, **NUMBERS | {"k_final": k_final}).surface_map


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """With the two shapes."""
    zo.store_shapes(tmp_path)
    yield tmp_path
    zo.store_shapes(None)
    zo.forget_shapes()


def exchanged(one: Path, other: Path) -> None:
    aside = one.with_name("aside")
    one.rename(aside)
    other.rename(one)
    aside.rename(other)


def of_other_numbers(one: Path, other: Path) -> None:
    """The same mesh prepared with fewer samples, under this one's name."""
    kept = {path: path.read_bytes() for path in (one, other)}
    zo.forget_shapes()
    zo.match(SOURCE, TARGET, **NUMBERS | {"samples": 200})
    sizes = {path.stat().st_size: path for path in one.parent.glob("*.npz") if path not in kept}
    for path, content in kept.items():
        path.write_bytes(content)
        shutil.copy(sizes[min(sizes)], path)


def rewritten(path: Path, **arrays: np.ndarray | None) -> None:
    """With some arrays as given, or without them."""
    with np.load(path) as file:
        held = {name: file[name] for name in file.files} | arrays
    np.savez(path, **{name: array for name, array in held.items() if array is not None})


DAMAGES: dict[str, Callable[[Path, Path], object]] = {
    "exchanged": exchanged,
    "the same one twice": lambda one, other: shutil.copy(one, other),
    "of other numbers": of_other_numbers,
    "empty": lambda one, _: one.write_bytes(b""),
    "cut off": lambda one, _: one.write_bytes(one.read_bytes()[: one.stat().st_size // 2]),
    "zeros in its middle": lambda one, _: one.write_bytes(
        one.read_bytes()[:4000] + bytes(4000) + one.read_bytes()[8000:]
    ),
    "a folder": lambda one, _: (one.unlink(), one.mkdir()),
    "of no shape": lambda one, _: rewritten(one, key=None),
    "without eigenvectors": lambda one, _: rewritten(one, eigenvectors=None),
    "of fewer vertices": lambda one, _: rewritten(one, areas=np.ones(7)),
    "a matrix out of bounds": lambda one, _: rewritten(one, **{"stiffness.indices": np.full(9, 10**6)}),
}


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_cached_shape_is_ignored(folder: Path, damage: str) -> None:
    right = matched()
    one, other = sorted(folder.rglob("*.npz"))
    DAMAGES[damage](one, other)
    found = matched()
    np.testing.assert_array_equal(found.triangle, right.triangle)
    np.testing.assert_array_equal(found.barycentric, right.barycentric)
