"""Sets of meshes with known correspondences, laid out as the benchmark data's README says."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from zoomout_core.files import read_surface
from zoomout_core.surface import Integers, Surface


@dataclass(frozen=True)
class PairOfMeshes:
    """Two meshes of a set: the map starts on the target and lands on the source.

    Attributes:
        target_name: as in `pairs.txt`, where it stands first.
        source_name: the second of the line.
        target: the first mesh.
        source: the second mesh.
        target_vertex: (c,) vertices of the target whose place on the source is known.
        source_vertex: (c,) that place.
    """

    target_name: str
    source_name: str
    target: Surface
    source: Surface
    target_vertex: Integers
    source_vertex: Integers


def sets_in(folder: Path) -> list[Path]:
    """The sets with a list of pairs in a folder, or the folder itself if it is one."""
    return [path.parent for path in sorted([*folder.glob("pairs.txt"), *folder.glob("*/pairs.txt")])]


def pair_names(folder: Path, most: int | None) -> list[tuple[str, str]]:
    """The pairs of a set, or `most` of them evenly spread over the list."""
    lines = [line.split() for line in (folder / "pairs.txt").read_text().splitlines() if line.strip()]
    if most is not None and most < len(lines):
        lines = [lines[i] for i in np.linspace(0, len(lines) - 1, most).round().astype(int)]
    return [(first, second) for first, second in lines]


def load_pair(folder: Path, target_name: str, source_name: str) -> PairOfMeshes:
    """A pair with its true correspondence."""
    truth = _truth(folder)
    target, source = (_surface(folder / f"{name}.off") for name in (target_name, source_name))
    return PairOfMeshes(target_name, source_name, target, source, truth[target_name], truth[source_name])


@lru_cache(maxsize=8)
def _truth(folder: Path) -> dict[str, Integers]:
    with np.load(folder / "correspondence.npz") as file:
        return dict(file)


@lru_cache(maxsize=128)
def _surface(path: Path) -> Surface:
    return read_surface(path)
